# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that turn a visibility buffer (raster.py) into the hits of primary rays: weights, instances, layers before.

Rays are traced where the buffer says that they are needed: through the triangles that need a test per hit, and through
the instances that are not flattened.
"""

from __future__ import annotations

import warp as wp

from .camera import CameraRay
from .flat_tracing import closest_flat_layer, no_hit
from .gbuffer_rays import PrimaryHits, primary_ray, store_primary_hit, store_primary_layer
from .geometry_math import transform_point
from .intersect import MISS, Hit, Layer, closer_layer, closest_instanced, static_layer
from .pixel_order import pixel_in_blocks
from .raster_pixels import Visibility, key_face
from .types import Geometry, Scene
from .view import View
from .wide_bvh import meet_triangle
from .wide_loads import load_corner, load_instance, load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def nearest_of_edge(origin: wp.vec3, direction: wp.vec3, a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Return where a ray comes closest to an edge: distance along it, share of the way from `a`, square of the gap."""
    way = b - a
    start = a - origin
    along = wp.dot(direction, way)
    across = wp.max(wp.length_sq(way) - along * along, 1.0e-30)
    share = wp.clamp((along * wp.dot(direction, start) - wp.dot(way, start)) / across, 0.0, 1.0)
    point = start + way * share
    t = wp.dot(direction, point)
    return wp.vec3(t, share, wp.length_sq(point - direction * t))


@wp.func
def nearest_of_edges(origin: wp.vec3, direction: wp.vec3, p: wp.vec3, q: wp.vec3, r: wp.vec3) -> wp.vec3:
    """Return where a ray goes by a triangle that it should meet: distance, weights of the second and third vertex.

    Of triangles a hundred thousand times as long as wide neither their planes nor the depths drawn are exact.
    """
    found = nearest_of_edge(origin, direction, p, q)
    result = wp.vec3(found[0], found[1], 0.0)
    gap = found[2]
    found = nearest_of_edge(origin, direction, q, r)
    if found[2] < gap:
        result = wp.vec3(found[0], 1.0 - found[1], found[1])
        gap = found[2]
    found = nearest_of_edge(origin, direction, r, p)
    if found[2] < gap:
        result = wp.vec3(found[0], 0.0, 1.0 - found[1])
    return result


@wp.func
def seen_hit(geometry: Geometry, nearest: wp.array[wp.uint64], pixel: int, ray: CameraRay) -> Hit:
    """Return the hit in a pixel of the visibility buffer; `nearest`: as in Visibility."""
    hit = no_hit(ray.t_max)
    key = nearest[pixel]
    if key != wp.uint64(0):
        ids = geometry.flat.faces[key_face(key)]
        to_world = load_instance(geometry.instances, ids[0]).to_world
        p = transform_point(to_world, load_corner(geometry, ids[1], 0))
        q = transform_point(to_world, load_corner(geometry, ids[1], 1))
        r = transform_point(to_world, load_corner(geometry, ids[1], 2))
        hit.instance = ids[0]
        hit.triangle = ids[1]
        found = meet_triangle(p, q, r, ray.origin, ray.direction)
        if found[3] > 0.0:
            hit.t = found[0]
            hit.u = found[2]
            hit.v = 1.0 - found[1] - found[2]
        else:
            # Some ten thousandths of a pixel beside an edge, by rounding.
            beside = nearest_of_edges(ray.origin, ray.direction, p, q, r)
            hit.t = beside[0]
            hit.u = beside[1]
            hit.v = beside[2]
    return hit


@wp.kernel(cuda_max_registers=56)
def resolve_hits(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    height: int,
    filtered: int,
    nearest: wp.array[wp.uint64],
    # Out:
    hits_out: PrimaryHits,
):
    """Store what each pixel shows and, if `filtered`, that there is no layer; see flat_tracing.trace_flat_primary."""
    pixel = pixel_in_blocks(first + wp.tid(), width, height)
    if pixel < 0:
        return
    view = load_view(views)
    ray = primary_ray(view, pixel % width, pixel // width)
    store_primary_hit(hits_out, pixel, seen_hit(scene.geometry, nearest, pixel, ray))
    if filtered == 1:
        hits_out.layer[pixel] = wp.vec2i(MISS, 0)
        hits_out.weight[pixel] = wp.vec3(1.0, 1.0, 1.0)


@wp.kernel(cuda_max_registers=64)
def resolve_instances(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    height: int,
    # Out:
    hits_out: PrimaryHits,
):
    """Let each pixel's ray look among the instances that are not flattened, before what the pixel shows."""
    pixel = pixel_in_blocks(first + wp.tid(), width, height)
    if pixel < 0:
        return
    ray = primary_ray(load_view(views), pixel % width, pixel // width)
    hit = no_hit(hits_out.t[pixel])
    hit = closest_instanced(
        scene.geometry.instanced, scene.geometry.mesh_faces, ray.origin, ray.direction, hit)
    if hit.instance != MISS:
        store_primary_hit(hits_out, pixel, hit)


@wp.kernel
def append_veiled(
    # In:
    seen: Visibility,
    width: int,
    height: int,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the pixels with a triangle before them that needs a test."""
    pixel = pixel_in_blocks(wp.tid(), width, height)
    if pixel >= 0:
        if seen.veiled[pixel] != wp.uint8(0):
            queue_out[wp.atomic_add(count_out, 0, 1)] = pixel


@wp.kernel(cuda_max_registers=56)
def trace_veils(
    # In:
    views: wp.array[View],
    scene: Scene,
    width: int,
    seen: Visibility,
    listing: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    hits_out: PrimaryHits,
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Find the first triangle that needs a test before what listed pixels show, as trace_primary_layers does.

    With `listing` pixels that have one are appended to another list (CUDA only: in one launch).
    """
    i = wp.tid()
    while i < count[0]:
        pixel = queue[i]
        if seen.veiled[pixel] != wp.uint8(0):
            ray = primary_ray(load_view(views), pixel % width, pixel // width)
            layer = closest_flat_layer(scene.geometry, ray.origin, ray.direction, hits_out.t[pixel])
            store_primary_layer(hits_out, pixel, layer)
            if listing == 1 and layer.hit.instance != MISS and layer.solid == 0:
                queue_out[wp.atomic_add(count_out, 0, 1)] = pixel
        i = i + stride


@wp.kernel(cuda_max_registers=64)
def trace_instanced_veils(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    seen: Visibility,
    # Out:
    hits_out: PrimaryHits,
):
    """The same for all pixels, where some instances are not flattened: those are not noted."""
    pixel = first + wp.tid()
    ray = primary_ray(load_view(views), pixel % width, pixel // width)
    layer = Layer()
    layer.hit = no_hit(hits_out.t[pixel])
    if seen.veiled[pixel] != wp.uint8(0):
        layer = static_layer(scene.geometry.flat_filtered, ray.origin, ray.direction, hits_out.t[pixel])
    store_primary_layer(hits_out, pixel, closer_layer(scene.geometry, ray.origin, ray.direction, layer))
