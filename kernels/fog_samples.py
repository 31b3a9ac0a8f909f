# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that chooses a place and a light for each froxel and each cell of the fog's grids.

In froxels distances are drawn evenly or by the angle at a light near the ray (media_distance.Pull), so that the light
about lamps is not sparks. Of several lights one is kept by what it would add, as in light_choice.py.
"""

from __future__ import annotations

import warp as wp

from .direct_shadow import start_factor
from .environment_split import EnvironmentSplit
from .fog import Fog, cell_key, cell_width, cells_a_grid, first_cell, fog_about, is_own, wrapped
from .fog_passage import anisotropy_at, fog_at
from .froxels import (
    FroxelOptions,
    eye_ray,
    froxel_range,
    has_changed,
    has_spread,
    slice_distance,
    surface_distance,
)
from .gbuffer import GBuffer
from .geometry_math import INV_PI, is_finite3, max_component, mean_component
from .intersect import offset_origin
from .lamp_hit import FAR
from .lamp_sample import LightSample, no_light
from .light_candidate import (
    CANDIDATE_EMITTER,
    Candidate,
    LightClasses,
    candidate_index,
    candidate_kind,
    choose,
    light_classes,
    replay,
)
from .light_linking import kinds_lit
from .light_tree import choose_by_tree
from .media import NO_MEDIUM, STACK_SIZE, Inside, passing, phase_value
from .media_distance import Pull, pull_of, pulled_density, pulled_distance
from .paths import Paths
from .probe_rays import ProbeRays
from .sampling import STEP_REFILL, STEP_X, STEP_Y, fraction, pixel_seed_of, sample_pair, sample_sphere
from .types import VISIBLE_VOLUME, Scene
from .view import View, eye_position, film_position
from .volume_phases import phase_value_at

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

DIMENSION_FILM = wp.constant(0)
DIMENSION_DISTANCE = wp.constant(1)
DIMENSION_PICK = wp.constant(2)
DIMENSION_POINT = wp.constant(3)
DIMENSION_RESAMPLE = wp.constant(4)
DIMENSION_DIRECTION = wp.constant(5)
DIMENSION_DEPTH = wp.constant(6)
DIMENSION_PULL = wp.constant(7)
STREAM = wp.constant(0x46524F58)
VARIED_PLACES = wp.constant(3)
"""Of fog that varies that are looked at for one that is lit"""
TURNS = wp.constant(4)
"""Frames in which a cell takes a sample once, when light has spread and nothing changes"""
TURN_FRAMES = wp.constant(32.0)
"""Samples that it has by then"""
NEAR_LIGHT = wp.constant(0.1)
"""Distance to a light, in widths of a cell, below which its light counts as from there: cells are means over places of
which few are as near"""


@wp.struct
class FogPlace:
    """Where a sample is taken."""

    position: wp.vec3
    direction: wp.vec3
    """Of the camera ray; none in cells: they keep light from all around"""
    weight: float
    """0: there is nothing to light"""
    nearest: float
    """Least distance of a light [m]"""
    inside: Inside


@wp.func
def pull_near(scene: Scene, origin: wp.vec3, direction: wp.vec3, length: float, u: wp.vec2) -> Pull:
    """Return the pull of a light that has a place on a stretch."""
    none = Pull()
    if scene.lights.class_count == 0:
        return none
    if scene.lights.weight[0] <= 0.0:
        return none
    light = choose_by_tree(scene.lights.tree, origin + direction * (0.5 * length), wp.vec3(0.0, 0.0, 0.0), u)
    if light.entry < 0:
        return none
    leaf = (1 << scene.lights.tree.levels) + scene.lights.tree.places[light.entry]
    low = scene.lights.tree.low[leaf]
    high = scene.lights.tree.high[leaf]
    center = wp.vec3(low[0] + high[0], low[1] + high[1], low[2] + high[2]) * 0.5
    return pull_of(center - origin, direction, length, 0.5)


@wp.func
def scatters(fog: Fog, inside: Inside, position: wp.vec3) -> bool:
    """Return whether what is at a place scatters light."""
    return max_component(fog_at(fog, inside, position).scattering) > 0.0


@wp.func
def varied_place(
    scene: Scene, fog: Fog, origin: wp.vec3, direction: wp.vec3, length: float, pull: Pull, u: wp.vec2,
) -> FogPlace:
    """Return a place on a stretch of fog that varies: one of some, by how much of what it scatters is seen.

    What is nearer to the light of a pull is chosen more often, and weighs less.
    """
    place = FogPlace()
    place.direction = direction
    left = u[1]
    seen = float(1.0)
    worth = float(0.0)
    total = float(0.0)
    step = length / float(VARIED_PLACES)
    k = int(0)
    while k < VARIED_PLACES:
        t = (float(k) + fraction(u[0] + float(k) * STEP_X)) * step
        position = origin + direction * t
        inside = fog_about(scene, fog, position)
        mixture = fog_at(fog, inside, position)
        half = wp.exp(-0.5 * step * mean_component(mixture.extinction))
        here = mean_component(mixture.scattering) * seen * half
        seen = seen * half * half
        if here > 0.0:
            near = float(1.0)
            if pull.chance > 0.0:
                near = 1.0 + pull.chance * (pulled_density(pull, t) * length - 1.0)
            worth = worth + here
            total = total + here * near
            share = here * near / total
            if left < share:
                left = left / share
                place.position = position
                place.inside = inside
                place.weight = 1.0 / near
            else:
                left = (left - share) / (1.0 - share)
        k = k + 1
    if worth > 0.0:
        place.weight = place.weight * total / worth
    return place


@wp.func
def froxel_place(
    view: View, scene: Scene, fog: Fog, options: FroxelOptions, gbuffer: GBuffer, slot: int, seed: wp.uint32,
) -> FogPlace:
    """Return a place in a froxel before the surface of a pixel in it."""
    place = FogPlace()
    tiles = options.columns * options.rows
    slice = slot // tiles
    tile = slot - slice * tiles
    index = wp.uint32(view.frame)
    # All slices of a tile take the same pixel: it is one ray that is looked along.
    tile_seed = pixel_seed_of(tile, 1, STREAM)
    u = sample_pair(tile_seed, index, DIMENSION_FILM)
    x = wp.min((tile % options.columns) * options.tile + int(u[0] * float(options.tile)), options.width - 1)
    y = wp.min((tile // options.columns) * options.tile + int(u[1] * float(options.tile)), options.height - 1)
    ray = eye_ray(view.camera, film_position(view, x, y))
    span = froxel_range(fog, view.camera)
    begin = slice_distance(span, options.slices, float(slice))
    end = slice_distance(span, options.slices, float(slice + 1))
    end = wp.min(end, surface_distance(ray, gbuffer.depth[y * options.width + x]))
    length = end - begin
    if length <= 0.0:
        return place
    origin = ray.origin + ray.direction * begin
    v = sample_pair(seed, index, DIMENSION_DISTANCE)
    pull = pull_near(scene, origin, ray.direction, length, sample_pair(seed, index, DIMENSION_PULL))
    if fog.varying == 1:
        return varied_place(scene, fog, origin, ray.direction, length, pull, v)
    t = v[1] * length
    if v[0] < pull.chance:
        t = wp.clamp(pulled_distance(pull, v[1]), 0.0, length)
    density = (1.0 - pull.chance) / length
    if pull.chance > 0.0:
        density = density + pull.chance * pulled_density(pull, t)
    place.position = origin + ray.direction * t
    place.direction = ray.direction
    place.inside = fog_about(scene, fog, place.position)
    if scatters(fog, place.inside, place.position):
        place.weight = 1.0 / (length * density)
    return place


@wp.func
def grid_place(
    view: View, scene: Scene, fog: Fog, cell: int, seed: wp.uint32,
) -> FogPlace:
    """Return a place in a cell, which forgets what it knew if it stands for another place than before."""
    place = FogPlace()
    level = cell // cells_a_grid(fog)
    at = cell - level * cells_a_grid(fog)
    eye = eye_position(view.camera)
    low_x = first_cell(fog, eye, level, 0)
    low_y = first_cell(fog, eye, level, 1)
    low_z = first_cell(fog, eye, level, 2)
    x = low_x + wrapped(fog, at % fog.side - low_x)
    y = low_y + wrapped(fog, (at // fog.side) % fog.side - low_y)
    z = low_z + wrapped(fog, at // (fog.side * fog.side) - low_z)
    key = cell_key(level, x, y, z)
    if fog.key[cell] != key:
        fog.key[cell] = key
        fog.count[cell] = 0.0
    elif fog.count[cell] >= TURN_FRAMES and (cell + view.frame) % TURNS != 0:
        if has_spread(view) and not has_changed(view):
            return place
    width = cell_width(fog, level)
    u = sample_pair(seed, wp.uint32(view.frame), DIMENSION_FILM)
    w = sample_pair(seed, wp.uint32(view.frame), DIMENSION_DEPTH)
    place.position = wp.vec3(float(x) + u[0], float(y) + u[1], float(z) + w[0]) * width
    place.nearest = NEAR_LIGHT * width
    place.inside = fog_about(scene, fog, place.position)
    if scatters(fog, place.inside, place.position) and (level < fog.own or not is_own(fog, eye, place.position)):
        place.weight = 1.0
    return place


@wp.func
def owner_of(inside: Inside) -> int:
    """Return an object whose medium is at a place, -1 for none."""
    for i in range(STACK_SIZE):
        if inside.media[i] != NO_MEDIUM:
            return inside.objects[i]
    return -1


@wp.func
def arriving(
    scene: Scene, fog: Fog, place: FogPlace, s: LightSample, extinction: wp.vec3, chance: float,
) -> wp.vec3:
    """Return what a light sample adds if nothing but the world's fog is in the way: scattered, or from all around."""
    value = float(0.25 * INV_PI)
    if place.nearest == 0.0:
        cosine = wp.dot(place.direction, s.wi)
        if fog.varying == 1:
            value = phase_value_at(fog.media, fog.volumes, place.inside, place.position, cosine)
        else:
            value = phase_value(fog.media, place.inside, cosine)
    elif s.distance < place.nearest:
        value = value * (s.distance / place.nearest) * (s.distance / place.nearest)
    return s.radiance * (value / (s.pdf * chance))


@wp.func
def light_place(
    scene: Scene, split: EnvironmentSplit, fog: Fog, options: FroxelOptions, emitters: wp.array[wp.uint64],
    place: FogPlace, classes: LightClasses, seed: wp.uint32, index: wp.uint32, slot: int, rays: Paths,
) -> wp.vec3:
    """Return the light of one of some light samples, for all of them, and set up its shadow ray."""
    which = sample_pair(seed, index, DIMENSION_PICK)
    where = sample_pair(seed, index, DIMENSION_POINT)
    left = sample_pair(seed, index, DIMENSION_RESAMPLE)[0]
    extinction = fog_at(fog, place.inside, place.position).extinction
    owner = owner_of(place.inside)
    kept = no_light()
    candidate = Candidate()
    light = wp.vec3(0.0, 0.0, 0.0)
    value = float(1.0)
    total = float(0.0)
    count = float(options.candidates)
    k = int(0)
    while k < options.candidates:
        step = float(k)
        choice = choose(
            scene, split, classes, place.position,
            wp.vec2(fraction(which[0] + step / count), fraction(which[1] + step * STEP_REFILL)),
            wp.vec2(fraction(where[0] + step * STEP_X), fraction(where[1] + step * STEP_Y)))
        if choice.chance > 0.0:
            s = replay(scene, split, emitters, place.position, choice.candidate)
            if s.kind >= 0 and owner >= 0:
                s.visibility = kinds_lit(scene, s.visibility, owner)
            if s.kind >= 0 and (s.visibility & VISIBLE_VOLUME) != 0:
                here = arriving(scene, fog, place, s, extinction, choice.chance)
                seen = wp.cw_mul(here, passing(extinction, s.distance))
                # As if the fog at the place were all about it: what it weakens, others may not.
                worth = wp.dot(seen, scene.luminance) + 0.01 * wp.dot(here, scene.luminance)
                if is_finite3(here) and worth > 0.0:
                    total = total + worth
                    share = worth / total
                    if left < share:
                        left = left / share
                        kept = s
                        candidate = choice.candidate
                        light = here
                        value = worth
                    else:
                        left = (left - share) / (1.0 - share)
        k = k + 1
    if kept.kind < 0:
        return wp.vec3(0.0, 0.0, 0.0)
    direction = kept.wi
    distance = kept.distance
    if distance < FAR:
        to_light = offset_origin(
            place.position + kept.wi * kept.distance, kept.normal, kept.error, -kept.wi) - place.position
        distance = wp.length(to_light)
        direction = to_light / wp.max(distance, 1.0e-30)
    if distance > 0.0:
        rays.shadow_origin[slot] = place.position
        rays.shadow_direction[slot] = direction
        rays.shadow_distance[slot] = wp.where(kept.shadow == 0, -distance, distance)
        emitter = int(-1)
        if candidate_kind(candidate) == CANDIDATE_EMITTER:
            emitter = candidate_index(candidate)
        start_factor(scene, emitter, kept, slot, rays)
    return light * (total / (value * count))


@wp.kernel
def place_fog_samples(
    first: int,
    # In:
    views: wp.array[View],
    scene: Scene,
    split: EnvironmentSplit,
    emitters: wp.array[wp.uint64],
    fog: Fog,
    options: FroxelOptions,
    gbuffer: GBuffer,
    # Out:
    rays_out: Paths,
    cache_rays_out: ProbeRays,
    place_out: wp.array[wp.vec4],
    light_out: wp.array[wp.vec4],
):
    """Choose a place and a light for each froxel, then for each cell; these have a ray to somewhere too.

    `place_out`: where; w = weight of what is found there, 0 for nothing. `light_out`: what the light adds if its
    shadow ray gets through; w = mean cosine of scattering. Cells forget other places.
    """
    slot = first + wp.tid()
    view = views[0]
    rays_out.shadow_distance[slot] = 0.0
    rays_out.radiance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    froxels = options.columns * options.rows * options.slices
    seed = pixel_seed_of(slot, 0, STREAM)
    index = wp.uint32(view.frame)
    place = FogPlace()
    if slot < froxels:
        place = froxel_place(view, scene, fog, options, gbuffer, slot, seed)
    else:
        cell = slot - froxels
        seed = pixel_seed_of(cell, 2, STREAM)
        place = grid_place(view, scene, fog, cell, seed)
        ray = fog.first_ray + cell
        cache_rays_out.t_max[ray] = wp.where(place.weight > 0.0, FAR, 0.0)
        cache_rays_out.origin[ray] = place.position
        cache_rays_out.direction[ray] = sample_sphere(sample_pair(seed, index, DIMENSION_DIRECTION))
    light = wp.vec3(0.0, 0.0, 0.0)
    classes = light_classes(scene.lights, split)
    if place.weight > 0.0 and classes.local + classes.sun + classes.world > 0.0:
        light = light_place(scene, split, fog, options, emitters, place, classes, seed, index, slot, rays_out)
    p = place.position
    place_out[slot] = wp.vec4(p[0], p[1], p[2], place.weight)
    light_out[slot] = wp.vec4(light[0], light[1], light[2], anisotropy_at(fog, place.inside, p))
