# SPDX-License-Identifier: GPL-3.0-or-later
"""The reference path tracer's shading of hits on hair that scatters light (hair_lobes.py).

Scenes with such hair launch this file's kernel before those of other surfaces, which shade what it leaves.
"""

from __future__ import annotations

import warp as wp

from .hair_exit import leaving_point
from .hair_lobes import HairLobes, evaluate_hair, hair_lobes, sample_hair
from .lamp_hit import FAR
from .lamp_sample import no_light
from .light_choice import chosen_light, consider
from .light_linking import kinds_lit, note_receiver
from .lights import class_total, sample_light_of
from .list_order import first_listed
from .path_shading import (
    LIGHT_CANDIDATES,
    aim_shadow_ray,
    begin_choice,
    begin_hit,
    candidate_place,
    continue_path,
    is_held_out,
    weighed_light,
)
from .paths import ENDED, Options, Paths, has_hit, hit_point
from .sampling import (
    DIMENSION_BSDF,
    DIMENSION_FIRST_BOUNCE,
    DIMENSION_LIGHT,
    DIMENSION_LIGHT_CHOICE,
    DIMENSION_LOBE,
    DIMENSION_RESAMPLE,
    DIMENSIONS_PER_BOUNCE,
    sample_number,
    sample_pair,
)
from .types import CLOSURE_HAIR, Bsdf, Closure, FrameData, Scene, ShadingPoint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def surface_of_hair(closure: Closure, point: ShadingPoint) -> Bsdf:
    """Return what paths ask of any surface's BSDF: what it emits, its normals, and that light passes through."""
    bsdf = Bsdf()
    bsdf.geometric_normal = point.geometric_normal
    bsdf.smooth_normal = point.normal
    bsdf.normal = point.normal
    bsdf.specular_normal = point.normal
    bsdf.emission = closure.emission
    bsdf.gain = wp.max(wp.max(closure.weight[0], wp.max(closure.weight[1], closure.weight[2])), 1.0)
    bsdf.pick_glass = 1.0
    return bsdf


@wp.func
def light_hair(scene: Scene, point: ShadingPoint, lobes: HairLobes, paths: Paths, path: int):
    """Sample one light from all around, as path_shading.sample_direct_light does."""
    seed = paths.seed[path]
    index = paths.index[path]
    dimension = DIMENSION_FIRST_BOUNCE + point.ray_depth * DIMENSIONS_PER_BOUNCE
    refill = sample_number(seed, index, dimension + DIMENSION_LIGHT_CHOICE)
    place = sample_pair(seed, index, dimension + DIMENSION_LIGHT)
    everywhere = wp.vec3(0.0, 0.0, 0.0)
    throughput = paths.throughput[path]
    choice = begin_choice(place, sample_number(seed, index, dimension + DIMENSION_RESAMPLE))
    kept = no_light()
    classes = class_total(scene.lights, everywhere)
    k = int(0)
    while k < LIGHT_CANDIDATES:
        u = candidate_place(place, float(k), LIGHT_CANDIDATES)
        s = sample_light_of(scene, classes, point.position, everywhere, u, refill)
        here = wp.vec3(0.0, 0.0, 0.0)
        if s.kind >= 0:
            s.visibility = kinds_lit(scene, s.visibility, point.instance)
            here = wp.cw_mul(throughput, weighed_light(point, evaluate_hair(lobes, s.wi), s))
        choice = consider(choice, here, wp.dot(here, scene.luminance) * s.brightness)
        if choice.keeps_last == 1:
            kept = s
        k = k + 1
    if kept.kind >= 0 and wp.isfinite(choice.total):
        light = chosen_light(choice, LIGHT_CANDIDATES)
        aim_shadow_ray(scene, point.position, point.position, kept, light, paths, path)


@wp.func
def leave_hair(scene: Scene, point: ShadingPoint, paths: Paths, path: int):
    """Move the start of the path's next ray, and of its shadow ray, to where they leave the strand."""
    k = int(0)
    while k < 2:
        # One place, so that the query's code exists once.
        wi = paths.direction[path]
        asked = paths.state[path] != ENDED
        if k == 1:
            wi = paths.shadow_direction[path]
            asked = paths.shadow_distance[path] != 0.0
        if asked:
            origin = leaving_point(scene, point, wi)
            if k == 0:
                paths.origin[path] = origin
            else:
                paths.shadow_origin[path] = origin
                distance = paths.shadow_distance[path]
                if wp.abs(distance) < FAR:
                    # The sign says whether the light casts shadows.
                    left = wp.max(wp.abs(distance) - wp.dot(origin - point.position, wi), 0.0)
                    paths.shadow_distance[path] = wp.where(distance < 0.0, -left, left)
        k = k + 1


@wp.func
def shade_hair(frame: FrameData, scene: Scene, options: Options, point: ShadingPoint, paths: Paths, path: int):
    """Shade a hit as path_shading.shade_hit does."""
    closure = paths.closure[path]
    bsdf = surface_of_hair(closure, point)
    if not begin_hit(frame, scene, options, point, bsdf, paths, path):
        return
    lobes = hair_lobes(closure, point)
    if scene.lights.class_count > 0:
        light_hair(scene, point, lobes, paths, path)
    dimension = DIMENSION_FIRST_BOUNCE + point.ray_depth * DIMENSIONS_PER_BOUNCE
    u = sample_pair(paths.seed[path], paths.index[path], dimension + DIMENSION_BSDF)
    choice = sample_number(paths.seed[path], paths.index[path], dimension + DIMENSION_LOBE)
    note_receiver(scene, point.instance, paths, path)
    continue_path(scene, point, bsdf, sample_hair(lobes, u, choice), paths, path)
    leave_hair(scene, point, paths, path)


@wp.kernel
def shade_hair_paths(
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
    others_out: wp.array[int],
    other_count_out: wp.array[int],
):
    """Shade listed hits on hair, whose closures are known, and list the paths that go on; list other hits too."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            if paths_out.closure[path].kind != CLOSURE_HAIR:
                others_out[wp.atomic_add(other_count_out, 0, 1)] = path
            else:
                point = hit_point(scene, paths_out, path, paths_out.state[path])
                paths_out.state[path] = ENDED
                if not is_held_out(scene, point, paths_out, path):
                    shade_hair(frames[0], scene, options, point, paths_out, path)
                    if paths_out.state[path] != ENDED:
                        queue_out[wp.atomic_add(count_out, 0, 1)] = path
