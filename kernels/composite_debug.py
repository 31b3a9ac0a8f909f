# SPDX-License-Identifier: GPL-3.0-or-later
"""Debug views of the composite, of anti-aliasing and of the blend at rest."""

from __future__ import annotations

import warp as wp

from .composite import Lights, light_shares
from .debug_colors import heat
from .gbuffer import GBuffer
from .packing import rgb, rgba

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SHOW_DIRECT = wp.constant(0)
SHOW_INDIRECT = wp.constant(1)
SHOW_REFLECTION = wp.constant(2)

# Frames at rest for which the ramp of the history view is white.
HISTORY_WHITE = wp.constant(256.0)


@wp.kernel
def show_light(
    first: int,
    # In:
    gbuffer: GBuffer,
    lights: Lights,
    what: int,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Draw the direct light and emission, all indirect light or its reflection alone, of this frame (SHOW_*)."""
    pixel = first + wp.tid()
    s = light_shares(gbuffer, lights, pixel)
    c = rgb(s.emission) + s.diffuse_direct + s.specular_direct
    if what == SHOW_INDIRECT:
        c = s.diffuse_indirect + s.specular_indirect + s.transmitted
    if what == SHOW_REFLECTION:
        c = s.specular_indirect
    picture_out[pixel] = rgba(c, 1.0)


@wp.kernel
def show_history(
    first: int,
    # In:
    samples: wp.array[wp.uint16],
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Draw how many frames each pixel averages, on a logarithmic scale."""
    pixel = first + wp.tid()
    picture_out[pixel] = rgba(heat(wp.log(float(samples[pixel])) / wp.log(HISTORY_WHITE)), 1.0)


@wp.kernel
def show_weight(
    first: int,
    # In:
    weight: wp.array[float],
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Draw the share of path-traced samples: black none, white all."""
    pixel = first + wp.tid()
    w = weight[pixel]
    picture_out[pixel] = wp.vec4(w, w, w, 1.0)
