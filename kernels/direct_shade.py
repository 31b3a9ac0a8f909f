# SPDX-License-Identifier: GPL-3.0-or-later
"""Direct light from the chosen samples and what their shadow rays found.

A pixel without a sample of its own takes that of a neighbour on the same surface: light, weight and shadow are the
neighbour's, but it is replayed for the pixel's own surface, so that normals, textures and reflections keep the full
resolution. Where no neighbour shows the same surface the pixel says that it has no sample (w = 0). So it does where its
mean over the frames before is worth more: what neighbours lend blurs the edges of shadows.
"""

from __future__ import annotations

import warp as wp

from .direct_light import PackedLight
from .direct_reservoir import (
    COARSE_SINE,
    DirectOptions,
    Reservoirs,
    has_sample,
    load_reservoir,
    pixel_of_slot,
    slot_of_pixel,
)
from .direct_temporal import DirectHistory
from .direct_terms import LightTerms, light_terms, load_lit, scaled_terms
from .direct_turns import known_pixel
from .environment_split import EnvironmentSplit
from .gbuffer import (
    SURFACE_BACKFACING,
    GBuffer,
    Surface,
    barycentrics_of,
    has_surface,
    load_surface,
    plane_distance,
)
from .geometry_math import max_component, normalize_or, transform_normal
from .light_candidate import replay
from .light_linking import kinds_lit_at, same_links
from .packed_halves import pack_halves, unpack_halves
from .packing import rgb, rgba
from .paths import Paths
from .reprojection import Reprojection
from .sampling import hash_combine, pixel_seed_of
from .types import Scene
from .view import View, pixel_footprint
from .wide_loads import interpolated_normal, load_instance, load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Cosine between the normals of neighbours that may lend each other their samples.
NEIGHBOUR_COSINE = wp.constant(0.9)


@wp.func
def factor_of(options: DirectOptions, rays: Paths, slot: int) -> wp.vec3:
    """Return what became of a ray: its transmittance times what a program says over the sample's estimate."""
    seen = rays.shadow_distance[slot] != 0.0
    one = wp.where(seen, 1.0, 0.0)
    factor = wp.vec3(one, one, one)
    if options.full == 1:
        if seen:
            factor = rays.shadow_light[slot]
        factor = factor + rgb(rays.radiance[slot])
    return factor


@wp.func
def is_same_surface(view: View, options: DirectOptions, gbuffer: GBuffer, surface: Surface, q: int) -> bool:
    """Return whether a pixel shows the same surface, so that its shadow ray counts here too."""
    other = load_surface(view, gbuffer, options.width, q)
    if not has_surface(other):
        return False
    return (wp.dot(other.normal, surface.normal) > NEIGHBOUR_COSINE
            and wp.dot(other.geometric_normal, surface.geometric_normal) > NEIGHBOUR_COSINE
            and plane_distance(surface, other.position) < 2.0 * pixel_footprint(view.camera, surface.depth))


@wp.func
def choose_lender(
    scene: Scene, view: View, options: DirectOptions, gbuffer: GBuffer, reservoirs: Reservoirs, surface: Surface,
    pixel: int,
) -> int:
    """Return one of the four neighbours that have a sample and show the same surface; -1: none.

    Any is as likely as its order after a random one.
    """
    x = pixel % options.width
    y = pixel // options.width
    start = int(hash_combine(pixel_seed_of(x, y, view.camera.seed), wp.uint32(view.frame)) & wp.uint32(3))
    k = int(0)
    while k < 4:
        # 0..3: left, above, right, below.
        side = (start + k) & 3
        dx = wp.where((side & 1) == 0, side - 1, 0)
        dy = wp.where((side & 1) == 1, 2 - side, 0)
        if x + dx >= 0 and x + dx < options.width and y + dy >= 0 and y + dy < options.height:
            q = pixel + dy * options.width + dx
            if reservoirs.weight[q][1] > 0.0 and is_same_surface(view, options, gbuffer, surface, q):
                if same_links(scene, gbuffer, pixel, q):
                    return q
        k = k + 1
    return -1


@wp.func
def smooth_normal(scene: Scene, gbuffer: GBuffer, surface: Surface, pixel: int) -> wp.vec3:
    """Return the interpolated normal of a pixel's surface, without normal map or bump, as surface_point has it."""
    hit = gbuffer.hit[pixel]
    b = barycentrics_of(gbuffer, pixel)
    local = interpolated_normal(scene.geometry, hit[1], b[0], b[1])
    side = wp.where((gbuffer.material[pixel] & SURFACE_BACKFACING) != wp.uint32(0), -1.0, 1.0)
    world = transform_normal(load_instance(scene.geometry.instances, hit[0]).to_object, local)
    return normalize_or(world * side, surface.geometric_normal)


@wp.func
def weaken(options: DirectOptions, rays: Paths, slot: int, pixel: int, light: PackedLight):
    """Multiply a pixel's light by what its own ray found; does nothing where it has left its turn out."""
    factor = factor_of(options, rays, slot)
    if factor[0] == 1.0 and factor[1] == 1.0 and factor[2] == 1.0:
        return
    diffuse = unpack_halves(light.diffuse[pixel])
    if diffuse[3] == 0.0:
        return
    terms = LightTerms()
    if max_component(factor) > 0.0:
        terms.diffuse = rgb(diffuse)
        terms.specular = rgb(unpack_halves(light.specular[pixel]))
        terms = scaled_terms(terms, factor)
    light.diffuse[pixel] = pack_halves(rgba(terms.diffuse, 1.0))
    light.specular[pixel] = pack_halves(rgba(terms.specular, 1.0))


@wp.kernel(cuda_max_registers=72)
def shade_direct(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    split: EnvironmentSplit,
    emitters: wp.array[wp.uint64],
    options: DirectOptions,
    gbuffer: GBuffer,
    reservoirs: Reservoirs,
    lent: wp.array[float],
    rays: Paths,
    reprojection: Reprojection,
    history: DirectHistory,
    # Out:
    light_out: PackedLight,
):
    """Write each pixel's direct light, without colours, exposed; own samples' light is there but for its shadow.

    `history` is of the frame before; without elements: no mean is kept.
    """
    slot = first + wp.tid()
    view = load_view(views)
    pixel = pixel_of_slot(view, options, slot)
    if pixel < 0:
        return
    if has_sample(view, options, slot):
        weaken(options, rays, slot, pixel, light_out)
        return
    if known_pixel(view, options, reprojection, history, pixel) >= 0:
        light_out.diffuse[pixel] = wp.uint64(0)
        light_out.specular[pixel] = wp.uint64(0)
        return
    light = LightTerms()
    sampled = float(1.0)
    surface = load_surface(view, gbuffer, options.width, pixel)
    if has_surface(surface):
        q = choose_lender(scene, view, options, gbuffer, reservoirs, surface, pixel)
        if q < 0:
            sampled = 0.0
        else:
            factor = factor_of(options, rays, slot_of_pixel(view, options, q))
            factor = factor * (lent[q] * view.exposure)
            if max_component(factor) > 0.0:
                candidate = load_reservoir(reservoirs, q).candidate
                s = replay(scene, split, emitters, surface.position, candidate)
                s.visibility = kinds_lit_at(scene, gbuffer, pixel, s.visibility)
                smooth = surface.geometric_normal
                if wp.abs(wp.dot(smooth, s.wi)) < COARSE_SINE:
                    smooth = smooth_normal(scene, gbuffer, surface, pixel)
                p = load_lit(view, gbuffer, surface, smooth, pixel)
                light = scaled_terms(light_terms(scene, split, options, p, candidate, s), factor)
    light_out.diffuse[pixel] = pack_halves(rgba(light.diffuse, sampled))
    light_out.specular[pixel] = pack_halves(rgba(light.specular, sampled))
