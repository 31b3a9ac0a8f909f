# SPDX-License-Identifier: GPL-3.0-or-later
"""How light is followed through hair from the pixels that show it, in real-time frames.

A ray for each block of pixels: in the strand that the pixel shows, and in those that it meets from there, it draws a
direction from their lobes (hair_lobes.py) and looks for lights. Of the lights in all strands chance keeps one, by what
it would bring, for a shadow ray. What leaves the hair goes on as other rays do, and after some strands hair is lit like
any surface. The kernels that run programs are in hair_full.py and hair_lean.py, by what programs of hair there are.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .environment_split import EnvironmentSplit
from .gbuffer import GBuffer
from .gbuffer_store import stored_point
from .geometry_math import is_finite3, max_component
from .hair_exit import leaving_point
from .hair_lobes import HairLobes, evaluate_hair, hair_lobes, sample_hair
from .hair_place import scatters_as_hair
from .intersect import offset_origin, surface_point, triangle_material
from .lamp_hit import FAR
from .lamp_sample import LightSample
from .light_candidate import LightClasses, candidate_index, choose, light_classes, replay
from .light_linking import kinds_lit, note_blockers, note_receiver
from .paths import ENDED, PENDING_NONE, PENDING_TRIANGLE, Paths, load_hit
from .reflection_rays import ReflectionRays, find_start, gather, send_ray, start_ray
from .reflection_types import SAMPLE_FAR, ReflectionOptions, ReflectionSamples
from .sampling import STEP_REFILL, STEP_X, STEP_Y, fraction, hash_combine, sample_number, sample_pair
from .tracing import FOOTPRINT_SCALE
from .types import (
    CLOSURE_HAIR,
    LIGHT_TRIANGLE,
    MATERIAL_CONSTANT_EMISSION,
    VISIBLE_DIFFUSE,
    VISIBLE_GLOSSY,
    VISIBLE_TRANSMISSION,
    Closure,
    Scene,
    ShadingPoint,
)
from .view import View
from .wide_loads import load_material_flags

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

HAIR_SEED = wp.constant(wp.uint32(0x48414952))
# Lights considered in each strand.
CANDIDATES = wp.constant(2)
# Dimensions of random numbers: the first, and how many a strand takes.
DIMENSION_FIRST = wp.constant(600)
DIMENSIONS = wp.constant(8)
DIMENSION_DIRECTION = wp.constant(0)
DIMENSION_LOBE = wp.constant(1)
DIMENSION_LIGHT = wp.constant(2)
DIMENSION_PLACE = wp.constant(3)
DIMENSION_KEPT = wp.constant(4)
DIMENSION_END = wp.constant(5)
DIMENSION_CLOSURE = wp.constant(6)
# Strands after which rays end by chance, and the most of them that go on.
ROULETTE = wp.constant(2)
SURVIVAL_MAX = wp.constant(0.95)


@wp.struct
class KeptLight:
    """The light that chance keeps of all that a ray has considered."""

    total: float
    """Of the brightness that all would bring"""
    value: float
    """That of the kept one"""
    number: float
    """Uniform, what decisions so far have left of it"""


@wp.func
def keep_light(
    scene: Scene, point: ShadingPoint, s: LightSample, part: wp.vec3, kept: KeptLight, lit: Paths, slot: int,
) -> KeptLight:
    """Consider a light for the shadow ray; `part`: what of its radiance it would bring."""
    out = kept
    light = wp.cw_mul(part, s.radiance)
    value = wp.dot(light, scene.luminance)
    if not (is_finite3(light) and value > 0.0):
        return out
    out.total = kept.total + value
    share = value / out.total
    if kept.number >= share:
        out.number = (kept.number - share) / (1.0 - share)
        return out
    out.number = kept.number / share
    out.value = value
    lit.hit[slot] = wp.vec2i(point.instance, point.triangle)
    lit.barycentrics[slot] = wp.vec2(point.u, point.v)
    lit.direction[slot] = -point.wo
    lit.shadow_direction[slot] = s.wi
    lit.shadow_distance[slot] = wp.where(s.shadow == 0, -s.distance, s.distance)
    lit.shadow_light[slot] = light
    lit.shadow_pending[slot] = PENDING_NONE
    note_receiver(scene, point.instance, lit, slot)
    # Where it leads: leave_hair finds out where it starts.
    lit.shadow_origin[slot] = offset_origin(point.position + s.wi * s.distance, s.normal, s.error, -s.wi)
    if s.kind == LIGHT_TRIANGLE:
        lit.shadow_emitter[slot] = wp.vec2i(s.instance, s.triangle)
        lit.shadow_barycentrics[slot] = wp.vec2(s.u, s.v)
        material = triangle_material(scene, s.instance, s.triangle)
        if (load_material_flags(scene.materials.materials, material)[3] & MATERIAL_CONSTANT_EMISSION) == 0:
            # The radiance was an estimate: a program says what it is.
            lit.shadow_light[slot] = part
            lit.shadow_pending[slot] = PENDING_TRIANGLE
    else:
        note_blockers(scene, s.visibility, lit, slot)
    return out


@wp.func
def light_strand(
    scene: Scene, split: EnvironmentSplit, classes: LightClasses, emitters: wp.array[wp.uint64], point: ShadingPoint,
    lobes: HairLobes, throughput: wp.vec3, seed: wp.uint32, index: wp.uint32, dimension: int, kept: KeptLight,
    lit: Paths, slot: int,
) -> KeptLight:
    """Consider some lights for a strand."""
    out = kept
    which = sample_pair(seed, index, dimension + DIMENSION_LIGHT)
    place = sample_pair(seed, index, dimension + DIMENSION_PLACE)
    k = int(0)
    while k < CANDIDATES:
        step = float(k)
        choice = choose(
            scene, split, classes, point.position,
            wp.vec2(fraction(which[0] + step / float(CANDIDATES)), fraction(which[1] + step * STEP_REFILL)),
            wp.vec2(fraction(place[0] + step * STEP_X), fraction(place[1] + step * STEP_Y)))
        if choice.chance > 0.0:
            s = replay(scene, split, emitters, point.position, choice.candidate)
            if s.kind >= 0:
                s.visibility = kinds_lit(scene, s.visibility, point.instance)
                if (s.visibility & (VISIBLE_GLOSSY | VISIBLE_TRANSMISSION)) != 0:
                    scale = 1.0 / (s.pdf * choice.chance * float(CANDIDATES))
                    if s.kind == LIGHT_TRIANGLE:
                        face = scene.lights.triangles[candidate_index(choice.candidate)]
                        s.instance = face[0]
                        s.triangle = face[1]
                    part = wp.cw_mul(throughput, evaluate_hair(lobes, s.wi).f) * scale
                    out = keep_light(scene, point, s, part, out, lit, slot)
        k = k + 1
    return out


@wp.struct
class HairWalks:
    """What rays through hair know besides their paths: one entry a ray."""

    kept: wp.array[wp.vec3]
    """Of KeptLight: total, value, number"""
    leaves: wp.array[wp.uint8]
    """1: it has left a strand, in the path's direction"""


@wp.func
def load_kept(walks: HairWalks, slot: int) -> KeptLight:
    """Return the light that is kept so far."""
    packed = walks.kept[slot]
    kept = KeptLight()
    kept.total = packed[0]
    kept.value = packed[1]
    kept.number = packed[2]
    return kept


@wp.func
def scatter(
    scene: Scene, split: EnvironmentSplit, emitters: wp.array[wp.uint64], point: ShadingPoint, closure: Closure,
    strand: int, strands: int, walks: HairWalks, paths: Paths, lit: Paths, slot: int,
):
    """Scatter a ray in the strand at a point, which is the `strand`-th, from 0 on; it ends, or goes on to the next."""
    paths.state[slot] = ENDED
    seed = paths.seed[slot]
    index = paths.index[slot]
    if closure.kind != CLOSURE_HAIR:
        # There is none where all weights are 0.
        return
    dimension = DIMENSION_FIRST + strand * DIMENSIONS
    throughput = paths.throughput[slot]
    # What a strand emits is in the G-buffer, or found by light samples, as for all rays of rough surfaces.
    lobes = hair_lobes(closure, point)
    kept = load_kept(walks, slot)
    kept = light_strand(
        scene, split, light_classes(scene.lights, split), emitters, point, lobes, throughput, seed, index, dimension,
        kept, lit, slot)
    walks.kept[slot] = wp.vec3(kept.total, kept.value, kept.number)
    drawn = sample_hair(
        lobes, sample_pair(seed, index, dimension + DIMENSION_DIRECTION),
        sample_number(seed, index, dimension + DIMENSION_LOBE))
    throughput = wp.cw_mul(throughput, drawn.weight)
    leaves = drawn.pdf > 0.0 and is_finite3(throughput) and max_component(throughput) > 0.0
    if leaves and strand >= ROULETTE:
        survival = wp.min(max_component(throughput), SURVIVAL_MAX)
        leaves = sample_number(seed, index, dimension + DIMENSION_END) < survival
        throughput = throughput / survival
    walks.leaves[slot] = wp.where(leaves, wp.uint8(1), wp.uint8(0))
    if leaves:
        send_ray(scene, paths, slot, point, drawn.wi, drawn.kind, strand + 1)
        paths.origin[slot] = leaving_point(scene, point, drawn.wi)
        paths.throughput[slot] = throughput
        if strand + 1 >= strands:
            paths.state[slot] = ENDED


@wp.func
def begin_in_hair(
    views: wp.array[View], scene: Scene, options: ReflectionOptions, gbuffer: GBuffer, samples: ReflectionSamples,
    rays: ReflectionRays, paths: Paths, vertices: Vertices, lit: Paths, walks: HairWalks, slot: int,
) -> ShadingPoint:
    """Start a ray and return the point of hair that its pixel shows; of instance -1 where there is no ray."""
    point = ShadingPoint()
    point.instance = int(-1)
    lit.shadow_distance[slot] = 0.0
    lit.radiance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    walks.leaves[slot] = wp.uint8(0)
    view = views[0]
    start = find_start(view, options, samples, rays, paths, vertices, slot)
    if start.block < 0:
        return point
    point = stored_point(view, scene, gbuffer, options.width, start.pixel)
    start.seed = hash_combine(start.seed, HAIR_SEED)
    start_ray(
        samples, rays, paths, vertices, slot, start, -point.wo, wp.vec3(1.0, 1.0, 1.0), 1.0,
        wp.vec2(point.footprint, view.camera.spread * FOOTPRINT_SCALE))
    walks.kept[slot] = wp.vec3(0.0, 0.0, sample_number(start.seed, start.index, DIMENSION_FIRST + DIMENSION_KEPT))
    lit.seed[slot] = start.seed
    lit.index[slot] = start.index
    return point


@wp.func
def met_strand(scene: Scene, paths: Paths, slot: int) -> ShadingPoint:
    """Return the point of hair that a ray has met; one that has met something else, or nothing, ends: instance -1."""
    point = ShadingPoint()
    point.instance = int(-1)
    hit = paths.hit[slot]
    if scatters_as_hair(scene, hit[0], hit[1]):
        point = surface_point(scene, load_hit(paths, slot), paths.direction[slot])
        point.ray_visibility = paths.kind[slot]
        point.ray_length = paths.t[slot]
        point.ray_depth = paths.state[slot]
    else:
        paths.state[slot] = ENDED
    return point


@wp.kernel(cuda_max_registers=80)
def leave_hair(
    # In:
    first: int,
    scene: Scene,
    walks: HairWalks,
    # Out:
    paths_out: Paths,
    vertices_out: Vertices,
    lit_out: Paths,
):
    """Let the rays go on that have left the hair, and find where shadow rays start; see reference_hair.leave_hair."""
    slot = first + wp.tid()
    if walks.leaves[slot] == wp.uint8(1):
        paths_out.state[slot] = 1
        paths_out.kind[slot] = VISIBLE_DIFFUSE
        paths_out.t[slot] = FAR
        # What comes through hair is blurred whatever its distance.
        gather(vertices_out, slot, wp.vec3(0.0, 0.0, 0.0), SAMPLE_FAR)
    distance = lit_out.shadow_distance[slot]
    if distance == 0.0:
        return
    kept = load_kept(walks, slot)
    lit_out.shadow_light[slot] = lit_out.shadow_light[slot] * (kept.total / kept.value)
    point = surface_point(scene, load_hit(lit_out, slot), lit_out.direction[slot])
    target = lit_out.shadow_origin[slot]
    origin = leaving_point(scene, point, lit_out.shadow_direction[slot])
    lit_out.shadow_origin[slot] = origin
    if wp.abs(distance) < FAR:
        left = wp.length(target - origin)
        lit_out.shadow_distance[slot] = wp.where(distance < 0.0, -left, left)
        if left > 0.0:
            lit_out.shadow_direction[slot] = (target - origin) / left
