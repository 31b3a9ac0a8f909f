# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixel of each block is sampled in a frame, and how: by a ray, or by a look into the probes.

Eto et al. 2023, section 2. The pixels of a block take turns in the same order everywhere, so that neighbouring rays
start at evenly spaced pixels. Where the pixel whose turn it is reflects nothing, the next one stands in.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .gbuffer import SURFACE_TRANSLUCENT, SURFACE_TRANSMITS, GBuffer, SurfaceMaterial, load_material
from .paths import ENDED, Paths
from .reflection_blocks import ReflectionHistory
from .reflection_lights import ray_zone
from .reflection_rays import (
    DIMENSION_CLASS,
    LEFT,
    ReflectionRays,
    place_of_frame,
    sequence_index,
    sequence_seed,
)
from .reflection_turns import leaves_turn_out
from .reflection_types import (
    LOBE_REFLECTION,
    LOBE_TRANSMISSION,
    NO_SAMPLE,
    SOURCE_COAT,
    SOURCE_NONE,
    SOURCE_PROBE,
    SOURCE_RAY,
    WAITS,
    ReflectionOptions,
    ReflectionSamples,
    coat_alone,
    is_sampled,
    place_pixel,
)
from .sampling import sample_pair
from .view import SKY_DEPTH, View
from .wide_loads import load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def chance_of_ray(options: ReflectionOptions, m: SurfaceMaterial) -> float:
    """Return with which chance a pixel's sample is a traced ray."""
    if options.lobe != LOBE_REFLECTION:
        return 1.0
    return ray_zone(options, m)


@wp.func
def may_be_sampled(options: ReflectionOptions, gbuffer: GBuffer, pixel: int) -> bool:
    """Return False where one word tells that a surface needs no sample: most let no light through."""
    if options.lobe != LOBE_TRANSMISSION or gbuffer.below.shape[0] > 0:
        return True
    return (gbuffer.material[pixel] & (SURFACE_TRANSLUCENT | SURFACE_TRANSMITS)) != wp.uint32(0)


@wp.kernel(cuda_max_registers=64)
def place_samples(
    # In:
    first: int,
    views: wp.array[View],
    options: ReflectionOptions,
    gbuffer: GBuffer,
    history: ReflectionHistory,
    matte: wp.array[wp.uint64],
    # Out:
    samples_out: ReflectionSamples,
    rays_out: ReflectionRays,
):
    """Choose each block's pixel, and whether it gets a ray; arguments as of leaves_turn_out."""
    block = first + wp.tid()
    view = load_view(views)
    places = options.stride * options.stride
    found = int(-1)
    pixel = int(-1)
    k = int(0)
    while k < places and found < 0:
        place = place_of_frame(options.stride, view.frame + k)
        pixel = place_pixel(options, block, place)
        if pixel >= 0:
            if gbuffer.depth[pixel] < SKY_DEPTH and may_be_sampled(options, gbuffer, pixel):
                if is_sampled(options, load_material(gbuffer, pixel)):
                    found = place
        k = k + 1
    waits = bool(False)
    traced = bool(False)
    coated = bool(False)
    if found >= 0:
        m = load_material(gbuffer, pixel)
        if leaves_turn_out(views, view, options, gbuffer, history, matte, block, pixel, m):
            found = -1
            waits = True
        else:
            coated = coat_alone(options, m)
            share = chance_of_ray(options, m)
            traced = share >= 1.0
            if share > 0.0 and share < 1.0:
                index = sequence_index(options.stride, view.frame, found)
                u = sample_pair(sequence_seed(view, options.width, pixel), index, DIMENSION_CLASS)
                traced = u[0] < share
    samples_out.place[block] = wp.where(found < 0, wp.where(waits, WAITS, NO_SAMPLE), wp.uint8(found))
    samples_out.pdf[block] = 0.0
    source = SOURCE_NONE
    if found >= 0:
        source = wp.where(traced, wp.where(coated, SOURCE_COAT, SOURCE_RAY), SOURCE_PROBE)
    rays_out.source[block] = source
    rays_out.flag[block] = wp.where(traced, 1, 0)


@wp.kernel
def list_rays(
    # Out:
    rays_out: ReflectionRays,
):
    """List the blocks that have a ray by rank."""
    block = wp.tid()
    if rays_out.flag[block] == 1:
        rays_out.block[rays_out.rank[block] - 1] = block


@wp.kernel
def append_left(
    # In:
    paths: Paths,
    vertices: Vertices,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the rays whose hits the lean node machine has left to the full one (CUDA only, see compaction.py)."""
    slot = wp.tid()
    if paths.state[slot] != ENDED and vertices.reflectance[slot][3] == LEFT:
        queue_out[wp.atomic_add(count_out, 0, 1)] = slot
