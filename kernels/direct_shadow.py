# SPDX-License-Identifier: GPL-3.0-or-later
"""Each pixel's shadow ray: aimed at the chosen light, with the light that arrives unless it is blocked, and traced.

Where the scene has triangles that need a test, tracing.trace_shadow_layers and shadow_layers.py go on; where emission
is a program, shadow_lights.py runs it. Both leave their factor in the ray's radiance. Rays and kernels go by slots
(direct_reservoir.pixel_of_slot).
"""

from __future__ import annotations

import warp as wp

from .direct_emitters import is_constant
from .direct_light import PackedLight
from .direct_reservoir import DirectOptions, Reservoirs, has_sample, load_reservoir, pixel_of_slot
from .direct_terms import LightTerms, light_terms, lit_point, load_lit, scaled_terms
from .environment_split import EnvironmentSplit
from .gbuffer import GBuffer, has_surface, load_surface
from .geometry_math import luminance
from .intersect import any_hit, offset_origin
from .lamp_hit import FAR
from .lamp_sample import LightSample
from .light_candidate import CANDIDATE_EMITTER, candidate_index, candidate_kind, replay
from .light_linking import kinds_lit, note_blockers
from .packed_halves import pack_halves
from .packing import rgba
from .paths import PENDING_NONE, PENDING_TRIANGLE, Paths
from .terminator import shadow_origin
from .types import Scene, ShadingPoint
from .view import View
from .wide_loads import load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def start_ray(scene: Scene, point: ShadingPoint, s: LightSample, slot: int, rays: Paths):
    """Set up a shadow ray, as the reference does (set_shadow_ray); none where the light is too near."""
    origin = shadow_origin(scene.geometry, point, s.wi)
    direction = s.wi
    distance = s.distance
    if distance < FAR:
        # Aim at the sampled point again: the origin has moved.
        to_light = offset_origin(point.position + s.wi * s.distance, s.normal, s.error, -s.wi) - origin
        distance = wp.length(to_light)
        direction = to_light / wp.max(distance, 1.0e-30)
    if distance > 0.0:
        rays.shadow_origin[slot] = origin
        rays.shadow_direction[slot] = direction
        rays.shadow_distance[slot] = wp.where(s.shadow == 0, -distance, distance)


@wp.func
def start_factor(scene: Scene, emitter: int, s: LightSample, slot: int, rays: Paths):
    """Set up what layers and programs multiply: 1, or a textured emitter's over the estimate that it was drawn by.

    Args:
        scene: The scene.
        emitter: Emissive triangle that was drawn, -1 for other lights.
        s: The sample.
        slot: Of the ray.
        rays: Written.
    """
    light = float(1.0)
    rays.shadow_pending[slot] = PENDING_NONE
    note_blockers(scene, s.visibility, rays, slot)
    if emitter >= 0:
        face = scene.lights.triangles[emitter]
        if not is_constant(scene, face[0], face[1]):
            light = 1.0 / wp.max(luminance(s.radiance, scene.luminance), 1.0e-30)
            rays.shadow_pending[slot] = PENDING_TRIANGLE
            rays.shadow_emitter[slot] = face
            rays.shadow_barycentrics[slot] = wp.vec2(s.u, s.v)
    rays.shadow_light[slot] = wp.vec3(light, light, light)


@wp.kernel(cuda_max_registers=96)
def aim_shadow_rays(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    split: EnvironmentSplit,
    emitters: wp.array[wp.uint64],
    options: DirectOptions,
    gbuffer: GBuffer,
    reservoirs: Reservoirs,
    # Out:
    rays_out: Paths,
    light_out: PackedLight,
):
    """Set up the shadow ray of each pixel that has a sample, and write its light as if nothing were in the way."""
    slot = first + wp.tid()
    view = load_view(views)
    rays_out.shadow_distance[slot] = 0.0
    pixel = pixel_of_slot(view, options, slot)
    if pixel < 0 or not has_sample(view, options, slot):
        return
    if options.full == 1:
        rays_out.radiance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    light = LightTerms()
    r = load_reservoir(reservoirs, pixel)
    if r.count == 0.0:
        light_out.diffuse[pixel] = pack_halves(rgba(light.diffuse, 0.0))
        light_out.specular[pixel] = pack_halves(rgba(light.specular, 0.0))
        return
    surface = load_surface(view, gbuffer, options.width, pixel)
    if r.weight > 0.0 and has_surface(surface):
        point = lit_point(view, scene, gbuffer, surface, pixel)
        p = load_lit(view, gbuffer, surface, point.normal, pixel)
        s = replay(scene, split, emitters, point.position, r.candidate)
        if s.kind >= 0:
            s.visibility = kinds_lit(scene, s.visibility, point.instance)
            scale = r.weight * view.exposure
            light = scaled_terms(
                light_terms(scene, split, options, p, r.candidate, s), wp.vec3(scale, scale, scale))
            start_ray(scene, point, s, slot, rays_out)
            if options.full == 1:
                emitter = int(-1)
                if candidate_kind(r.candidate) == CANDIDATE_EMITTER:
                    emitter = candidate_index(r.candidate)
                start_factor(scene, emitter, s, slot, rays_out)
    light_out.diffuse[pixel] = pack_halves(rgba(light.diffuse, 1.0))
    light_out.specular[pixel] = pack_halves(rgba(light.specular, 1.0))


@wp.kernel(cuda_max_registers=64)
def trace_direct_shadows(
    # In:
    first: int,
    scene: Scene,
    # Out:
    rays_out: Paths,
):
    """Set the distance of blocked shadow rays to 0; below 0 it says that the light casts no shadow."""
    slot = first + wp.tid()
    distance = rays_out.shadow_distance[slot]
    if distance > 0.0:
        if any_hit(scene.geometry, rays_out.shadow_origin[slot], rays_out.shadow_direction[slot], distance):
            rays_out.shadow_distance[slot] = 0.0
