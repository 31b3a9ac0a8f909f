# SPDX-License-Identifier: GPL-3.0-or-later
"""The reference path tracer's shading where light is scattered below surfaces: where paths go in and come out.

In scenes with such materials this file's first kernel stands in for that of reference.py: a path may go below the
surface instead of being reflected. subsurface_walk.py takes it on, and the second kernel lights it where it comes out,
as a white diffuse surface, in the same round: that is still the same bounce, as in Cycles.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import is_finite3, max_component
from .layering import prepare_bsdf, unit_normal
from .light_linking import note_receiver
from .list_order import first_listed
from .normals import valid_specular_normal
from .path_shading import begin_hit, continue_path, is_held_out, light_hit
from .paths import ENDED, LONG_PATH, Options, Paths, has_hit, hit_point
from .principled import sample_bsdf
from .sampling import (
    DIMENSION_BSDF,
    DIMENSION_FIRST_BOUNCE,
    DIMENSION_LOBE,
    DIMENSIONS_PER_BOUNCE,
    sample_number,
    sample_pair,
)
from .subsurface import WithoutSubsurface, without_subsurface
from .types import Bsdf, FrameData, Scene, ShadingPoint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def go_below(split: WithoutSubsurface, bounce: int, paths: Paths, path: int) -> bool:
    """Weigh a path that goes below the surface, and end it; return whether it carries any light."""
    weight = split.weight / split.odds
    if bounce >= LONG_PATH:
        weight = weight / split.bsdf.gain
    paths.throughput[path] = wp.cw_mul(paths.throughput[path], weight)
    return is_finite3(paths.throughput[path]) and max_component(paths.throughput[path]) > 0.0


@wp.func
def shade_scattering(
    frame: FrameData, scene: Scene, options: Options, point: ShadingPoint, split: WithoutSubsurface, paths: Paths,
    path: int,
) -> bool:
    """Shade a hit as path_shading.shade_hit does; return whether the path has gone below the surface instead."""
    bounce = point.ray_depth
    bsdf = split.bsdf
    if not begin_hit(frame, scene, options, point, bsdf, paths, path):
        return False
    light_hit(scene, point, bsdf, paths, path)
    dimension = DIMENSION_FIRST_BOUNCE + bounce * DIMENSIONS_PER_BOUNCE
    u = sample_pair(paths.seed[path], paths.index[path], dimension + DIMENSION_BSDF)
    if u[0] < split.odds:
        return go_below(split, bounce, paths, path)
    choice = sample_number(paths.seed[path], paths.index[path], dimension + DIMENSION_LOBE)
    # The odds that are left sum to what is left of the number's range.
    sample = sample_bsdf(bsdf, point.wo, wp.vec3(u[0] - split.odds, u[1], choice))
    note_receiver(scene, point.instance, paths, path)
    continue_path(scene, point, bsdf, sample, paths, path)
    return False


@wp.kernel
def shade_scattering_paths(
    # In:
    frames: wp.array[FrameData],
    scene: Scene,
    options: Options,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    queue_out: wp.array[int],
    count_out: wp.array[int],
    below_out: wp.array[int],
    below_count_out: wp.array[int],
):
    """Shade listed hits whose closures are known and list the paths that go on; list those that go below too."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            point = hit_point(scene, paths_out, path, paths_out.state[path])
            paths_out.state[path] = ENDED
            if not is_held_out(scene, point, paths_out, path):
                bsdf = prepare_bsdf(scene.tables, paths_out.closure[path], point)
                split = without_subsurface(bsdf, paths_out.closure[path])
                if shade_scattering(frames[0], scene, options, point, split, paths_out, path):
                    below_out[wp.atomic_add(below_count_out, 0, 1)] = path
                elif paths_out.state[path] != ENDED:
                    queue_out[wp.atomic_add(count_out, 0, 1)] = path


@wp.func
def white_diffuse(point: ShadingPoint, normal: wp.vec3) -> Bsdf:
    """Return the BSDF with which light comes out."""
    bsdf = Bsdf()
    bsdf.geometric_normal = point.geometric_normal
    bsdf.smooth_normal = point.normal
    bsdf.normal = normal
    bsdf.specular_normal = normal
    bsdf.diffuse = wp.vec3(1.0, 1.0, 1.0)
    bsdf.gain = 1.0
    bsdf.pick_diffuse = 1.0
    return bsdf


@wp.kernel
def shade_exits(
    # In:
    scene: Scene,
    bumped: int,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Light the listed paths where they come out of surfaces, and list those that go on.

    `bumped` 1: their closures are those of where they come out, whose normals count. `bounces`: how many surfaces the
    paths have met before, one element.
    """
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        bounce = bounces[0]
        point = hit_point(scene, paths_out, path, bounce)
        paths_out.state[path] = ENDED
        normal = point.normal
        if bumped == 1:
            bent = unit_normal(paths_out.closure[path].normal, normal)
            normal = valid_specular_normal(point.geometric_normal, point.wo, bent)
        bsdf = white_diffuse(point, normal)
        light_hit(scene, point, bsdf, paths_out, path)
        dimension = DIMENSION_FIRST_BOUNCE + bounce * DIMENSIONS_PER_BOUNCE
        u = sample_pair(paths_out.seed[path], paths_out.index[path], dimension + DIMENSION_BSDF)
        note_receiver(scene, point.instance, paths_out, path)
        continue_path(scene, point, bsdf, sample_bsdf(bsdf, point.wo, wp.vec3(u[0], u[1], 0.0)), paths_out, path)
        if paths_out.state[path] != ENDED:
            queue_out[wp.atomic_add(count_out, 0, 1)] = path
