# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays of probes and cells that go on over mirrors: cells know no directions. Functions only, no kernels.

A cell on a mirror sends out on all sides what it gets, so that what a mirror shows would light the room evenly instead
of the wall and the floor before it. Where a hit reflects mostly, and sharply, its ray goes on by chance with what is
reflected, and with the rest of the chances it ends there with the rest of the albedo.
"""

from __future__ import annotations

import warp as wp

from .environment_split import soft_radiance
from .geometry_math import mean_component
from .ggx import reflect_about
from .homes import NOWHERE, home_row
from .intersect import offset_origin
from .lamp_hit import FAR
from .normals import valid_specular_normal
from .packing import rgb
from .paths import ENDED, Paths
from .reflectance import BsdfAlbedo, whole_albedo
from .sampling import hash_combine, hashed_unit
from .types import Scene, ShadingPoint
from .view import View

# Perceptual roughness below which a reflection counts as a mirror's.
FOLLOWED_ROUGHNESS = wp.constant(0.2)
# Share of its albedo from which on a surface mostly shows what it reflects, and with which rays go on at most; albedo
# of what is reflected below which that is too little to matter: dark varnish, all that is no metal but seen at grazing.
FOLLOWED_SHARE = wp.constant(0.3)
FOLLOWED_MOST = wp.constant(0.95)
FOLLOWED_ALBEDO = wp.constant(0.2)
# Exposed luminance to which light is limited that such rays meet. Samples of light know no way over mirrors, so these
# rays bring all that lamps and suns send over them; small ones are met so seldom that they would be sparks.
FOLLOWED_LIGHT = wp.constant(256.0)

STREAM_MIRROR = wp.constant(wp.uint32(0x4D495252))

# Mirrors.state of rays over a mirror: apart from what rays have before, for the random numbers of layers.
FOLLOWED = wp.constant(2)
# The same over a mirror that has ever moved.
FOLLOWED_MOVED = wp.constant(3)


@wp.struct
class Mirrors:
    """The frame's rays over mirrors, a slot each as for all rays; without elements where a scene has no mirrors."""

    state: wp.array[int]
    """FOLLOWED or FOLLOWED_MOVED, or ENDED for rays that end where they first hit"""
    weight: wp.array[wp.vec4]
    """What arrives of what they meet; w = length of the way before the mirror [m]"""
    homes: wp.array[int]
    """Homes.of"""


@wp.func
def over_mirror(mirrors: Mirrors, slot: int) -> bool:
    """Tell whether a ray has come over a mirror."""
    return mirrors.state.shape[0] > 0 and mirrors.state[slot] != ENDED


@wp.func
def way_weight(mirrors: Mirrors, filtered: int, paths: Paths, slot: int) -> wp.vec3:
    """Return what arrives of what a ray meets: mirrors and transparent layers (`filtered` 1) take some."""
    weight = wp.vec3(1.0, 1.0, 1.0)
    if filtered == 1:
        weight = paths.throughput[slot]
    if over_mirror(mirrors, slot):
        weight = wp.cw_mul(weight, rgb(mirrors.weight[slot]))
    return weight


@wp.func
def way_before(mirrors: Mirrors, slot: int) -> float:
    """Return the length of a ray's way before the segment that it is on [m]."""
    if over_mirror(mirrors, slot):
        return mirrors.weight[slot][3]
    return 0.0


@wp.func
def limit_followed(view: View, scene: Scene, light: wp.vec3) -> wp.vec3:
    """Return a light as a ray over a mirror brings it."""
    return soft_radiance(light, FOLLOWED_LIGHT / wp.max(view.exposure, 1.0e-20), scene.luminance)


@wp.func
def mirror_chance(albedo: BsdfAlbedo, mirrors: Mirrors, slot: int) -> float:
    """Return the chance with which a ray goes on over what it has hit: 0 where that is no mirror, or its second."""
    if mirrors.state.shape[0] == 0 or mirrors.state[slot] != ENDED or albedo.roughness >= FOLLOWED_ROUGHNESS:
        return 0.0
    reflected = mean_component(albedo.reflected)
    share = reflected / wp.max(mean_component(whole_albedo(albedo)), 1.0e-20)
    follows = share > FOLLOWED_SHARE and reflected > FOLLOWED_ALBEDO
    return wp.where(follows, wp.min(share, FOLLOWED_MOST), 0.0)


@wp.func
def goes_on(chance: float, seed: wp.uint32, frame: int) -> bool:
    """Draw whether a ray goes on over a mirror."""
    return hashed_unit(hash_combine(seed, STREAM_MIRROR), wp.uint32(frame)) < chance


@wp.func
def send_over(
    point: ShadingPoint, normal: wp.vec3, weight: wp.vec3, filtered: int, paths: Paths, mirrors: Mirrors, slot: int,
):
    """Send a ray on over the mirror that it has hit; `weight` is what then arrives of what it meets."""
    n = valid_specular_normal(point.geometric_normal, point.wo, normal)
    direction = wp.normalize(reflect_about(point.wo, n))
    still = home_row(mirrors.homes, paths.hit[slot][0]) == NOWHERE
    mirrors.state[slot] = wp.where(still, FOLLOWED, FOLLOWED_MOVED)
    mirrors.weight[slot] = wp.vec4(weight[0], weight[1], weight[2], point.ray_length)
    paths.origin[slot] = offset_origin(point.position, point.geometric_normal, point.error, direction)
    paths.direction[slot] = direction
    paths.t[slot] = FAR
    if filtered == 1:
        paths.throughput[slot] = wp.vec3(1.0, 1.0, 1.0)
