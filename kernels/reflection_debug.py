# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that shows the samples of reflections: each block's sample in all of its pixels."""

from __future__ import annotations

import warp as wp

from .debug_colors import heat
from .gbuffer import GBuffer, load_material
from .packed_halves import unpack_halves
from .packing import rgb, rgba
from .reflection_chain import MIRROR_ROUGHNESS
from .reflection_rays import (
    FOUND_CELL,
    FOUND_EMITTER,
    FOUND_OWN,
    FOUND_SCREEN,
    FOUND_WORLD,
    ReflectionRays,
)
from .reflection_types import (
    SAMPLE_FAR,
    SOURCE_COAT,
    SOURCE_PROBE,
    SOURCE_RAY,
    ReflectionOptions,
    ReflectionSamples,
    block_of,
    sample_pixel,
)
from .view import SKY_DEPTH

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

REFLECTION_CLASSES = wp.constant(0)
REFLECTION_HITS = wp.constant(1)
REFLECTION_RADIANCE = wp.constant(2)
REFLECTION_DISTANCE = wp.constant(3)


@wp.func
def class_color(gbuffer: GBuffer, pixel: int, source: wp.uint8) -> wp.vec3:
    """Return grey for diffuse surfaces, green for probes, blue for rays and light blue for rays over mirrors."""
    if source == SOURCE_PROBE:
        return wp.vec3(0.05, 0.5, 0.1)
    if source == SOURCE_RAY or source == SOURCE_COAT:
        if load_material(gbuffer, pixel).roughness < MIRROR_ROUGHNESS:
            return wp.vec3(0.2, 0.5, 1.0)
        return wp.vec3(0.02, 0.08, 0.7)
    return wp.vec3(0.1, 0.1, 0.1)


@wp.func
def found_color(found: wp.uint8) -> wp.vec3:
    """Return the colour of where a ray's light came from."""
    if found == FOUND_WORLD:
        return wp.vec3(0.1, 0.4, 1.0)
    if found == FOUND_EMITTER:
        return wp.vec3(1.0, 1.0, 1.0)
    if found == FOUND_SCREEN:
        return wp.vec3(0.1, 0.7, 0.1)
    if found == FOUND_OWN:
        return wp.vec3(1.0, 0.6, 0.05)
    if found == FOUND_CELL:
        return wp.vec3(0.7, 0.05, 0.4)
    return wp.vec3(0.0, 0.0, 0.0)


@wp.kernel
def show_samples(
    # In:
    first: int,
    what: int,
    options: ReflectionOptions,
    gbuffer: GBuffer,
    rays: ReflectionRays,
    samples: ReflectionSamples,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Draw what is known of each block's sample."""
    pixel = first + wp.tid()
    block = block_of(options, pixel)
    source = rays.source[block]
    c = wp.vec3(0.0, 0.0, 0.0)
    if gbuffer.depth[pixel] < SKY_DEPTH:
        if what == REFLECTION_CLASSES:
            c = class_color(gbuffer, pixel, source)
        elif what == REFLECTION_HITS:
            if source == SOURCE_RAY or source == SOURCE_COAT:
                c = found_color(rays.found[rays.rank[block] - 1])
        elif sample_pixel(options, samples, block) >= 0 and samples.pdf[block] > 0.0:
            value = unpack_halves(samples.radiance[block])
            c = rgb(value)
            if what == REFLECTION_DISTANCE:
                c = heat(value[3] / (value[3] + 10.0))
                if value[3] >= SAMPLE_FAR:
                    c = wp.vec3(1.0, 1.0, 1.0)
    picture_out[pixel] = rgba(c, 1.0)
