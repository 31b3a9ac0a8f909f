# SPDX-License-Identifier: GPL-3.0-or-later
"""What render passes tell of the first surfaces: mist, motion, Cryptomatte's coverage by things, shader AOVs.

A launch of its own, apart from both integrators: a ray through each sample of the pixel filter meets every transparent
layer in turn, weighed by what the layers before it let through, so that layers add no noise. The definitions are those
of Cycles (film/data_passes.h, film/aov_passes.h and film/cryptomatte_passes.h).
"""

from __future__ import annotations

import warp as wp

from .camera import CameraRay, filter_offset
from .filter import MAX_LAYERS, layer_point, step_past
from .geometry_math import clamp3, max_component, mean_component
from .intersect import MISS, Hit, closest_hit, closest_layer
from .motion import Motion, previous_point
from .nodes import run, world_point
from .panorama import film_ray, panorama_film
from .sampling import DIMENSION_FILTER, DIMENSION_LENS, pixel_seed_of, sample_pair
from .tracing import FOOTPRINT_SCALE
from .types import HOLDOUT, MATERIAL_TRANSPARENCY, VISIBLE_CAMERA, FrameData, Scene, ShadingPoint
from .view import project

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Id of a slot that is free: no name has it, since ids have no exponent of 0.
FREE = wp.constant(0.0)

# Light that layers let through below which what lies behind them no longer counts.
OPAQUE = wp.constant(1.0e-5)

# Farthest from the film's corner that motion leads [px].
FILM_EDGE = wp.constant(1.0e6)

NO_PROGRAM = wp.constant(-1)


@wp.struct
class FirstHitOptions:
    """What is asked for."""

    filtered: int
    """1: the scene has triangles that need a test per hit"""
    mist: int
    """1: write FirstHits.mist"""
    mist_start: float
    """Distance from the camera up to which there is none [m]"""
    mist_inverse: float
    """1 / its depth [1/m]"""
    mist_falloff: float
    """Exponent"""
    objects: int
    materials: int
    assets: int
    """1: write the array of that name in FirstHits"""
    motion: int
    """1: write FirstHits.motion"""
    slots: int
    """Things that a pixel can hold, each with its coverage"""
    pixels: int
    """Of the rendered region"""


@wp.struct
class MatteIds:
    """Cryptomatte's ids, made of names by engine/cryptomatte.py."""

    objects: wp.array[float]
    """By instance"""
    assets: wp.array[float]
    """By instance"""
    materials: wp.array[float]


@wp.struct
class ShaderValues:
    """Programs of AOV Output nodes; what they emit is their value."""

    count: int
    materials: int
    """Materials, and the world as the last"""
    starts: wp.array[int]
    """First instruction by value and material"""
    threshold: float
    """Alpha from which on a surface hides the values of those behind it"""


@wp.struct
class OtherFrames:
    """Where everything is in the frame before and in the one after."""

    cameras: wp.array[FrameData]
    """Then, and then"""
    before: Motion
    after: Motion


@wp.struct
class FirstHits:
    """Sums over samples of the rendered region's pixels; those not asked for have no elements."""

    mist: wp.array[float]
    """What is seen through the mist, 0..1"""
    objects: wp.array[wp.vec2]
    materials: wp.array[wp.vec2]
    assets: wp.array[wp.vec2]
    """`slots` pairs of id and coverage a pixel, in the order in which they were met"""
    values: wp.array[wp.vec4]
    """By value and pixel; w: by how much any surface was seen"""
    motion: wp.array[wp.vec4]
    """On the film [px]: from now to before, from after to now; weighed by `moving`"""
    moving: wp.array[float]


@wp.func
def add_matte(slots: wp.array[wp.vec2], first: int, count: int, name: float, weight: float):
    """Add the coverage of a thing to its slot; where all are taken by others, to the last."""
    slot = int(0)
    while slot < count:
        held = slots[first + slot]
        if held[0] == FREE:
            slots[first + slot] = wp.vec2(name, weight)
            return
        if held[0] == name or slot == count - 1:
            slots[first + slot] = wp.vec2(held[0], held[1] + weight)
            return
        slot += 1


@wp.func
def mist_at(frame: FrameData, options: FirstHitOptions, position: wp.vec3) -> float:
    """Return how much the mist hides of a point, 0..1."""
    m = frame.camera_to_world
    offset = position - wp.vec3(m[0, 3], m[1, 3], m[2, 3])
    distance = wp.length(offset)
    if frame.orthographic == 1:
        distance = wp.abs(wp.dot(offset, wp.vec3(m[0, 2], m[1, 2], m[2, 2])))
    return wp.pow(wp.clamp((distance - options.mist_start) * options.mist_inverse, 0.0, 1.0), options.mist_falloff)


@wp.func
def add_surface(
    frame: FrameData, options: FirstHitOptions, ids: MatteIds, hits: FirstHits, pixel: int, point: ShadingPoint,
    throughput: wp.vec3, transparency: wp.vec3,
):
    """Add a surface to a pixel, by what reaches it and what it lets through."""
    alpha = wp.vec3(1.0) - transparency
    if options.mist == 1:
        seen = mean_component(wp.cw_mul(throughput, alpha))
        hits.mist[pixel] = hits.mist[pixel] + (1.0 - mist_at(frame, options, point.position)) * seen
    weight = mean_component(throughput) * mean_component(alpha)
    if weight > 0.0:
        first = pixel * options.slots
        if options.objects == 1:
            add_matte(hits.objects, first, options.slots, ids.objects[point.instance], weight)
        if options.materials == 1:
            add_matte(hits.materials, first, options.slots, ids.materials[point.material], weight)
        if options.assets == 1:
            add_matte(hits.assets, first, options.slots, ids.assets[point.instance], weight)


@wp.func
def place_on_film(frame: FrameData, point: wp.vec3) -> wp.vec2:
    """Return where any camera shows a point [px]."""
    if frame.panorama != 0:
        return panorama_film(frame, point)
    film = project(frame, point)
    return wp.vec2(film[0], film[1])


@wp.func
def film_at(scene: Scene, camera: FrameData, motion: Motion, hit: Hit, position: wp.vec3) -> wp.vec2:
    """Return where a hit point of this frame is on the film of another one [px]."""
    p = position
    if motion.moved[0] == 1:
        p = p + previous_point(scene.geometry, motion, hit.instance, hit.triangle, wp.vec2(hit.u, hit.v)).displacement
    film = place_on_film(camera, p)
    # What is behind the camera then is nowhere on the film.
    return wp.vec2(wp.clamp(film[0], -FILM_EDGE, FILM_EDGE), wp.clamp(film[1], -FILM_EDGE, FILM_EDGE))


@wp.func
def add_motion(
    scene: Scene, frame: FrameData, others: OtherFrames, hits: FirstHits, pixel: int, hit: Hit, position: wp.vec3,
    weight: float,
):
    """Add how a surface moves on the film."""
    now = place_on_film(frame, position)
    before = film_at(scene, others.cameras[0], others.before, hit, position) - now
    after = now - film_at(scene, others.cameras[1], others.after, hit, position)
    hits.motion[pixel] = hits.motion[pixel] + wp.vec4(before[0], before[1], after[0], after[1]) * weight
    hits.moving[pixel] = hits.moving[pixel] + weight


@wp.func
def start_of(scene: Scene, values: ShaderValues, number: int, material: int, transparent: bool) -> int:
    """Return the first instruction of a material's program: 0 lets light through, the others are shader values'."""
    if number > 0:
        return values.starts[(number - 1) * values.materials + material]
    if transparent:
        return scene.materials.materials[material].transparency_start
    return NO_PROGRAM


@wp.func
def look(
    scene: Scene, frame: FrameData, options: FirstHitOptions, ids: MatteIds, values: ShaderValues,
    others: OtherFrames, hits: FirstHits, pixel: int, ray: CameraRay, cone: wp.vec2,
):
    """Add what a ray meets: each layer of transparency in turn, what is opaque, or the world.

    Shader values count as Cycles counts them: of each surface by what reaches it, up to the first of enough alpha,
    whose motion is the pixel's.
    """
    opaque = closest_hit(scene.geometry, ray.origin, ray.direction, ray.t_max)
    layer = Hit()
    layer.instance = MISS
    if options.filtered == 1:
        found_layer = closest_layer(scene.geometry, ray.origin, ray.direction, opaque.t)
        if found_layer.solid == 1:
            opaque = found_layer.hit
        else:
            layer = found_layer.hit
    throughput = wp.vec3(1.0, 1.0, 1.0)
    layers = int(0)
    reading = int(values.count)
    settled = int(0)
    looking = int(1)
    while looking == 1:
        hit = opaque
        if layer.instance != MISS:
            hit = layer
        point = world_point(ray.direction, VISIBLE_CAMERA, 0, cone[1])
        point.material = values.materials - 1
        visibility = VISIBLE_CAMERA
        transparent = False
        if hit.instance != MISS:
            point = layer_point(scene, hit, ray.direction, VISIBLE_CAMERA, 0, cone)
            visibility = scene.geometry.instances[hit.instance].visibility
            flags = scene.materials.materials[point.material].flags
            transparent = layer.instance != MISS and (flags & MATERIAL_TRANSPARENCY) != 0
        passed = wp.vec3(0.0, 0.0, 0.0)
        if (visibility & VISIBLE_CAMERA) == 0:
            passed = wp.vec3(1.0, 1.0, 1.0)
        else:
            number = int(0)
            while number <= reading:
                start = start_of(scene, values, number, point.material, transparent)
                if start != NO_PROGRAM:
                    found = run(scene, point, start, 0.0)
                    if number == 0:
                        passed = clamp3(found.transparency)
                    else:
                        reached = mean_component(throughput)
                        value = found.emission * reached
                        at = (number - 1) * options.pixels + pixel
                        hits.values[at] = hits.values[at] + wp.vec4(value[0], value[1], value[2], reached)
                number += 1
            if hit.instance != MISS and settled == 0 and 1.0 - mean_component(passed) >= values.threshold:
                settled = 1
                reading = 0
                if options.motion == 1 and (visibility & HOLDOUT) == 0:
                    add_motion(
                        scene, frame, others, hits, pixel, hit, point.position, mean_component(throughput))
        if hit.instance == MISS and settled == 0 and options.motion == 1:
            # The world does not move.
            hits.moving[pixel] = hits.moving[pixel] + mean_component(throughput)
        if hit.instance != MISS and (visibility & HOLDOUT) == 0:
            add_surface(frame, options, ids, hits, pixel, point, throughput, passed)
        throughput = wp.cw_mul(throughput, passed)
        if layer.instance == MISS or max_component(throughput) < OPAQUE or layers == MAX_LAYERS - 1:
            looking = 0
        else:
            layers += 1
            beyond = step_past(point, ray.direction, hit.t)
            layer = Hit()
            layer.instance = MISS
            if beyond < opaque.t:
                further = closest_layer(
                    scene.geometry, ray.origin + ray.direction * beyond, ray.direction, opaque.t - beyond)
                further.hit.t = further.hit.t + beyond
                if further.solid == 1:
                    opaque = further.hit
                else:
                    layer = further.hit


@wp.kernel
def gather_first_hits(
    first: int,
    # In:
    scene: Scene,
    frames: wp.array[FrameData],
    filter_table: wp.array[float],
    options: FirstHitOptions,
    ids: MatteIds,
    values: ShaderValues,
    others: OtherFrames,
    first_sample: int,
    sample_count: int,
    # Out:
    hits_out: FirstHits,
):
    """Add so many samples of each pixel."""
    pixel = first + wp.tid()
    frame = frames[0]
    x = frame.crop_x + pixel % frame.crop_width
    y = frame.crop_y + pixel // frame.crop_width
    seed = pixel_seed_of(x, y, frame.seed)
    cone = wp.vec2(frame.pixel_size, frame.spread) * FOOTPRINT_SCALE
    sample = int(first_sample)
    while sample < first_sample + sample_count:
        jitter = sample_pair(seed, wp.uint32(sample), DIMENSION_FILTER)
        film = wp.vec2(
            float(x) + 0.5 + filter_offset(filter_table, jitter[0]),
            float(y) + 0.5 + filter_offset(filter_table, jitter[1]))
        ray = film_ray(frame, film, sample_pair(seed, wp.uint32(sample), DIMENSION_LENS))
        if ray.t_max >= 0.0:
            look(scene, frame, options, ids, values, others, hits_out, pixel, ray, cone)
        sample += 1
