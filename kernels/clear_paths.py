# SPDX-License-Identifier: GPL-3.0-or-later
"""Light samples of the path tracer through panes of clear glass, weighed against the paths that find the same light.

A path that has gone through a pane goes on as it came, so a light sample in that direction stands for it: both share
the light by the power heuristic (Veach 1997), with the densities that they have at the surface before the pane. Light
behind windows is then found in every sample. This is next-event estimation through interfaces (Hanika, Droske and
Fascione, "Manifold Next Event Estimation", EGSR 2015) for the one case that needs no search.

What counts as a pane is told by the same tests here, where paths go through glass, and in `dim_strictly`, where shadow
rays do: smooth glass, entered and left, whose normals are those of its triangles and which has turned nothing. All
other ways through glass are paths' alone. Light from behind a pane seems closer by about a third of its thickness, and
so denser; what is in its way is looked for along the straight line.
"""

from __future__ import annotations

import warp as wp

from .clear_glass import (
    ClearWay,
    any_blocker,
    bend,
    clear_triangle,
    end_dimmed,
    first_way,
    flat_blocker,
    glass_normal,
    looks_on,
    take_hit,
)
from .flat_tracing import closest_flat
from .fresnel import fresnel_dielectric
from .geometry_math import normalize_or, transform_normal
from .intersect import MISS, Hit, closest_hit
from .lamp_hit import FAR
from .paths import Paths
from .types import VISIBLE_TRANSMISSION, Bsdf, BsdfSample, Scene, ShadingPoint
from .wide_loads import interpolated_normal, load_instance

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Squared length by which the direction behind a pane may differ from that before it, and a normal from its triangle's.
TURN_MAX = wp.constant(1.0e-5)
NORMAL_MAX = wp.constant(1.0e-6)

# Least share of the distance that light seems to come over: panes as thick as this leaves are none.
SHIFT_MIN = wp.constant(0.25)

# Surfaces that a shadow ray goes through.
STRICT_SURFACES = wp.constant(64)


@wp.func
def pass_pane(
    scene: Scene, point: ShadingPoint, bsdf: Bsdf, sample: BsdfSample, paths: Paths, path: int,
) -> float:
    """Take in that a path is sent on by a mirror or through smooth glass; return the density that it keeps.

    That of the surface before a pane which it leaves, its negative in the pane, else 0.
    """
    pdf = paths.pdf[path]
    before = paths.clear_way[path]
    paths.clear_way[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    plain = wp.length_sq(bsdf.specular_normal - point.geometric_normal) < NORMAL_MAX
    if pdf == 0.0 or sample.kind != VISIBLE_TRANSMISSION or not plain:
        return 0.0
    if scene.materials.clear[point.material][3] <= 0.0:
        return 0.0
    length = before[3] + point.ray_length
    if point.backfacing == 0:
        if pdf < 0.0:
            return 0.0
        d = -point.wo
        paths.clear_way[path] = wp.vec4(d[0], d[1], d[2], length)
        return -pdf
    turn = sample.wi - wp.vec3(before[0], before[1], before[2])
    if pdf > 0.0 or wp.length_sq(turn) > TURN_MAX:
        return 0.0
    paths.clear_way[path] = wp.vec4(0.0, 0.0, 0.0, length)
    return -pdf


@wp.func
def pane_length(scene: Scene, paths: Paths, path: int) -> float:
    """Return how far behind the surface that shares its light a path's ray begins: 0 but behind panes."""
    if scene.materials.clear.shape[0] == 0:
        return 0.0
    return wp.where(paths.pdf[path] > 0.0, paths.clear_way[path][3], 0.0)


@wp.func
def is_plain(scene: Scene, hit: Hit, normal: wp.vec3) -> bool:
    """Return whether the normal of a hit is that of its triangle."""
    row = load_instance(scene.geometry.instances, hit.instance)
    local = interpolated_normal(scene.geometry, hit.triangle, hit.u, hit.v)
    n = normalize_or(transform_normal(row.to_object, local), normal)
    # Either may point inwards.
    return wp.min(wp.length_sq(n - normal), wp.length_sq(n + normal)) < NORMAL_MAX


@wp.func
def dim_strictly(scene: Scene, way: ClearWay) -> ClearWay:
    """Return a shadow ray's state at a hit as clear_glass.dim_at_hit, black at all that is no pane."""
    result = way
    material = clear_triangle(scene, way.hit.instance, way.hit.triangle)
    normal = glass_normal(scene, way.hit)
    cosine = wp.dot(normal, way.direction)
    # Entered from outside, or left.
    passes = material[3] > 0.0 and way.surfaces <= STRICT_SURFACES and (cosine > 0.0) == (way.inside == 1)
    if passes:
        passes = is_plain(scene, way.hit, normal)
    if passes:
        result.bent = bend(way.bent, normal, material[3])
        result.inside = wp.where(cosine < 0.0, 1, 0)
        if cosine > 0.0:
            passes = wp.length_sq(result.bent - way.direction) <= TURN_MAX
            result.bent = way.direction
    if not passes:
        result.light = wp.vec3(0.0, 0.0, 0.0)
        result.open = 0
        return result
    # A pane of thickness h moves what lies a distance D behind it, along the normal, from D tan a to (D - h) tan a +
    # h tan b; light gets denser by the ratio of the areas.
    c = wp.abs(cosine)
    below = wp.max(1.0 - (1.0 - c * c) / (material[3] * material[3]), 1.0e-6)
    slope = c / (material[3] * wp.sqrt(below))
    shift = wp.vec2(1.0 - slope, 1.0 - slope * c * c / below) * way.hit.t
    result.shift = way.shift + wp.where(cosine < 0.0, -shift, shift)
    passing = 1.0 - fresnel_dielectric(cosine, material[3])[0]
    result.light = wp.cw_mul(way.light, wp.vec3(material[0], material[1], material[2])) * passing
    return result


@wp.func
def end_strictly(paths: Paths, path: int, way: ClearWay, distance: float):
    """Weaken a shadow ray's light by the panes in its way; its distance becomes 0 where it doesn't arrive."""
    share = way.light
    if way.inside == 1:
        share = wp.vec3(0.0, 0.0, 0.0)
    if distance < FAR:
        left = wp.max(wp.vec2(1.0, 1.0) - way.shift / distance, wp.vec2(SHIFT_MIN, SHIFT_MIN))
        share = share / (left[0] * left[1])
    end_dimmed(paths, path, share)


@wp.func
def dim_path_flat(scene: Scene, paths: Paths, path: int, distance: float):
    """Weaken a path's shadow ray by panes; its distance becomes 0 where anything else blocks it."""
    origin = paths.shadow_origin[path]
    direction = paths.shadow_direction[path]
    if not looks_on(scene, flat_blocker(scene.geometry, origin, direction, distance), True, paths, path):
        return
    way = first_way(origin, direction)
    while way.open == 1:
        way = take_hit(way, closest_flat(
            scene.geometry, origin + direction * way.start, direction, distance - way.start))
        if way.hit.instance == MISS:
            way.open = 0
        elif way.again == 0:
            way = dim_strictly(scene, way)
    end_strictly(paths, path, way, distance)


@wp.func
def dim_path_all(scene: Scene, paths: Paths, path: int, distance: float):
    """Do as dim_path_flat in scenes where not all is flattened."""
    origin = paths.shadow_origin[path]
    direction = paths.shadow_direction[path]
    if not looks_on(scene, any_blocker(scene.geometry, origin, direction, distance), True, paths, path):
        return
    way = first_way(origin, direction)
    while way.open == 1:
        way = take_hit(way, closest_hit(
            scene.geometry, origin + direction * way.start, direction, distance - way.start))
        if way.hit.instance == MISS:
            way.open = 0
        elif way.again == 0:
            way = dim_strictly(scene, way)
    end_strictly(paths, path, way, distance)
