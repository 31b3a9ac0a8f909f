# SPDX-License-Identifier: GPL-3.0-or-later
"""Near-contact detail: light and shadow of things closer to a pixel than its probes.

Probes lie 8 pixels apart, so what stands between a pixel and its probes is missing from their light. Around each pixel
the G-buffer is searched for horizons along a few directions on the screen (Bavoil et al. 2008). Where a nearby surface
rises over the pixel's tangent plane, the probe's radiance from there is exchanged for that surface's colour in the
frame before. Only the difference counts: where the probe sees the same as the pixel nothing changes, so no light or
shadow is counted twice (the published pass clips the cosine lobe by a cone instead, and adds the nearby light).
"""

from __future__ import annotations

import warp as wp

from .gbuffer import SURFACE_EMITS, GBuffer, Surface, has_surface, load_surface
from .geometry_math import TWO_PI, is_finite3
from .packing import from_half, rgb, rgba, to_half, unpack_normal
from .probe_map import cell_of, to_local
from .probe_spawn import on_surface, probe_cell
from .probe_types import CELLS, TILE, ProbeGrid, ProbePool, ProbeTiles
from .reprojection import Reprojection, has_tap, tap_pixel, tap_weight
from .sampling import hash_combine, hashed_unit
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Directions on the screen, and pixels visited along each.
SIDES = wp.constant(4)
STEPS = wp.constant(4)

# Farthest pixel visited: two tiles.
RADIUS = wp.constant(16.0)

# Sine of the elevation from which on something stands over the tangent plane: depth differences of curved and noisy
# surfaces stay below it.
LEAST_SINE = wp.constant(0.08)


@wp.func
def previous_radiance(
    previous_color: wp.array[wp.vec4h], reprojection: Reprojection, width: int, pixel: int,
) -> wp.vec4:
    """Return the colour of a pixel's surface in the frame before, at the best tap; w = 0 where it was not seen."""
    taps = reprojection.taps[pixel]
    best = int(-1)
    most = float(-1.0)
    for tap in range(4):
        if has_tap(taps, tap):
            w = tap_weight(reprojection.position[pixel], tap)
            if w > most:
                most = w
                best = tap
    if best < 0:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    color = rgb(from_half(previous_color[tap_pixel(reprojection.position[pixel], best, width)]))
    if not is_finite3(color):
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    return rgba(wp.max(color, wp.vec3(0.0, 0.0, 0.0)), 1.0)


@wp.func
def pixel_probe(
    view: View, grid: ProbeGrid, tiles: ProbeTiles, pool: ProbePool, s: Surface, pixel: int,
) -> int:
    """Return the probe of a pixel's tile that lies on its surface, -1 for none."""
    tile = (pixel // grid.width // TILE) * grid.tile_columns + pixel % grid.width // TILE
    slot = tiles.probe[tile]
    if slot >= 0:
        if on_surface(view, s, pool.position[slot], unpack_normal(pool.normal[slot])):
            return slot
    slot = tiles.other[tile]
    if slot >= 0:
        if on_surface(view, s, pool.position[slot], unpack_normal(pool.normal[slot])):
            return slot
    return -1


@wp.func
def probe_radiance(pool: ProbePool, slot: int, direction: wp.vec3) -> wp.vec3:
    """Return exposed radiance that a probe sees in a direction; just above its horizon for those below."""
    local = to_local(unpack_normal(pool.normal[slot]), direction)
    local = wp.normalize(wp.vec3(local[0], local[1], wp.max(local[2], 1.0e-3)))
    return rgb(from_half(pool.radiance[slot * CELLS + cell_of(local)]))


@wp.func
def side_difference(
    view: View, grid: ProbeGrid, gbuffer: GBuffer, pool: ProbePool, slot: int, previous_color: wp.array[wp.vec4h],
    reprojection: Reprojection, s: Surface, pixel: int, angle: float, jitter: float,
) -> wp.vec3:
    """Return what is to be added for one direction on the screen, as if all directions were alike.

    The share of a cosine-weighted hemisphere between the tangent plane and an elevation e is sin^2 e.
    """
    reach = probe_cell(view, s.depth) * (RADIUS / float(TILE))
    horizon = LEAST_SINE * LEAST_SINE
    total = wp.vec3(0.0, 0.0, 0.0)
    step = int(0)
    while step < STEPS:
        # Closer together near the pixel.
        t = (float(step) + jitter) / float(STEPS)
        radius = 1.0 + (RADIUS - 1.0) * t * t
        x = pixel % grid.width + int(wp.round(radius * wp.cos(angle)))
        y = pixel // grid.width + int(wp.round(radius * wp.sin(angle)))
        step = step + 1
        if x >= 0 and y >= 0 and x < grid.width and y < grid.height:
            other = load_surface(view, gbuffer, grid.width, y * grid.width + x)
            offset = other.position - s.position
            distance = wp.max(wp.length(offset), 1.0e-20)
            direction = offset / distance
            sine = wp.dot(s.normal, direction)
            covered = sine * sine
            # Only fronts of things count, and only as near as the probes are far.
            if (has_surface(other) and sine > 0.0 and covered > horizon and distance < reach
                    and wp.dot(other.geometric_normal, direction) < 0.0):
                color = previous_radiance(previous_color, reprojection, grid.width, y * grid.width + x)
                # What shines by itself is direct light: probes don't hold it, and it would count twice.
                shines = (gbuffer.material[y * grid.width + x] & SURFACE_EMITS) != wp.uint32(0)
                if color[3] > 0.0 and not shines:
                    fade = 1.0 - (distance / reach) * (distance / reach)
                    total = total + (rgb(color) - probe_radiance(pool, slot, direction)) * ((covered - horizon) * fade)
                horizon = covered
    return total


@wp.kernel
def add_contact(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    gbuffer: GBuffer,
    tiles: ProbeTiles,
    pool: ProbePool,
    previous_color: wp.array[wp.vec4h],
    reprojection: Reprojection,
    # Out:
    irradiance_out: wp.array[wp.vec4h],
    contact_out: wp.array[wp.vec4h],
):
    """Add to a pixel's exposed irradiance / pi what nearby pixels tell; `contact_out` is what was added."""
    pixel = first + wp.tid()
    contact_out[pixel] = to_half(wp.vec4(0.0, 0.0, 0.0, 0.0))
    view = views[0]
    # Colours of a frame before the light was edited tell nothing.
    if view.restart == 1 or view.light_age == 0 or gbuffer.hit[pixel][0] < 0:
        return
    s = load_surface(view, gbuffer, grid.width, pixel)
    slot = pixel_probe(view, grid, tiles, pool, s, pixel)
    if slot < 0:
        return
    seed = hash_combine(wp.uint32(pixel), wp.uint32(view.frame))
    turn = hashed_unit(seed, wp.uint32(0))
    total = wp.vec3(0.0, 0.0, 0.0)
    side = int(0)
    while side < SIDES:
        angle = TWO_PI * (float(side) + turn) / float(SIDES)
        total = total + side_difference(
            view, grid, gbuffer, pool, slot, previous_color, reprojection, s, pixel, angle,
            hashed_unit(seed, wp.uint32(1 + side)))
        side = side + 1
    total = total / float(SIDES)
    contact_out[pixel] = to_half(rgba(total, 1.0))
    before = from_half(irradiance_out[pixel])
    irradiance_out[pixel] = to_half(rgba(wp.max(rgb(before) + total, wp.vec3(0.0, 0.0, 0.0)), before[3]))
