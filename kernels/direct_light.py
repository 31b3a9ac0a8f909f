# SPDX-License-Identifier: GPL-3.0-or-later
"""Direct light of a frame as passes hand it to each other."""

from __future__ import annotations

import warp as wp


@wp.struct
class DirectLight:
    """One entry a pixel: radiance that lights send straight to the camera by way of a surface, without its colours."""

    diffuse: wp.array[wp.vec4h]
    """Exposed; times (diffuse + translucent albedo) it is the radiance that leaves. w = 1 where this frame has a
    sample, 0 where it has none"""
    specular: wp.array[wp.vec4h]
    """Exposed; times GBuffer.specular it is the radiance that leaves. w as in `diffuse`"""


@wp.struct
class PackedLight:
    """The same memory in words that load and store at once (packed_halves.py)."""

    diffuse: wp.array[wp.uint64]
    specular: wp.array[wp.uint64]
