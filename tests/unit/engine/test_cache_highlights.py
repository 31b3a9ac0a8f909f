# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that comes over glossy walls: where the sun sends it, as bright as path traced, and no light twice."""

from __future__ import annotations

import numpy as np
import pytest

from tests import scenes
from tests.light_checks import Setup, luminance
from tests.light_scenes import LitScene, look_at, slab
from tests.unit.engine.test_mirrored_highlights import SHARED, WALL, towards

SIZE = (48, 30)


def arcade(roughness=0.5, lights=(), background=0.0, metallic=0.0, color=0.2):
    """Make a wall that a steep sun shines along above a roof, whose floor sees no light but what that wall sends on."""
    wall = scenes.material("PRINCIPLED", color=color, metallic=metallic, roughness=roughness, **SHARED)
    matte = scenes.material(color=0.5)
    delta = scenes.delta(
        {"floor": scenes.quad(4.0), "wall": scenes.quad(2.0), "roof": slab((-4.0, -4.0, 2.4), (4.0, 1.6, 2.45))},
        [("floor", np.eye(4), "matte"), ("wall", WALL, "wall"), ("roof", np.eye(4), "matte")],
        {"matte": matte, "wall": wall}, lights, background)
    return LitScene(delta, look_at((0.0, -2.5, 1.2), (0.0, 1.5, 0.1), SIZE, 1.2))


def floor_light(scene, **groups):
    """Return the mean light of the floor in frames, by that in Reference."""
    setup = Setup(SIZE, truth_samples=256, groups=groups)
    positions = setup.positions(scene)
    mask = positions.any(-1) & (np.abs(positions[..., 2]) < 0.01) & (np.abs(positions[..., 0]) < 1.5)
    assert mask.sum() > 300
    return luminance(setup.picture(scene, 24))[mask].mean() / luminance(setup.truth(scene))[mask].mean()


SUN = scenes.lamp("SUN", 3.0, towards((0.0, 0.0, 0.0), (0.0, 0.35, -1.0)), angle=0.02)


FRAMES_IN_MOTION = {"denoiser": {"path_traced_rest": False, "rest_gather": False}}
"""Settings with which light comes by the probes alone"""


WAYS = [pytest.param({}, id="gathered"), pytest.param(FRAMES_IN_MOTION, id="probes", marks=pytest.mark.slow)]
"""Settings by which light comes to a pixel"""


@pytest.mark.parametrize("groups", WAYS)
@pytest.mark.parametrize(("roughness", "metallic", "color"), [(0.5, 0.0, 0.2), (0.5, 1.0, 0.6)], ids=["stone", "metal"])
def test_the_sun_comes_down_a_wall(roughness, metallic, color, groups):
    """Find as much light below a wall as path traced: it reflects the sun to the ground, not to all sides."""
    scene = arcade(roughness, [SUN], 0.0, metallic, color)
    assert floor_light(scene, **groups) == pytest.approx(1.0, abs=0.12)


def test_matte_walls_leave_the_ground_dark():
    """Lose much of that light where hits show no highlights."""
    assert floor_light(arcade(0.5, [SUN], 0.0, 1.0, 0.6), cache={"highlights": False}) < 0.6


@pytest.mark.parametrize("groups", WAYS)
def test_a_sky_is_counted_once(groups):
    """Find no more and no less light under a sky without direction, which highlights don't change."""
    scene = arcade(0.5, [], 1.0)
    matte = {**groups, "cache": {"highlights": False}}
    light, before = floor_light(scene, **groups), floor_light(scene, **matte)
    assert light == pytest.approx(before, rel=0.005) and light == pytest.approx(1.0, abs=0.08)


def test_matte_scenes_have_no_lobes():
    """Keep no room for lobes where nothing is glossy."""
    room = []
    for color in (scenes.material(color=0.5), scenes.material("PRINCIPLED", color=0.5, roughness=0.5, **SHARED)):
        delta = scenes.delta({"floor": scenes.quad(4.0)}, [("floor", np.eye(4), "all")], {"all": color}, [SUN])
        session = Setup(SIZE).session(LitScene(delta, look_at((0.0, -2.5, 1.2), (0.0, 1.5, 0.1), SIZE, 1.2)))
        session.step(1)
        room.append(len(session._realtime.pipeline.cache.rays.vertices.lobe))
    assert room[0] == 0 and room[1] > 0
