# SPDX-License-Identifier: GPL-3.0-or-later
"""The reference path tracer as a wavefront: one small kernel a step, path states in arrays between them.

Unbiased: next-event estimation over all lights with multiple importance sampling (Veach 1997), unlimited bounces
ended by Russian roulette. The kernels that traverse are thin (a ray in, a hit out); the one that shades is the only
large one. A path owns its slot in every array, so any range of paths may run anywhere in any order.
"""

from __future__ import annotations

import warp as wp

from .camera import camera_ray, filter_offset
from .environment import environment_pdf
from .filter import accept_hit, transmittance
from .geometry_math import is_finite3, max_component, power_heuristic
from .intersect import MISS, Hit, any_hit, closest_hit, offset_origin, surface_point
from .lights import FAR, LightSample, emitter_pdf, lamp_hit, sample_light
from .nodes import evaluate_emission, evaluate_surface, evaluate_world
from .principled import evaluate_bsdf, prepare_bsdf, sample_bsdf
from .sampling import (
    DIMENSION_BSDF,
    DIMENSION_FILTER,
    DIMENSION_FIRST_BOUNCE,
    DIMENSION_LENS,
    DIMENSION_LIGHT,
    DIMENSION_LIGHT_CHOICE,
    DIMENSION_LOBE,
    DIMENSION_TRANSPARENCY,
    DIMENSIONS_PER_BOUNCE,
    hash_combine,
    pixel_seed_of,
    sample_pair,
)
from .terminator import smooth_surface_offset
from .types import (
    HOLDOUT,
    LIGHT_ENVIRONMENT,
    LIGHT_HITTABLE,
    LIGHT_TRIANGLE,
    MATERIAL_CONSTANT_EMISSION,
    MATERIAL_EMISSION,
    VISIBLE_CAMERA,
    VISIBLE_DIFFUSE,
    VISIBLE_GLOSSY,
    VISIBLE_TRANSMISSION,
    FrameData,
    Scene,
    ShadingPoint,
)

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Paths.state
ENDED = wp.constant(-1)

# A material's program must be evaluated before a shadow ray's light counts.
PENDING_NONE = wp.constant(0)
PENDING_TRIANGLE = wp.constant(1)
PENDING_WORLD = wp.constant(2)

# Widening of the ray cone at a rough bounce [rad per alpha]; a quarter of the lobe keeps detail where it shows.
CONE_PER_ALPHA = wp.constant(0.25)

# Pixel footprints are halved: samples are jittered over the pixel filter, which already blurs by a pixel.
FOOTPRINT_SCALE = wp.constant(0.5)


@wp.struct
class Options:
    """Settings of the path tracer that kernels read."""

    max_bounces: int
    roulette_start: int
    clamp_direct: float
    """0: off"""
    clamp_indirect: float
    transparent: int
    """1: the world behind the scene leaves alpha 0"""
    exposure: float
    passes: int
    """1: write Paths.surface_* and emission, environment at the first hit"""
    programs: int
    """1: shadow rays may need programs (transparency, textured emitters, a world that varies)"""


@wp.struct
class Paths:
    """States of all paths under way, one slot a path."""

    state: wp.array[int]
    """Bounces so far, or ENDED"""
    seed: wp.array[wp.uint32]
    """Of the pixel"""
    index: wp.array[wp.uint32]
    """Sample index"""
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
    kind: wp.array[int]
    """VISIBLE_* bit of the ray"""
    cone: wp.array[wp.vec2]
    """Width [m] at the origin, spread [rad]"""
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


@wp.kernel
def generate_paths(
    # In:
    frames: wp.array[FrameData],
    filter_table: wp.array[float],
    first_pixel: int,
    pixel_count: int,
    # Out:
    paths_out: Paths,
):
    """Start a path per pixel and sample: slot = sample * pixel_count + pixel."""
    path = wp.tid()
    frame = frames[0]
    pixel = first_pixel + path % pixel_count
    x = frame.crop_x + pixel % frame.crop_width
    y = frame.crop_y + pixel // frame.crop_width
    seed = pixel_seed_of(x, y, frame.seed)
    index = wp.uint32(frame.sample + path // pixel_count)
    jitter = sample_pair(seed, index, DIMENSION_FILTER)
    film = wp.vec2(
        float(x) + 0.5 + filter_offset(filter_table, jitter[0]),
        float(y) + 0.5 + filter_offset(filter_table, jitter[1]))
    ray = camera_ray(frame, film, sample_pair(seed, index, DIMENSION_LENS))
    paths_out.state[path] = 0
    paths_out.seed[path] = seed
    paths_out.index[path] = index
    paths_out.origin[path] = ray.origin
    paths_out.direction[path] = ray.direction
    paths_out.t[path] = ray.t_max
    paths_out.throughput[path] = wp.vec3(1.0, 1.0, 1.0)
    paths_out.radiance[path] = wp.vec4(0.0, 0.0, 0.0, 1.0)
    paths_out.pdf[path] = 0.0
    paths_out.kind[path] = VISIBLE_CAMERA
    paths_out.cone[path] = wp.vec2(frame.pixel_size, frame.spread) * FOOTPRINT_SCALE


@wp.kernel
def trace_paths(
    # In:
    scene: Scene,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find the closest opaque hit of every path in the queue."""
    path = queue[wp.tid()]
    if paths_out.state[path] == ENDED:
        return
    hit = closest_hit(scene.geometry, paths_out.origin[path], paths_out.direction[path], paths_out.t[path])
    paths_out.t[path] = hit.t
    paths_out.hit[path] = wp.vec2i(hit.instance, hit.triangle)
    paths_out.barycentrics[path] = wp.vec2(hit.u, hit.v)


@wp.kernel
def filter_paths(
    # In:
    scene: Scene,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Walk through the layers of triangles that need a test, in front of the opaque hit."""
    path = queue[wp.tid()]
    if paths_out.state[path] == ENDED:
        return
    hit = Hit()
    hit.t = paths_out.t[path]
    hit.instance = paths_out.hit[path][0]
    hit.triangle = paths_out.hit[path][1]
    hit.u = paths_out.barycentrics[path][0]
    hit.v = paths_out.barycentrics[path][1]
    noise = hash_combine(hash_combine(paths_out.seed[path], paths_out.index[path]),
                         wp.uint32(paths_out.state[path] * 64 + DIMENSION_TRANSPARENCY))
    found = accept_hit(scene, paths_out.origin[path], paths_out.direction[path], hit, paths_out.kind[path],
                       paths_out.state[path], paths_out.cone[path], noise)
    paths_out.t[path] = found.hit.t
    paths_out.hit[path] = wp.vec2i(found.hit.instance, found.hit.triangle)
    paths_out.barycentrics[path] = wp.vec2(found.hit.u, found.hit.v)
    paths_out.throughput[path] = wp.cw_mul(paths_out.throughput[path], found.weight)


@wp.func
def gather_lamps(scene: Scene, options: Options, paths: Paths, path: int):
    """Add the lamps that the ray meets before its hit; lamps hide nothing."""
    origin = paths.origin[path]
    direction = paths.direction[path]
    bounce = paths.state[path]
    pdf = paths.pdf[path]
    t_max = paths.t[path]
    if paths.hit[path][0] == MISS:
        t_max = FAR
    for i in range(scene.lights.lamp_count):
        flags = scene.lights.lamps[i].flags
        visibility = scene.lights.lamps[i].visibility
        if (flags & LIGHT_HITTABLE) != 0 and (visibility & paths.kind[path]) != 0:
            hit = lamp_hit(scene.lights.lamps[i], origin, direction, t_max)
            if hit.t > 0.0:
                weight = float(1.0)
                if pdf > 0.0:
                    weight = power_heuristic(pdf, hit.pdf * scene.lights.weight[i])
                light = wp.cw_mul(paths.throughput[path], hit.radiance) * weight
                add_light(paths, path, light, limit_at(options, bounce))


@wp.func
def end_in_world(scene: Scene, options: Options, paths: Paths, path: int):
    """Add the world's radiance and end the path."""
    bounce = paths.state[path]
    kind = paths.kind[path]
    direction = paths.direction[path]
    paths.state[path] = ENDED
    if bounce == 0 and options.transparent == 1:
        r = paths.radiance[path]
        paths.radiance[path] = wp.vec4(r[0], r[1], r[2], 0.0)
        return
    if (scene.environment.visibility & kind) == 0:
        return
    radiance = scene.environment.radiance
    if scene.environment.constant == 0:
        radiance = evaluate_world(scene, direction, kind, bounce, paths.cone[path][1])
    weight = float(1.0)
    pdf = paths.pdf[path]
    if pdf > 0.0 and scene.lights.environment_entry >= 0:
        light_pdf = environment_pdf(scene.environment, direction)
        weight = power_heuristic(pdf, light_pdf * scene.lights.weight[scene.lights.environment_entry])
    light = wp.cw_mul(paths.throughput[path], radiance) * weight
    add_light(paths, path, light, limit_at(options, bounce))
    if options.passes == 1 and bounce == 0:
        paths.environment[path] = radiance


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
def set_shadow_ray(scene: Scene, point: ShadingPoint, s: LightSample, light: wp.vec3, paths: Paths, path: int):
    """Store the shadow ray of a light sample and what it carries."""
    side = point.geometric_normal
    start = point.position + smooth_surface_offset(scene.geometry, point, s.wi)
    origin = offset_origin(start, side, point.error, s.wi)
    direction = s.wi
    distance = s.distance
    if distance < FAR:
        # Aim at the sampled point again: the origin has moved.
        target = offset_origin(point.position + s.wi * s.distance, s.normal, s.error, -s.wi) - origin
        distance = wp.length(target)
        if distance > 0.0:
            direction = target / distance
    pending = int(PENDING_NONE)
    carried = light
    if s.kind == LIGHT_TRIANGLE:
        material = scene.materials.instance_materials[
            scene.geometry.instances[s.instance].material_offset
            + wp.min(scene.geometry.slots[s.triangle], scene.geometry.instances[s.instance].material_count - 1)]
        if (scene.materials.materials[material].flags & MATERIAL_CONSTANT_EMISSION) != 0:
            carried = wp.cw_mul(light, scene.materials.materials[material].emission)
        else:
            pending = PENDING_TRIANGLE
    if s.kind == LIGHT_ENVIRONMENT:
        if scene.environment.constant == 1:
            carried = wp.cw_mul(light, scene.environment.radiance)
        else:
            pending = PENDING_WORLD
    if max_component(carried) > 0.0:
        paths.shadow_origin[path] = origin
        paths.shadow_direction[path] = direction
        paths.shadow_distance[path] = distance
        if s.shadow == 0:
            paths.shadow_distance[path] = -distance
        paths.shadow_light[path] = carried
        paths.shadow_pending[path] = pending
        paths.shadow_emitter[path] = wp.vec2i(s.instance, s.triangle)
        paths.shadow_barycentrics[path] = wp.vec2(s.u, s.v)


@wp.func
def record_first_hit(scene: Scene, frame: FrameData, point: ShadingPoint, emission: wp.vec3, paths: Paths, path: int):
    """Write the first hit's data for the passes."""
    instance = scene.geometry.instances[point.instance]
    axis = -wp.vec3(frame.camera_to_world[0, 2], frame.camera_to_world[1, 2], frame.camera_to_world[2, 2])
    eye = wp.vec3(frame.camera_to_world[0, 3], frame.camera_to_world[1, 3], frame.camera_to_world[2, 3])
    depth = wp.dot(point.position - eye, axis)
    uv = wp.vec2(0.0, 0.0)
    offset = scene.geometry.uv_offsets[instance.mesh, 0]
    if offset >= 0:
        corner = offset + 3 * (point.triangle - instance.triangle_offset)
        uv = (scene.geometry.uvs[corner] * (1.0 - point.u - point.v) + scene.geometry.uvs[corner + 1] * point.u
              + scene.geometry.uvs[corner + 2] * point.v)
    n = point.normal
    paths.surface_normal[path] = wp.vec4(n[0], n[1], n[2], depth)
    p = point.position
    paths.surface_position[path] = wp.vec4(p[0], p[1], p[2], float(instance.pass_index))
    material = scene.materials.materials[point.material]
    paths.surface_uv[path] = wp.vec4(uv[0], uv[1], 1.0, float(material.pass_index))
    paths.surface_emission[path] = emission


@wp.kernel
def shade_paths(
    # In:
    frames: wp.array[FrameData],
    scene: Scene,
    options: Options,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Shade the hits: add what they emit, sample one light, sample the BSDF and set up the next ray."""
    path = queue[wp.tid()]
    bounce = paths_out.state[path]
    if bounce == ENDED:
        return
    paths_out.shadow_distance[path] = 0.0
    if scene.lights.lamp_count > 0:
        gather_lamps(scene, options, paths_out, path)
    instance = paths_out.hit[path][0]
    if instance == MISS:
        end_in_world(scene, options, paths_out, path)
        return
    direction = paths_out.direction[path]
    kind = paths_out.kind[path]
    hit = Hit()
    hit.t = paths_out.t[path]
    hit.instance = instance
    hit.triangle = paths_out.hit[path][1]
    hit.u = paths_out.barycentrics[path][0]
    hit.v = paths_out.barycentrics[path][1]
    point = surface_point(scene, hit, direction)
    cone = paths_out.cone[path]
    point.footprint = cone[0] + cone[1] * hit.t
    point.ray_visibility = kind
    point.ray_length = hit.t
    point.ray_depth = bounce
    if bounce == 0 and (scene.geometry.instances[instance].visibility & HOLDOUT) != 0:
        paths_out.radiance[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
        paths_out.state[path] = ENDED
        return
    dimension = DIMENSION_FIRST_BOUNCE + bounce * DIMENSIONS_PER_BOUNCE
    seed = paths_out.seed[path]
    index = paths_out.index[path]
    choice = sample_pair(seed, index, dimension + DIMENSION_LOBE)
    closure = evaluate_surface(scene, point, choice[1])
    bsdf = prepare_bsdf(scene.tables, closure, point)
    throughput = paths_out.throughput[path]
    # The part that lets light through unchanged was taken by filter_paths with the probability of its weight.
    emission = bsdf.emission
    if max_component(emission) > 0.0:
        weight = float(1.0)
        pdf = paths_out.pdf[path]
        if pdf > 0.0:
            light_pdf = emitter_pdf(scene, instance, hit.triangle, paths_out.origin[path], direction, hit.t)
            weight = power_heuristic(pdf, light_pdf)
        add_light(paths_out, path, wp.cw_mul(throughput, emission) * weight, limit_at(options, bounce))
    if options.passes == 1 and bounce == 0:
        record_first_hit(scene, frames[0], point, emission, paths_out, path)

    light_choice = sample_pair(seed, index, dimension + DIMENSION_LIGHT_CHOICE)
    last = options.max_bounces > 0 and bounce >= options.max_bounces
    if scene.lights.entry_count > 0 and not last:
        s = sample_light(scene, point.position, light_choice[0], sample_pair(seed, index, dimension + DIMENSION_LIGHT))
        if s.kind >= 0:
            value = evaluate_bsdf(bsdf, point.wo, s.wi)
            weight = float(1.0)
            if s.delta == 0:
                weight = power_heuristic(s.pdf, value.pdf)
            reflected = wp.dot(point.geometric_normal, s.wi) > 0.0
            f = visible_part(value.f, value.diffuse, reflected, s.visibility)
            light = wp.cw_mul(wp.cw_mul(throughput, f), s.radiance) * (weight / s.pdf)
            if is_finite3(light) and max_component(light) > 0.0:
                set_shadow_ray(scene, point, s, light, paths_out, path)

    u = sample_pair(seed, index, dimension + DIMENSION_BSDF)
    sample = sample_bsdf(bsdf, point.wo, wp.vec3(u[0], u[1], choice[0]))
    paths_out.state[path] = ENDED
    if sample.pdf > 0.0 and not last and is_finite3(sample.weight) and max_component(sample.weight) > 0.0:
        next_throughput = wp.cw_mul(throughput, sample.weight)
        survival = float(1.0)
        if bounce >= options.roulette_start:
            survival = wp.clamp(max_component(next_throughput), 0.02, 1.0)
        if light_choice[1] < survival:
            paths_out.state[path] = bounce + 1
            paths_out.throughput[path] = next_throughput / survival
            paths_out.origin[path] = offset_origin(point.position, point.geometric_normal, point.error, sample.wi)
            paths_out.direction[path] = sample.wi
            paths_out.t[path] = FAR
            paths_out.pdf[path] = wp.where(sample.delta == 1, 0.0, sample.pdf)
            paths_out.kind[path] = sample.kind
            alpha = sample.roughness * sample.roughness
            paths_out.cone[path] = wp.vec2(point.footprint, cone[1] + CONE_PER_ALPHA * alpha)


@wp.kernel
def trace_shadows(
    # In:
    scene: Scene,
    options: Options,
    bounce: int,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Trace the shadow rays against opaque triangles; add the light where no program is needed."""
    path = queue[wp.tid()]
    distance = paths_out.shadow_distance[path]
    if distance == 0.0:
        return
    if distance > 0.0:
        if any_hit(scene.geometry, paths_out.shadow_origin[path], paths_out.shadow_direction[path], distance):
            paths_out.shadow_distance[path] = 0.0
            return
    if options.programs == 0:
        add_light(paths_out, path, paths_out.shadow_light[path], limit_at(options, bounce + 1))
        paths_out.shadow_distance[path] = 0.0


@wp.kernel
def shade_shadows(
    # In:
    scene: Scene,
    options: Options,
    bounce: int,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Finish shadow rays that need programs: transparent layers in between, textured emitters, the world."""
    path = queue[wp.tid()]
    distance = paths_out.shadow_distance[path]
    if distance == 0.0:
        return
    paths_out.shadow_distance[path] = 0.0
    light = paths_out.shadow_light[path]
    origin = paths_out.shadow_origin[path]
    direction = paths_out.shadow_direction[path]
    cone = paths_out.cone[path]
    pending = paths_out.shadow_pending[path]
    if pending == PENDING_TRIANGLE:
        hit = Hit()
        hit.t = wp.abs(distance)
        hit.instance = paths_out.shadow_emitter[path][0]
        hit.triangle = paths_out.shadow_emitter[path][1]
        hit.u = paths_out.shadow_barycentrics[path][0]
        hit.v = paths_out.shadow_barycentrics[path][1]
        point = surface_point(scene, hit, direction)
        point.footprint = cone[0]
        point.ray_visibility = VISIBLE_DIFFUSE
        point.ray_length = hit.t
        point.ray_depth = bounce + 1
        light = wp.cw_mul(light, evaluate_emission(scene, point))
    if pending == PENDING_WORLD:
        light = wp.cw_mul(light, evaluate_world(scene, direction, VISIBLE_DIFFUSE, bounce + 1, cone[1]))
    if distance > 0.0 and max_component(light) > 0.0:
        light = wp.cw_mul(light, transmittance(scene, origin, direction, distance, bounce + 1))
    if max_component(light) > 0.0:
        add_light(paths_out, path, light, limit_at(options, bounce + 1))


@wp.func
def material_emits(scene: Scene, material: int) -> bool:
    """Return whether a material can emit."""
    return (scene.materials.materials[material].flags & MATERIAL_EMISSION) != 0
