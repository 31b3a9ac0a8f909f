# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of indirect light in rough reflections: the probes' harmonics seen through a GGX lobe."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.settings import ProbeSettings

from tests import scenes
from tests.ggx_sums import directions, lobe_values
from tests.light_checks import Setup, luminance
from tests.light_scenes import LitScene, look_at, slab
from tests.probe_bench import ProbeBench

SIZE = (64, 48)


def bench(sky, camera=None, **fields):
    """Make a bench over a wide floor, seen from above unless by another camera."""
    return ProbeBench({"floor": scenes.quad(50.0)}, [0.0], camera or scenes.camera_above(half=0.5), SIZE, sky=sky,
                      specular=0.5, settings=ProbeSettings(contact_detail=False), **fields)


def ratio(b):
    """Return the light of reflections by the diffuse light [height, width]."""
    return b.probes.specular_ratio.numpy().astype(np.float64).reshape(b.size[1], b.size[0])


@pytest.mark.parametrize("tilt", [0, 25, 60])
@pytest.mark.parametrize("roughness", [0.1, 0.8])
def test_white_sky_reflects_white(tilt, roughness):
    """Give reflections as much of a white sky as diffuse light, for every normal."""
    a = np.radians(tilt)
    b = bench(1.0, tilt=(np.sin(a), 0.0, np.cos(a)), roughness=roughness)
    for _ in range(12):
        b.frame()
    np.testing.assert_allclose(ratio(b), 1.0, rtol=0.005)


@pytest.mark.parametrize("roughness", [0.5, 0.8])
@pytest.mark.parametrize("side", [-1, 1])
def test_rough_reflection_of_half_a_sky(side, roughness):
    """Give a tilted surface the reflection of the half of the sky that it faces, or not."""
    a = np.radians(25)
    b = bench(0.0, tilt=(np.sin(a), 0.0, np.cos(a)), roughness=roughness)
    b.lighting.sun, b.lighting.sun_cosine, b.lighting.sun_direction = 1.0, 0.0, wp.vec3(side, 0.0, 0.0)
    b.record()
    for _ in range(160):
        b.frame()
    got = (ratio(b) * b.irradiance()[0]).mean()
    # The frame about the normal, x away from the view; the surface's own plane hides what is below it.
    frame = np.array([[np.cos(a), 0.0, -np.sin(a)], [0.0, 1.0, 0.0], [np.sin(a), 0.0, np.cos(a)]])
    d = directions()
    f = lobe_values(np.cos(a), roughness, 1.0, 1.0, d * [-1.0, 1.0, 1.0])
    world = d @ frame
    above = world[:, 2] > 0
    due = f[above & (world[:, 0] * side > 0)].sum() / f[above].sum()
    assert abs(got - due) < 0.06


@pytest.mark.parametrize("roughness", [0.7, 1.0])
@pytest.mark.parametrize("cosine", [0.2, 0.5])
def test_grazing_reflection_of_what_is_overhead(cosine, roughness):
    """Give a floor seen at grazing angles what its lobe gets of a bright patch overhead: less than diffuse light."""
    eye = np.array([0.0, -np.sqrt(1.0 - cosine * cosine), cosine])
    b = bench(0.0, look_at(20.0 * eye, (0.0, 0.0, 0.0), SIZE, 0.02), roughness=roughness)
    b.lighting.sun, b.lighting.sun_cosine, b.lighting.sun_direction = 1.0, 0.75, wp.vec3(0.0, 0.0, 1.0)
    b.record()
    for _ in range(96):
        b.frame()
    d = directions()
    f = lobe_values(cosine, roughness, 1.0, 1.0, d)
    due = f[d[:, 2] > 0.75].sum() / f.sum()
    # Harmonics of the whole sphere have 1.15 to 1.27 times that.
    assert abs((ratio(b) * b.irradiance()[0]).mean() / due - 1.0) < 0.12


def window_room(roughness):
    """Make a room that is open to a white sky at one end, with a dark glossy floor and a wall of metal."""
    shared = {"roughness": roughness, "ior": 1.5, "specular_level": 0.5, "specular_tint": (1.0, 1.0, 1.0)}
    walls = {"floor": ((-2, -2, -0.1), (2, 2, 0)), "metal": ((-2.1, -2, 0), (-2, 2, 2.5)),
             "right": ((2, -2, 0), (2.1, 2, 2.5)), "top": ((-2, -2, 2.5), (2, 2, 2.6)),
             "back": ((-2, -2.1, 0), (2, -2, 2.5)), "front": ((-2, 2, 1.8), (2, 2.1, 2.5))}
    materials = {"grey": scenes.material(color=0.4), "floor": scenes.material("PRINCIPLED", color=0.01, **shared),
                 "metal": scenes.material("PRINCIPLED", color=0.8, metallic=1.0, **shared)}
    objects = [(name, np.eye(4), name if name in materials else "grey") for name in walls]
    delta = scenes.delta({name: slab(*ends) for name, ends in walls.items()}, objects, materials, background=1.0)
    return LitScene(delta, look_at((0.6, -1.8, 0.3), (-0.3, 1.9, 0.1), SIZE, 1.3))


@pytest.mark.slow
def test_reflections_of_a_window():
    """Find the light of Reference in rough metal and in a floor seen at grazing angles, opposite a window."""
    setup = Setup(SIZE, truth_samples=512)
    scene = window_room(0.8)
    picture, truth, p = luminance(setup.picture(scene, 64)), luminance(setup.truth(scene)), setup.positions(scene)
    metal = np.abs(p[..., 0] + 2) < 1e-3
    floor = (np.abs(p[..., 2]) < 1e-3) & p.any(-1)
    # As diffuse light alone they would have 0.73 and 0.51 of it.
    assert 0.97 < picture[metal].sum() / truth[metal].sum() < 1.04
    assert 0.91 < picture[floor].sum() / truth[floor].sum() < 1.04
