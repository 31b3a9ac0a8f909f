# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the lists of rays that meet layers, the lean kernels that work them off, and rays in flat scenes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine.device_scene import DeviceScene
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.passes.cache_buffers import LAYER_ARRAYS, RAY_ARRAYS, UNUSED_ARRAYS
from burnish.engine.shadow_rays import make_options
from burnish.engine.structures import is_flat
from burnish.engine.work_list import LISTED_THREADS, ONCE, make_queue, make_work_list, one_number
from burnish.kernels import (
    compaction,
    flat_paths,
    flat_tracing,
    layers,
    layers_lean,
    reflection_trace,
    shadow_layers,
    shadow_layers_lean,
    tracing,
)
from burnish.kernels.intersect import MISS
from burnish.kernels.paths import Paths
from burnish.kernels.types import VISIBLE_DIFFUSE

from tests import scenes
from tests.device import DEVICE
from tests.unit.engine.test_lean import row_of_balls, textured

COUNT = 3000
WRITTEN = ("t", "hit", "barycentrics", "throughput", "overruns", "layer", "layer_t")
LIT = ("shadow_distance", "shadow_light", "radiance", "overruns", "layer")


def veils():
    """Make squares of textured layers under each other over a floor, beside nothing."""
    materials = {"leaf": textured(transparent=True), "veil": scenes.transparent(0.6, color=0.5),
                 "grey": scenes.material(color=0.5)}
    delta = row_of_balls(materials)
    heights = {"grey": -0.5, "leaf": 0.2, "veil": 0.5}
    places = [("square", scenes.place(0.1 * i, 0.05 * i, heights[name] + 0.1 * i), name)
              for i, name in enumerate(("grey", "leaf", "veil", "leaf", "veil"))]
    return dataclasses.replace(scenes.delta(delta.meshes, places, materials), images=delta.images)


def make_paths(device, distance=9.0):
    """Return rays that fall from above, and shadow rays alike; every seventh has none of both."""
    rng = np.random.default_rng(2)
    paths = Paths()
    for arrays, size in ((RAY_ARRAYS, COUNT), (LAYER_ARRAYS, COUNT), (UNUSED_ARRAYS, 1)):
        for name, dtype in arrays.items():
            setattr(paths, name, wp.zeros(size, dtype=dtype, device=device))
    origin = np.stack([*rng.uniform(-1, 1, (2, COUNT)), np.full(COUNT, 3.0)], -1).astype(np.float32)
    direction = rng.normal(0, 0.1, (COUNT, 3)) + [0.0, 0.0, -1.0]
    direction = (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)
    idle = np.arange(COUNT) % 7 == 0
    for prefix in ("", "shadow_"):
        getattr(paths, prefix + "origin").assign(origin)
        getattr(paths, prefix + "direction").assign(direction)
    paths.state.assign(np.where(idle, -1, 1).astype(np.int32))
    paths.t.fill_(distance)
    paths.shadow_distance.assign(np.where(idle, 0.0, distance).astype(np.float32))
    paths.shadow_light.fill_(wp.vec3(1.0, 2.0, 3.0))
    paths.throughput.fill_(wp.vec3(1.0, 1.0, 1.0))
    paths.kind.fill_(int(VISIBLE_DIFFUSE))
    paths.seed.assign(rng.integers(0, 1 << 31, COUNT, np.uint32))
    return paths


def every(queue):
    """Return what tells kernels to work on all of a queue, a thread for each."""
    return ONCE, one_number(len(queue), queue.device), queue


def values(paths, names):
    """Return copies of arrays."""
    return {name: getattr(paths, name).numpy().copy() for name in names}


def assert_same(a, b):
    """Compare arrays exactly; on a processor but for roundings, which kernels of their own may do elsewhere there."""
    rounded = DEVICE == "cpu"
    for name in a:
        if rounded and np.issubdtype(a[name].dtype, np.floating):
            np.testing.assert_allclose(a[name], b[name], rtol=5e-5, atol=1e-7, err_msg=name)
        else:
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)


@pytest.fixture(scope="module")
def scene():
    """Make a scene of layers."""
    made = DeviceScene(DEVICE)
    made.apply(veils(), scenes.SETTINGS.performance)
    assert made.structures.has_filtered and made.material_table.lean.transparency and is_flat(made.scene)
    return made


def run_listed(device, append, inputs, kernel, before, paths, listed):
    """Run a kernel over a list: as frames do it on this device, or (`listed`) as on CUDA, with fewer threads."""
    work = make_work_list(COUNT, device)
    graph = FrameGraph(device)
    if listed:
        work.count.zero_()
        wp.launch(append, COUNT, inputs, [work.queue, work.count], device=device, block_dim=64)
        found = int(work.count.numpy()[0])
        wp.launch(kernel, 128, [*before, 128, work.count, work.queue], [paths], device=device, block_dim=64)
        return found
    graph.fill_list(append, COUNT, inputs, work)
    graph.launch_listed(kernel, before, work, [paths])
    graph.replay()
    return int(work.count.numpy()[0])


@pytest.mark.parametrize("listed", [False, True])
def test_rays_pass_layers_alike(scene, listed):
    """Stop at the same layers with the lean machine over a list as with the full one over all rays."""
    device, full, lean = scene.device, make_paths(scene.device), make_paths(scene.device)
    queue = make_queue(COUNT, device)
    for paths in (full, lean):
        wp.launch(tracing.trace_paths, COUNT, [scene.scene, *every(queue)], [paths], device=device, block_dim=64)
        wp.launch(tracing.trace_layers, COUNT, [scene.scene, *every(queue)], [paths], device=device, block_dim=64)
    met = (full.layer.numpy()[:, 0] != int(MISS)) & (full.state.numpy() >= 0)
    wp.launch(layers.filter_paths, COUNT, [scene.scene, *every(queue)], [full], device=device, block_dim=64)
    found = run_listed(device, compaction.append_layered_paths, [lean, 0], layers_lean.filter_paths_lean,
                       [scene.scene], lean, listed)
    assert 0.1 < met.mean() < 0.6 and found == (COUNT if not listed and device == "cpu" else met.sum())
    stopped = (full.hit.numpy() == full.layer.numpy()).all(1)[met].mean()
    assert 0.2 < stopped < 0.95
    assert_same(values(full, WRITTEN), values(lean, WRITTEN))


@pytest.mark.parametrize("listed", [False, True])
def test_shadow_rays_pass_layers_alike(scene, listed):
    """Weaken shadow rays alike with both machines."""
    device, queue, options = scene.device, make_queue(COUNT, scene.device), make_options(filtered=True)
    full, lean = make_paths(device, 2.75), make_paths(device, 2.75)
    for paths in (full, lean):
        wp.launch(tracing.trace_shadow_layers, COUNT, [scene.scene, options, one_number(1, device), *every(queue)],
                  [paths], device=device, block_dim=64)
    before = [scene.scene, options, one_number(1, device)]
    met = (full.layer.numpy()[:, 0] != int(MISS)) & (full.shadow_distance.numpy() != 0)
    wp.launch(shadow_layers.weaken_shadow_rays, COUNT, [*before, *every(queue)], [full], device=device, block_dim=64)
    found = run_listed(device, compaction.append_layered_shadows, [lean, 0], shadow_layers_lean.weaken_shadow_rays_lean,
                       before, lean, listed)
    assert 0.1 < met.mean() < 0.6 and found == (COUNT if not listed and device == "cpu" else met.sum())
    light = full.radiance.numpy()[:, 0]
    assert ((light[met] > 0.0) & (light[met] < 1.0)).mean() > 0.9
    assert_same(values(full, LIT), values(lean, LIT))


def test_flat_rays_find_the_same(scene):
    """Trace in a flat scene with the kernels that know no second level as with those that do."""
    device, queue, options = scene.device, make_queue(COUNT, scene.device), make_options(filtered=True)
    both, flat = make_paths(device), make_paths(device)
    all_of = scene.scene
    for kernel, inputs, paths in (
            (tracing.trace_paths, [all_of, *every(queue)], both), (flat_tracing.trace_flat_rays, [0, all_of, 0], flat),
            (tracing.trace_layers, [all_of, *every(queue)], both),
            (flat_tracing.trace_flat_layers, [0, all_of, 0], flat)):
        wp.launch(kernel, COUNT, inputs, [paths], device=device, block_dim=64)
    alive = both.state.numpy() >= 0
    one, other = (values(paths, WRITTEN) for paths in (both, flat))
    assert 0.1 < (one["hit"][alive, 0] >= 0).mean() < 0.9
    assert_same({name: one[name][alive] for name in one}, {name: other[name][alive] for name in other})
    work, queue_of_half = make_work_list(COUNT, device), np.flatnonzero(alive)[::2].astype(np.int32)
    work.queue[: len(queue_of_half)].assign(queue_of_half)
    work.count.assign([len(queue_of_half)])
    for kernel in (reflection_trace.trace_further, flat_tracing.trace_flat_further):
        further = make_paths(device)
        wp.launch(kernel, 128, [all_of, 1, 128, work.count, work.queue], [further], device=device, block_dim=64)
        other = values(further, WRITTEN)
        assert_same({name: one[name][queue_of_half] for name in one},
                    {name: other[name][queue_of_half] for name in other})
    for kernel, inputs, paths in (
            (tracing.trace_shadows, [all_of, options, one_number(1, device), *every(queue)], both),
            (flat_tracing.trace_flat_shadows, [0, all_of], flat),
            (tracing.trace_shadow_layers, [all_of, options, one_number(1, device), *every(queue)], both),
            (flat_tracing.trace_flat_shadow_layers, [all_of, options, one_number(1, device), *every(queue)], flat)):
        wp.launch(kernel, COUNT, inputs, [paths], device=device, block_dim=64)
    assert_same(values(both, LIT), values(flat, LIT))
    assert (both.shadow_distance.numpy() == 0).mean() > 0.3


def test_flat_paths_find_the_same(scene):
    """Trace paths in a flat scene with the kernels that know no second level as with those that do."""
    device, options = scene.device, make_options(filtered=True)
    queue = every(make_queue(COUNT, device))
    shadows = [scene.scene, options, one_number(1, device), *queue]
    both, flat, work = make_paths(device), make_paths(device), make_work_list(COUNT, device)
    for kernel, inputs in ((tracing.trace_paths, [scene.scene, *queue]), (tracing.trace_layers, [scene.scene, *queue]),
                           (tracing.trace_shadows, shadows), (tracing.trace_shadow_layers, shadows)):
        wp.launch(kernel, COUNT, inputs, [both], device=device, block_dim=64)
    for kernel, inputs, standing in ((flat_paths.trace_flat_paths, [scene.scene, 1, *queue], "state"),
                                     (flat_paths.trace_flat_path_shadows, shadows, "shadow_distance")):
        work.count.zero_()
        wp.launch(kernel, COUNT, inputs, [flat, work.queue, work.count], device=device, block_dim=64)
        alive = getattr(flat, standing).numpy()
        alive = alive >= 0 if standing == "state" else alive != 0
        met = flat.layer.numpy()[:, 0] != int(MISS)
        listed = np.sort(work.queue.numpy()[: int(work.count.numpy()[0])])
        assert 0.1 < met.mean() and (listed == np.flatnonzero(met & alive)).all()
    assert 0.1 < (both.hit.numpy()[both.state.numpy() >= 0, 0] >= 0).mean() < 0.9
    assert_same(values(both, WRITTEN), values(flat, WRITTEN))
    assert_same(values(both, LIT), values(flat, LIT))


def test_lists_hold_all_on_the_processor():
    """Give bands of elements to the processor's threads, each element once."""
    work = make_work_list(LISTED_THREADS, "cpu")
    assert (work.part(5, 9).queue.numpy() == np.arange(5, 14)).all() and len(work.queue) == LISTED_THREADS
