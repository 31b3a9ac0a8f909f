# SPDX-License-Identifier: GPL-3.0-or-later
"""Media along the rays of reflections and refraction: what absorbs and shines within glass, as a drink does.

Frames know nothing else of media: what is scattered is neither lost nor found, and the world has none. Launched
between the kernels that find what a segment meets and those that send the ray on, in scenes with media alone.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .gbuffer import GBuffer
from .gbuffer_rays import primary_ray
from .intersect import MISS
from .media import (
    NO_MEDIUM,
    Media,
    MediaPaths,
    Mixture,
    after_hit,
    cross,
    emitted,
    faces_along,
    load_inside,
    medium_at,
    mixture_of,
    nowhere,
    passing,
    store_inside,
)
from .paths import ENDED, Paths
from .reflection_rays import ReflectionRays, gather
from .reflection_types import ReflectionOptions, ReflectionSamples, place_pixel
from .types import Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.kernel
def start_in_media(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    media: Media,
    options: ReflectionOptions,
    gbuffer: GBuffer,
    samples: ReflectionSamples,
    rays: ReflectionRays,
    paths: Paths,
    # Out:
    kept_out: MediaPaths,
):
    """Note what rays are in that have just left the surfaces in their pixels."""
    slot = first + wp.tid()
    if paths.state[slot] == ENDED:
        return
    inside = nowhere()
    block = rays.block[slot]
    pixel = place_pixel(options, block, int(samples.place[block]))
    hit = gbuffer.hit[pixel]
    medium = medium_at(scene, media, hit[0], hit[1])
    if medium != NO_MEDIUM:
        ray = primary_ray(views[0], pixel % options.width, pixel // options.width)
        from_behind = faces_along(scene, hit[0], hit[1], ray.direction)
        outwards = faces_along(scene, hit[0], hit[1], paths.direction[slot])
        # In the medium it is behind a front that it has come through, or before a back that it has stayed at.
        if not outwards:
            inside = cross(inside, hit[0], medium, False)
        kept_out.backfacing[slot] = wp.where(from_behind, 1, 0)
    store_inside(kept_out, slot, inside)


@wp.kernel
def dim_segments(
    # In:
    scene: Scene,
    media: Media,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    vertices_out: Vertices,
    kept_out: MediaPaths,
):
    """Weaken listed rays, whose segments have found what they meet, by what the media on the way absorb."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        hit = paths_out.hit[slot]
        # Where nothing is met it has left the scene, out of an open mesh if it is in a medium.
        if paths_out.state[slot] != ENDED and hit[0] != MISS:
            mixture = mixture_of(media, load_inside(kept_out, slot))
            absorbing = Mixture()
            absorbing.extinction = wp.max(mixture.extinction - mixture.scattering, wp.vec3(0.0, 0.0, 0.0))
            absorbing.emission = mixture.emission
            length = paths_out.t[slot]
            throughput = paths_out.throughput[slot]
            gather(vertices_out, slot, wp.cw_mul(throughput, emitted(absorbing, length)), 0.0)
            paths_out.throughput[slot] = wp.cw_mul(throughput, passing(absorbing.extinction, length))
            if medium_at(scene, media, hit[0], hit[1]) != NO_MEDIUM:
                from_behind = faces_along(scene, hit[0], hit[1], paths_out.direction[slot])
                kept_out.backfacing[slot] = wp.where(from_behind, 1, 0)


@wp.kernel
def cross_boundaries(
    # In:
    scene: Scene,
    media: Media,
    paths: Paths,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    kept_out: MediaPaths,
):
    """Note what listed rays are in that have been sent on."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        if paths.state[slot] != ENDED:
            store_inside(kept_out, slot, after_hit(
                scene, media, kept_out, paths, slot, load_inside(kept_out, slot), paths.direction[slot]))
