# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays through the wide BVH of triangles that need a test per hit: what opacity maps and answers say of them.

wide_bvh.py tells what they look like. Native code, as there.
"""

from __future__ import annotations

import warp as wp

from . import wide_bvh
from .wide_query import POSTPONE, RESULT, WAITING, query_source

__all__ = [
    "CHANCE_LAYER", "CLOSEST_LAYER", "PASSING_LAYER", "LayerHit", "chance_layer_wide", "closest_layer_wide",
    "passing_layers_wide", "shadow_layer", "shadow_layer_wide",
]

LayerHit = wp.types.vector(length=5, dtype=float)
"""t, the weights of the first and second vertex, the face's bits, and the share that passes where it was hit"""

# The key of a layer tells faces apart as the face does, its lowest bit whether the map says that it is solid.
_LAYER_KEY = "2 * (int)face_word"
_LAYER = """unsigned int opacity = opacity_word >> 30;
                    const bool by_image = (opacity_word & ANSWER_IMAGEu) != 0u;
                    float passing = -1.0f;
                    if (opacity == 3u) {
                        float a = u * scale, b = v * scale, c = 1.0f - a - b;
                        unsigned int micro = 0u;
                        for (unsigned int level = opacity_word & 15u; level != 0u; --level) {
                            a += a; b += b; c += c;
                            if (a >= 1.0f) { a -= 1.0f; micro = 4u * micro; }
                            else if (b >= 1.0f) { b -= 1.0f; micro = 4u * micro + 1u; }
                            else if (c >= 1.0f) { c -= 1.0f; micro = 4u * micro + 2u; }
                            else { a = 1.0f - a; b = 1.0f - b; c = 1.0f - c; micro = 4u * micro + 3u; }
                        }
                        const unsigned int map = map_word + (by_image ? PLACE_WORDSu : 0u);
                        opacity = (load_word(triangle_words, map + (micro >> 4)) >> (2u * (micro & 15u))) & 3u;
                    }
                    if (opacity == 0u && (opacity_word & (ANSWER_CONSTANTu | ANSWER_IMAGEu)) != 0u) {
                        if (by_image) {
                            const Row p0 = load(triangle_words, map_word >> 2);
                            const Row p1 = load(triangle_words, (map_word >> 2) + 1u);
                            const Row image = load(triangle_words, p1.z >> 2);
                            const float a = u * scale, b = v * scale, c = 1.0f - a - b;
                            float x = a * as_float(p0.x) + b * as_float(p0.z) + c * as_float(p1.x);
                            float y = a * as_float(p0.y) + b * as_float(p0.w) + c * as_float(p1.y);
                            const float left = wp::floor(x), below = wp::floor(y);
                            x -= left;
                            y -= below;
                            int column = (int)left, row = (int)below;
                            const int width = (int)image.x, height = (int)image.y;
                            if (image.z == 0u) {
                                column %= width;
                                column += column < 0 ? width : 0;
                                row %= height;
                                row += row < 0 ? height : 0;
                            } else {
                                column = column < -IMAGE_BORDER ? -IMAGE_BORDER : (column > width ? width : column);
                                row = row < -IMAGE_BORDER ? -IMAGE_BORDER : (row > height ? height : row);
                            }
                            const unsigned int four = load_word(
                                triangle_words, image.w + (unsigned int)(
                                    (row + IMAGE_BORDER) * (width + 2 * IMAGE_BORDER - 1) + column + IMAGE_BORDER));
                            const float lower = (float)(four & 255u) * (1.0f - x) + (float)(four >> 8 & 255u) * x;
                            const float upper = (float)(four >> 16 & 255u) * (1.0f - x) + (float)(four >> 24) * x;
                            const float value = (lower * (1.0f - y) + upper * y) * (ANSWER_STEPS.0f / 255.0f);
                            const int step = value < ANSWER_STEPS.0f - 1.0f ? (int)value : ANSWER_STEPS - 1;
                            const float p = as_float(load_word(triangle_words, p1.z + 4u + (unsigned int)step));
                            const float q = as_float(load_word(triangle_words, p1.z + 5u + (unsigned int)step));
                            passing = p + (q - p) * (value - (float)step);
                        } else {
                            passing = as_float(map_word);
                        }
                        opacity = passing >= 1.0f ? 1u : (passing <= 0.0f ? 2u : 0u);
                        // A ray through an edge meets both of its triangles: it counts for the one on its left.
                        if (opacity == 0u && (u == 0.0f || v == 0.0f || w == 0.0f)) {
                            auto counts = [&](float at, float x, float y) -> bool {
                                return at != 0.0f || (determinant > 0.0f ? (x > 0.0f || (x == 0.0f && y > 0.0f))
                                                                         : (x < 0.0f || (x == 0.0f && y < 0.0f)));
                            };
                            if (!counts(u, rx - qx, ry - qy) || !counts(v, px - rx, py - ry)
                                || !counts(w, qx - px, qy - py))
                                opacity = 1u;
                        }
                    }
                    """
for _name in ("ANSWER_CONSTANT", "ANSWER_IMAGE", "ANSWER_STEPS", "IMAGE_BORDER", "PLACE_WORDS"):
    _LAYER = _LAYER.replace(_name, str(int(getattr(wide_bvh, _name))))
CLOSEST_LAYER = _LAYER + """if (opacity != 1u) {
                        best_t = t;
                        best_u = u * scale;
                        best_v = v * scale;
                        best_key = KEY + (opacity == 2u ? 1 : 0);
                    }"""


def shadow_layer(solid: str) -> str:
    """Return what to do at a hit: end with `solid`, what to return there, or keep the closest."""
    return _LAYER + f"""if (opacity == 2u)
                        return {solid};
                    if (opacity == 0u) {{
                        best_t = t;
                        best_u = u * scale;
                        best_v = v * scale;
                        best_key = KEY;
                    }}"""


# All layers let some through or none.
PASSING_LAYER = _LAYER + """if (opacity == 2u)
                        return 0.0f;
                    if (opacity == 0u)
                        through *= passing;"""
# Whether a layer stops the ray is a random number of ray and face, so that layers may be met in any order.
CHANCE_LAYER = _LAYER + """bool stops = opacity == 2u;
                    if (opacity == 0u) {
                        unsigned int bits = seed ^ (face_word * 0x9E3779B9u + 0x85EBCA6Bu);
                        bits = (bits ^ (bits >> 16)) * 0x7FEB352Du;
                        bits = (bits ^ (bits >> 15)) * 0x846CA68Bu;
                        bits ^= bits >> 16;
                        stops = (float)(bits >> 8) * (1.0f / 16777216.0f) >= passing;
                    }
                    if (stops) {
                        best_t = t;
                        best_u = u * scale;
                        best_v = v * scale;
                        best_key = KEY;
                        best_passing = opacity == 2u ? 0.0f : passing;
                    }"""
_LAYER_HIT = """wp::vec_t<5, wp::float32>({
        best_t, best_u, best_v, as_float((unsigned int)best_key), best_passing})"""


@wp.func_native(query_source(CLOSEST_LAYER, RESULT, POSTPONE, WAITING, _LAYER_KEY))
def closest_layer_wide(
    nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32], origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> wp.vec4:
    """Return the closest hit where a triangle is not known to be clear.

    As closest_wide, but the last bits are twice the face, plus 1 where the triangle is known to be solid.
    """
    ...


@wp.func_native(query_source(
    shadow_layer("wp::vec4(t, u * scale, v * scale, as_float((unsigned int)(KEY + 1)))"), RESULT, POSTPONE, WAITING,
    _LAYER_KEY))
def shadow_layer_wide(
    nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32], origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> wp.vec4:
    """Return the same for rays that any solid triangle ends: one such hit if it is met on the way to the closest."""
    ...


@wp.func_native("    float through = 1.0f;\n" + query_source(PASSING_LAYER, "through"))
def passing_layers_wide(
    nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32], origin: wp.vec3, direction: wp.vec3, t_max: float,
) -> float:
    """Return what share of light all layers before t_max let through together, where none needs a program."""
    ...


@wp.func_native("    float best_passing = 0.0f;\n" + query_source(CHANCE_LAYER, _LAYER_HIT, POSTPONE, WAITING))
def chance_layer_wide(
    nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32], origin: wp.vec3, direction: wp.vec3, t_max: float,
    seed: wp.uint32,
) -> LayerHit:
    """Return the closest layer that stops a ray, where none needs a program; t_max and -1 where all let it pass.

    A layer lets a ray pass with the chance that is the share of light that it lets pass; `seed` decides.
    """
    ...
