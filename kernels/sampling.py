# SPDX-License-Identifier: GPL-3.0-or-later
"""Random numbers and warps: Owen-scrambled Sobol pairs, and maps from the unit square to disks, cones and lobes.

Every use has a dimension of its own (`DIMENSION_*`), so adding one never shifts another's stream. Pairs are
padded: each takes the two-dimensional Sobol sequence with an index shuffled and coordinates scrambled by seeds of
its own (Burley, "Practical Hash-based Owen Scrambling", JCGT 2020).
"""

from __future__ import annotations

import warp as wp

from .geometry_math import TWO_PI, orthonormal_tangent, safe_sqrt

# Dimensions before the first bounce, and per bounce.
DIMENSION_FILTER = wp.constant(0)
DIMENSION_LENS = wp.constant(1)
DIMENSION_FIRST_BOUNCE = wp.constant(2)
DIMENSIONS_PER_BOUNCE = wp.constant(6)
DIMENSION_BSDF = wp.constant(0)
DIMENSION_LOBE = wp.constant(1)
"""x: lobe of the BSDF, y: closure of the material"""
DIMENSION_LIGHT = wp.constant(2)
DIMENSION_LIGHT_CHOICE = wp.constant(3)
"""Which light, where a tree is deep"""
DIMENSION_ROULETTE = wp.constant(4)
DIMENSION_RESAMPLE = wp.constant(5)
"""Which of a few light samples"""

# Warp writes literals above 2^31 as signed numbers; typed constants keep them unsigned.
BITS_846CA68B = wp.constant(wp.uint32(0x846CA68B))
BITS_9E3779B9 = wp.constant(wp.uint32(0x9E3779B9))
BITS_85EBCA6B = wp.constant(wp.uint32(0x85EBCA6B))

# Steps from one point of a sequence of pairs to the next: 1 / g and 1 / g^2 of the plastic number g (Roberts 2018).
STEP_X = wp.constant(0.7548777)
STEP_Y = wp.constant(0.5698403)
# The same of one number, as of those that choose lights: the golden ratio's.
STEP_REFILL = wp.constant(0.6180340)

# The largest float that numbers rescaled to [0, 1) may reach.
BELOW_ONE = wp.constant(0.9999999)


@wp.func
def fraction(x: float) -> float:
    """Return the part after the point, below 1."""
    return wp.min(x - wp.floor(x), BELOW_ONE)


@wp.func
def hash32(value: wp.uint32) -> wp.uint32:
    """Mix 32 bits (the `lowbias32` constants of Wellons' integer hash prospector)."""
    v = value
    v = v ^ (v >> wp.uint32(16))
    v = v * wp.uint32(0x7FEB352D)
    v = v ^ (v >> wp.uint32(15))
    v = v * BITS_846CA68B
    v = v ^ (v >> wp.uint32(16))
    return v


@wp.func
def hash_combine(seed: wp.uint32, value: wp.uint32) -> wp.uint32:
    """Mix a value into a seed."""
    return hash32(seed ^ (value * BITS_9E3779B9 + BITS_85EBCA6B))


# Compilers don't see that these shifts are one instruction of a GPU.
@wp.func_native("""
#ifdef __CUDA_ARCH__
    return __brev(value);
#else
    wp::uint32 v = value;
    v = (v << 16) | (v >> 16);
    v = ((v & 0x00FF00FFu) << 8) | ((v & 0xFF00FF00u) >> 8);
    v = ((v & 0x0F0F0F0Fu) << 4) | ((v & 0xF0F0F0F0u) >> 4);
    v = ((v & 0x33333333u) << 2) | ((v & 0xCCCCCCCCu) >> 2);
    v = ((v & 0x55555555u) << 1) | ((v & 0xAAAAAAAAu) >> 1);
    return v;
#endif
""")
def reverse_bits(value: wp.uint32) -> wp.uint32:
    """Reverse the order of 32 bits."""
    ...


@wp.func
def laine_karras(value: wp.uint32, seed: wp.uint32) -> wp.uint32:
    """Permute so that each bit depends on lower bits only (Laine and Karras 2011; constants of Vegdahl 2021)."""
    v = value
    v = v ^ (v * wp.uint32(0x3D20ADEA))
    v = v + seed
    v = v * ((seed >> wp.uint32(16)) | wp.uint32(1))
    v = v ^ (v * wp.uint32(0x05526C56))
    v = v ^ (v * wp.uint32(0x53A22864))
    return v


@wp.func
def sobol_second(reversed_index: wp.uint32) -> wp.uint32:
    """Return the second Sobol coordinate, as a left-aligned fraction, of a bit-reversed index.

    Its generator matrix is Pascal's triangle modulo 2, which five masked shifts apply
    (Ahmed, "An Implementation Algorithm of 2D Sobol Sequence", 2024). `reversed_index` holds bit 0 of the index at
    the top.
    """
    v = reversed_index
    v = v ^ (v << wp.uint32(16))
    v = v ^ ((v & wp.uint32(0x00FF00FF)) << wp.uint32(8))
    v = v ^ ((v & wp.uint32(0x0F0F0F0F)) << wp.uint32(4))
    v = v ^ ((v & wp.uint32(0x33333333)) << wp.uint32(2))
    v = v ^ ((v & wp.uint32(0x55555555)) << wp.uint32(1))
    return v


@wp.func
def to_unit(bits: wp.uint32) -> float:
    """Map 32 bits to [0, 1), exactly representable."""
    return float(bits >> wp.uint32(8)) * 5.9604645e-8


@wp.func
def sample_pair(pixel_seed: wp.uint32, index: wp.uint32, dimension: int) -> wp.vec2:
    """Return point `index` of the pixel's Owen-scrambled Sobol pair `dimension`, in [0, 1)^2."""
    seed = hash_combine(pixel_seed, wp.uint32(dimension))
    # Shuffle the order (an Owen scramble of the index), then scramble each coordinate the same way.
    shuffled = reverse_bits(laine_karras(reverse_bits(index), seed))
    first = reverse_bits(shuffled)
    second = sobol_second(first)
    x = reverse_bits(laine_karras(reverse_bits(first), hash32(seed + wp.uint32(1))))
    y = reverse_bits(laine_karras(reverse_bits(second), hash32(seed + wp.uint32(2))))
    return wp.vec2(to_unit(x), to_unit(y))


@wp.func
def sample_number(pixel_seed: wp.uint32, index: wp.uint32, dimension: int) -> float:
    """Return the first of sample_pair's numbers."""
    seed = hash_combine(pixel_seed, wp.uint32(dimension))
    shuffled = reverse_bits(laine_karras(reverse_bits(index), seed))
    return to_unit(reverse_bits(laine_karras(shuffled, hash32(seed + wp.uint32(1)))))


@wp.func
def hashed_unit(seed: wp.uint32, value: wp.uint32) -> float:
    """Return a white-noise number in [0, 1)."""
    return to_unit(hash_combine(seed, value))


@wp.func
def pixel_seed_of(x: int, y: int, seed: int) -> wp.uint32:
    """Return the seed of a pixel's sequences."""
    return hash_combine(hash_combine(hash32(wp.uint32(seed) + wp.uint32(0x68BC21EB)), wp.uint32(x)), wp.uint32(y))


@wp.func
def sample_disk(u: wp.vec2) -> wp.vec2:
    """Map the unit square to the unit disk, concentrically and uniformly (Shirley and Chiu 1997)."""
    a = 2.0 * u[0] - 1.0
    b = 2.0 * u[1] - 1.0
    if a == 0.0 and b == 0.0:
        return wp.vec2(0.0, 0.0)
    r = a
    phi = 0.78539816 * (b / wp.where(a == 0.0, 1.0, a))
    if wp.abs(b) > wp.abs(a):
        r = b
        phi = 1.57079633 - 0.78539816 * (a / b)
    return wp.vec2(r * wp.cos(phi), r * wp.sin(phi))


@wp.func
def sample_cosine(u: wp.vec2) -> wp.vec3:
    """Return a direction about +z with pdf cos / pi."""
    d = sample_disk(u)
    return wp.vec3(d[0], d[1], safe_sqrt(1.0 - d[0] * d[0] - d[1] * d[1]))


@wp.func
def sample_cone(axis: wp.vec3, one_minus_cos: float, u: wp.vec2) -> wp.vec3:
    """Return a direction uniform in the cone about `axis`; pdf 1 / (2 pi one_minus_cos).

    `one_minus_cos` is given instead of the cosine because it stays exact for narrow cones.
    """
    z = u[0] * one_minus_cos
    sin_theta = safe_sqrt(z * (2.0 - z))
    phi = TWO_PI * u[1]
    t = orthonormal_tangent(axis)
    b = wp.cross(axis, t)
    return wp.normalize(t * (sin_theta * wp.cos(phi)) + b * (sin_theta * wp.sin(phi)) + axis * (1.0 - z))


@wp.func
def sample_sphere(u: wp.vec2) -> wp.vec3:
    """Return a direction uniform over the sphere; pdf 1 / (4 pi)."""
    z = 1.0 - 2.0 * u[0]
    r = safe_sqrt(1.0 - z * z)
    phi = TWO_PI * u[1]
    return wp.vec3(r * wp.cos(phi), r * wp.sin(phi), z)


@wp.func
def sample_triangle(u: wp.vec2) -> wp.vec2:
    """Return uniform weights (second, third vertex) on a triangle, low distortion (Heitz 2019)."""
    b0 = u[0] * 0.5
    b1 = u[1] * 0.5
    offset = b1 - b0
    if offset > 0.0:
        b1 = b1 + offset
    else:
        b0 = b0 - offset
    return wp.vec2(b0, b1)
