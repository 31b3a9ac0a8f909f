# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that looks whether the frame before shows the hits of reflection rays, and takes its light if so.

Only of rough, mostly diffuse surfaces that don't shine, and of these the diffuse light alone, which is the same from
everywhere: a floor that shows the camera the sun's highlight shows a mirror none (with the picture itself, as
published, a metal ball on such a floor was 4.6 times too bright there). The hit's reflectance makes radiance of it, as
of the cache's light. GI-1.0's tests of depth and normal (Boissé et al. 2023), and one against the plane.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .gbuffer import (
    SURFACE_COATED,
    SURFACE_EMITS,
    SURFACE_TRANSMITS,
    GBuffer,
    has_surface,
    load_material,
    load_previous_surface,
    plane_distance,
)
from .geometry_math import is_finite3, mean_component
from .long_mean import unpack_mean
from .motion import Motion, previous_point
from .packing import rgb, unpack_normal
from .paths import Paths
from .reflection_rays import FOUND_SCREEN, FOUND_WHOLE_HIT, ReflectionRays, gather
from .types import Scene
from .view import View, pixel_footprint, pixel_of, project, settling_frames

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Relative difference of depth, least cosine of the normals, and distance from the plane in pixels' widths.
DEPTH_SLACK = wp.constant(0.01)
NORMAL_COSINE = wp.constant(0.95)
PLANE_PIXELS = wp.constant(2.0)

# Largest share of reflection in a surface's albedo, and the same for rough reflection.
SPECULAR_SHARE = wp.constant(0.15)
ROUGH_SHARE = wp.constant(0.3)
ROUGH = wp.constant(0.4)

# Frames that light needs to spread before the picture is worth looking at.
SETTLED_FRAMES = wp.constant(8.0)


@wp.func
def looks_alike(gbuffer: GBuffer, pixel: int) -> bool:
    """Return whether a surface looks about the same from everywhere."""
    m = load_material(gbuffer, pixel)
    if (m.flags & (SURFACE_EMITS | SURFACE_TRANSMITS | SURFACE_COATED)) != wp.uint32(0):
        return False
    specular = mean_component(m.specular)
    total = specular + mean_component(m.diffuse + m.translucent)
    return specular <= total * wp.where(m.roughness > ROUGH, ROUGH_SHARE, SPECULAR_SHARE)


@wp.kernel
def look_back(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    motion: Motion,
    width: int,
    height: int,
    reuse: int,
    previous: GBuffer,
    previous_matte: wp.array[wp.uint64],
    # Out:
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Mark hits that must be lit (state 1); take the light of those that the frame before shows, with `reuse` 1."""
    slot = first + wp.tid()
    r = vertices_out.reflectance[slot]
    if not wp.max(r[0], wp.max(r[1], r[2])) > 0.0:
        return
    paths_out.state[slot] = 1
    view = views[0]
    if reuse == 0 or view.restart == 1 or settling_frames(view) < SETTLED_FRAMES:
        return
    if rays_out.found[slot] != FOUND_WHOLE_HIT:
        return
    position = rgb(vertices_out.position[slot])
    normal = unpack_normal(vertices_out.normal[slot])
    if motion.moved[0] != 0:
        hit = paths_out.hit[slot]
        was = previous_point(scene.geometry, motion, hit[0], hit[1], paths_out.barycentrics[slot])
        if was.moved == 1:
            if not is_finite3(was.displacement) or wp.dot(was.normal, was.now_normal) < NORMAL_COSINE:
                return
            position = position + was.displacement
    film = project(view.previous, position)
    pixel = pixel_of(view.previous, view.previous_jitter, film, width, height)
    if pixel < 0:
        return
    seen = load_previous_surface(view, previous, width, pixel)
    if not has_surface(seen) or wp.abs(seen.depth - film[2]) > DEPTH_SLACK * film[2]:
        return
    if wp.dot(normal, seen.normal) < NORMAL_COSINE:
        return
    if plane_distance(seen, position) > PLANE_PIXELS * pixel_footprint(view.previous, seen.depth):
        return
    if not looks_alike(previous, pixel):
        return
    light = wp.cw_mul(rgb(r), unpack_mean(previous_matte[pixel]) / view.exposure)
    gather(vertices_out, slot, wp.cw_mul(paths_out.throughput[slot], light), 0.0)
    vertices_out.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    rays_out.found[slot] = FOUND_SCREEN
