# SPDX-License-Identifier: GPL-3.0-or-later
"""At rest: pixels without any like them, whose noise no band of rest_blend.py has found a neighbour to average with.

Most are at edges, where each has a mix of surfaces of its own. Their coarsest r is all of P - F.
"""

from __future__ import annotations

import warp as wp

from .film import Film, mean_square
from .packing import rgb
from .rest_blend import Residual, assumed_share, mean_ratio, noise_ratio, widening

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Share of its variance that a pixel's coarsest r still has, from which on it counts as lonely, and wholly so.
LONELY_FROM = wp.constant(0.2)
LONELY_TO = wp.constant(0.6)
# How fast pixels become lonely as their mean normal's squared length falls from 1: by texture alone none does.
LONELY_NORMAL = wp.constant(10.0)


@wp.kernel
def split_lonely(
    first: int,
    # In:
    residual: Residual,
    film: Film,
    variance: wp.array[float],
    bands: int,
    # Out:
    coarser_out: wp.array[wp.vec4],
    ratio_out: wp.array[wp.vec2],
):
    """Split the coarsest r as split_band does: into what passes whole, and what pixels without any like them have.

    Those are at edges, and hold all of their noise in it, as none of the filters found them a neighbour.
    """
    pixel = first + wp.tid()
    own = residual.color[pixel]
    coarser = own
    ratio = wp.vec2(0.0, -1.0)
    if own[3] >= 0.0:
        few = widening(film, pixel)
        # Each band has widened it for few samples; once is meant.
        left = own[3] / wp.pow(few, float(bands - 1))
        kept = left / (few * wp.max(variance[pixel], 1.0e-30))
        normal = rgb(residual.guide[pixel])
        lonely = wp.clamp((kept - LONELY_FROM) / (LONELY_TO - LONELY_FROM), 0.0, 1.0)
        lonely *= wp.clamp(LONELY_NORMAL * (1.0 - wp.dot(normal, normal)), 0.0, 1.0)
        if lonely > 0.0:
            ratio = noise_ratio(rgb(own), left)
            passing = rgb(own) * (1.0 - lonely)
            coarser = wp.vec4(passing[0], passing[1], passing[2], own[3])
    coarser_out[pixel] = coarser
    ratio_out[pixel] = ratio


@wp.kernel
def take_lonely_noise(
    first: int,
    # In:
    residual: Residual,
    coarser: wp.array[wp.vec4],
    ratio: wp.array[wp.vec2],
    picture: wp.array[wp.vec4],
    # Out:
    kept_out: wp.array[wp.vec4],
):
    """Take off what is noise of the coarsest r of pixels without any like them, see split_lonely.

    Less strictly than take_noise: frames err at edges too.
    """
    pixel = first + wp.tid()
    z = ratio[pixel]
    if z[1] >= 0.0:
        share = 1.0 - 1.0 / wp.max(wp.max(mean_ratio(residual, ratio, pixel), z[0]), 1.0)
        share = wp.max(share, assumed_share(z[1], mean_square(picture[pixel])))
        d = (rgb(residual.color[pixel]) - rgb(coarser[pixel])) * (1.0 - share)
        kept_out[pixel] = kept_out[pixel] - wp.vec4(d[0], d[1], d[2], 0.0)
