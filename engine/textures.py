# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of a scene: fitted into a budget, and kept on the device.

What files hold is image_files.py's, how images are read image_loading.py's, what pixels become (formats, mip levels)
texels.py's; how they are looked up is kernels/texture.py's.

An image that can't be read is one magenta texel and an entry in the report; nothing here raises for bad input.
"""

from __future__ import annotations

import os
from collections.abc import Hashable

import numpy as np

from ..kernels.texture import ALPHA_UNRELATED
from ..kernels.types import Textures
from .image_loading import ImageLoading, ImageSource
from .report import Report, ReportKind
from .scene import ImageData
from .settings import PerformanceSettings
from .texels import Texels
from .texture_arrays import TextureArrays
from .texture_budget import TextureSize

__all__ = ["TextureStore"]

Key = Hashable
MAGENTA = np.array([[[255, 0, 255, 255]]], np.uint8)


class TextureStore:
    """All images of a scene on one device, by key."""

    def __init__(self, device: str) -> None:
        self.arrays = TextureArrays(device)
        self._slots: dict[Key, int] = {}
        self._names: dict[int, str] = {}

    @property
    def bytes(self) -> int:
        """Device memory of the texels."""
        return self.arrays.bytes

    def index(self, key: Key) -> int:
        """Return the index for `sample_texture`; -1 (drawn magenta) for an image that was never sent."""
        return self._slots.get(key, -1)

    def struct(self) -> Textures:
        """Return what kernels read; the same object until an update."""
        return self.arrays.struct()

    def level(self, key: Key, level: int = 0) -> np.ndarray:
        """Read one mip level of an image back: [H, W, 4] as stored, top row first."""
        return self.arrays.level(self._slots[key], level)

    def remove(self, *keys: Key) -> None:
        """Forget images; indices of the others stay."""
        slots = [self._slots.pop(key) for key in keys if key in self._slots]
        for slot in slots:
            del self._names[slot]
        self.arrays.change({}, removed=slots)

    def clear(self) -> None:
        """Forget all images."""
        self.remove(*self._slots)

    def update(self, images: dict[Key, ImageData], settings: PerformanceSettings, report: Report,
               loading: ImageLoading | None = None) -> None:
        """Take new and changed images; the others stay as they are, unless the budget asks that they be halved.

        Args:
            images: By key; a key sent before keeps its index.
            settings: The budget and the size limit.
            report: Receives what is missing, was reduced, cleaned or approximated.
            loading: Has begun to read some of the images.

        Raises:
            OutOfDeviceMemory: The device refused the memory, within the budget though it is.
        """
        if not images:
            return
        kept = self.arrays.sizes([slot for key, slot in self._slots.items() if key not in images])
        sources = (loading or ImageLoading({}, settings)).take(images, list(kept.values()), settings)
        self._place(sources, {slot: size.halvings for slot, size in kept.items() if size.halvings})
        for source in sources.values():
            _report(source, settings, report)
        for slot, size in kept.items():
            if size.halvings:
                _report_size(self._names[slot], size, settings, report)

    def _place(self, sources: dict[Key, ImageSource], halvings: dict[int, int]) -> None:
        """Give every image a slot and move all to the device."""
        taken = set(self._slots.values())
        free = (slot for slot in range(len(taken) + len(sources)) if slot not in taken)
        slots = {key: self._slots.get(key, -1) for key in sources}
        slots = {key: slot if slot >= 0 else next(free) for key, slot in slots.items()}
        magenta = Texels(levels=[MAGENTA], srgb=False, alpha=ALPHA_UNRELATED)
        self.arrays.change({slots[key]: source.texels or magenta for key, source in sources.items()}, (), halvings)
        self._slots.update(slots)
        self._names.update({slots[key]: source.data.name for key, source in sources.items()})


def _report(source: ImageSource, settings: PerformanceSettings, report: Report) -> None:
    """Tell what became of one image."""
    owner = f"image '{source.data.name}'"
    if source.size is None:
        report.add(ReportKind.MISSING, owner, f"{source.error}; drawn magenta: set its path or pack it into the file")
        return
    if source.texels.cleaned:
        report.add(ReportKind.APPROXIMATED, owner, "has texels that are not finite, set to 0", source.texels.cleaned)
    if source.cmyk:
        report.add(ReportKind.APPROXIMATED, owner, "is CMYK, converted to RGB without its colour profile")
    for name, error in source.lost.items():
        report.add(ReportKind.MISSING, owner, f"tile {name} can't be read ({error}); drawn magenta")
    if source.path != source.data.path:
        tile = os.path.basename(source.path)
        report.add(ReportKind.APPROXIMATED, owner, f"has UDIM tiles, of which only {tile} is drawn, on all of them")
    if source.size.halvings:
        _report_size(source.data.name, source.size, settings, report)


def _report_size(name: str, size: TextureSize, settings: PerformanceSettings, report: Report) -> None:
    """Tell that an image was reduced."""
    width, height = size.shape()
    limit = f", the size limit of {settings.texture_size_limit} px" if settings.texture_size_limit else ""
    report.add(ReportKind.APPROXIMATED, f"image '{name}'",
               f"reduced from {size.width} x {size.height} to {width} x {height} to fit the texture budget of "
               f"{settings.texture_budget} MiB{limit} or the device; raise them in the performance settings")
