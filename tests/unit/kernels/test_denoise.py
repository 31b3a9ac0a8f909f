# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the denoisers' parts: packed means, reading between pixels, edge-stopping weights."""

import numpy as np
import pytest
import warp as wp
from burnish.kernels import direct_atrous, filter_weights, long_mean
from burnish.kernels.gbuffer import GBuffer, load_surface, plane_distance
from burnish.kernels.packed_halves import pack_halves, unpack_first, unpack_halves
from burnish.kernels.packing import pack_normal, rgb, unpack_normal
from burnish.kernels.view import View, pixel_footprint

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False})

WIDTH, HEIGHT = 16, 12
COUNT = WIDTH * HEIGHT


@wp.kernel
def round_trip(colors: wp.array[wp.vec3], out: wp.array[wp.vec3]):
    i = wp.tid()
    out[i] = long_mean.unpack_mean(long_mean.pack_mean(colors[i]))


@wp.kernel
def pack_all(colors: wp.array[wp.vec3], out: wp.array[wp.uint64]):
    i = wp.tid()
    out[i] = long_mean.pack_mean(colors[i])


@wp.kernel
def gather_all(image: wp.array[wp.uint64], positions: wp.array[wp.vec2], width: int, height: int,
               wide: bool, out: wp.array[wp.vec3]):
    i = wp.tid()
    place = long_mean.place_between(positions[i], width)
    out[i] = long_mean.gather_cubic(image, place, width, height, wide, long_mean.SMOOTH)


@wp.kernel
def pack_normals(normals: wp.array[wp.vec3], out: wp.array[wp.uint32]):
    i = wp.tid()
    out[i] = pack_normal(normals[i])


@wp.kernel
def compare_offsets(views: wp.array[View], gbuffer: GBuffer, width: int, centre: int, out: wp.array[wp.vec2]):
    pixel = wp.tid()
    view = views[0]
    plane = filter_weights.pixel_plane(view, gbuffer, width, centre)
    p = load_surface(view, gbuffer, width, centre)
    q = load_surface(view, gbuffer, width, pixel)
    dx = pixel % width - centre % width
    dy = pixel // width - centre // width
    offset = filter_weights.plane_offset(plane, dx, dy, gbuffer.depth[pixel])
    out[pixel] = wp.vec2(offset, plane_distance(p, q.position) / pixel_footprint(view.camera, p.depth))


@wp.func
def one_way(p: wp.vec4, q: wp.vec4) -> float:
    return direct_atrous.noise_weight(
        filter_weights.brightness(rgb(p)), direct_atrous.own_variance(p), filter_weights.brightness(rgb(q)), q[3])


@wp.kernel
def weigh_noise(p: wp.array[wp.vec4], q: wp.array[wp.vec4], out: wp.array[wp.vec2]):
    i = wp.tid()
    out[i] = wp.vec2(one_way(p[i], q[i]), one_way(q[i], p[i]))


@wp.kernel
def weigh_normals(normals: wp.array[wp.uint32], out: wp.array[wp.vec2]):
    i = wp.tid()
    square = filter_weights.squared_cosine(wp.vec3(0.0, 0.0, 1.0), normals[i])
    out[i] = wp.vec2(filter_weights.smooth_normal_weight(square), filter_weights.sharp_normal_weight(square))


@wp.kernel
def weigh_roughness(a: wp.array[wp.uint32], b: wp.array[wp.uint32], out: wp.array[wp.vec2]):
    i = wp.tid()
    out[i] = wp.vec2(filter_weights.roughness_weight(a[i], b[i]), filter_weights.roughness_weight(b[i], a[i]))


@wp.kernel
def decode_normals(packed: wp.array[wp.uint32], centre: wp.vec3, out: wp.array[wp.vec2]):
    i = wp.tid()
    n = unpack_normal(packed[i])
    cosine = wp.max(wp.dot(n, centre), 0.0)
    out[i] = wp.vec2(
        wp.length(filter_weights.unit_normal(packed[i]) - n),
        wp.abs(filter_weights.squared_cosine(centre, packed[i]) - cosine * cosine))


@wp.kernel
def pack_four(values: wp.array[wp.vec4], out: wp.array[wp.uint64]):
    i = wp.tid()
    out[i] = pack_halves(values[i])


@wp.kernel
def unpack_four(words: wp.array[wp.uint64], out: wp.array[wp.vec4]):
    i = wp.tid()
    v = unpack_halves(words[i])
    out[i] = wp.vec4(unpack_first(words[i]), v[1], v[2], v[3])


@wp.kernel
def cap_lengths(rest: wp.array[int], light_age: int, cap: float, out: wp.array[float]):
    i = wp.tid()
    out[i] = long_mean.history_cap(rest[i], light_age, cap)


def run(kernel, inputs, dtype, count):
    out = wp.zeros(count, dtype=dtype, device=DEVICE)
    wp.launch(kernel, count, [*inputs, out], device=DEVICE)
    return out.numpy()


def vectors(values, dtype=wp.vec3):
    return wp.array(np.asarray(values, np.float32), dtype=dtype, device=DEVICE)


def test_packed_means_are_precise():
    """Keep colours over twelve decades within 2^-16, and half-floats exactly."""
    rng = np.random.default_rng(1)
    colors = np.exp(rng.uniform(np.log(1e-8), np.log(6e4), (10000, 3))).astype(np.float32)
    assert run(round_trip, [vectors(colors)], wp.vec3, 10000) == pytest.approx(colors, rel=2.0**-16)
    halves = np.append(colors[1000:].astype(np.float16), np.zeros((1, 3))).reshape(-1, 3).astype(np.float32)
    assert (run(round_trip, [vectors(halves)], wp.vec3, len(halves)) == halves).all()


def test_packed_means_are_finite():
    """Turn NaN, infinities, negative and tiny numbers into numbers of the format."""
    found = run(round_trip, [vectors([[np.nan, np.inf, -np.inf], [-1.0, 1e30, 1e-30]])], wp.vec3, 2)
    most = pytest.approx(65000.0, rel=1e-4)
    assert found.tolist() == [[0.0, most, 0.0], [0.0, most, 0.0]]


def test_cubic_gather_is_sharp_and_bounded():
    """Reproduce a ramp exactly between pixels, and stay within the four nearest at a step."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    rng = np.random.default_rng(2)
    places = rng.uniform((2.0, 2.0), (WIDTH - 2.0, HEIGHT - 2.0), (500, 2)).astype(np.float32)
    ramp = np.stack([x, y, 2 * x + y], -1).reshape(-1, 3)
    image = wp.array(run(pack_all, [vectors(ramp)], wp.uint64, COUNT), dtype=wp.uint64, device=DEVICE)
    found = run(gather_all, [image, vectors(places, wp.vec2), WIDTH, HEIGHT, False], wp.vec3, 500)
    expected = places - 0.5
    assert found[:, :2] == pytest.approx(expected, abs=1e-4)
    assert found[:, 2] == pytest.approx(expected @ [2.0, 1.0], abs=1e-3)
    step = np.where(x >= 8, 1.0, 0.25)[..., None].repeat(3, -1).reshape(-1, 3)
    image = wp.array(run(pack_all, [vectors(step)], wp.uint64, COUNT), dtype=wp.uint64, device=DEVICE)
    found = run(gather_all, [image, vectors(places, wp.vec2), WIDTH, HEIGHT, False], wp.vec3, 500)[:, 0]
    assert found.min() >= 0.25 and found.max() <= 1.0
    apart = (places[:, 0] <= 7.5) | (places[:, 0] >= 8.5)
    assert (found[apart] == np.where(places[apart, 0] < 8, 0.25, 1.0)).all()


@pytest.mark.parametrize("orthographic", [0, 1])
def test_plane_offset_needs_no_positions(orthographic):
    """Find the same distance from a pixel's plane as from positions in space, for any camera."""
    rng = np.random.default_rng(3)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    row = np.zeros(1, View.numpy_dtype())
    camera = row["camera"]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation * 1.3, (1.0, -2.0, 0.5)
    camera["camera_to_world"], camera["world_to_camera"] = matrix, np.linalg.inv(matrix)
    camera["window"], camera["orthographic"] = (-0.6, 0.4, -0.2, 0.5), orthographic
    camera["width"], camera["height"], camera["crop_x"], camera["crop_y"] = 40, 30, 7, 5
    camera["spread" if not orthographic else "pixel_size"] = 0.02
    row["jitter"] = (0.3, -0.4)
    normals = rng.normal(size=(COUNT, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    gbuffer = GBuffer()
    gbuffer.depth = wp.array(rng.uniform(1.0, 9.0, COUNT), dtype=float, device=DEVICE)
    packed = run(pack_normals, [vectors(normals)], wp.uint32, COUNT)
    gbuffer.normal = gbuffer.geometric_normal = wp.array(packed, dtype=wp.uint32, device=DEVICE)
    views = wp.array(row, dtype=View, device=DEVICE)
    for centre in (0, 37, COUNT - 1):
        found = run(compare_offsets, [views, gbuffer, WIDTH, centre], wp.vec2, COUNT)
        assert found[:, 0] == pytest.approx(found[:, 1], rel=1e-3, abs=1e-2)
        assert found[:, 1].max() > 1.0


def test_noise_weight_is_mutual():
    """Weigh two pixels the same from either side: 1 for equal light, falling with the difference over the errors."""
    rng = np.random.default_rng(4)
    p, q = rng.lognormal(size=(2, 1000, 4)).astype(np.float32)
    found = run(weigh_noise, [vectors(p, wp.vec4), vectors(q, wp.vec4)], wp.vec2, 1000)
    assert found[:, 0] == pytest.approx(found[:, 1], rel=1e-6)
    assert found.min() >= 0.0 and found.max() <= 1.0
    certain, unsure = np.full((2, 4), 1.0), np.full((2, 4), 1.0)
    certain[:, 3] = 0.0
    unsure[:, :3], unsure[:, 3] = 1.5, (0.0, 0.5)
    found = run(weigh_noise, [vectors(certain, wp.vec4), vectors(unsure, wp.vec4)], wp.vec2, 2)[:, 0]
    assert found[0] < 1e-9 and found[1] > 0.7


def test_normals_apart_have_no_weight():
    """Give the same normal weight 1, and one 60 degrees off exactly none in smooth light, 1e-9 in direct light."""
    normals = [[0.0, 0.0, 1.0], [0.0, 0.75**0.5, 0.5], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
    packed = wp.array(run(pack_normals, [vectors(normals)], wp.uint32, 4), dtype=wp.uint32, device=DEVICE)
    found = run(weigh_normals, [packed], wp.vec2, 4)
    assert found[0].tolist() == [1.0, 1.0]
    assert found[1:].max() < 1e-9 and (found[2:, 0] == 0.0).all()


def test_mirrors_take_no_highlights_from_their_frames():
    """Weigh roughness the same from either side: 1 for the same, whatever flags say; none for a mirror in wood."""
    rough = np.array([0.0, 0.387, 0.387, 0.3])
    other = np.array([0.387, 0.387, 0.45, 0.9])
    words = [wp.array((np.round(r * 65535).astype(np.uint32) | flags), dtype=wp.uint32, device=DEVICE)
             for r, flags in ((rough, np.uint32(1 << 20)), (other, np.uint32(0)))]
    found = run(weigh_roughness, words, wp.vec2, 4)
    assert (found[:, 0] == found[:, 1]).all()
    assert found[0, 0] == 0.0 and found[1, 0] == 1.0 and 0.5 < found[2, 0] < 1.0 and found[3, 0] == 0.0


def test_normals_are_decoded_the_short_way():
    """Find the normal and the squared cosine that unpack_normal gives, for normals of all directions."""
    rng = np.random.default_rng(5)
    normals = rng.normal(size=(2000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    packed = wp.array(run(pack_normals, [vectors(normals)], wp.uint32, 2000), dtype=wp.uint32, device=DEVICE)
    assert run(decode_normals, [packed, wp.vec3(0.48, -0.6, 0.64)], wp.vec2, 2000).max() < 1e-6


def test_words_hold_half_floats():
    """Pack four numbers to the bits of a vec4h and back, too large ones clamped."""
    rng = np.random.default_rng(6)
    values = rng.normal(size=(500, 4)).astype(np.float16).astype(np.float32)
    values[0] = (0.0, -1.0, 1e9, -1e9)
    words = run(pack_four, [vectors(values, wp.vec4)], wp.uint64, 500)
    expected = np.clip(values, -65000.0, 65000.0).astype(np.float16)
    assert (words.view(np.uint16).reshape(-1, 4) == expected.view(np.uint16)).all()
    found = run(unpack_four, [wp.array(words, dtype=wp.uint64, device=DEVICE)], wp.vec4, 500)
    assert (found == expected.astype(np.float32)).all()


def test_history_grows_at_rest_only():
    """Hold the cap in motion, let it grow by one a frame at rest up to 1024, and cut it after an edit of the light."""
    rest = wp.array([0, 1, 100, 5000], dtype=int, device=DEVICE)
    assert run(cap_lengths, [rest, 1000, 32.0], float, 4).tolist() == [32.0, 33.0, 132.0, 1024.0]
    assert run(cap_lengths, [rest, 11, 32.0], float, 4).tolist() == [2.0] * 4
    assert run(cap_lengths, [rest, 0, 1.0], float, 4).tolist() == [1.0, 2.0, 2.0, 2.0]
