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
are for triangle_split.part_box. Of triangles for the queries for layers, which alone read them here, they tell of the
opacity micromap (Gruen, Benthin and Woop, "Sub-triangle opacity masks for faster ray tracing of transparent objects",
2020) that opacity_maps.py makes:

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

The code is native, since Warp loads arrays of vectors component by component: five loads a node instead of twenty.
"""

from __future__ import annotations

import warp as wp

NODE_WORDS = wp.constant(20)
TRIANGLE_WORDS = wp.constant(12)
# Children of a node; triangles of a leaf.
WIDTH = wp.constant(8)
LEAF_SIZE = wp.constant(3)
# Levels of nodes that a tree may have. Each needs at most one entry of a ray's stack.
MAX_DEPTH = 32
# Entries for leaves that wait.
WAITING = 16

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

_LEAST_AND_MOST = """
#ifdef __CUDA_ARCH__
    auto least = [](float a, float b) -> float { return fminf(a, b); };
    auto most = [](float a, float b) -> float { return fmaxf(a, b); };
#else
    auto least = [](float a, float b) -> float { return a < b ? a : b; };
    auto most = [](float a, float b) -> float { return a > b ? a : b; };
#endif
"""
# What a ray needs for its tests, and the test of a triangle whose vertices, less the ray's origin, are p, q and r with
# turned axes: the weights of p, q and r times the determinant, and the distance t in the block that it opens.
_SHEAR = """
    // Shear that maps the ray to the axis along which it is longest.
    const int axis = wp::abs(dx) > wp::abs(dy) ? (wp::abs(dx) > wp::abs(dz) ? 0 : 2)
        : (wp::abs(dy) > wp::abs(dz) ? 1 : 2);
    auto turned = [&](float x, float y, float z, float& a, float& b, float& c) {
        a = axis == 0 ? y : (axis == 1 ? z : x);
        b = axis == 0 ? z : (axis == 1 ? x : y);
        c = axis == 0 ? x : (axis == 1 ? y : z);
    };
    float sx, sy, sz;
    turned(dx, dy, dz, sx, sy, sz);
    sz = 1.0f / sz;
    sx = sx * sz;
    sy = sy * sz;
    // Differences of products by Kahan: their sign is exact, so two triangles agree about the edge they share.
    auto product_difference = [](float a, float b, float c, float d) -> float {
        const float cd = c * d;
        return fmaf(a, b, -cd) + fmaf(-c, d, cd);
    };
"""
_MEET = """
            px = fmaf(-sx, pz, px); py = fmaf(-sy, pz, py);
            qx = fmaf(-sx, qz, qx); qy = fmaf(-sy, qz, qy);
            rx = fmaf(-sx, rz, rx); ry = fmaf(-sy, rz, ry);
            const float u = product_difference(rx, qy, ry, qx);
            const float v = product_difference(px, ry, py, rx);
            const float w = product_difference(qx, py, qy, px);
            const bool outside = least(u, least(v, w)) < 0.0f && most(u, most(v, w)) > 0.0f;
            const float determinant = u + v + w;
            if (!outside && determinant != 0.0f) {
                const float scale = 1.0f / determinant;
                const float t = sz * (u * pz + v * qz + w * rz) * scale;
"""

_TRAVERSE = """
    // Loads of four words, bit patterns, bit counting.
#ifdef __CUDA_ARCH__
    using Row = uint4;
    auto load = [](const wp::uint32* words, unsigned int row) -> Row {
        return __ldg(reinterpret_cast<const uint4*>(words) + row);
    };
    auto load_word = [](const wp::uint32* words, unsigned int word) -> unsigned int { return __ldg(words + word); };
    auto as_float = [](unsigned int bits) -> float { return __uint_as_float(bits); };
    auto highest_bit = [](unsigned int bits) -> int { return 31 - __clz((int)bits); };
    auto bit_count = [](unsigned int bits) -> int { return __popc((int)bits); };
#else
    struct Row { unsigned int x, y, z, w; };
    auto load = [](const wp::uint32* words, unsigned int row) -> Row {
        const wp::uint32* p = words + 4 * (size_t)row;
        return Row{p[0], p[1], p[2], p[3]};
    };
    auto load_word = [](const wp::uint32* words, unsigned int word) -> unsigned int { return words[word]; };
    auto as_float = [](unsigned int bits) -> float { union { unsigned int u; float f; } c; c.u = bits; return c.f; };
    auto highest_bit = [](unsigned int bits) -> int { return 31 - __builtin_clz(bits); };
    auto bit_count = [](unsigned int bits) -> int { return __builtin_popcount(bits); };
#endif
LEAST_AND_MOST
    const wp::uint32* node_words = nodes.data;
    const wp::uint32* triangle_words = triangles.data;
    const float ox = origin[0], oy = origin[1], oz = origin[2];
    const float dx = direction[0], dy = direction[1], dz = direction[2];
    // A ray along a plane gets a slope so small that its parameters there are huge but finite.
    const float ix = 1.0f / (wp::abs(dx) > 1.0e-20f ? dx : (dx < 0.0f ? -1.0e-20f : 1.0e-20f));
    const float iy = 1.0f / (wp::abs(dy) > 1.0e-20f ? dy : (dy < 0.0f ? -1.0e-20f : 1.0e-20f));
    const float iz = 1.0f / (wp::abs(dz) > 1.0e-20f ? dz : (dz < 0.0f ? -1.0e-20f : 1.0e-20f));
    const bool nx = dx < 0.0f, ny = dy < 0.0f, nz = dz < 0.0f;
    const unsigned int inverse_octant = 7u - ((nx ? 4u : 0u) | (ny ? 2u : 0u) | (nz ? 1u : 0u));
SHEAR
#ifdef __CUDA_ARCH__
    // The bits of 1.0 in a register: as a constant they take the place of another one, which is then loaded each time.
    const unsigned int one = 0x3f800000u + threadIdx.y;
#else
    // A processor loads what it has turned: the origin, and where the turned axes lie.
    float oa, ob, oc;
    turned(ox, oy, oz, oa, ob, oc);
    const int ka = axis == 2 ? 0 : axis + 1, kb = axis == 0 ? 2 : axis - 1;
#endif
    float best_t = t_max, best_u = 0.0f, best_v = 0.0f;
    int best_key = -1;
    unsigned long long stack[STACK_SIZE];
    int depth = 0;
    unsigned int group_base = 0u, group = 0x80000000u;
    while (true) {
        unsigned int triangle_base, leaves;
        if (group > 0x00ffffffu) {
            const int bit = highest_bit(group);
            const unsigned int rest = group & ~(1u << bit);
            const unsigned int slot = (unsigned int)(bit - 24) ^ inverse_octant;
            const unsigned int node = group_base + bit_count(group & ((1u << slot) - 1u));
            if (rest > 0x00ffffffu)
                stack[depth++] = ((unsigned long long)group_base << 32) | rest;
            const Row n0 = load(node_words, 5u * node);
            const Row n1 = load(node_words, 5u * node + 1u);
            const Row n2 = load(node_words, 5u * node + 2u);
            const Row n3 = load(node_words, 5u * node + 3u);
            const Row n4 = load(node_words, 5u * node + 4u);
            const float ax = as_float((n0.w & 0xffu) << 23) * ix;
            const float ay = as_float((n0.w & 0xff00u) << 15) * iy;
            const float az = as_float((n0.w & 0xff0000u) << 7) * iz;
            const float bx = (as_float(n0.x) - ox) * ix;
            const float by = (as_float(n0.y) - oy) * iy;
            const float bz = (as_float(n0.z) - oz) * iz;
            unsigned int hits = 0u;
TEST_BOXES
            group_base = n1.x;
            group = (hits & 0xff000000u) | (n0.w >> 24);
            triangle_base = n1.y;
            leaves = hits & 0x00ffffffu;
        } else {
            triangle_base = group_base;
            leaves = group;
            group = 0u;
        }
        while (leaves != 0u) {
POSTPONE            const int bit = highest_bit(leaves);
            leaves &= ~(1u << bit);
            const unsigned int row = 3u * (triangle_base + bit);
            float px, py, pz, qx, qy, qz, rx, ry, rz;
#ifdef __CUDA_ARCH__
            const Row r0 = load(triangle_words, row);
            const Row r1 = load(triangle_words, row + 1u);
            const Row r2 = load(triangle_words, row + 2u);
            turned(as_float(r0.x) - ox, as_float(r0.y) - oy, as_float(r0.z) - oz, px, py, pz);
            turned(as_float(r1.x) - ox, as_float(r1.y) - oy, as_float(r1.z) - oz, qx, qy, qz);
            turned(as_float(r2.x) - ox, as_float(r2.y) - oy, as_float(r2.z) - oz, rx, ry, rz);
            const unsigned int face_word = r0.w, opacity_word = r1.w, map_word = r2.w;
#else
            auto corner = [&](unsigned int number, float& a, float& b, float& c) -> unsigned int {
                const wp::uint32* words = triangle_words + 4 * (size_t)(row + number);
                a = as_float(words[ka]) - oa;
                b = as_float(words[kb]) - ob;
                c = as_float(words[axis]) - oc;
                return words[3];
            };
            const unsigned int face_word = corner(0u, px, py, pz);
            const unsigned int opacity_word = corner(1u, qx, qy, qz);
            const unsigned int map_word = corner(2u, rx, ry, rz);
#endif
MEET
                if (t >= 0.0f && (t < best_t || (t == best_t && KEY < best_key))) {
                    FOUND
                }
            }
        }
        if (group <= 0x00ffffffu) {
            if (depth == 0)
                break;
            const unsigned long long entry = stack[--depth];
            group_base = (unsigned int)(entry >> 32);
            group = (unsigned int)entry;
        }
    }
"""

# A GPU's thread tests the children one by one, with bytes as the mantissa of a number in [1, 1.008): permutations run
# at a higher rate than conversions. The rounding of the larger slope and offset errs by 0.002 quanta. Numbers from zero
# on are in the order of their bits, and what a negative one is compared with is not: so all comparisons are those of
# integers, of which Hopper has some with three operands. A box's far side is moved out by four steps of float32.
# A processor tests all eight at once, in vectors: 1.3 to 1.8 times as fast.
_TEST_BOXES = """
#ifdef __CUDA_ARCH__
            const float gx = 32768.0f * ax, gy = 32768.0f * ay, gz = 32768.0f * az;
            const float hx = bx - gx, hy = by - gy, hz = bz - gz;
            auto byte_of = [&](unsigned int word, int k) -> float {
                return __uint_as_float(__byte_perm(word, one, 0x7604u | (unsigned int)(k << 4)));
            };
#if __CUDA_ARCH__ >= 900
            auto entry = [](float x, float y, float z) -> int {
                return __vimax3_s32_relu(__float_as_int(x), __float_as_int(y), __float_as_int(z));
            };
            auto exit = [&](float x, float y, float z) -> int {
                return __viaddmin_s32(
                    __vimin3_s32(__float_as_int(x), __float_as_int(y), __float_as_int(z)), 4, __float_as_int(best_t));
            };
#else
            auto entry = [](float x, float y, float z) -> int {
                return __float_as_int(fmaxf(fmaxf(x, y), fmaxf(z, 0.0f)));
            };
            auto exit = [&](float x, float y, float z) -> int {
                return __float_as_int(fminf(fminf(x, y), fminf(z, best_t)) * 1.0000005f);
            };
#endif
            auto test_four = [&](unsigned int meta, unsigned int low_x, unsigned int low_y, unsigned int low_z,
                                 unsigned int high_x, unsigned int high_y, unsigned int high_z) {
                const unsigned int inner = ((meta & (meta << 1)) & 0x10101010u) >> 4;
                const unsigned int shift4 = (meta ^ ((inverse_octant * 0x01010101u) & (inner * 255u))) & 0x1f1f1f1fu;
                const unsigned int bits4 = (meta >> 5) & 0x07070707u;
                const unsigned int near_x = nx ? high_x : low_x, far_x = nx ? low_x : high_x;
                const unsigned int near_y = ny ? high_y : low_y, far_y = ny ? low_y : high_y;
                const unsigned int near_z = nz ? high_z : low_z, far_z = nz ? low_z : high_z;
                #pragma unroll
                for (int k = 0; k < 4; ++k) {
                    const int t0 = entry(fmaf(byte_of(near_x, k), gx, hx), fmaf(byte_of(near_y, k), gy, hy),
                                         fmaf(byte_of(near_z, k), gz, hz));
                    const int t1 = exit(fmaf(byte_of(far_x, k), gx, hx), fmaf(byte_of(far_y, k), gy, hy),
                                        fmaf(byte_of(far_z, k), gz, hz));
                    if (t0 <= t1)
                        hits |= ((bits4 >> (8 * k)) & 0xffu) << ((shift4 >> (8 * k)) & 0xffu);
                }
            };
            test_four(n1.z, n2.x, n2.z, n3.x, n3.z, n4.x, n4.z);
            test_four(n1.w, n2.y, n2.w, n3.y, n3.w, n4.y, n4.w);
#else
            typedef unsigned char Bytes __attribute__((vector_size(8)));
            typedef unsigned int Words __attribute__((vector_size(32)));
            typedef float Floats __attribute__((vector_size(32)));
            const wp::uint32* node_start = node_words + 20 * (size_t)node;
            auto bytes_at = [&](unsigned int word) -> Bytes {
                Bytes bytes;
                __builtin_memcpy(&bytes, node_start + word, 8);
                return bytes;
            };
            auto planes = [&](unsigned int word, float slope, float offset) -> Floats {
                const Floats quanta = __builtin_convertvector(bytes_at(word), Floats);
                return __builtin_elementwise_fma(quanta, Floats{} + slope, Floats{} + offset);
            };
            const Floats near_x = planes(nx ? 14u : 8u, ax, bx), far_x = planes(nx ? 8u : 14u, ax, bx);
            const Floats near_y = planes(ny ? 16u : 10u, ay, by), far_y = planes(ny ? 10u : 16u, ay, by);
            const Floats near_z = planes(nz ? 18u : 12u, az, bz), far_z = planes(nz ? 12u : 18u, az, bz);
            const Floats zero = {0.0f}, farthest = zero + best_t;
            const Floats near_xy = near_x > near_y ? near_x : near_y, near_z0 = near_z > zero ? near_z : zero;
            const Floats far_xy = far_x < far_y ? far_x : far_y, far_zt = far_z < farthest ? far_z : farthest;
            const Floats t0 = near_xy > near_z0 ? near_xy : near_z0, t1 = far_xy < far_zt ? far_xy : far_zt;
            const Words meta = __builtin_convertvector(bytes_at(6u), Words);
            const Words inner = (meta & (meta << 1)) & 0x10u;
            const Words shift = (meta ^ (inner != 0u ? Words{} + inverse_octant : Words{})) & 0x1fu;
            const Words bits = ((meta >> 5) << shift) & (Words)(t0 <= t1 * 1.0000005f);
            hits = __builtin_reduce_or(bits);
#endif
"""
# Leaves wait on the stack while few of the warp's rays have one.
POSTPONE = """
#ifdef __CUDA_ARCH__
            if (group > 0x00ffffffu && depth < WAITING && __popc(__activemask()) < 8) {
                stack[depth++] = ((unsigned long long)triangle_base << 32) | leaves;
                break;
            }
#endif
"""
FACE = "(int)face_word"
CLOSEST = """best_t = t;
                    best_u = u * scale;
                    best_v = v * scale;
                    best_key = KEY;"""
RESULT = "wp::vec4(best_t, best_u, best_v, as_float((unsigned int)best_key))"

def query_source(found: str, result: str, postpone: str = "", waiting: int = 0, key: str = FACE) -> str:
    """Return the native source of a query.

    Args:
        found: What to do at a hit before the closest: best_t, best_u, best_v and best_key are what is known of that.
        result: What the query returns when it has seen all.
        postpone: POSTPONE, or nothing for queries that end at hits.
        waiting: WAITING with POSTPONE.
        key: What tells hits at the same distance apart: the lowest counts.
    """
    text = _TRAVERSE
    for name, block in (("LEAST_AND_MOST", _LEAST_AND_MOST), ("SHEAR", _SHEAR), ("TEST_BOXES", _TEST_BOXES),
                        ("MEET", _MEET)):
        text = text.replace(f"{name}\n", block.lstrip("\n"))
    text = text.replace("POSTPONE", postpone.lstrip("\n"))
    text = text.replace("STACK_SIZE", str(MAX_DEPTH + waiting)).replace("WAITING", str(waiting))
    return text.replace("FOUND", found).replace("KEY", key) + f"    return {result};\n"


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


@wp.func_native("""
    const float ox = origin[0], oy = origin[1], oz = origin[2];
    const float dx = direction[0], dy = direction[1], dz = direction[2];
""" + _LEAST_AND_MOST + _SHEAR + """
    float px, py, pz, qx, qy, qz, rx, ry, rz;
    turned(p[0] - ox, p[1] - oy, p[2] - oz, px, py, pz);
    turned(q[0] - ox, q[1] - oy, q[2] - oz, qx, qy, qz);
    turned(r[0] - ox, r[1] - oy, r[2] - oz, rx, ry, rz);
""" + _MEET + """
                if (t >= 0.0f)
                    return wp::vec4(t, u * scale, v * scale, 1.0f);
            }
    return wp::vec4(0.0f, 0.0f, 0.0f, -1.0f);
""")
def meet_triangle(p: wp.vec3, q: wp.vec3, r: wp.vec3, origin: wp.vec3, direction: wp.vec3) -> wp.vec4:
    """Return t, the weights of the first and second vertex, and 1 where a ray meets a triangle; the last is -1 if not.

    The test of the queries, for who knows a triangle already.
    """
    ...
