# SPDX-License-Identifier: GPL-3.0-or-later
"""What the path tracer does at a hit: it adds emission, samples a light and finds the next ray.

Unbiased: next-event estimation over all lights with multiple importance sampling (Veach 1997), unlimited bounces
ended by Russian roulette.
"""

from __future__ import annotations

import warp as wp

from .clear_paths import pane_length, pass_pane
from .geometry_math import is_finite3, max_component, normalize_or, power_heuristic
from .intersect import may_emit, offset_origin, triangle_material
from .lamp_hit import FAR
from .lamp_sample import LightSample, no_light
from .light_choice import LightChoice, choice_of_none, chosen_light, consider
from .light_linking import (
    blockers,
    emission_counts,
    kinds_lit,
    met_by_rays,
    note_blockers,
    note_receiver,
)
from .lights import class_total, emitter_pdf, sample_light_of
from .node_input import deeper
from .path_ends import ends_in_cache
from .path_guides import leave_surface, show_surface
from .paths import (
    LONG_PATH,
    PENDING_NONE,
    PENDING_TRIANGLE,
    PENDING_WORLD,
    Options,
    Paths,
    add_light,
    limit_at,
    survives,
)
from .principled import evaluate_bsdf, sample_bsdf
from .sampling import (
    BELOW_ONE,
    DIMENSION_BSDF,
    DIMENSION_FIRST_BOUNCE,
    DIMENSION_LIGHT,
    DIMENSION_LIGHT_CHOICE,
    DIMENSION_LOBE,
    DIMENSION_RESAMPLE,
    DIMENSIONS_PER_BOUNCE,
    fraction,
    sample_number,
    sample_pair,
)
from .terminator import lit_side, shadow_origin
from .types import (
    HOLDOUT,
    LIGHT_ENVIRONMENT,
    LIGHT_TRIANGLE,
    MATERIAL_CONSTANT_EMISSION,
    VISIBLE_DIFFUSE,
    VISIBLE_GLOSSY,
    VISIBLE_TRANSMISSION,
    Bsdf,
    BsdfSample,
    BsdfValue,
    FrameData,
    Scene,
    ShadingPoint,
)
from .wide_loads import load_instance, load_material_flags

__all__ = ["aim_shadow_ray", "begin_hit", "continue_path", "is_held_out", "light_hit", "set_shadow_ray", "shade_hit"]

# Light samples of which one gets a shadow ray.
LIGHT_CANDIDATES = wp.constant(2)


@wp.func
def visible_part(f: wp.vec3, diffuse: wp.vec3, reflected: bool, visibility: int) -> wp.vec3:
    """Leave out the lobes for which a light is switched off."""
    part = wp.vec3(0.0, 0.0, 0.0)
    if (visibility & VISIBLE_DIFFUSE) != 0:
        part = part + diffuse
    specular = f - diffuse
    if reflected and (visibility & VISIBLE_GLOSSY) != 0:
        part = part + specular
    if not reflected and (visibility & VISIBLE_TRANSMISSION) != 0:
        part = part + specular
    return part


@wp.func
def carry_light(scene: Scene, s: LightSample, light: wp.vec3, paths: Paths, path: int) -> bool:
    """Store what the shadow ray of a light sample carries, by what is known of the light; return whether anything."""
    pending = int(PENDING_NONE)
    carried = light
    if s.kind == LIGHT_TRIANGLE:
        material = triangle_material(scene, s.instance, s.triangle)
        if (load_material_flags(scene.materials.materials, material)[3] & MATERIAL_CONSTANT_EMISSION) != 0:
            carried = wp.cw_mul(light, scene.materials.materials[material].emission)
        else:
            pending = PENDING_TRIANGLE
    if s.kind == LIGHT_ENVIRONMENT:
        if scene.environment.constant == 1:
            carried = wp.cw_mul(light, scene.environment.radiance)
        else:
            pending = PENDING_WORLD
    if not max_component(carried) > 0.0:
        return False
    paths.shadow_light[path] = carried
    paths.shadow_pending[path] = pending
    paths.shadow_emitter[path] = wp.vec2i(s.instance, s.triangle)
    paths.shadow_barycentrics[path] = wp.vec2(s.u, s.v)
    if s.kind != LIGHT_TRIANGLE:
        note_blockers(scene, s.visibility, paths, path)
    return True


@wp.func
def aim_shadow_ray(
    scene: Scene, position: wp.vec3, origin: wp.vec3, s: LightSample, light: wp.vec3, paths: Paths, path: int,
):
    """Store the shadow ray, from an origin, of a light sample that was drawn for a position, and what it carries."""
    direction = s.wi
    distance = s.distance
    if distance < FAR:
        # Aim at the sampled point again: the origin has moved.
        target = offset_origin(position + s.wi * s.distance, s.normal, s.error, -s.wi) - origin
        distance = wp.length(target)
        if distance > 0.0:
            direction = target / distance
    if carry_light(scene, s, light, paths, path):
        paths.shadow_origin[path] = origin
        paths.shadow_direction[path] = direction
        paths.shadow_distance[path] = distance
        if s.shadow == 0:
            paths.shadow_distance[path] = -distance


@wp.func
def set_shadow_ray(scene: Scene, point: ShadingPoint, s: LightSample, light: wp.vec3, paths: Paths, path: int):
    """Store the shadow ray of a light sample for a surface and what it carries."""
    if s.kind == LIGHT_ENVIRONMENT and scene.environment.constant == 1 and wp.dot(lit_side(point, s.wi), s.wi) <= 0.0:
        # Cycles lets paths alone find a world of one colour: from behind the triangle none does.
        return
    aim_shadow_ray(scene, point.position, shadow_origin(scene.geometry, point, s.wi), s, light, paths, path)


@wp.func
def mean_normal(bsdf: Bsdf) -> wp.vec3:
    """Return the mean normal of the lobes by their weights, as in Cycles' Normal pass; the smooth one without lobes."""
    ones = wp.vec3(1.0, 1.0, 1.0)
    n = bsdf.normal * wp.dot(bsdf.diffuse + bsdf.translucent, ones)
    n = n + bsdf.specular_normal * wp.dot(bsdf.metal + bsdf.dielectric + bsdf.glass, ones)
    if bsdf.pick_coat > 0.0:
        n = n + bsdf.coat_normal * wp.dot(bsdf.coat, ones)
    if bsdf.pick_sheen > 0.0:
        n = n + bsdf.sheen_normal * wp.dot(bsdf.sheen, ones)
    return normalize_or(n, bsdf.smooth_normal)


@wp.func
def record_first_hit(scene: Scene, frame: FrameData, point: ShadingPoint, bsdf: Bsdf, paths: Paths, path: int):
    """Write the first hit's data for the passes."""
    instance = scene.geometry.instances[point.instance]
    axis = -wp.vec3(frame.camera_to_world[0, 2], frame.camera_to_world[1, 2], frame.camera_to_world[2, 2])
    eye = wp.vec3(frame.camera_to_world[0, 3], frame.camera_to_world[1, 3], frame.camera_to_world[2, 3])
    depth = wp.dot(point.position - eye, axis)
    if frame.panorama != 0:
        depth = wp.length(point.position - eye)
    uv = wp.vec2(0.0, 0.0)
    offset = scene.geometry.uv_offsets[instance.mesh, 0]
    if offset >= 0:
        corner = offset + 3 * (point.triangle - instance.triangle_offset)
        uv = (scene.geometry.uvs[corner] * (1.0 - point.u - point.v) + scene.geometry.uvs[corner + 1] * point.u
              + scene.geometry.uvs[corner + 2] * point.v)
    n = mean_normal(bsdf)
    paths.surface_normal[path] = wp.vec4(n[0], n[1], n[2], depth)
    p = point.position
    paths.surface_position[path] = wp.vec4(p[0], p[1], p[2], float(instance.pass_index))
    material = scene.materials.materials[point.material]
    paths.surface_uv[path] = wp.vec4(uv[0], uv[1], 1.0, float(material.pass_index))
    paths.surface_emission[path] = bsdf.emission


@wp.func
def add_emission(scene: Scene, options: Options, point: ShadingPoint, emission: wp.vec3, paths: Paths, path: int):
    """Add what a hit surface emits, weighed against light sampling."""
    if not emission_counts(scene, point.instance, point.ray_depth, paths, path):
        return
    weight = float(1.0)
    pdf = paths.pdf[path]
    if pdf > 0.0:
        before = pane_length(scene, paths, path)
        light_pdf = emitter_pdf(
            scene, point.instance, point.triangle, paths.origin[path] - paths.direction[path] * before,
            paths.side[path], paths.direction[path], point.ray_length + before)
        weight = power_heuristic(pdf, light_pdf)
        if light_pdf > 0.0 and not met_by_rays(scene, scene.geometry.instances[point.instance].visibility, pdf):
            return
    add_light(paths, path, wp.cw_mul(paths.throughput[path], emission) * weight, limit_at(options, point.ray_depth))


@wp.func
def front_of(bsdf: Bsdf) -> wp.vec3:
    """Return the normal of a surface on whose back no light counts, zero for one that lets light through.

    It is the smooth one, whose side lobes ask for (normals.bump_shadowing), not that of the flat triangle: light that
    grazes a coarse mesh arrives at triangles that face away from it, on the surface that their normals imply
    (terminator.py). A bumped normal that leans away by more than a right angle turns sides.
    """
    n = bsdf.smooth_normal
    cosine = wp.min(wp.dot(n, bsdf.normal), wp.dot(n, bsdf.specular_normal))
    if bsdf.pick_coat > 0.0:
        cosine = wp.min(cosine, wp.dot(n, bsdf.coat_normal))
    if bsdf.pick_glass + bsdf.pick_translucent > 0.0 or cosine <= 0.0:
        return wp.vec3(0.0, 0.0, 0.0)
    return n


@wp.func
def arriving(point: ShadingPoint, bsdf: Bsdf, s: LightSample) -> wp.vec3:
    """Return what a light sample adds to a path of throughput 1 if nothing is in its way, weighed against the BSDF."""
    return weighed_light(point, evaluate_bsdf(bsdf, point.wo, s.wi), s)


@wp.func
def weighed_light(point: ShadingPoint, value: BsdfValue, s: LightSample) -> wp.vec3:
    """Return what a light sample adds by the value and the density that a BSDF has for its direction."""
    weight = float(1.0)
    if s.delta == 0 and blockers(s.visibility) == 0:
        weight = power_heuristic(s.pdf, value.pdf)
    reflected = wp.dot(point.geometric_normal, s.wi) > 0.0
    f = visible_part(value.f, value.diffuse, reflected, s.visibility)
    return wp.cw_mul(f, s.radiance) * (weight / s.pdf)


@wp.func
def candidate_place(place: wp.vec2, number: float, count: int) -> wp.vec2:
    """Return the numbers of one of `count` light candidates, of which each part of the first number has one.

    The second numbers of neighbours are half of the range apart, so that whole strata change places. The passes of
    light draw candidates once more.
    """
    return wp.vec2(
        (fraction(place[0] * float(count)) + number) / float(count), fraction(place[1] + 0.5 * number))


@wp.func
def begin_choice(place: wp.vec2, number: float) -> LightChoice:
    """Return a choice among the two candidates before the first, by a number in [0, 1).

    Of candidates that would add as much that in the half of `place` itself is kept: over samples, those kept are as
    even then as `place` is. Which half that is says nothing about where in its half each candidate lies.
    """
    second = wp.floor(place[0] * 2.0)
    return choice_of_none(wp.min(0.5 * (1.0 - second + number), BELOW_ONE))


@wp.func
def sample_direct_light(
    scene: Scene, point: ShadingPoint, bsdf: Bsdf, refill: float, dimension: int, paths: Paths, path: int,
):
    """Draw light samples, keep one by what it would add, and store the shadow ray that decides whether it counts.

    Resampled importance sampling (Talbot, Cline and Egbert 2005): the light that matters here gets the ray, of sun
    and sky for one. Both techniques' weights are of single samples, so they still sum to one.
    """
    seed = paths.seed[path]
    index = paths.index[path]
    place = sample_pair(seed, index, dimension + DIMENSION_LIGHT)
    side = front_of(bsdf)
    throughput = paths.throughput[path]
    choice = begin_choice(place, sample_number(seed, index, dimension + DIMENSION_RESAMPLE))
    kept = no_light()
    classes = class_total(scene.lights, side)
    k = int(0)
    while k < LIGHT_CANDIDATES:
        u = candidate_place(place, float(k), LIGHT_CANDIDATES)
        s = sample_light_of(scene, classes, point.position, side, u, refill)
        here = wp.vec3(0.0, 0.0, 0.0)
        if s.kind >= 0:
            s.visibility = kinds_lit(scene, s.visibility, point.instance)
            here = wp.cw_mul(throughput, arriving(point, bsdf, s))
        choice = consider(choice, here, wp.dot(here, scene.luminance) * s.brightness)
        if choice.keeps_last == 1:
            kept = s
        k = k + 1
    if kept.kind >= 0 and wp.isfinite(choice.total):
        set_shadow_ray(scene, point, kept, chosen_light(choice, LIGHT_CANDIDATES), paths, path)


@wp.func
def continue_path(
    scene: Scene, point: ShadingPoint, bsdf: Bsdf, sample: BsdfSample, paths: Paths, path: int,
):
    """Set up the next ray, or leave the path ended."""
    bounce = point.ray_depth
    weight = sample.weight
    if not (sample.pdf > 0.0 and is_finite3(weight) and max_component(weight) > 0.0):
        return
    if bounce >= LONG_PATH:
        # Some materials return more than they receive (two BSDFs added); unlimited paths would never converge. It is
        # not the weight that is limited: of materials that gain nothing it is above 1 as often as below.
        weight = weight / bsdf.gain
    leave_surface(paths, path, bounce, sample)
    paths.state[path] = bounce + 1
    paths.throughput[path] = wp.cw_mul(paths.throughput[path], weight)
    paths.origin[path] = offset_origin(point.position, point.geometric_normal, point.error, sample.wi)
    paths.direction[path] = sample.wi
    paths.t[path] = FAR
    pdf = wp.where(sample.delta == 1, 0.0, sample.pdf)
    if scene.materials.clear.shape[0] > 0:
        if sample.delta == 1:
            pdf = pass_pane(scene, point, bsdf, sample, paths, path)
        else:
            paths.clear_way[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if sample.delta == 0 or pdf == 0.0:
        paths.side[path] = front_of(bsdf)
    paths.pdf[path] = pdf
    paths.kind[path] = deeper(point.ray_visibility, sample.kind)
    # The cone is not widened by the lobe: blurring over it would average in parts of a texture atlas that the
    # surface does not show, and flatten normal maps.
    paths.cone[path] = wp.vec2(point.footprint, paths.cone[path][1])


@wp.func
def is_held_out(scene: Scene, point: ShadingPoint, paths: Paths, path: int) -> bool:
    """Return whether the camera sees a holdout, which hides all and shows nothing."""
    if point.ray_depth > 0 or (load_instance(scene.geometry.instances, point.instance).visibility & HOLDOUT) == 0:
        return False
    paths.radiance[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    return True


@wp.func
def begin_hit(
    frame: FrameData, scene: Scene, options: Options, point: ShadingPoint, bsdf: Bsdf, paths: Paths, path: int,
) -> bool:
    """Add what a hit emits and record a first one; return whether the path is scattered there."""
    bounce = point.ray_depth
    if max_component(bsdf.emission) > 0.0:
        add_emission(scene, options, point, bsdf.emission, paths, path)
    if may_emit(scene, point.material) and not survives(options, paths, path, bounce):
        return False
    show_surface(scene, options.exposure, point, bsdf, paths, path)
    if options.passes == 1 and bounce == 0:
        record_first_hit(scene, frame, point, bsdf, paths, path)
    return not (options.max_bounces > 0 and bounce >= options.max_bounces)


@wp.func
def light_hit(scene: Scene, point: ShadingPoint, bsdf: Bsdf, paths: Paths, path: int):
    """Sample one light, if there are any."""
    if scene.lights.class_count > 0:
        dimension = DIMENSION_FIRST_BOUNCE + point.ray_depth * DIMENSIONS_PER_BOUNCE
        refill = sample_number(paths.seed[path], paths.index[path], dimension + DIMENSION_LIGHT_CHOICE)
        sample_direct_light(scene, point, bsdf, refill, dimension, paths, path)


@wp.func
def shade_hit(
    frame: FrameData, scene: Scene, options: Options, point: ShadingPoint, bsdf: Bsdf, paths: Paths, path: int,
):
    """Add what a hit emits, sample one light, sample the BSDF and set up the next ray of a path that ends otherwise."""
    seed = paths.seed[path]
    index = paths.index[path]
    dimension = DIMENSION_FIRST_BOUNCE + point.ray_depth * DIMENSIONS_PER_BOUNCE
    if not begin_hit(frame, scene, options, point, bsdf, paths, path):
        return
    if ends_in_cache(scene, options, point, bsdf, paths, path):
        return
    light_hit(scene, point, bsdf, paths, path)
    u = sample_pair(seed, index, dimension + DIMENSION_BSDF)
    choice = sample_number(seed, index, dimension + DIMENSION_LOBE)
    sample = sample_bsdf(bsdf, point.wo, wp.vec3(u[0], u[1], choice))
    note_receiver(scene, point.instance, paths, path)
    continue_path(scene, point, bsdf, sample, paths, path)
