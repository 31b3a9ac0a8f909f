# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that take samples into the means of froxels, which follow the camera."""

from __future__ import annotations

import warp as wp

from .fog import Fog, scattered_light
from .froxels import FroxelOptions, eye_ray, froxel_range, has_changed, has_spread, slice_at, slice_distance
from .geometry_math import is_finite3
from .packing import from_half, rgb, rgba, to_half
from .paths import Paths
from .sampling import hash_combine, pixel_seed_of
from .types import FrameData
from .view import View, eye_position, project

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

STREAM = wp.constant(0x464F4742)
REST_FRAMES = wp.constant(256.0)
MOVING_FRAMES = wp.constant(24.0)
CHANGED_FRAMES = wp.constant(3.0)
"""Most frames in a mean: at rest, while the camera moves, and where something else has just moved or light changed"""
BLURRED_FRAMES = wp.constant(16.0)
"""Frames in a froxel's mean from which it is not blurred"""
GROWTH = wp.constant(3.0)
"""Over itself and the samples before it is the weight of the newest one: what light has yet to spread in is soon left
behind"""


@wp.func
def factor_of(rays: Paths, slot: int) -> wp.vec3:
    """Return what became of a shadow ray: what gets through, times what a program says over its estimate."""
    factor = rgb(rays.radiance[slot])
    if rays.shadow_distance[slot] != 0.0:
        factor = factor + rays.shadow_light[slot]
    return factor


@wp.func
def froxel_film(frame: FrameData, options: FroxelOptions, x: float, y: float) -> wp.vec2:
    """Return the film position [px] of a place among tiles, whose middles are at 0.5, 1.5 and so on."""
    return wp.vec2(
        float(frame.crop_x) + x * float(options.tile), float(frame.crop_y) + y * float(options.tile))


@wp.func
def known_light(
    view: View, fog: Fog, options: FroxelOptions, before: wp.array[wp.vec4h], slot: int, tile: int, slice: int,
) -> wp.vec4:
    """Return the light of a froxel's middle in the frame before, exposed; w = frames in it."""
    if view.restart == 1:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    if view.rest > 0:
        return from_half(before[slot])
    span_now = froxel_range(fog, view.camera)
    ray = eye_ray(view.camera, froxel_film(
        view.camera, options, float(tile % options.columns) + 0.5, float(tile // options.columns) + 0.5))
    middle = 0.5 * (slice_distance(span_now, options.slices, float(slice))
                    + slice_distance(span_now, options.slices, float(slice + 1)))
    position = ray.origin + ray.direction * middle
    film = project(view.previous, position)
    if film[2] <= 0.0:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    old_range = froxel_range(fog, view.previous)
    old_ray = eye_ray(view.previous, wp.vec2(film[0], film[1]))
    distance = wp.dot(position - old_ray.origin, old_ray.direction)
    # The middle of a slice by distance is not that by number.
    low = slice_at(old_range, options.slices, distance)
    inner = wp.floor(low)
    span = slice_distance(old_range, options.slices, inner + 1.0) - slice_distance(old_range, options.slices, inner)
    z = inner + (distance - slice_distance(old_range, options.slices, inner)) / wp.max(span, 1.0e-20) - 0.5
    x = (film[0] - float(view.previous.crop_x)) / float(options.tile) - 0.5
    y = (film[1] - float(view.previous.crop_y)) / float(options.tile) - 0.5
    light = wp.vec3(0.0, 0.0, 0.0)
    frames = float(0.0)
    for tap in range(8):
        i = int(wp.floor(x)) + (tap & 1)
        j = int(wp.floor(y)) + ((tap >> 1) & 1)
        k = int(wp.floor(z)) + (tap >> 2)
        weight = 1.0 - wp.abs(x - float(i))
        weight = weight * (1.0 - wp.abs(y - float(j))) * (1.0 - wp.abs(z - float(k)))
        k = wp.max(k, 0)
        if i >= 0 and j >= 0 and i < options.columns and j < options.rows and k < options.slices:
            known = from_half(before[(k * options.rows + j) * options.columns + i])
            light = light + rgb(known) * (weight * known[3])
            frames = frames + weight * known[3]
    return rgba(light / wp.max(frames, 1.0e-6), frames)


@wp.kernel
def blend_froxels(
    first: int,
    # In:
    views: wp.array[View],
    fog: Fog,
    options: FroxelOptions,
    rays: Paths,
    place: wp.array[wp.vec4],
    light: wp.array[wp.vec4],
    before: wp.array[wp.vec4h],
    # Out:
    froxels_out: wp.array[wp.vec4h],
):
    """Average what each froxel scatters into its camera rays, per unit of scattering: exposed; w = frames in it."""
    slot = first + wp.tid()
    view = views[0]
    tiles = options.columns * options.rows
    slice = slot // tiles
    tile = slot - slice * tiles
    mean = known_light(view, fog, options, before, slot, tile, slice)
    most = wp.where(view.rest > 0, REST_FRAMES, MOVING_FRAMES)
    if has_changed(view):
        most = CHANGED_FRAMES
    frames = wp.min(mean[3], most - 1.0)
    here = place[slot]
    if here[3] > 0.0:
        frame = view.camera
        ray = eye_ray(frame, froxel_film(
            frame, options, float(tile % options.columns) + 0.5, float(tile // options.columns) + 0.5))
        sample = light[slot]
        seed = hash_combine(pixel_seed_of(slot, 0, STREAM), wp.uint32(view.frame))
        indirect = scattered_light(
            fog, eye_position(frame), rgb(here), ray.direction, sample[3], 0, seed)
        found = (wp.cw_mul(rgb(sample), factor_of(rays, slot)) + indirect) * (here[3] * view.exposure)
        if is_finite3(found):
            # Light of the cells spreads at first: what was before counts for less.
            growth = wp.where(not has_spread(view), GROWTH, 1.0)
            newest = growth / (frames + growth)
            mean = rgba(rgb(mean) + (found - rgb(mean)) * newest, frames + 1.0)
    else:
        mean = rgba(rgb(mean), frames)
    froxels_out[slot] = to_half(mean)


@wp.kernel
def smooth_froxels(
    first: int,
    # In:
    options: FroxelOptions,
    froxels: wp.array[wp.vec4h],
    # Out:
    smooth_out: wp.array[wp.vec4h],
):
    """Blur froxels that few frames have told of over those beside them; w = 0 where nothing is known at all."""
    slot = first + wp.tid()
    tiles = options.columns * options.rows
    slice = slot // tiles
    tile = slot - slice * tiles
    x = tile % options.columns
    y = tile // options.columns
    own = from_half(froxels[slot])
    light = rgb(own) * own[3]
    total = own[3]
    blur = wp.clamp(1.0 - own[3] / BLURRED_FRAMES, 0.0, 1.0)
    if blur > 0.0:
        for tap in range(9):
            i = x + tap % 3 - 1
            j = y + tap // 3 - 1
            if tap != 4 and i >= 0 and j >= 0 and i < options.columns and j < options.rows:
                other = from_half(froxels[(slice * options.rows + j) * options.columns + i])
                weight = wp.min(other[3], BLURRED_FRAMES) * blur
                light = light + rgb(other) * weight
                total = total + weight
    smooth_out[slot] = to_half(rgba(light / wp.max(total, 1.0e-6), wp.where(total > 0.0, 1.0, 0.0)))
