# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that make opacity micromaps: where triangles are clear, solid, or need a test per hit.

What the maps look like is in wide_bvh.py, what decides in opacity_pieces.py. engine/opacity_maps.py launches these
kernels; most work on entries: each triangle of a mesh under a set of materials has one, which all its instances share.
"""

from __future__ import annotations

import warp as wp

from .intersect import triangle_material
from .opacity_pieces import (
    FAR_TEXELS,
    AlphaMask,
    covered_texels,
    longest_edge,
    part_of,
    piece_state,
    state_of,
    triangle_piece,
)
from .types import Scene, TextureInfo, Textures
from .wide_bvh import OPACITY_MIXED, OPACITY_UNKNOWN, TRIANGLE_WORDS
from .wide_bvh_edit import GONE
from .wide_loads import load_texture_info

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# The halvings of a map's edges. A word holds the sixteen states that two halvings leave.
MIN_LEVEL = wp.constant(2)
MAX_LEVEL = wp.constant(9)


@wp.func
def entry_triangle(scene: Scene, starts: wp.array[int], instances: wp.array[int], entry: int) -> wp.vec2i:
    """Return (instance, triangle) of an entry, of one of the instances that share it; blocks of entries start there."""
    block = wp.lower_bound(starts, entry + 1) - 1
    instance = instances[block]
    return wp.vec2i(instance, scene.geometry.instances[instance].triangle_offset + entry - starts[block])


@wp.func
def mask_of(scene: Scene, rows: wp.array[int], face: wp.vec2i) -> int:
    """Return the mask of a triangle's material, -1 for none; `rows` holds it by material."""
    return rows[triangle_material(scene, face[0], face[1])]


@wp.func
def mask_image(textures: Textures, mask: AlphaMask) -> TextureInfo:
    """Return what is known of a mask's image; 0 levels where there is none."""
    info = TextureInfo()
    if mask.texture >= 0 and mask.texture < textures.infos.shape[0]:
        info = load_texture_info(textures.infos, mask.texture)
    return info


@wp.kernel
def choose_levels(
    # In:
    first: int,
    scene: Scene,
    starts: wp.array[int],
    instances: wp.array[int],
    rows: wp.array[int],
    masks: wp.array[AlphaMask],
    fine: float,
    # Out:
    levels_out: wp.array[int],
    texels_out: wp.array[float],
    states_out: wp.array[int],
):
    """Choose the level of each entry's map by the triangle's size in the image, and its state where it has no map.

    Level 0: none. `texels_out`: how many the triangle covers. A mask without an image has one state. Parts whose
    longest edge has no more than `fine` texels are not halved again.
    """
    entry = first + wp.tid()
    levels_out[entry] = 0
    texels_out[entry] = 0.0
    states_out[entry] = OPACITY_UNKNOWN
    face = entry_triangle(scene, starts, instances, entry)
    row = mask_of(scene, rows, face)
    if row < 0:
        return
    mask = masks[row]
    if mask.texture < 0:
        states_out[entry] = state_of(wp.vec2(0.0, 0.0), mask)
        return
    info = mask_image(scene.textures, mask)
    if info.levels > 0:
        piece = triangle_piece(scene, mask, info, face[0], face[1])
        edge = longest_edge(piece)
        level = int(MIN_LEVEL)
        if edge < FAR_TEXELS:
            while level < MAX_LEVEL and edge > fine * float(1 << level):
                level = level + 1
            levels_out[entry] = level
            texels_out[entry] = covered_texels(piece)


@wp.kernel
def limit_levels(
    # In:
    first: int,
    texels: wp.array[float],
    most: float,
    limit: int,
    # Out:
    levels_out: wp.array[int],
    words_out: wp.array[int],
):
    """Lower levels to `limit`, to none for more texels than `most`, and write how many words each map has."""
    entry = first + wp.tid()
    level = wp.where(texels[entry] > most, 0, wp.min(levels_out[entry], limit))
    levels_out[entry] = level
    words_out[entry] = wp.where(level == 0, 0, 1 << (2 * (level - MIN_LEVEL)))


@wp.kernel
def fill_maps(
    # In:
    first: int,
    scene: Scene,
    starts: wp.array[int],
    instances: wp.array[int],
    rows: wp.array[int],
    masks: wp.array[AlphaMask],
    levels: wp.array[int],
    ends: wp.array[int],
    # Out:
    maps_out: wp.array[wp.uint32],
):
    """Write the words of all maps, each by its own thread; `ends` holds the sum of words up to each entry."""
    word = first + wp.tid()
    entry = wp.lower_bound(ends, word + 1)
    face = entry_triangle(scene, starts, instances, entry)
    mask = masks[mask_of(scene, rows, face)]
    info = mask_image(scene.textures, mask)
    piece = triangle_piece(scene, mask, info, face[0], face[1])
    halvings = levels[entry] - MIN_LEVEL
    number = word - ends[entry] + (1 << (2 * halvings))
    while halvings > 0:
        halvings = halvings - 1
        piece = part_of(piece, (number >> (2 * halvings)) & 3)
    # The sixteenth parts of what is known are known.
    state = piece_state(scene.textures, info, mask, scene.luminance, piece)
    result = wp.uint32(state) * wp.uint32(0x55555555)
    if state == OPACITY_UNKNOWN:
        k = int(0)
        while k < 16:
            quarter = part_of(piece, k >> 2)
            if (k & 3) == 0:
                state = piece_state(scene.textures, info, mask, scene.luminance, quarter)
            part = state
            if state == OPACITY_UNKNOWN:
                part = piece_state(scene.textures, info, mask, scene.luminance, part_of(quarter, k & 3))
            result = result | (wp.uint32(part) << wp.uint32(2 * k))
            k = k + 1
    maps_out[word] = result


@wp.kernel
def judge_maps(
    # In:
    first: int,
    levels: wp.array[int],
    ends: wp.array[int],
    maps: wp.array[wp.uint32],
    # Out:
    states_out: wp.array[int],
    kept_out: wp.array[int],
):
    """Write the state of each entry with a map, and how many words it needs: none where it is the same everywhere."""
    entry = first + wp.tid()
    kept_out[entry] = 0
    if levels[entry] > 0:
        word = int(0)
        if entry > 0:
            word = ends[entry - 1]
        count = ends[entry] - word
        state = int(maps[word] & wp.uint32(3))
        same = wp.uint32(state) * wp.uint32(0x55555555)
        while word < ends[entry] and state != OPACITY_MIXED:
            if maps[word] != same:
                state = OPACITY_MIXED
            word = word + 1
        states_out[entry] = state
        if state == OPACITY_MIXED:
            kept_out[entry] = count


@wp.kernel
def place_maps(
    # In:
    first: int,
    ends: wp.array[int],
    kept_ends: wp.array[int],
    maps: wp.array[wp.uint32],
    offset: int,
    # Out:
    words_out: wp.array[wp.uint32],
):
    """Copy a word of the maps that are needed, which follow each other from word `offset` on."""
    word = first + wp.tid()
    entry = wp.lower_bound(kept_ends, word + 1)
    # Counted from the ends: they belong to the same map.
    words_out[offset + word] = maps[ends[entry] - kept_ends[entry] + word]


@wp.kernel
def mark_triangles(
    # In:
    first: int,
    scene: Scene,
    faces: wp.array[wp.vec2i],
    bases: wp.array[int],
    levels: wp.array[int],
    states: wp.array[int],
    kept_ends: wp.array[int],
    # Out:
    words_out: wp.array[wp.uint32],
):
    """Write into the structure's triangles what is known of them; `bases` holds an instance's first entry or -1."""
    base = TRIANGLE_WORDS * (first + wp.tid())
    number = words_out[base + 3]
    known = wp.uint32(0)
    place = wp.uint32(0)
    if number != GONE:
        face = faces[int(number)]
        if bases[face[0]] >= 0:
            entry = bases[face[0]] + face[1] - scene.geometry.instances[face[0]].triangle_offset
            known = wp.uint32(states[entry]) << wp.uint32(30)
            if states[entry] == OPACITY_MIXED:
                level = levels[entry]
                known = known | wp.uint32(level)
                # The words after the last triangle's, less this map's own.
                place = wp.uint32(TRIANGLE_WORDS) * wp.uint32(faces.shape[0])
                place = place + wp.uint32(kept_ends[entry] - (1 << (2 * (level - MIN_LEVEL))))
    words_out[base + 7] = known
    words_out[base + 11] = place
