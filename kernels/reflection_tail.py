# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that follows the few reflection rays still under way after some segments to their ends.

A launch takes at least as long as its longest ray, so a launch for each segment and kernel costs more than threads that
wait for each other.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .decided_layers import meet_layers
from .environment_split import EnvironmentSplit
from .intersect import closest_hit, closest_layer
from .layers_lean import filter_path
from .paths import ENDED, Paths, load_hit, store_hit, take_layer
from .reflection_chain import last_of
from .reflection_lamps import add_lamps
from .reflection_lean import follow_one
from .reflection_rays import LEFT, ReflectionRays
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


# Who decides which layers stop a ray: the lean machine, which knows all of them, or the ray itself.
TAIL_LAYERS = wp.constant(1)
TAIL_LAYERS_DECIDED = wp.constant(2)


@wp.func
def trace_segment(
    scene: Scene, reflection: int, filtered: int, rays: ReflectionRays, paths: Paths, vertices: Vertices, slot: int,
):
    """Find what a segment meets; `filtered`: TAIL_LAYERS* where there are transparent layers."""
    store_hit(paths, slot, closest_hit(
        scene.geometry, paths.origin[slot], paths.direction[slot], paths.t[slot]))
    if filtered == TAIL_LAYERS_DECIDED:
        meet_layers(scene.geometry, paths, slot)
    elif filtered == TAIL_LAYERS:
        take_layer(paths, slot, closest_layer(
            scene.geometry, paths.origin[slot], paths.direction[slot], load_hit(paths, slot).t))
        filter_path(scene, paths, slot)
    if scene.lights.lamp_count > 0:
        add_lamps(scene, reflection, rays, paths, vertices, slot)


@wp.kernel(cuda_max_registers=168)
def follow_tail(
    # In:
    scene: Scene,
    split: EnvironmentSplit,
    world: wp.array[wp.vec3],
    reflection: int,
    segments: int,
    filtered: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Trace and take in all segments that are left of listed rays; see follow_lean and follow_full.

    Rays stop at what the lean machine can't run, noted as LEFT.

    Args:
        scene: The scene.
        split: Of the world.
        world: Its radiance by texels where that is known (DeviceScene.world_texels).
        reflection: REFLECTED, REFRACTED or GATHERED.
        segments: Most of a ray, those before included.
        filtered: TAIL_LAYERS* where there are triangles that need a test, else 0.
        stride: Number of threads.
        count: Number of rays.
        queue: Their slots.
        rays_out: The rays.
        paths_out: Theirs.
        vertices_out: Theirs.
    """
    i = wp.tid()
    slot = int(-1)
    # Threads that are done with a ray take the next while others of their warp are on their way.
    while slot >= 0 or i < count[0]:
        if slot < 0:
            slot = queue[i]
            i = i + stride
            if paths_out.state[slot] == ENDED:
                slot = int(-1)
        if slot >= 0:
            trace_segment(scene, reflection, filtered, rays_out, paths_out, vertices_out, slot)
            last = last_of(paths_out.state[slot], segments)
            follow_one(scene, split, world, reflection, last, rays_out, paths_out, vertices_out, slot)
            if paths_out.state[slot] == ENDED or vertices_out.reflectance[slot][3] == LEFT:
                slot = int(-1)
