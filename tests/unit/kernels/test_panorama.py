# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoramic mappings: known directions, unit lengths, and the way back to the film."""

import math

import numpy as np
import pytest
import warp as wp
from burnish.engine.errors import InvalidScene
from burnish.engine.frame_data import frame_row
from burnish.engine.scene import CameraData, CameraKind
from burnish.kernels import panorama
from burnish.kernels.types import FrameData

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False})

WIDTH, HEIGHT = 64, 32
HALF = 0.5 * math.pi
WINDOWS = {
    "equirectangular": (CameraKind.EQUIRECTANGULAR, (-math.pi, math.pi, -HALF, HALF), {}),
    "part": (CameraKind.EQUIRECTANGULAR, (-0.5, 1.5, 0.2, 1.1), {}),
    "cube face": (CameraKind.CUBE_FACE, (-0.5 * HALF, 0.5 * HALF, -0.5 * HALF, 0.5 * HALF), {}),
    "mirror ball": (CameraKind.MIRROR_BALL, (-1.0, 1.0, -1.0, 1.0), {}),
    "equidistant": (CameraKind.FISHEYE_EQUIDISTANT, (-1.5, 1.5, -1.5, 1.5), {"fov": 3.0}),
    "equisolid": (CameraKind.FISHEYE_EQUISOLID, (-1.2, 1.2, -0.6, 0.6), {"fov": 5.0}),
    "polynomial": (CameraKind.FISHEYE_POLYNOMIAL, (-18.0, 18.0, -9.0, 9.0),
                   {"fov": 2.5, "polynomial": (-0.001, -0.1, 1e-4, -2e-5, 1e-7)}),
    "cylinder": (CameraKind.CYLINDER, (-2.0, 2.5, -0.8, 1.2), {}),
}
ROUND = ("mirror ball", "equidistant", "equisolid", "polynomial")


@wp.kernel
def shoot(frames: wp.array[FrameData], places: wp.array[wp.vec2], lenses: wp.array[wp.vec2],
          origins_out: wp.array[wp.vec3], directions_out: wp.array[wp.vec4], films_out: wp.array[wp.vec2]):
    i = wp.tid()
    frame = frames[0]
    ray = panorama.film_ray(frame, places[i], lenses[i])
    d = ray.direction
    origins_out[i] = ray.origin
    directions_out[i] = wp.vec4(d[0], d[1], d[2], ray.t_max)
    films_out[i] = panorama.panorama_film(frame, ray.origin + d * 3.0)


def rays(camera, places, lenses=None, size=(WIDTH, HEIGHT)):
    """Return origins, directions with t_max, and where the film shows what these rays meet."""
    row = frame_row(camera, *size, (0, 0, *size), 0, np.zeros(3))
    places = np.asarray(places, np.float32).reshape(-1, 2)
    lenses = np.zeros_like(places) if lenses is None else np.asarray(lenses, np.float32)
    outs = [wp.zeros(len(places), dtype=dtype, device=DEVICE) for dtype in (wp.vec3, wp.vec4, wp.vec2)]
    wp.launch(shoot, len(places), [
        wp.array(row, dtype=FrameData, device=DEVICE), wp.array(places, dtype=wp.vec2, device=DEVICE),
        wp.array(lenses, dtype=wp.vec2, device=DEVICE), *outs], device=DEVICE)
    return [out.numpy() for out in outs]


def camera(name, **fields):
    """Return one of WINDOWS' cameras, at the origin and looking along -z."""
    kind, window, own = WINDOWS[name]
    return CameraData(kind=kind, window=window, **{"clip_start": 0.0, "clip_end": 100.0, **own, **fields})


def pixel_centers():
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return np.stack([x.ravel(), y.ravel()], 1)


@pytest.mark.parametrize("name", WINDOWS)
def test_directions(name):
    """Send unit directions through all pixels that show something, and find the way back to each of them."""
    places = pixel_centers()
    _, found, films = rays(camera(name), places)
    seen = found[:, 3] >= 0.0
    assert seen.any() and seen.all() == (name not in ROUND)
    assert np.abs(np.linalg.norm(found[seen, :3], axis=1) - 1.0).max() < 1e-5
    # Rounding of angles in single precision, most near the rim of a mirror ball.
    assert np.abs(films[seen] - places[seen]).max() < 5e-3


@pytest.mark.parametrize("name", ["equirectangular", "cube face", "mirror ball", "equidistant", "equisolid"])
def test_center_looks_forward(name):
    """Look along -z in the middle, with +x on the right of it and +y above."""
    x, y = WIDTH / 2, HEIGHT / 2
    _, found, _ = rays(camera(name), [(x, y), (x + 4, y), (x, y + 4)])
    assert found[0, :3] == pytest.approx([0.0, 0.0, -1.0], abs=1e-6)
    assert found[1, 0] > 0.05 and abs(found[1, 1]) < 1e-6
    assert found[2, 1] > 0.05 and abs(found[2, 0]) < 1e-6


def test_known_places():
    """Show what the definitions of the projections say at places where that is simple."""
    _, found, _ = rays(camera("equirectangular"), [(48.0, 16.0), (32.0, 32.0), (64.0, 16.0)])
    assert found[:, :3] == pytest.approx(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]]), abs=1e-6)
    # A cube's face spans 90 degrees.
    _, found, _ = rays(camera("cube face"), [(64.0, 16.0), (32.0, 32.0)])
    assert found[:, :3] == pytest.approx(np.array([[1, 0, -1], [0, 1, -1]]) / math.sqrt(2.0), abs=1e-6)
    # A mirror ball's rim shows what is behind; between, the normal halves the angle.
    _, found, _ = rays(camera("mirror ball"), [(32.0 + 32.0 * math.sqrt(0.5), 16.0), (63.9999, 16.0)])
    assert found[:, :3] == pytest.approx(np.array([[1, 0, 0], [0, 0, 1]]), abs=6e-3)
    # An equidistant fisheye's radius is the angle, an equisolid one's the sine of its half.
    _, found, _ = rays(camera("equidistant"), [(32.0 + 32.0 * 1.0 / 1.5, 16.0)])
    assert found[0, :3] == pytest.approx([math.sin(1.0), 0.0, -math.cos(1.0)], abs=1e-5)
    _, found, _ = rays(camera("equisolid"), [(32.0 + 32.0 * math.sin(0.5) / 1.2, 16.0)])
    assert found[0, :3] == pytest.approx([math.sin(1.0), 0.0, -math.cos(1.0)], abs=1e-5)
    _, found, _ = rays(camera("cylinder"), [((1.0 + 2.0) / 4.5 * 64, (0.5 + 0.8) / 2.0 * 32)])
    assert found[0, :3] == pytest.approx(
        np.array([math.sin(1.0), 0.5, -math.cos(1.0)]) / math.sqrt(1.25), abs=1e-5)


@pytest.mark.parametrize("name", ["equidistant", "equisolid", "polynomial"])
def test_fisheyes_end_at_their_field_of_view(name):
    """Show nothing beyond half the field of view, and something nearly up to it."""
    _, found, _ = rays(camera(name, fov=1.4), pixel_centers())
    seen = found[:, 3] >= 0.0
    angles = np.arccos(np.clip(-found[seen, 2], -1.0, 1.0))
    assert angles.max() <= 0.7 + 1e-5 and angles.max() > 0.6 and not seen[0]


@pytest.mark.parametrize("name", ["equirectangular", "mirror ball"])
def test_lens(name):
    """Let all rays of a place meet at the focus distance from the camera, and start at right angles to the middle's."""
    random = np.random.default_rng(3)
    places = np.repeat([(20.5, 11.0)], 64, 0)
    sharp, found, _ = rays(camera(name), places[:1])
    assert np.abs(sharp).max() == 0.0
    middle = found[0, :3]
    origins, found, _ = rays(camera(name, aperture_radius=0.2, focus_distance=2.5), places, random.random((64, 2)))
    assert np.abs(origins @ middle).max() < 1e-6
    lengths = np.linalg.norm(origins, axis=1)
    assert 0.15 < lengths.max() < 0.2 + 1e-6
    distance = np.linalg.norm(2.5 * middle - origins, axis=1)
    assert origins + found[:, :3] * distance[:, None] == pytest.approx(np.repeat([2.5 * middle], 64, 0), abs=1e-5)


def test_clipping_is_by_distance():
    """Begin and end all rays at the same distances."""
    origins, found, _ = rays(camera("equirectangular", clip_start=0.5, clip_end=7.0), pixel_centers())
    assert np.linalg.norm(origins, axis=1) == pytest.approx(np.full(len(origins), 0.5), abs=1e-6)
    assert found[:, 3] == pytest.approx(np.full(len(found), 6.5))


@pytest.mark.parametrize(("fields", "words"), [
    ({"kind": CameraKind.FISHEYE_EQUIDISTANT, "fov": 0.0}, "field of view"),
    ({"kind": CameraKind.FISHEYE_EQUISOLID, "fov": math.nan}, "field of view"),
    ({"kind": CameraKind.EQUIRECTANGULAR, "window": (1.0, 1.0, 0.0, 1.0)}, "covers nothing"),
    ({"kind": CameraKind.FISHEYE_POLYNOMIAL}, "one direction"),
    ({"kind": CameraKind.CYLINDER, "window": (math.inf, 1.0, 0.0, 1.0)}, "not finite"),
])
def test_nonsense_is_refused(fields, words):
    """Name what can't be drawn."""
    with pytest.raises(InvalidScene, match=words):
        rays(CameraData(**fields), [(0.0, 0.0)])


@pytest.mark.parametrize("fields", [
    {"kind": CameraKind.FISHEYE_POLYNOMIAL, "polynomial": (1e30, 1e30, -1e30, 1e38, -1e300),
     "window": (-1e9, 1e9, -1.0, 1.0)},
    {"kind": CameraKind.FISHEYE_POLYNOMIAL, "polynomial": (0.0, -1e-30, 0.0, 0.0, 0.0), "window": (-1, 1, -1, 1)},
    {"kind": CameraKind.EQUIRECTANGULAR, "window": (-1e30, 1e30, 3.0, -3.0)},
    {"kind": CameraKind.CYLINDER, "window": (1.0, -1.0, -1e15, 1e15)},
    {"kind": CameraKind.FISHEYE_EQUISOLID, "window": (-1e6, 1e6, -1e-6, 1e-6), "fov": 31.4},
])
def test_extreme_numbers(fields):
    """Send only unit directions, or none, whatever a camera's numbers are."""
    origins, found, _ = rays(CameraData(**{"window": (-1.0, 1.0, -1.0, 1.0), **fields}), pixel_centers())
    seen = found[:, 3] >= 0.0
    assert np.isfinite(origins).all() and np.isfinite(found).all()
    assert (~seen | (np.abs(np.linalg.norm(found[:, :3], axis=1) - 1.0) < 1e-5)).all()


@pytest.mark.parametrize("name", WINDOWS)
def test_spread_is_the_angle_between_pixels(name):
    """Tell textures the angle between neighbouring pixels, within a factor of two in the middle."""
    made = camera(name)
    spread = frame_row(made, WIDTH, HEIGHT, (0, 0, WIDTH, HEIGHT), 0, np.zeros(3))["spread"][0]
    middle = np.array([WIDTH / 2, HEIGHT / 2])
    _, found, _ = rays(made, [middle, middle + (1, 0), middle + (0, 1)])
    angles = np.arccos(np.clip(found[1:, :3] @ found[0, :3], -1.0, 1.0))
    assert 0.5 < spread / angles.mean() < 2.0
