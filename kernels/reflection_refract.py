# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that draws the first directions of light from behind: through glass, or scattered by a translucent lobe.

Through glass from the real BSDF, which the G-buffer does not hold; what a leaf or a curtain scatters comes from the
half-space behind it, evenly by the cosine, and direct light has the lamps there (first_density). Where light from below
the surface comes from is found by reflection_below.py.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .gather_start import PDF_MIN
from .gbuffer import GBuffer, SurfaceMaterial, load_material
from .gbuffer_store import stored_point
from .geometry_math import INV_PI, is_finite3, max_component, over_albedo, to_frame
from .layering import prepare_bsdf
from .nodes import run
from .packing import unpack_normal
from .paths import Paths
from .reflectance import bsdf_albedo
from .reflection_glass import sample_transmission
from .reflection_rays import (
    DIMENSION_DIRECTION,
    DIMENSION_LOBE,
    FOUND_BELOW,
    RayStart,
    ReflectionRays,
    find_start,
    send_ray,
    start_ray,
)
from .reflection_types import SAMPLE_FAR, ReflectionOptions, ReflectionSamples, through_albedo, translucent_share
from .sampling import DIMENSION_FIRST_BOUNCE, sample_cosine, sample_number, sample_pair
from .sampling import DIMENSION_LOBE as CLOSURE_LOBE
from .tracing import FOOTPRINT_SCALE
from .types import VISIBLE_DIFFUSE, VISIBLE_TRANSMISSION, Scene, ShadingPoint
from .view import View
from .wide_loads import load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.struct
class FirstDirection:
    """A direction from which light comes through a surface."""

    wi: wp.vec3
    weight: wp.vec3
    """Value * cos / pdf / albedo, that of all that comes through"""
    pdf: float
    """Of its lobe [1/sr]; 0: none"""


@wp.func
def scattered_direction(
    m: SurfaceMaterial, normal: wp.vec3, point: ShadingPoint, start: RayStart, share: float,
) -> FirstDirection:
    """Draw a direction behind a translucent surface, with this `share` of all that are drawn there.

    One that lies on the wrong side of the triangle is absorbed, as in the path tracer.
    """
    s = FirstDirection()
    local = sample_cosine(sample_pair(start.seed, start.index, DIMENSION_DIRECTION))
    s.wi = wp.normalize(to_frame(-normal, local))
    s.pdf = wp.max(local[2] * INV_PI, PDF_MIN)
    if wp.dot(s.wi, point.geometric_normal) < 0.0:
        s.weight = over_albedo(m.translucent, through_albedo(m)) / share
    return s


@wp.func
def refracted_direction(
    scene: Scene, m: SurfaceMaterial, point: ShadingPoint, start: RayStart, pick: float, share: float,
) -> FirstDirection:
    """Draw a direction through glass, with this `share` of all that are drawn; `pick` chooses the closure."""
    s = FirstDirection()
    program = scene.materials.materials[point.material].surface_start
    bsdf = prepare_bsdf(scene.tables, run(scene, point, program, pick), point)
    drawn = sample_transmission(bsdf, point.wo, sample_pair(start.seed, start.index, DIMENSION_DIRECTION))
    # Not that of the G-buffer, which knows of the transparent layers in front.
    weight = over_albedo(drawn.weight, bsdf_albedo(scene.tables, bsdf, point.wo).transmitted)
    s.wi = drawn.wi
    s.pdf = drawn.pdf
    s.weight = wp.cw_mul(weight, over_albedo(m.transmitted, through_albedo(m))) / wp.max(share, 1.0e-6)
    return s


@wp.kernel
def start_refractions(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    options: ReflectionOptions,
    gbuffer: GBuffer,
    # Out:
    samples_out: ReflectionSamples,
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Draw a direction for each ray, by the shares of what glass lets through and what is scattered."""
    slot = first + wp.tid()
    view = load_view(views)
    start = find_start(view, options, samples_out, rays_out, paths_out, vertices_out, slot)
    if start.block < 0:
        return
    pixel = start.pixel
    m = load_material(gbuffer, pixel)
    point = stored_point(view, scene, gbuffer, options.width, pixel)
    share = translucent_share(m)
    kind = int(VISIBLE_DIFFUSE)
    light = FirstDirection()
    below = bool(False)
    if sample_number(start.seed, start.index, DIMENSION_LOBE) < share:
        # No closure has both a translucent lobe and light from below.
        below = max_component(m.scattered) > 0.0
        light = scattered_direction(m, unpack_normal(gbuffer.normal[pixel]), point, start, share)
    else:
        kind = int(VISIBLE_TRANSMISSION)
        # The closure that the G-buffer has drawn in this frame.
        choice = sample_pair(start.seed, wp.uint32(view.frame), DIMENSION_FIRST_BOUNCE + CLOSURE_LOBE)
        light = refracted_direction(scene, m, point, start, choice[1], 1.0 - share)
    if below:
        light.weight = over_albedo(m.scattered, through_albedo(m)) / share
    if not (light.pdf > 0.0 and is_finite3(light.weight)):
        light.weight = wp.vec3(0.0, 0.0, 0.0)
        light.wi = -point.wo
        light.pdf = 1.0
    start_ray(
        samples_out, rays_out, paths_out, vertices_out, slot, start, light.wi, light.weight, light.pdf,
        wp.vec2(point.footprint, view.camera.spread * FOOTPRINT_SCALE))
    if below:
        rays_out.found[slot] = FOUND_BELOW
        return
    if kind == VISIBLE_DIFFUSE:
        # What lies behind is blurred whatever its distance: filters need not keep apart what is close.
        vertices_out.emission[slot] = wp.vec4(0.0, 0.0, 0.0, SAMPLE_FAR)
    if max_component(light.weight) > 0.0:
        send_ray(scene, paths_out, slot, point, light.wi, kind, 1)
