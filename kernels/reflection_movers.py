# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the virtual images of what moves were in the frame before, so that their means go along in mirrors.

Zeng et al., "Temporally Reliable Motion Vectors for Real-time Ray Tracing", 2021, section 4, for what each block of
pixels reflects first; kernels/reflection_images.py knows where the image of what stands still was.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, load_surface
from .geometry_math import is_finite3
from .ggx import reflect_about
from .intersect import MISS
from .motion import Motion, previous_point
from .packed_halves import pack_pair
from .paths import ENDED, Paths
from .reflection_rays import ReflectionRays
from .reflection_types import ReflectionOptions, ReflectionSamples, sample_pixel
from .types import Scene
from .view import View, direction_to_eye, project
from .wide_loads import load_previous_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def image_shift(
    views: wp.array[View], scene: Scene, motion: Motion, options: ReflectionOptions, gbuffer: GBuffer,
    samples: ReflectionSamples, paths: Paths, block: int, slot: int,
) -> wp.vec2:
    """Return by how many pixels the image of a ray's first hit lay elsewhere than if that had stood still."""
    none = wp.vec2(0.0, 0.0)
    hit = paths.hit[slot]
    if paths.state[slot] == ENDED or hit[0] == MISS:
        return none
    was = previous_point(scene.geometry, motion, hit[0], hit[1], paths.barycentrics[slot])
    if was.moved == 0 or not is_finite3(was.displacement):
        return none
    pixel = sample_pixel(options, samples, block)
    if pixel < 0:
        return none
    view = load_previous_view(views)
    mirror = load_surface(view, gbuffer, options.width, pixel)
    image = mirror.position - direction_to_eye(view.camera, mirror.position) * paths.t[slot]
    still = project(view.previous, image)
    # A mirror turns motion about as it turns what moves.
    moved = project(view.previous, image - reflect_about(was.displacement, mirror.normal))
    if still[2] <= 0.0 or moved[2] <= 0.0:
        return none
    return wp.vec2(moved[0] - still[0], moved[1] - still[1])


@wp.kernel
def find_image_shifts(
    first: int,
    # In:
    views: wp.array[View],
    scene: Scene,
    motion: Motion,
    options: ReflectionOptions,
    gbuffer: GBuffer,
    rays: ReflectionRays,
    paths: Paths,
    samples: ReflectionSamples,
    # Out:
    shift_out: wp.array[wp.uint32],
):
    """Find ReflectionSamples.shift of each block in frames in which something has moved; banded over blocks."""
    block = first + wp.tid()
    if views[0].moved_age != 0:
        return
    shift = wp.vec2(0.0, 0.0)
    if motion.moved[0] != 0 and rays.flag[block] == 1:
        shift = image_shift(
            views, scene, motion, options, gbuffer, samples, paths, block, rays.rank[block] - 1)
    shift_out[block] = pack_pair(shift[0], shift[1])
