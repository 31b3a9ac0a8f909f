# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's light passes of the path tracer: a path's light by what its first surface does with it.

Light is added to a path in the order in which it is met: what the camera sees, then what arrives after one scattering,
then all the rest. So the kernels that add it need not know of passes: these keep what a path has gathered between
them, and the film's sums are made of the differences, which add up to the picture however light is clamped. As in
Cycles, direct light is that after one scattering, found by a shadow ray or met by the path itself, and both are shared
among diffuse, glossy and transmission by the first surface's lobes (light_shares.py); transparency is no scattering.
"""

from __future__ import annotations

import warp as wp

from .composite import PASS_GLOSSY, PASS_TRANSMISSION, LightPasses
from .geometry_math import is_finite3
from .intersect import MISS
from .packing import rgb, rgba
from .paths import Options, Paths, clamp_light, has_hit, limit_at

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.struct
class LightSplit:
    """What is kept of each path, one slot a path as in Paths."""

    ray: wp.array[wp.vec4]
    """Direction of the camera's ray, distance to the first hit"""
    throughput: wp.array[wp.vec3]
    """With which it arrives there: less than 1 behind transparent surfaces"""
    diffuse_color: wp.array[wp.vec3]
    """Albedo of the first hit, times that; black where there is none"""
    glossy_color: wp.array[wp.vec3]
    transmission_color: wp.array[wp.vec3]
    lamp_share: wp.array[wp.vec4]
    """Diffuse share of the light that the first hit's shadow ray brings; w = 1 if the rest is glossy, 0 transmission"""
    path_share: wp.array[wp.vec4]
    """The same of what the path meets after the first hit"""
    seen: wp.array[wp.vec3]
    """Light gathered up to the first hit: emission, lamps in view, the world"""
    lamps: wp.array[wp.vec3]
    """With the light of the first hit's shadow ray"""
    direct: wp.array[wp.vec3]
    """With what the second hit emits, or the lamps and the world that are met instead"""


@wp.kernel
def weigh_seen_light(
    # In:
    options: Options,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Make the emission and the world of the first hits what they add to the picture; comes after shading.

    Shading has put in what the surface emits and the world's radiance themselves: veils and clamping are left out
    there, and so are lamps in view, which count as emission.
    """
    i = wp.tid()
    if bounces[0] == 0:
        while i < count[0]:
            path = queue[i]
            i = i + stride
            world = wp.vec3(0.0, 0.0, 0.0)
            if paths_out.hit[path][0] == MISS:
                # A path that has met nothing has still the throughput with which it left.
                arriving = wp.cw_mul(paths_out.throughput[path], paths_out.environment[path])
                if is_finite3(arriving):
                    world = clamp_light(arriving, limit_at(options, 0))
            paths_out.environment[path] = world
            paths_out.surface_emission[path] = rgb(paths_out.radiance[path]) - world


@wp.kernel
def keep_first_hits(
    # In:
    paths: Paths,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    split_out: LightSplit,
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Keep how camera rays arrive at surfaces, and list those that do; comes before shading."""
    i = wp.tid()
    if bounces[0] == 0:
        while i < count[0]:
            path = queue[i]
            i = i + stride
            d = paths.direction[path]
            split_out.ray[path] = wp.vec4(d[0], d[1], d[2], paths.t[path])
            split_out.throughput[path] = paths.throughput[path]
            none = wp.vec3(0.0, 0.0, 0.0)
            split_out.diffuse_color[path] = none
            split_out.glossy_color[path] = none
            split_out.transmission_color[path] = none
            split_out.lamp_share[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
            split_out.path_share[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
            if has_hit(paths, path):
                queue_out[wp.atomic_add(count_out, 0, 1)] = path


@wp.kernel
def keep_met_light(
    # In:
    paths: Paths,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    split_out: LightSplit,
):
    """Keep what paths have gathered when their first and second hits are shaded and no shadow ray of those has come."""
    i = wp.tid()
    if bounces[0] <= 1:
        while i < count[0]:
            path = queue[i]
            i = i + stride
            if bounces[0] == 0:
                split_out.seen[path] = rgb(paths.radiance[path])
            else:
                split_out.direct[path] = rgb(paths.radiance[path])


@wp.kernel
def keep_lamp_light(
    # In:
    paths: Paths,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    split_out: LightSplit,
):
    """Keep what paths have gathered when their first shadow rays have come: all that those that end there get."""
    i = wp.tid()
    if bounces[0] == 0:
        while i < count[0]:
            path = queue[i]
            i = i + stride
            split_out.lamps[path] = rgb(paths.radiance[path])
            split_out.direct[path] = rgb(paths.radiance[path])


@wp.kernel
def keep_exit_light(
    # In:
    paths: Paths,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    split_out: LightSplit,
):
    """Keep what paths have gathered that were scattered below their first surface: light from there is diffuse."""
    i = wp.tid()
    if bounces[0] == 0:
        while i < count[0]:
            path = queue[i]
            i = i + stride
            split_out.direct[path] = rgb(paths.radiance[path])
            split_out.path_share[path] = wp.vec4(1.0, 1.0, 1.0, 1.0)


@wp.kernel
def leave_out_scattered(
    # In:
    paths: Paths,
    scattered: wp.array[int],
    # Out:
    split_out: LightSplit,
):
    """Keep paths that a medium has scattered before they met a surface out of the lobes' light: of none they are."""
    path = wp.tid()
    if scattered[path] == 1:
        whole = rgb(paths.radiance[path])
        split_out.seen[path] = whole
        split_out.lamps[path] = whole
        split_out.direct[path] = whole


@wp.kernel
def accumulate_scattered(
    # In:
    paths: Paths,
    scattered: wp.array[int],
    split: LightSplit,
    exposure: float,
    first_pixel: int,
    pixel_count: int,
    sample_count: int,
    # Out:
    passes_out: LightPasses,
):
    """Add the light that a medium has scattered first, of an albedo of 1; comes before leave_out_scattered."""
    local = wp.tid()
    direct = wp.vec3(0.0, 0.0, 0.0)
    indirect = wp.vec3(0.0, 0.0, 0.0)
    count = float(0.0)
    for sample in range(sample_count):
        path = sample * pixel_count + local
        whole = rgb(paths.radiance[path])
        if is_finite3(whole):
            count += 1.0
            if scattered[path] == 1:
                direct += split.direct[path] - split.seen[path]
                indirect += whole - split.direct[path]
    pixel = first_pixel + local
    passes_out.direct[pixel] = passes_out.direct[pixel] + direct * exposure
    passes_out.indirect[pixel] = passes_out.indirect[pixel] + indirect * exposure
    passes_out.albedo[pixel] = passes_out.albedo[pixel] + wp.vec4(count, count, count, count)


@wp.func
def lobe_share(share: wp.vec4, lobe: int) -> wp.vec3:
    """Return the share of a path's light that a lobe (PASS_*) has; those of all three add up to 1."""
    diffuse = rgb(share)
    rest = wp.vec3(1.0, 1.0, 1.0) - diffuse
    if lobe == PASS_GLOSSY:
        return rest * share[3]
    if lobe == PASS_TRANSMISSION:
        return rest * (1.0 - share[3])
    return diffuse


@wp.func
def lobe_color(split: LightSplit, lobe: int, path: int) -> wp.vec3:
    """Return the albedo that a lobe has at a path's first hit."""
    color = split.diffuse_color[path]
    if lobe == PASS_GLOSSY:
        color = split.glossy_color[path]
    if lobe == PASS_TRANSMISSION:
        color = split.transmission_color[path]
    return color


@wp.kernel
def accumulate_split(
    # In:
    paths: Paths,
    split: LightSplit,
    exposure: float,
    lobe: int,
    first_pixel: int,
    pixel_count: int,
    sample_count: int,
    # Out:
    passes_out: LightPasses,
):
    """Add one lobe's light of the finished paths of each pixel to the sums; leave out what film.py leaves out."""
    local = wp.tid()
    direct = wp.vec3(0.0, 0.0, 0.0)
    indirect = wp.vec3(0.0, 0.0, 0.0)
    albedo = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for sample in range(sample_count):
        path = sample * pixel_count + local
        whole = rgb(paths.radiance[path])
        if is_finite3(whole):
            lamps = split.lamps[path]
            met = split.direct[path]
            share = lobe_share(split.path_share[path], lobe)
            direct += wp.cw_mul(lamps - split.seen[path], lobe_share(split.lamp_share[path], lobe))
            direct += wp.cw_mul(met - lamps, share)
            indirect += wp.cw_mul(whole - met, share)
            albedo += rgba(lobe_color(split, lobe, path), 1.0)
    pixel = first_pixel + local
    passes_out.direct[pixel] = passes_out.direct[pixel] + direct * exposure
    passes_out.indirect[pixel] = passes_out.indirect[pixel] + indirect * exposure
    passes_out.albedo[pixel] = passes_out.albedo[pixel] + albedo
