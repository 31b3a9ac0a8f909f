# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays through instances: an 8-wide BVH in world space over others in object space, each of which many may share.

A node of the upper level is one of wide_bvh.py, with instances in place of triangles. A ray goes through both levels in
one loop with one stack: at an instance it is turned into object space, and back when nothing is left of that. Its
direction keeps its length's share, so distances mean the same in both. While some rays of a warp are in the upper
level and others in the lower, they test boxes together.

What a ray must know of an instance is a record of 20 words, in the leaves' order:

    0..11    rows of the transform from world to object space (float32)
    12..13   address of the object-space nodes
    14..15   address of the object-space triangles
    16       the mesh's root among the nodes
    17       what is added to a triangle's face
    18       the instance

Addresses, since meshes are built, edited and dropped one by one.
"""

from __future__ import annotations

import warp as wp

from .wide_layers import CHANCE_LAYER, CLOSEST_LAYER, PASSING_LAYER, shadow_layer
from .wide_query import CLOSEST, MAX_DEPTH, POSTPONE, WAITING, Way, query_source

RECORD_WORDS = wp.constant(20)

InstanceHit = wp.types.vector(length=5, dtype=float)
"""t, the weights of the first and second vertex, the bits of the face with what its instance adds, the instance's"""

InstanceLayerHit = wp.types.vector(length=6, dtype=float)
"""The same, and the share that passes where it was hit"""

_START = """
    auto words_at = [](unsigned int low, unsigned int high) -> const wp::uint32* {
        return reinterpret_cast<const wp::uint32*>((unsigned long long)low | ((unsigned long long)high << 32));
    };
    auto along = [&](const Row& m, float x, float y, float z) -> float {
        return as_float(m.x) * x + as_float(m.y) * y + as_float(m.z) * z;
    };
    const wp::uint32* upper_words = reinterpret_cast<const wp::uint32*>(nodes);
    const wp::uint32* record_words = reinterpret_cast<const wp::uint32*>(records);
    const wp::uint32* node_words = upper_words;
    const wp::uint32* triangle_words = nullptr;
    int best_instance = -1, instance = -1, first_face = 0;
    // Inside an instance the upper level's entries lie below `ground`.
    int ground = 0;
"""
_ENTER = """
        if (leaves != 0u && instance < 0) {
            const int bit = highest_bit(leaves);
            leaves &= ~(1u << bit);
            // What is left of this level waits.
            if (group > 0x00ffffffu)
                stack[depth++] = ((unsigned long long)group_base << 32) | group;
            if (leaves != 0u)
                stack[depth++] = ((unsigned long long)triangle_base << 32) | leaves;
            const unsigned int row = 5u * (triangle_base + bit);
            const Row m0 = load(record_words, row);
            const Row m1 = load(record_words, row + 1u);
            const Row m2 = load(record_words, row + 2u);
            const Row m3 = load(record_words, row + 3u);
            const Row m4 = load(record_words, row + 4u);
            aim(along(m0, ox, oy, oz) + as_float(m0.w), along(m1, ox, oy, oz) + as_float(m1.w),
                along(m2, ox, oy, oz) + as_float(m2.w), along(m0, dx, dy, dz), along(m1, dx, dy, dz),
                along(m2, dx, dy, dz));
            node_words = words_at(m3.x, m3.y);
            triangle_words = words_at(m3.z, m3.w);
            first_face = (int)m4.y;
            instance = (int)m4.z;
            ground = depth;
            group_base = m4.x;
            group = 0x80000000u;
            leaves = 0u;
        }
"""
_LEAVE = """
            if (depth == ground && instance >= 0) {
                instance = -1;
                ground = 0;
                node_words = upper_words;
                aim(origin[0], origin[1], origin[2], direction[0], direction[1], direction[2]);
            }
"""
# The upper level has as many entries, and one for leaves left of the node that the instance is from.
_WAY = Way(_START, _ENTER, _LEAVE, "depth - ground", MAX_DEPTH + 1)
_KEY = "first_face + (int)face_word"
# Its lowest bit tells whether a layer's map says that it is solid.
_LAYER_KEY = "2 * (first_face + (int)face_word)"


def _source(
    found: str, result: str, nothing: str, *, postponing: bool = False, key: str = _KEY, tubes: bool = False,
) -> str:
    """Return the native source of a query; `nothing`: what it returns without instances."""
    postpone, waiting = (POSTPONE, WAITING) if postponing else ("", 0)
    return f"    if (nodes == 0u)\n        return {nothing};\n" + query_source(
        found, result, postpone, waiting, key, _WAY, tubes=tubes)


def _hit(*values: str) -> str:
    return f"wp::vec_t<{len(values)}, wp::float32>({{" + ", ".join(values) + "})"


_FOUND = ("best_t", "best_u", "best_v", "as_float((unsigned int)best_key)", "as_float((unsigned int)best_instance)")
_NONE = ("t_max", "0.0f", "0.0f", "-1.0f", "-1.0f")


def _with_instance(found: str) -> str:
    """Return what to do at a hit that is kept, with its instance kept too."""
    return found.replace("best_t = t;", "best_t = t; best_instance = instance;")


@wp.func_native(_source(_with_instance(CLOSEST), _hit(*_FOUND), _hit(*_NONE), postponing=True))
def closest_in_instances(
    nodes: wp.uint64, records: wp.uint64, origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> InstanceHit:
    """Return the closest hit among instances; a face below 0 and t_max where there is none.

    In detail:
        nodes: Address of the upper level's nodes, 0 where there is none.
        records: Address of its instances' records.
        returns: As InstanceHit tells.
    """
    ...


@wp.func_native(_source("return true;", "false", "false"))
def any_in_instances(
    nodes: wp.uint64, records: wp.uint64, origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> bool:
    """Return whether a triangle of an instance lies closer than t_max."""
    ...


@wp.func_native(_source(
    "return wp::vec_t<2, wp::int32>(KEY, instance);", *2 * ("wp::vec_t<2, wp::int32>(-1, -1)",)))
def any_face_in_instances(
    nodes: wp.uint64, records: wp.uint64, origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> wp.vec2i:
    """Return face, with what its instance adds, and instance of any triangle closer than t_max; -1 where none is."""
    ...


# The same where some meshes have tubes.


@wp.func_native(_source(_with_instance(CLOSEST), _hit(*_FOUND), _hit(*_NONE), postponing=True, tubes=True))
def closest_in_instances_with_tubes(
    nodes: wp.uint64, records: wp.uint64, origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> InstanceHit:
    """Return what closest_in_instances does."""
    ...


@wp.func_native(_source("return true;", "false", "false", tubes=True))
def any_in_instances_with_tubes(
    nodes: wp.uint64, records: wp.uint64, origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> bool:
    """Return what any_in_instances does."""
    ...


@wp.func_native(_source(
    "return wp::vec_t<2, wp::int32>(KEY, instance);", *2 * ("wp::vec_t<2, wp::int32>(-1, -1)",), tubes=True))
def any_face_in_instances_with_tubes(
    nodes: wp.uint64, records: wp.uint64, origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> wp.vec2i:
    """Return what any_face_in_instances does."""
    ...


@wp.func_native(_source(
    _with_instance(CLOSEST_LAYER), _hit(*_FOUND), _hit(*_NONE), postponing=True, key=_LAYER_KEY))
def closest_layer_in_instances(
    nodes: wp.uint64, records: wp.uint64, origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> InstanceHit:
    """Return the closest hit where a triangle is not known to be clear; see wide_layers.closest_layer_wide."""
    ...


@wp.func_native(_source(
    _with_instance(shadow_layer(_hit(
        "t", "u * scale", "v * scale", "as_float((unsigned int)(KEY + 1))", "as_float((unsigned int)instance)"))),
    _hit(*_FOUND), _hit(*_NONE), postponing=True, key=_LAYER_KEY))
def shadow_layer_in_instances(
    nodes: wp.uint64, records: wp.uint64, origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> InstanceHit:
    """Return the same for rays that any solid triangle ends; see wide_layers.shadow_layer_wide."""
    ...


@wp.func_native("    float through = 1.0f;\n" + _source(PASSING_LAYER, "through", "1.0f"))
def passing_layers_in_instances(
    nodes: wp.uint64, records: wp.uint64, origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> float:
    """Return what share of light instances' layers let through together; see wide_layers.passing_layers_wide."""
    ...


# Instances of a mesh decide each for itself.
@wp.func_native("    float best_passing = 0.0f;\n" + _source(
    _with_instance(CHANCE_LAYER).replace("(face_word *", "((face_word ^ ((unsigned int)instance * 0x27D4EB2Fu)) *"),
    _hit(*_FOUND, "best_passing"), _hit(*_NONE, "0.0f"), postponing=True))
def chance_layer_in_instances(
    nodes: wp.uint64, records: wp.uint64, origin: wp.vec3, direction: wp.vec3, t_max: float, seed: wp.uint32,
) -> InstanceLayerHit:
    """Return the closest of instances' layers that stops a ray; see wide_layers.chance_layer_wide."""
    ...
