# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the screen probe pass on scenes of known light: energy, guiding, leaks, persistence, changes of light."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine.history import arrays_of
from burnish.engine.passes.screen_probes import ScreenProbePass
from burnish.engine.scene import CameraData
from burnish.engine.settings import ProbeSettings

from tests import scenes
from tests.probe_bench import ProbeBench

SETTINGS = ProbeSettings(contact_detail=False)
SIZE = (64, 48)


def settings(**changes):
    """Change some of the settings."""
    return dataclasses.replace(SETTINGS, **changes)


def camera(orthographic=False, half=0.5):
    """Look down on the plane z = 0."""
    return scenes.camera_above(height=3.0, half=half, orthographic=orthographic)


def bench(sky=0.0, size=SIZE, view=None, **fields):
    """Make a bench over a wide black floor."""
    fields.setdefault("settings", SETTINGS)
    return ProbeBench({"floor": scenes.quad(50.0)}, [0.0], view or camera(), size, sky=sky, **fields)


def corner(size=(96, 96), **fields):
    """Make a bench over the edge of a black floor and a white wall of height 1 that starts in the picture's middle."""
    wall = scenes.mesh([[0, -50, 0], [0, 50, 0], [0, 50, 1], [0, -50, 1]], [[0, 1, 2], [0, 2, 3]])
    floor = scenes.mesh([[0, -50, 0], [50, -50, 0], [50, 50, 0], [0, 50, 0]], [[0, 1, 2], [0, 2, 3]])
    fields.setdefault("settings", SETTINGS)
    return ProbeBench({"floor": floor, "wall": wall}, [0.0, 1.0], camera(), size, **fields)


def wall_light(x):
    """Return irradiance / pi on the floor at a distance from an endless white wall of height 1."""
    return 0.5 * (1 - x / np.hypot(x, 1.0))


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize(("tilt", "specular", "exposure"), [(0, 0.0, 1.0), (25, 1.0, 0.01), (60, 0.3, 30.0),
                                                            (85, 0.9, 1.0)])
def test_white_sky(orthographic, tilt, specular, exposure):
    """Give exactly the sky's radiance for every normal and any share of rays into reflections."""
    a = np.radians(tilt)
    b = bench(1.0, view=camera(orthographic), tilt=(np.sin(a), 0.0, np.cos(a)), specular=specular, exposure=exposure)
    for i in range(12):
        b.frame(moved=i < 6)
    light, confidence = b.irradiance()
    np.testing.assert_allclose(light, 1.0, rtol=0.003)
    assert confidence.min() == 1.0
    assert b.probes.stats()["updated"] == b.probes.update_count


@pytest.mark.slow
@pytest.mark.parametrize(("changes", "angle"), [
    ({}, 1.1), *((changes, angle) for angle in (0.3, 1.1) for changes in (
        {}, {"guiding": False}, {"spawn_tile": 8}, {"filtering": False}) if changes or angle < 1.0)])
def test_small_light(changes, angle):
    """Find the irradiance of a small bright light exactly in the mean, with and without guiding."""
    size = 8 * changes.get("spawn_tile", 16)
    b = bench(0.05, settings=settings(**changes), specular=0.5, size=(size, size))
    b.lighting.sun, b.lighting.sun_cosine = 50.0, 0.99
    b.lighting.sun_direction = wp.vec3(np.sin(angle), 0.0, np.cos(angle))
    b.record()
    due = 0.05 + 50.0 * (1 - 0.99**2) * np.cos(angle)
    for _ in range(240):
        b.frame()
    # 256 probes whose light still varies by 8 %: three standard deviations are 1.5 %.
    assert abs(b.irradiance()[0].mean() / due - 1) < 0.015


@pytest.mark.slow
def test_guiding_keeps_the_mean_in_motion():
    """Stay unbiased where the history is short and rays follow it: guided and even rays agree."""
    means = []
    for guiding in (False, True):
        b = bench(0.05, settings=settings(guiding=guiding), size=(96, 96))
        b.lighting.sun, b.lighting.sun_cosine = 10.0, 0.96
        b.lighting.sun_direction = wp.vec3(np.sin(0.8), 0.0, np.cos(0.8))
        b.record()
        frames = []
        for _ in range(300):
            b.frame(moved=True)
            frames.append(b.irradiance()[0].mean())
        means.append(np.mean(frames[40:]))
    due = 0.05 + 10.0 * (1 - 0.96**2) * np.cos(0.8)
    np.testing.assert_allclose(np.array(means) / due, 1.0, atol=0.01)


def test_guiding_lowers_the_noise():
    """Have less noise with guided rays than with even ones."""
    noise = []
    for guiding in (False, True):
        b = bench(0.0, settings=settings(guiding=guiding, filtering=False, update_interval=1))
        b.lighting.sun, b.lighting.sun_cosine = 50.0, 0.99
        b.lighting.sun_direction = wp.vec3(0.5, 0.0, 0.8660254)
        b.record()
        for _ in range(200):
            b.frame(moved=True)
        noise.append(b.irradiance()[0].std())
    assert noise[1] < 0.8 * noise[0]


def test_published_estimator_differs():
    """Show the published estimator's error on a white sky, with the switch that is there for it."""
    b = bench(1.0, settings=settings(energy_exact=False))
    for _ in range(60):
        b.frame(moved=True)
    assert abs(b.irradiance()[0].mean() - 1.0) > 0.05


def test_corner():
    """Give the light of a wall on the floor beside it, up to the pixels at the contact."""
    b = corner()
    for _ in range(300):
        b.frame()
    light, confidence = b.irradiance()
    floor = b.hits() == 0
    x = np.broadcast_to((np.arange(96) + 0.5) / 96 - 0.5, floor.shape)
    ratio = light[floor] / wall_light(x[floor])
    contact = ratio[x[floor] < 8 / 96]
    assert 0.88 < contact.min() and contact.max() < 1.05 and abs(contact.mean() - 1) < 0.02
    assert (contact > 0.9).mean() > 0.99
    inside = x[floor] < 0.4
    assert np.abs(np.array([ratio[inside & (x[floor] > low)].mean() for low in (0.0, 0.1, 0.2)]) - 1).max() < 0.02
    assert confidence[floor].mean() > 0.99


def test_thin_wall_does_not_leak():
    """Keep the light of one side of a wall 2 cm thick from the other."""
    low, high, far = -0.01, 0.01, 5.0
    slab = [[x, y, z] for x in (low, high) for y in (-far, far) for z in (0.0, 2.0)]
    slab = scenes.mesh(slab, [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (1, 5, 7), (1, 7, 3)])
    left = scenes.mesh([[-far, -far, 0], [low, -far, 0], [low, far, 0], [-far, far, 0]], [[0, 1, 2], [0, 2, 3]])
    right = scenes.mesh([[high, -far, 0], [far, -far, 0], [far, far, 0], [high, far, 0]], [[0, 1, 2], [0, 2, 3]])
    lamp = scenes.mesh([[-3, -far, 0], [-3, far, 0], [-3, far, 2], [-3, -far, 2]], [[0, 1, 2], [0, 2, 3]])
    view = CameraData(kind="perspective", transform=tuple(scenes.place(z=4.0).ravel()), window=(-0.5, 0.5, -0.5, 0.5))
    b = ProbeBench({"slab": slab, "left": left, "right": right, "lamp": lamp}, [0.0, 0.0, 0.0, 10.0], view, (96, 96),
                   settings=SETTINGS)
    for i in range(60):
        b.frame(moved=i < 40)
    light, _ = b.irradiance()
    hits = b.hits()
    assert light[hits == 1].mean() > 0.5
    # The floor is one plane, and the wall hides less than two columns of it: only those next to it may hold a rest.
    assert light[hits == 2].mean() < 0.001 * light[hits == 1].mean()
    assert light[:, 49].mean() < 0.1 * light[hits == 1].mean()
    assert light[:, 52:][hits[:, 52:] == 2].max() < 0.005 * light[hits == 1].mean()


def turned(angle):
    """Look along the floor from its middle, turned about z."""
    c, s = np.cos(angle), np.sin(angle)
    right, up, back = np.array([s, -c, 0.0]), np.array([0.0, 0.0, 1.0]), np.array([-c, -s, 0.0])
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = right, up, back, (0.0, 0.0, 1.0)
    return CameraData(kind="perspective", transform=tuple(matrix.ravel()), window=(-1.0, 1.0, -1.0, 0.5))


@pytest.mark.parametrize("persistence", [True, False])
def test_persistence(persistence):
    """Find the old probes again when the camera turns away and back, unless they are not to be kept."""
    b = bench(1.0, view=turned(0.0), settings=settings(persistence=persistence))
    for _ in range(12):
        b.frame()
    before = set(b.probes.tiles.probe.numpy()) - {-1}
    born = b.probes.pool.born.numpy()
    for _ in range(8):
        b.frame(turned(np.pi))
    assert not before & (set(b.probes.tiles.probe.numpy()) - {-1})
    b.frame(turned(0.0))
    after = [p for p in b.probes.tiles.probe.numpy() if p in before and b.probes.pool.born.numpy()[p] == born[p]]
    assert len(after) > 0.9 * len(before) if persistence else not after


def test_empty_tiles_come_first():
    """Cover the whole picture soon after a cut; a sky in most tiles gives its rays to the others."""
    b = bench(1.0, view=turned(0.0))
    b.frame()
    stats = b.probes.stats()
    assert stats["patched"] > 0
    for _ in range(3):
        b.frame()
    tiles = b.probes.tiles
    seeds, probes = tiles.seed.numpy(), tiles.probe.numpy()
    assert (probes[seeds >= 0] >= 0).mean() > 0.95


def test_all_slots_are_owned_once():
    """Never give two tiles or two updates the same slot, and update every spawn tile that shows a surface."""
    b = bench(1.0, view=turned(0.0))
    for i in range(40):
        b.frame(turned(0.05 * i))
        slots = b.probes.updates.slot.numpy()
        slots = slots[slots >= 0]
        assert len(np.unique(slots)) == len(slots)
        probes = b.probes.tiles.probe.numpy()
        probes = probes[probes >= 0]
        assert len(np.unique(probes)) == len(probes)


def test_light_switched_off():
    """Forget the light at once when told of its end, and soon when not."""
    b = bench(1.0)
    for _ in range(100):
        b.frame()
    b.lighting.sky = 0.0
    b.record()
    for i in range(6):
        b.frame(lit=i == 0)
    assert b.irradiance()[0].max() == 0.0
    b.lighting.sky = 1.0
    b.record()
    for i in range(100):
        b.frame(lit=i == 0)
    np.testing.assert_allclose(b.irradiance()[0], 1.0, rtol=0.01)
    b.lighting.sky = 0.3
    b.record()
    for _ in range(8):
        b.frame(moved=True)
    np.testing.assert_allclose(b.irradiance()[0], 0.3, rtol=0.05)


def test_outdated_probes_step_back():
    """Show next to nothing of the old light two frames after its end, when half of the probes still hold it."""
    b = bench(1.0)
    for _ in range(40):
        b.frame()
    b.lighting.sky = 0.0
    b.record()
    for i in range(2):
        b.frame(lit=i == 0)
    assert b.irradiance()[0].mean() < 0.05


def test_first_frames_are_forgotten():
    """Reach back over half of the frames since the start, so that light that took frames to spread is not held down."""
    b = bench(0.0)
    for i in range(64):
        b.lighting.sky = 1.0 - 0.8 ** (i + 1)
        b.record()
        b.frame()
    # A plain mean over the 16 updates would give 0.9.
    assert b.irradiance()[0].mean() > 0.98
    assert b.probes.pool.count.numpy().max() <= 1 + 64 / 8


def test_long_means_stay_exact():
    """Drift nowhere in thousands of updates of half-floats."""
    b = bench(0.7003, size=(16, 16))
    for _ in range(2500):
        b.frame()
    np.testing.assert_allclose(b.irradiance()[0], 0.7003, rtol=0.002)


def test_restart_forgets_everything():
    """Start with no probes after a cut."""
    b = bench(1.0)
    for _ in range(8):
        b.frame()
    b.lighting.sky = 0.25
    b.record()
    b.tracker.restart()
    b.frame()
    stats = b.probes.stats()
    assert stats["live"] == stats["updated"] == stats["spawned"]
    np.testing.assert_allclose(b.irradiance()[0].max(), 0.25, rtol=0.01)


def test_slots_keep_nothing_of_probes_before():
    """Give the same bits whatever the slots of new probes held before: on both sides of a thin wall."""
    wall = scenes.mesh([[0.05, -50, 0], [0.05, 50, 0], [0.05, 50, 1], [0.05, -50, 1]], [[0, 1, 2], [0, 2, 3]])
    found = []
    for before in (0, 50000):
        b = ProbeBench({"floor": scenes.quad(50.0), "wall": wall}, [0.0, 1.0], camera(), (96, 96), settings=SETTINGS)
        for array in arrays_of(b.probes.pool):
            array.fill_(0 if array is b.probes.pool.used or array is b.probes.pool.updates else before)
        for _ in range(3):
            b.frame()
            found.append([b.probes.updates.neighbor.numpy().copy(), b.result.numpy().view(np.uint16).copy()])
    for k in range(6):
        np.testing.assert_array_equal(found[k % 3][k // 3], found[3 + k % 3][k // 3])


def test_broken_rays_do_no_harm():
    """Keep NaN out of the probes."""
    b = bench(1.0)
    b.lighting.broken = 1
    b.record()
    for _ in range(10):
        b.frame()
    assert np.isfinite(b.irradiance()[0]).all()
    assert np.isfinite(b.probes.pool.radiance.numpy().astype(np.float32)).all()


def test_runs_repeat():
    """Give the same numbers in every run."""
    pictures = []
    for _ in range(2):
        b = corner((48, 48))
        for i in range(20):
            b.frame(camera(half=0.5 + 0.01 * (i % 5)))
        pictures.append(b.result.numpy().view(np.uint16))
    np.testing.assert_array_equal(pictures[0], pictures[1])


def test_moving_camera_keeps_the_light():
    """Stay within a few per cent of the truth while the camera flies along the wall."""
    b = corner()
    errors = []
    for i in range(40):
        window = np.array([-0.5, 0.5, -0.5, 0.5]) / 3.0
        b.frame(CameraData(kind="perspective", transform=tuple(scenes.place(y=0.03 * i, z=3.0).ravel()),
                           window=tuple(window)))
        light, _ = b.irradiance()
        floor = b.hits() == 0
        x = np.broadcast_to((np.arange(96) + 0.5) / 96 - 0.5, floor.shape)
        errors.append(light[floor].mean() / wall_light(x[floor]).mean() - 1)
    assert np.abs(errors[8:]).max() < 0.04


@pytest.mark.parametrize("name", sorted(ScreenProbePass.debug_views))
def test_debug_views_show_something(name):
    """Draw every debug view without NaN and not all black."""
    b = bench(1.0, settings=settings(contact_detail=True))
    picture = wp.zeros(SIZE[0] * SIZE[1], dtype=wp.vec4, device=b.device)
    b.probes.record_debug(b.graph, 0, name, picture)
    for _ in range(8):
        b.frame(moved=True)
    values = picture.numpy()
    assert np.isfinite(values).all()
    assert values[:, :3].max() > 0.0
