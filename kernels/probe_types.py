# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: the pool of probes in the world, the screen's tiles, and the probes updated in a frame.

A probe lies at a point on a surface and holds the light that arrives there from 8 x 8 directions (probe_map.py). It is
anchored in the world and owned by a slot of the pool, so it moves only when it is updated: nothing is blurred by
resampling from frame to frame, and probes that leave the picture are still there when it comes back. The published
method (GI-1.0, section 3) resamples probes from tile to tile and keeps lost ones in a second store.
"""

from __future__ import annotations

import warp as wp

TILE = wp.constant(8)
"""Side of a screen tile [px], and of a probe's map [cells]"""
CELLS = wp.constant(64)
"""Directions of a probe, and its rays a frame"""
BANDS = wp.constant(10)
"""Spherical harmonics up to l = 2, and a correction along the normal (probe_map.band_basis)"""
FAR = wp.constant(5.9e4)
"""From this distance [m] on only the direction counts; rays that meet nothing give MISS_DISTANCE (probe_rays.py)"""
NO_CELL = wp.constant(255)
"""ProbeUpdates.cell of a ray that isn't counted in the probe's map"""


@wp.struct
class ProbeGrid:
    """Sizes and switches; fixed while a recorded frame is replayed."""

    width: int
    height: int
    tile_columns: int
    tile_rows: int
    update_columns: int
    update_rows: int
    side: int
    """Tiles along one side of a spawn tile; each spawn tile updates one probe a frame"""
    slots: int
    """Probes in the pool, a multiple of the spawn tiles"""
    persistent: int
    guided: int
    filtered: int
    specular: int
    interval: int
    """Frames of which an update that may wait has one while something moves"""
    half_rate: int
    """1: while only the camera moves, pixels that know their light get none in every other frame"""
    exact: int
    """0: the published estimator"""
    history: float
    """Most frames that a probe averages over while something moves"""
    luminance: wp.vec3
    """Weights of the working space's primaries"""


@wp.struct
class ProbePool:
    """All probes. `used`, `updated` and `born` count frames from 1; a slot whose `used` is 0 is free."""

    position: wp.array[wp.vec3]
    center: wp.array[wp.vec3]
    """Mean of the places of the updates that the mean is over: what `irradiance` is the light of"""
    normal: wp.array[wp.uint32]
    """pack_normal of the surface's geometric normal, the axis of the map"""
    radiance: wp.array[wp.vec4h]
    """[slot * 64 + cell] exposed radiance; w = distance to what is seen [m], at most MISS_DISTANCE"""
    irradiance: wp.array[wp.vec4]
    """[slot * 10 + band] coefficients of exposed irradiance / pi in the frame about the normal"""
    residual: wp.array[wp.vec4]
    """[slot * 10 + band] what the cells' means miss of each coefficient (probe_light.py); w = updates in this mean"""
    clear: wp.array[float]
    """Least distance in `radiance` [m]: nothing stands nearer"""
    count: wp.array[float]
    """Updates that the mean in `radiance` is over"""
    noise: wp.array[float]
    """Mean square of the updates' departures from the history (probe_blend.detect_changes)"""
    used: wp.array[int]
    """Last frame in which it stood for a tile"""
    updated: wp.array[int]
    born: wp.array[int]
    updates: wp.array[int]
    """Times that the slot has been updated: index of its random sequences"""
    tile: wp.array[int]
    """Tile on which the probe lies in this frame, -1 off screen or hidden"""


@wp.struct
class ProbeTiles:
    """The screen in squares of 8 x 8 pixels."""

    seed: wp.array[int]
    """Pixel at which a probe would be put in this frame, -1 where there is only sky"""
    claim: wp.array[wp.int64]
    """Best probe on the tile: frame of its update << 32 | slot; -1 none"""
    claim_other: wp.array[wp.int64]
    """Best among those on another surface"""
    probe: wp.array[int]
    """Slot, -1 none; after the updates of this frame the updated one"""
    other: wp.array[int]
    """Slot of a probe on another surface, -1 none"""
    empty: wp.array[int]
    """1 where a probe is missing (find_missing); at last only where the spawn tile's own update goes elsewhere"""
    rank: wp.array[int]
    """Inclusive prefix sum of `empty`"""
    empty_list: wp.array[int]


@wp.struct
class ProbeUpdates:
    """The probes updated in a frame, one for each spawn tile."""

    own: wp.array[int]
    """Tile of the spawn tile that needs an update most, -1 where there is only sky"""
    free: wp.array[int]
    """1 where `own` can wait: it misses no probe"""
    rank: wp.array[int]
    """Inclusive prefix sum of `free`"""
    tile: wp.array[int]
    """Tile that is updated, -1 none"""
    pixel: wp.array[int]
    slot: wp.array[int]
    """-1: idle"""
    fresh: wp.array[int]
    """1 where the slot is filled anew, 0 where its probe is updated in place"""
    position: wp.array[wp.vec3]
    error: wp.array[float]
    """How far rays start off the surface [m]"""
    normal: wp.array[wp.uint32]
    specular: wp.array[int]
    """Rays that go into the reflection"""
    count: wp.array[float]
    """Updates that `previous` is the mean of, 0: nothing that counts is known"""
    change: wp.array[float]
    """New light over that known before where it has changed, else 1"""
    covered: wp.array[int]
    """Cells with a `previous`"""
    previous: wp.array[wp.vec4h]
    """[update * 64 + cell] radiance known before, distance; w < 0: unknown"""
    guide: wp.array[float]
    """[update * 64 + cell] what light the cell is thought to bring; < 0: unknown"""
    residual: wp.array[wp.vec4]
    """[update * 10 + band] of a new probe what the probes around know as ProbePool.residual; w = 0: nothing"""
    expected: wp.array[float]
    """[update * 64 + cell] mean number of rays that the cell gets in an update"""
    cell: wp.array[wp.uint8]
    """[update * 64 + ray] cell in which a ray counts, or NO_CELL"""
    neighbor: wp.array[int]
    """[update * 9 + i] probes of the 3 x 3 spawn tiles that may smooth this one, -1 none"""
    filtered: wp.array[wp.vec4h]
    """[update * 64 + cell] radiance smoothed over neighbouring probes"""
