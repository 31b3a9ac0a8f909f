# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the radiance cache as a whole: its light against closed forms and the path tracer, edits, overload, bad input.

The rays are cast by the tests, from inside rooms or from a camera; no probes are needed.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine.debug_views import DEBUG_VIEWS
from burnish.engine.device_scene import DeviceScene
from burnish.engine.frame_data import frame_row
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.passes.radiance_cache import RadianceCachePass, smallest_cell
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import WorldData
from burnish.engine.settings import CacheKey, CacheSettings, PerformanceSettings
from burnish.engine.view_data import ViewTracker
from burnish.kernels.gbuffer import GBuffer
from burnish.kernels.hash_grid import SCREEN_LINES
from burnish.kernels.probe_rays import MISS_DISTANCE, ProbeRays

from tests import scenes

RAY_ARRAYS = {"origin": wp.vec3, "direction": wp.vec3, "t_max": float, "probe": int, "radiance": wp.vec4}

LINES = 64


class Rig:
    """A scene, a cache, a camera, and rays to ask with."""

    def __init__(self, delta, device, count=2048, camera=None, minimum=0.12, seed=0, texels=False, **settings):
        settings.setdefault("capacity", 14)
        # Asked for in pixels of this picture.
        pixels = settings.pop("cell_pixels", 32.0)
        settings["cell_pixels"] = pixels * (float(SCREEN_LINES) / LINES) ** 0.5
        self.scene = DeviceScene(device)
        self.scene.apply(delta, PerformanceSettings())
        self.settings = CacheSettings(**settings)
        self.cache = RadianceCachePass(device, self.settings)
        self.cache.resize(8, 8)
        self.views = ViewTracker(device)
        camera = camera or scenes.camera_above(height=0.5, half=0.3, orthographic=False)
        self.row = frame_row(camera, LINES, LINES, (0, 0, LINES, LINES), 0, self.scene.origin)
        self.rays, self.count, self.minimum = ProbeRays(), count, minimum
        for name, dtype in RAY_ARRAYS.items():
            setattr(self.rays, name, wp.zeros(count, dtype=dtype, device=device))
        self.rng = np.random.default_rng(seed)
        self.texels = texels
        self.record()

    def record(self):
        """Record both frames; needed again after the scene's arrays have changed."""
        self.graphs = []
        for parity in (0, 1):
            graph = FrameGraph(self.cache.device)
            self.cache.record(
                graph, parity, self.scene.scene, self.views.array, self.rays, self.count, minimum_cell=self.minimum,
                filtered=self.scene.structures.has_filtered, programs=self.programs,
                lean_layers=self.scene.material_table.lean.transparency,
                world=self.scene.world_texels if self.texels else None)
            self.graphs.append(graph)

    @property
    def programs(self):
        """Return whether lights may be programs for the cache."""
        return self.scene.has_hit_programs if self.texels else self.scene.has_light_programs

    def frame(self, origin, direction, t_max=1e18, lit=False, moved=False):
        """Render a frame and return the answers, [count, 4]."""
        self.views.advance(
            self.row, moved=moved, lit=lit, exposure=1.0, transparent=False, filter_quantiles=None)
        self.rays.origin.assign(np.asarray(origin, np.float32))
        self.rays.direction.assign(np.asarray(direction, np.float32))
        self.rays.t_max.assign(np.broadcast_to(np.float32(t_max), self.count).astype(np.float32))
        self.graphs[self.views.parity].replay()
        return self.rays.radiance.numpy().copy()

    def room_rays(self, size=0.9):
        """Return rays from anywhere in a room into all directions."""
        direction = self.rng.normal(size=(self.count, 3))
        return (self.rng.uniform(-size, size, (self.count, 3)),
                direction / np.linalg.norm(direction, axis=1, keepdims=True))

    def camera_rays(self, camera):
        """Return rays through random points of a camera's picture, and the points in 0..1."""
        place = self.rng.random((self.count, 2))
        left, right, bottom, top = camera.window
        local = np.stack([left + (right - left) * place[:, 0], bottom + (top - bottom) * place[:, 1],
                          np.full(self.count, -1.0)], -1)
        matrix = np.reshape(camera.transform, (4, 4))
        direction = local @ matrix[:3, :3].T
        origin = np.tile(matrix[:3, 3], (self.count, 1))
        return origin, direction / np.linalg.norm(direction, axis=1, keepdims=True), place

    def mean_of(self, frames, channel=slice(0, 3)):
        """Return the mean answer of so many frames in a room."""
        return float(np.mean([self.frame(*self.room_rays())[:, channel].mean() for _ in range(frames)]))


def furnace(albedo):
    """Make a closed box that emits 1 and reflects `albedo`."""
    return scenes.delta({"box": scenes.box(1.0, inward=True)}, [("box", np.eye(4), "wall")],
                        {"wall": scenes.emitter(1.0, albedo)})


def lit_room(albedo=0.7, strength=20.0):
    """Make a closed room with a lamp under its ceiling and a block on its floor."""
    lamp = scenes.lamp("AREA", strength, scenes.place(z=0.95), shape="SQUARE", size_x=0.5, size_y=0.5)
    return scenes.delta(
        {"box": scenes.box(1.0, inward=True), "block": scenes.box(0.25)},
        [("box", np.eye(4), "wall"), ("block", scenes.place(x=0.4, z=-0.75), "red")],
        {"wall": scenes.material(color=albedo), "red": scenes.material(color=(0.6, 0.2, 0.1))}, [lamp])


@pytest.mark.parametrize("albedo", [*(pytest.param(a, marks=pytest.mark.slow) for a in (0.5, 0.8)), 0.9])
def test_furnace(device, albedo):
    """Find albedo / (1 - albedo) reflected everywhere in a box that emits 1, within 1 %, soon and for good."""
    rig = Rig(furnace(albedo), device)
    expected = albedo / (1 - albedo)
    rig.mean_of(24)
    np.testing.assert_allclose(rig.mean_of(16), expected, rtol=0.01)
    rig.mean_of(100)
    np.testing.assert_allclose(rig.mean_of(32), expected, rtol=0.01)


@pytest.mark.parametrize(("bounces", "path_bounces"), [
    (1, 1), (2, 2), pytest.param(0, 0, marks=pytest.mark.slow)])
def test_bounces_match_the_path_tracer(device, bounces, path_bounces):
    """See the path tracer's picture of a room with one, two and all bounces: whole, and its quarters."""
    camera = scenes.camera_above(height=0.7, half=0.5, orthographic=False)
    camera = dataclasses.replace(camera, window=(-0.6, 0.6, -0.6, 0.6))
    reference = scenes.render(lit_room(), camera, (16, 16), 512, max_bounces=path_bounces)[..., :3]
    rig = Rig(lit_room(), device, camera=camera, minimum=0.03, bounces=bounces, cell_pixels=4.0)
    total, hits = np.zeros((2, 2, 3)), np.zeros((2, 2, 1))
    for index in range(160):
        origin, direction, place = rig.camera_rays(camera)
        answer = rig.frame(origin, direction)
        if index >= 40:
            x, y = (place * 2).astype(int).T
            np.add.at(total, (y, x), answer[:, :3])
            np.add.at(hits, (y, x), 1.0)
    expected = reference.reshape(2, 8, 2, 8, 3).mean((1, 3))
    np.testing.assert_allclose((total / hits).mean(), expected.mean(), rtol=0.015)
    np.testing.assert_allclose(total / hits, expected, rtol=0.05)


def test_light_goes_off_and_on(device):
    """Keep at most 2 % of the light 12 frames after the lamp went out, and have 95 % of it 12 frames after it is on."""
    rig = Rig(lit_room(), device, count=3072)
    rig.mean_of(60)
    steady = rig.mean_of(20)
    for strength, low, high in ((0.0, 0.0, 0.02), (20.0, 0.95, 1.05)):
        delta = dataclasses.replace(
            lit_room(strength=strength), full=False, meshes={}, instances=None, materials={}, world=None)
        rig.scene.apply(delta, PerformanceSettings())
        rig.record()
        rig.frame(*rig.room_rays(), lit=True)
        rig.mean_of(10)
        assert low <= rig.mean_of(4) / steady <= high


def test_white_sky_over_a_floor(device):
    """Light a floor under a white sky by albedo, and let rays that miss bring the sky itself, limited where asked."""
    delta = scenes.delta({"floor": scenes.quad(2.0)}, [("floor", np.eye(4), "grey")],
                         {"grey": scenes.material(color=0.5)}, background=2.0)
    rig = Rig(delta, device, count=512)
    origin = np.tile([0.0, 0.0, 1.0], (512, 1))
    up = np.arange(512) % 2 == 0
    direction = np.where(up[:, None], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0])
    answers = np.mean([rig.frame(origin + rig.rng.uniform(-1, 1, (512, 3)) * [1, 1, 0], direction)
                       for _ in range(40)], 0)
    np.testing.assert_allclose(answers[up], [[2.0, 2.0, 2.0, float(MISS_DISTANCE)]] * 256, rtol=1e-5)
    np.testing.assert_allclose(answers[~up, :3].mean(), 1.0, rtol=0.02)
    np.testing.assert_allclose(answers[~up, 3], 1.0, rtol=1e-4)
    rig.graphs = []
    for parity in (0, 1):
        rig.graphs.append(FrameGraph(device))
        rig.cache.record(rig.graphs[-1], parity, rig.scene.scene, rig.views.array, rig.rays, 512, minimum_cell=0.1,
                         threshold=0.25, filtered=False, programs=False)
    np.testing.assert_allclose(rig.frame(origin, direction)[up, :3], 0.25, rtol=1e-5)


def varying_world():
    """Make a world whose radiance is 3 above the horizon and 1 below, as a program."""
    builder = ProgramBuilder()
    above = builder.math("GREATER_THAN", builder.component(builder.input("POSITION"), 2), 0.0)
    builder.emit((1.0, 1.0, 1.0), builder.math("ADD", builder.math("MULTIPLY", above, 2.0), 1.0), 1.0)
    return WorldData(name="varying", program=builder.finish(), importance_resolution=16)


@pytest.mark.parametrize("texels", [True, False])
@pytest.mark.parametrize("sampling", [True, False])
def test_varying_world_over_a_floor(device, sampling, texels):
    """Light a floor from both sides under a world that is a program, whether it is sampled or met by chance.

    The same by the world's texels as by running its program.
    """
    background = dataclasses.replace(varying_world(), sampling=sampling)
    delta = scenes.delta({"floor": scenes.quad(2.0)}, [("floor", np.eye(4), "grey")],
                         {"grey": scenes.material(color=0.5)}, background=background)
    rig = Rig(delta, device, count=512, texels=texels)
    assert rig.programs != texels
    down = np.arange(512) % 2 == 0
    origin = np.where(down[:, None], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0])
    answers = [rig.frame(origin + rig.rng.uniform(-1, 1, (512, 3)) * [1, 1, 0], -origin) for _ in range(60)]
    answers = np.mean(answers[10:], 0)
    np.testing.assert_allclose([answers[down, :3].mean(), answers[~down, :3].mean()], [1.5, 0.5], rtol=0.02)
    missing = rig.frame(origin, origin)
    np.testing.assert_allclose([missing[down, :3].mean(), missing[~down, :3].mean()], [3.0, 1.0], rtol=1e-4)


def test_glass_before_a_wall_dims_it(device):
    """Look at a lit wall through a pane that lets half of the light through: rays and shadow rays both know it."""
    panes = scenes.delta(
        {"floor": scenes.quad(4.0), "pane": scenes.quad(4.0)},
        [("floor", np.eye(4), "white"), ("pane", scenes.place(z=0.5), "pane")],
        {"white": scenes.material(color=0.8), "pane": scenes.transparent(0.5, color=0.0)},
        [scenes.lamp("SUN", 3.0, angle=0.0)])
    rig = Rig(panes, device, count=1024)
    origin = np.tile([0.0, 0.0, 1.0], (1024, 1)) + rig.rng.uniform(-1, 1, (1024, 3)) * [1, 1, 0]
    down = np.tile([0.0, 0.0, -1.0], (1024, 1))
    answers = np.mean([rig.frame(origin, down)[:, :3].mean() for _ in range(30)])
    # Half of the sun reaches the floor, 0.8 / pi of it goes up, and half of that passes the black pane again.
    np.testing.assert_allclose(answers, 3.0 * 0.5 * 0.8 / np.pi * 0.5, rtol=0.03)


def test_leaf_is_lit_from_behind(device):
    """Light a translucent sheet from the side that is not seen."""
    leaf = scenes.delta({"leaf": scenes.quad(2.0)}, [("leaf", np.eye(4), "leaf")],
                        {"leaf": scenes.material("TRANSLUCENT", color=0.6)}, [scenes.lamp("SUN", 2.0, angle=0.0)])
    rig = Rig(leaf, device, count=512)
    origin = np.tile([0.0, 0.0, -1.0], (512, 1)) + rig.rng.uniform(-1, 1, (512, 3)) * [1, 1, 0]
    answers = rig.frame(origin, np.tile([0.0, 0.0, 1.0], (512, 1)))
    np.testing.assert_allclose(answers[:, :3], 2.0 * 0.6 / np.pi, rtol=0.01)


def test_full_table_stays_lit(device):
    """Answer with the hits' own light where there is no room for cells: as bright on the mean, and never black."""
    rig = Rig(lit_room(), device, capacity=10, minimum=0.005, cell_pixels=1.0, bounces=1)
    free = Rig(lit_room(), device, bounces=1)
    crowded = rig.mean_of(40)
    assert rig.cache.stats()["cells failed"] > 500
    np.testing.assert_allclose(crowded, free.mean_of(40), rtol=0.05)


def test_same_light_from_run_to_run(device):
    """Give the very same numbers twice."""
    runs = []
    for _ in range(2):
        rig = Rig(lit_room(), device, count=512)
        runs.append([rig.frame(*rig.room_rays()) for _ in range(6)])
    np.testing.assert_array_equal(runs[0], runs[1])


def test_reset_forgets_everything(device):
    """Start anew after a reset as after construction."""
    rig = Rig(lit_room(), device, count=512)
    first = [rig.frame(*rig.room_rays()) for _ in range(3)]
    rig.cache.reset()
    rig.views.restart()
    rig.rng = np.random.default_rng(0)
    np.testing.assert_array_equal([rig.frame(*rig.room_rays()) for _ in range(3)], first)


def test_idle_slots_and_bad_rays(device):
    """Answer zero in slots without a ray, and keep rays that are not finite out of the cells."""
    rig = Rig(lit_room(), device, count=512)
    origin, direction = rig.room_rays()
    t_max = np.where(np.arange(512) % 4 == 0, 0.0, 1e18)
    origin[1::8] = np.nan
    direction[5::8] = np.inf
    for _ in range(5):
        answers = rig.frame(origin, direction, t_max)
    assert (answers[::4] == 0).all()
    assert np.isfinite(answers).all()
    for name in ("direct", "indirect"):
        assert np.isfinite(getattr(rig.cache.grid, name).numpy()).all()
    assert rig.cache.stats()["rays"] >= 384
    assert answers[2::4, :3].mean() > 0.1


def test_cells_are_freed(device):
    """Free what rays no longer meet: the table holds what the last frames saw."""
    rig = Rig(lit_room(), device, count=512, lifetime=6, bounces=1, minimum=0.05, cell_pixels=1.0)
    for _ in range(8):
        rig.frame(*rig.room_rays())
    crowded = rig.cache.stats()["cells live"]
    for _ in range(20):
        rig.frame(np.zeros((512, 3)), np.tile([0.0, 0.0, -1.0], (512, 1)))
    stats = rig.cache.stats()
    assert crowded > 500 and 1 <= stats["cells live"] <= 2
    assert stats["cells live"] == (rig.cache.grid.keys.numpy() != 0).sum()


def test_published_key_runs(device):
    """Light a room by direction keys too, for study."""
    rig = Rig(lit_room(), device, key=CacheKey.DIRECTION, scan_all=False, level_blend=False, cone_test=False)
    other = Rig(lit_room(), device)
    np.testing.assert_allclose(rig.mean_of(40), other.mean_of(40), rtol=0.2)


def test_counts(device):
    """Count a frame's rays: the probes', a bounce of each until light has spread, then of a share, shadow rays.

    Others go on from where the first frames' have ended: up to 750, and fewer than half of that where cells are wide.
    """
    rig = Rig(lit_room(), device, count=1000)
    rig.frame(*rig.room_rays())
    assert 1010 <= rig.cache.stats()["bounce rays"] <= 1375
    for frames, bounces in ((19, 1000), (30, 300)):
        for _ in range(frames):
            rig.frame(*rig.room_rays())
        stats = rig.cache.stats()
        assert 990 + bounces <= stats["rays"] <= 1000 + bounces
        assert bounces - 10 <= stats["bounce rays"] <= bounces
        assert 0 < stats["shadow rays"] <= stats["rays"] and stats["hits"] == 1000


def test_smallest_cell():
    """Scale the smallest cell with the scene, up to 10 cm, unless it is set."""
    assert smallest_cell(CacheSettings(), 250.0) == pytest.approx(0.1)
    assert smallest_cell(CacheSettings(), 2.5) == pytest.approx(0.01)
    assert smallest_cell(CacheSettings(minimum_cell=0.3), 2.5) == pytest.approx(0.3)


def test_debug_views(device):
    """Draw every view of the cache: cells and levels everywhere, light where there is some, nothing for the world."""
    assert RadianceCachePass.debug_views == {k: v for k, v in DEBUG_VIEWS.items() if k.startswith("cache.")}
    rig = Rig(lit_room(), device, count=512)
    gbuffer = GBuffer()
    for name, dtype in (("hit", wp.vec2i), ("barycentrics", wp.uint32), ("depth", float),
                        ("geometric_normal", wp.uint32), ("normal", wp.uint32), ("diffuse", wp.uint32),
                        ("specular", wp.uint32), ("f0", wp.uint32), ("material", wp.uint32),
                        ("translucent", wp.uint32), ("emission", wp.vec4h)):
        setattr(gbuffer, name, wp.zeros(64, dtype=dtype, device=device))
    depth = np.full(64, 1.5, np.float32)
    depth[:8] = 1e18
    gbuffer.depth.assign(depth)
    up = np.full(64, (32768 | 32768 << 16), np.uint32)
    gbuffer.geometric_normal.assign(up)
    gbuffer.normal.assign(up)
    rig.cache._gbuffer = {0: gbuffer}
    rig.row["width"], rig.row["height"], rig.row["crop_width"], rig.row["crop_height"] = 8, 8, 8, 8
    down = np.tile([0.0, 0.0, -1.0], (512, 1))
    for _ in range(9):
        rig.frame(np.zeros((512, 3)) + rig.rng.uniform(-0.9, 0.9, (512, 3)) * [1, 1, 0], down)
    for name in RadianceCachePass.debug_views:
        graph, picture = FrameGraph(device), wp.zeros(64, dtype=wp.vec4, device=device)
        rig.cache.record_debug(graph, 0, name, picture)
        graph.replay()
        colors = picture.numpy()[:, :3]
        assert (colors[:8] == 0).all()
        assert (colors[8:].max(1) > 0).mean() > 0.9, name
