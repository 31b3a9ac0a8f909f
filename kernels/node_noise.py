# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine's patterns: Perlin noise and its fractal sum in 3D, white noise, wave, magic, bricks.

The same numbers as Cycles 5.2 (kernel/svm/noise.h, fractal_noise.h, noisetex.h, wave.h, magic.h, brick.h and
util/hash.h): lattice noise of Perlin 2002 on Bob Jenkins' lookup3 hash.
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .geometry_math import PI, TWO_PI

HASH_SEED = wp.constant(wp.uint32(0xDEADBEEF))


@wp.func
def rotate_bits(x: wp.uint32, k: int) -> wp.uint32:
    """Return x rotated left by k bits."""
    return (x << wp.uint32(k)) | (x >> wp.uint32(32 - k))


@wp.func
def hash_words(x: wp.uint32, y: wp.uint32, z: wp.uint32, w: wp.uint32, count: int) -> wp.uint32:
    """Return lookup3's hash of the first `count` words, 1 to 4 (burtleburtle.net/bob/c/lookup3.c)."""
    seed = HASH_SEED + wp.uint32(4 * count + 13)
    a = seed + x
    b = seed
    c = seed
    if count > 1:
        b += y
    if count > 2:
        c += z
    if count > 3:
        # mix()
        a = (a - c) ^ rotate_bits(c, 4)
        c += b
        b = (b - a) ^ rotate_bits(a, 6)
        a += c
        c = (c - b) ^ rotate_bits(b, 8)
        b += a
        a = (a - c) ^ rotate_bits(c, 16)
        c += b
        b = (b - a) ^ rotate_bits(a, 19)
        a += c
        c = (c - b) ^ rotate_bits(b, 4)
        b += a
        a += w
    # final()
    c = (c ^ b) - rotate_bits(b, 14)
    a = (a ^ c) - rotate_bits(c, 11)
    b = (b ^ a) - rotate_bits(a, 25)
    c = (c ^ b) - rotate_bits(b, 16)
    a = (a ^ c) - rotate_bits(c, 4)
    b = (b ^ a) - rotate_bits(a, 14)
    return (c ^ b) - rotate_bits(b, 24)


@wp.func
def hash_floats(x: float, y: float, z: float, w: float, count: int) -> float:
    """Return a number in [0, 1] from the bits of the first `count` arguments."""
    h = hash_words(
        wp.cast(x, wp.uint32), wp.cast(y, wp.uint32), wp.cast(z, wp.uint32), wp.cast(w, wp.uint32), count)
    return float(h) * (1.0 / 4294967295.0)


@wp.func
def lattice_gradient(x: int, y: int, z: int, d: wp.vec3) -> float:
    """Return the dot product of d with the gradient at a lattice point: one of 12 edge directions of a cube."""
    h = int(hash_words(wp.uint32(x), wp.uint32(y), wp.uint32(z), wp.uint32(0), 3) & wp.uint32(15))
    u = wp.where(h < 8, d[0], d[1])
    v = wp.where(h < 4, d[1], wp.where(h == 12 or h == 14, d[0], d[2]))
    return wp.where((h & 1) != 0, -u, u) + wp.where((h & 2) != 0, -v, v)


@wp.func
def fade(t: float) -> float:
    """Return Perlin's quintic."""
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0)


@wp.func
def fold(x: float) -> float:
    """Return x folded into +-100000, where float still resolves the lattice."""
    return wp.mod(x, 100000.0) + wp.where(wp.abs(x) >= 1000000.0, 0.5, 0.0)


@wp.func
def perlin_noise(p: wp.vec3) -> float:
    """Return signed Perlin noise in 3D, scaled to about +-1."""
    q = wp.vec3(fold(p[0]), fold(p[1]), fold(p[2]))
    cell = wp.vec3(wp.floor(q[0]), wp.floor(q[1]), wp.floor(q[2]))
    d = q - cell
    x = int(cell[0])
    y = int(cell[1])
    z = int(cell[2])
    u = fade(d[0])
    v = fade(d[1])
    w = fade(d[2])
    sum = float(0.0)
    for k in range(8):
        i = k & 1
        j = (k >> 1) & 1
        m = k >> 2
        offset = wp.vec3(float(i), float(j), float(m))
        weight = wp.where(i == 1, u, 1.0 - u) * wp.where(j == 1, v, 1.0 - v) * wp.where(m == 1, w, 1.0 - w)
        sum += weight * lattice_gradient(x + i, y + j, z + m, d - offset)
    return 0.9820 * sum


@wp.func
def fractal_noise(p: wp.vec3, detail: float, roughness: float, lacunarity: float, normalize: bool) -> float:
    """Return the sum of detail + 1 octaves (the last one partly), to 0..1 if normalised."""
    octaves = int(detail)
    rest = detail - wp.floor(detail)
    scale = float(1.0)
    amplitude = float(1.0)
    reach = float(0.0)
    sum = float(0.0)
    for _ in range(octaves + 1):
        sum += perlin_noise(p * scale) * amplitude
        reach += amplitude
        amplitude *= roughness
        scale *= lacunarity
    more = sum
    more_reach = reach
    if rest != 0.0:
        more = sum + perlin_noise(p * scale) * amplitude
        more_reach = reach + amplitude
    if normalize:
        return wp.lerp(0.5 * sum / reach + 0.5, 0.5 * more / more_reach + 0.5, rest)
    return wp.lerp(sum, more, rest)


@wp.func
def random_offset(seed: float) -> wp.vec3:
    """Return a far-off place to sample independent noise from."""
    return wp.vec3(
        100.0 + 100.0 * hash_floats(seed, 0.0, 0.0, 0.0, 2),
        100.0 + 100.0 * hash_floats(seed, 1.0, 0.0, 0.0, 2),
        100.0 + 100.0 * hash_floats(seed, 2.0, 0.0, 0.0, 2),
    )


@wp.func
def noise(sub: int, co: wp.vec3, b: wp.vec4, c: wp.vec4) -> wp.vec3:
    """Return the noise texture's factor, or its colour: three independent noises."""
    p = co
    if c[0] != 0.0:
        p += wp.vec3(
            perlin_noise(co + random_offset(0.0)),
            perlin_noise(co + random_offset(1.0)),
            perlin_noise(co + random_offset(2.0)),
        ) * c[0]
    detail = wp.clamp(b[0], 0.0, 15.0)
    roughness = wp.max(b[1], 0.0)
    channels = wp.where(sub == codes.PROCEDURAL_NOISE_COLOR, 3, 1)
    value = wp.vec3(0.0)
    for i in range(channels):
        q = p
        if i > 0:
            q = p + random_offset(float(2 + i))
        value[i] = fractal_noise(q, detail, roughness, b[2], c[1] != 0.0)
    if channels == 1:
        return wp.vec3(value[0])
    return value


@wp.func
def white_noise(sub: int, p: wp.vec3, w: float) -> wp.vec3:
    """Return a random number, or colour, per coordinate of one to four dimensions."""
    count = (sub - codes.PROCEDURAL_WHITE_NOISE_1) % 4 + 1
    x = hash_floats(p[0], p[1], p[2], w, count)
    if sub < codes.PROCEDURAL_WHITE_NOISE_COLOR_1:
        return wp.vec3(x)
    if count == 1:
        return wp.vec3(x, hash_floats(p[0], 1.0, 0.0, 0.0, 2), hash_floats(p[0], 2.0, 0.0, 0.0, 2))
    if count == 2:
        return wp.vec3(x, hash_floats(p[0], p[1], 1.0, 0.0, 3), hash_floats(p[0], p[1], 2.0, 0.0, 3))
    if count == 3:
        return wp.vec3(x, hash_floats(p[0], p[1], p[2], 1.0, 4), hash_floats(p[0], p[1], p[2], 2.0, 4))
    return wp.vec3(x, hash_floats(p[2], p[0], w, p[1], 4), hash_floats(w, p[2], p[1], p[0], 4))


@wp.func
def wave_profile(phase: float, profile: int) -> float:
    """Return a wave of period 2 pi: sine, saw or triangle."""
    if profile == 0:
        return 0.5 + 0.5 * wp.sin(phase - 0.5 * PI)
    turns = phase / TWO_PI
    if profile == 1:
        return turns - wp.floor(turns)
    return wp.abs(turns - wp.floor(turns + 0.5)) * 2.0


@wp.func
def magic(p: wp.vec3, depth: int, distortion: float) -> wp.vec3:
    """Return the magic texture: sines of sums of sines, one more per step of depth."""
    q = wp.vec3(wp.mod(p[0], TWO_PI), wp.mod(p[1], TWO_PI), wp.mod(p[2], TWO_PI))
    x = wp.sin((q[0] + q[1] + q[2]) * 5.0)
    y = wp.cos((-q[0] + q[1] - q[2]) * 5.0)
    z = -wp.cos((-q[0] - q[1] + q[2]) * 5.0)
    if depth > 0:
        x *= distortion
        z *= distortion
        y = -wp.cos(x - y * distortion + z) * distortion
    if depth > 1:
        x = wp.cos(x - y - z) * distortion
    if depth > 2:
        z = wp.sin(-x - y - z) * distortion
    if depth > 3:
        x = -wp.cos(-x + y - z) * distortion
    if depth > 4:
        y = -wp.sin(-x + y + z) * distortion
    if depth > 5:
        y = -wp.cos(-x + y + z) * distortion
    if depth > 6:
        x = wp.cos(x + y + z) * distortion
    if depth > 7:
        z = wp.sin(x + y - z) * distortion
    if depth > 8:
        x = -wp.cos(-x - y + z) * distortion
    if depth > 9:
        y = -wp.sin(x - y + z) * distortion
    scale = wp.where(distortion != 0.0, 0.5 / distortion, 1.0)
    return wp.vec3(0.5) - wp.vec3(x, y, z) * scale


@wp.func
def brick(p: wp.vec3, b: wp.vec4, c: wp.vec4) -> wp.vec3:
    """Return (random number of the brick, distance to its edge, 0)."""
    row = int(wp.floor(p[1] / c[2]))
    width = c[1]
    offset = float(0.0)
    offset_frequency = int(b[1])
    squash_frequency = int(c[0])
    if offset_frequency != 0 and squash_frequency != 0:
        if row % squash_frequency == 0:
            width *= b[2]
        if row % offset_frequency != 0:
            offset = 0.0
        else:
            offset = width * b[0]
    number = int(wp.floor((p[0] + offset) / width))
    x = p[0] + offset - width * float(number)
    y = p[1] - c[2] * float(row)
    n = (wp.uint32((row << 16) + (number & 65535)) + wp.uint32(1013)) & wp.uint32(0x7FFFFFFF)
    n = (n >> wp.uint32(13)) ^ n
    n = (n * (n * n * wp.uint32(60493) + wp.uint32(19990303)) + wp.uint32(1376312589)) & wp.uint32(0x7FFFFFFF)
    edge = wp.min(wp.min(x, y), wp.min(width - x, c[2] - y))
    return wp.vec3(0.5 * float(n) / 1073741824.0, edge, 0.0)


@wp.func
def mortar(edge: float, size: float, smoothness: float) -> float:
    """Return the share of mortar at a distance from the brick's edge."""
    if edge >= size:
        return 0.0
    if smoothness == 0.0:
        return 1.0
    t = wp.clamp((1.0 - edge / size) / smoothness, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def noise_texture(sub: int, a: wp.vec4, b: wp.vec4, c: wp.vec4) -> wp.vec4:
    """Evaluate a pattern (codes.PROCEDURAL_NOISE and later)."""
    p = wp.vec3(a[0], a[1], a[2])
    v = wp.vec3(0.0)
    if sub <= codes.PROCEDURAL_NOISE_COLOR:
        v = noise(sub, p, b, c)
    elif sub == codes.PROCEDURAL_WAVE:
        v = wp.vec3(wave_profile(p[0], int(b[0])))
    elif sub == codes.PROCEDURAL_MAGIC:
        v = magic(p, int(b[0]), b[1])
    elif sub == codes.PROCEDURAL_BRICK:
        v = brick(p, b, c)
    elif sub == codes.PROCEDURAL_BRICK_MORTAR:
        v = wp.vec3(mortar(p[0], b[0], b[1]))
    else:
        v = white_noise(sub, p, b[0])
    return wp.vec4(v[0], v[1], v[2], 0.0)
