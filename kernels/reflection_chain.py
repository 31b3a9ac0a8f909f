# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens where a reflection ray meets a surface or the world: it ends there, or goes on over mirrors and glass.

A surface's sharp lobes send the ray on, all others end it, in proportion to their albedos and by chance; what it ends
in is lit by the radiance cache, which knows no direction. Functions, for the lean and the full node machine.
"""

from __future__ import annotations

import warp as wp

from .cache_materials import sane
from .cache_rays import Vertices
from .gbuffer import Surface, SurfaceMaterial
from .geometry_math import INV_PI, max_component, mean_component, to_frame
from .normals import valid_specular_normal
from .packing import pack_normal
from .paths import ENDED, Paths
from .reflectance import BsdfAlbedo, bsdf_albedo, fit_lobe
from .reflection_found import add_emission
from .reflection_glass import (
    CLEAR_ALPHA,
    INSIDE_ALPHA,
    GlassSample,
    as_cached,
    is_inside,
    let_out,
    sample_inside,
    sample_transmission,
    trapped_albedo,
)
from .reflection_highlights import BEHIND_MAX, HIGHLIGHT_ALBEDO, HitLobe, highlight_lobe, pack_lobe
from .reflection_rays import (
    DIMENSION_DIRECTION,
    DIMENSION_LOBE,
    DIMENSIONS,
    FOUND_DIRECT,
    FOUND_HIT,
    FOUND_WHOLE_HIT,
    GATHERED,
    REFRACTED,
    ReflectionRays,
    kind_through,
    passes_samples,
    send_ray,
    shared_with_samples,
)
from .reflection_shared import going_on, shared_density, shared_lobe
from .sampling import sample_cosine, sample_pair
from .specular_lobes import lobes_pdf, lobes_value, sample_lobes, specular_lobes
from .types import VISIBLE_DIFFUSE, VISIBLE_GLOSSY, Bsdf, Scene, ShadingPoint

# Lobes sharper than this send rays on; rougher ones show their surroundings too blurred to tell.
MIRROR_ROUGHNESS = wp.constant(0.3)

# Least share of a surface's albedo for which a ray goes on: from the first hit, and from later ones or after a lobe so
# wide (density [1/sr]) that it hides what weak mirrors show. A weaker mirror counts as rough: its light is kept.
SHARE_MIN_FIRST = wp.constant(0.08)
SHARE_MIN_FURTHER = wp.constant(0.25)
SHARE_MIN_WIDE = wp.constant(0.5)
"""After a lobe of a density below WIDE_DENSITY: panes of glass and real mirrors alone"""
WIDE_DENSITY = wp.constant(10.0)

# What meet_surface takes for `last`, besides 0.
LAST_OUTSIDE = wp.constant(1)
"""Rays end but in smooth glass"""
LAST = wp.constant(2)
LAST_CAUGHT = wp.constant(3)
"""All rays end, and those still inside of smooth glass are caught there: hardly any light is"""
LAST_LEAVES = wp.constant(4)
"""As LAST_OUTSIDE, but rays leave glass that is not clear: what that has thrown beyond the angle of total reflection
stays inside for a hundred surfaces and more, some percent of the light at an IOR of 2.4"""
# Further segments in smooth glass, for each bounce of the setting: a bottle with a liquid has six surfaces and more.
GLASS_FACTOR = wp.constant(2)

# Least part of the pixel's light for which a ray goes on.
PART_MIN = wp.constant(0.03)

BRANCH_END = wp.constant(0)
BRANCH_MIRROR = wp.constant(1)
BRANCH_GLASS = wp.constant(2)
BRANCH_SCATTER = wp.constant(3)
"""To either side of a translucent surface, for its indirect light"""


@wp.struct
class Branch:
    """How a ray goes on from a hit."""

    kind: int
    """BRANCH_*"""
    chance: float
    """Of that"""
    whole: int
    """1: the ray ends, and all lobes are taken for rough ones"""
    direct: int
    """1: where it ends it shows direct light alone, as others go on for the rest"""
    ends: float
    """Chance of ending there"""


@wp.func
def mirror_material(albedo: BsdfAlbedo) -> SurfaceMaterial:
    """Return the lobes that send a ray on: all that reflect, or a sharp coat on a rough base; `specular` 0: none."""
    m = SurfaceMaterial()
    m.roughness = albedo.roughness
    m.coat = albedo.coat
    m.coat_roughness = albedo.coat_roughness
    none = wp.vec3(0.0, 0.0, 0.0)
    if albedo.roughness < MIRROR_ROUGHNESS:
        m.specular = sane(albedo.specular)
    elif albedo.coat > 0.0 and albedo.coat_roughness < MIRROR_ROUGHNESS:
        m.specular = wp.vec3(albedo.coat, albedo.coat, albedo.coat)
    else:
        m.specular = none
    return m


@wp.func
def scatters(reflection: int, paths: Paths, slot: int) -> bool:
    """Return whether a ray goes on behind translucent surfaces: those that come from one do, as through a folded blind.

    The cache seldom knows the light between them, where no probe looks; where such a ray ends it shows direct light.
    """
    return reflection == REFRACTED and paths.kind[slot] == VISIBLE_DIFFUSE


@wp.func
def choose_branch(
    albedo: BsdfAlbedo, mirrored: wp.vec3, reflection: int, last: int, paths: Paths, slot: int, surfaces: int,
) -> Branch:
    """Choose between ending, a mirror, glass and, where a translucent surface has sent the ray, another one.

    Args:
        albedo: Of the hit.
        mirrored: Part of `albedo.specular` that sends rays on.
        reflection: REFLECTED, REFRACTED or GATHERED.
        last: Not 0: rays end here.
        paths: Rays.
        slot: Which.
        surfaces: Met so far.
    """
    throughput = paths.throughput[slot]
    mirror = mean_component(wp.cw_mul(throughput, mirrored))
    glass = mean_component(wp.cw_mul(throughput, sane(albedo.transmitted)))
    rough = mean_component(wp.cw_mul(throughput, sane(
        albedo.diffuse + albedo.translucent + albedo.specular - mirrored)))
    scatter = float(0.0)
    if scatters(reflection, paths, slot):
        if mean_component(wp.cw_mul(throughput, sane(albedo.translucent))) > PART_MIN:
            scatter = rough
    branch = Branch()
    branch.direct = wp.where(scatter > 0.0, 1, 0)
    branch.kind = BRANCH_END
    branch.chance = 1.0
    branch.whole = 1
    total = mirror + glass + scatter + rough
    least = SHARE_MIN_FIRST
    if surfaces > 1:
        least = SHARE_MIN_FURTHER
    if paths.pdf[slot] < WIDE_DENSITY:
        least = SHARE_MIN_WIDE
    if reflection == GATHERED and glass > 0.0:
        # Light samples know a way through glass.
        least = 1.0
    if last != 0 or not (scatter > 0.0 or mirror + glass > wp.max(least * total, PART_MIN)):
        branch.direct = 0
        return branch
    branch.whole = 0
    branch.ends = rough / total
    u = sample_pair(paths.seed[slot], paths.index[slot], DIMENSION_LOBE + DIMENSIONS * surfaces)[1] * total
    if u < mirror:
        branch.kind = BRANCH_MIRROR
        branch.chance = mirror / total
    elif u < mirror + glass:
        branch.kind = BRANCH_GLASS
        branch.chance = glass / total
    elif u < mirror + glass + scatter:
        branch.kind = BRANCH_SCATTER
        branch.chance = scatter / total
    else:
        branch.chance = rough / total
    return branch


@wp.func
def end_ray(
    point: ShadingPoint, albedo: BsdfAlbedo, mirrored: wp.vec3, shared: HitLobe, normal: wp.vec3, branch: Branch,
    rays: ReflectionRays, paths: Paths, vertices: Vertices, slot: int,
):
    """End a ray in a hit, for the cache to light; `shared`: from shared_lobe."""
    # Refracted light comes from the other side like that of the translucent lobe.
    behind = sane(albedo.translucent)
    before = sane(albedo.diffuse + albedo.specular)
    if branch.whole == 1:
        behind = behind + sane(albedo.transmitted)
    else:
        before = sane(before - mirrored)
    total = behind + before
    share = wp.clamp(mean_component(behind) / wp.max(mean_component(total), 1.0e-20), 0.0, 1.0)
    if rays.glossy == 1:
        rays.lobe[slot] = wp.uint64(0)
        if share < BEHIND_MAX and paths.pdf[slot] > rays.least_density:
            lobe = highlight_lobe(albedo, wp.where(branch.whole == 1, wp.vec3(0.0, 0.0, 0.0), mirrored), branch.chance)
            if shared.mirrored == 1:
                lobe = shared
                lobe.albedo = shared.albedo / branch.chance
            if mean_component(wp.cw_mul(paths.throughput[slot], lobe.albedo)) > HIGHLIGHT_ALBEDO:
                rays.lobe[slot] = pack_lobe(lobe)
    total = sane(total / branch.chance)
    vertices.reflectance[slot] = wp.vec4(total[0], total[1], total[2], share)
    if max_component(total) > 0.0:
        rays.found[slot] = wp.where(branch.whole == 1, FOUND_WHOLE_HIT, FOUND_HIT)
        if branch.direct == 1:
            rays.found[slot] = FOUND_DIRECT
    p = point.position
    vertices.position[slot] = wp.vec4(p[0], p[1], p[2], point.error)
    vertices.geometric_normal[slot] = pack_normal(point.geometric_normal)
    vertices.normal[slot] = pack_normal(normal)
    paths.state[slot] = ENDED


@wp.func
def follow(
    scene: Scene, point: ShadingPoint, direction: wp.vec3, weight: wp.vec3, pdf: float, kind: int, paths: Paths,
    slot: int,
):
    """Send a ray on from a hit; a weight of 0 ends it, black."""
    surfaces = paths.state[slot]
    throughput = sane(wp.cw_mul(paths.throughput[slot], weight))
    paths.throughput[slot] = throughput
    paths.state[slot] = ENDED
    if not max_component(throughput) > 0.0:
        return
    paths.cone[slot] = wp.vec2(point.footprint, paths.cone[slot][1])
    paths.pdf[slot] = wp.min(paths.pdf[slot], pdf)
    send_ray(scene, paths, slot, point, direction, kind, surfaces + 1)


@wp.func
def mirror_ray(
    scene: Scene, point: ShadingPoint, albedo: BsdfAlbedo, lobe: SurfaceMaterial, normal: wp.vec3, cosine: float,
    chance: float, shared: HitLobe, rays: ReflectionRays, paths: Paths, slot: int,
):
    """Send a ray on over a mirror: the lobes that fit the hit's albedo."""
    m = lobe
    if albedo.roughness < MIRROR_ROUGHNESS:
        m = fit_lobe(scene.tables, albedo, cosine, lobe)
    surface = Surface()
    surface.position = point.position
    surface.normal = normal
    surface.geometric_normal = point.geometric_normal
    lobes = specular_lobes(m, surface, point.wo)
    dimension = DIMENSIONS * paths.state[slot]
    seed = paths.seed[slot]
    index = paths.index[slot]
    pick = sample_pair(seed, index, DIMENSION_LOBE + dimension)
    direction = sample_lobes(lobes, sample_pair(seed, index, DIMENSION_DIRECTION + dimension), pick[0])
    pdf = lobes_pdf(lobes, direction)
    weight = wp.vec3(0.0, 0.0, 0.0)
    if pdf > 0.0 and wp.dot(direction, point.geometric_normal) > 0.0:
        weight = lobes_value(m, lobes, direction) / (pdf * chance)
    if shared.mirrored == 1:
        valid = valid_specular_normal(point.geometric_normal, point.wo, normal)
        rest = sane(albedo.diffuse + albedo.translucent + albedo.specular - lobe.specular)
        odds = going_on(shared.albedo, rest, paths.throughput[slot])
        rays.shared[slot] = odds * shared_density(shared.roughness, valid, point.wo, direction)
    follow(scene, point, direction, weight, pdf, VISIBLE_GLOSSY, paths, slot)


@wp.func
def scattered_ray(
    scene: Scene, point: ShadingPoint, albedo: BsdfAlbedo, before: wp.vec3, normal: wp.vec3, chance: float,
    paths: Paths, slot: int,
):
    """Send a ray on to either side of a translucent surface, which reflects `before` of the light in front of it.

    One that lies on the wrong side of the triangle is absorbed.
    """
    dimension = DIMENSIONS * paths.state[slot]
    pick = sample_pair(paths.seed[slot], paths.index[slot], DIMENSION_LOBE + dimension)
    behind = sane(albedo.translucent)
    share = mean_component(behind) / wp.max(mean_component(behind + before), 1.0e-20)
    side = float(-1.0)
    lobe = behind
    if pick[0] >= share:
        side = float(1.0)
        lobe = before
        share = 1.0 - share
    local = sample_cosine(sample_pair(paths.seed[slot], paths.index[slot], DIMENSION_DIRECTION + dimension))
    direction = wp.normalize(to_frame(normal * side, local))
    weight = wp.vec3(0.0, 0.0, 0.0)
    if wp.dot(direction, point.geometric_normal) * side > 0.0:
        weight = lobe / wp.max(chance * share, 1.0e-6)
    follow(scene, point, direction, weight, local[2] * INV_PI, VISIBLE_DIFFUSE, paths, slot)


@wp.func
def last_of(surfaces: int, segments: int) -> int:
    """Return what meet_surface takes for `last`, for the hit of that segment in a ray of so many.

    The host calls it too, where segments have launches of their own.
    """
    most = segments + GLASS_FACTOR * (segments - 1)
    if surfaces < segments:
        return 0
    if surfaces < most - 1:
        return LAST_OUTSIDE
    return LAST_LEAVES if surfaces < most else LAST_CAUGHT


@wp.func
def meet_surface(
    scene: Scene, point: ShadingPoint, bsdf: Bsdf, reflection: int, last: int, rays: ReflectionRays, paths: Paths,
    vertices: Vertices, slot: int,
):
    """Take in a hit: add what it emits, and send the ray on or end it; `last`: 0 or LAST*."""
    surfaces = paths.state[slot]
    inside = is_inside(bsdf, point)
    outer = bsdf
    if inside:
        outer.pick_glass = 0.0
    albedo = bsdf_albedo(scene.tables, outer, point.wo)
    if inside:
        # Both halves of the glass go on together.
        albedo.transmitted = trapped_albedo(scene.tables, bsdf, point.wo)
    add_emission(scene, point, bsdf.emission, reflection, rays, paths, vertices, slot)
    lobe = mirror_material(albedo)
    smooth = bsdf.pick_glass > 0.0 and bsdf.glass_alpha <= INSIDE_ALPHA
    ends = wp.where((last == LAST_OUTSIDE or last == LAST_LEAVES) and smooth, 0, last)
    branch = choose_branch(albedo, lobe.specular, reflection, ends, paths, slot, surfaces)
    shared = HitLobe()
    before = float(0.0)
    if rays.glossy == 1:
        before = shared_with_samples(rays, paths, slot)
        rays.shared[slot] = 0.0
        if branch.whole == 0:
            shared = shared_lobe(albedo, lobe.specular, paths.throughput[slot], paths.pdf[slot], branch.ends)
    if branch.kind == BRANCH_MIRROR:
        cosine = wp.dot(bsdf.specular_normal, point.wo)
        mirror_ray(scene, point, albedo, lobe, bsdf.normal, cosine, branch.chance, shared, rays, paths, slot)
    elif branch.kind == BRANCH_GLASS:
        seed = paths.seed[slot]
        index = paths.index[slot]
        place = sample_pair(seed, index, DIMENSION_DIRECTION + DIMENSIONS * surfaces)
        s = GlassSample()
        stays = bool(False)
        if inside:
            choice = sample_pair(seed, index, DIMENSION_LOBE + DIMENSIONS * surfaces)
            s = sample_inside(bsdf, albedo.transmitted, point.wo, place, choice[0], surfaces)
            if last == LAST_LEAVES and bsdf.glass_alpha > CLEAR_ALPHA:
                # As from a translucent surface: a shadow ray brings lights, which would be sparks, and a ray the rest.
                s = let_out(bsdf, albedo.transmitted, place)
                s.kind = VISIBLE_DIFFUSE
                stays = choice[0] < 0.5
                branch.chance = 0.5 * branch.chance
        else:
            s = sample_transmission(bsdf, point.wo, place)
        if stays:
            branch.whole = 1
            branch.direct = 1
            left = BsdfAlbedo()
            left.transmitted = albedo.transmitted
            end_ray(point, left, wp.vec3(0.0, 0.0, 0.0), HitLobe(), bsdf.normal, branch, rays, paths, vertices, slot)
        else:
            kind = kind_through(scene, point, s.wi, s.kind, paths, slot)
            if before > 0.0 and passes_samples(scene, point, s.wi, s.kind):
                rays.shared[slot] = before
            follow(scene, point, s.wi, s.weight / branch.chance, s.pdf, kind, paths, slot)
    elif branch.kind == BRANCH_SCATTER:
        reflected = sane(albedo.diffuse + albedo.specular - lobe.specular)
        scattered_ray(scene, point, albedo, reflected, bsdf.normal, branch.chance, paths, slot)
    else:
        if inside:
            albedo = as_cached(bsdf, albedo, point.wo)
            albedo.reflected = wp.vec3(0.0, 0.0, 0.0)
            albedo.coat = 0.0
        if last == LAST_CAUGHT and inside and smooth:
            albedo.transmitted = wp.vec3(0.0, 0.0, 0.0)
        end_ray(point, albedo, lobe.specular, shared, bsdf.normal, branch, rays, paths, vertices, slot)
