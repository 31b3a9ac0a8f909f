# SPDX-License-Identifier: GPL-3.0-or-later
"""Lists of the paths, rays and pixels that need more work (CUDA only: an atomic append must be one launch, no bands).

Their order does not matter to any picture.
"""

from __future__ import annotations

import warp as wp

from .cache_materials import LEFT
from .cache_mirrors import Mirrors, over_mirror
from .intersect import MISS
from .paths import ENDED, Paths, has_layers, has_shadow_layers, waits_for_program
from .pixel_order import pixel_in_blocks

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def append_living(
    # In:
    state: wp.array[int],
    queue: wp.array[int],
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the paths that go on to the next queue."""
    path = queue[wp.tid()]
    if state[path] != ENDED:
        queue_out[wp.atomic_add(count_out, 0, 1)] = path


@wp.kernel
def append_layered_paths(
    # In:
    paths: Paths,
    offset: int,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the paths, from slot `offset` on, that a triangle that needs a test stands in the way of."""
    path = offset + wp.tid()
    if has_layers(paths, path):
        queue_out[wp.atomic_add(count_out, 0, 1)] = path


@wp.kernel
def append_shadows(
    # In:
    paths: Paths,
    offset: int,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the slots, from `offset` on, that have a shadow ray."""
    path = offset + wp.tid()
    if paths.shadow_distance[path] != 0.0:
        queue_out[wp.atomic_add(count_out, 0, 1)] = path


@wp.kernel
def append_layered_shadows(
    # In:
    paths: Paths,
    offset: int,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the shadow rays, from slot `offset` on, that a triangle that needs a test stands in the way of."""
    path = offset + wp.tid()
    if has_shadow_layers(paths, path):
        queue_out[wp.atomic_add(count_out, 0, 1)] = path


@wp.kernel
def append_pending_shadows(
    # In:
    paths: Paths,
    offset: int,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the shadow rays, from slot `offset` on, that got through to a light whose radiance is a program."""
    path = offset + wp.tid()
    if waits_for_program(paths, path):
        queue_out[wp.atomic_add(count_out, 0, 1)] = path


@wp.kernel
def append_mirrored(
    # In:
    mirrors: Mirrors,
    offset: int,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the cache's rays, from slot `offset` on, that go on over a mirror."""
    slot = offset + wp.tid()
    if over_mirror(mirrors, slot):
        queue_out[wp.atomic_add(count_out, 0, 1)] = slot


@wp.kernel
def append_left_hits(
    # In:
    emission: wp.array[wp.vec4],
    offset: int,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the cache's rays, from slot `offset` on, that evaluate_cache_lean has left (Vertices.emission)."""
    slot = offset + wp.tid()
    if emission[slot][3] == LEFT:
        queue_out[wp.atomic_add(count_out, 0, 1)] = slot


@wp.kernel
def append_marked(
    # In:
    mark: wp.array[int],
    offset: int,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the slots, from `offset` on, that are marked."""
    slot = offset + wp.tid()
    if mark[slot] != 0:
        queue_out[wp.atomic_add(count_out, 0, 1)] = slot


@wp.kernel
def append_layered_pixels(
    # In:
    layer: wp.array[wp.vec2i],
    width: int,
    height: int,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the pixels that show a triangle that needs a test (PrimaryHits.layer), in the order of pixel_in_blocks."""
    pixel = pixel_in_blocks(wp.tid(), width, height)
    if pixel >= 0:
        if layer[pixel][0] != MISS:
            queue_out[wp.atomic_add(count_out, 0, 1)] = pixel
