# SPDX-License-Identifier: GPL-3.0-or-later
"""What guides the final denoiser: albedo and normal of the first surface that is no mirror, and the mix of pictures.

Paths of the reference integrator note them as they are shaded (path_guides.py). For a picture without such paths these
kernels follow some to their first hit, and on through what reflects or refracts sharply. Nothing is lit, so that few
samples are free of noise but at edges and behind veils.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import is_finite3, max_component
from .intersect import MISS, offset_origin
from .lamp_hit import FAR
from .layering import prepare_bsdf
from .light_linking import note_receiver
from .packing import rgb
from .path_guides import GUIDE_MIRRORS, is_sharp, tells_little
from .paths import ENDED, Paths, has_hit, hit_point
from .principled import sample_bsdf
from .reflectance import bsdf_albedo, whole_albedo
from .sampling import (
    DIMENSION_BSDF,
    DIMENSION_FIRST_BOUNCE,
    DIMENSION_LOBE,
    DIMENSIONS_PER_BOUNCE,
    sample_number,
    sample_pair,
)
from .types import HOLDOUT, Bsdf, BsdfSample, Scene, ShadingPoint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def go_on(point: ShadingPoint, sample: BsdfSample, tint: wp.vec3, paths: Paths, path: int):
    """Set up the next ray."""
    paths.state[path] = point.ray_depth + 1
    paths.throughput[path] = wp.cw_mul(tint, sample.weight)
    paths.origin[path] = offset_origin(point.position, point.geometric_normal, point.error, sample.wi)
    paths.direction[path] = sample.wi
    paths.t[path] = FAR
    # The world counts in full: no light is sampled here.
    paths.pdf[path] = 0.0
    paths.kind[path] = sample.kind
    paths.cone[path] = wp.vec2(point.footprint, paths.cone[path][1])


@wp.func
def show(albedo: wp.vec3, normal: wp.vec3, paths: Paths, path: int):
    """End a path at what it shows: `radiance` becomes that's albedo, `shadow_light` its normal."""
    paths.state[path] = ENDED
    paths.radiance[path] = wp.vec4(albedo[0], albedo[1], albedo[2], 1.0)
    paths.shadow_light[path] = normal


@wp.func
def meet_guide(
    scene: Scene, exposure: float, point: ShadingPoint, bsdf: Bsdf, paths: Paths, path: int,
):
    """End a path at a surface, or send it on if that is a mirror. Of what shines the light is the albedo, at most 1."""
    bounce = point.ray_depth
    none = wp.vec3(0.0, 0.0, 0.0)
    if bounce == 0 and (scene.geometry.instances[point.instance].visibility & HOLDOUT) != 0:
        show(none, none, paths, path)
        return
    tint = paths.throughput[path]
    parts = bsdf_albedo(scene.tables, bsdf, point.wo)
    albedo = whole_albedo(parts)
    if bounce < GUIDE_MIRRORS and tells_little(bsdf, parts):
        dimension = DIMENSION_FIRST_BOUNCE + bounce * DIMENSIONS_PER_BOUNCE
        choice = sample_number(paths.seed[path], paths.index[path], dimension + DIMENSION_LOBE)
        u = sample_pair(paths.seed[path], paths.index[path], dimension + DIMENSION_BSDF)
        sample = sample_bsdf(bsdf, point.wo, wp.vec3(u[0], u[1], choice))
        usable = sample.pdf > 0.0 and is_finite3(sample.weight) and max_component(sample.weight) > 0.0
        if usable and is_sharp(sample):
            note_receiver(scene, point.instance, paths, path)
            go_on(point, sample, tint, paths, path)
            return
    show(wp.cw_mul(tint, albedo + bsdf.emission * exposure), bsdf.normal, paths, path)


@wp.kernel
def show_misses(
    # In:
    exposure: float,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Show the world, which shade_misses has put into `radiance`, where paths have left the scene."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if paths_out.hit[path][0] == MISS:
            show(rgb(paths_out.radiance[path]) * exposure, wp.vec3(0.0, 0.0, 0.0), paths_out, path)


@wp.kernel
def find_surfaces(
    # In:
    scene: Scene,
    exposure: float,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Take in listed hits whose closures are known, see meet_guide."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            point = hit_point(scene, paths_out, path, paths_out.state[path])
            bsdf = prepare_bsdf(scene.tables, paths_out.closure[path], point)
            meet_guide(scene, exposure, point, bsdf, paths_out, path)


@wp.kernel
def average_guides(
    # In:
    paths: Paths,
    first_pixel: int,
    pixel_count: int,
    sample_count: int,
    share: float,
    # Out:
    albedo_out: wp.array[wp.vec3],
    normal_out: wp.array[wp.vec3],
):
    """Add the guides of each pixel's paths, each by its share in the mean."""
    local = wp.tid()
    albedo = wp.vec3(0.0, 0.0, 0.0)
    normal = wp.vec3(0.0, 0.0, 0.0)
    sample = int(0)
    while sample < sample_count:
        path = sample * pixel_count + local
        a = rgb(paths.radiance[path])
        n = paths.shadow_light[path]
        if is_finite3(a):
            albedo += shares_of_light(a)
        if is_finite3(n):
            normal += n
        sample += 1
    albedo_out[first_pixel + local] = albedo_out[first_pixel + local] + albedo * share
    normal_out[first_pixel + local] = normal_out[first_pixel + local] + normal * share


@wp.func
def shares_of_light(albedo: wp.vec3) -> wp.vec3:
    """Return an albedo as the denoiser takes it, 0..1: of what shines it is the light."""
    return wp.vec3(wp.clamp(albedo[0], 0.0, 1.0), wp.clamp(albedo[1], 0.0, 1.0), wp.clamp(albedo[2], 0.0, 1.0))


@wp.kernel
def begin_guides(
    # Out:
    paths_out: Paths,
):
    """Let paths that start be guides to the first that they meet."""
    path = wp.tid()
    paths_out.guide_albedo[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    paths_out.guide_normal[path] = wp.vec3(0.0, 0.0, 0.0)


@wp.kernel
def add_guides(
    # In:
    first_pixel: int,
    pixel_count: int,
    sample_count: int,
    # Out:
    paths_out: Paths,
    albedo_out: wp.array[wp.vec4],
    normal_out: wp.array[wp.vec3],
):
    """Add what each pixel's paths have shown to the sums, whose fourth number counts; they are no guides any more."""
    local = wp.tid()
    pixel = first_pixel + local
    albedo = albedo_out[pixel]
    normal = normal_out[pixel]
    sample = int(0)
    while sample < sample_count:
        path = sample * pixel_count + local
        a = rgb(paths_out.guide_albedo[path])
        n = paths_out.guide_normal[path]
        if is_finite3(a) and is_finite3(n):
            a = shares_of_light(a)
            albedo += wp.vec4(a[0], a[1], a[2], 1.0)
            normal += n
        paths_out.guide_albedo[path] = wp.vec4(0.0, 0.0, 0.0, -1.0)
        sample += 1
    albedo_out[pixel] = albedo
    normal_out[pixel] = normal


@wp.kernel
def mean_guides(
    # In:
    albedo: wp.array[wp.vec4],
    normal: wp.array[wp.vec3],
    # Out:
    albedo_out: wp.array[wp.vec3],
    normal_out: wp.array[wp.vec3],
):
    """Divide the sums of add_guides by their number."""
    pixel = wp.tid()
    share = 1.0 / wp.max(albedo[pixel][3], 1.0)
    albedo_out[pixel] = rgb(albedo[pixel]) * share
    normal_out[pixel] = normal[pixel] * share


@wp.kernel
def mix_pictures(
    first: int,
    # In:
    denoised: wp.array[wp.vec4],
    picture: wp.array[wp.vec4],
    share: float,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Mix a share of the denoised picture with another, whose alpha stays; a pixel that is not finite is left out."""
    pixel = first + wp.tid()
    d = rgb(denoised[pixel])
    p = picture[pixel]
    c = rgb(p)
    if is_finite3(d):
        c = wp.lerp(c, d, share)
    picture_out[pixel] = wp.vec4(c[0], c[1], c[2], p[3])
