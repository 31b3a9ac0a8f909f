# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that make opacity micromaps: where triangles are clear, solid, or need a test per hit.

What the maps look like is in wide_bvh.py, what decides in opacity_pieces.py, how rays test what maps leave open in
opacity_answers.py. engine/opacity_maps.py launches these kernels; most work on entries: each triangle of a mesh under a
set of materials has one, which all its instances share.
"""

from __future__ import annotations

import warp as wp

from .intersect import triangle_material
from .opacity_pieces import (
    AlphaMask,
    Piece,
    covered_texels,
    is_near,
    longest_edge,
    part_of,
    piece_state,
    state_of,
    triangle_piece,
)
from .types import Scene, TextureInfo, Textures
from .wide_bvh import (
    ANSWER_CONSTANT,
    ANSWER_IMAGE,
    ANSWER_NONE,
    OPACITY_MIXED,
    OPACITY_UNKNOWN,
    PLACE_WORDS,
    TRIANGLE_WORDS,
)
from .wide_bvh_edit import GONE
from .wide_loads import load_texture_info

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# The halvings of a map's edges. A word holds the sixteen states that two halvings leave.
MIN_LEVEL = wp.constant(2)
MAX_LEVEL = wp.constant(9)


@wp.func
def entry_triangle(scene: Scene, starts: wp.array[int], instances: wp.array[int], entry: int) -> wp.vec2i:
    """Return (instance, triangle) of an entry, of one of the instances that share it.

    Blocks of entries begin at `starts`, which has one more than there are, beyond all entries.
    """
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
    answers_out: wp.array[int],
):
    """Choose the level of each entry's map by the triangle's size in the image, and its state where it has no map.

    Level 0: none. `texels_out`: how many the triangle covers. A mask without an image has one state. Parts whose
    longest edge has no more than `fine` texels are not halved again. `answers_out`: ANSWER_*.
    """
    entry = first + wp.tid()
    levels_out[entry] = 0
    texels_out[entry] = 0.0
    states_out[entry] = OPACITY_UNKNOWN
    answers_out[entry] = ANSWER_NONE
    face = entry_triangle(scene, starts, instances, entry)
    row = mask_of(scene, rows, face)
    if row < 0:
        return
    mask = masks[row]
    if mask.texture < 0:
        states_out[entry] = state_of(wp.vec2(0.0, 0.0), mask)
        if mask.passing >= 0.0:
            answers_out[entry] = ANSWER_CONSTANT
        return
    info = mask_image(scene.textures, mask)
    if info.levels > 0:
        piece = triangle_piece(scene, mask, info, face[0], face[1])
        edge = longest_edge(piece)
        level = int(MIN_LEVEL)
        if is_near(piece):
            if mask.answers >= 0:
                answers_out[entry] = ANSWER_IMAGE
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


@wp.func
def place_words(state: int, answer: int) -> int:
    """Return how many words a triangle's place in the image takes: none where nothing is left open."""
    open_state = state == OPACITY_UNKNOWN or state == OPACITY_MIXED
    return wp.where(open_state and answer == ANSWER_IMAGE, PLACE_WORDS, 0)


@wp.func
def map_words(state: int, level: int) -> int:
    """Return how many words a map is given: none where it is the same everywhere, whole fours for wide loads."""
    words = wp.max(4, 1 << wp.max(2 * (level - MIN_LEVEL), 0))
    return wp.where(state == OPACITY_MIXED, words, 0)


@wp.kernel
def judge_maps(
    # In:
    first: int,
    levels: wp.array[int],
    ends: wp.array[int],
    maps: wp.array[wp.uint32],
    answers: wp.array[int],
    # Out:
    states_out: wp.array[int],
    kept_out: wp.array[int],
):
    """Write the state of each entry with a map, and how many words it keeps."""
    entry = first + wp.tid()
    if levels[entry] > 0:
        word = int(0)
        if entry > 0:
            word = ends[entry - 1]
        state = int(maps[word] & wp.uint32(3))
        same = wp.uint32(state) * wp.uint32(0x55555555)
        while word < ends[entry] and state != OPACITY_MIXED:
            if maps[word] != same:
                state = OPACITY_MIXED
            word = word + 1
        states_out[entry] = state
    kept_out[entry] = place_words(states_out[entry], answers[entry]) + map_words(states_out[entry], levels[entry])


@wp.func
def place_word(piece: Piece, answers: int, word: int) -> wp.uint32:
    """Return a word of a triangle's place in the image; see wide_bvh.py."""
    corner = wp.where(word < 2, piece.a, wp.where(word < 4, piece.b, piece.c))
    value = wp.cast(corner[word & 1], wp.uint32)
    return wp.where(word < 6, value, wp.where(word == 6, wp.uint32(answers), wp.uint32(0)))


@wp.kernel
def place_maps(
    # In:
    first: int,
    scene: Scene,
    starts: wp.array[int],
    instances: wp.array[int],
    rows: wp.array[int],
    masks: wp.array[AlphaMask],
    levels: wp.array[int],
    states: wp.array[int],
    answers: wp.array[int],
    ends: wp.array[int],
    kept_ends: wp.array[int],
    maps: wp.array[wp.uint32],
    offset: int,
    # Out:
    words_out: wp.array[wp.uint32],
):
    """Write a word of what entries keep, which follow each other from word `offset` on: place in the image, map."""
    word = first + wp.tid()
    entry = wp.lower_bound(kept_ends, word + 1)
    before = place_words(states[entry], answers[entry])
    number = word - kept_ends[entry] + before + map_words(states[entry], levels[entry])
    result = wp.uint32(0)
    if number < before:
        face = entry_triangle(scene, starts, instances, entry)
        mask = masks[mask_of(scene, rows, face)]
        piece = triangle_piece(scene, mask, mask_image(scene.textures, mask), face[0], face[1])
        result = place_word(piece, mask.answers, number)
    else:
        count = 1 << (2 * (levels[entry] - MIN_LEVEL))
        if number - before < count:
            result = maps[ends[entry] - count + number - before]
    words_out[offset + word] = result


@wp.kernel
def mark_triangles(
    # In:
    first: int,
    scene: Scene,
    faces: wp.array[wp.vec2i],
    bases: wp.array[int],
    rows: wp.array[int],
    masks: wp.array[AlphaMask],
    levels: wp.array[int],
    states: wp.array[int],
    answers: wp.array[int],
    kept_ends: wp.array[int],
    offset: int,
    # Out:
    words_out: wp.array[wp.uint32],
    open_out: wp.array[int],
):
    """Write into the structure's triangles what is known of them; `bases` holds an instance's first entry or -1.

    `offset`: where what entries keep begins. `open_out`: 1 where rays can't decide all hits on the triangle.
    """
    i = first + wp.tid()
    base = TRIANGLE_WORDS * i
    number = words_out[base + 3]
    known = wp.uint32(0)
    place = wp.uint32(0)
    open_out[i] = wp.where(number == GONE, 0, 1)
    if number != GONE:
        face = faces[int(number)]
        if bases[face[0]] >= 0:
            entry = bases[face[0]] + face[1] - scene.geometry.instances[face[0]].triangle_offset
            state = states[entry]
            answer = answers[entry]
            known = (wp.uint32(state) << wp.uint32(30)) | wp.uint32(answer)
            kept = place_words(state, answer) + map_words(state, levels[entry])
            if kept > 0:
                place = wp.uint32(offset + kept_ends[entry] - kept)
            if state == OPACITY_MIXED:
                known = known | wp.uint32(levels[entry])
            elif answer == ANSWER_CONSTANT:
                place = wp.cast(masks[mask_of(scene, rows, face)].passing, wp.uint32)
            if answer != ANSWER_NONE or (state != OPACITY_UNKNOWN and state != OPACITY_MIXED):
                open_out[i] = 0
    words_out[base + 7] = known
    words_out[base + 11] = place
