# SPDX-License-Identifier: GPL-3.0-or-later
"""Test that a frame's bits do not depend on threads: on how many there are on the processor, on which comes first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from burnish.engine import device as device_module
from burnish.engine.passes.cache_spreading import LightPhase
from burnish.engine.scene import SceneDelta
from burnish.engine.session import Session
from burnish.engine.setting_changes import Change, change_since
from burnish.engine.settings import (
    CacheSettings,
    Device,
    Integrator,
    PerformanceSettings,
    SamplingSettings,
)
from burnish.kernels.cache_claim import claim_key, settle_cells
from burnish.kernels.hash_grid import BUCKET, HashGrid

from tests import scenes
from tests.glossy_scenes import glass, metal
from tests.thread_order import backwards, lists
from tests.unit.kernels.test_hash_grid import make_grid

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SIZE = (64, 64)
FRAMES = 8
REALTIME = replace(scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(
    capacity=12, cell_pixels=16.0, lifetime=3))
"""A small cache with short-lived cells: buckets fill up, and cells come and go"""


def room(shift=0.0):
    """Make a room with a lamp, things of metal, glass and thin cloth, and a box that may be shifted."""
    meshes = {"room": scenes.box(2.0, inward=True), "box": scenes.box(0.3), "ball": scenes.sphere(0.4, 12),
              "cloth": scenes.quad(0.5)}
    materials = {"white": scenes.material(color=0.7), "red": scenes.material(color=(0.7, 0.1, 0.1)),
                 "metal": metal(0.15), "glass": glass(), "cloth": scenes.transparent(0.5, color=0.6)}
    objects = [("room", scenes.place(), "white"), ("box", scenes.place(x=shift, z=-1.7), "red"),
               ("ball", scenes.place(0.8, 0.3, -1.6), "metal"), ("ball", scenes.place(-0.8, -0.3, -1.6), "glass"),
               ("cloth", scenes.place(0.2, 0.9, -1.0), "cloth")]
    lamps = [scenes.lamp("POINT", 40.0, scenes.place(0.5, 0.5, 1.6), radius=0.1)]
    return scenes.delta(meshes, objects, materials, lamps)


def camera(x):
    """Make a camera under the ceiling, looking down."""
    made = scenes.camera_above(1.8, 1.6, orthographic=False)
    transform = np.array(made.transform).reshape(4, 4)
    transform[0, 3] = x
    return replace(made, transform=tuple(transform.ravel()))


def fly(settings, frames=FRAMES):
    """Render frames with a moving camera and a moving box, and two at rest; returns the last of each."""
    made = Session(settings)
    made.update(room())
    pictures = []
    for frame in range(frames):
        made.configure(settings, camera(0.04 * frame), *SIZE)
        made.update(SceneDelta(instances=room(0.03 * frame).instances))
        made.step(1)
    pictures.append(made.read())
    made.step(2)
    pictures.append(made.read())
    return np.stack(pictures)


def with_option(deterministic, settings=REALTIME):
    """Return settings with the option on or off."""
    return replace(settings, performance=PerformanceSettings(deterministic=deterministic))


@pytest.mark.parametrize("integrator", [Integrator.REALTIME, Integrator.REFERENCE])
def test_any_number_of_threads_gives_the_same_bits(monkeypatch, integrator):
    """Render in motion and at rest with one, two and three threads on the processor."""
    settings = replace(REALTIME, device=Device.CPU, sampling=SamplingSettings(integrator=integrator))
    pictures = []
    for threads in (1, 2, 3):
        for module in ("device", "frame_graph"):
            monkeypatch.setattr(f"burnish.engine.{module}.thread_count", lambda count=threads: count)
        monkeypatch.setattr(device_module, "_pool", None)
        pictures.append(fly(settings))
        if device_module._pool is not None:
            assert device_module._pool._max_workers == threads > 1
            device_module._pool.shutdown()
    assert pictures[0][..., :3].mean() > 0.01
    np.testing.assert_array_equal(pictures[1], pictures[0])
    np.testing.assert_array_equal(pictures[2], pictures[0])


@pytest.fixture
def racing(device, monkeypatch):
    """Let the option do on the processor, where the order of threads can be chosen, what it does on CUDA."""
    if device != "cpu":
        pytest.skip("the order of threads is chosen on the processor")
    monkeypatch.setattr("burnish.engine.passes.radiance_cache.threads_race", lambda _: True)


@pytest.mark.slow
@pytest.mark.usefixtures("racing")
def test_order_of_threads_does_not_matter_with_the_option():
    """Get the same bits when all threads run in another order; without the option only nearly."""
    differences = {}
    for deterministic in (True, False):
        settings = with_option(deterministic)
        forwards = fly(settings)
        with backwards() as used:
            other = fly(settings)
        assert {"insert_vertices", "accumulate_light", "purge_cells", "claim_tiles", "list_rays"} <= set(used)
        assert ("claim_vertices" in used) == ("settle_cells" in used) == deterministic
        differences[deterministic] = np.abs(other - forwards)[..., :3].mean() / forwards[..., :3].mean()
    print(f"mean relative difference without the option: {differences[False]:.2e}")
    assert differences[True] == 0.0
    assert 0.0 < differences[False] < 0.2


@pytest.mark.slow
@pytest.mark.usefixtures("racing")
def test_order_of_lists_does_not_matter():
    """Get the same bits with lists of what needs work, as on CUDA, in any order, as without them."""
    settings = with_option(True)
    plain = fly(settings, 4)
    with lists():
        np.testing.assert_array_equal(fly(settings, 4), plain)
        with backwards() as used:
            np.testing.assert_array_equal(fly(settings, 4), plain)
    assert {"append_living", "append_layered_pixels"} <= set(used)


def test_option_costs_nothing_on_the_processor():
    """Launch no more kernels with the option where it is of no use."""
    launches = {}
    for deterministic in (True, False):
        settings = with_option(deterministic, replace(REALTIME, device=Device.CPU))
        made = Session(settings)
        made.update(room())
        made.configure(settings, camera(0.0), *SIZE)
        made.step(1)
        graph = made._realtime.pipeline._graphs[0, False, LightPhase.SWEEPING, False][0]
        launches[deterministic] = [step.kernel for step in graph._steps]
    assert len(launches[True]) > 40
    assert launches[True] == launches[False]


@wp.kernel
def claim_keys(
    # In:
    keys: wp.array[wp.int64],
    # Out:
    grid_out: HashGrid,
):
    """Claim a slot for each key."""
    claim_key(grid_out, keys[wp.tid()])


@pytest.mark.parametrize("scan_all", [1, 0])
def test_claims_do_not_depend_on_their_order(device, scan_all):
    """Deal each key one slot in any order, the greatest first, and leave old cells where they are."""
    rng = np.random.default_rng(1)
    grids = []
    old = rng.integers(1, 1 << 62, 150)
    new = np.concatenate([rng.integers(1, 1 << 62, 700), old[::3]])
    new = np.concatenate([new, new[::2]])
    for order in (np.arange(len(new)), np.arange(len(new))[::-1], rng.permutation(len(new))):
        grid = make_grid(device, capacity=512, scan_all=scan_all)
        for keys in (old, new[order]):
            wp.launch(claim_keys, len(keys), [wp.array(keys, dtype=wp.int64, device=device)], [grid], device=device)
            if keys is not old:
                claims = grid.keys.numpy().reshape(-1, int(BUCKET))
                assert (claims < 0).any() and (claims > 0).any()
                # The claims of a bucket lie in order.
                assert all((np.diff(bucket[bucket < 0]) > 0).all() for bucket in claims)
            wp.launch(settle_cells, 512, [], [grid], device=device)
            if keys is old:
                # Holes among the cells.
                kept = grid.keys.numpy()
                gone = (rng := np.random.default_rng(2)).random(512) < 0.4
                kept[gone] = 0
                grid.keys.assign(kept)
                grid.live.assign([np.count_nonzero(kept)])
        keys = grid.keys.numpy()
        np.testing.assert_array_equal(keys[kept != 0], kept[kept != 0])
        assert (keys > 0).all() == (np.count_nonzero(keys) == 512) and grid.live.numpy()[0] == np.count_nonzero(keys)
        grids.append(keys)
    found = grids[0][grids[0] != 0]
    if scan_all:
        assert len(np.unique(found)) == len(found)
    assert np.isin(found, np.concatenate([old, new])).all()
    assert not np.isin(new, found).all(), "some bucket must be full"
    np.testing.assert_array_equal(grids[1], grids[0])
    np.testing.assert_array_equal(grids[2], grids[0])


def test_option_starts_anew():
    """Restart the samples when the option changes, since its cells lie elsewhere."""
    assert change_since(with_option(True), with_option(False)) == Change.RESTART
