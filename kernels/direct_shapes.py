# SPDX-License-Identifier: GPL-3.0-or-later
"""Direct light on surfaces whose lobes the G-buffer doesn't hold: rough diffuse, sheen, stretched highlights.

The G-buffer says how much light a surface reflects, and has Lambert's and round lobes for where it goes. Where the
real ones differ (SURFACE_SHAPED) the material is run once more and asked what it reflects of the pixel's light sample.
Only scenes that have such materials have this launch.
"""

from __future__ import annotations

import warp as wp

from .direct_light import PackedLight
from .direct_reservoir import DirectOptions, Reservoirs, has_sample, load_reservoir, pixel_of_slot, slot_of_pixel
from .direct_shade import choose_lender, factor_of
from .direct_terms import lit_point
from .environment_split import EnvironmentSplit
from .gbuffer import SURFACE_SHAPED, GBuffer, Surface, load_surface
from .gbuffer_store import closure_number
from .geometry_math import is_finite3, max_component, mean_component
from .layering import prepare_bsdf
from .light_candidate import replay
from .light_linking import kinds_lit_at
from .lobes import LOBE_NONE, evaluate_diffuse_lobes, evaluate_specular_lobes
from .nodes import run
from .packed_halves import pack_halves, unpack_halves
from .packing import rgb, rgba
from .paths import Paths
from .reflectance import bsdf_albedo
from .tracing import FOOTPRINT_SCALE
from .types import VISIBLE_CAMERA, VISIBLE_DIFFUSE, Bsdf, Scene, ShadingPoint, Tables
from .view import View, eye_position

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Albedo below which a lobe's light counts for nothing.
ALBEDO_MIN = wp.constant(1.0e-5)
# Most that a stretched lobe shows of what the round one does: more is sparks where the round one has next to nothing.
STRETCH_MAX = wp.constant(32.0)


@wp.func
def seen_point(view: View, scene: Scene, gbuffer: GBuffer, surface: Surface, pixel: int) -> ShadingPoint:
    """Return the point that a pixel shows, as its material is run at it (gbuffer_store.pixel_point)."""
    point = lit_point(view, scene, gbuffer, surface, pixel)
    point.ray_length = wp.length(eye_position(view.camera) - point.position)
    point.footprint = (view.camera.pixel_size + view.camera.spread * point.ray_length) * FOOTPRINT_SCALE
    point.ray_visibility = VISIBLE_CAMERA
    point.ray_depth = 0
    return point


@wp.func
def seen_bsdf(view: View, scene: Scene, width: int, point: ShadingPoint, pixel: int) -> Bsdf:
    """Return the BSDF that the G-buffer's albedos of a pixel are of: of a mix, the one drawn in this frame."""
    start = scene.materials.materials[point.material].surface_start
    closure = run(scene, point, start, closure_number(view, width, pixel))
    return prepare_bsdf(scene.tables, closure, point)


@wp.func
def shaped_diffuse(tables: Tables, bsdf: Bsdf, wo: wp.vec3, wi: wp.vec3) -> wp.vec3:
    """Return the diffuse lobes' value over their albedo."""
    albedo = bsdf_albedo(tables, bsdf, wo)
    value = evaluate_diffuse_lobes(bsdf, wo, wi, LOBE_NONE).f
    total = albedo.diffuse + albedo.translucent
    for c in range(3):
        value[c] = wp.where(total[c] > ALBEDO_MIN, value[c] / wp.max(total[c], ALBEDO_MIN), 0.0)
    return value


@wp.func
def stretch(bsdf: Bsdf, wo: wp.vec3, wi: wp.vec3) -> float:
    """Return what the stretched lobe reflects over what a round one as rough reflects."""
    stretched = mean_component(evaluate_specular_lobes(bsdf, wo, wi, LOBE_NONE).f)
    circle = bsdf
    circle.alpha_x = wp.sqrt(bsdf.alpha_x * bsdf.alpha_y)
    circle.alpha_y = circle.alpha_x
    total = mean_component(evaluate_specular_lobes(circle, wo, wi, LOBE_NONE).f)
    if not total > 0.0:
        return 1.0
    return wp.min(stretched / total, STRETCH_MAX)


@wp.kernel
def shape_direct(
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
    # Out:
    light_out: PackedLight,
):
    """Replace the direct light of shaped surfaces by what their materials reflect; comes after shade_direct."""
    slot = first + wp.tid()
    view = views[0]
    pixel = pixel_of_slot(view, options, slot)
    if pixel < 0:
        return
    if (gbuffer.material[pixel] & SURFACE_SHAPED) == wp.uint32(0):
        return
    surface = load_surface(view, gbuffer, options.width, pixel)
    source = int(pixel)
    weight = float(0.0)
    if has_sample(view, options, slot):
        weight = load_reservoir(reservoirs, pixel).weight
    elif unpack_halves(light_out.diffuse[pixel])[3] == 0.0:
        # shade_direct has found no lender, or asked for none.
        return
    else:
        source = choose_lender(scene, view, options, gbuffer, reservoirs, surface, pixel)
        weight = lent[source]
    factor = factor_of(options, rays, slot_of_pixel(view, options, source)) * (weight * view.exposure)
    if not max_component(factor) > 0.0:
        return
    point = seen_point(view, scene, gbuffer, surface, pixel)
    s = replay(scene, split, emitters, point.position, load_reservoir(reservoirs, source).candidate)
    if s.kind < 0:
        return
    bsdf = seen_bsdf(view, scene, options.width, point, pixel)
    if (kinds_lit_at(scene, gbuffer, pixel, s.visibility) & VISIBLE_DIFFUSE) != 0:
        light = wp.cw_mul(shaped_diffuse(scene.tables, bsdf, point.wo, s.wi), s.radiance / s.pdf)
        light = wp.cw_mul(light, factor)
        if is_finite3(light):
            light_out.diffuse[pixel] = pack_halves(rgba(light, 1.0))
    if bsdf.alpha_x != bsdf.alpha_y:
        specular = unpack_halves(light_out.specular[pixel])
        light_out.specular[pixel] = pack_halves(rgba(rgb(specular) * stretch(bsdf, point.wo, s.wi), specular[3]))
