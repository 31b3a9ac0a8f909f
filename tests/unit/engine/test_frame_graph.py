# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of recorded frames: branches that run side by side touch nothing that another changes."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from burnish.engine.device_scene import DeviceScene
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.motion import MotionTracker
from burnish.engine.passes.cache_buffers import VERTEX_ARRAYS
from burnish.engine.passes.cache_spreading import LightPhase
from burnish.engine.passes.gbuffer import GBufferPass
from burnish.engine.scene import LightKind
from burnish.engine.session import Session
from burnish.engine.settings import CacheSettings, Integrator, PerformanceSettings, SamplingSettings
from burnish.engine.view_data import ViewTracker
from burnish.kernels import compaction
from burnish.kernels.cache_rays import Vertices
from burnish.kernels.hash_grid import HashGrid
from burnish.kernels.paths import ENDED, Paths

from tests import scenes
from tests.device import DEVICE


def room():
    """Make a room with all that has passes of its own: a mirror, glass, layers, an emitter, a lamp, a world."""
    materials = {
        "white": scenes.material(color=0.7), "mirror": scenes.material("PRINCIPLED", metallic=1.0, roughness=0.1),
        "glass": scenes.material("GLASS", color=1.0, roughness=0.0, ior=1.5), "leaf": scenes.transparent(0.5),
        "light": scenes.emitter(5.0)}
    places = [("floor", scenes.place(), "white"), ("ball", scenes.place(x=0.5, z=0.4), "mirror"),
              ("ball", scenes.place(x=-0.5, z=0.4), "glass"), ("leaf", scenes.place(z=1.0), "leaf"),
              ("leaf", scenes.place(x=1.0, z=1.5), "light")]
    meshes = {"floor": scenes.quad(3.0), "ball": scenes.sphere(0.3, 8), "leaf": scenes.quad(0.2)}
    made = scenes.delta(
        meshes, places, materials, [scenes.lamp(LightKind.POINT, 50.0, scenes.place(1.0, 1.0, 2.0), radius=0.2)], 0.2)
    return made


def addresses(values, slots=None):
    """Return the memory that arrays, structs of arrays and structs in them hold: (first byte, last).

    `slots`: as of a step, which touches a part of some arrays; that from 0 on has no bounce rays. States of paths have
    arrays of one element where a pass has no use for them. Of a grid's homes no frame writes anything.
    """
    found = set()
    for value in values:
        if isinstance(value, wp.array):
            if value.ptr and value.capacity:
                each = wp.types.type_size_in_bytes(value.dtype)
                first, count, _ = slots if slots and len(value) == slots[2] else (0, value.size, 0)
                found.add((value.ptr + first * each, value.ptr + (first + count) * each))
        elif hasattr(value, "_cls"):
            probes = value._cls is Vertices and slots and slots[0] == 0
            names = VERTEX_ARRAYS if probes else value._cls.vars
            members = [getattr(value, name) for name in names if value._cls is not HashGrid or name != "homes"]
            if value._cls is Paths:
                members = [array for array in members if array is not None and len(array) > 1]
            found |= addresses(members, slots)
        elif isinstance(value, list | tuple):
            found |= addresses(value, slots)
    return found


CELL_KERNELS = {
    "insert_vertices", "accumulate_light", "choose_cache_lights", "choose_reflection_lights", "choose_glossy_lights",
    "start_bounces", "gather_bounces", "follow_near_hits", "balance_bounces", "find_beyond", "list_cells",
    "spread_cells", "spread_light", "mark_sources", "continue_bounces"}
"""They make cells and add to their sums by atomics, or read what none of them changes in a cell that was there.

Those that spread light have the sums and counts of indirect light for themselves: other branches add direct light. The
last two have the marks for themselves.
"""

CELL_READERS = {
    "insert_vertices", "choose_cache_lights", "choose_reflection_lights", "choose_glossy_lights", "follow_near_hits",
    "gather_bounces", "balance_bounces"}
"""They make cells or look at their light, and may find it as it was before `update_cells` or after."""


def may_share_cells(a, b):
    """Return whether two kernels may use the radiance cache's cells side by side."""
    return {a, b} <= CELL_KERNELS | {"resolve_rays", "resolve_reflections", "resolve_glossy_reflections"} or (
        "update_cells" in (a, b) and not CELL_READERS.isdisjoint({a, b}))


LISTED_PIXELS = {
    "append_veiled", "trace_veils", "see_through", "filter_primary_lean", "shade_lean_listed", "append_full",
    "shade_primary", "shade_exact_primary"}
"""They read and write pixels that shade_lean leaves out; append_full reads what it does not change"""

DRAWING = {"raster_triangles", "raster_blocks", "raster_tiles"}
"""They find what pixels show, which resolve_hits reads; beside it they only note pixels behind veils"""

LAMP_READERS = {"compose", "add_contact"}
"""They look at what add_lamps writes: light that lamps emit, and which pixels show one"""


def may_share_pixels(a, b):
    """Return whether two kernels may work on pixels side by side, as they touch others or other bits of them."""
    if "add_lamps" in (a, b):
        return LAMP_READERS.isdisjoint({a, b})
    if "resolve_hits" in (a, b):
        return not DRAWING.isdisjoint({a, b})
    return "shade_lean" in (a, b) and not LISTED_PIXELS.isdisjoint({a, b})


def overlap(a, b):
    """Return whether two sets of memory have a byte in common."""
    return any(low < end and start < high for low, high in a for start, end in b)


def races(graph, cells=frozenset(), surfaces=frozenset()):
    """Return the pairs of kernels of which one changes what the other touches though neither waits for the other.

    Also returns how many pairs may run side by side. `cells`: memory that CELL_KERNELS may share, `surfaces`: that
    kernels may share that work on other pixels.
    """
    before = {"": set()}
    done, found, beside = [], [], 0
    for step in graph._steps:
        if step.after is not None:
            before[step.branch] = before.get(step.branch, set()) | before[step.after]
            continue
        reads, writes = addresses(step.reads, step.slots), addresses(step.writes, step.slots)
        for index, (kernel, other_reads, other_writes) in enumerate(done):
            if index not in before[step.branch]:
                beside += 1
                shared = cells if may_share_cells(kernel, step.kernel) else frozenset()
                if may_share_pixels(kernel, step.kernel):
                    shared = surfaces
                both = "add_lamps" in (kernel, step.kernel) and overlap(writes, other_writes)
                if both or overlap(writes - shared, other_reads | other_writes) or overlap(
                        reads - shared, other_writes):
                    found.append((kernel, step.kernel))
        before[step.branch].add(len(done))
        done.append((step.kernel, reads, writes))
    return found, beside


@pytest.mark.slow
def test_branches_do_not_race():
    """Record frames in motion and at rest with every pass, and unseen ones: what runs side by side is independent."""
    settings = replace(
        scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=14))
    made = Session(settings)
    made.update(room())
    made.configure(settings, scenes.camera_above(3.0, 1.5, orthographic=False), 24, 16)
    made.step(4)
    pipeline, views = made._realtime.pipeline, made._realtime.views
    motion = pipeline.motion.advance(made._scene)
    cells = frozenset(addresses([pipeline.cache.grid, pipeline.cache.control]))
    seen = pipeline.gbuffer
    surfaces = frozenset(addresses([seen.current(0), seen.hits] + ([seen.raster.seen] if seen.raster else [])))
    for (resting, unseen), phase in itertools.product(((False, False), (True, False), (False, True)), LightPhase):
        graph, *_ = pipeline._record(0, resting, phase, unseen, made._scene, views.array, motion)
        sections = {step.section for step in graph._steps}
        assert "Cache cells" in sections
        assert unseen or {"Reflection denoising", "Refraction denoising", "Direct denoising"} <= sections
        found, beside = races(graph, cells, surfaces)
        assert not found, (resting, unseen, phase, sorted(set(found)))
        assert beside > (20 if unseen else 500)


@pytest.mark.parametrize("lean", [True, False])
def test_drawn_pixels_do_not_race(lean):
    """Record visible surfaces that are drawn, with layers for the lean node machine or for the full one."""
    scene, views = DeviceScene(DEVICE), ViewTracker(DEVICE)
    scene.apply(room(), PerformanceSettings())
    made, graph = GBufferPass(DEVICE, rasterizing=True), FrameGraph(DEVICE)
    made.resize(24, 16)
    made.record(graph, 0, scene.scene, scene.structures, views.array, filtered=True, lean_layers=lean)
    made.record_reprojection(graph, 0, scene.scene, views.array, MotionTracker(DEVICE).advance(scene))
    found, beside = races(graph, surfaces=frozenset(addresses([made.current(0), made.hits, made.raster.seen])))
    assert not found
    assert beside > 0
    kernels = {kernel for _, kernel in graph.launch_list()}
    assert {"trace_veils", "shade_primary", "add_lamps"} <= kernels
    assert ("shade_lean_listed" in kernels) == lean


def test_races_are_found():
    """Change an array on two branches, with and without waiting in between."""
    state, queue = wp.zeros(8, dtype=int, device=DEVICE), wp.zeros(8, dtype=int, device=DEVICE)

    def record(join):
        graph = FrameGraph(DEVICE)
        with graph.branch("a"):
            graph.clear(state)
        if join:
            graph.join("a")
        with graph.branch("b"):
            graph.launch(compaction.append_living, 8, [state, queue], [queue, queue], banded=False)
        graph.join("a", "b")
        graph.clear(state)
        return graph

    assert races(record(join=False))[0] == [("clear", "append_living")]
    assert races(record(join=True))[0] == []


def test_branches_replay_in_order():
    """Change an array between two branches that read it: each sees its own version, in every replay."""
    source = wp.array(np.arange(8, dtype=np.int32), dtype=int, device=DEVICE)
    state, queue, more = (wp.zeros(8, dtype=int, device=DEVICE) for _ in range(3))
    counts = [wp.zeros(1, dtype=int, device=DEVICE) for _ in range(2)]
    graph = FrameGraph(DEVICE)
    graph.clear(state, *counts)
    with graph.branch("a"):
        graph.launch(compaction.append_living, 8, [state, source], [queue, counts[0]], banded=False)
    graph.join("a")
    graph.call(lambda: state.fill_(int(ENDED)))
    with graph.branch("b"):
        graph.launch(compaction.append_living, 8, [state, source], [more, counts[1]], banded=False)
    for timed in (False, True, False):
        graph.replay(timed)
        assert [int(count.numpy()[0]) for count in counts] == [8, 0]
        assert sorted(queue.numpy()) == list(range(8))
