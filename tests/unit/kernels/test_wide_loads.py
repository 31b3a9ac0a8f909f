# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of kernels/wide_loads.py and wide_stores.py: loads by pieces return what loads by name do, stores arrive."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.kernels.types import Geometry, Instance, Material, TextureInfo
from burnish.kernels.view import View
from burnish.kernels.wide_loads import (
    load_corner,
    load_eight_bytes,
    load_float,
    load_four_floats,
    load_instance,
    load_material_flags,
    load_normal,
    load_piece,
    load_previous_view,
    load_slab_square,
    load_slot,
    load_square,
    load_texture_info,
    load_two_floats,
    load_two_words,
    load_uint,
    load_vec2,
    load_vec4h,
    load_vec4us,
    load_view,
    load_word,
)
from burnish.kernels.wide_stores import store_vec2, store_vec4, store_vec4h

wp.set_module_options({"enable_backward": False})

COUNT = 5


@wp.kernel
def copy_rows(
    instances: wp.array[Instance], views: wp.array[View], infos: wp.array[TextureInfo],
    materials: wp.array[Material], instances_out: wp.array[Instance], views_out: wp.array[View],
    infos_out: wp.array[TextureInfo], flags_out: wp.array[wp.vec4i],
):
    """Copy rows by the loads under test."""
    i = wp.tid()
    instances_out[i] = load_instance(instances, i)
    infos_out[i] = load_texture_info(infos, i)
    flags_out[i] = load_material_flags(materials, i)
    if i == 0:
        views_out[0] = load_view(views)


@wp.kernel
def copy_vectors(
    geometry: Geometry, halves: wp.array[wp.vec4h], shorts: wp.array[wp.vec4us], halves_out: wp.array[wp.vec4h],
    shorts_out: wp.array[wp.vec4us], uvs_out: wp.array[wp.vec2], corners_out: wp.array[wp.vec3],
    slots_out: wp.array[int],
):
    """Copy vectors by the loads under test."""
    i = wp.tid()
    halves_out[i] = load_vec4h(halves, i)
    shorts_out[i] = load_vec4us(shorts, i)
    uvs_out[i] = load_vec2(geometry.uvs, i)
    slots_out[i] = load_slot(geometry, i)
    for k in range(3):
        corners_out[6 * i + k] = load_corner(geometry, i, k)
        corners_out[6 * i + 3 + k] = load_normal(geometry, i, k)


def _random_rows(dtype: type, count: int) -> np.ndarray:
    """Return rows of small numbers, different ones in all words."""
    kind = np.dtype(dtype.numpy_dtype())
    return np.arange(1, count * kind.itemsize // 4 + 1, dtype=np.int32).view(kind)


def _fields(value: np.ndarray, names: list[str]) -> dict[str, bytes]:
    return {name: np.ascontiguousarray(value[name]).tobytes() for name in names}


@pytest.mark.parametrize("struct", [Instance, Material, TextureInfo])
def test_rows_are_whole_pieces(struct: type) -> None:
    """Arrays of structs that are loaded by pieces begin each row at a piece."""
    assert np.dtype(struct.numpy_dtype()).itemsize % 16 == 0


@pytest.mark.parametrize("device", ["cpu", *(["cuda:0"] if wp.get_cuda_device_count() else [])])
def test_structs(device: str) -> None:
    """Each field that a load promises holds what its name holds in the array."""
    rows = {struct: _random_rows(struct, 1 if struct is View else COUNT)
            for struct in (Instance, View, TextureInfo, Material)}
    # Affine matrices: their last rows are not loaded.
    for name in ("to_world", "to_object"):
        rows[Instance][name][:, 3] = (0.0, 0.0, 0.0, 1.0)
    for name in ("camera_to_world", "world_to_camera"):
        rows[View]["camera"][name][:, 3] = (0.0, 0.0, 0.0, 1.0)
    sources = [wp.array(values, dtype=struct, device=device) for struct, values in rows.items()]
    outs = [wp.zeros(len(rows[s]), dtype=s, device=device) for s in (Instance, View, TextureInfo)]
    flags = wp.zeros(COUNT, dtype=wp.vec4i, device=device)
    wp.launch(copy_rows, COUNT, [*sources, *outs, flags], device=device)
    instances, views, infos = (out.numpy() for out in outs)
    names = ["to_world", "to_object", "mesh", "triangle_offset", "material_offset", "material_count", "instanced",
             "visibility", "flipped"]
    assert _fields(instances, names) == _fields(rows[Instance], names)
    names = ["width", "height", "levels", "offset", "format", "srgb", "alpha"]
    assert _fields(infos, names) == _fields(rows[TextureInfo], names)
    names = ["jitter", "previous_jitter", "frame", "rest", "light_age", "restart", "exposure", "transparent",
             "moved_age"]
    assert _fields(views, names) == _fields(rows[View], names)
    names = ["camera_to_world", "world_to_camera", "window", "orthographic", "clip_start", "clip_end", "width",
             "height", "crop_x", "crop_y", "crop_width", "crop_height", "sample", "seed", "spread", "pixel_size"]
    assert _fields(views["camera"], names) == _fields(rows[View]["camera"], names)
    starts = ("surface_start", "transparency_start", "emission_start", "flags")
    assert (flags.numpy() == np.stack([rows[Material][name] for name in starts], 1)).all()


@pytest.mark.parametrize("device", ["cpu", *(["cuda:0"] if wp.get_cuda_device_count() else [])])
def test_vectors(device: str) -> None:
    """Vectors and the parts of a triangle's corners arrive as they were stored."""
    random = np.random.default_rng(1)
    halves = random.normal(size=(COUNT, 4)).astype(np.float16)
    shorts = random.integers(0, 65536, (COUNT, 4)).astype(np.uint16)
    uvs = random.normal(size=(COUNT, 2)).astype(np.float32)
    corners = random.normal(size=(COUNT, 6, 4)).astype(np.float32)
    corners[:, 0, 3] = np.arange(COUNT)
    geometry = Geometry()
    geometry.uvs = wp.array(uvs, dtype=wp.vec2, device=device)
    geometry.corners = wp.array(corners.reshape(-1, 4), dtype=wp.vec4, device=device)
    outs = [wp.zeros(count, dtype=dtype, device=device) for count, dtype in (
        (COUNT, wp.vec4h), (COUNT, wp.vec4us), (COUNT, wp.vec2), (6 * COUNT, wp.vec3), (COUNT, int))]
    wp.launch(copy_vectors, COUNT, [
        geometry, wp.array(halves, dtype=wp.vec4h, device=device), wp.array(shorts, dtype=wp.vec4us, device=device),
        *outs], device=device)
    expected = (halves, shorts, uvs, corners.reshape(-1, 4)[:, :3], np.arange(COUNT))
    for out, values in zip(outs, expected, strict=True):
        assert (out.numpy() == values).all()


@wp.kernel
def copy_previous(views: wp.array[View], views_out: wp.array[View]):
    """Copy a view with the camera of the frame before."""
    views_out[0] = load_previous_view(views)


@pytest.mark.parametrize("device", ["cpu", *(["cuda:0"] if wp.get_cuda_device_count() else [])])
def test_previous_view(device: str) -> None:
    """The camera of the frame before begins in the middle of a piece."""
    rows = _random_rows(View, 1)
    for name in ("camera_to_world", "world_to_camera"):
        for camera in ("camera", "previous"):
            rows[camera][name][:, 3] = (0.0, 0.0, 0.0, 1.0)
    out = wp.zeros(1, dtype=View, device=device)
    wp.launch(copy_previous, 1, [wp.array(rows, dtype=View, device=device), out], device=device)
    names = ["camera_to_world", "world_to_camera", "window", "orthographic", "width", "height", "crop_x", "crop_y"]
    for camera in ("camera", "previous"):
        assert _fields(out.numpy()[camera], names) == _fields(rows[camera], names)
    assert out.numpy()["frame"] == rows["frame"]


@wp.kernel
def copy_neighbors(
    words: wp.array[wp.uint64], floats: wp.array[float], small: wp.array[wp.uint8], words_out: wp.array[wp.uint64],
    floats_out: wp.array[float], packed_out: wp.array[wp.uint64], pieces_out: wp.array[wp.vec4ui],
    two_out: wp.array[wp.vec2], four_out: wp.array[wp.vec4], halves_out: wp.array[wp.vec4h],
):
    """Copy what lies side by side by the loads under test, and store vectors."""
    i = wp.tid()
    two = load_two_words(words, i)
    words_out[3 * i] = two[0]
    words_out[3 * i + 1] = two[1]
    words_out[3 * i + 2] = load_word(words, i)
    near = load_two_floats(floats, i)
    far = load_four_floats(floats, i)
    for k in range(2):
        floats_out[6 * i + k] = near[k]
    for k in range(4):
        floats_out[6 * i + 2 + k] = far[k]
    packed_out[i] = load_eight_bytes(small, i)
    pieces_out[i] = load_piece(words, i)
    store_vec2(two_out, i, near)
    store_vec4(four_out, i, far)
    store_vec4h(halves_out, i, wp.vec4h(
        wp.float16(far[0]), wp.float16(far[1]), wp.float16(far[2]), wp.float16(far[3])))


@pytest.mark.parametrize("device", ["cpu", *(["cuda:0"] if wp.get_cuda_device_count() else [])])
def test_neighbors_and_stores(device: str) -> None:
    """Neighbours arrive wherever they begin, and vectors where they are stored."""
    random = np.random.default_rng(2)
    words = random.integers(0, 1 << 63, 2 * COUNT).astype(np.uint64)
    floats = random.normal(size=COUNT + 3).astype(np.float32)
    small = random.integers(0, 256, 8 * COUNT).astype(np.uint8)
    types = ((3 * COUNT, wp.uint64), (6 * COUNT, float), (COUNT, wp.uint64), (COUNT, wp.vec4ui), (COUNT, wp.vec2),
             (COUNT, wp.vec4), (COUNT, wp.vec4h))
    outs = [wp.zeros(count, dtype=dtype, device=device) for count, dtype in types]
    inputs = [wp.array(values, dtype=dtype, device=device) for values, dtype in (
        (words, wp.uint64), (floats, float), (small, wp.uint8))]
    wp.launch(copy_neighbors, COUNT, [*inputs, *outs], device=device)
    i = np.arange(COUNT)[:, None]
    far = floats[i + np.arange(4)]
    expected = (
        words[i + [[0, 1, 0]]].ravel(), np.hstack([far[:, :2], far]).ravel(), small.view(np.uint64),
        words.view(np.uint32).reshape(-1, 4), far[:, :2], far, far.astype(np.float16))
    for out, values in zip(outs, expected, strict=True):
        assert (out.numpy() == values).all()


@wp.kernel
def copy_tables(
    words: wp.array[wp.uint32], numbers: wp.array[float], square: wp.array2d[float], cube: wp.array3d[float],
    words_out: wp.array[wp.uint32], numbers_out: wp.array[float], squares_out: wp.array3d[float],
    cubes_out: wp.array4d[float],
):
    """Copy all places of tables that have a neighbour behind and below."""
    i, j, k = wp.tid()
    words_out[k] = load_uint(words, k)
    numbers_out[k] = load_float(numbers, k)
    for c in range(4):
        squares_out[j, k, c] = load_square(square, j, k, COUNT)[c]
        cubes_out[i, j, k, c] = load_slab_square(cube, i, j, k, COUNT)[c]


@pytest.mark.parametrize("device", ["cpu", *(["cuda:0"] if wp.get_cuda_device_count() else [])])
def test_tables(device: str) -> None:
    """Loads from tables of one, two and three dimensions return the entries at the place that was asked for."""
    random = np.random.default_rng(2)
    words = random.integers(0, 1 << 32, COUNT - 1, dtype=np.uint64).astype(np.uint32)
    numbers = random.normal(size=COUNT - 1).astype(np.float32)
    square = random.normal(size=(COUNT, COUNT)).astype(np.float32)
    cube = random.normal(size=(COUNT, COUNT, COUNT)).astype(np.float32)
    n = COUNT - 1
    outs = [wp.zeros(shape, dtype=dtype, device=device)
            for shape, dtype in ((n, wp.uint32), (n, float), ((n, n, 4), float), ((COUNT, n, n, 4), float))]
    inputs = [wp.array(words, dtype=wp.uint32, device=device), *(
        wp.array(table, dtype=float, device=device) for table in (numbers, square, cube))]
    wp.launch(copy_tables, (COUNT, n, n), [*inputs, *outs], device=device)
    expected = (
        words, numbers,
        np.stack([square[:-1, :-1], square[:-1, 1:], square[1:, :-1], square[1:, 1:]], -1),
        np.stack([cube[:, :-1, :-1], cube[:, :-1, 1:], cube[:, 1:, :-1], cube[:, 1:, 1:]], -1))
    for out, values in zip(outs, expected, strict=True):
        assert (out.numpy() == values).all()
