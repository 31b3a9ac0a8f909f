# SPDX-License-Identifier: GPL-3.0-or-later
"""Test surfaces whose smooth normals lean far away from their triangles, or face the other side, as Cycles draws them.

Converted scenes are full of them: what Cycles leaves black must not be lit through the wall behind.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.session import Session
from burnish.engine.settings import DenoiserSettings, Integrator, SamplingSettings

from tests import scenes

ALBEDO = 0.8


def leaning(degrees: float):
    """Return a square that faces +z, with smooth normals turned by an angle from there towards +x."""
    square, angle = scenes.quad(3.0), np.radians(degrees)
    square.corner_normals[:] = np.float32((np.sin(angle), 0.0, np.cos(angle)))
    return square


def light_on(shape, integrator: Integrator = Integrator.REFERENCE, samples: int = 256, **light) -> float:
    """Return the mean radiance of a grey shape seen from above."""
    settings = dataclasses.replace(
        scenes.SETTINGS, sampling=SamplingSettings(integrator=integrator),
        denoiser=DenoiserSettings(path_traced_rest=False))
    session = Session(settings)
    session.update(scenes.delta({"shape": shape}, [("shape", np.eye(4), "grey")],
                                {"grey": scenes.material(color=ALBEDO)}, **light))
    session.configure(settings, scenes.camera_above(), 16, 16)
    session.step(samples)
    return float(session.read()[..., :3].mean())


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0, 100.0, 180.0])
def test_white_worlds_light_what_lies_above_the_triangle(degrees):
    """Reflect the part of the cosine lobe about the smooth normal that lies above the triangle."""
    expected = ALBEDO * 0.5 * (1.0 + np.cos(np.radians(degrees)))
    np.testing.assert_allclose(light_on(leaning(degrees), background=1.0), expected, rtol=0.01, atol=1e-4)


@pytest.mark.parametrize("integrator", list(Integrator))
@pytest.mark.parametrize(("degrees", "height", "lit"), [
    (0.0, 0.6, True), (40.0, 0.6, True), (180.0, 0.6, False), (180.0, -0.6, False), (100.0, -0.6, False)])
def test_suns_behind_a_triangle_leave_it_dark(integrator, degrees, height, lit):
    """Let a sun light no side of a triangle but its own, whatever the smooth normals say."""
    z = np.float64((np.sqrt(1.0 - height**2), 0.0, height))
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([np.cross((0.0, 1.0, 0.0), z), (0.0, 1.0, 0.0), z], 1)
    found = light_on(leaning(degrees), integrator, 32, lights=[scenes.lamp("SUN", 2.0, matrix, angle=0.01)])
    cosine = np.dot((np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))), z)
    np.testing.assert_allclose(found, 2.0 * ALBEDO / np.pi * cosine if lit else 0.0, rtol=0.02, atol=1e-4)


@pytest.mark.parametrize("kind", ["DIFFUSE", "PRINCIPLED"])
def test_the_normal_pass_shows_normal_maps(kind):
    """Show the normals that lobes have, as Cycles' pass does, not those of the mesh."""
    leaned = np.float32((0.6, 0.0, 0.8))
    session = Session(scenes.SETTINGS)
    bumpy = scenes.material(kind, color=0.5, normal=tuple(leaned.tolist()))
    session.update(scenes.delta({"shape": scenes.quad(3.0)}, [("shape", np.eye(4), "bumpy")], {"bumpy": bumpy},
                                background=1.0))
    session.configure(scenes.SETTINGS, scenes.camera_above(), 8, 8, passes=("Combined", "Normal"))
    session.step(16)
    np.testing.assert_allclose(session.read("Normal"), np.broadcast_to(leaned, (8, 8, 3)), atol=0.01)
