# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that adds the lamps that reflection rays meet; recorded for scenes that have lamps."""

from __future__ import annotations

import warp as wp

from .cache_materials import sane
from .cache_rays import Vertices
from .geometry_math import max_component
from .intersect import MISS
from .lamp_hit import FAR
from .light_linking import receives_at
from .paths import ENDED, Paths
from .reflection_lights import lamps_along
from .reflection_rays import ReflectionRays, clear_length, first_density, gather, shared_with_samples
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def add_lamps(
    scene: Scene, reflection: int, rays: ReflectionRays, paths: Paths, vertices: Vertices, slot: int,
):
    """Add the lamps along a ray's segment."""
    if paths.state[slot] == ENDED:
        return
    density = first_density(reflection, paths, slot)
    if density < 0.0:
        return
    t_max = paths.t[slot]
    if paths.hit[slot][0] == MISS:
        t_max = FAR
    light = wp.vec3(0.0, 0.0, 0.0)
    before = clear_length(paths, vertices, slot)
    origin = paths.origin[slot] - paths.direction[slot] * before
    t = t_max + before
    sign = float(1.0)
    # What lies before the glass has been counted.
    while t > 0.0:
        light = light + sign * lamps_along(
            scene.lights, paths.kind[slot], receives_at(scene, 1, paths, slot), density,
            shared_with_samples(rays, paths, slot), origin, paths.direction[slot], t)
        t = wp.where(sign > 0.0, before, 0.0)
        sign = -1.0
    if max_component(light) > 0.0:
        gather(vertices, slot, sane(wp.cw_mul(paths.throughput[slot], light)), 0.0)


@wp.kernel(cuda_max_registers=64)
def meet_lamps(
    # In:
    scene: Scene,
    reflection: int,
    rays: ReflectionRays,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Add the lamps along the segments of listed rays, traced already; `reflection` as of follow_full."""
    i = wp.tid()
    while i < count[0]:
        add_lamps(scene, reflection, rays, paths_out, vertices_out, queue[i])
        i = i + stride
