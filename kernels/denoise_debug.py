# SPDX-License-Identifier: GPL-3.0-or-later
"""Debug views of the denoisers: lengths of means, errors and blur."""

from __future__ import annotations

import warp as wp

from .debug_colors import heat
from .diffuse_blur import blur_radius
from .diffuse_temporal import DiffuseHistory
from .direct_temporal import DirectHistory
from .filter_weights import brightness
from .long_mean import unpack_mean
from .packed_halves import unpack_first, unpack_halves
from .packing import rgba

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def length_color(length: float) -> wp.vec4:
    """Return the colour of a number of frames: logarithmic, 0 black, 1024 white."""
    return rgba(heat(wp.log2(1.0 + wp.max(length, 0.0)) * 0.1), 1.0)


@wp.kernel
def show_direct_history(
    first: int,
    # In:
    history: DirectHistory,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Show how many frames are in the mean of direct light; banded over pixels."""
    pixel = first + wp.tid()
    picture_out[pixel] = length_color(wp.abs(float(history.length[pixel])))


@wp.kernel
def show_direct_variance(
    first: int,
    # In:
    history: DirectHistory,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Show the relative error that is left in the mean of direct light, white from 100 % on; banded over pixels."""
    pixel = first + wp.tid()
    length = wp.max(wp.abs(float(history.length[pixel])), 1.0)
    moments = unpack_halves(history.moments[pixel])
    light = brightness(unpack_mean(history.diffuse[pixel]) + unpack_mean(history.specular[pixel]))
    error = (moments[0] + moments[1]) / wp.sqrt(length)
    picture_out[pixel] = rgba(heat(error / wp.max(light, 1.0e-6)), 1.0)


@wp.kernel
def show_diffuse_history(
    first: int,
    # In:
    history: DiffuseHistory,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Show how many frames are in the mean of diffuse indirect light; banded over pixels."""
    pixel = first + wp.tid()
    picture_out[pixel] = length_color(unpack_first(history.state[pixel]))


@wp.kernel
def show_diffuse_blur(
    first: int,
    # In:
    history: DiffuseHistory,
    width: int,
    height: int,
    radius: int,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Show the blur of diffuse indirect light, white at the largest; banded over pixels."""
    pixel = first + wp.tid()
    reach = blur_radius(history.state, width, height, pixel, radius)
    if unpack_first(history.state[pixel]) < 0.0:
        reach = 0
    picture_out[pixel] = rgba(heat(float(reach) / float(wp.max(radius, 1))), 1.0)
