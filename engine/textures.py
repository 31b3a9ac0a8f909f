# SPDX-License-Identifier: GPL-3.0-or-later
"""Images: read from files and memory through OpenImageIO, fitted into a budget, and kept on the device.

This is the one file that reads images. What pixels become (formats, mip levels) is texels.py's; how they are looked up
is kernels/texture.py's. Reading and alpha follow Cycles (util/image_metadata.cpp of Blender 5.2): files are read
without OpenImageIO's own multiplication by alpha; colours that a file stores straight are multiplied by alpha for
filtering; data images, channel-packed ones and those whose alpha is ignored are left alone.

An image that can't be read is one magenta texel and an entry in the report; nothing here raises for bad input.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import OpenImageIO as oiio

from ..kernels.texture import ALPHA_ASSOCIATED, ALPHA_STRAIGHT, ALPHA_UNRELATED
from ..kernels.types import Textures
from .image_atlas import assemble
from .report import Report, ReportKind
from .scene import AlphaMode, ColorEncoding, ImageData
from .settings import PerformanceSettings
from .texels import TEXEL_BYTES, Texels, expand_channels, make_texels
from .texture_arrays import TextureArrays
from .texture_budget import TextureSize, fit

__all__ = [
    "DATA_SPACES", "FilePixels", "ImageUnreadable", "TextureStore", "can_read_bytes", "read_bytes", "read_file",
    "read_size", "to_linear",
]

Key = Hashable
T = TypeVar("T")
DATA_SPACES = {"Non-Color", "Raw", "Generic Data"}
"""Colour spaces whose values are no colours"""
UNKNOWN_ALPHA = {"dds", "psd"}
"""File formats whose reader doesn't say that alpha is straight, which it is (Cycles has the same exception)"""
THREADS_MAX = 16
"""Images read at the same time at most"""
TYPES = {"uint8": "uint8", "int8": "uint8", "uint16": "uint16", "int16": "uint16", "half": "half"}
MAGENTA = np.array([[[255, 0, 255, 255]]], np.uint8)


class ImageUnreadable(OSError):
    """A file is absent, empty, damaged or in no known format."""


@dataclass(frozen=True, eq=False)
class FilePixels:
    """What a file holds."""

    pixels: np.ndarray
    """[H, W, C] uint8, uint16, float16 or float32, top row first"""
    has_alpha: bool
    straight: bool
    """Whether colours are stored without being multiplied by alpha"""
    cmyk: bool = False
    """Whether the file holds CMYK, converted to RGB without a profile"""


def _open(path: str) -> oiio.ImageInput:
    """Open a file, leaving straight alpha straight; raise ImageUnreadable."""
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(path, config)
    if source is None:
        raise ImageUnreadable(" ".join(oiio.geterror().split()) or "unknown format")
    return source


def _is_straight(source: oiio.ImageInput) -> bool:
    """Tell whether a file's colours are stored without being multiplied by alpha."""
    spec, name = source.spec(), source.format_name()
    if spec.alpha_channel < 0:
        return False
    if name == "targa":
        return spec.get_int_attribute("targa:alpha_type", -1) != 4
    return name in UNKNOWN_ALPHA or spec.get_int_attribute("oiio:UnassociatedAlpha", 0) == 1


def _cmyk_to_rgb(pixels: np.ndarray) -> np.ndarray:
    """Convert [H, W, 4] CMYK to RGB as Cycles does: (1 - c) (1 - k)."""
    largest = np.float32(np.iinfo(pixels.dtype).max if pixels.dtype.kind != "f" else 1.0)
    ink = pixels.astype(np.float32) / largest
    rgb = (1.0 - ink[..., :3]) * (1.0 - ink[..., 3:]) * largest
    return (np.rint(rgb) if pixels.dtype.kind != "f" else rgb).astype(pixels.dtype)


def _type(spec: oiio.ImageSpec) -> str:
    """Return the type to read a file's pixels as."""
    return TYPES.get(str(spec.format), "float")


def read_file(path: str) -> FilePixels:
    """Read an image file's first picture as it is stored; raise ImageUnreadable."""
    source = _open(path)
    spec = source.spec()
    pixels = source.read_image(0, 0, 0, min(spec.nchannels, 4), _type(spec))
    if pixels is None or pixels.size == 0:
        raise ImageUnreadable(" ".join(source.geterror().split()) or "no pixels")
    pixels = pixels.reshape(spec.height, spec.width, -1)
    cmyk = source.format_name() == "jpeg" and pixels.shape[2] == 4
    if cmyk:
        pixels = _cmyk_to_rgb(pixels)
    elif pixels.shape[2] == 2 and spec.alpha_channel != 1:
        pixels = expand_channels(pixels, gray_alpha=False)[..., :3]
    has_alpha = not cmyk and 0 <= spec.alpha_channel < pixels.shape[2]
    return FilePixels(pixels, has_alpha, _is_straight(source), cmyk)


def read_size(data: str | bytes) -> tuple[int, int] | None:
    """Return width and height of an image file [px], given by its path or held in memory; None: it can't be read."""
    try:
        if isinstance(data, bytes):
            return _with_file(data, read_size)
        spec = _open(data).spec()
    except (OSError, RuntimeError):
        return None
    return (spec.width, spec.height) if min(spec.width, spec.height) > 0 else None


def can_read_bytes() -> bool:
    """Tell whether this system lets files be read from memory (`read_bytes`)."""
    return hasattr(os, "memfd_create") and os.path.isdir("/proc/self/fd")


def read_bytes(data: bytes) -> FilePixels:
    """Read an image file that lies in memory, writing nothing to disk; raise ImageUnreadable."""
    return _with_file(data, read_file)


def _with_file(data: bytes, use: Callable[[str], T]) -> T:
    """Return what is read of a file that lies in memory.

    OpenImageIO's Python binding has no reader for memory, but it reads an anonymous file of the kernel's (Linux).
    """
    assert can_read_bytes(), "ask can_read_bytes() first"
    handle = os.memfd_create("image", os.MFD_CLOEXEC)
    try:
        with open(handle, "wb", closefd=False) as file:
            file.write(data)
        return use(f"/proc/self/fd/{handle}")
    finally:
        os.close(handle)


def to_linear(picture: FilePixels, source_space: str, linear_space: str, config_path: str) -> np.ndarray | None:
    """Convert pixels from a named colour space of an OpenColorIO config to a linear one.

    Returns:
        float32 [H, W, 4], or None where the config lacks one of the spaces. Alpha stays as stored (straight or not).
    """
    rgba = expand_channels(picture.pixels)
    scale = 1.0 if rgba.dtype.kind == "f" else 1.0 / np.iinfo(rgba.dtype).max
    buffer = oiio.ImageBuf(np.ascontiguousarray(rgba.astype(np.float32) * np.float32(scale)))
    associated = picture.has_alpha and not picture.straight
    done = oiio.ImageBufAlgo.colorconvert(
        buffer, buffer, source_space, linear_space, unpremult=associated, colorconfig=config_path)
    if not done or buffer.has_error:
        buffer.geterror()
        return None
    return buffer.get_pixels(oiio.FLOAT).reshape(rgba.shape)


def _first_tile(path: str) -> str:
    """Return the first existing tile of a `<UDIM>` or `<UVTILE>` path, or the path of tile 1001."""
    for token, pattern, first in (("<UDIM>", "[12][0-9][0-9][0-9]", "1001"), ("<UVTILE>", "u[0-9]*_v[0-9]*", "u1_v1")):
        if token in path:
            found = sorted(glob.glob(glob.escape(path).replace(glob.escape(token), pattern)))
            return found[0] if found else path.replace(token, first)
    return path


@dataclass
class _Source:
    """An image on its way: found and measured, then read."""

    data: ImageData
    path: str | None
    size: TextureSize | None = None
    """None where it can't be read"""
    error: str = ""
    texels: Texels | None = None
    cmyk: bool = False
    lost: dict[str, str] = field(default_factory=dict)
    """Why tiles can't be read, by name"""

    @property
    def is_data(self) -> bool:
        """Whether values are no colours."""
        return self.data.source_colorspace in DATA_SPACES

    def texel_bytes(self, type_name: str) -> int:
        """Return what a texel of a pixel type will take; float colours count as the halves they mostly become."""
        return {"uint8": 4, "uint16": 8, "half": 8, "float16": 8}.get(type_name, 16 if self.is_data else 8)

    def fail(self, reason: object) -> None:
        """Give the image up."""
        self.size, self.texels = None, None
        self.error = f"{self.path or 'its pixels'} can't be read ({reason})"


def _measure(data: ImageData) -> _Source:
    """Find an image and read its size, not its pixels."""
    source = _Source(data, _first_tile(data.path) if data.path else None)
    try:
        if data.missing or (data.pixels is None and not data.path and data.atlas is None):
            source.error = f"{data.path} is missing or damaged" if data.path else "it has neither file nor pixels"
        elif data.atlas is not None:
            kinds = [_measure(tile).size for tile in data.atlas.tiles]
            texel_bytes = max([size.texel_bytes for size in kinds if size], default=4)
            source.size = TextureSize(data.atlas.width, data.atlas.height, texel_bytes, side=data.atlas.side)
        elif data.pixels is not None:
            height, width = data.pixels.shape[:2]
            source.size = TextureSize(width, height, source.texel_bytes(data.pixels.dtype.name))
        else:
            spec = _open(source.path).spec()
            source.size = TextureSize(spec.width, spec.height, source.texel_bytes(_type(spec)))
        if source.size and min(source.size.width, source.size.height) < 1:
            source.fail("it is empty")
    except (OSError, RuntimeError) as error:
        source.fail(error)
    return source


def _read(source: _Source) -> None:
    """Read an image's pixels and build its levels; failing that, note the error."""
    data = source.data
    try:
        source.texels = _picture(source) if data.atlas is None else _atlas(source)
        source.size.texel_bytes = TEXEL_BYTES[source.texels.format]
    except (OSError, RuntimeError, MemoryError) as error:
        source.fail(error)


def _stored(source: _Source) -> tuple[np.ndarray, int]:
    """Read an image's pixels; return them as [H, W, 4] and their ALPHA_* as the image's settings ask."""
    data = source.data
    if data.missing:
        raise ImageUnreadable(f"{data.path} is missing or damaged")
    if data.pixels is not None:
        straight = data.alpha_mode is AlphaMode.STRAIGHT
        picture = FilePixels(data.pixels, data.pixels.shape[2] in (2, 4), straight)
    else:
        picture = read_file(source.path)
    source.cmyk |= picture.cmyk
    rgba = expand_channels(picture.pixels)
    alpha = ALPHA_STRAIGHT if picture.straight else ALPHA_ASSOCIATED
    if not picture.has_alpha or data.alpha_mode is AlphaMode.CHANNEL_PACKED or source.is_data:
        alpha = ALPHA_UNRELATED
    if picture.has_alpha and data.alpha_mode is AlphaMode.NONE:
        alpha, rgba = ALPHA_UNRELATED, rgba.copy()
        rgba[..., 3] = 1 if rgba.dtype.kind == "f" else np.iinfo(rgba.dtype).max
    return rgba, alpha


def _picture(source: _Source) -> Texels:
    """Turn an image's pixels into texels."""
    rgba, alpha = _stored(source)
    return make_texels(rgba, srgb=source.data.encoding is ColorEncoding.SRGB, alpha=alpha, data=source.is_data,
                       halvings=source.size.halvings)


def _atlas(source: _Source) -> Texels:
    """Join an image's tiles into texels."""
    atlas, srgb = source.data.atlas, source.data.encoding is ColorEncoding.SRGB

    def load(tile: ImageData) -> tuple[np.ndarray, bool, int]:
        part = _Source(tile, tile.path)
        rgba, alpha = _stored(part)
        source.cmyk |= part.cmyk
        return rgba, srgb, alpha

    joined = assemble(atlas, source.size.halvings, load)
    texels = make_texels(joined.pixels, srgb=srgb, alpha=joined.alpha, data=source.is_data,
                         halvings=source.size.halvings - joined.halvings)
    source.lost, texels.cleaned = joined.errors, texels.cleaned + joined.cleaned
    texels.levels_max = max(atlas.levels - source.size.halvings, 1)
    return texels


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

    def update(self, images: dict[Key, ImageData], settings: PerformanceSettings, report: Report) -> None:
        """Take new and changed images; the others stay as they are, unless the budget asks that they be halved.

        Args:
            images: By key; a key sent before keeps its index.
            settings: The budget and the size limit.
            report: Receives what is missing, was reduced, cleaned or approximated.

        Raises:
            OutOfDeviceMemory: The device refused the memory, within the budget though it is.
        """
        if not images:
            return
        with ThreadPoolExecutor(min(len(images), os.cpu_count() or 1, THREADS_MAX)) as pool:
            sources = dict(zip(images, pool.map(_measure, images.values()), strict=True))
            good = {key: source for key, source in sources.items() if source.size}
            present = [slot for key, slot in self._slots.items() if key not in images]
            # The sizes in files decide what is read, so that the host never holds much more than the budget.
            budget = settings.texture_budget << 20
            sizes = [source.size for source in good.values()]
            fit(sizes + list(self.arrays.sizes(present).values()), budget, settings.texture_size_limit)
            read = [size.halvings for size in sizes]
            list(pool.map(_read, good.values()))
        # Formats are certain now.
        kept = self.arrays.sizes(present)
        sizes = [source.size for source in good.values() if source.size]
        fit(sizes + list(kept.values()), budget, settings.texture_size_limit)
        for source, halvings in zip(good.values(), read, strict=True):
            if source.size:
                source.texels.forget(source.size.halvings - halvings)
        self._place(sources, {slot: size.halvings for slot, size in kept.items() if size.halvings})
        for source in sources.values():
            _report(source, settings, report)
        for slot, size in kept.items():
            if size.halvings:
                _report_size(self._names[slot], size, settings, report)

    def _place(self, sources: dict[Key, _Source], halvings: dict[int, int]) -> None:
        """Give every image a slot and move all to the device."""
        taken = set(self._slots.values())
        free = (slot for slot in range(len(taken) + len(sources)) if slot not in taken)
        slots = {key: self._slots.get(key, -1) for key in sources}
        slots = {key: slot if slot >= 0 else next(free) for key, slot in slots.items()}
        magenta = Texels(levels=[MAGENTA], srgb=False, alpha=ALPHA_UNRELATED)
        self.arrays.change({slots[key]: source.texels or magenta for key, source in sources.items()}, (), halvings)
        self._slots.update(slots)
        self._names.update({slots[key]: source.data.name for key, source in sources.items()})


def _report(source: _Source, settings: PerformanceSettings, report: Report) -> None:
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
