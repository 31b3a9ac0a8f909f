# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames against Reference where the G-buffer's lobes aren't the material's: rough diffuse, sheen, toon, mixes."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import MaterialData

from tests import scenes
from tests.light_checks import Setup, eroded
from tests.light_scenes import LitScene, look_at

SIZE = (48, 32)
BASE = {"ior": 1.5, "specular_tint": 1.0, "coat_ior": 1.5, "coat_tint": 1.0, "sheen_tint": 1.0, "multiscatter": True}


def lit_ball(material, *, lamp=True, background=0.0):
    """Make a ball under a lamp from aside, and nothing else."""
    lamps = [scenes.lamp("POINT", 800.0, scenes.place(3.0, -3.0, 3.0), radius=0.5)] if lamp else []
    delta = scenes.delta({"ball": scenes.sphere(1.0, 48)}, [("ball", np.eye(4), "ball")], {"ball": material},
                         lights=lamps, background=background)
    return LitScene(delta, look_at((0.0, -4.0, 0.8), (0.0, 0.0, 0.0), SIZE, 0.85))


def ratios(scene, frames=24, samples=256):
    """Return the light of the ball after frames over that of Reference: of its mean, and of its quarters."""
    setup = Setup(SIZE, truth_samples=samples)
    inside = eroded(setup.positions(scene).any(-1), 1)
    mine, truth = setup.picture(scene, frames), setup.truth(scene)
    parts = [inside[:16, :24], inside[:16, 24:], inside[16:, :24], inside[16:, 24:]]
    corners = [np.s_[:16, :24], np.s_[:16, 24:], np.s_[16:, :24], np.s_[16:, 24:]]
    whole = mine[inside].mean(0, dtype=np.float64) / truth[inside].mean(0, dtype=np.float64)
    quarters = [mine[corner][part].mean() / truth[corner][part].mean()
                for corner, part in zip(corners, parts, strict=True) if truth[corner][part].mean() > 0.02]
    return whole, np.array(quarters)


SHAPES = {
    # Without direct_shapes.py, the furthest of the quarters: 0.80, 0.80, 2.7, 0.83, 1.2, 4.5.
    "rough diffuse": ("DIFFUSE", {"roughness": 1.0, "color": (0.8, 0.4, 0.2)}),
    "rough base": ("PRINCIPLED", BASE | {"diffuse_roughness": 1.0, "color": (0.8, 0.4, 0.2), "roughness": 1.0}),
    "sheen": ("SHEEN", {"roughness": 0.5, "color": 0.9}),
    "toon": ("TOON_DIFFUSE", {"roughness": 0.5, "anisotropic": 0.3, "color": 0.8}),
    "velvet": ("PRINCIPLED", BASE | {"sheen": 1.0, "sheen_roughness": 0.3, "roughness": 1.0, "color": 0.05}),
    "glossy toon": ("TOON_GLOSSY", {"roughness": 0.3, "anisotropic": 0.3, "color": 0.8}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
def test_light_falls_as_the_material_reflects_it(name):
    """Match Reference under a lamp, over the whole ball and over its quarters."""
    kind, arguments = SHAPES[name]
    whole, quarters = ratios(lit_ball(scenes.material(kind, **arguments)))
    np.testing.assert_allclose(whole, 1.0, atol=0.02)
    np.testing.assert_allclose(quarters, 1.0, atol=0.06)


def test_highlights_are_stretched():
    """Find the light of brushed metal where Reference has it: highlights across the ball, not round ones."""
    metal = scenes.material("PRINCIPLED", **BASE, metallic=1.0, roughness=0.5, color=0.9, anisotropic=0.9,
                            tangent=(0.0, 0.0, 1.0))
    scene = lit_ball(metal)
    setup = Setup(SIZE, truth_samples=256)
    mine, truth = (np.clip(picture[..., 0], 0.0, 2.0) for picture in (setup.picture(scene, 24), setup.truth(scene)))
    # 0.94 with round highlights, now 0.055.
    assert np.abs(mine - truth).mean() / truth.mean() < 0.15


def mixture(*parts):
    """Make a material of several closures, as (kind, colour, weight)."""
    builder = ProgramBuilder()
    for kind, color, weight in parts:
        builder.closure(kind, weight, color=color)
    return MaterialData(name="mixture", program=builder.finish())


def test_mixes_of_colors_keep_their_light():
    """Show a mix of a saturated and a pale colour under a white sky; a clipped G-buffer lost 21 % of the red."""
    mix = mixture(("DIFFUSE", (0.9, 0.02, 0.02), 0.5), ("DIFFUSE", (0.9, 0.9, 0.9), 0.5))
    scene = lit_ball(mix, lamp=False, background=1.0)
    setup = Setup(SIZE)
    inside = eroded(setup.positions(scene).any(-1), 1)
    np.testing.assert_allclose(setup.picture(scene, 32)[inside].mean(0), (0.9, 0.46, 0.46), rtol=0.03)


def test_the_sky_shines_through_bodies_once():
    """Show a hollow translucent ball in a white sky: light passes twice. It had twice that light."""
    scene = lit_ball(scenes.material("TRANSLUCENT", color=(0.8, 0.4, 0.2)), lamp=False, background=1.0)
    setup = Setup(SIZE)
    inside = eroded(setup.positions(scene).any(-1), 1)
    np.testing.assert_allclose(setup.picture(scene, 24)[inside].mean(0), (0.64, 0.16, 0.04), rtol=0.03)
