# SPDX-License-Identifier: GPL-3.0-or-later
"""Images made of tiles (UDIM) as one picture, so that one look-up serves all tiles and kernels know nothing of them.

Tile 1001 + i + 10 j covers the square [i, i + 1) x [j, j + 1) of UV space. Each keeps its own resolution and lies in
the picture with a border all around that continues it as the look-up's extension asks, so that filtering does not see
its neighbours: at level l a texel is 2^l wide, which is why no level beyond log2 of the border is looked up. Squares
without a tile are magenta, as in Cycles (kernel/svm/image.h of Blender 5.2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..kernels.node_codes import RAMP_SIZE
from ..kernels.texture import ALPHA_ASSOCIATED, ALPHA_STRAIGHT, ALPHA_UNRELATED
from .texels import make_texels

if TYPE_CHECKING:
    from .scene import ImageData

__all__ = ["Atlas", "Joined", "Place", "TileRange", "assemble", "lay_out_tiles", "tile_table"]

BORDER_SHARE = 32
"""The largest tile is this many borders wide; it has about that many texels in the coarsest level looked up"""
BORDER_MIN, BORDER_MAX = 8, 128
TILES_ACROSS = 10
"""Tiles in a row of UV space"""
FIRST = 1001
PADDING = {0: "wrap", 1: "edge", 2: "constant", 3: "symmetric"}
"""How numpy.pad continues a tile, by EXTENSION_* of kernels/texture.py"""
MAGENTA = (1.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True)
class Place:
    """Where a tile lies [px], without its border; rows from the top."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class Atlas:
    """A picture of tiles and what is in it."""

    width: int
    height: int
    border: int
    """Texels around each tile, a power of two; all cells lie at multiples of it"""
    extension: int
    """EXTENSION_* in kernels/texture.py"""
    places: tuple[Place, ...]
    """One for each tile, then one that is magenta"""
    tiles: tuple[ImageData, ...] = ()
    """Each a file or pixels of the size of its place, or missing"""

    @property
    def levels(self) -> int:
        """How many levels see nothing of other tiles."""
        return self.border.bit_length()

    @property
    def side(self) -> int:
        """Longest side of a tile [px]."""
        return max(max(place.width, place.height) for place in self.places)


@dataclass(eq=False)
class Joined:
    """Tiles joined."""

    pixels: np.ndarray
    """[H, W, 4]"""
    alpha: int
    """ALPHA_* of kernels/texture.py"""
    halvings: int
    """How often sides have been halved"""
    cleaned: int
    """Texels that weren't finite"""
    errors: dict[str, str]
    """Why tiles couldn't be read, by their names"""


@dataclass(frozen=True)
class TileRange:
    """The squares of UV space that a table knows, a column and two rows around them without tiles included."""

    column: int
    row: int
    """Those of the first tile"""
    columns: int
    rows: int

    @property
    def entries(self) -> int:
        """How many entries of the table are used; the last one is before a row's first column and after its last."""
        return (self.columns + 1) * (self.rows + 2) + 1

    @property
    def entry_of_first(self) -> int:
        """The entry of the lowest row's first column."""
        return self.columns + 2

    def entry(self, number: int) -> int:
        """Return a tile's entry."""
        row, column = divmod(number - FIRST, TILES_ACROSS)
        return (row - self.row) * (self.columns + 1) + column - self.column + self.entry_of_first


def find_range(numbers: Sequence[int]) -> TileRange:
    """Return the range of the numbers that a table has room for, counted from the lowest row."""
    columns, rows = [(n - FIRST) % TILES_ACROSS for n in numbers], [(n - FIRST) // TILES_ACROSS for n in numbers]
    across = max(columns) - min(columns) + 1
    room = (int(RAMP_SIZE) - 1) // (across + 1) - 2
    return TileRange(min(columns), min(rows), across, min(max(rows) - min(rows) + 1, room))


def lay_out_tiles(sizes: Sequence[tuple[int, int]], extension: int) -> Atlas:
    """Lay tiles out in rows of like height.

    Args:
        sizes: Widths and heights [px].
        extension: EXTENSION_* in kernels/texture.py.
    """
    largest = max(max(size) for size in sizes)
    border = min(max(1 << max(largest // BORDER_SHARE, 1).bit_length() - 1, BORDER_MIN), BORDER_MAX)
    boxes = [*sizes, (1, 1)]
    cells = [tuple(-(-side // border) * border + 2 * border for side in size) for size in boxes]
    room = max(int(np.sqrt(sum(w * h for w, h in cells))), max(w for w, _ in cells))
    # As many of the widest cells as come nearest to a square: ten alike are four, four and two.
    widest = max(w for w, _ in cells)
    room = -(-room // widest) * widest
    places: list[Place] = [Place(0, 0, 1, 1)] * len(boxes)
    x = y = tall = wide = 0
    for i in sorted(range(len(boxes)), key=lambda i: (-cells[i][1], -cells[i][0])):
        width, height = cells[i]
        if x + width > room:
            x, y, tall = 0, y + tall, 0
        places[i] = Place(x + border, y + border, *boxes[i])
        x, tall, wide = x + width, max(tall, height), max(wide, x + width)
    return Atlas(wide, y + tall, border, extension, tuple(places))


def tile_table(atlas: Atlas, numbers: Sequence[int]) -> tuple[TileRange, np.ndarray]:
    """Return where tiles lie by the square of UV space.

    Args:
        atlas: Its places are in the order of `numbers`.
        numbers: 1001 and up.

    Returns:
        The range of squares, and float32 [RAMP_SIZE, 4]: a square's lower left corner and its size in the picture's
        UV; those without a tile have no size.
    """
    known = find_range(numbers)
    lost = atlas.places[-1]
    table = np.zeros((int(RAMP_SIZE), 4), np.float32)
    table[:, 0], table[:, 1] = (lost.x + 0.5) / atlas.width, 1.0 - (lost.y + 0.5) / atlas.height
    for number, place in zip(numbers, atlas.places, strict=False):
        if (number - FIRST) // TILES_ACROSS < known.row + known.rows:
            table[known.entry(number)] = (
                place.x / atlas.width, 1.0 - (place.y + place.height) / atlas.height,
                place.width / atlas.width, place.height / atlas.height)
    return known, table


def assemble(atlas: Atlas, halvings: int, load: Callable[[ImageData], tuple[np.ndarray, bool, int]]) -> Joined:
    """Join tiles, each halved on its own, so that never more than a tile is held at full size.

    Args:
        atlas: What to join.
        halvings: How often sides shall be halved.
        load: Returns a tile's pixels [H, W, 4], whether they are sRGB-encoded, and its ALPHA_*; raises OSError,
            RuntimeError or MemoryError.
    """
    done = min(halvings, atlas.levels - 1)
    parts, kinds, errors, cleaned = [], [], {}, 0
    for data, place in zip(atlas.tiles, atlas.places, strict=False):
        try:
            pixels, srgb, alpha = load(data)
            if pixels.shape[:2] != (place.height, place.width):
                raise ValueError("it has changed its size")
        except (OSError, RuntimeError, MemoryError, ValueError) as error:
            errors[data.name] = str(error)
            parts.append(None)
            kinds.append(ALPHA_UNRELATED)
            continue
        texels = make_texels(_pad(pixels, atlas), srgb=srgb, alpha=alpha, data=True, halvings=done)
        parts.append(texels.levels[0])
        kinds.append(alpha)
        cleaned += texels.cleaned
    # What is opaque is so in either way.
    kind = max(kinds, default=ALPHA_UNRELATED)
    for i, part in enumerate(parts):
        if kind == ALPHA_ASSOCIATED and kinds[i] == ALPHA_STRAIGHT:
            parts[i] = _convert(part, np.dtype(np.float32))
            parts[i] = np.concatenate([parts[i][..., :3] * parts[i][..., 3:], parts[i][..., 3:]], axis=2)
    dtype = _common_type([part.dtype for part in parts if part is not None])
    picture = np.zeros((atlas.height >> done, atlas.width >> done, 4), dtype)
    for part, place in zip([*parts, None], atlas.places, strict=True):
        if part is None:
            shape = _padded(place.height, atlas) >> done, _padded(place.width, atlas) >> done, 4
            part = np.broadcast_to(_convert(np.array(MAGENTA, np.float32), dtype), shape)
        top, left = (place.y - atlas.border) >> done, (place.x - atlas.border) >> done
        picture[top:top + part.shape[0], left:left + part.shape[1]] = _convert(part, dtype)
    return Joined(picture, kind, done, cleaned, errors)


def _padded(side: int, atlas: Atlas) -> int:
    """Return the side of a tile's cell."""
    return -(-side // atlas.border) * atlas.border + 2 * atlas.border


def _pad(pixels: np.ndarray, atlas: Atlas) -> np.ndarray:
    """Continue a tile's pixels over its cell, whose sides are multiples of the border."""
    height, width = pixels.shape[:2]
    more = [(atlas.border, _padded(side, atlas) - side - atlas.border) for side in (height, width)]
    return np.ascontiguousarray(np.pad(pixels, (*more, (0, 0)), mode=PADDING[atlas.extension]))


def _common_type(types: Sequence[np.dtype]) -> np.dtype:
    """Return the type that holds all tiles' values."""
    if len(set(types)) <= 1:
        return types[0] if types else np.dtype(np.uint8)
    integers = all(dtype.kind == "u" for dtype in types)
    return np.dtype(np.uint16 if integers else np.float32)


def _convert(values: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Return values of one type as those of another, integers being 0..max."""
    if values.dtype == dtype:
        return values
    scaled = values.astype(np.float32)
    if values.dtype.kind == "u":
        scaled /= np.float32(np.iinfo(values.dtype).max)
    return np.rint(scaled * np.iinfo(dtype).max).astype(dtype) if dtype.kind == "u" else scaled.astype(dtype)
