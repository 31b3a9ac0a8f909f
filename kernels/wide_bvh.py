# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays through an 8-wide BVH with quantized child boxes: closest hit and any hit.

The structure and its traversal are those of Ylitie, Karras and Laine, "Efficient Incoherent Ray Traversal on GPUs
Through Compressed Wide BVHs" (HPG 2017): nodes of 80 bytes, children in the order of octants so that a ray takes them
front to back without sorting, and one stack entry for all the children of a node that are left. Differences: child
boxes are widened by a share of a quantum, so that the rounding of float32 can't lose a hit, and triangles are tested
by Woop, Benthin and Wald's "Watertight Ray/Triangle Intersection" (JCGT 2013) on vertices kept in the leaves' order.
engine/wide_bvh.py builds it.

A node is 20 words, read as five times four:

    0..2   origin of the grid (float32)
    3      biased exponents of the grid's spacing along x, y, z (a byte each); bit s of the top byte: slot s is a node
    4      first child node; the others follow in the order of slots
    5      first triangle
    6..7   a byte per slot: 0 empty; node: 0x20 + 24 + slot; leaf: ones for 1 to 3 triangles in the top three bits,
           below them the first of them counted from word 5
    8..19  bytes per slot: low x, low y, low z, high x, high y, high z in quanta

A triangle is 12 words: its three vertices, each with a fourth word, the first of which is the face. Several may be
references to one face: it is tested more than once then, and hit in one place. The other two words of opaque triangles
are for triangle_split.part_box, or tell of a tube (tube_items.py), which stands in the place of a triangle:

    0..2     the beginning of its axis
    3        its first face; the others follow
    4..6     the end of its axis
    7        TUBE, TUBE_HALF where each of its six sides is one triangle instead of two, TUBE_LEFT where its vertices
             go round the axis as a left-handed screw does, TUBE_CROOKED where rays may enter it more than once
    8        radius of a cylinder around the axis that holds it, however long
    9        radii of the rings at both ends over that one, 16 bits each
    10       direction from the axis to the first vertices along x, y, z, 9 bits each from -255 on, then how far off
             regular rings vertices are at most, over the radius, in steps of 1 / TUBE_STEPS
    11       the row, of four words, behind all triangles, where its TUBE_ROWS vertices begin: a ring, then the other

Of triangles for the queries for layers, which alone read them here, the two words tell of the opacity micromap (Gruen,
Benthin and Woop, "Sub-triangle opacity masks for faster ray tracing of transparent objects", 2020) that opacity_maps.py
makes:

    7      the top two bits: an OPACITY_* of the whole triangle; below them an ANSWER_* where hits need a test, and the
           level of OPACITY_MIXED
    11     of ANSWER_CONSTANT the share of light that passes; else the word, counted from the first triangle's, behind
           all triangles, where of ANSWER_IMAGE its place in the image begins, then of OPACITY_MIXED the map

The map of level k has an OPACITY_* of two bits for each of the 4^k triangles that k halvings of all edges leave, in the
order of their numbers in base 4, a digit a halving: 0 to 2 at the triangle's vertices, 3 in the middle.

Where the map leaves a hit open, rays look up what passes (opacity_answers.py). A place of PLACE_WORDS is a triangle's
three vertices in texels, whose centres lie at whole numbers, then the word where the image's answers begin:

    0..3   width, height, EXTENSION_*, the word of the image
    4..    what share passes for the values 0 to 1 in ANSWER_STEPS steps (float32)

The image has a word for each texel, and for IMAGE_BORDER more on the left and below, one less on the right and above:
the values of the texel and of its neighbours to the right, above, and both, a byte each.

The code is native (wide_query.py), since Warp loads arrays of vectors component by component: five loads a node instead
of twenty.
"""

from __future__ import annotations

import warp as wp

from .wide_query import CLOSEST, POSTPONE, RESULT, WAITING, query_source, with_blocks

NODE_WORDS = wp.constant(20)
TRIANGLE_WORDS = wp.constant(12)
# Children of a node; triangles of a leaf.
WIDTH = wp.constant(8)
LEAF_SIZE = wp.constant(3)

# In word 7 of tubes; their sides, and rows of their vertices.
TUBE = wp.constant(wp.uint32(0x80000000))
TUBE_HALF = wp.constant(wp.uint32(0x40000000))
TUBE_LEFT = wp.constant(wp.uint32(0x20000000))
TUBE_CROOKED = wp.constant(wp.uint32(0x10000000))
TUBE_SIDES = wp.constant(6)
TUBE_ROWS = wp.constant(12)
TUBE_STEPS = wp.constant(15.0)

# What is known of a triangle's opacity: a test per hit decides; rays pass; it stops them; its map says.
OPACITY_UNKNOWN = wp.constant(0)
OPACITY_CLEAR = wp.constant(1)
OPACITY_SOLID = wp.constant(2)
OPACITY_MIXED = wp.constant(3)

# How hits are decided where a triangle's state, or its map, leaves them open: by its material's program; all alike; by
# the image in the same memory.
ANSWER_NONE = wp.constant(0)
ANSWER_CONSTANT = wp.constant(16)
ANSWER_IMAGE = wp.constant(32)
PLACE_WORDS = wp.constant(8)
ANSWER_STEPS = wp.constant(512)
ANSWER_WORDS = wp.constant(520)
"""Before the image: whole fours"""
IMAGE_BORDER = wp.constant(2)


@wp.func_native(query_source(CLOSEST, RESULT, POSTPONE, WAITING))
def closest_wide(
    nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32], origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> wp.vec4:
    """Return t, the weights of the first and second vertex, and the face's bits; t_max and -1 without a hit.

    Of triangles at the same distance the one of the lowest face is hit.
    """
    ...


@wp.func_native(query_source("return true;", "false"))
def any_wide(
    nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32], origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> bool:
    """Return whether any triangle lies closer than t_max."""
    ...


@wp.func_native(query_source("return KEY;", "-1"))
def any_face_wide(
    nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32], origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> int:
    """Return the face of any triangle that lies closer than t_max; -1 where none does."""
    ...


# The same where some references are tubes: others go without the registers that these take.


@wp.func_native(query_source(CLOSEST, RESULT, POSTPONE, WAITING, tubes=True))
def closest_with_tubes(
    nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32], origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> wp.vec4:
    """Return what closest_wide does."""
    ...


@wp.func_native(query_source("return true;", "false", tubes=True))
def any_with_tubes(
    nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32], origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> bool:
    """Return what any_wide does."""
    ...


@wp.func_native(query_source("return KEY;", "-1", tubes=True))
def any_face_with_tubes(
    nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32], origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> int:
    """Return what any_face_wide does."""
    ...


@wp.func_native(with_blocks("""
LEAST_AND_MOST
RAY
    aim(origin[0], origin[1], origin[2], direction[0], direction[1], direction[2]);
    float px, py, pz, qx, qy, qz, rx, ry, rz;
    turned(p[0] - ox, p[1] - oy, p[2] - oz, px, py, pz);
    turned(q[0] - ox, q[1] - oy, q[2] - oz, qx, qy, qz);
    turned(r[0] - ox, r[1] - oy, r[2] - oz, rx, ry, rz);
MEET
                if (t >= 0.0f)
                    return wp::vec4(t, u * scale, v * scale, 1.0f);
            }
    return wp::vec4(0.0f, 0.0f, 0.0f, -1.0f);
"""))
def meet_triangle(p: wp.vec3, q: wp.vec3, r: wp.vec3, origin: wp.vec3, direction: wp.vec3) -> wp.vec4:
    """Return t, the weights of the first and second vertex, and 1 where a ray meets a triangle; the last is -1 if not.

    The test of the queries, for who knows a triangle already.
    """
    ...
