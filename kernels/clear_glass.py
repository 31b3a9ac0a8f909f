# SPDX-License-Identifier: GPL-3.0-or-later
"""Light through clear glass in real-time frames: rays of light go on behind it in straight lines.

Without this, glass stops every shadow ray, and rays of probes and of the radiance cache end on it as on something
white: rooms behind windows are dark, the inside of a glass case is lit by what its panes scatter. Path tracing finds
such light by chance alone, when a path that glass has bent meets a lamp, and puts right at rest what straight lines get
wrong: caustics. Through panes, whose two sides undo each other's bend, there is nothing to put right.

At each surface the share that Fresnel's equations leave passes, with the glass's tint; rays that find surfaces pass by
that chance, and are reflected otherwise: none ends on glass. Which materials are clear is told by
engine/clear_glass.py. Rays that follow what is seen in glass and mirrors (reflection_chain.py) bend as they should.

Triangles that need a test per hit are looked at after this, along the way since the last reflection. A tint counts for
rays that such a triangle stops before the glass, too.
"""

from __future__ import annotations

import warp as wp

from .flat_tracing import closest_flat
from .fresnel import fresnel_dielectric
from .geometry_math import max_component, transform_point
from .ggx import reflect_about, refract_about
from .intersect import MISS, Hit, closest_hit, triangle_material
from .paths import Paths, store_hit
from .sampling import hash_combine, hashed_unit
from .types import Geometry, Scene
from .wide_bvh import any_face_wide, any_face_with_tubes
from .wide_instances import any_face_in_instances, any_face_in_instances_with_tubes
from .wide_loads import load_corner, load_instance

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Surfaces of glass that a ray goes through; behind more of them it is dark.
MOST_SURFACES = wp.constant(8)

# How far behind a surface a ray goes on: so many times the largest coordinate and the distance, some float32 steps.
STEP = wp.constant(2.0e-6)

# Squared length that direction and straight way are apart after a piece of glass from which on it hardly counts: light
# that a ball or a lens has bent is elsewhere, as a caustic.
BEND_MAX = wp.constant(0.09)

CLEAR_STREAM = wp.constant(0x474C0000)


@wp.struct
class ClearWay:
    """A ray on its way through clear glass."""

    origin: wp.vec3
    """Where it began, or was reflected last"""
    direction: wp.vec3
    bent: wp.vec3
    """Direction that refraction would have given it; of shadow rays"""
    hit: Hit
    """Where it is, at its distance from there"""
    start: float
    """Distance from which it looks on"""
    light: wp.vec3
    """Share of light that has come through, over the chance that the ray has"""
    surfaces: int
    """Met so far"""
    inside: int
    """1: in glass; of paths' shadow rays"""
    shift: wp.vec2
    """By how much the light seems closer across its plane of incidence and in it; of paths' shadow rays"""
    again: int
    """1: it has met the same surface once more, which counts once"""
    open: int
    """1: it looks on"""


@wp.func
def first_way(origin: wp.vec3, direction: wp.vec3) -> ClearWay:
    """Return the state of a ray that has met nothing."""
    way = ClearWay()
    way.origin = origin
    way.direction = direction
    way.bent = direction
    way.hit.instance = MISS
    way.light = wp.vec3(1.0, 1.0, 1.0)
    way.open = 1
    return way


@wp.func
def clear_triangle(scene: Scene, instance: int, triangle: int) -> wp.vec4:
    """Return the tint of a triangle and its index of refraction, 0 where it isn't clear glass; see Materials.clear."""
    return scene.materials.clear[triangle_material(scene, instance, triangle)]


@wp.func
def glass_normal(scene: Scene, hit: Hit) -> wp.vec3:
    """Return the normal of a triangle, outwards."""
    row = load_instance(scene.geometry.instances, hit.instance)
    p = transform_point(row.to_world, load_corner(scene.geometry, hit.triangle, 0))
    q = transform_point(row.to_world, load_corner(scene.geometry, hit.triangle, 1))
    r = transform_point(row.to_world, load_corner(scene.geometry, hit.triangle, 2))
    return wp.normalize(wp.cross(q - p, r - p)) * wp.where(row.flipped == 1, -1.0, 1.0)


@wp.func
def take_hit(way: ClearWay, found: Hit) -> ClearWay:
    """Return a ray's state where it has looked on and found a hit or none, `found.t` from where it has looked."""
    result = way
    again = found.instance == way.hit.instance and found.triangle == way.hit.triangle
    result.hit = found
    result.hit.t = way.start + found.t
    result.surfaces = way.surfaces + wp.where(again, 0, 1)
    p = way.origin + way.direction * result.hit.t
    size = wp.max(wp.abs(p[0]), wp.max(wp.abs(p[1]), wp.abs(p[2]))) + result.hit.t
    # Twice as far where the last step was lost to rounding.
    step = wp.where(again, 2.0 * (result.hit.t - way.hit.t), 0.0)
    result.start = result.hit.t + wp.max(STEP * size, step)
    result.again = wp.where(again, 1, 0)
    return result


@wp.func
def bend(direction: wp.vec3, normal: wp.vec3, ior: float) -> wp.vec3:
    """Return a direction that a surface has refracted; the one reflected where it can't get out."""
    entering = wp.dot(direction, normal) < 0.0
    facing = wp.where(entering, normal, -normal)
    bent = refract_about(-direction, facing, wp.where(entering, ior, 1.0 / ior))
    if wp.length_sq(bent) > 0.0:
        return bent
    return reflect_about(-direction, facing)


@wp.func
def dim_at_hit(scene: Scene, way: ClearWay) -> ClearWay:
    """Return a shadow ray's state at a hit: weakened by clear glass, black at anything else."""
    result = way
    material = clear_triangle(scene, way.hit.instance, way.hit.triangle)
    if material[3] == 0.0 or way.surfaces > MOST_SURFACES:
        result.light = wp.vec3(0.0, 0.0, 0.0)
        result.open = 0
        return result
    normal = glass_normal(scene, way.hit)
    cosine = wp.dot(normal, way.direction)
    ior = wp.abs(material[3])
    passing = 1.0 - fresnel_dielectric(cosine, ior)[0]
    result.bent = bend(way.bent, normal, ior)
    if cosine > 0.0:
        # It leaves the glass.
        passing = passing * wp.exp(-wp.length_sq(result.bent - way.direction) / BEND_MAX)
    result.light = wp.cw_mul(way.light, wp.vec3(material[0], material[1], material[2])) * passing
    if max_component(result.light) <= 0.0:
        result.open = 0
    return result


@wp.func
def pass_by_chance(scene: Scene, way: ClearWay, seed: wp.uint32) -> ClearWay:
    """Return a ray's state at a hit: from clear glass it goes on by chance, behind it or reflected."""
    result = way
    material = clear_triangle(scene, way.hit.instance, way.hit.triangle)
    if material[3] == 0.0 or way.surfaces > MOST_SURFACES:
        result.open = 0
        if material[3] != 0.0:
            result.light = wp.vec3(0.0, 0.0, 0.0)
        return result
    normal = glass_normal(scene, way.hit)
    cosine = wp.dot(normal, way.direction)
    reflected = fresnel_dielectric(cosine, wp.abs(material[3]))[0]
    through = wp.vec3(material[0], material[1], material[2]) * (1.0 - reflected)
    chance = max_component(through)
    if hashed_unit(seed, wp.uint32(way.surfaces)) < chance:
        result.light = wp.cw_mul(way.light, through) / chance
        return result
    result.light = way.light * (reflected / (1.0 - chance))
    result.origin = way.origin + way.direction * way.hit.t
    result.direction = way.direction - normal * (2.0 * cosine)
    result.start = way.start - way.hit.t
    result.hit.t = 0.0
    return result


@wp.func
def end_way(paths: Paths, slot: int, way: ClearWay):
    """Store where a ray has come to, and the last part of its way."""
    store_hit(paths, slot, way.hit)
    paths.origin[slot] = way.origin
    paths.direction[slot] = way.direction
    paths.throughput[slot] = wp.cw_mul(paths.throughput[slot], way.light)


@wp.func
def ray_chance(paths: Paths, slot: int) -> wp.uint32:
    """Return the seed of a ray's chances."""
    return hash_combine(hash_combine(paths.seed[slot], wp.uint32(paths.state[slot] + CLEAR_STREAM)), paths.index[slot])


@wp.func
def follow_flat(scene: Scene, paths: Paths, slot: int):
    """Find the closest opaque hit of a ray, by chance behind clear glass or reflected from it."""
    limit = paths.t[slot]
    way = first_way(paths.origin[slot], paths.direction[slot])
    while way.open == 1:
        way = take_hit(way, closest_flat(
            scene.geometry, way.origin + way.direction * way.start, way.direction, limit - way.start))
        if way.hit.instance == MISS:
            way.open = 0
        elif way.again == 0:
            way = pass_by_chance(scene, way, ray_chance(paths, slot))
    end_way(paths, slot, way)


@wp.func
def follow_all(scene: Scene, paths: Paths, slot: int):
    """Do as follow_flat in scenes where not all is flattened."""
    limit = paths.t[slot]
    way = first_way(paths.origin[slot], paths.direction[slot])
    while way.open == 1:
        way = take_hit(way, closest_hit(
            scene.geometry, way.origin + way.direction * way.start, way.direction, limit - way.start))
        if way.hit.instance == MISS:
            way.open = 0
        elif way.again == 0:
            way = pass_by_chance(scene, way, ray_chance(paths, slot))
    end_way(paths, slot, way)


@wp.func
def flat_blocker(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, distance: float) -> wp.vec2i:
    """Return (instance, triangle) of any flattened opaque triangle before a distance; -1 where there is none."""
    face = int(-1)
    if geometry.flat.nodes.shape[0] > 0:
        flat = geometry.flat
        if flat.tubes == 1:
            face = any_face_with_tubes(flat.nodes, flat.triangles, origin, direction, distance)
        else:
            face = any_face_wide(flat.nodes, flat.triangles, origin, direction, distance)
    if face < 0:
        return wp.vec2i(-1, -1)
    return geometry.flat.faces[face]


@wp.func
def any_blocker(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, distance: float) -> wp.vec2i:
    """Do as flat_blocker in scenes where not all is flattened."""
    found = flat_blocker(geometry, origin, direction, distance)
    if found[0] < 0:
        level = geometry.instanced
        other = wp.vec2i(-1, -1)
        if level.tubes == 1:
            other = any_face_in_instances_with_tubes(level.nodes, level.records, origin, direction, distance)
        else:
            other = any_face_in_instances(level.nodes, level.records, origin, direction, distance)
        if other[0] >= 0:
            found = wp.vec2i(other[1], geometry.mesh_faces[other[0]])
    return found


@wp.func
def looks_on(scene: Scene, face: wp.vec2i, smooth: bool, paths: Paths, slot: int) -> bool:
    """Return whether a shadow ray has to look closer by what it meets first, wherever that lies; else it is done.

    Its distance becomes 0 where that is no clear glass; with `smooth`, no smooth one.
    """
    if face[0] < 0:
        return False
    ior = clear_triangle(scene, face[0], face[1])[3]
    if ior == 0.0 or (smooth and ior < 0.0):
        paths.shadow_distance[slot] = 0.0
        return False
    return True


@wp.func
def end_dimmed(paths: Paths, slot: int, share: wp.vec3):
    """Weaken a shadow ray's light to a share; its distance becomes 0 where nothing is left."""
    if max_component(share) > 0.0:
        paths.shadow_light[slot] = wp.cw_mul(paths.shadow_light[slot], share)
    else:
        paths.shadow_distance[slot] = 0.0


@wp.func
def dim_flat(scene: Scene, paths: Paths, slot: int, distance: float):
    """Weaken a shadow ray by clear glass; its distance becomes 0 where anything opaque blocks it."""
    origin = paths.shadow_origin[slot]
    direction = paths.shadow_direction[slot]
    if not looks_on(scene, flat_blocker(scene.geometry, origin, direction, distance), False, paths, slot):
        return
    way = first_way(origin, direction)
    while way.open == 1:
        way = take_hit(way, closest_flat(
            scene.geometry, origin + direction * way.start, direction, distance - way.start))
        if way.hit.instance == MISS:
            way.open = 0
        elif way.again == 0:
            way = dim_at_hit(scene, way)
    end_dimmed(paths, slot, way.light)


@wp.func
def dim_all(scene: Scene, paths: Paths, slot: int, distance: float):
    """Do as dim_flat in scenes where not all is flattened."""
    origin = paths.shadow_origin[slot]
    direction = paths.shadow_direction[slot]
    if not looks_on(scene, any_blocker(scene.geometry, origin, direction, distance), False, paths, slot):
        return
    way = first_way(origin, direction)
    while way.open == 1:
        way = take_hit(way, closest_hit(
            scene.geometry, origin + direction * way.start, direction, distance - way.start))
        if way.hit.instance == MISS:
            way.open = 0
        elif way.again == 0:
            way = dim_at_hit(scene, way)
    end_dimmed(paths, slot, way.light)
