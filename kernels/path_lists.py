# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's lists: which paths live, and which of them need a kernel that few do.

Each kernel works on listed paths and appends to a list; the numbers of paths are on the device, so that a loop over
bounces needs no answer from it. Within a list the order does not matter to any picture. One launch a list: atomics.
"""

from __future__ import annotations

import warp as wp

from .list_order import first_listed
from .paths import ENDED, Paths, has_layers, has_shadow_layers
from .pixel_order import place_in_blocks

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Lists, by their place among the counts. Living paths take turns in two.
LIVING = wp.constant(0)
PLAIN_HITS = wp.constant(2)
"""Those that shade_plain_paths shades"""
FULL_HITS = wp.constant(3)
"""Those that need the full node machine"""
LAYERED = wp.constant(4)
LAYERED_SHADOWS = wp.constant(5)
FIRST_HITS = wp.constant(6)
"""Of camera rays, where light passes are asked for"""
BELOW = wp.constant(7)
"""Paths that go below a surface"""
EXITS = wp.constant(8)
"""Those of them that come out"""
LAYERED_EXITS = wp.constant(9)
"""Those whose shadow rays a triangle that needs a test stands in the way of"""
SCATTERED = wp.constant(10)
"""Paths that a medium has scattered"""
OTHER_HITS = wp.constant(11)
"""Hits that shade_hair_paths leaves, in scenes with hair that scatters light"""
LIST_COUNT = wp.constant(12)


@wp.kernel
def start_round(
    # In:
    source: int,
    kept: int,
    limit: int,
    # Out:
    counts_out: wp.array[int],
    rounds_out: wp.array[int],
    rays_out: wp.array[wp.int64],
):
    """Empty all lists but `source`, that of the living paths, and `kept`; after `limit` rounds `source` too."""
    rounds = rounds_out[0] + 1
    rounds_out[0] = rounds
    if rounds >= limit:
        counts_out[source] = 0
    rays_out[0] = rays_out[0] + wp.int64(counts_out[source])
    for i in range(LIST_COUNT):
        if i != source and i != kept:
            counts_out[i] = 0


@wp.kernel
def finish_round(
    # In:
    rounds: wp.array[int],
    kept: int,
    # Out:
    counts_out: wp.array[int],
    rounds_out: wp.array[int],
):
    """Empty the list of the paths that lived in the round before; note the number of the one that goes on."""
    counts_out[kept] = 0
    rounds_out[0] = rounds[0]


@wp.kernel
def list_all(
    # In:
    width: int,
    pixel_count: int,
    # Out:
    queue_out: wp.array[int],
):
    """List paths of a pixel_count's samples one after the other, the pixels in blocks: warps of near pixels."""
    i = wp.tid()
    pixel = i % pixel_count
    queue_out[i] = i - pixel + place_in_blocks(pixel, width, pixel_count)


@wp.kernel
def list_living(
    # In:
    state: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """List the paths that go on."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if state[path] != ENDED:
            queue_out[wp.atomic_add(count_out, 0, 1)] = path


@wp.kernel
def list_layered(
    # In:
    paths: Paths,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """List the paths that a triangle that needs a test stands in the way of."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_layers(paths, path):
            queue_out[wp.atomic_add(count_out, 0, 1)] = path


@wp.kernel
def list_layered_shadows(
    # In:
    paths: Paths,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """List the paths whose shadow rays a triangle that needs a test stands in the way of."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_shadow_layers(paths, path):
            queue_out[wp.atomic_add(count_out, 0, 1)] = path
