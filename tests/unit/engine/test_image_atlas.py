# SPDX-License-Identifier: GPL-3.0-or-later
"""engine/image_atlas.py: tiles joined into one picture are looked up as each of them alone would be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from burnish.engine.image_atlas import Atlas, find_range, lay_out_tiles, tile_table
from burnish.engine.report import Report
from burnish.engine.scene import AlphaMode, ColorEncoding, ImageData
from burnish.engine.settings import PerformanceSettings
from burnish.engine.textures import TextureStore

SIZES = [(64, 32), (8, 8), (300, 200), (1, 5), (300, 200)]
"""Widths and heights [px]"""


def tile(name: str, size: tuple[int, int], dtype: str = "uint8", channels: int = 4) -> ImageData:
    """Return a tile of noise."""
    values = np.random.default_rng(len(name)).random((size[1], size[0], channels)).astype(np.float32)
    pixels = np.rint(values * np.iinfo(dtype).max).astype(dtype) if dtype.startswith("u") else values.astype(dtype)
    return ImageData(name=name, pixels=pixels, encoding=ColorEncoding.LINEAR, source_colorspace="Non-Color",
                     alpha_mode=AlphaMode.CHANNEL_PACKED)


def store_of(atlas: Atlas, tiles: list[ImageData], device: str, **settings: int) -> tuple[TextureStore, Report]:
    """Put a picture of tiles on the device."""
    data = ImageData(name="x", atlas=replace(atlas, tiles=tuple(tiles)), encoding=ColorEncoding.LINEAR,
                     source_colorspace="Non-Color", alpha_mode=AlphaMode.CHANNEL_PACKED)
    store, report = TextureStore(device), Report()
    store.update({"a": data}, PerformanceSettings(**settings), report)
    return store, report


def test_cells_do_not_overlap() -> None:
    """Lay each tile and its border out inside the picture, apart from all others, at multiples of the border."""
    atlas = lay_out_tiles(SIZES, 0)
    taken = np.zeros((atlas.height, atlas.width), int)
    for place, size in zip(atlas.places, [*SIZES, (1, 1)], strict=True):
        assert (place.width, place.height) == size and place.x % atlas.border == place.y % atlas.border == 0
        left, top = place.x - atlas.border, place.y - atlas.border
        assert left >= 0 and top >= 0
        taken[top:place.y + place.height + atlas.border, left:place.x + place.width + atlas.border] += 1
    assert taken.max() == 1
    ten = lay_out_tiles([(2048, 2048)] * 10, 0)
    assert ten.width * ten.height < 1.5 * 10 * 2048**2 and ten.width < 3 * ten.height


@pytest.mark.parametrize(("extension", "mode"), [(0, "wrap"), (1, "edge"), (2, "constant"), (3, "symmetric")])
def test_tiles_keep_their_texels(extension: int, mode: str, device: str) -> None:
    """Hold each tile bit for bit, and around it what the extension continues it with."""
    atlas = lay_out_tiles(SIZES, extension)
    tiles = [tile(f"{1001 + i}" + "x" * i, size) for i, size in enumerate(SIZES)]
    store, report = store_of(atlas, tiles, device)
    assert not report.entries(), report.text()
    picture = store.level("a")
    for place, data in zip(atlas.places, tiles, strict=False):
        b = atlas.border
        found = picture[place.y - b:place.y + place.height + b, place.x - b:place.x + place.width + b]
        np.testing.assert_array_equal(found, np.pad(data.pixels, ((b, b), (b, b), (0, 0)), mode=mode))
    lost = atlas.places[-1]
    np.testing.assert_array_equal(picture[lost.y, lost.x], [255, 0, 255, 255])


def test_levels_see_no_other_tile(device: str) -> None:
    """Let as many levels be looked up as see one tile alone, within the border of half a texel that filters read."""
    atlas = lay_out_tiles([(100, 60), (37, 91)], 1)
    colors = ([10, 20, 30, 255], [200, 100, 50, 255])
    tiles = [replace(tile("t", (p.width, p.height)), pixels=np.full((p.height, p.width, 4), color, np.uint8))
             for p, color in zip(atlas.places, colors, strict=False)]
    for halvings, limit in ((0, 0), (1, 99), (2, 40)):
        store, _ = store_of(atlas, tiles, device, texture_size_limit=limit)
        info = store.struct().infos.numpy()[store.index("a")]
        assert info["levels"] == atlas.levels - halvings and info["width"] == atlas.width >> halvings
        for level in range(info["levels"]):
            picture, side = store.level("a", level), 1 << level + halvings
            for place, color in zip(atlas.places, colors, strict=False):
                columns = slice((place.x - side // 2) // side, -(-(place.x + place.width + side // 2) // side))
                rows = slice((place.y - side // 2) // side, -(-(place.y + place.height + side // 2) // side))
                part = picture[rows, columns].reshape(-1, 4).astype(int)
                assert np.abs(part - color).max() <= 1, (halvings, level)


def test_table_finds_each_square() -> None:
    """Give each tile its entry, squares around the tiles a magenta place without size, and no more rows than fit."""
    numbers = [1003, 1011, 1024]
    atlas = lay_out_tiles([(16, 16), (32, 8), (8, 32)], 0)
    known, table = tile_table(atlas, numbers)
    assert (known.column, known.row, known.columns, known.rows) == (0, 0, 4, 3) and known.entries <= 256
    for number, place in zip(numbers, atlas.places, strict=False):
        x, y, width, height = table[known.entry(number)] * (atlas.width, atlas.height, atlas.width, atlas.height)
        assert (x, atlas.height - y - height) == pytest.approx((place.x, place.y), abs=1e-3)
        assert (width, height) == pytest.approx((place.width, place.height))
    assert np.count_nonzero(table[:, 2]) == 3
    everything = find_range(list(range(1001, 2000)))
    assert everything.rows == 21 and everything.entries <= 256 < everything.entries + everything.columns + 1


def test_unlike_tiles_join(device: str) -> None:
    """Keep the values of tiles of other types and channels; name tiles that are gone, which are magenta."""
    sizes = [(8, 8), (4, 4), (2, 2)]
    atlas = lay_out_tiles(sizes, 0)
    tiles = [tile("1001", sizes[0], "uint8", 3), tile("1002", sizes[1], "float32", 4),
             ImageData(name="1003", path="gone.png", missing=True)]
    store, report = store_of(atlas, tiles, device)
    picture = store.level("a")
    places = atlas.places
    first = picture[places[0].y:places[0].y + 8, places[0].x:places[0].x + 8]
    np.testing.assert_allclose(first[..., :3], tiles[0].pixels / np.float32(255.0), atol=1e-6)
    np.testing.assert_array_equal(first[..., 3], 1.0)
    second = picture[places[1].y:places[1].y + 4, places[1].x:places[1].x + 4]
    np.testing.assert_allclose(second, tiles[1].pixels, atol=1e-6)
    np.testing.assert_array_equal(picture[places[2].y, places[2].x], [1.0, 0.0, 1.0, 1.0])
    assert "1003" in report.text() and "1002" not in report.text()
