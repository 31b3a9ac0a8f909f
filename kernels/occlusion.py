# SPDX-License-Identifier: GPL-3.0-or-later
"""The Ambient Occlusion pass: a ray from each first hit, whose light arrives where nothing near stands in its way.

As Cycles has it (kernel/integrator/shade_surface.h, integrate_surface_ao): about the normal of the diffuse part of the
surface, with the cosine's density, weighed by what reaches the surface and its alpha. The path tracer's kernels find
the hits and trace the rays as shadow rays, transparent things included.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import clamp3, is_finite3, to_frame
from .intersect import offset_origin
from .light_linking import note_blockers
from .packing import rgb
from .paths import ENDED, PENDING_NONE, Paths, has_hit, hit_point
from .sampling import DIMENSION_BSDF, DIMENSION_FIRST_BOUNCE, sample_cosine, sample_pair
from .types import (
    CLOSURE_DIFFUSE,
    CLOSURE_PRINCIPLED,
    CLOSURE_SHEEN,
    CLOSURE_TRANSLUCENT,
    HOLDOUT,
    Closure,
    Scene,
    ShadingPoint,
)

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# A ray of length 0 would be none.
SHORTEST = wp.constant(1.0e-20)


@wp.func
def diffuse_normal(closure: Closure, point: ShadingPoint) -> wp.vec3:
    """Return the normal of the diffuse part of a surface, that of the surface where there is none."""
    kind = closure.kind
    principled = kind == CLOSURE_PRINCIPLED and closure.metallic < 1.0 and closure.transmission < 1.0
    if principled or kind == CLOSURE_DIFFUSE or kind == CLOSURE_TRANSLUCENT or kind == CLOSURE_SHEEN:
        return closure.normal
    return point.normal


@wp.func
def aim(scene: Scene, distance: float, paths: Paths, path: int):
    """Set up the ray of a hit whose closure is known."""
    point = hit_point(scene, paths, path, 0)
    if (scene.geometry.instances[point.instance].visibility & HOLDOUT) != 0:
        return
    closure = paths.closure[path]
    alpha = clamp3(wp.vec3(1.0, 1.0, 1.0) - closure.transparency)
    u = sample_pair(paths.seed[path], paths.index[path], DIMENSION_FIRST_BOUNCE + DIMENSION_BSDF)
    direction = to_frame(diffuse_normal(closure, point), sample_cosine(u))
    paths.shadow_origin[path] = offset_origin(point.position, point.geometric_normal, point.error, direction)
    paths.shadow_direction[path] = direction
    paths.shadow_distance[path] = wp.max(distance, SHORTEST)
    paths.shadow_light[path] = wp.cw_mul(paths.throughput[path], alpha)
    paths.shadow_pending[path] = PENDING_NONE
    note_blockers(scene, 0, paths, path)


@wp.kernel
def aim_occlusion_rays(
    # In:
    scene: Scene,
    distance: float,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """End all listed paths, those that have hit something with a shadow ray of a length [m]; forget their light."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        paths_out.radiance[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
        paths_out.shadow_distance[path] = 0.0
        if has_hit(paths_out, path):
            aim(scene, distance, paths_out, path)
        paths_out.state[path] = ENDED


@wp.kernel
def average_occlusion(
    # In:
    paths: Paths,
    first_pixel: int,
    pixel_count: int,
    sample_count: int,
    # Out:
    light_out: wp.array[wp.vec3],
):
    """Add what the rays of each pixel's paths have brought."""
    local = wp.tid()
    light = wp.vec3(0.0, 0.0, 0.0)
    sample = int(0)
    while sample < sample_count:
        found = rgb(paths.radiance[sample * pixel_count + local])
        if is_finite3(found):
            light += found
        sample += 1
    light_out[first_pixel + local] = light_out[first_pixel + local] + light
