# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that chooses a light for every hit of a reflection ray in scenes where hits may show highlights.

It does what choose_reflection_lights does, and tells what the lobe of a hit (reflection_highlights.py) makes of its
light sample: ReflectionRays.highlight. Hits whose light the frame before shows get a shadow ray where a highlight is
missing there.
"""

from __future__ import annotations

import warp as wp

from .cache_lights import sampled_density, send_to_light
from .cache_rays import Vertices
from .geometry_math import INV_PI, mean_component, power_heuristic
from .hash_grid import NO_CELL, HashGrid
from .intersect import surface_point
from .lamp_sample import LightSample
from .light_linking import kinds_lit
from .lights import cell_side, sample_light
from .packing import rgb, unpack_normal
from .paths import Paths, has_hit, load_hit
from .reflection_choice import DIMENSION_CANDIDATE, STREAM_PICK, emitted
from .reflection_highlights import Highlight, lobe_albedo, lobe_density, make_highlight, unpack_lobe
from .reflection_rays import FOUND_DIRECT, FOUND_SCREEN, ReflectionRays
from .reflection_shared import going_on, shared_density
from .sampling import BELOW_ONE, hashed_unit, sample_number, sample_pair
from .types import VISIBLE_DIFFUSE, VISIBLE_GLOSSY, Scene, ShadingPoint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

STREAM_SPARE = wp.constant(wp.uint32(0x53504152))

# Least part of the weight that a sample has for matte light: cells take it in.
MATTE_MIN = wp.constant(0.3)
# Part of the light of a hit in the frame before that a missing highlight must have for a shadow ray for certain; less
# gets one by chance.
SCREEN_PART = wp.constant(0.25)


@wp.struct
class GlossyHit:
    """A hit that looks for a light."""

    normal: wp.vec3
    behind: float
    """Share of its light that comes from behind"""
    lit: int
    """0: the frame before shows its light, but for what its highlight adds"""
    weighed: int
    """1: rays bring their share of what triangles emit, as matte light"""
    share: float
    """Of the lobe in the hit's reflectance; 0: it shows no highlights"""
    lobe: Highlight
    shared: float
    """Roughness of a lobe that shares lights with rays (reflection_shared.py), not in the hit's reflectance; 0: none"""
    odds: float
    """From going_on"""


@wp.struct
class LightParts:
    """What a hit makes of a light sample [1/sr]."""

    weight: float
    """By which it is chosen"""
    matte: float
    """Irradiance / pi, of what is sampled for the cells"""
    lobe: float
    """The lobe's, over its albedo; less what it gets as matte light by other ways"""


@wp.func
def light_parts(scene: Scene, hit: GlossyHit, point: ShadingPoint, s: LightSample, kinds: int) -> LightParts:
    """Return what a hit makes of a light sample that lights `kinds` of its lobes."""
    parts = LightParts()
    density = sampled_density(hit.normal, hit.behind, hit.weighed, s)
    parts.matte = density
    parts.weight = density
    parts.lobe = 0.0
    if hit.share > 0.0:
        if (kinds & VISIBLE_GLOSSY) != 0 and wp.dot(point.geometric_normal, s.wi) > 0.0:
            # What is shared needs no wider lobe: the heuristic keeps sparks away.
            narrow = wp.where(hit.shared > 0.0, 1, s.delta)
            parts.lobe = lobe_density(scene.tables, hit.lobe, s.wi, s.pdf, narrow)
            if hit.shared > 0.0 and s.delta == 0:
                parts.lobe *= power_heuristic(
                    s.pdf, hit.odds * shared_density(hit.shared, hit.lobe.normal, hit.lobe.wo, s.wi))
        whole = wp.max(wp.dot(hit.normal, s.wi), 0.0) * INV_PI
        if hit.lit == 1:
            if hit.shared == 0.0:
                # The rest of a weighed sample comes by rays, as matte light.
                parts.lobe = parts.lobe - wp.max(whole - density, 0.0)
            parts.weight = density * wp.max(1.0 - hit.share, MATTE_MIN) + hit.share * wp.max(parts.lobe, 0.0)
        else:
            parts.lobe = parts.lobe - whole
            parts.matte = wp.abs(parts.lobe)
            parts.weight = parts.matte
    return parts


@wp.func
def shadow_chance(paths: Paths, vertices: Vertices, word: wp.uint64, missing: float, slot: int) -> float:
    """Return the chance of a shadow ray for a hit that the frame before shows, whose lobe misses so much light."""
    known = mean_component(rgb(vertices.emission[slot]))
    added = mean_component(wp.cw_mul(paths.throughput[slot], lobe_albedo(word))) * missing
    return wp.min(added / wp.max(SCREEN_PART * known, 1.0e-20), 1.0)


@wp.func
def choose_light(
    scene: Scene, world: wp.array[wp.vec3], ways: wp.array[wp.vec3], hit: GlossyHit, word: wp.uint64, candidates: int,
    rays: ReflectionRays, paths: Paths, vertices: Vertices, point: ShadingPoint, slot: int,
):
    """Choose one of a hit's samples of light by what it makes of them, and set up its shadow ray."""
    seed = paths.seed[slot]
    index = paths.index[slot]
    side = cell_side(hit.normal, hit.behind, hit.weighed)
    if hit.shared > 0.0:
        # Rays don't know the normal of where they have begun.
        side = wp.vec3(0.0, 0.0, 0.0)
    chosen = LightSample()
    kept = LightParts()
    target = float(0.0)
    total = float(0.0)
    k = int(0)
    while k < candidates:
        dimension = DIMENSION_CANDIDATE + 3 * k
        # Stratified over the classes of lights.
        u = sample_pair(seed, index, dimension)
        choice = wp.min((float(k) + u[0]) / float(candidates), BELOW_ONE)
        s = sample_light(
            scene, point.position, side, wp.vec2(choice, u[1]), sample_number(seed, index, dimension + 1))
        kinds = kinds_lit(scene, s.visibility, point.instance)
        if s.kind >= 0 and (kinds & VISIBLE_DIFFUSE) != 0:
            value = wp.float32(1.0)
            if candidates > 1:
                value = mean_component(wp.cw_mul(s.radiance, emitted(scene, world, s)))
            parts = light_parts(scene, hit, point, s, kinds)
            weight = value * parts.weight / s.pdf
            if weight > 0.0 and wp.isfinite(weight):
                total = total + weight
                if hashed_unit(seed ^ STREAM_PICK, index * wp.uint32(candidates) + wp.uint32(k)) * total < weight:
                    chosen = s
                    kept = parts
                    target = value * parts.weight
        k = k + 1
    if not target > 0.0 or not kept.matte > 0.0:
        return
    scale = total / (target * float(candidates))
    if hit.lit == 0 and candidates > 1:
        chance = shadow_chance(paths, vertices, word, scale * target, slot)
        if hashed_unit(seed ^ STREAM_SPARE, index) >= chance:
            return
        scale = scale / chance
    rays.highlight[slot] = kept.lobe / kept.matte
    light = chosen.radiance * (kept.matte * scale)
    send_to_light(scene, world, ways, point, chosen, light, paths, slot)


@wp.kernel(cuda_max_registers=168)
def choose_glossy_lights(
    # In:
    first: int,
    scene: Scene,
    world: wp.array[wp.vec3],
    grid: HashGrid,
    candidates: int,
    # Out:
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Choose one of `candidates` samples of light at every hit and set up its shadow ray, for cells and highlights.

    The shadow ray carries matte light; the highlight is that times ReflectionRays.highlight. A hit of the frame before
    carries what its highlight adds alone.
    """
    slot = first + wp.tid()
    paths_out.shadow_distance[slot] = 0.0
    paths_out.radiance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if not has_hit(paths_out, slot) or scene.lights.class_count == 0:
        return
    reflectance = vertices_out.reflectance[slot]
    total = mean_component(rgb(reflectance))
    found = rays_out.found[slot]
    word = wp.uint64(0)
    if total > 0.0 or found == FOUND_SCREEN:
        word = rays_out.lobe[slot]
    if not total > 0.0 and word == wp.uint64(0):
        return
    point = surface_point(scene, load_hit(paths_out, slot), paths_out.direction[slot])
    hit = GlossyHit()
    hit.normal = unpack_normal(vertices_out.normal[slot])
    hit.behind = reflectance[3]
    hit.lit = wp.where(total > 0.0, 1, 0)
    hit.weighed = grid.weighed
    if found == FOUND_DIRECT or hit.lit == 0:
        hit.weighed = 0
        vertices_out.cell[slot] = NO_CELL
    hit.share = 0.0
    hit.shared = 0.0
    if word != wp.uint64(0):
        lobe = unpack_lobe(word)
        hit.lobe = make_highlight(lobe, point, hit.normal, paths_out.pdf[slot])
        hit.share = 1.0
        if lobe.mirrored == 1:
            hit.shared = lobe.roughness
            hit.odds = going_on(lobe.albedo, rgb(reflectance), paths_out.throughput[slot])
            hit.share = mean_component(lobe.albedo) / (mean_component(lobe.albedo) + total)
        elif hit.lit == 1:
            hit.share = wp.min(mean_component(lobe.albedo) / total, 1.0)
    choose_light(scene, world, grid.ways, hit, word, candidates, rays_out, paths_out, vertices_out, point, slot)
