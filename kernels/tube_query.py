# SPDX-License-Identifier: GPL-3.0-or-later
"""The native source of a ray's test of a tube, the part of wide_query.py that tube_items.py makes use for.

It stands around the test of a triangle: FACES before it finds a tube's next one, FACES_MET is for hits, FACES_END after
it.
"""

from __future__ import annotations

__all__ = ["FACES", "FACES_END", "FACES_MET"]

# A tube's record tells how far a ray passes its axis, which turns most away, and between which of its edges it passes,
# along the common perpendicular of ray and axis: only sides between which it does are tested, those that face the ray
# first. Of those that a ray from outside meets, the first is the closest.
FACES = """
            // Bits 2 k and 2 k + 1 for the triangles of side k, above these the same for sides that face the ray.
            unsigned int faces = 0u;
            const bool half = (opacity_word & 0x40000000u) != 0u;
            // (sx, sy, 1) points along the ray or against it.
            const bool away = ((opacity_word & 0x20000000u) != 0u) != (sz < 0.0f);
            if ((int)opacity_word < 0) {
                const float ex = qx - px, ey = qy - py, ez = qz - pz;
                const float cx = fmaf(sy, ez, -ey), cy = fmaf(-sx, ez, ex), cz = fmaf(sx, ey, -sy * ex);
#ifdef __CUDA_ARCH__
                const float radius = as_float(r2.x);
                const unsigned int ratios = r2.y, frame = r2.z;
#else
                const wp::uint32* last_words = triangle_words + 4 * (size_t)(row + 2u);
                const float radius = as_float(last_words[0]);
                const unsigned int ratios = last_words[1], frame = last_words[2];
#endif
                const float error = 1.0e-6f * (wp::abs(px) + wp::abs(py) + wp::abs(pz));
                const float off = cx * px + cy * py + cz * pz, square = cx * cx + cy * cy + cz * cz;
                if (off * off > (radius + error) * (radius + error) * square)
                    continue;
                float gx, gy, gz;
                turned((float)(frame & 511u) - 255.0f, (float)((frame >> 9) & 511u) - 255.0f,
                       (float)((frame >> 18) & 511u) - 255.0f, gx, gy, gz);
                const float length = ex * ex + ey * ey + ez * ez;
                const float leaning = (gx * ex + gy * ey + gz * ez) * (ex * sx + ey * sy + ez) / most(length, 1.0e-30f);
                const float along = (gx * sx + gy * sy + gz - leaning) * sqrtf(length);
                const float scale = radius * (1.0f / 255.0f);
                const float h0 = scale * (gx * cx + gy * cy + gz * cz);
                const float across = 0.8660254f * scale * ((opacity_word & 0x20000000u) ? along : -along);
                const float h1 = fmaf(0.5f, h0, across), h2 = fmaf(-0.5f, h0, across);
                const float slack = (error + radius * (float)(frame >> 27) * (1.0f / 15.0f)) * sqrtf(square);
                const float begin = (float)(ratios & 0xffffu) * (1.0f / 65535.0f);
                const float end = (float)(ratios >> 16) * (1.0f / 65535.0f);
                const float lows[3] = {least(begin * h0, end * h0), least(begin * h1, end * h1),
                                       least(begin * h2, end * h2)};
                const float highs[3] = {most(begin * h0, end * h0), most(begin * h1, end * h1),
                                        most(begin * h2, end * h2)};
                const unsigned int pair = half ? 1u : 3u;
                #pragma unroll
                for (int side = 0; side < 6; ++side) {
                    const int k = side % 3, n = (side + 1) % 3;
                    const float low_k = side < 3 ? lows[k] : -highs[k], high_k = side < 3 ? highs[k] : -lows[k];
                    const bool turns = side >= 2 && side < 5;
                    const float low_n = turns ? -highs[n] : lows[n], high_n = turns ? -lows[n] : highs[n];
                    if (least(low_k, low_n) + off <= slack && most(high_k, high_n) + off >= -slack)
                        faces |= pair << (2 * side + ((low_n + high_n > low_k + high_k) != away ? 12 : 0));
                }
                if (faces == 0u)
                    continue;
            }
            const unsigned int first_of_tube = face_word;
            do {
                if ((int)opacity_word < 0) {
                    const int bit = highest_bit(faces);
                    faces &= ~(1u << bit);
                    const unsigned int number = (unsigned int)(bit < 12 ? bit : bit - 12);
                    const unsigned int side = number >> 1, following = side == 5u ? 0u : side + 1u;
                    const bool odd = (number & 1u) != 0u;
                    const unsigned int p_row = map_word + side;
                    const unsigned int q_row = map_word + (odd ? 6u + following : following);
                    const unsigned int r_row = map_word + 6u + (odd ? side : following);
                    face_word = first_of_tube + (half ? side : number);
#ifdef __CUDA_ARCH__
                    const Row v0 = load(triangle_words, p_row);
                    const Row v1 = load(triangle_words, q_row);
                    const Row v2 = load(triangle_words, r_row);
                    turned(as_float(v0.x) - ox, as_float(v0.y) - oy, as_float(v0.z) - oz, px, py, pz);
                    turned(as_float(v1.x) - ox, as_float(v1.y) - oy, as_float(v1.z) - oz, qx, qy, qz);
                    turned(as_float(v2.x) - ox, as_float(v2.y) - oy, as_float(v2.z) - oz, rx, ry, rz);
#else
                    corner(p_row, px, py, pz);
                    corner(q_row, qx, qy, qz);
                    corner(r_row, rx, ry, rz);
#endif
                }
"""
FACES_MET = """
                    if ((determinant > 0.0f) != away && (opacity_word & 0x10000000u) == 0u)
                        faces = 0u;
"""
FACES_END = """
            } while (faces != 0u);
"""
