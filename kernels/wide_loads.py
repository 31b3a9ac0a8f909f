# SPDX-License-Identifier: GPL-3.0-or-later
"""Loads of whole rows of arrays, four words at a time.

Warp loads vectors, matrices and structs word by word, and shading waits for the number of its loads more than for
their bytes. These functions return the same values from loads of 16 bytes (8 for vectors of four 16-bit numbers);
words that a caller doesn't use are not loaded unless they share such a piece with one it does.

The arrays must be contiguous, begin where Warp's allocators begin or a whole number of rows later, have rows of a
multiple of the load's size (types.py pads structs to it), and no kernel may write them while one that loads them so
is running: on a GPU the loads go through the read-only path.
"""

from __future__ import annotations

import warp as wp

from .types import Geometry, Instance, Material, TextureInfo
from .view import View

__all__ = [
    "PairOfWords", "interpolated_normal", "load_constant", "load_corner", "load_eight_bytes", "load_float",
    "load_four_floats", "load_instance", "load_material_flags", "load_normal", "load_piece", "load_previous_view",
    "load_slab_square", "load_slot", "load_square", "load_texture_info", "load_two_floats", "load_two_words",
    "load_uint", "load_vec2", "load_vec4", "load_vec4h", "load_vec4i", "load_vec4us", "load_view", "load_word",
]

PairOfWords = wp.types.vector(length=2, dtype=wp.uint64)
"""Neighbours in an array of words"""

# Pieces are numbered from the row's begin.
_VECTOR_16 = """
#ifdef __CUDA_ARCH__
    const uint4 w = __ldg(reinterpret_cast<const uint4*>(rows.data + index) + PIECE);
    FLOAT
#else
    const TYPE* w = reinterpret_cast<const TYPE*>(rows.data + index) + 4 * PIECE;
    return wp::vec_t<4, TYPE>(w[0], w[1], w[2], w[3]);
#endif
"""
_AS_INTS = "return wp::vec4i((int)w.x, (int)w.y, (int)w.z, (int)w.w);"
_AS_FLOATS = """return wp::vec4(
        __uint_as_float(w.x), __uint_as_float(w.y), __uint_as_float(w.z), __uint_as_float(w.w));"""
_INTS = _VECTOR_16.replace("FLOAT", _AS_INTS).replace("TYPE", "int")
_FLOATS = _VECTOR_16.replace("FLOAT", _AS_FLOATS).replace("TYPE", "float")

_VECTOR_8 = """
    auto result = rows.data[index];
#ifdef __CUDA_ARCH__
    const uint2 w = __ldg(reinterpret_cast<const uint2*>(rows.data + index));
    memcpy(&result, &w, sizeof(w));
#endif
    return result;
"""


@wp.func_native(_FLOATS.replace("PIECE", "0"))
def load_vec4(rows: wp.array[wp.vec4], index: int) -> wp.vec4:
    """Return rows[index]."""
    ...


@wp.func_native("""
#ifdef __CUDA_ARCH__
    const int row = operand < 0 ? -1 - operand : 0;
    const float4 w = __ldg(reinterpret_cast<const float4*>(rows.data) + row);
    return operand < 0 ? wp::vec4(w.x, w.y, w.z, w.w) : other;
#else
    return operand < 0 ? rows.data[-1 - operand] : other;
#endif
""")
def load_constant(rows: wp.array[wp.vec4], operand: int, other: wp.vec4) -> wp.vec4:
    """Return rows[-1 - operand] for a negative operand, else `other`.

    On a GPU it is loaded in any case: a branch would let one load wait for the next.
    """
    ...


@wp.func_native(_INTS.replace("PIECE", "0"))
def load_vec4i(rows: wp.array[wp.vec4i], index: int) -> wp.vec4i:
    """Return rows[index]."""
    ...


@wp.func_native(_VECTOR_8)
def load_vec2(rows: wp.array[wp.vec2], index: int) -> wp.vec2:
    """Return rows[index]."""
    ...


@wp.func_native(_VECTOR_8)
def load_vec4h(rows: wp.array[wp.vec4h], index: int) -> wp.vec4h:
    """Return rows[index]."""
    ...


@wp.func_native(_VECTOR_8)
def load_vec4us(rows: wp.array[wp.vec4us], index: int) -> wp.vec4us:
    """Return rows[index]."""
    ...


# Neighbours: one address for all, which Warp computes anew for each element.
_NEIGHBORS = """
    const auto* p = rows.data + index;
#ifdef __CUDA_ARCH__
    return TYPE(LOADS);
#else
    return TYPE(VALUES);
#endif
"""


def _neighbors(vector: str, count: int) -> str:
    loads = ", ".join(f"__ldg(p + {i})" for i in range(count))
    values = ", ".join(f"p[{i}]" for i in range(count))
    return _NEIGHBORS.replace("TYPE", vector).replace("LOADS", loads).replace("VALUES", values)


@wp.func_native(_neighbors("wp::vec_t<2, wp::uint64>", 2))
def load_two_words(rows: wp.array[wp.uint64], index: int) -> PairOfWords:
    """Return rows[index] and the one behind it; need not begin at an even index."""
    ...


@wp.func_native("""
#ifdef __CUDA_ARCH__
    const uint4 w = __ldg(reinterpret_cast<const uint4*>(rows.data) + piece);
    return wp::vec_t<4, wp::uint32>(w.x, w.y, w.z, w.w);
#else
    const wp::uint32* w = reinterpret_cast<const wp::uint32*>(rows.data) + 4 * piece;
    return wp::vec_t<4, wp::uint32>(w[0], w[1], w[2], w[3]);
#endif
""")
def load_piece(rows: wp.array[wp.uint64], piece: int) -> wp.vec4ui:
    """Return words 2 * piece and 2 * piece + 1 as four halves of them, the lower ones first."""
    ...


@wp.func_native("""
#ifdef __CUDA_ARCH__
    return __ldg(reinterpret_cast<const unsigned long long*>(rows.data) + piece);
#else
    wp::uint64 w;
    memcpy(&w, rows.data + 8 * piece, sizeof(w));
    return w;
#endif
""")
def load_eight_bytes(rows: wp.array[wp.uint8], piece: int) -> wp.uint64:
    """Return rows[8 * piece] and the seven behind it, the first in the lowest bits."""
    ...


@wp.func_native(_neighbors("wp::uint64", 1))
def load_word(rows: wp.array[wp.uint64], index: int) -> wp.uint64:
    """Return rows[index]."""
    ...


@wp.func_native(_neighbors("wp::float32", 1))
def load_float(rows: wp.array[float], index: int) -> float:
    """Return rows[index]."""
    ...


@wp.func_native(_neighbors("wp::uint32", 1))
def load_uint(rows: wp.array[wp.uint32], index: int) -> wp.uint32:
    """Return rows[index]."""
    ...


@wp.func_native(_neighbors("wp::vec_t<2, float>", 2))
def load_two_floats(rows: wp.array[float], index: int) -> wp.vec2:
    """Return rows[index] and the one behind it; need not begin at an even index."""
    ...


@wp.func_native(_neighbors("wp::vec_t<4, float>", 4))
def load_four_floats(rows: wp.array[float], index: int) -> wp.vec4:
    """Return rows[index] and the three behind it; may begin anywhere."""
    ...


_SQUARE = (_neighbors("wp::vec_t<4, float>", 4).replace("+ 2", "+ count").replace("+ 3", "+ count + 1")
           .replace("[2]", "[count]").replace("[3]", "[count + 1]"))


@wp.func_native(_SQUARE.replace("rows.data + index", "table.data + row * count + column"))
def load_square(table: wp.array2d[float], row: int, column: int, count: int) -> wp.vec4:
    """Return table[row, column], the entry behind it, and the two below these; rows have `count` entries."""
    ...


@wp.func_native(_SQUARE.replace("rows.data + index", "table.data + (slab * count + row) * count + column"))
def load_slab_square(table: wp.array3d[float], slab: int, row: int, column: int, count: int) -> wp.vec4:
    """Return load_square's of a slab, which has `count` rows of as many entries."""
    ...


@wp.func_native(_INTS.replace("PIECE", "piece"))
def instance_ints(rows: wp.array[Instance], index: int, piece: int) -> wp.vec4i:
    """Return a piece of a row as integers."""
    ...


@wp.func_native(_FLOATS.replace("PIECE", "piece"))
def instance_floats(rows: wp.array[Instance], index: int, piece: int) -> wp.vec4:
    """Return a piece of a row as floats."""
    ...


@wp.func_native(_INTS.replace("PIECE", "piece"))
def view_ints(rows: wp.array[View], index: int, piece: int) -> wp.vec4i:
    """Return a piece of a row as integers."""
    ...


@wp.func_native(_FLOATS.replace("PIECE", "piece"))
def view_floats(rows: wp.array[View], index: int, piece: int) -> wp.vec4:
    """Return a piece of a row as floats."""
    ...


@wp.func_native(_INTS.replace("PIECE", "piece"))
def material_ints(rows: wp.array[Material], index: int, piece: int) -> wp.vec4i:
    """Return a piece of a row as integers."""
    ...


@wp.func_native(_INTS.replace("PIECE", "piece"))
def texture_ints(rows: wp.array[TextureInfo], index: int, piece: int) -> wp.vec4i:
    """Return a piece of a row as integers."""
    ...


@wp.func
def matrix_of(x: wp.vec4, y: wp.vec4, z: wp.vec4) -> wp.mat44:
    """Return an affine matrix of three rows."""
    return wp.mat44(
        x[0], x[1], x[2], x[3], y[0], y[1], y[2], y[3], z[0], z[1], z[2], z[3], 0.0, 0.0, 0.0, 1.0)


@wp.func
def load_instance(rows: wp.array[Instance], index: int) -> Instance:
    """Return what shading needs of rows[index]: all but its number, colour and texture space."""
    row = Instance()
    row.to_world = matrix_of(
        instance_floats(rows, index, 0), instance_floats(rows, index, 1), instance_floats(rows, index, 2))
    row.to_object = matrix_of(
        instance_floats(rows, index, 4), instance_floats(rows, index, 5), instance_floats(rows, index, 6))
    places = instance_ints(rows, index, 8)
    row.mesh = places[0]
    row.triangle_offset = places[1]
    row.material_offset = places[2]
    row.material_count = places[3]
    rest = instance_ints(rows, index, 9)
    row.instanced = rest[0]
    row.visibility = rest[1]
    row.flipped = rest[2]
    return row


@wp.func
def load_corner(geometry: Geometry, triangle: int, corner: int) -> wp.vec3:
    """Return the position of one of a triangle's vertices in object space."""
    row = load_vec4(geometry.corners, 6 * triangle + corner)
    return wp.vec3(row[0], row[1], row[2])


@wp.func
def load_normal(geometry: Geometry, triangle: int, corner: int) -> wp.vec3:
    """Return the normal at one of a triangle's corners in object space."""
    row = load_vec4(geometry.corners, 6 * triangle + 3 + corner)
    return wp.vec3(row[0], row[1], row[2])


@wp.func
def interpolated_normal(geometry: Geometry, triangle: int, u: float, v: float) -> wp.vec3:
    """Return the normal within a triangle in object space, not normalised; u, v: weights of its last two corners."""
    return (
        load_normal(geometry, triangle, 0) * (1.0 - u - v)
        + load_normal(geometry, triangle, 1) * u
        + load_normal(geometry, triangle, 2) * v
    )


@wp.func
def load_slot(geometry: Geometry, triangle: int) -> int:
    """Return a triangle's material slot."""
    return int(load_vec4(geometry.corners, 6 * triangle)[3])


@wp.func
def load_material_flags(rows: wp.array[Material], index: int) -> wp.vec4i:
    """Return the starts of a material's surface, transparency and emission programs, and its flags."""
    return material_ints(rows, index, 0)


@wp.func
def load_texture_info(rows: wp.array[TextureInfo], index: int) -> TextureInfo:
    """Return rows[index]."""
    row = TextureInfo()
    size = texture_ints(rows, index, 0)
    row.width = size[0]
    row.height = size[1]
    row.levels = size[2]
    row.offset = size[3]
    kind = texture_ints(rows, index, 1)
    row.format = kind[0]
    row.srgb = kind[1]
    row.alpha = kind[2]
    return row


@wp.func
def load_view(rows: wp.array[View]) -> View:
    """Return what shading needs of the only row: not the camera of the frame before, not the camera's lens."""
    view = View()
    frame = view.camera
    frame.camera_to_world = matrix_of(view_floats(rows, 0, 0), view_floats(rows, 0, 1), view_floats(rows, 0, 2))
    frame.world_to_camera = matrix_of(view_floats(rows, 0, 4), view_floats(rows, 0, 5), view_floats(rows, 0, 6))
    frame.window = view_floats(rows, 0, 8)
    frame.orthographic = view_ints(rows, 0, 9)[0]
    clip = view_floats(rows, 0, 9)
    frame.clip_start = clip[1]
    frame.clip_end = clip[2]
    size = view_ints(rows, 0, 11)
    frame.width = size[0]
    frame.height = size[1]
    frame.crop_x = size[2]
    frame.crop_y = size[3]
    crop = view_ints(rows, 0, 12)
    frame.crop_width = crop[0]
    frame.crop_height = crop[1]
    frame.sample = crop[2]
    frame.seed = crop[3]
    cone = view_floats(rows, 0, 13)
    frame.spread = cone[0]
    frame.pixel_size = cone[1]
    view.camera = frame
    jitter = view_floats(rows, 0, 32)
    view.jitter = wp.vec2(jitter[0], jitter[1])
    view.previous_jitter = wp.vec2(jitter[2], jitter[3])
    ages = view_ints(rows, 0, 33)
    view.frame = ages[0]
    view.rest = ages[1]
    view.light_age = ages[2]
    view.restart = ages[3]
    view.exposure = rows[0].exposure
    view.transparent = rows[0].transparent
    view.moved_age = rows[0].moved_age
    return view


@wp.func
def load_previous_view(rows: wp.array[View]) -> View:
    """Return the same as load_view and the camera of the frame before: its matrices, window and size."""
    view = load_view(rows)
    frame = view.previous
    frame.camera_to_world = matrix_of(view_floats(rows, 0, 16), view_floats(rows, 0, 17), view_floats(rows, 0, 18))
    frame.world_to_camera = matrix_of(view_floats(rows, 0, 20), view_floats(rows, 0, 21), view_floats(rows, 0, 22))
    frame.window = view_floats(rows, 0, 24)
    frame.orthographic = view_ints(rows, 0, 25)[0]
    size = view_ints(rows, 0, 27)
    frame.width = size[0]
    frame.height = size[1]
    frame.crop_x = size[2]
    frame.crop_y = size[3]
    view.previous = frame
    return view
