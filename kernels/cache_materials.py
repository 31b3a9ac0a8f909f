# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache's kernel that runs material programs: what each hit reflects and emits, and what misses bring."""

from __future__ import annotations

import warp as wp

from .cache_highlights import store_lobe
from .cache_mirrors import (
    Mirrors,
    goes_on,
    limit_followed,
    mirror_chance,
    over_mirror,
    send_over,
    way_before,
    way_weight,
)
from .cache_rays import DIMENSION_CLOSURE, IDLE, Vertices, slot_seed
from .environment_split import soft_radiance
from .geometry_math import is_finite3, mean_component, power_heuristic
from .intersect import MISS, surface_point
from .light_linking import is_linked
from .lights import emitter_pdf
from .nodes import run, world_point
from .packing import pack_normal
from .paths import Paths, load_hit
from .principled import prepare_bsdf
from .probe_rays import MISS_DISTANCE
from .reflectance import BsdfAlbedo, bsdf_albedo
from .sampling import sample_pair
from .types import MATERIAL_FLAT_SHIFT, VISIBLE_DIFFUSE, Scene, ShadingPoint
from .view import View, eye_position, pixel_footprint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Largest value in a sample: what is brighter came from a division by nearly nothing.
BRIGHTEST = wp.constant(1.0e9)

# Vertices.emission[3] where the lean kernel has left a ray to the full one.
LEFT = wp.constant(-2.0)


@wp.func
def is_sampled_emitter(scene: Scene, instance: int, triangle: int) -> bool:
    """Return whether a triangle is in the light table: its light arrives by light sampling."""
    if scene.lights.class_count == 0:
        return False
    first = scene.lights.emitter_offset[instance]
    if first < 0:
        return False
    return scene.lights.emitter_index[first + triangle - scene.geometry.instances[instance].triangle_offset] >= 0


@wp.func
def sane(c: wp.vec3) -> wp.vec3:
    """Return a colour without negative, endless or undefined channels."""
    if not is_finite3(c):
        return wp.vec3(0.0, 0.0, 0.0)
    return wp.vec3(
        wp.clamp(c[0], 0.0, BRIGHTEST), wp.clamp(c[1], 0.0, BRIGHTEST), wp.clamp(c[2], 0.0, BRIGHTEST))


@wp.func
def hit_point(view: View, scene: Scene, paths: Paths, slot: int, bounce: int) -> ShadingPoint:
    """Return the point that a ray has hit. Textures are seen as widely as a pixel would see them there."""
    point = surface_point(scene, load_hit(paths, slot), paths.direction[slot])
    point.footprint = pixel_footprint(view.camera, wp.length(point.position - eye_position(view.camera)))
    point.ray_visibility = VISIBLE_DIFFUSE
    point.ray_length = paths.t[slot]
    point.ray_depth = 1 + bounce
    return point


@wp.func
def flat_start(scene: Scene, point: ShadingPoint) -> int:
    """Return the first instruction of the program without normal maps: a cell is wider than their detail."""
    return scene.materials.materials[point.material].surface_start + (
        scene.materials.materials[point.material].flags >> MATERIAL_FLAT_SHIFT)


@wp.func
def emission_weight(
    scene: Scene, point: ShadingPoint, paths: Paths, mirrors: Mirrors, slot: int, weighed: bool,
) -> float:
    """Return how much of a hit's emission its ray brings: none of what arrives by light sampling.

    `weighed`: the two share it by their densities (Veach 1997), so that neither is noisy close to an emitter. Not of
    emitters that are for some objects alone: rays don't know what they have left. No light is sampled over mirrors.
    """
    if over_mirror(mirrors, slot) or not is_sampled_emitter(scene, point.instance, point.triangle):
        return 1.0
    if not weighed:
        return 0.0
    if scene.lights.linked == 1:
        if is_linked(scene.geometry.instances[point.instance].visibility):
            return 0.0
    pdf = emitter_pdf(
        scene, point.instance, point.triangle, paths.origin[slot], wp.vec3(0.0, 0.0, 0.0), paths.direction[slot],
        point.ray_length)
    return power_heuristic(paths.pdf[slot], pdf)


@wp.func
def store_world(
    view: View, scene: Scene, radiance: wp.vec3, bounce: int, threshold: float, filtered: int, paths: Paths,
    mirrors: Mirrors, vertices: Vertices, slot: int,
):
    """Store what a ray that misses brings of the world: its bright part is sampled as a light, but over mirrors."""
    light = radiance
    if over_mirror(mirrors, slot):
        light = limit_followed(view, scene, radiance)
    elif bounce == 0:
        light = soft_radiance(radiance, threshold, scene.luminance)
    light = sane(wp.cw_mul(light, way_weight(mirrors, filtered, paths, slot)))
    vertices.emission[slot] = wp.vec4(light[0], light[1], light[2], MISS_DISTANCE)


@wp.func
def store_surface(
    view: View, scene: Scene, point: ShadingPoint, albedo: BsdfAlbedo, normal: wp.vec3, emitted: wp.vec3, share: float,
    filtered: int, paths: Paths, mirrors: Mirrors, vertices: Vertices, slot: int,
):
    """Store what is known of a hit, or send its ray on over a mirror; `share` is that of its emission."""
    weight = way_weight(mirrors, filtered, paths, slot)
    chance = mirror_chance(albedo, mirrors, slot)
    if chance > 0.0:
        if goes_on(chance, slot_seed(slot), view.frame):
            send_over(point, normal, wp.cw_mul(weight, albedo.reflected) / chance, filtered, paths, mirrors, slot)
            vertices.emission[slot] = wp.vec4(0.0, 0.0, 0.0, IDLE)
            return
        weight = weight / (1.0 - chance)
        albedo.specular = albedo.specular - albedo.reflected
    if over_mirror(mirrors, slot):
        emitted = limit_followed(view, scene, emitted)
    # Refracted light comes from the other side like that of the translucent lobe.
    behind = sane(albedo.translucent + albedo.transmitted)
    total = sane(albedo.diffuse + albedo.specular) + behind
    through = wp.clamp(mean_component(behind) / wp.max(mean_component(total), 1.0e-20), 0.0, 1.0)
    reflectance = sane(wp.cw_mul(total, weight))
    vertices.reflectance[slot] = wp.vec4(reflectance[0], reflectance[1], reflectance[2], through)
    store_lobe(vertices, albedo, weight, total, through, slot)
    emission = sane(wp.cw_mul(emitted, weight) * share)
    length = wp.min(point.ray_length + way_before(mirrors, slot), MISS_DISTANCE)
    vertices.emission[slot] = wp.vec4(emission[0], emission[1], emission[2], length)
    p = point.position
    vertices.position[slot] = wp.vec4(p[0], p[1], p[2], point.error)
    vertices.geometric_normal[slot] = pack_normal(point.geometric_normal)
    vertices.normal[slot] = pack_normal(normal)


@wp.func
def evaluate_one(
    scene: Scene, view: View, bounce: int, weighed: int, threshold: float, filtered: int, paths: Paths,
    mirrors: Mirrors, vertices: Vertices, slot: int,
):
    """Run the program of the material that a ray hits, or of the world."""
    vertices.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    missed = paths.hit[slot][0] == MISS
    point = world_point(paths.direction[slot], VISIBLE_DIFFUSE, 1, 0.0)
    start = scene.materials.world_start
    if not missed:
        point = hit_point(view, scene, paths, slot, bounce)
        start = flat_start(scene, point)
    u = sample_pair(slot_seed(slot), wp.uint32(view.frame), DIMENSION_CLOSURE)
    closure = run(scene, point, start, u[0])
    if missed:
        store_world(view, scene, sane(closure.emission), bounce, threshold, filtered, paths, mirrors, vertices, slot)
        return
    share = emission_weight(scene, point, paths, mirrors, slot, bounce == 1 and weighed == 1)
    bsdf = prepare_bsdf(scene.tables, closure, point)
    albedo = bsdf_albedo(scene.tables, bsdf, point.wo)
    store_surface(
        view, scene, point, albedo, bsdf.normal, bsdf.emission, share, filtered, paths, mirrors, vertices, slot)


@wp.kernel
def evaluate_cache_materials(
    # In:
    views: wp.array[View],
    scene: Scene,
    bounce: int,
    weighed: int,
    threshold: float,
    filtered: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    mirrors_out: Mirrors,
    vertices_out: Vertices,
):
    """Run the programs of what listed rays meet, as far as evaluate_cache_lean has left them.

    `bounce` is 1 for bounce rays: the world reaches cells by light sampling, so those that miss bring nothing, unless
    the world is not sampled. `weighed` 1: they share the emission of emitters with light sampling.
    """
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        if vertices_out.emission[slot][3] == LEFT:
            evaluate_one(
                scene, views[0], bounce, weighed, threshold, filtered, paths_out, mirrors_out, vertices_out, slot)
        i = i + stride
