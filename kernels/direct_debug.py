# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the direct light pass's intermediate results."""

from __future__ import annotations

import warp as wp

from .debug_colors import hash_color, heat
from .direct_light import DirectLight
from .direct_reservoir import DirectOptions, Reservoirs, has_sample, load_reservoir, slot_of_pixel
from .direct_shade import factor_of
from .light_candidate import CANDIDATE_NONE, CANDIDATE_WORLD, candidate_kind
from .packing import from_half, rgb, rgba
from .paths import Paths
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SHOW_DIFFUSE = wp.constant(0)
SHOW_SPECULAR = wp.constant(1)
SHOW_LIGHT = wp.constant(2)
SHOW_WEIGHT = wp.constant(3)
SHOW_VISIBILITY = wp.constant(4)

# Of pixels that show nothing, or leave their turn out.
NO_RAY = wp.constant(wp.vec3(0.0, 0.0, 0.25))


@wp.func
def sampled_pixel(view: View, options: DirectOptions, pixel: int) -> int:
    """Return a pixel whose turn it is: itself or the one beside it."""
    x = pixel % options.width
    if has_sample(view, options, slot_of_pixel(view, options, pixel)) or options.width == 1:
        return pixel
    return wp.where(x > 0, pixel - 1, pixel + 1)


@wp.func
def reservoir_color(reservoirs: Reservoirs, pixel: int, what: int) -> wp.vec3:
    """Return the colour of a pixel's light or weight; black without one."""
    r = load_reservoir(reservoirs, pixel)
    kind = candidate_kind(r.candidate)
    if kind == CANDIDATE_NONE:
        return wp.vec3(0.0, 0.0, 0.0)
    if what == SHOW_WEIGHT:
        # With one light the weight is 1, with many about their number: half-way up the ramp is the weight 1.
        return heat(0.5 + wp.log2(wp.max(r.weight, 1.0e-9)) / 16.0)
    code = int(r.candidate.light)
    if kind == CANDIDATE_WORLD:
        # One colour for the whole world: it has more texels than a picture has pixels.
        code = 1
    return hash_color(code & 0x7FFFFFFF)


@wp.kernel
def show_direct(
    # In:
    first: int,
    views: wp.array[View],
    options: DirectOptions,
    what: int,
    reservoirs: Reservoirs,
    rays: Paths,
    light: DirectLight,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Draw one of SHOW_*; light as on the film, without exposure and colours."""
    pixel = first + wp.tid()
    color = wp.vec3(0.0, 0.0, 0.0)
    if what == SHOW_DIFFUSE:
        color = rgb(from_half(light.diffuse[pixel])) / wp.max(views[0].exposure, 1.0e-30)
    if what == SHOW_SPECULAR:
        color = rgb(from_half(light.specular[pixel])) / wp.max(views[0].exposure, 1.0e-30)
    if what == SHOW_LIGHT or what == SHOW_WEIGHT:
        color = reservoir_color(reservoirs, sampled_pixel(views[0], options, pixel), what)
    if what == SHOW_VISIBILITY:
        shown = sampled_pixel(views[0], options, pixel)
        color = NO_RAY
        if reservoirs.weight[shown][1] > 0.0:
            color = factor_of(options, rays, slot_of_pixel(views[0], options, shown))
    picture_out[pixel] = rgba(color, 1.0)
