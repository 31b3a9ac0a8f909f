# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the tiles (UDIM) of Blender's images are: in files, packed, painted or generated."""

from __future__ import annotations

import os
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ...engine.image_atlas import Atlas, TileRange
from ...engine.image_files import can_read_bytes
from ...engine.texels import srgb_to_linear

__all__ = ["TILE_TOKENS", "TileSource", "TiledImage", "generated_pixels", "tile_path", "tile_sources"]

TILE_TOKENS = ("<UDIM>", "<UVTILE>")


@dataclass(frozen=True, eq=False)
class TiledImage:
    """What a node needs to know to look tiles up."""

    key: Hashable
    atlas: Atlas
    range: TileRange
    table: np.ndarray
    """See engine/image_atlas.tile_table"""


@dataclass(frozen=True, eq=False)
class TileSource:
    """Where one tile is."""

    number: int
    """1001 and up"""
    path: str = ""
    """Of a file; may not exist"""
    packed: bpy.types.PackedFile | None = None
    painted: bool = False
    """Its pixels are those that Blender gives of the image"""
    color: tuple[float, ...] | None = None
    """All of it is of one colour, as Blender generates it; straight alpha"""
    is_float: bool = False
    """Whether the colour is kept as linear floats"""

    def content(self) -> str | bytes | None:
        """Return the file: its path or what is in it; None where there is none to be read."""
        if self.packed is not None:
            return self.packed.data if can_read_bytes() else None
        return self.path if os.path.isfile(self.path) else None

    def signature(self) -> tuple:
        """Return what changes when the tile does, painting excepted."""
        stamp = None
        if self.packed is None and os.path.isfile(self.path):
            status = os.stat(self.path)
            stamp = status.st_mtime_ns, status.st_size
        packed = None if self.packed is None else self.packed.size
        return self.number, self.path, stamp, packed, self.painted, self.color, self.is_float


def tile_path(path: str, number: int) -> str:
    """Return the path of a tile's file."""
    row, column = divmod(number - 1001, 10)
    return path.replace("<UDIM>", str(number)).replace("<UVTILE>", f"u{column + 1}_v{row + 1}")


def tile_sources(image: bpy.types.Image, numbers: Sequence[int] | None = None) -> list[TileSource]:
    """Return an image's tiles in the order of their numbers; those of `numbers` alone if given."""
    path = bpy.path.abspath(image.filepath, library=image.library) if image.filepath else ""
    packed = {file.tile_number: file.packed_file for file in image.packed_files}
    tiles = sorted(image.tiles, key=lambda tile: tile.number)
    found = []
    for i, tile in enumerate(tiles):
        number = tile.number
        if numbers is not None and number not in numbers:
            continue
        place = tile_path(path, number)
        if number in packed:
            # Blender's own pixels are those of the first tile.
            lent = i == 0 and not can_read_bytes()
            found.append(TileSource(number, place, None if lent else packed[number], painted=lent))
        elif i == 0 and (image.is_dirty or tile.is_generated_tile):
            found.append(TileSource(number, place, painted=True))
        elif tile.is_generated_tile and tile.generated_type == 'BLANK':
            color = tuple(tile.generated_color)
            found.append(TileSource(number, place, color=color, is_float=tile.use_generated_float))
        else:
            found.append(TileSource(number, place))
    return found


def generated_pixels(tile: TileSource) -> np.ndarray:
    """Return the colour of a generated tile as an image of one pixel, uint8 or float32 [1, 1, 4]."""
    color = np.array(tile.color, np.float32).reshape(1, 1, 4)
    if tile.is_float:
        color[..., :3] = srgb_to_linear(color[..., :3])
        return color
    return np.rint(np.clip(color, 0.0, 1.0) * 255.0).astype(np.uint8)
