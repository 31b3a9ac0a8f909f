# SPDX-License-Identifier: GPL-3.0-or-later
"""Primary rays of the real-time frame: closest hits, and the lamps that the camera sees. They know no materials.

The camera is a pinhole here: depth of field would need several samples a pixel, and comes with the path-traced ones.
"""

from __future__ import annotations

import warp as wp

from .camera import CameraRay, camera_ray
from .gbuffer import GBuffer
from .geometry_math import is_finite3
from .intersect import MISS, closest_filtered_hit, closest_hit
from .lamp_hit import FAR, lamp_hit
from .packing import from_half, rgba, to_half
from .types import LIGHT_HITTABLE, VISIBLE_CAMERA, Lights, LightTree, Scene
from .view import View, film_position

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# So many local lamps are tested one by one; more are found through the tree of lights.
LAMPS_IN_A_ROW = wp.constant(16)


@wp.struct
class PrimaryHits:
    """What the primary rays have met, one entry a pixel; exact, unlike the G-buffer's packed form."""

    t: wp.array[float]
    """Distance along the ray [m]"""
    hit: wp.array[wp.vec2i]
    """(instance, triangle); instance MISS for none"""
    barycentrics: wp.array[wp.vec2]
    layer_t: wp.array[float]
    """First triangle that needs a test (transparency, visibility), before the opaque hit; as above"""
    layer: wp.array[wp.vec2i]
    layer_barycentrics: wp.array[wp.vec2]
    weight: wp.array[wp.vec3]
    """What the layers in front of the hit leave of its light"""


@wp.func
def primary_ray(view: View, x: int, y: int) -> CameraRay:
    """Return this frame's camera ray of a pixel, through the centre of the lens."""
    frame = view.camera
    frame.aperture_radius = 0.0
    return camera_ray(frame, film_position(view, x, y), wp.vec2(0.0, 0.0))


@wp.kernel
def trace_primary(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    # Out:
    hits_out: PrimaryHits,
):
    """Find what each pixel shows: the closest opaque hit."""
    pixel = first + wp.tid()
    ray = primary_ray(views[0], pixel % width, pixel // width)
    hit = closest_hit(scene.geometry, ray.origin, ray.direction, ray.t_max)
    hits_out.t[pixel] = hit.t
    hits_out.hit[pixel] = wp.vec2i(hit.instance, hit.triangle)
    hits_out.barycentrics[pixel] = wp.vec2(hit.u, hit.v)


@wp.kernel
def trace_primary_layers(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    # Out:
    hits_out: PrimaryHits,
):
    """Find the first triangle in front of each opaque hit that needs a test."""
    pixel = first + wp.tid()
    ray = primary_ray(views[0], pixel % width, pixel // width)
    hit = closest_filtered_hit(scene.geometry, ray.origin, ray.direction, hits_out.t[pixel])
    hits_out.layer_t[pixel] = hit.t
    hits_out.layer[pixel] = wp.vec2i(hit.instance, hit.triangle)
    hits_out.layer_barycentrics[pixel] = wp.vec2(hit.u, hit.v)
    hits_out.weight[pixel] = wp.vec3(1.0, 1.0, 1.0)


@wp.func
def meets_node(tree: LightTree, node: int, origin: wp.vec3, inverse: wp.vec3, t_max: float) -> bool:
    """Return whether a ray meets the bounds of a node (slabs; the bounds are widened by the float error)."""
    low = tree.low[node]
    high = tree.high[node]
    near = float(0.0)
    far = float(t_max)
    for axis in range(3):
        slack = 1.0e-6 * wp.max(wp.abs(low[axis]), wp.abs(high[axis])) + 1.0e-20
        a = (low[axis] - slack - origin[axis]) * inverse[axis]
        b = (high[axis] + slack - origin[axis]) * inverse[axis]
        near = wp.max(near, wp.min(a, b))
        far = wp.min(far, wp.max(a, b))
    return near <= far


@wp.func
def lamp_light(lights: Lights, lamp: int, origin: wp.vec3, direction: wp.vec3, t_max: float) -> wp.vec3:
    """Return the radiance of a lamp if the camera's ray meets it before t_max."""
    light = lights.lamps[lamp]
    if (light.flags & LIGHT_HITTABLE) != 0 and (light.visibility & VISIBLE_CAMERA) != 0:
        hit = lamp_hit(light, origin, direction, t_max)
        if hit.t > 0.0:
            return hit.radiance
    return wp.vec3(0.0, 0.0, 0.0)


@wp.func
def safe_inverse(x: float) -> float:
    """Return 1 / x, large instead of infinite: a product with it is never NaN."""
    if wp.abs(x) < 1.0e-18:
        return wp.where(x < 0.0, -1.0e18, 1.0e18)
    return 1.0 / x


@wp.func
def tree_light(lights: Lights, origin: wp.vec3, direction: wp.vec3, t_max: float) -> wp.vec3:
    """Return the radiance of all local lamps that a ray meets, found through the tree (a heap, so without a stack)."""
    total = wp.vec3(0.0, 0.0, 0.0)
    inverse = wp.vec3(safe_inverse(direction[0]), safe_inverse(direction[1]), safe_inverse(direction[2]))
    leaves = 1 << lights.tree.levels
    node = int(1)
    while node > 0:
        met = meets_node(lights.tree, node, origin, inverse, t_max)
        if met and node < leaves:
            node = 2 * node
        else:
            if met:
                entry = lights.tree.entries[node - leaves]
                if entry >= 0 and entry < lights.local_lamp_count:
                    total = total + lamp_light(lights, entry, origin, direction, t_max)
            # The next subtree: up while this is a second child, then to the sibling.
            while node > 1 and (node & 1) == 1:
                node = node >> 1
            node = wp.where(node == 1, 0, node + 1)
    return total


@wp.kernel
def add_lamps(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    filtered: int,
    hits: PrimaryHits,
    # Out:
    gbuffer_out: GBuffer,
):
    """Add the lamps that the camera sees in front of its hits; they hide nothing. One pixel a thread."""
    pixel = first + wp.tid()
    view = views[0]
    ray = primary_ray(view, pixel % width, pixel // width)
    t_max = hits.t[pixel]
    if hits.hit[pixel][0] == MISS:
        t_max = FAR
    lights = scene.lights
    total = wp.vec3(0.0, 0.0, 0.0)
    start = int(0)
    if lights.local_lamp_count > LAMPS_IN_A_ROW:
        total = tree_light(lights, ray.origin, ray.direction, t_max)
        start = lights.local_lamp_count
    for i in range(start, lights.lamp_count):
        total = total + lamp_light(lights, i, ray.origin, ray.direction, t_max)
    if filtered == 1:
        total = wp.cw_mul(total, hits.weight[pixel])
    total = total * view.exposure
    if is_finite3(total) and wp.length_sq(total) > 0.0:
        gbuffer_out.emission[pixel] = to_half(from_half(gbuffer_out.emission[pixel]) + rgba(total, 0.0))
