# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the path tracer's light samples through panes: the light that paths alone find, with less noise."""

from dataclasses import replace

import numpy as np
import pytest
from burnish.engine.session import Session
from burnish.engine.stress.scenes import box as slab

from tests import scenes
from tests.light_scenes import look_at
from tests.unit.engine.test_clear_glass import HERE, WHITE, glass, principled

SIZE = (16, 12)
ALONE = ("Combined", "Diffuse Direct")
"""Passes of light are kept by paths that share nothing with light samples behind glass"""


def behind(panes, lights, background=0.0):
    """Make a white floor and wall behind things given as (mesh, material), whose light comes from beyond them."""
    meshes = {"floor": slab((-2, -2, -0.1), (2, 2, 0)), "wall": slab((-2, 1.9, 0), (2, 2, 2))}
    materials = {"wall": WHITE}
    objects = [(key, HERE, "wall") for key in meshes]
    for i, (mesh, material) in enumerate(panes):
        meshes[f"pane {i}"], materials[f"pane {i}"] = mesh, material
        objects.append((f"pane {i}", HERE, f"pane {i}"))
    return scenes.delta(meshes, objects, materials, lights, background)


def sampled(delta, passes, samples):
    """Return the picture of the floor below the panes."""
    session = Session(scenes.SETTINGS)
    session.update(delta)
    session.configure(
        scenes.SETTINGS, look_at((0.0, -1.9, 0.9), (0.0, 1.0, 0.2), SIZE, 1.4), *SIZE, passes=passes)
    session.step(samples)
    return session.read()[..., :3]


CEILING = slab((-6, -6, 2.1), (6, 6, 2.15))
"""A pane over all"""
SECOND = slab((-6, -6, 2.4), (6, 6, 2.5))
LARGE = scenes.lamp("AREA", 400.0, scenes.place(0.3, 0.2, 4.0), shape="SQUARE", size_x=3.0, size_y=3.0)
BALL = scenes.lamp("POINT", 300.0, scenes.place(-0.5, 0.5, 4.0), radius=1.0, soft_falloff=False)


@pytest.mark.slow
@pytest.mark.parametrize(("panes", "lights"), [
    ([(CEILING, glass())], [LARGE]),
    ([(CEILING, principled((0.4, 0.7, 0.9)))], [LARGE]),
    ([(CEILING, glass()), (SECOND, glass((0.9, 0.8, 0.7), ior=1.3))], [BALL]),
    ([(slab((-6, -6, 2.1), (6, 6, 4.5)), glass())], [LARGE]),
    ([(CEILING, glass(roughness=0.15))], [LARGE]),
    ([(scenes.quad(6.0, 2.1), glass())], [LARGE]),
    ([(scenes.sphere(0.7, 16), glass())], [BALL])],
    ids=["pane", "tinted", "two panes", "lamp within", "rough", "one surface", "ball of glass"])
def test_same_light(panes, lights):
    """Find the light that paths find alone: behind panes with less noise, behind all other glass with the same."""
    delta = behind(panes, lights)
    shared, alone = sampled(delta, ("Combined",), 256), sampled(delta, ALONE, 1024)
    assert shared.mean((0, 1)) == pytest.approx(alone.mean((0, 1)), rel=0.03)


@pytest.mark.slow
def test_mesh_that_shines():
    """Find the light of an emissive mesh behind a pane, which both ways meet, once."""
    panes = [(CEILING, glass()), (slab((-1, -1, 3.5), (1, 1, 3.6)), scenes.emitter(8.0, 0.0))]
    delta = behind(panes, [])
    shared, alone = sampled(delta, ("Combined",), 256), sampled(delta, ALONE, 1024)
    assert shared.mean() == pytest.approx(alone.mean(), rel=0.03)


def test_small_sun():
    """Show the sun through a pane as through a hole, but for what the pane reflects: without sparks."""
    turned = scenes.place()
    turned[:3, :3] = [[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]]
    sun = scenes.lamp("SUN", 2.0, turned, angle=0.01)
    through, opened = (sampled(behind(panes, [sun]), ("Combined",), 64) for panes in ([(CEILING, glass())], []))
    cosine, bent = 0.8, np.arcsin(0.6 / 1.5)
    s = (cosine - 1.5 * np.cos(bent)) / (cosine + 1.5 * np.cos(bent))
    p = (1.5 * cosine - np.cos(bent)) / (1.5 * cosine + np.cos(bent))
    passing = (1.0 - 0.5 * (s * s + p * p)) ** 2
    # What a pane throws back of the floor's light makes the picture lighter, and it is found by chance.
    assert passing - 0.02 < np.median(through / np.maximum(opened, 1.0e-3)) < passing + 0.12
    assert through.max() < 2.0 * opened.max()


def test_linked_lights_stay_with_paths():
    """Leave lights that are for some objects alone to paths, which know what they have left."""
    linked = replace(LARGE, linked_to=1)
    delta = behind([(CEILING, glass())], [linked])
    assert np.isfinite(sampled(delta, ("Combined",), 16)).all()
