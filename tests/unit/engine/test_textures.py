# SPDX-License-Identifier: GPL-3.0-or-later
"""engine/textures.py and what it is made of: reading, formats, mip levels, budget, and what the report says."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from burnish.engine.device import load_module, start_warp
from burnish.engine.image_files import ImageUnreadable, can_read_bytes, read_bytes, read_file
from burnish.engine.image_loading import ImageLoading
from burnish.engine.mip_levels import can_halve, can_widen
from burnish.engine.report import Report, ReportKind
from burnish.engine.scene import AlphaMode, ColorEncoding, ImageData
from burnish.engine.settings import PerformanceSettings
from burnish.engine.texels import average, expand_channels, linear_to_srgb, make_texels, srgb_to_linear
from burnish.engine.texture_budget import TextureSize, fit
from burnish.engine.textures import TextureStore
from burnish.kernels import mip_levels as mip_kernels
from burnish.kernels.texture import ALPHA_ASSOCIATED, ALPHA_STRAIGHT, ALPHA_UNRELATED, TEXELS_FLOAT, TEXELS_HALF

LINEAR = {"encoding": ColorEncoding.LINEAR, "source_colorspace": "Linear Rec.709"}
DATA = {"encoding": ColorEncoding.LINEAR, "source_colorspace": "Non-Color"}


def write(path: Path, pixels: np.ndarray, *, straight: bool = True) -> str:
    """Write an image file as its extension asks."""
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, pixels.dtype.name.replace("float16", "half"))
    if straight:
        spec.attribute("oiio:UnassociatedAlpha", 1)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(np.ascontiguousarray(pixels)), output.geterror()
    output.close()
    return str(path)


def random_pixels(dtype: str, height: int = 9, width: int = 14, channels: int = 4) -> np.ndarray:
    """Return random pixels over the type's whole range (floats 0..1)."""
    values = np.random.default_rng(3).random((height, width, channels))
    return np.rint(values * np.iinfo(dtype).max).astype(dtype) if dtype.startswith("u") else values.astype(dtype)


@pytest.fixture
def image_kernels() -> None:
    """Have the kernels for images built, without which NumPy does their work."""
    start_warp()
    assert load_module(mip_kernels.__name__, "cpu")


@pytest.mark.usefixtures("image_kernels")
@pytest.mark.parametrize("srgb", [True, False])
@pytest.mark.parametrize("halvings", [0, 1, 3, 6])
@pytest.mark.parametrize("shape", [(64, 96), (128, 32), (33, 64), (34, 2), (12, 80), (64, 64)])
def test_kernels_halve_as_numpy_does(
    monkeypatch: pytest.MonkeyPatch, srgb: bool, shape: tuple[int, int], halvings: int,
) -> None:
    """Make the same bytes of every level, whether a kernel or NumPy averages it."""
    pixels = random_pixels("uint8", *shape)
    monkeypatch.setattr("burnish.engine.mip_levels.FEWEST", 1)
    assert can_halve(pixels) == (shape[0] % 2 == 0)
    by_kernel = make_texels(pixels, srgb=srgb, alpha=ALPHA_UNRELATED, halvings=halvings)
    monkeypatch.setattr("burnish.engine.texels.can_halve", lambda values: False)
    by_numpy = make_texels(pixels, srgb=srgb, alpha=ALPHA_UNRELATED, halvings=halvings)
    assert len(by_kernel.levels) == len(by_numpy.levels) > 0
    for ours, theirs in zip(by_kernel.levels, by_numpy.levels, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.usefixtures("image_kernels")
def test_kernels_widen_as_numpy_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add the same alpha to three channels, whether a kernel or NumPy does."""
    pixels = random_pixels("uint8", 33, 40, 3)
    assert can_widen(pixels)
    by_kernel = expand_channels(pixels)
    monkeypatch.setattr("burnish.engine.texels.can_widen", lambda values: False)
    np.testing.assert_array_equal(by_kernel, expand_channels(pixels))
    assert by_kernel.shape == (33, 40, 4) and (by_kernel[..., 3] == 255).all()


def test_images_read_ahead_are_those_read_at_once(tmp_path: Path, device: str) -> None:
    """Give the same textures where some images are on their way before the scene is whole; changed ones anew."""
    images = {name: ImageData(name=name, path=write(tmp_path / f"{name}.png", random_pixels("uint8", 8 + i, 16)))
              for i, name in enumerate("abc")}
    images["lost"] = ImageData(name="lost", path=str(tmp_path / "nothing.png"))
    settings, reports = PerformanceSettings(), (Report(), Report())
    plain, ahead = TextureStore(device), TextureStore(device)
    plain.update(images, settings, reports[0])
    other = ImageData(name="b", path=images["a"].path)
    loading = ImageLoading({"a": lambda: images["a"], "b": lambda: other, "lost": lambda: images["lost"]}, settings)
    ahead.update(images, settings, reports[1], loading)
    assert reports[0].counts == reports[1].counts and len(reports[0].counts) == 1
    for name in "abc":
        for level in (0, 1):
            np.testing.assert_array_equal(ahead.level(name, level), plain.level(name, level))


def test_images_read_ahead_keep_to_the_budget(device: str) -> None:
    """Halve images that were read whole, once others turn out to need the room too."""
    images = {name: ImageData(name=name, pixels=random_pixels("uint8", 256, 512)) for name in "abcd"}
    settings = PerformanceSettings(texture_budget=1)
    plain, ahead = TextureStore(device), TextureStore(device)
    plain.update(images, settings, Report())
    ahead.update(images, settings, Report(), ImageLoading({"a": lambda: images["a"]}, settings))
    sizes = [[store.level(name).shape for name in images] for store in (plain, ahead)]
    assert sizes[0] == sizes[1] and ahead.bytes == plain.bytes <= 1 << 20
    np.testing.assert_array_equal(ahead.level("a"), plain.level("a"))


def test_images_that_nobody_takes_end(device: str) -> None:
    """Read no more once stopped."""
    begun: list[str] = []

    def slow(name: str) -> ImageData:
        begun.append(name)
        time.sleep(0.05)
        return ImageData(name=name, pixels=random_pixels("uint8"))

    loading = ImageLoading({name: lambda name=name: slow(name) for name in "ab"}, PerformanceSettings())
    loading.stop()
    time.sleep(0.3)
    assert len(begun) <= 2 and not any("burnish images" in thread.name for thread in threading.enumerate())


def load(image: ImageData, device: str, **settings: int) -> tuple[TextureStore, Report]:
    """Return a store that holds one image under the key "a"."""
    store, report = TextureStore(device), Report()
    store.update({"a": image}, PerformanceSettings(**settings), report)
    return store, report


def info(store: TextureStore, key: str = "a") -> dict[str, int]:
    """Return an image's row in the table that kernels read."""
    row = store.struct().infos.numpy()[store.index(key)]
    return {name: int(row[name]) for name in row.dtype.names}


@pytest.mark.parametrize(("name", "dtype"), [
    ("x.png", "uint8"), ("x.png", "uint16"), ("x.tif", "uint8"), ("x.tga", "uint8"), ("x.exr", "float16"),
    ("x.tif", "uint16"),
])
def test_level_zero_is_the_file(tmp_path: Path, device: str, name: str, dtype: str) -> None:
    """Keep integers and halves bit for bit, straight alpha too."""
    pixels = random_pixels(dtype)
    store, report = load(ImageData(name="x", path=write(tmp_path / name, pixels)), device)
    np.testing.assert_array_equal(store.level("a"), pixels)
    assert not report.entries()
    alpha = ALPHA_ASSOCIATED if name == "x.exr" else ALPHA_STRAIGHT
    assert (info(store)["alpha"], info(store)["srgb"], info(store)["levels"]) == (alpha, 1, 4)


def test_floats_become_halves_where_nothing_is_lost(device: str) -> None:
    """Store float colours as halves, but data and what exceeds the half range as floats."""
    pixels = random_pixels("float32")
    bright = pixels * 1e6
    for image, expected, form in (
            (ImageData(name="c", pixels=pixels, **LINEAR), pixels.astype(np.float16), TEXELS_HALF),
            (ImageData(name="d", pixels=pixels, **DATA), pixels, TEXELS_FLOAT),
            (ImageData(name="b", pixels=bright, **LINEAR), bright, TEXELS_FLOAT)):
        store, _ = load(image, device)
        np.testing.assert_array_equal(store.level("a"), expected)
        assert info(store)["format"] == form
        assert store.bytes == (9 * 14 + 4 * 7 + 2 * 3 + 1) * (8 if form == TEXELS_HALF else 16)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_channels_are_expanded(channels: int, dtype: str) -> None:
    """Repeat grey, take a second channel as alpha, and fill absent alpha with 1."""
    pixels, one = random_pixels(dtype, channels=channels), 255 if dtype == "uint8" else 1.0
    rgba = expand_channels(pixels)
    gray = channels < 3
    np.testing.assert_array_equal(rgba[..., :3], np.repeat(pixels[..., :1], 3, 2) if gray else pixels[..., :3])
    alpha = pixels[..., -1] if channels in (2, 4) else np.full((9, 14), one)
    np.testing.assert_array_equal(rgba[..., 3], alpha)
    two = expand_channels(random_pixels(dtype, channels=2), gray_alpha=False)
    np.testing.assert_array_equal(two[..., 1], random_pixels(dtype, channels=2)[..., 1])
    assert (two[..., 2] == 0).all() and (two[..., 3] == one).all()


def test_gray_png_is_opaque_gray(tmp_path: Path, device: str) -> None:
    """Read a single-channel file as opaque grey."""
    pixels = random_pixels("uint8", channels=1)
    store, _ = load(ImageData(name="x", path=write(tmp_path / "g.png", pixels)), device)
    np.testing.assert_array_equal(store.level("a"), expand_channels(pixels))
    assert info(store)["alpha"] == ALPHA_UNRELATED


@pytest.mark.parametrize(("mode", "space", "alpha", "opaque"), [
    (AlphaMode.STRAIGHT, "sRGB", ALPHA_STRAIGHT, False),
    (AlphaMode.PREMUL, "sRGB", ALPHA_ASSOCIATED, False),
    (AlphaMode.CHANNEL_PACKED, "sRGB", ALPHA_UNRELATED, False),
    (AlphaMode.NONE, "sRGB", ALPHA_UNRELATED, True),
    (AlphaMode.STRAIGHT, "Non-Color", ALPHA_UNRELATED, False),
])
def test_alpha_modes(device: str, mode: AlphaMode, space: str, alpha: int, opaque: bool) -> None:
    """Tell colour that alpha covers from channels that are none of its business."""
    pixels = random_pixels("uint8")
    store, _ = load(ImageData(name="x", pixels=pixels, alpha_mode=mode, source_colorspace=space), device)
    assert info(store)["alpha"] == alpha
    assert (store.level("a")[..., 3] == 255).all() == opaque
    np.testing.assert_array_equal(store.level("a")[..., :3], pixels[..., :3])


def test_files_say_whether_they_are_premultiplied(tmp_path: Path, device: str) -> None:
    """Believe the file, not Image.alpha_mode, as Cycles does; opaque images need no weighting."""
    pixels = random_pixels("uint8")
    path = write(tmp_path / "x.tif", pixels, straight=False)
    store, _ = load(ImageData(name="x", path=path, alpha_mode=AlphaMode.STRAIGHT), device)
    assert info(store)["alpha"] == ALPHA_ASSOCIATED
    pixels[..., 3] = 255
    store, _ = load(ImageData(name="x", path=write(tmp_path / "o.png", pixels)), device)
    assert info(store)["alpha"] == ALPHA_UNRELATED


def area_average(values: np.ndarray) -> np.ndarray:
    """Halve [H, W, C] by exact area, written the slow way."""
    for _ in range(2):
        old, new = values.shape[0], max(values.shape[0] // 2, 1)
        edges = np.arange(new + 1) * old / new
        weights = np.array([[max(0.0, min(edges[i + 1], j + 1) - max(edges[i], j)) for j in range(old)]
                            for i in range(new)])
        values = (weights @ values.reshape(old, -1) * new / old).reshape(new, *values.shape[1:]).swapaxes(0, 1)
    return values


@pytest.mark.parametrize("shape", [(8, 8), (7, 9), (1, 5), (6, 3), (2, 1)])
def test_average_covers_the_area(shape: tuple[int, int]) -> None:
    """Average exactly the area that a texel covers, also for odd sizes, and so keep the mean."""
    values = random_pixels("float32", *shape)
    np.testing.assert_allclose(average(values), area_average(values.astype(np.float64)), atol=1e-6)
    np.testing.assert_allclose(average(values).mean(axis=(0, 1)), values.mean(axis=(0, 1)), atol=1e-6)
    words = random_pixels("uint16", *shape)
    assert np.abs(average(words).astype(float) - area_average(words.astype(np.float64))).max() <= 0.5 + 1e-2


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16"])
@pytest.mark.parametrize("shape", [(16, 16), (13, 6), (300, 20)])
def test_levels_average_linear_light(dtype: str, shape: tuple[int, int]) -> None:
    """Average sRGB colours in linear light and encode them again, within a rounding step for each level."""
    image = random_pixels(dtype, *shape)
    texels = make_texels(image, srgb=True, alpha=ALPHA_UNRELATED)
    scale = np.iinfo(dtype).max if dtype.startswith("u") else 1.0
    linear = image.astype(np.float64) / scale
    linear[..., :3] = srgb_to_linear(linear[..., :3])
    for level in texels.levels[1:]:
        linear = area_average(linear)
        expected = linear.copy()
        expected[..., :3] = linear_to_srgb(linear[..., :3])
        assert level.dtype == image.dtype and level.shape == linear.shape
        tolerance = {"uint8": 0.51 / 255, "uint16": 3e-5, "float16": 6e-4}[dtype]
        np.testing.assert_allclose(level / scale, expected, atol=tolerance)
    assert texels.levels[-1].shape == (1, 1, 4)


def test_hidden_colours_do_not_bleed() -> None:
    """Weight straight colours by alpha in mip levels; keep colour where all is clear."""
    image = np.zeros((4, 4, 4), np.uint8)
    image[:, :2] = (255, 0, 0, 255)
    image[:, 2:] = (0, 255, 0, 0)
    levels = make_texels(image, srgb=True, alpha=ALPHA_STRAIGHT).levels
    np.testing.assert_array_equal(levels[1][0], [[255, 0, 0, 255], [0, 255, 0, 0]])
    assert levels[2][0, 0, 0] == 255 and levels[2][0, 0, 1] <= 4 and levels[2][0, 0, 3] == 128


def test_bad_texels_are_cleaned(device: str) -> None:
    """Set texels with NaN or infinity to 0 and count them in the report."""
    pixels = random_pixels("float32")
    pixels[1, 2, 0], pixels[3, 4, 1], pixels[3, 4, 2] = np.nan, np.inf, -np.inf
    store, report = load(ImageData(name="hot", pixels=pixels, **LINEAR), device)
    assert (store.level("a")[[1, 3], [2, 4]] == 0).all() and np.isfinite(store.level("a", 2)).all()
    entry = report.entries()[0]
    assert (entry.owner, entry.count) == ("image 'hot'", 2)


def test_unreadable_images_are_magenta(tmp_path: Path, device: str) -> None:
    """Draw absent, empty, cut and foreign files magenta and name each in the report."""
    whole = Path(write(tmp_path / "whole.png", random_pixels("uint8", 64, 64))).read_bytes()
    files = {"empty.png": b"", "cut.png": whole[:200], "text.png": b"no picture\n" * 20, "cut.exr": b"\x76/1\x01"}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    images = {name: ImageData(name=name, path=str(tmp_path / name)) for name in [*files, "absent.png"]}
    images |= {"folder": ImageData(name="folder", path=str(tmp_path)), "none": ImageData(name="none"),
               "told": ImageData(name="told", path="//x.png", missing=True),
               "flat": ImageData(name="flat", pixels=np.zeros((0, 4, 4), np.uint8))}
    store, report = TextureStore(device), Report()
    store.update(images, PerformanceSettings(), report)
    for key in images:
        np.testing.assert_array_equal(store.level(key), [[[255, 0, 255, 255]]])
        assert info(store, key)["srgb"] == 0
    entries = {entry.owner: entry for entry in report.entries()}
    assert set(entries) == {f"image '{name}'" for name in images}
    assert {entry.kind for entry in entries.values()} == {ReportKind.MISSING}


def test_budget_halves_the_largest(tmp_path: Path, device: str) -> None:
    """Halve the largest images until all fit, sent before or now, and name them."""
    pixels = np.full((1024, 2048, 4), 90, np.uint8)
    pixels[..., 3] = 255
    store, report = TextureStore(device), Report()
    store.update({"old": ImageData(name="old", pixels=pixels), "small": ImageData(name="s", pixels=pixels[:64, :64])},
                 PerformanceSettings(texture_budget=16), report)
    assert not report.entries() and info(store, "old")["width"] == 2048
    path = write(tmp_path / "new.png", pixels)
    store.update({"new": ImageData(name="new", path=path)}, PerformanceSettings(texture_budget=16), report)
    shapes = {key: store.level(key).shape[:2] for key in ("old", "new", "small")}
    assert shapes["small"] == (64, 64) and sorted(shapes.values()) == [(64, 64), (512, 1024), (1024, 2048)]
    halved = "old" if shapes["old"] == (512, 1024) else "new"
    assert [entry.owner for entry in report.entries()] == [f"image '{halved}'"]
    assert "2048 x 1024 to 1024 x 512" in report.text() and store.bytes <= 16 << 20
    assert (store.level("old") == pixels[0, 0]).all() and (store.level("new") == pixels[0, 0]).all()


def test_size_limit(device: str) -> None:
    """Halve images until their longest side keeps the limit."""
    pixels = random_pixels("uint8", 100, 30)
    store, report = load(ImageData(name="x", pixels=pixels), device, texture_size_limit=50)
    assert store.level("a").shape == (50, 15, 4) and "100" in report.text()


def test_fit_keeps_device_limits() -> None:
    """Keep sides and the number of texels of one format within what arrays can index."""
    sizes = [TextureSize(131072, 100, 4), *(TextureSize(40000, 40000, 4) for _ in range(2)), TextureSize(9, 9, 16)]
    fit(sizes, 1 << 60)
    assert max(sizes[0].shape()) <= 65536 and sizes[3].halvings == 0
    assert sum(size.texels() for size in sizes[:3]) < 1 << 31
    tiny = [TextureSize(1, 1, 4) for _ in range(3)]
    fit(tiny, 0)
    assert all(size.halvings == 0 for size in tiny)


def test_udim_draws_the_first_tile(tmp_path: Path, device: str) -> None:
    """Draw the first tile that exists of a UDIM path, and say so."""
    pixels = random_pixels("uint8", channels=3)
    write(tmp_path / "t [1].1012.png", pixels)
    write(tmp_path / "t [1].1013.png", pixels[::-1])
    store, report = load(ImageData(name="x", path=str(tmp_path / "t [1].<UDIM>.png")), device)
    np.testing.assert_array_equal(store.level("a")[..., :3], pixels)
    assert "1012" in report.text()


def test_indices_stay(device: str) -> None:
    """Keep each image's index and content while others come, change, grow and go."""
    rng = np.random.default_rng(0)
    store, report, expected = TextureStore(device), Report(), {}
    indices: dict[int, int] = {}
    for step in range(25):
        keys = rng.integers(0, 12, 3).tolist()
        if step % 4 == 3:
            store.remove(*keys, "never sent")
            for key in keys:
                expected.pop(key, None)
                indices.pop(key, None)
        else:
            new = {}
            for key in keys:
                dtype = ("uint8", "uint16", "float16", "float32")[rng.integers(4)]
                new[key] = (rng.random((*rng.integers(1, 9, 2), 4)) * 200).astype(dtype)
            images = {key: ImageData(name=str(key), pixels=value, **DATA) for key, value in new.items()}
            store.update(images, PerformanceSettings(), report)
            expected |= new
        for key, pixels in expected.items():
            assert indices.setdefault(key, store.index(key)) == store.index(key)
            np.testing.assert_array_equal(store.level(key), pixels)
    assert len(set(indices.values())) == len(indices) and store.index("never sent") == -1
    assert store.struct() is store.struct()
    store.clear()
    assert store.bytes == 0 and store.index(0) == -1


def test_update_in_place_keeps_the_arrays(device: str) -> None:
    """Replace an image by one of its size without moving the others."""
    images = {key: ImageData(name=key, pixels=random_pixels("uint8")) for key in "ab"}
    store, report = TextureStore(device), Report()
    store.update(images, PerformanceSettings(), report)
    before = store.struct().bytes4.ptr
    store.update({"b": ImageData(name="b", pixels=255 - random_pixels("uint8"))}, PerformanceSettings(), report)
    assert store.struct().bytes4.ptr == before
    np.testing.assert_array_equal(store.level("a"), random_pixels("uint8"))
    np.testing.assert_array_equal(store.level("b"), 255 - random_pixels("uint8"))


@pytest.mark.skipif(not can_read_bytes(), reason="needs an anonymous file (Linux)")
def test_bytes_read_as_files_do(tmp_path: Path) -> None:
    """Read files from memory as from disk, and refuse what is none."""
    for name, dtype in (("x.png", "uint8"), ("x.exr", "float16"), ("x.jpg", "uint8"), ("x.hdr", "float32")):
        path = write(tmp_path / name, random_pixels(dtype, channels=3))
        found, expected = read_bytes(Path(path).read_bytes()), read_file(path)
        np.testing.assert_array_equal(found.pixels, expected.pixels)
        assert found.pixels.dtype == dtype and (found.has_alpha, found.straight) == (False, False)
    for content in (b"", b"no picture"):
        with pytest.raises(ImageUnreadable):
            read_bytes(content)
