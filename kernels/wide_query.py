# SPDX-License-Identifier: GPL-3.0-or-later
"""The native source of queries of the 8-wide BVH: the pieces that rays' ways through one or two levels are made of.

wide_bvh.py tells what nodes and triangles look like. A line that is a name in capitals stands for a piece.
"""

from __future__ import annotations

from .tube_query import FACES, FACES_END, FACES_MET

__all__ = ["CLOSEST", "MAX_DEPTH", "POSTPONE", "RESULT", "WAITING", "Way", "query_source", "with_blocks"]


# Levels of nodes that a tree may have. Each needs at most one entry of a ray's stack.
MAX_DEPTH = 32
# Entries for leaves that wait.
WAITING = 16

_LEAST_AND_MOST = """
#ifdef __CUDA_ARCH__
    auto least = [](float a, float b) -> float { return fminf(a, b); };
    auto most = [](float a, float b) -> float { return fmaxf(a, b); };
#else
    auto least = [](float a, float b) -> float { return a < b ? a : b; };
    auto most = [](float a, float b) -> float { return a > b ? a : b; };
#endif
"""
# What a ray needs for its tests, set by `aim`: its place and direction, the slopes of its distances to planes, and the
# shear that maps it to the axis along which it is longest.
_RAY = """
    float ox, oy, oz, dx, dy, dz, ix, iy, iz, sx, sy, sz;
    bool nx, ny, nz;
    unsigned int inverse_octant;
    int axis;
#ifndef __CUDA_ARCH__
    // A processor loads what it has turned: the origin, and where the turned axes lie.
    float oa, ob, oc;
    int ka, kb;
#endif
    auto turned = [&](float x, float y, float z, float& a, float& b, float& c) {
        a = axis == 0 ? y : (axis == 1 ? z : x);
        b = axis == 0 ? z : (axis == 1 ? x : y);
        c = axis == 0 ? x : (axis == 1 ? y : z);
    };
    auto aim = [&](float from_x, float from_y, float from_z, float to_x, float to_y, float to_z) {
        ox = from_x; oy = from_y; oz = from_z;
        dx = to_x; dy = to_y; dz = to_z;
        // A ray along a plane gets a slope so small that its parameters there are huge but finite.
        ix = 1.0f / (wp::abs(dx) > 1.0e-20f ? dx : (dx < 0.0f ? -1.0e-20f : 1.0e-20f));
        iy = 1.0f / (wp::abs(dy) > 1.0e-20f ? dy : (dy < 0.0f ? -1.0e-20f : 1.0e-20f));
        iz = 1.0f / (wp::abs(dz) > 1.0e-20f ? dz : (dz < 0.0f ? -1.0e-20f : 1.0e-20f));
        nx = dx < 0.0f; ny = dy < 0.0f; nz = dz < 0.0f;
        inverse_octant = 7u - ((nx ? 4u : 0u) | (ny ? 2u : 0u) | (nz ? 1u : 0u));
        axis = wp::abs(dx) > wp::abs(dy) ? (wp::abs(dx) > wp::abs(dz) ? 0 : 2)
            : (wp::abs(dy) > wp::abs(dz) ? 1 : 2);
        turned(dx, dy, dz, sx, sy, sz);
        sz = 1.0f / sz;
        sx = sx * sz;
        sy = sy * sz;
#ifndef __CUDA_ARCH__
        turned(ox, oy, oz, oa, ob, oc);
        ka = axis == 2 ? 0 : axis + 1;
        kb = axis == 0 ? 2 : axis - 1;
#endif
    };
    // Differences of products by Kahan: their sign is exact, so two triangles agree about the edge they share.
    auto product_difference = [](float a, float b, float c, float d) -> float {
        const float cd = c * d;
        return fmaf(a, b, -cd) + fmaf(-c, d, cd);
    };
"""
# The test of a triangle whose vertices, less the ray's origin, are p, q and r with turned axes: the weights of p, q and
# r times the determinant, and the distance t in the block that it opens.
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

# Loads of four words, bit patterns, bit counting; the bits of 1.0 in a register: as a constant they take the place of
# another one, which is then loaded each time.
_LOADS = """
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
#ifdef __CUDA_ARCH__
    const unsigned int one = 0x3f800000u + threadIdx.y;
#endif
"""
# A step into a node: the nodes that the ray meets next, triangle_base and leaves.
_VISIT_NODE = """
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
"""
_TEST_TRIANGLE = """
            const unsigned int row = 3u * (triangle_base + bit);
            float px, py, pz, qx, qy, qz, rx, ry, rz;
#ifdef __CUDA_ARCH__
            const Row r0 = load(triangle_words, row);
            const Row r1 = load(triangle_words, row + 1u);
            const Row r2 = load(triangle_words, row + 2u);
            turned(as_float(r0.x) - ox, as_float(r0.y) - oy, as_float(r0.z) - oz, px, py, pz);
            turned(as_float(r1.x) - ox, as_float(r1.y) - oy, as_float(r1.z) - oz, qx, qy, qz);
            turned(as_float(r2.x) - ox, as_float(r2.y) - oy, as_float(r2.z) - oz, rx, ry, rz);
            unsigned int face_word = r0.w;
            const unsigned int opacity_word = r1.w, map_word = r2.w;
#else
            auto corner = [&](unsigned int number, float& a, float& b, float& c) -> unsigned int {
                const wp::uint32* words = triangle_words + 4 * (size_t)number;
                a = as_float(words[ka]) - oa;
                b = as_float(words[kb]) - ob;
                c = as_float(words[axis]) - oc;
                return words[3];
            };
            unsigned int face_word = corner(row, px, py, pz);
            const unsigned int opacity_word = corner(row + 1u, qx, qy, qz);
            const unsigned int map_word = corner(row + 2u, rx, ry, rz);
#endif
FACES
MEET
                if (t >= 0.0f && (t < best_t || (t == best_t && KEY < best_key))) {
                    FOUND
FACES_MET
                }
            }
FACES_END
"""
_TRAVERSE = """
LOADS
LEAST_AND_MOST
RAY
START
    aim(origin[0], origin[1], origin[2], direction[0], direction[1], direction[2]);
    float best_t = t_max, best_u = 0.0f, best_v = 0.0f;
    int best_key = -1;
    unsigned long long stack[STACK_SIZE];
    int depth = 0;
    unsigned int group_base = 0u, group = 0x80000000u;
    while (true) {
        unsigned int triangle_base, leaves;
        if (group > 0x00ffffffu) {
VISIT_NODE
        } else {
            triangle_base = group_base;
            leaves = group;
            group = 0u;
        }
ENTER
        while (leaves != 0u) {
POSTPONE            const int bit = highest_bit(leaves);
            leaves &= ~(1u << bit);
TEST_TRIANGLE
        }
        if (group <= 0x00ffffffu) {
LEAVE
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
_START = """    const wp::uint32* node_words = nodes.data;
    const wp::uint32* triangle_words = triangles.data;
"""
RESULT = "wp::vec4(best_t, best_u, best_v, as_float((unsigned int)best_key))"


class Way:
    """What is different in ways through one level or two."""

    def __init__(self, start: str = _START, enter: str = "", leave: str = "", waiting: str = "depth", entries: int = 0):
        """Describe one.

        Args:
            start: Where node_words and triangle_words lie at first.
            enter: What comes before leaves' triangles are tested.
            leave: What comes before the ray turns to what waits on the stack.
            waiting: How many entries wait.
            entries: Of the stack, besides MAX_DEPTH.
        """
        self.start, self.enter, self.leave, self.waiting, self.entries = start, enter, leave, waiting, entries


def with_blocks(text: str, way: Way | None = None, *, tubes: bool = False) -> str:
    """Return native source with the names of blocks, on lines of their own, replaced by them."""
    way = way or Way()
    for name, block in (
            ("START", way.start), ("ENTER", way.enter), ("LEAVE", way.leave), ("LOADS", _LOADS),
            ("LEAST_AND_MOST", _LEAST_AND_MOST), ("RAY", _RAY), ("VISIT_NODE", _VISIT_NODE),
            ("TEST_BOXES", _TEST_BOXES), ("TEST_TRIANGLE", _TEST_TRIANGLE), ("MEET", _MEET),
            ("FACES", FACES if tubes else ""), ("FACES_MET", FACES_MET if tubes else ""),
            ("FACES_END", FACES_END if tubes else "")):
        text = text.replace(f"{name}\n", block.lstrip("\n"))
    return text


def query_source(
    found: str, result: str, postpone: str = "", waiting: int = 0, key: str = FACE, way: Way | None = None, *,
    tubes: bool = False,
) -> str:
    """Return the native source of a query.

    Args:
        found: What to do at a hit before the closest: best_t, best_u, best_v and best_key are what is known of that.
        result: What the query returns when it has seen all.
        postpone: POSTPONE, or nothing for queries that end at hits.
        waiting: WAITING with POSTPONE.
        key: What tells hits at the same distance apart: the lowest counts.
        tubes: Whether references may be tubes.
        way: Through the tree; None: through one level.
    """
    way = way or Way()
    text = with_blocks(_TRAVERSE, way, tubes=tubes).replace("POSTPONE", postpone.lstrip("\n"))
    text = text.replace("STACK_SIZE", str(MAX_DEPTH + way.entries + waiting))
    text = text.replace("depth < WAITING", f"{way.waiting} < {waiting}")
    return text.replace("FOUND", found).replace("KEY", key) + f"    return {result};\n"
