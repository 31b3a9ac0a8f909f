# SPDX-License-Identifier: GPL-3.0-or-later
"""Images on their way: found, measured, read and made into texels, in threads.

Reading can begin while the rest of the scene is still being extracted (`ImageLoading`): files take processors, reading
Blender's scene takes one. Colours that a file stores straight are multiplied by alpha for filtering; data images,
channel-packed ones and those whose alpha is ignored are left alone, as Cycles does.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from ..kernels.texture import ALPHA_ASSOCIATED, ALPHA_STRAIGHT, ALPHA_UNRELATED
from .image_atlas import assemble
from .image_files import DATA_SPACES, FilePixels, ImageUnreadable, read_file, read_type
from .scene import AlphaMode, ColorEncoding, ImageData
from .settings import PerformanceSettings
from .texels import TEXEL_BYTES, Texels, expand_channels, make_texels
from .texture_budget import TextureSize, fit

__all__ = ["ImageLoading", "ImageSource"]

Key = Hashable
THREADS_MAX = 16
"""Images read at the same time at most"""


def _first_tile(path: str) -> str:
    """Return the first existing tile of a `<UDIM>` or `<UVTILE>` path, or the path of tile 1001."""
    for token, pattern, first in (("<UDIM>", "[12][0-9][0-9][0-9]", "1001"), ("<UVTILE>", "u[0-9]*_v[0-9]*", "u1_v1")):
        if token in path:
            found = sorted(glob.glob(glob.escape(path).replace(glob.escape(token), pattern)))
            return found[0] if found else path.replace(token, first)
    return path


@dataclass
class ImageSource:
    """An image on its way: found and measured, then read."""

    data: ImageData
    path: str | None
    size: TextureSize | None = None
    """None where it can't be read"""
    error: str = ""
    halvings: int = 0
    """Of what is read, see TextureSize"""
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


def _measure(data: ImageData) -> ImageSource:
    """Find an image and read its size, not its pixels."""
    source = ImageSource(data, _first_tile(data.path) if data.path else None)
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
            width, height, kind = read_type(source.path)
            source.size = TextureSize(width, height, source.texel_bytes(kind))
        if source.size and min(source.size.width, source.size.height) < 1:
            source.fail("it is empty")
    except (OSError, RuntimeError) as error:
        source.fail(error)
    return source


def _read(source: ImageSource) -> None:
    """Read an image's pixels and build its levels; failing that, note the error."""
    data = source.data
    try:
        source.texels = _picture(source) if data.atlas is None else _atlas(source)
        source.size.texel_bytes = TEXEL_BYTES[source.texels.format]
    except (OSError, RuntimeError, MemoryError) as error:
        source.fail(error)


def _stored(source: ImageSource) -> tuple[np.ndarray, int]:
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


def _picture(source: ImageSource) -> Texels:
    """Turn an image's pixels into texels."""
    rgba, alpha = _stored(source)
    return make_texels(rgba, srgb=source.data.encoding is ColorEncoding.SRGB, alpha=alpha, data=source.is_data,
                       halvings=source.halvings)


def _atlas(source: ImageSource) -> Texels:
    """Join an image's tiles into texels."""
    atlas, srgb = source.data.atlas, source.data.encoding is ColorEncoding.SRGB

    def load(tile: ImageData) -> tuple[np.ndarray, bool, int]:
        part = ImageSource(tile, tile.path)
        rgba, alpha = _stored(part)
        source.cmyk |= part.cmyk
        return rgba, srgb, alpha

    joined = assemble(atlas, source.halvings, load)
    texels = make_texels(joined.pixels, srgb=srgb, alpha=joined.alpha, data=source.is_data,
                         halvings=source.halvings - joined.halvings)
    source.lost, texels.cleaned = joined.errors, texels.cleaned + joined.cleaned
    texels.levels_max = max(atlas.levels - source.halvings, 1)
    return texels


class ImageLoading:
    """Reads images in the background, until they are taken or what has begun it is stopped or forgotten."""

    def __init__(self, images: dict[Key, Callable[[], ImageData]], settings: PerformanceSettings) -> None:
        """Begin to read images, as far as the budget and the limit of sides allow.

        Args:
            images: What gives them, which may take its time.
            settings: The budget and the size limit.
        """
        self._pool = ThreadPoolExecutor(min(os.cpu_count() or 1, THREADS_MAX), thread_name_prefix="burnish images")
        self._sources: dict[Key, ImageSource] = {}
        self._reading: list[Future] = []
        self._started = self._pool.submit(self._start, images, settings) if images else None

    def _start(self, images: dict[Key, Callable[[], ImageData]], settings: PerformanceSettings) -> None:
        self._sources |= {key: _measure(make()) for key, make in images.items()}
        sizes = [source.size for source in self._sources.values() if source.size]
        fit(sizes, settings.texture_budget << 20, settings.texture_size_limit)
        self._reading = self._begin(list(self._sources.values()))

    def _begin(self, sources: list[ImageSource]) -> list[Future]:
        good = [source for source in sources if source.size]
        for source in good:
            source.halvings = source.size.halvings
        return [self._pool.submit(_read, source) for source in good]

    def take(
        self, images: dict[Key, ImageData], kept: list[TextureSize], settings: PerformanceSettings,
    ) -> dict[Key, ImageSource]:
        """Return images read, reduced so that they fit beside those that are kept; those not begun yet are read now.

        Args:
            images: By key, in the order of the result.
            kept: Sizes of images that stay; their `halvings` are raised where they must shrink, too.
            settings: The budget and the size limit.
        """
        limits = settings.texture_budget << 20, settings.texture_size_limit
        with self._pool:
            if self._started is not None:
                self._started.result()
            for future in self._reading:
                future.result()
            begun = {key: source for key, source in self._sources.items() if source.data is images.get(key)}
            new = {key: data for key, data in images.items() if key not in begun}
            later = dict(zip(new, self._pool.map(_measure, new.values()), strict=True))
            sources = {key: begun[key] if key in begun else later[key] for key in images}
            # The sizes in files decide what is read, so that the host never holds much more than the budget.
            fit([*(source.size for source in sources.values() if source.size), *kept], *limits)
            for future in self._begin(list(later.values())):
                future.result()
        # Formats are certain now.
        good = [source for source in sources.values() if source.size]
        fit([*(source.size for source in good), *kept], *limits)
        for source in good:
            source.texels.forget(source.size.halvings - source.halvings)
        return sources

    def stop(self) -> None:
        """Read no more."""
        self._pool.shutdown(wait=False, cancel_futures=True)
