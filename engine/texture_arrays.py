# SPDX-License-Identifier: GPL-3.0-or-later
"""All texels on the device: one flat array for each storage format, and the table that says where each image lies.

An image keeps its place in the table for as long as it exists, so that programs which refer to it stay valid. Replacing
one by another of the same size copies that image alone; any other change moves what is kept within the device.
No copy of the texels stays on the host.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels.texture import TEXELS_BYTE, TEXELS_FLOAT, TEXELS_HALF, TEXELS_SHORT
from ..kernels.types import TextureInfo, Textures
from .device import host_array
from .errors import OutOfDeviceMemory
from .texels import TEXEL_BYTES, Texels
from .texture_budget import TextureSize

__all__ = ["TextureArrays"]

SMALL_TEXELS = 1 << 16
"""Levels of fewer texels go to the device together: each copy by itself takes as long as 64 KiB"""

FORMATS = {
    TEXELS_BYTE: ("bytes4", wp.uint32),
    TEXELS_SHORT: ("shorts4", wp.vec4us),
    TEXELS_HALF: ("halves4", wp.vec4h),
    TEXELS_FLOAT: ("floats4", wp.vec4),
}
"""Field of Textures and element type by TEXELS_*"""


@dataclass
class _Place:
    """Where one image lies: the fields of kernels.types.TextureInfo.

    `levels` may be fewer than there are.
    """

    width: int
    height: int
    levels: int
    offset: int
    format: int
    srgb: int
    alpha: int
    count: int
    """Texels of all levels"""


class TextureArrays:
    """Texels of all images on one device, by slot (the index that kernels use)."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._arrays = {form: wp.empty(0, dtype=dtype, device=device) for form, (_, dtype) in FORMATS.items()}
        self._places: dict[int, _Place] = {}
        self._finest: set[int] = set()
        self._struct: Textures | None = None

    @property
    def bytes(self) -> int:
        """Device memory of the texels."""
        return sum(place.count * TEXEL_BYTES[place.format] for place in self._places.values())

    def sizes(self, slots: Iterable[int]) -> dict[int, TextureSize]:
        """Return the sizes of some images."""
        places = {slot: self._places[slot] for slot in slots}
        return {slot: TextureSize(p.width, p.height, TEXEL_BYTES[p.format]) for slot, p in places.items()}

    def level(self, slot: int, level: int = 0) -> np.ndarray:
        """Read one mip level back: [H, W, 4], top row first."""
        place = self._places[slot]
        width, height, start = place.width, place.height, place.offset
        for _ in range(level):
            start, width, height = start + width * height, max(width // 2, 1), max(height // 2, 1)
        texels = self._arrays[place.format][start:start + width * height].numpy()
        return texels.view(np.uint8 if place.format == TEXELS_BYTE else texels.dtype).reshape(height, width, 4)

    def change(self, texels: dict[int, Texels], removed: Iterable[int] = (),
               halvings: dict[int, int] | None = None) -> None:
        """Put, replace, remove and shrink images.

        Args:
            texels: New contents by slot; their levels are taken over.
            removed: Slots that become empty.
            halvings: By slot, how many of the largest levels of images already there are forgotten.

        Raises:
            OutOfDeviceMemory: The arrays don't fit; nothing has changed then.
        """
        places = {slot: place for slot, place in self._places.items() if slot not in set(removed)}
        stale = {self._places[slot].format for slot in removed if slot in self._places}
        for slot, count in (halvings or {}).items():
            places[slot] = _halved(places[slot], count)
            stale.add(places[slot].format)
        in_place = {slot for slot, new in texels.items() if slot in places and _alike(places[slot], new)}
        for slot in texels.keys() - in_place:
            stale |= {texels[slot].format} | ({places.pop(slot).format} if slot in places else set())
        moved = {slot: new for slot, new in texels.items() if slot not in in_place}
        rebuilt = {}
        for form in sorted(stale):
            rebuilt[form] = self._rebuild(form, places, {s: new for s, new in moved.items() if new.format == form})
        self._arrays |= rebuilt
        for slot in in_place:
            places[slot] = self._write(places[slot].offset, texels[slot], self._arrays[texels[slot].format])
        self._places = places
        self._struct = None

    def look_up_finest(self, slots: set[int]) -> None:
        """Have kernels look the finest level of these images up at any distance, and all levels of the others."""
        if slots != self._finest:
            self._finest, self._struct = slots, None

    def _rebuild(self, form: int, places: dict[int, _Place], new: dict[int, Texels]) -> wp.array:
        """Return one format's array made anew from what is kept and what is new; fill in their `places`."""
        kept = sorted((slot for slot, place in places.items() if place.format == form),
                      key=lambda slot: places[slot].offset)
        total = sum(places[slot].count for slot in kept) + sum(texels.count for texels in new.values())
        old = self._arrays[form]
        try:
            array = wp.empty(total, dtype=FORMATS[form][1], device=self._device)
        except (RuntimeError, MemoryError) as error:
            size = total * TEXEL_BYTES[form] / (1 << 20)
            raise OutOfDeviceMemory(
                f"Textures need {size:.0f} MiB more than {self._device} has free: lower the texture budget or the "
                f"texture size limit in the performance settings ({error})") from error
        offset = 0
        for slot in kept:
            place = places[slot]
            wp.copy(array, old, dest_offset=offset, src_offset=place.offset, count=place.count)
            places[slot] = _Place(**{**vars(place), "offset": offset})
            offset += place.count
        for slot, texels in new.items():
            places[slot] = self._write(offset, texels, array)
            offset += texels.count
        return array

    def _write(self, offset: int, texels: Texels, array: wp.array) -> _Place:
        """Copy an image's levels to the device and return its place."""
        dtype, start = FORMATS[texels.format][1], offset
        for flat in _joined([level.reshape(-1, 4) for level in texels.levels]):
            flat = flat.view(np.uint32).ravel() if texels.format == TEXELS_BYTE else flat
            wp.copy(array, host_array(flat, dtype), dest_offset=start, count=len(flat))
            start += len(flat)
        height, width = texels.levels[0].shape[:2]
        levels = min(len(texels.levels), texels.levels_max or len(texels.levels))
        return _Place(width=width, height=height, levels=levels, offset=offset, format=texels.format,
                      srgb=int(texels.srgb), alpha=texels.alpha, count=start - offset)

    def struct(self) -> Textures:
        """Return what kernels read; the same object until something changes."""
        if self._struct is None:
            names = [name for name in TextureInfo.numpy_dtype()["names"] if name != "padding"]
            infos = np.zeros(max(self._places, default=-1) + 1, dtype=TextureInfo.numpy_dtype())
            for slot, place in self._places.items():
                for name in names:
                    infos[slot][name] = getattr(place, name)
                if slot in self._finest:
                    infos[slot]["levels"] = 1
            textures = Textures()
            textures.infos = wp.array(infos, dtype=TextureInfo, device=self._device)
            for form, (name, _) in FORMATS.items():
                setattr(textures, name, self._arrays[form])
            self._struct = textures
        return self._struct


def _joined(levels: list[np.ndarray]) -> list[np.ndarray]:
    """Return the texels [N, 4] of levels, the largest first, with those of small ones in one array."""
    large = [level for level in levels if len(level) >= SMALL_TEXELS]
    small = levels[len(large):]
    return large + ([np.concatenate(small)] if small else [])


def _alike(place: _Place, texels: Texels) -> bool:
    """Tell whether new texels fit exactly where old ones lie."""
    shape = texels.levels[0].shape[:2]
    return (place.format, place.height, place.width, place.count) == (texels.format, *shape, texels.count)


def _halved(place: _Place, count: int) -> _Place:
    """Return the place of an image without its `count` largest levels."""
    values = dict(vars(place))
    for _ in range(count):
        dropped = values["width"] * values["height"]
        values.update(width=max(values["width"] // 2, 1), height=max(values["height"] // 2, 1),
                      levels=max(values["levels"] - 1, 1), offset=values["offset"] + dropped,
                      count=values["count"] - dropped)
    return _Place(**values)
