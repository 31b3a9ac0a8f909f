# SPDX-License-Identifier: GPL-3.0-or-later
"""States of the paths that the path tracer's kernels hand to each other, and how light is added to them."""

from __future__ import annotations

import warp as wp

from .geometry_math import is_finite3, max_component
from .intersect import MISS, Hit, Layer, surface_point
from .known_light import BOUNCES, KnownLight, is_ending
from .sampling import DIMENSION_FIRST_BOUNCE, DIMENSION_ROULETTE, DIMENSIONS_PER_BOUNCE, sample_number
from .shading_types import Closure, ShadingPoint
from .types import Scene

# Paths.state
ENDED = wp.constant(-1)

# A material's program must be evaluated before a shadow ray's light counts.
PENDING_NONE = wp.constant(0)
PENDING_TRIANGLE = wp.constant(1)
PENDING_WORLD = wp.constant(2)

# Bounces (Cycles' usual limit in comparisons) after which paths are ended harder and may not gain energy.
LONG_PATH = wp.constant(32)
# Largest chance with which they go on. Less would weigh the few that are left the more: their share falls by it in each
# bounce, the square of their weight rises by it, without bound where its root is less than an albedo. More makes single
# samples wait for the longest of their paths, between mirrors and in glass: 0.97 made them a third slower.
LONG_SURVIVAL = wp.constant(0.92)
# The same for paths off anything but mirrors and clear glass after Options.ended_harder bounces.
HARD_SURVIVAL = wp.constant(0.88)
# Weight from which on they are ended harder no more: else the squares of weights would grow without bound wherever the
# root of the chance is less than an albedo.
HEAVY_PATH = wp.constant(8.0)
# Largest chance with which any path of a picture of few samples goes on, whatever it weighs, as its longest paths alone
# are waited for: from so many bounces sooner on, off mirrors and clear glass so many later.
FEW_SURVIVAL = wp.constant(0.75)
SOONER = wp.constant(2)
LATER = wp.constant(4)

@wp.struct
class Options:
    """Settings of the path tracer that kernels read; from `programs` on its host alone: they choose the kernels."""

    max_bounces: int
    roulette_start: int
    ended_harder: int
    """Bounces after which few paths go on, where all wait for the last of them; 0: as LONG_PATH says"""
    clamp_direct: float
    """0: off"""
    clamp_indirect: float
    transparent: int
    """1: the world behind the scene leaves alpha 0"""
    exposure: float
    passes: int
    """1: write Paths.surface_* and emission, environment at the first hit"""
    filtered: int
    """1: the scene has triangles that need a test per hit"""
    programs: int
    """1: lights may be programs (textured emitters, a world that varies)"""
    all_lean: int
    """1: the lean node machine runs all surface programs"""
    all_plain: int
    """1: it runs those with glass in them too, if there are any"""
    lean_layers: int
    """1: it runs all transparency programs"""
    subsurface: int
    """1: some scatter light below the surface"""
    subsurface_bump: int
    """1: some of those bend normals"""
    films: int
    """1: some surfaces have a thin film"""
    known: KnownLight
    """In which paths may end"""


@wp.struct
class Paths:
    """States of all paths under way, one slot a path."""

    state: wp.array[int]
    """Bounces so far, or ENDED"""
    seed: wp.array[wp.uint32]
    """Of the pixel"""
    index: wp.array[wp.uint32]
    """Sample index"""
    few: wp.array[int]
    """[1] 1: the picture is going to have few samples, whose longest paths are waited for; without it they are many"""
    origin: wp.array[wp.vec3]
    direction: wp.array[wp.vec3]
    t: wp.array[float]
    """Before tracing the ray's limit, after it the hit's distance"""
    hit: wp.array[wp.vec2i]
    """(instance, triangle); instance MISS for none"""
    barycentrics: wp.array[wp.vec2]
    throughput: wp.array[wp.vec3]
    radiance: wp.array[wp.vec4]
    """Gathered so far; w = alpha"""
    pdf: wp.array[float]
    """Of the BSDF sample that made the ray; 0 for camera rays and mirrors"""
    side: wp.array[wp.vec3]
    """Normal of the surface that the ray has left if no light from behind it counts there, else zero"""
    kind: wp.array[int]
    """VISIBLE_* bit of the ray; of the path tracer's also the numbers of depth_place"""
    receiver: wp.array[int]
    """Instance that the ray has left; written and read where lights are linked alone (light_linking.py)"""
    clear_way: wp.array[wp.vec4]
    """Where the scene has clear glass: direction in which a path has come to the glass that it is in, and how far back,
    through such glass, the surface is that it has left (clear_paths.py)"""
    cone: wp.array[wp.vec2]
    """Width [m] at the origin, spread [rad]"""
    layer_t: wp.array[float]
    """Distance to the first triangle that needs a test, before the opaque hit or the light"""
    layer: wp.array[wp.vec2i]
    """(instance, triangle) of it; instance MISS for none"""
    layer_barycentrics: wp.array[wp.vec2]
    overruns: wp.array[int]
    """Rays of the path that met more transparent layers than are looked through"""
    closure: wp.array[Closure]
    """What the material of the hit says"""
    shadow_origin: wp.array[wp.vec3]
    shadow_direction: wp.array[wp.vec3]
    shadow_distance: wp.array[float]
    """0: no shadow ray"""
    shadow_light: wp.array[wp.vec3]
    """What arrives if nothing is in between"""
    shadow_pending: wp.array[int]
    shadow_emitter: wp.array[wp.vec2i]
    shadow_barycentrics: wp.array[wp.vec2]
    surface_normal: wp.array[wp.vec4]
    """First hit: normal, depth"""
    surface_position: wp.array[wp.vec4]
    """First hit: position, object index"""
    surface_uv: wp.array[wp.vec4]
    """First hit: u, v, 1, material index"""
    surface_emission: wp.array[wp.vec3]
    environment: wp.array[wp.vec3]
    guide_albedo: wp.array[wp.vec4]
    """What the path shows (path_guides.py), its emission added; w = bounces after which that is met, else -1. Without
    elements where no guides are collected"""
    guide_normal: wp.array[wp.vec3]
    """Of the same"""


@wp.func
def clamp_light(light: wp.vec3, limit: float) -> wp.vec3:
    """Limit the sum of the channels, as Cycles clamps; 0 is no limit."""
    total = wp.abs(light[0]) + wp.abs(light[1]) + wp.abs(light[2])
    if limit > 0.0 and total > 3.0 * limit:
        return light * (3.0 * limit / total)
    return light


@wp.func
def add_light(paths: Paths, path: int, light: wp.vec3, limit: float):
    """Add to a path's radiance; what is not finite is left out, so that one bad sample does not spoil a pixel."""
    if is_finite3(light):
        c = clamp_light(light, limit)
        r = paths.radiance[path]
        paths.radiance[path] = wp.vec4(r[0] + c[0], r[1] + c[1], r[2] + c[2], r[3])


@wp.func
def limit_at(options: Options, bounce: int) -> float:
    """Return the clamp for light met after `bounce` bounces."""
    if bounce <= 1:
        return options.clamp_direct
    return options.clamp_indirect


@wp.func
def add_shadow_light(paths: Paths, options: Options, bounce: int, path: int, light: wp.vec3):
    """Add the light of a shadow ray that got through, and end the ray."""
    add_light(paths, path, light, limit_at(options, bounce + 1))
    paths.shadow_distance[path] = 0.0


@wp.func
def make_hit(t: float, ids: wp.vec2i, barycentrics: wp.vec2) -> Hit:
    """Return a hit from the form in which states keep it: distance, (instance, triangle), weights."""
    hit = Hit()
    hit.t = t
    hit.instance = ids[0]
    hit.triangle = ids[1]
    hit.u = barycentrics[0]
    hit.v = barycentrics[1]
    return hit


@wp.func
def load_hit(paths: Paths, path: int) -> Hit:
    """Return the hit that a path has found."""
    return make_hit(paths.t[path], paths.hit[path], paths.barycentrics[path])


@wp.func
def store_hit(paths: Paths, path: int, hit: Hit):
    """Store the hit that a path has found."""
    paths.t[path] = hit.t
    paths.hit[path] = wp.vec2i(hit.instance, hit.triangle)
    paths.barycentrics[path] = wp.vec2(hit.u, hit.v)


@wp.func
def load_layer(paths: Paths, path: int) -> Hit:
    """Return the first triangle on the way that needs a test."""
    return make_hit(paths.layer_t[path], paths.layer[path], paths.layer_barycentrics[path])


@wp.func
def store_layer(paths: Paths, path: int, hit: Hit):
    """Store the first triangle on the way that needs a test."""
    paths.layer_t[path] = hit.t
    paths.layer[path] = wp.vec2i(hit.instance, hit.triangle)
    paths.layer_barycentrics[path] = wp.vec2(hit.u, hit.v)


@wp.func
def take_layer(paths: Paths, path: int, layer: Layer):
    """Store the first triangle on the way that needs a test; one that is known to be solid is the path's hit."""
    if layer.solid == 1:
        store_hit(paths, path, layer.hit)
        paths.layer[path] = wp.vec2i(MISS, 0)
    else:
        store_layer(paths, path, layer.hit)


@wp.func
def has_hit(paths: Paths, path: int) -> bool:
    """Return whether a path lives and its ray has met a surface."""
    return paths.state[path] != ENDED and paths.hit[path][0] != MISS


@wp.func
def has_layers(paths: Paths, path: int) -> bool:
    """Return whether a path lives and a triangle that needs a test stands in the way of its ray."""
    return paths.state[path] != ENDED and paths.layer[path][0] != MISS


@wp.func
def has_shadow_layers(paths: Paths, path: int) -> bool:
    """Return whether there is a shadow ray and a triangle that needs a test stands in its way."""
    return paths.shadow_distance[path] != 0.0 and paths.layer[path][0] != MISS


@wp.func
def waits_for_program(paths: Paths, path: int) -> bool:
    """Return whether a shadow ray got through to a light whose radiance is a program."""
    return paths.shadow_distance[path] != 0.0 and paths.shadow_pending[path] != PENDING_NONE


@wp.func
def hit_point(scene: Scene, paths: Paths, path: int, bounce: int) -> ShadingPoint:
    """Return a path's hit, ready for its material."""
    hit = load_hit(paths, path)
    point = surface_point(scene, hit, paths.direction[path])
    cone = paths.cone[path]
    point.footprint = cone[0] + cone[1] * hit.t
    point.ray_visibility = paths.kind[path]
    point.ray_length = hit.t
    point.ray_depth = bounce
    return point


@wp.func
def survival_chance(options: Options, bounce: int, throughput: wp.vec3, pdf: float, few: int) -> float:
    """Return the probability with which Russian roulette lets a path be shaded at its hit.

    Long paths end even where nothing absorbs: a scene may hold light between surfaces of albedo 1 for ever.

    Args:
        options: Settings of the path tracer.
        bounce: Rays of the path but for the camera's.
        throughput: Of the path.
        pdf: Density of its last ray [1/sr]; 0 for a mirror's.
        few: As Paths.few.
    """
    if bounce <= options.roulette_start:
        return 1.0
    largest = max_component(throughput)
    limit = wp.where(bounce < LONG_PATH, 1.0, LONG_SURVIVAL)
    if options.ended_harder > 0:
        if pdf > 0.0 and bounce >= options.ended_harder:
            limit = wp.min(HARD_SURVIVAL * wp.max(largest / HEAVY_PATH, 1.0), limit)
        if few == 1 and bounce >= options.ended_harder + wp.where(pdf > 0.0, -SOONER, LATER):
            limit = FEW_SURVIVAL
    # The root, as in Cycles: ending in proportion to the throughput itself would save rays at the price of noise.
    return wp.clamp(wp.sqrt(largest), 0.05, limit)


@wp.func
def shows_what_it_meets(paths: Paths, path: int, bounce: int) -> bool:
    """Tell whether a path is a guide to what it meets after so many bounces, as all before were off mirrors."""
    return paths.guide_albedo.shape[0] > 0 and paths.guide_albedo[path][3] == float(bounce)


@wp.func
def survives(options: Options, paths: Paths, path: int, bounce: int) -> bool:
    """Play Russian roulette at a hit: end the path, or let it go on with the throughput that makes up for it.

    As in Cycles, what a hit emits and the world are added before: a ray that was traced shows what it meets.
    """
    few = int(0)
    if options.ended_harder > 0 and paths.few.shape[0] > 0:
        few = paths.few[0]
    chance = survival_chance(options, bounce, paths.throughput[path], paths.pdf[path], few)
    if bounce == BOUNCES and is_ending(options.known, paths.index[path]):
        # What is known may end it here.
        chance = 1.0
    if chance < 1.0:
        dimension = DIMENSION_FIRST_BOUNCE + bounce * DIMENSIONS_PER_BOUNCE + DIMENSION_ROULETTE
        if sample_number(paths.seed[path], paths.index[path], dimension) >= chance:
            paths.state[path] = ENDED
            if shows_what_it_meets(paths, path, bounce):
                # Those that go on count for the others too.
                paths.guide_albedo[path] = wp.vec4(0.0, 0.0, 0.0, -1.0)
                paths.guide_normal[path] = wp.vec3(0.0, 0.0, 0.0)
            return False
        paths.throughput[path] = paths.throughput[path] / chance
    return True
