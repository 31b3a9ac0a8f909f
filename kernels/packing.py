# SPDX-License-Identifier: GPL-3.0-or-later
"""Compact forms of normals, colours and radiance in the frame's buffers."""

from __future__ import annotations

import warp as wp

from .geometry_math import safe_sqrt

# Largest value that the half-float buffers take (the format ends at 65504).
HALF_MAX = wp.constant(65000.0)
BITS_OF_2_23 = wp.constant(wp.uint32(0x4B000000))


@wp.func
def sign_not_zero(x: float) -> float:
    """Return 1 or -1."""
    return wp.where(x < 0.0, -1.0, 1.0)


@wp.func
def whole_float(x: wp.uint32) -> float:
    """Return a whole number below 2^23 as a float: the lower bits of 2^23's. On GPUs conversions proper are slow."""
    return wp.cast(x | BITS_OF_2_23, float) - 8388608.0


@wp.func
def pack_unorm16(x: float, y: float) -> wp.uint32:
    """Pack two numbers in [0, 1] with 16 bits each, rounded."""
    a = wp.uint32(wp.clamp(x, 0.0, 1.0) * 65535.0 + 0.5)
    b = wp.uint32(wp.clamp(y, 0.0, 1.0) * 65535.0 + 0.5)
    return a | (b << wp.uint32(16))


@wp.func
def unpack_unorm16(packed: wp.uint32) -> wp.vec2:
    """Return the two numbers of pack_unorm16."""
    return wp.vec2(float(packed & wp.uint32(65535)), float(packed >> wp.uint32(16))) * 1.5259022e-5


@wp.func
def pack_normal(n: wp.vec3) -> wp.uint32:
    """Pack a unit vector as octahedral coordinates of 16 bits (Cigolle et al. 2014); errs by at most 4e-5 rad."""
    scale = 1.0 / wp.max(wp.abs(n[0]) + wp.abs(n[1]) + wp.abs(n[2]), 1.0e-20)
    x = n[0] * scale
    y = n[1] * scale
    if n[2] < 0.0:
        folded = (1.0 - wp.abs(y)) * sign_not_zero(x)
        y = (1.0 - wp.abs(x)) * sign_not_zero(y)
        x = folded
    # Even steps: 0 is exactly representable, so axis-aligned normals stay so.
    a = wp.uint32(int(wp.round(wp.clamp(x, -1.0, 1.0) * 32767.0)) + 32768)
    b = wp.uint32(int(wp.round(wp.clamp(y, -1.0, 1.0) * 32767.0)) + 32768)
    return a | (b << wp.uint32(16))


@wp.func
def unpack_normal(packed: wp.uint32) -> wp.vec3:
    """Return the unit vector of pack_normal."""
    x = (float(packed & wp.uint32(65535)) - 32768.0) / 32767.0
    y = (float(packed >> wp.uint32(16)) - 32768.0) / 32767.0
    z = 1.0 - wp.abs(x) - wp.abs(y)
    if z < 0.0:
        folded = (1.0 - wp.abs(y)) * sign_not_zero(x)
        y = (1.0 - wp.abs(x)) * sign_not_zero(y)
        x = folded
    return wp.normalize(wp.vec3(x, y, z))


@wp.func
def pack_color(c: wp.vec3) -> wp.uint32:
    """Pack a colour in [0, 1] as square roots with 11, 11 and 10 bits, rounded (0 and 1 are exact)."""
    r = wp.uint32(safe_sqrt(wp.min(c[0], 1.0)) * 2047.0 + 0.5)
    g = wp.uint32(safe_sqrt(wp.min(c[1], 1.0)) * 2047.0 + 0.5)
    b = wp.uint32(safe_sqrt(wp.min(c[2], 1.0)) * 1023.0 + 0.5)
    return r | (g << wp.uint32(11)) | (b << wp.uint32(22))


@wp.func
def unpack_color(packed: wp.uint32) -> wp.vec3:
    """Return the colour of pack_color."""
    r = float(packed & wp.uint32(2047)) * 4.8851978e-4
    g = float((packed >> wp.uint32(11)) & wp.uint32(2047)) * 4.8851978e-4
    b = float(packed >> wp.uint32(22)) * 9.7751711e-4
    return wp.vec3(r * r, g * g, b * b)


@wp.func
def to_half(v: wp.vec4) -> wp.vec4h:
    """Round to half-floats; too large numbers are clamped, not made infinite."""
    return wp.vec4h(
        wp.float16(wp.clamp(v[0], -HALF_MAX, HALF_MAX)), wp.float16(wp.clamp(v[1], -HALF_MAX, HALF_MAX)),
        wp.float16(wp.clamp(v[2], -HALF_MAX, HALF_MAX)), wp.float16(wp.clamp(v[3], -HALF_MAX, HALF_MAX)))


@wp.func
def from_half(v: wp.vec4h) -> wp.vec4:
    """Return half-floats as floats."""
    return wp.vec4(float(v[0]), float(v[1]), float(v[2]), float(v[3]))


@wp.func
def rgb(v: wp.vec4) -> wp.vec3:
    """Return the first three components."""
    return wp.vec3(v[0], v[1], v[2])


@wp.func
def rgba(c: wp.vec3, a: float) -> wp.vec4:
    """Put a colour and a fourth number together."""
    return wp.vec4(c[0], c[1], c[2], a)


@wp.func
def pack_floats(a: float, b: float) -> wp.uint64:
    """Put the bits of two floats into a word, which loads at once (Warp loads a vector in parts)."""
    return wp.uint64(wp.cast(a, wp.uint32)) | (wp.uint64(wp.cast(b, wp.uint32)) << wp.uint64(32))


@wp.func
def unpack_floats(packed: wp.uint64) -> wp.vec2:
    """Return the floats of pack_floats."""
    return wp.vec2(
        wp.cast(wp.uint32(packed & wp.uint64(0xFFFFFFFF)), float), wp.cast(wp.uint32(packed >> wp.uint64(32)), float))
