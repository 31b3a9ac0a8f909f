# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: what pixels need of a tile's probes, in few words that load at once.

The light's harmonics are turned into world space here, once a probe, so that a pixel evaluates its basis once for all
probes around it. Two records a tile (ProbeTiles.probe and .other) of 128 bytes, a line of the cache each.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import luminance, orthonormal_tangent
from .packed_halves import pack_halves
from .packing import pack_floats, rgb, rgba, unpack_normal
from .probe_gather import outdated
from .probe_types import BANDS, ProbeGrid, ProbePool, ProbeTiles
from .view import View, project

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

RECORD = wp.constant(8)
"""Pieces of 16 bytes: film position, clear distance, slot; centre, normal's x; normal's y, z; 10 bands (rgb, and
luminance; in the first trust instead), two a piece"""
RECORD_CENTER = wp.constant(1)
RECORD_NORMAL = wp.constant(2)
RECORD_BANDS = wp.constant(3)
RECORD_WORDS = wp.constant(16)

# Weight of a probe that holds the light from before an edit, beside others.
OUTDATED_TRUST = wp.constant(0.01)

# No probe: farther than any pixel.
OFF_FILM = wp.constant(1.0e9)

WorldBands = wp.types.vector(length=9, dtype=wp.float32)


@wp.func
def world_basis(d: wp.vec3) -> WorldBands:
    """Return the functions that the coefficients of a record belong to.

    1; x, y, z; x^2 - z^2, y^2 - z^2, 2 x y, 2 y z, 2 x z: the last five take a traceless symmetric matrix.
    """
    x = d[0]
    y = d[1]
    z = d[2]
    return WorldBands(1.0, x, y, z, x * x - z * z, y * y - z * z, 2.0 * x * y, 2.0 * y * z, 2.0 * x * z)


@wp.func
def world_coefficients(pool: ProbePool, slot: int, n: wp.vec3, c: int) -> WorldBands:
    """Return one colour's coefficients in world_basis; the pool holds those of probe_map.band_basis about n."""
    i = slot * BANDS
    t = orthonormal_tangent(n)
    b = wp.cross(n, t)
    v = (t * pool.irradiance[i + 3][c] + b * pool.irradiance[i + 1][c] + n * pool.irradiance[i + 2][c]) * 0.48860251
    xy = 0.54627422 * pool.irradiance[i + 4][c]
    yz = 0.54627422 * pool.irradiance[i + 5][c]
    xz = 0.54627422 * pool.irradiance[i + 7][c]
    up = 0.31539157 * pool.irradiance[i + 6][c]
    across = 0.54627422 * pool.irradiance[i + 8][c]
    # Rows of the local matrix, each turned into world space; then the columns.
    mt = t * (across - up) + b * xy + n * xz
    mb = t * xy - b * (across + up) + n * yz
    mn = t * xz + b * yz + n * (2.0 * up)
    m = wp.outer(t, mt) + wp.outer(b, mb) + wp.outer(n, mn)
    return WorldBands(
        0.28209479 * pool.irradiance[i][c], v[0], v[1], v[2], m[0, 0], m[1, 1], m[0, 1], m[1, 2], m[0, 2])


@wp.kernel
def record_probes(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    tiles: ProbeTiles,
    pool: ProbePool,
    # Out:
    records_out: wp.array[wp.uint64],
):
    """Make the record of one of the two probes of a tile."""
    index = first + wp.tid()
    base = index * RECORD_WORDS
    slot = wp.where(index % 2 == 0, tiles.probe[index // 2], tiles.other[index // 2])
    if slot < 0:
        records_out[base] = pack_floats(OFF_FILM, OFF_FILM)
        return
    view = views[0]
    center = pool.center[slot]
    film = project(view.camera, center)
    records_out[base] = pack_floats(film[0], film[1])
    n = unpack_normal(pool.normal[slot])
    records_out[base + 1] = pack_floats(pool.clear[slot], wp.cast(slot, float))
    records_out[base + 2] = pack_floats(center[0], center[1])
    records_out[base + 3] = pack_floats(center[2], n[0])
    records_out[base + 4] = pack_floats(n[1], n[2])
    red = world_coefficients(pool, slot, n, 0)
    green = world_coefficients(pool, slot, n, 1)
    blue = world_coefficients(pool, slot, n, 2)
    trust = wp.where(outdated(view, pool, slot), OUTDATED_TRUST, 1.0)
    bands = base + 2 * RECORD_BANDS
    records_out[bands] = pack_halves(wp.vec4(red[0], green[0], blue[0], trust))
    for k in range(1, 9):
        c = wp.vec3(red[k], green[k], blue[k])
        records_out[bands + k] = pack_halves(rgba(c, luminance(c, grid.luminance)))
    records_out[bands + 9] = pack_halves(rgba(rgb(pool.irradiance[slot * BANDS + 9]), trust))
