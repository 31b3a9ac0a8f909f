# SPDX-License-Identifier: GPL-3.0-or-later
"""What a path's first surface does with light, by its lobes: albedos, and shares of what arrives; for light passes.

The surface is prepared once more from its closure, after the path tracer has shaded it and drawn a light and the next
ray: that kernel is bound by registers, and few pictures need this one. Shares are by the lobes' values for those two
directions, as Cycles' are: less noisy than by the lobe that was drawn.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import max_component, mean_component
from .hair_lobes import hair_albedo, hair_lobes
from .intersect import surface_point
from .layering import prepare_bsdf
from .light_linking import is_for
from .light_split import LightSplit
from .lights import class_total, sample_light_of
from .packing import rgb, rgba
from .path_shading import LIGHT_CANDIDATES, candidate_place, front_of
from .paths import ENDED, Paths, make_hit
from .principled import evaluate_bsdf
from .reflectance import bsdf_albedo
from .sampling import (
    DIMENSION_FIRST_BOUNCE,
    DIMENSION_LIGHT,
    DIMENSION_LIGHT_CHOICE,
    sample_number,
    sample_pair,
)
from .subsurface import without_subsurface
from .types import CLOSURE_HAIR, VISIBLE_DIFFUSE, VISIBLE_GLOSSY, VISIBLE_TRANSMISSION, Bsdf, Scene, ShadingPoint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

ALL_LOBES = wp.constant(2 | 4 | 8)
"""VISIBLE_DIFFUSE, VISIBLE_GLOSSY and VISIBLE_TRANSMISSION"""


@wp.func
def light_visibility(scene: Scene, point: ShadingPoint, bsdf: Bsdf, paths: Paths, path: int) -> int:
    """Return the visibility of the light that the path's shadow ray goes to: its lobes may be switched off.

    The light samples are drawn again with their numbers (see path_shading.sample_direct_light); the one kept is that
    in the shadow ray's direction.
    """
    seed = paths.seed[path]
    index = paths.index[path]
    place = sample_pair(seed, index, DIMENSION_FIRST_BOUNCE + DIMENSION_LIGHT)
    refill = sample_number(seed, index, DIMENSION_FIRST_BOUNCE + DIMENSION_LIGHT_CHOICE)
    side = front_of(bsdf)
    total = class_total(scene.lights, side)
    nearest = float(-2.0)
    visibility = int(ALL_LOBES)
    k = int(0)
    while k < LIGHT_CANDIDATES:
        s = sample_light_of(
            scene, total, point.position, side,
            candidate_place(place, float(k), LIGHT_CANDIDATES), refill)
        if s.kind >= 0:
            cosine = wp.dot(s.wi, paths.shadow_direction[path])
            # Lights for other objects may lie in the same place.
            if cosine > nearest and is_for(scene, s.visibility, point.instance):
                nearest = cosine
                visibility = s.visibility
        k = k + 1
    return visibility


@wp.func
def reflects(bsdf: Bsdf, wi: wp.vec3) -> bool:
    """Return whether a lobe that is not diffuse reflects light from `wi`, as against letting it through."""
    return not (bsdf.pick_glass > 0.0) or wp.dot(bsdf.specular_normal, wi) > 0.0


@wp.func
def share_of(bsdf: Bsdf, wo: wp.vec3, wi: wp.vec3, visibility: int, fallback: wp.vec4) -> wp.vec4:
    """Return a direction's LightSplit.lamp_share; `fallback` where no lobe but a mirror says anything.

    Args:
        bsdf: Prepared for `wo`.
        wo: Unit direction to the viewer.
        wi: Unit direction to the light.
        visibility: Lobes (VISIBLE_*) that the light counts for.
        fallback: What to return instead.
    """
    value = evaluate_bsdf(bsdf, wo, wi)
    reflected = reflects(bsdf, wi)
    diffuse = value.diffuse
    rest = value.f - value.diffuse
    if (visibility & VISIBLE_DIFFUSE) == 0:
        diffuse = wp.vec3(0.0, 0.0, 0.0)
    if (visibility & wp.where(reflected, VISIBLE_GLOSSY, VISIBLE_TRANSMISSION)) == 0:
        rest = wp.vec3(0.0, 0.0, 0.0)
    whole = diffuse + rest
    if not max_component(whole) > 0.0:
        return fallback
    # Where a channel has nothing to share, rounding may still leave light: it goes as the others do.
    mean = wp.clamp(mean_component(diffuse) / mean_component(whole), 0.0, 1.0)
    share = wp.vec3(mean, mean, mean)
    for c in range(3):
        if whole[c] > 0.0:
            share[c] = wp.clamp(diffuse[c] / whole[c], 0.0, 1.0)
    return rgba(share, wp.where(reflected, 1.0, 0.0))


@wp.func
def drawn_share(bsdf: Bsdf, kind: int) -> wp.vec4:
    """Return the share of light along a ray by the kind of lobe it was drawn from."""
    if (kind & VISIBLE_GLOSSY) != 0:
        return wp.vec4(0.0, 0.0, 0.0, 1.0)
    # What passes diffusely counts as diffuse.
    if (kind & VISIBLE_TRANSMISSION) != 0 and bsdf.pick_glass > 0.0:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    return wp.vec4(1.0, 1.0, 1.0, 1.0)


@wp.func
def albedo_share(split: LightSplit, path: int) -> wp.vec4:
    """Return the share of light by the first hit's albedos alone."""
    diffuse = mean_component(split.diffuse_color[path])
    glossy = mean_component(split.glossy_color[path])
    transmission = mean_component(split.transmission_color[path])
    share = diffuse / wp.max(diffuse + glossy + transmission, 1.0e-20)
    return wp.vec4(share, share, share, wp.where(glossy >= transmission, 1.0, 0.0))


@wp.func
def share_surface(scene: Scene, point: ShadingPoint, paths: Paths, split_out: LightSplit, path: int):
    """Find albedos and shares at a hit of a path."""
    bsdf = prepare_bsdf(scene.tables, paths.closure[path], point)
    albedo = bsdf_albedo(scene.tables, bsdf, point.wo)
    # Light of the shadow ray and of a ray reflected here has not been below the surface.
    bsdf = without_subsurface(bsdf, paths.closure[path]).bsdf
    arriving = split_out.throughput[path]
    split_out.diffuse_color[path] = wp.cw_mul(arriving, albedo.diffuse + albedo.translucent)
    split_out.glossy_color[path] = wp.cw_mul(arriving, albedo.specular)
    split_out.transmission_color[path] = wp.cw_mul(arriving, albedo.transmitted)
    k = int(0)
    while k < 2:
        # Of the shadow ray, then of the path's next ray.
        wi = paths.shadow_direction[path]
        visibility = int(ALL_LOBES)
        asked = paths.shadow_distance[path] != 0.0
        if k == 1:
            wi = paths.direction[path]
            asked = paths.state[path] != ENDED
        elif asked:
            visibility = light_visibility(scene, point, bsdf, paths, path)
        if asked:
            # A shadow ray starts off the surface: at the horizon it may leave for where no lobe looks.
            share = albedo_share(split_out, path)
            if k == 1:
                share = drawn_share(bsdf, paths.kind[path])
            # A mirror's ray has no density (pdf 0); what other lobes return in its direction is not in it.
            if k == 0 or paths.pdf[path] > 0.0:
                share = share_of(bsdf, point.wo, wi, visibility, share)
            if k == 0:
                split_out.lamp_share[path] = share
            else:
                split_out.path_share[path] = share
        k = k + 1


@wp.func
def share_hair(point: ShadingPoint, paths: Paths, split_out: LightSplit, path: int):
    """Find them on hair that scatters light: as in Cycles all of that is glossy."""
    closure = paths.closure[path]
    none = wp.vec3(0.0, 0.0, 0.0)
    split_out.diffuse_color[path] = none
    split_out.glossy_color[path] = wp.cw_mul(
        split_out.throughput[path], hair_albedo(closure, hair_lobes(closure, point)))
    split_out.transmission_color[path] = none
    split_out.lamp_share[path] = wp.vec4(0.0, 0.0, 0.0, 1.0)
    split_out.path_share[path] = wp.vec4(0.0, 0.0, 0.0, 1.0)


@wp.kernel
def share_first_light(
    # In:
    scene: Scene,
    paths: Paths,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    split_out: LightSplit,
):
    """Find albedos and shares at listed first hits; comes after shading, before shadow rays."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        ray = split_out.ray[path]
        point = surface_point(scene, make_hit(ray[3], paths.hit[path], paths.barycentrics[path]), rgb(ray))
        if paths.closure[path].kind == CLOSURE_HAIR:
            share_hair(point, paths, split_out, path)
        else:
            share_surface(scene, point, paths, split_out, path)
