# SPDX-License-Identifier: GPL-3.0-or-later
"""kernels/texture.py against a plain NumPy lookup: wrapping, filtering, mip levels, alpha and decoding."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.texels import make_texels
from burnish.engine.texture_arrays import TextureArrays
from burnish.kernels import texture
from burnish.kernels.texture import (
    ALPHA_ASSOCIATED,
    ALPHA_STRAIGHT,
    ALPHA_UNRELATED,
    EXTENSION_CLIP,
    EXTENSION_EXTEND,
    EXTENSION_MIRROR,
    EXTENSION_REPEAT,
    INTERPOLATION_CLOSEST,
    INTERPOLATION_CUBIC,
    INTERPOLATION_LINEAR,
    SAMPLE_ASSOCIATED,
)
from burnish.kernels.types import Textures

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

HEIGHT, WIDTH = 3, 5
"""Odd and unequal, so that swapped axes and wrong halves show"""


@wp.kernel
def look_up(
    # In:
    textures: Textures, index: int, uv: wp.array[wp.vec2], width: wp.array[float], extension: int, interpolation: int,
    # Out:
    rgba_out: wp.array[wp.vec4],
):
    """Look all coordinates up."""
    i = wp.tid()
    rgba_out[i] = texture.sample_texture(textures, index, uv[i], width[i], extension, interpolation)


def sample(device: str, arrays: TextureArrays, uv: np.ndarray, *, width: float | np.ndarray = 0.0,
           extension: int = EXTENSION_REPEAT, interpolation: int = INTERPOLATION_LINEAR, index: int = 0) -> np.ndarray:
    """Return what the kernel looks up at uv [N, 2]."""
    uv = np.asarray(uv, np.float32).reshape(-1, 2)
    widths = np.broadcast_to(np.float32(width), len(uv)).copy()
    result = wp.zeros(len(uv), dtype=wp.vec4, device=device)
    inputs = [arrays.struct(), index, wp.array(uv, dtype=wp.vec2, device=device), wp.array(widths, device=device),
              extension, interpolation]
    wp.launch(look_up, len(uv), inputs=inputs, outputs=[result], device=device)
    return result.numpy()


def put(device: str, rgba: np.ndarray, *, srgb: bool = False, alpha: int = ALPHA_UNRELATED) -> TextureArrays:
    """Return device arrays that hold one image."""
    arrays = TextureArrays(device)
    # An image before it, so that offsets count.
    arrays.change({1: make_texels(np.zeros((2, 2, 4), rgba.dtype), srgb=False, alpha=ALPHA_UNRELATED, data=True)})
    arrays.change({0: make_texels(rgba, srgb=srgb, alpha=alpha, data=True)})
    return arrays


def random_image(dtype: str = "float32", height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Return an image of random values."""
    values = np.random.default_rng(7).random((height, width, 4), np.float32)
    return values if dtype.startswith("float") else np.rint(values * np.iinfo(dtype).max).astype(dtype)


def texel(image: np.ndarray, x: int, y: int, extension: int) -> np.ndarray:
    """Return the texel at any column x and row y, counted from the bottom."""
    height, width = image.shape[:2]
    if extension == EXTENSION_CLIP and not (0 <= x < width and 0 <= y < height):
        return np.zeros(4)
    if extension == EXTENSION_MIRROR:
        x, y = x % (2 * width), y % (2 * height)
        x, y = min(x, 2 * width - 1 - x), min(y, 2 * height - 1 - y)
    elif extension == EXTENSION_REPEAT:
        x, y = x % width, y % height
    x, y = min(max(x, 0), width - 1), min(max(y, 0), height - 1)
    return image[height - 1 - y, x].astype(np.float64)


def bilinear(image: np.ndarray, uv: np.ndarray, extension: int) -> np.ndarray:
    """Return the plain bilinear lookup at uv [N, 2] in double precision."""
    height, width = image.shape[:2]
    results = []
    for u, v in np.asarray(uv, np.float64).reshape(-1, 2):
        x, y = u * width - 0.5, v * height - 0.5
        x0, y0 = int(np.floor(x)), int(np.floor(y))
        fx, fy = x - x0, y - y0
        results.append(
            (1 - fy) * ((1 - fx) * texel(image, x0, y0, extension) + fx * texel(image, x0 + 1, y0, extension))
            + fy * ((1 - fx) * texel(image, x0, y0 + 1, extension) + fx * texel(image, x0 + 1, y0 + 1, extension)))
    return np.array(results)


def centres(height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Return uv of all texel centres, top row first."""
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([(x + 0.5) / width, 1.0 - (y + 0.5) / height], axis=-1).reshape(-1, 2)


EXTENSIONS = [EXTENSION_REPEAT, EXTENSION_EXTEND, EXTENSION_CLIP, EXTENSION_MIRROR]


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32"])
def test_texel_centres_return_texels(device: str, dtype: str) -> None:
    """Return each texel at its centre, in all formats, upper rows at larger v."""
    image = random_image("float32" if dtype == "float16" else dtype).astype(dtype)
    expected = image.astype(np.float64) / (np.iinfo(dtype).max if dtype.startswith("u") else 1.0)
    found = sample(device, put(device, image), centres())
    # The weight of the neighbours is not quite 0: (x + 0.5) / w * w rounds.
    np.testing.assert_allclose(found.reshape(image.shape), expected, atol=2e-6)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_bilinear_matches_reference(device: str, extension: int) -> None:
    """Match the plain lookup inside, across and far outside the borders."""
    image = random_image()
    uv = np.random.default_rng(1).uniform(-3.0, 4.0, (400, 2)).astype(np.float32)
    found = sample(device, put(device, image), uv, extension=extension)
    np.testing.assert_allclose(found, bilinear(image, uv, extension), atol=1e-5)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_borders_match_reference(device: str, extension: int) -> None:
    """Match the plain lookup exactly on and beside the borders, where indices wrap."""
    image = random_image()
    edges = np.float32([-1.0, 0.0, 0.5, 1.0, 2.0])
    line = np.concatenate([edges, np.nextafter(edges, np.float32(-9)), np.nextafter(edges, np.float32(9))])
    uv = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    found = sample(device, put(device, image), uv, extension=extension)
    np.testing.assert_allclose(found, bilinear(image, uv, extension), atol=1e-5)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_closest_matches_reference(device: str, extension: int) -> None:
    """Return the texel that holds the coordinate, at level 0 whatever the footprint."""
    image = random_image()
    uv = np.random.default_rng(2).uniform(-3.0, 4.0, (400, 2)).astype(np.float32)
    found = sample(device, put(device, image), uv, extension=extension, interpolation=INTERPOLATION_CLOSEST, width=1.0)
    x, y = np.floor(uv[:, 0] * WIDTH).astype(int), np.floor(uv[:, 1] * HEIGHT).astype(int)
    expected = np.array([texel(image, *at, extension) for at in zip(x, y, strict=True)])
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_cubic_is_linear(device: str) -> None:
    """Draw cubic interpolation as linear."""
    arrays, uv = put(device, random_image()), np.random.default_rng(3).random((50, 2))
    cubic = sample(device, arrays, uv, interpolation=INTERPOLATION_CUBIC)
    np.testing.assert_array_equal(cubic, sample(device, arrays, uv))


def test_single_texel_is_constant(device: str) -> None:
    """Return a 1 by 1 image's texel everywhere."""
    image = random_image(height=1, width=1)
    uv = np.random.default_rng(4).uniform(-2.0, 3.0, (100, 2))
    for extension in (EXTENSION_REPEAT, EXTENSION_EXTEND, EXTENSION_MIRROR):
        found = sample(device, put(device, image), uv, extension=extension, width=0.7)
        np.testing.assert_allclose(found, np.broadcast_to(image[0, 0], (100, 4)), atol=1e-6)


@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_width_chooses_level(device: str, level: int) -> None:
    """Read exactly the level whose texels are as wide as the footprint."""
    image = random_image(height=6, width=11)
    arrays = put(device, image)
    uv = np.random.default_rng(5).random((60, 2)).astype(np.float32)
    found = sample(device, arrays, uv, width=2.0**level / 11.0)
    expected = bilinear(arrays.level(0, level), uv, EXTENSION_REPEAT)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_nearest_level_is_read(device: str) -> None:
    """Read the level that is nearest to the footprint by its logarithm; the last one beyond it."""
    image = random_image(height=8, width=8)
    arrays, uv = put(device, image), np.random.default_rng(6).random((60, 2)).astype(np.float32)
    fine, coarse = (bilinear(arrays.level(0, level), uv, EXTENSION_REPEAT) for level in (1, 2))
    np.testing.assert_allclose(sample(device, arrays, uv, width=2.0**1.45 / 8.0), fine, atol=1e-5)
    np.testing.assert_allclose(sample(device, arrays, uv, width=2.0**1.55 / 8.0), coarse, atol=1e-5)
    mean = np.broadcast_to(image.mean(axis=(0, 1)), (60, 4))
    for width in (1.0, 50.0, np.inf):
        np.testing.assert_allclose(sample(device, arrays, uv, width=width), mean, atol=1e-5)
    np.testing.assert_array_equal(sample(device, arrays, uv, width=np.nan), sample(device, arrays, uv))
    np.testing.assert_array_equal(sample(device, arrays, uv, width=-1.0), sample(device, arrays, uv))


def decode(values: np.ndarray) -> np.ndarray:
    """Decode sRGB in double precision."""
    return np.where(values < 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def test_srgb_is_decoded_after_filtering(device: str) -> None:
    """Filter encoded values and decode the result; leave alpha alone."""
    image = random_image("uint8")
    uv = np.random.default_rng(8).random((200, 2)).astype(np.float32)
    found = sample(device, put(device, image, srgb=True), uv)
    encoded = bilinear(image / 255.0, uv, EXTENSION_REPEAT)
    np.testing.assert_allclose(found[:, :3], decode(encoded[:, :3]), atol=1e-5)
    np.testing.assert_allclose(found[:, 3], encoded[:, 3], atol=1e-6)


def test_straight_alpha_weights_colour(device: str) -> None:
    """Weight straight colour by alpha, so that what is hidden doesn't bleed; return it straight or associated."""
    image = random_image("uint8")
    image[0, :, 3] = 0
    uv = np.random.default_rng(9).random((200, 2)).astype(np.float32)
    arrays = put(device, image, srgb=True, alpha=ALPHA_STRAIGHT)
    values = image / 255.0
    values[..., :3] *= values[..., 3:]
    mixed = bilinear(values, uv, EXTENSION_REPEAT)
    seen = mixed[:, 3] > 1e-3
    found = sample(device, arrays, uv)
    np.testing.assert_allclose(found[seen, :3], decode(mixed[seen, :3] / mixed[seen, 3:]), atol=1e-4)
    np.testing.assert_allclose(found[:, 3], mixed[:, 3], atol=1e-6)
    found = sample(device, arrays, uv, interpolation=INTERPOLATION_LINEAR + SAMPLE_ASSOCIATED)
    np.testing.assert_allclose(found[:, :3], decode(mixed[:, :3]), atol=1e-5)


def test_associated_alpha_is_divided(device: str) -> None:
    """Return stored associated colour as it is or divided by alpha; leave it where alpha is 0."""
    image = random_image()
    image[..., :3] *= image[..., 3:]
    image[1, 2] = (0.5, 0.25, 2.0, 0.0)
    arrays = put(device, image, alpha=ALPHA_ASSOCIATED)
    found = sample(device, arrays, centres(), interpolation=INTERPOLATION_CLOSEST).reshape(image.shape)
    alpha = np.where(image[..., 3:] == 0.0, 1.0, image[..., 3:])
    np.testing.assert_allclose(found[..., :3], image[..., :3] / alpha, atol=1e-6)
    found = sample(device, arrays, centres(), interpolation=INTERPOLATION_CLOSEST + SAMPLE_ASSOCIATED)
    np.testing.assert_allclose(found.reshape(image.shape), image, atol=1e-7)


def test_bad_input_is_safe(device: str) -> None:
    """Answer magenta for absent textures and clear for coordinates that are not finite; survive huge ones."""
    arrays = put(device, random_image())
    arrays.change({}, removed=[1])
    arrays.change({3: make_texels(random_image(), srgb=False, alpha=ALPHA_UNRELATED, data=True)})
    for index in (-1, 1, 2, 4, 1 << 30):
        np.testing.assert_array_equal(sample(device, arrays, [[0.5, 0.5]], index=index), [[1, 0, 1, 1]])
    bad = [[np.nan, 0.5], [0.5, np.nan], [np.inf, 0.5], [0.5, -np.inf]]
    huge = [[1e30, 0.5], [-1e30, -1e30], [3e9, -3e9], [-1e-30, -1e-45]]
    for extension in EXTENSIONS:
        for interpolation in (INTERPOLATION_LINEAR, INTERPOLATION_CLOSEST):
            found = sample(device, arrays, bad, extension=extension, interpolation=interpolation, width=0.1)
            np.testing.assert_array_equal(found, np.zeros((4, 4)))
            found = sample(device, arrays, huge, extension=extension, interpolation=interpolation, width=0.1)
            assert np.isfinite(found).all() and found.max() <= 1.0


def test_far_coordinates_repeat(device: str) -> None:
    """Repeat and mirror far from the origin as near it."""
    arrays, uv = put(device, random_image()), np.random.default_rng(10).integers(0, 64, (100, 2)) / 64.0
    for extension in (EXTENSION_REPEAT, EXTENSION_MIRROR):
        near, far = (sample(device, arrays, uv + shift, extension=extension) for shift in (0.0, 4096.0))
        np.testing.assert_allclose(far, near, atol=1e-6)
