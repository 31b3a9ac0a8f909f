# SPDX-License-Identifier: GPL-3.0-or-later
"""How a surface's albedos, or the world, are packed into the G-buffer; used by all kernels that fill it. Functions.

The BSDF is reduced to one diffuse and one translucent lobe, a GGX lobe, a coat's and the sum of what glass lets
through, of the same albedos.
"""

from __future__ import annotations

import warp as wp

from .camera import CameraRay
from .gbuffer import (
    SURFACE_BACKFACING,
    SURFACE_EMITS,
    GBuffer,
    SurfaceMaterial,
    barycentrics_of,
    store_material,
)
from .gbuffer_rays import PrimaryHits, primary_ray
from .geometry_math import (
    finite_or_zero,
    is_finite3,
    max_component,
    mean_component,
    safe_sqrt,
    sqr,
    transform_direction,
    transform_normal,
)
from .intersect import MISS, surface_point, triangle_material
from .nodes import world_point
from .packing import pack_normal, pack_unorm16, rgba, to_half
from .paths import make_hit
from .reflectance import BsdfAlbedo, fit_lobe
from .sampling import DIMENSION_FIRST_BOUNCE, DIMENSION_LOBE, pixel_seed_of, sample_pair
from .tracing import FOOTPRINT_SCALE
from .types import HOLDOUT, MATERIAL_LEAN, VISIBLE_CAMERA, FrameData, Geometry, Scene, ShadingPoint
from .view import SKY_DEPTH, View, pixel_footprint, project
from .wide_loads import load_corner, load_instance, load_material_flags, load_normal

# Tokuyoshi and Kaplanyan 2021: variance of a pixel's filter [px^2] and the largest widening of alpha squared. An eighth
# of the published 1 / (2 pi): the mean over jittered frames filters the rest as it is, without the tails of a wider GGX
# lobe, which blurred highlights over many pixels.
FILTER_VARIANCE = wp.constant(0.02)
WIDENING_MAX = wp.constant(0.18)
# Roughness from which lobes are so wide that the normals in a pixel change nothing, and over which that fades in.
WIDENED_ROUGHNESS = wp.constant(0.6)
WIDENED_FADE = wp.constant(0.2)
# A footprint seen more aslant than this grows no further.
COSINE_MIN = wp.constant(0.1)


@wp.func
def normal_change(geometry: Geometry, point: ShadingPoint, right: wp.vec3, up: wp.vec3) -> float:
    """Return the sum of the squared changes of the interpolated normal over two vectors in the triangle's plane."""
    instance = load_instance(geometry.instances, point.instance)
    n0 = wp.normalize(transform_normal(instance.to_object, load_normal(geometry, point.triangle, 0)))
    n1 = wp.normalize(transform_normal(instance.to_object, load_normal(geometry, point.triangle, 1)))
    n2 = wp.normalize(transform_normal(instance.to_object, load_normal(geometry, point.triangle, 2)))
    p0 = load_corner(geometry, point.triangle, 0)
    e1 = load_corner(geometry, point.triangle, 1) - p0
    e2 = load_corner(geometry, point.triangle, 2) - p0
    # Barycentric coordinates of the offset by the edges' Gram matrix; lengths in units of the first edge.
    world1 = transform_direction(instance.to_world, e1)
    world2 = transform_direction(instance.to_world, e2)
    scale = 1.0 / wp.max(wp.length(world1), 1.0e-20)
    world1 = world1 * scale
    world2 = world2 * scale
    a = wp.dot(world1, world1)
    b = wp.dot(world1, world2)
    c = wp.dot(world2, world2)
    determinant = wp.max(a * c - b * b, 1.0e-12)
    x = wp.dot(world1, right) * scale
    y = wp.dot(world2, right) * scale
    du = (c * x - b * y) / determinant
    dv = (a * y - b * x) / determinant
    change = wp.length_sq((n1 - n0) * du + (n2 - n0) * dv)
    x = wp.dot(world1, up) * scale
    y = wp.dot(world2, up) * scale
    du = (c * x - b * y) / determinant
    dv = (a * y - b * x) / determinant
    return change + wp.length_sq((n1 - n0) * du + (n2 - n0) * dv)


@wp.func
def widening(frame: FrameData, geometry: Geometry, point: ShadingPoint, depth: float) -> float:
    """Return what the variance of the normal inside the pixel adds to alpha squared (Tokuyoshi and Kaplanyan 2021)."""
    width = pixel_footprint(frame, depth)
    m = frame.camera_to_world
    right = wp.normalize(wp.vec3(m[0, 0], m[1, 0], m[2, 0])) * width
    up = wp.normalize(wp.vec3(m[0, 1], m[1, 1], m[2, 1])) * width
    n = point.geometric_normal
    cosine = wp.max(wp.dot(point.wo, n), COSINE_MIN)
    right = right - point.wo * (wp.dot(right, n) / cosine)
    up = up - point.wo * (wp.dot(up, n) / cosine)
    change = normal_change(geometry, point, right, up)
    if not wp.isfinite(change):
        return 0.0
    return wp.min(2.0 * FILTER_VARIANCE * change, WIDENING_MAX)


@wp.func
def widened(roughness: float, added: float) -> float:
    """Return a perceptual roughness with `added` to its alpha squared, as far as that shows."""
    if not wp.isfinite(roughness):
        return 1.0
    if added > 0.0:
        share = wp.clamp((WIDENED_ROUGHNESS - roughness) / WIDENED_FADE, 0.0, 1.0)
        return wp.min(wp.sqrt(safe_sqrt(sqr(sqr(roughness)) + share * added)), 1.0)
    return roughness


@wp.func
def store_surface(
    view: View, scene: Scene, point: ShadingPoint, albedo: BsdfAlbedo, shading_normal: wp.vec3, cosine: float,
    emitted: wp.vec3, weight: wp.vec3, flags: wp.uint32, gbuffer: GBuffer, pixel: int,
):
    """Pack a surface.

    Args:
        view: The frame's view.
        scene: The scene.
        point: Where the surface lies.
        albedo: Of its BSDF for this view.
        shading_normal: Normal map and bump included.
        cosine: Of the view with the normal that reflects it.
        emitted: Radiance that arrives of its own light and of what shines behind it.
        weight: What transparent layers in front let through.
        flags: SURFACE_* bits known so far.
        gbuffer: What to fill.
        pixel: Which entry.
    """
    depth = project(view.camera, point.position)[2]
    normal = shading_normal
    if not is_finite3(normal):
        normal = point.geometric_normal
    material = SurfaceMaterial()
    sharpest = float(albedo.roughness)
    if albedo.coat > 0.0:
        sharpest = wp.min(sharpest, albedo.coat_roughness)
    added = float(0.0)
    if sharpest < WIDENED_ROUGHNESS:
        added = widening(view.camera, scene.geometry, point, depth)
    material.roughness = widened(albedo.roughness, added)
    material = fit_lobe(scene.tables, albedo, cosine, material)
    material.f90 = material.f90 * mean_component(weight)
    if not wp.isfinite(material.f90):
        material.f90 = 0.0
    material.f0 = finite_or_zero(wp.cw_mul(material.f0, weight))
    material.diffuse = finite_or_zero(wp.cw_mul(albedo.diffuse, weight))
    material.translucent = finite_or_zero(wp.cw_mul(albedo.translucent, weight))
    material.specular = finite_or_zero(wp.cw_mul(albedo.specular, weight))
    # The lean machine knows neither coats nor glass: there these are constants and nothing is computed.
    if max_component(albedo.transmitted) > 0.0:
        material.transmitted = finite_or_zero(wp.cw_mul(albedo.transmitted, weight))
    if albedo.coat > 0.0 and wp.isfinite(albedo.coat):
        material.coat = wp.min(albedo.coat * mean_component(weight), 1.0)
        material.coat_roughness = widened(albedo.coat_roughness, added)
    emission = finite_or_zero(emitted) * view.exposure
    alpha = float(1.0)
    if (load_instance(scene.geometry.instances, point.instance).visibility & HOLDOUT) != 0:
        # It keeps its geometry for the passes that look at neighbours, and gives no light at all.
        material = SurfaceMaterial()
        emission = wp.vec3(0.0, 0.0, 0.0)
        alpha = 0.0
    material.flags = flags | wp.where(max_component(emission) > 0.0, SURFACE_EMITS, wp.uint32(0))
    if point.backfacing == 1:
        material.flags = material.flags | SURFACE_BACKFACING
    # Stores come last: loads after them could not be moved before them.
    store_material(gbuffer, pixel, material)
    gbuffer.emission[pixel] = to_half(rgba(emission, alpha))
    gbuffer.depth[pixel] = depth
    gbuffer.hit[pixel] = wp.vec2i(point.instance, point.triangle)
    gbuffer.barycentrics[pixel] = pack_unorm16(point.u, point.v)
    gbuffer.geometric_normal[pixel] = pack_normal(point.geometric_normal)
    gbuffer.normal[pixel] = pack_normal(normal)


@wp.func
def store_world(view: View, scene: Scene, radiance: wp.vec3, flags: wp.uint32, gbuffer: GBuffer, pixel: int):
    """Pack a pixel that shows the world; `radiance`: what arrives."""
    gbuffer.depth[pixel] = SKY_DEPTH
    gbuffer.hit[pixel] = wp.vec2i(MISS, MISS)
    gbuffer.barycentrics[pixel] = wp.uint32(0)
    up = pack_normal(wp.vec3(0.0, 0.0, 1.0))
    gbuffer.geometric_normal[pixel] = up
    gbuffer.normal[pixel] = up
    material = SurfaceMaterial()
    material.flags = flags
    store_material(gbuffer, pixel, material)
    light = finite_or_zero(radiance) * view.exposure
    if view.transparent == 1:
        gbuffer.emission[pixel] = to_half(wp.vec4(0.0, 0.0, 0.0, 0.0))
        return
    if (scene.environment.visibility & VISIBLE_CAMERA) == 0:
        light = wp.vec3(0.0, 0.0, 0.0)
    gbuffer.emission[pixel] = to_half(rgba(light, 1.0))


@wp.func
def closure_number(view: View, width: int, pixel: int) -> float:
    """Return the number that draws one closure of a pixel's material in this frame."""
    seed = pixel_seed_of(view.camera.crop_x + pixel % width, view.camera.crop_y + pixel // width, view.camera.seed)
    return sample_pair(seed, wp.uint32(view.frame), DIMENSION_FIRST_BOUNCE + DIMENSION_LOBE)[1]


@wp.func
def needs_full(scene: Scene, hits: PrimaryHits, pixel: int) -> bool:
    """Return whether a pixel shows what the lean node machine can't run; gbuffer_lean.py does all others."""
    ids = hits.hit[pixel]
    if ids[0] == MISS:
        return scene.environment.constant == 0
    flags = load_material_flags(scene.materials.materials, triangle_material(scene, ids[0], ids[1]))[3]
    return (flags & MATERIAL_LEAN) == 0


@wp.func
def pixel_point(view: View, scene: Scene, hits: PrimaryHits, pixel: int, ray: CameraRay) -> ShadingPoint:
    """Return the point at which a pixel's program runs: its hit, or the direction in which the world is seen."""
    cone = wp.vec2(view.camera.pixel_size, view.camera.spread) * FOOTPRINT_SCALE
    if hits.hit[pixel][0] == MISS:
        return world_point(ray.direction, VISIBLE_CAMERA, 0, cone[1])
    t = hits.t[pixel]
    point = surface_point(scene, make_hit(t, hits.hit[pixel], hits.barycentrics[pixel]), ray.direction)
    point.footprint = cone[0] + cone[1] * t
    point.ray_visibility = VISIBLE_CAMERA
    point.ray_length = t
    point.ray_depth = 0
    return point


@wp.func
def stored_point(view: View, scene: Scene, gbuffer: GBuffer, width: int, pixel: int) -> ShadingPoint:
    """Return the point at which the program of a surface in the G-buffer runs once more."""
    ray = primary_ray(view, pixel % width, pixel // width)
    point = surface_point(scene, make_hit(0.0, gbuffer.hit[pixel], barycentrics_of(gbuffer, pixel)), ray.direction)
    cone = wp.vec2(view.camera.pixel_size, view.camera.spread) * FOOTPRINT_SCALE
    point.ray_length = wp.length(point.position - ray.origin)
    point.footprint = cone[0] + cone[1] * point.ray_length
    point.ray_visibility = VISIBLE_CAMERA
    point.ray_depth = 0
    return point
