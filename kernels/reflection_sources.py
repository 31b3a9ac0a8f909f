# SPDX-License-Identifier: GPL-3.0-or-later
"""The two places in the frame before where a reflection may come from: its surface's and its virtual image's.

Eto et al. 2023, section 2; method 7.4.
"""

from __future__ import annotations

import warp as wp

from .filter_weights import squared_cosine
from .gbuffer import GBuffer, unpack_roughness
from .geometry_math import max_component
from .long_mean import (
    ALL_TAPS,
    ON_CENTRE,
    SMOOTH,
    TAP_MINIMUM,
    gather_mean,
    nearest_tap,
    off_centre,
    place_between,
    surrounded,
    tap_weights,
    unpack_mean,
    valid_tap,
)
from .packed_halves import unpack_halves, unpack_pair
from .packing import rgb
from .reflection_blocks import ReflectionHistory, light_strength
from .reflection_images import MirrorBefore, image_position, image_stretch, mirror_before
from .reflection_types import (
    LOBE_REFLECTION,
    SAMPLE_FAR,
    ReflectionOptions,
    ReflectionSamples,
    block_of,
    fading,
)
from .reprojection import Reprojection, has_moved, has_tap, known_taps, tap_pixel
from .view import (
    SKY_DEPTH,
    View,
    pixel_footprint,
    previous_film_position,
    project,
    unproject,
)
from .wide_loads import load_previous_view, load_word

# Frames that the distance of what is reflected is averaged over at most, and those at rest besides.
DISTANCE_FRAMES = wp.constant(8.0)
# Relative difference that is always taken for noise.
MARGIN = wp.constant(0.05)
# Roughness up to which the virtual image is preferred, and over which the preference moves to the surface.
VIRTUAL_ROUGHNESS = wp.constant(0.5)
VIRTUAL_BLEND = wp.constant(0.3)
# Preference of the image of what moves itself at most: a shadow on it, or a texture by place, stays where it is.
MOVER_PREFERENCE = wp.constant(0.8)
# Roughness up to which the distance of what is reflected is this frame's, and over which it becomes a mean's.
DISTANCE_ROUGHNESS = wp.constant(0.1)
DISTANCE_BLEND = wp.constant(0.35)
# Roughness up to which means are read with the sharp interpolation: rougher reflections have nothing that would blur.
SHARP_ROUGHNESS = wp.constant(0.3)
# Distance [px] up to which the surface stands in for a virtual image that was not seen, and twice which it does not.
FOLLOWED = wp.constant(1.0)
# Least share of either source, before the scores.
SOURCE_MINIMUM = wp.constant(0.02)
# What another pixel of the frame before must have for the virtual image to be seen in it: squared cosine of the
# normals, relative depth or distance from the plane [px], roughness.
IMAGE_COSINE2 = wp.constant(0.9)
IMAGE_DEPTH = wp.constant(0.05)
IMAGE_PLANE = wp.constant(2.0)
IMAGE_ROUGHNESS = wp.constant(0.1)


@wp.struct
class ReflectionMean:
    """The mean of one pixel."""

    light: wp.vec3
    length: float
    fast: float
    deviation: float
    closeness: float
    changed: int


@wp.func
def no_reflection() -> ReflectionMean:
    """Return a mean of no frames."""
    m = ReflectionMean()
    m.light = wp.vec3(0.0, 0.0, 0.0)
    m.length = 0.0
    m.fast = 0.0
    m.deviation = 0.0
    m.closeness = 1.0 / SAMPLE_FAR
    m.changed = 0
    return m


@wp.func
def with_reflection_state(m: ReflectionMean, state: wp.vec4) -> ReflectionMean:
    """Return the mean with everything but its light set from ReflectionHistory.state."""
    out = m
    out.length = wp.abs(state[0])
    out.fast = state[1]
    out.deviation = state[2]
    out.closeness = state[3]
    return out


@wp.func
def gather_reflection(
    history: ReflectionHistory, gbuffer: GBuffer, position: wp.vec2, taps: wp.uint8, own: int, sharp: bool, width: int,
    height: int,
) -> ReflectionMean:
    """Return the mean of the frame before at a place (for pixel `own`); its length is 0 where there is none.

    It is the shorter the less of the place is known (long_mean.py).
    """
    m = no_reflection()
    if not off_centre(position):
        nearest = nearest_tap(position)
        if has_tap(taps, nearest):
            pixel = tap_pixel(position, nearest, width)
            found = unpack_halves(history.state[pixel])
            if found[0] != 0.0:
                m = with_reflection_state(m, found)
                m.changed = wp.where(found[0] < 0.0, 1, 0)
                m.light = unpack_mean(history.light[pixel])
        return m
    place = place_between(position, width)
    weights = tap_weights(place)
    state = wp.vec4(0.0, 0.0, 0.0, 0.0)
    total = float(0.0)
    changed = float(0.0)
    complete = sharp and int(taps) == ALL_TAPS
    for tap in range(4):
        # All are read before any is judged: they wait for memory together.
        around = unpack_halves(load_word(history.state, valid_tap(place, taps, tap, width, own)))
        if not has_tap(taps, tap):
            weights[tap] = 0.0
        elif around[0] == 0.0:
            complete = complete and weights[tap] == 0.0
            weights[tap] = 0.0
        elif around[0] < 0.0:
            changed += weights[tap]
            around[0] = -around[0]
        total += weights[tap]
        state += around * weights[tap]
    if total > TAP_MINIMUM:
        scale = 1.0 / total
        m = with_reflection_state(m, state * scale)
        m.changed = wp.where(changed > 0.25 * total, 1, 0)
        wide = complete and surrounded(gbuffer, place, width, height)
        m.light = gather_mean(history.light, place, weights * scale, complete, wide, SMOOTH, width, height)
        m.length *= total
    return m


@wp.func
def surface_roughness(gbuffer: GBuffer, pixel: int) -> float:
    """Return the roughness of a pixel's base lobe."""
    return unpack_roughness(gbuffer.material[pixel])


@wp.func
def image_taps(
    views: wp.array[View], gbuffer: GBuffer, previous: GBuffer, before: MirrorBefore, width: int, height: int,
    pixel: int, position: wp.vec2,
) -> wp.uint8:
    """Return which of the four pixels around a place in the frame before show a surface like a pixel's."""
    view = load_previous_view(views)
    left = int(wp.floor(position[0] - 0.5))
    low = int(wp.floor(position[1] - 0.5))
    depth = project(view.previous, before.position)[2]
    tolerance = IMAGE_PLANE * pixel_footprint(view.camera, gbuffer.depth[pixel])
    roughness = surface_roughness(gbuffer, pixel)
    taps = int(0)
    tap = int(0)
    while tap < 4:
        i = left + (tap & 1)
        j = low + (tap >> 1)
        if i >= 0 and j >= 0 and i < width and j < height:
            q = j * width + i
            there = previous.depth[q]
            other = unproject(view.previous, previous_film_position(view, i, j), wp.min(there, 1.0e15))
            # A flat mirror's plane may be seen aslant: its depth says nothing.
            alike = wp.abs(there - depth) < IMAGE_DEPTH * depth
            alike = alike or wp.abs(wp.dot(before.plane_normal, other - before.position)) < tolerance
            alike = alike and wp.abs(surface_roughness(previous, q) - roughness) < IMAGE_ROUGHNESS
            alike = alike and squared_cosine(before.normal, previous.normal[q]) > IMAGE_COSINE2
            if alike and there < SKY_DEPTH:
                taps = taps | (1 << tap)
        tap += 1
    return wp.uint8(taps)


@wp.func
def score(m: ReflectionMean, color: wp.vec3, deviation: float) -> float:
    """Return how well a mean agrees with a frame's light, 0..1; brighter and darker means alike."""
    apart = max_component(wp.abs(m.light - color))
    unit = deviation + MARGIN * light_strength(color) + 1.0e-6
    return 1.0 / (1.0 + apart * apart / (unit * unit))


@wp.func
def blended(surface: ReflectionMean, image: ReflectionMean, share: float) -> ReflectionMean:
    """Return the mean of both sources, `share` of it from the virtual image."""
    m = ReflectionMean()
    m.light = wp.lerp(surface.light, image.light, share)
    m.length = wp.lerp(surface.length, image.length, share)
    m.fast = wp.lerp(surface.fast, image.fast, share)
    m.deviation = wp.lerp(surface.deviation, image.deviation, share)
    m.closeness = wp.lerp(surface.closeness, image.closeness, share)
    m.changed = wp.where(share > 0.5, image.changed, surface.changed)
    return m


@wp.func
def gather_sources(
    views: wp.array[View], gbuffer: GBuffer, previous: GBuffer, reprojection: Reprojection, options: ReflectionOptions,
    samples: ReflectionSamples, history: ReflectionHistory, pixel: int, roughness: float, light: wp.vec4,
    deviation: float,
) -> ReflectionMean:
    """Return the mean of the frame before, from where the surface and where the virtual image was.

    In detail:
        light: Of this frame; w = closeness of what is reflected, below 0 where that is not known.
        deviation: Of the light around.
    """
    width = options.width
    position = reprojection.position[pixel]
    taps = known_taps(reprojection, pixel)
    prefer = fading(roughness, VIRTUAL_ROUGHNESS, VIRTUAL_BLEND)
    smooth = fading(roughness, DISTANCE_ROUGHNESS, DISTANCE_BLEND)
    reflects = options.lobe == LOBE_REFLECTION
    if not reflects:
        prefer = smooth
    # At rest both places are one. Of a mirror that moved and was not seen before nothing is known, nor how glass that
    # moves bends light.
    twofold = views[0].rest == 0 and prefer > 0.0
    if has_moved(reprojection.taps[pixel]) and (taps == wp.uint8(0) or not reflects):
        twofold = False
    sharp = roughness < SHARP_ROUGHNESS
    surface = gather_reflection(history, previous, position, taps, pixel, sharp, width, options.height)
    if not twofold:
        return surface
    closeness = light[3]
    if surface.length > 0.0:
        closeness = wp.where(
            closeness < 0.0, surface.closeness,
            wp.lerp(surface.closeness, closeness, wp.max(smooth, 1.0 / DISTANCE_FRAMES)))
    closeness = wp.max(closeness, 0.0)
    before = mirror_before(views, gbuffer, previous, reprojection, width, pixel)
    there = image_position(views, gbuffer, before, width, pixel, closeness)
    apart = there - position
    if reflects and views[0].moved_age == 0:
        shift = unpack_pair(samples.shift[block_of(options, pixel)])
        if wp.abs(shift[0]) + wp.abs(shift[1]) > 0.0:
            prefer = wp.min(prefer, MOVER_PREFERENCE)
        apart = apart + shift
    if wp.abs(apart[0]) + wp.abs(apart[1]) < ON_CENTRE:
        return surface
    if reflects:
        apart = apart * image_stretch(views, gbuffer, width, options.height, pixel, apart, closeness)
        there = position + apart
    taps = image_taps(views, gbuffer, previous, before, width, options.height, pixel, there)
    image = no_reflection()
    if taps != wp.uint8(0):
        image = gather_reflection(history, previous, there, taps, pixel, sharp, width, options.height)
    if image.length <= 0.0:
        if reflects:
            # What is reflected has come into view: a mirror's surface showed something else where it was.
            gone = wp.clamp((wp.length(apart) - FOLLOWED) / FOLLOWED, 0.0, 1.0)
            surface.length = surface.length * (1.0 - smooth * gone)
        return surface
    if surface.length <= 0.0:
        return image
    prefer = wp.clamp(prefer, SOURCE_MINIMUM, 1.0 - SOURCE_MINIMUM)
    for_image = prefer * score(image, rgb(light), deviation)
    for_surface = (1.0 - prefer) * score(surface, rgb(light), deviation)
    return blended(surface, image, for_image / (for_image + for_surface))
