# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's images as ImageData: files, packed files, sequences, generated and painted images.

Files are only named, for the engine to read; packed ones are read here, in parallel, straight from memory; what
exists in Blender alone (generated, painted, movies) is taken from `Image.pixels`. Those are, as measured on Blender
5.2: bottom row first; for 8-bit images as stored with straight alpha; for float images scene-linear and multiplied by
alpha, unless the image is data or channel-packed. Colour spaces other than sRGB and the working space are converted
here, with Blender's OpenColorIO configuration.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...engine.image_atlas import lay_out_tiles, tile_table
from ...engine.image_files import (
    DATA_SPACES,
    FilePixels,
    ImageUnreadable,
    can_read_bytes,
    read_bytes,
    read_file,
    read_size,
    to_linear,
)
from ...engine.report import Report, ReportKind
from ...engine.scene import AlphaMode, ColorEncoding, ImageData
from .image_tiles import TILE_TOKENS, TiledImage, TileSource, generated_pixels, tile_sources

__all__ = ["ImageCollector", "sequence_frame", "sequence_path", "working_space"]

Key = Hashable
THREADS_MAX = 16


def sequence_frame(scene_frame: int, image_user: bpy.types.ImageUser | None) -> int:
    """Return the number of the file shown at a scene frame (BKE_image_user_frame_get in Blender's image.cc)."""
    if image_user is None:
        return scene_frame
    length = image_user.frame_duration
    if length == 0:
        return 0
    frame = scene_frame - image_user.frame_start + 1
    frame = (frame - 1) % length + 1 if image_user.use_cyclic else min(max(frame, 1), length)
    return frame + image_user.frame_offset


def sequence_path(path: str, frame: int) -> str:
    """Return a sequence's path with the last number in the file's name replaced by `frame`, digits kept."""
    folder, name = os.path.split(path)
    stem, extension = os.path.splitext(name)
    numbers = list(re.finditer(r"\d+", stem))
    if not numbers:
        return path
    last = numbers[-1]
    stem = f"{stem[:last.start()]}{frame:0{len(last.group())}d}{stem[last.end():]}"
    return os.path.join(folder, stem + extension)


def working_space() -> str:
    """Return the name of the file's scene-linear space."""
    colorspace = getattr(bpy.data, "colorspace", None)
    return colorspace.working_space if colorspace else "Linear Rec.709"


def ocio_config() -> str:
    """Return the path of the OpenColorIO configuration that Blender uses, or an empty string."""
    folder = bpy.utils.system_resource("DATAFILES", path="colormanagement")
    candidates = (os.environ.get("OCIO", ""), os.path.join(folder or "", "config.ocio"))
    return next((path for path in candidates if path and os.path.isfile(path)), "")


@dataclass(frozen=True)
class _Space:
    """What an image's colour space asks for."""

    name: str
    working: str

    @property
    def is_data(self) -> bool:
        return self.name in DATA_SPACES

    @property
    def encoding(self) -> ColorEncoding | None:
        """How texels are decoded on lookup; None: they must be converted first."""
        if self.is_data or self.name in (self.working, "scene_linear"):
            return ColorEncoding.LINEAR
        if self.name == "sRGB" and self.working == "Linear Rec.709":
            return ColorEncoding.SRGB
        return None


class ImageCollector:
    """Collects the images that materials use; remembers between updates what has been handed over."""

    def __init__(self, depsgraph_or_scene: bpy.types.Depsgraph | bpy.types.Scene) -> None:
        self._known: dict[Key, tuple] = {}
        self._reports: dict[Key, Report] = {}
        self._atlases: dict[Key, TiledImage] = {}
        self._pool: ThreadPoolExecutor | None = None
        self.begin(depsgraph_or_scene)

    def begin(self, depsgraph_or_scene: bpy.types.Depsgraph | bpy.types.Scene, *, full: bool = False) -> None:
        """Start an update: forget its predecessor's images, but not which ones were handed over.

        Args:
            depsgraph_or_scene: Gives the frame; a depsgraph also tells which images were painted on. With a scene,
                painted and generated images count as changed.
            full: Hand everything over again.
        """
        self._images: dict[Key, ImageData] = {}
        self._jobs: dict[Key, Future[ImageData]] = {}
        self._seen: set[Key] = set()
        self._touched: set[int] | None = None
        if full:
            self._known.clear()
            self._atlases.clear()
            self._reports.clear()
        scene = depsgraph_or_scene
        if isinstance(depsgraph_or_scene, bpy.types.Depsgraph):
            scene = depsgraph_or_scene.scene
            self._touched = {update.id.session_uid for update in depsgraph_or_scene.updates
                             if isinstance(update.id, bpy.types.Image)}
        self._frame = scene.frame_current
        self._working = working_space()

    @property
    def images(self) -> dict[Key, ImageData]:
        """New and changed images of this update, by key. Waits for packed files to be read."""
        self._finish_jobs()
        return self._images

    @property
    def started(self) -> dict[Key, Callable[[], ImageData]]:
        """What gives the images of this update known so far, by key, waiting where they are still being read."""
        known = {key: lambda data=data: data for key, data in self._images.items()}
        return {**known, **{key: job.result for key, job in self._jobs.items()}}

    @property
    def report(self) -> Report:
        """What is approximated in the images known so far, whether they changed in this update or before."""
        merged = Report()
        self._finish_jobs()
        for part in self._reports.values():
            merged.merge(part)
        return merged

    def key(self, image: bpy.types.Image, image_user: bpy.types.ImageUser | None = None) -> Key:
        """Return the key of an image (a sequence: of its current frame), and record its data if that changed."""
        frame = sequence_frame(self._frame, image_user) if image.source == "SEQUENCE" else 0
        key = (image.session_uid, frame)
        if key in self._seen:
            return key
        self._seen.add(key)
        path = bpy.path.abspath(image.filepath, library=image.library) if image.filepath else ""
        path = sequence_path(path, frame) if image.source == "SEQUENCE" else path
        space = _Space(image.colorspace_settings.name, self._working)
        in_blender = image.source in ("GENERATED", "MOVIE", "VIEWER") or image.is_dirty
        signature = self._signature(image, path, space)
        touched = in_blender if self._touched is None else image.session_uid in self._touched
        if self._known.get(key) == signature and not touched:
            return key
        self._known[key] = signature
        told = self._reports[key] = Report()
        if in_blender:
            self._images[key] = _from_blender(image, space, told)
        elif len(image.packed_files):
            self._from_memory(key, image, space, told)
        else:
            self._from_file(key, image, path, space, told)
        return key

    def tiles(self, image: bpy.types.Image, extension: int, numbers: Sequence[int] | None = None) -> TiledImage | None:
        """Return an image made of tiles as one picture, and record its data if that changed; None without tiles.

        Args:
            image: Its source is TILED.
            extension: How its tiles go on beyond their borders, EXTENSION_* in kernels/texture.py.
            numbers: The tiles that count; None for all.
        """
        space = _Space(image.colorspace_settings.name, self._working)
        parts = tile_sources(image, numbers)
        if not parts:
            return None
        key = (image.session_uid, "tiles", extension, tuple(numbers or ()))
        signature = (space, image.alpha_mode, image.is_dirty, tuple(part.signature() for part in parts))
        touched = image.is_dirty and (self._touched is None or image.session_uid in self._touched)
        known = self._atlases.get(key)
        if known is not None and (key in self._seen or (self._known.get(key) == signature and not touched)):
            self._seen.add(key)
            return known
        self._seen.add(key)
        self._known[key] = signature
        told = self._reports[key] = Report()
        found: list[tuple[tuple[int, int], Callable[[], ImageData]]] = [
            self._tile(image, part, space, told) for part in parts]
        atlas = lay_out_tiles([size for size, _ in found], extension)
        known_range, table = tile_table(atlas, [part.number for part in parts])
        if len(parts) > known_range.columns * known_range.rows:
            _tell(told, image.name, f"has tiles above row {known_range.row + known_range.rows}, drawn magenta")
        if image.is_dirty and any(part.content() for part in parts if not part.painted):
            _tell(told, image.name, "has unsaved changes, drawn on its first tile alone: save it to see all")
        mode = AlphaMode(image.alpha_mode)

        def join() -> ImageData:
            tiles = tuple(make() for _, make in found)
            first = next((tile for tile in tiles if not tile.missing), tiles[0])
            return ImageData(
                name=image_name, encoding=first.encoding, source_colorspace=first.source_colorspace, alpha_mode=mode,
                atlas=replace(atlas, tiles=tiles))

        image_name = image.name
        self._read(key, join)
        self._atlases[key] = TiledImage(key, atlas, known_range, table)
        return self._atlases[key]

    def _tile(self, image: bpy.types.Image, part: TileSource, space: _Space,
              told: Report) -> tuple[tuple[int, int], Callable[[], ImageData]]:
        """Return a tile's size and what makes its data, which holds nothing of Blender's."""
        name, mode, number = image.name, AlphaMode(image.alpha_mode), str(part.number)
        data: ImageData | None = None
        if part.painted:
            data = _from_blender(image, space, told)
        elif part.color is not None:
            pixels = generated_pixels(part)
            data = _finish(name, FilePixels(pixels, True, True), AlphaMode.STRAIGHT,
                           space if pixels.dtype == np.uint8 else _Space(space.working, space.working), ocio_config(),
                           told)
        content = None if data is not None else part.content()
        size = None if content is None else read_size(content)
        if data is None and size is None:
            where = part.path or "its pixels"
            data = ImageData(name=number, path=where, missing=True)
        if data is not None:
            data.name = number
            shape = (1, 1) if data.pixels is None else (data.pixels.shape[1], data.pixels.shape[0])
            return shape, lambda: data
        if space.encoding is not None and isinstance(content, str):
            file = ImageData(name=number, path=content, encoding=space.encoding, source_colorspace=space.name,
                             alpha_mode=mode)
            return size, lambda: file
        where = {"path": content} if isinstance(content, str) else {"data": content}
        return size, _Job(number, mode, space, ocio_config(), told, **where).run

    def computed(self, key: Key, name: str, signature: Hashable, make: Callable[[], np.ndarray]) -> Key:
        """Return the key of a picture that a node computes, and record its data if that changed.

        Args:
            key: Stays the same while the picture changes.
            name: For messages.
            signature: Changes when the picture does.
            make: Returns linear colours in the working space, float32 [H, W, 3], top row first.
        """
        if self._known.get(key) != signature:
            self._known[key] = signature
            self._images[key] = ImageData(
                name=name, pixels=make(), encoding=ColorEncoding.LINEAR, source_colorspace=self._working,
                alpha_mode=AlphaMode.NONE)
        return key

    def _read(self, key: Key, job: Callable[[], ImageData]) -> None:
        """Begin to read an image, several at a time."""
        if self._pool is None:
            self._pool = ThreadPoolExecutor(min(os.cpu_count() or 1, THREADS_MAX), thread_name_prefix="burnish files")
        self._jobs[key] = self._pool.submit(job)

    def _finish_jobs(self) -> None:
        """Wait until everything is read."""
        jobs, self._jobs = self._jobs, {}
        self._images |= {key: job.result() for key, job in jobs.items()}
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def _signature(self, image: bpy.types.Image, path: str, space: _Space) -> tuple:
        """Return what changes when an image's content or meaning does; painting is seen by the depsgraph."""
        stamp = None
        if path and not len(image.packed_files) and os.path.isfile(path):
            status = os.stat(path)
            stamp = (status.st_mtime_ns, status.st_size)
        packed = tuple(file.packed_file.size for file in image.packed_files)
        generated = (image.generated_type, *image.size, tuple(image.generated_color)) \
            if image.source == "GENERATED" else ()
        return path, stamp, packed, generated, image.source, image.is_dirty, image.alpha_mode, space

    def _from_file(self, key: Key, image: bpy.types.Image, path: str, space: _Space, told: Report) -> None:
        """Name a file, or have it read where its colours must be converted."""
        exists = any(token in path for token in TILE_TOKENS) or os.path.isfile(path)
        if space.encoding is None and exists:
            job = _Job(image.name, AlphaMode(image.alpha_mode), space, ocio_config(), told, path=path)
            self._read(key, job.run)
            return
        self._images[key] = ImageData(
            name=image.name, path=path or None, encoding=space.encoding or ColorEncoding.SRGB,
            source_colorspace=space.name, alpha_mode=AlphaMode(image.alpha_mode), missing=not exists)

    def _from_memory(self, key: Key, image: bpy.types.Image, space: _Space, told: Report) -> None:
        """Have a packed file read; where the system can't, let Blender read it."""
        if image.source == "TILED" and len(image.packed_files) > 1:
            _tell(told, image.name, "has UDIM tiles, of which only the first is drawn, on all of them")
        if not can_read_bytes():
            self._images[key] = _from_blender(image, space, told)
            return
        data = image.packed_files[0].packed_file.data
        self._read(key, _Job(image.name, AlphaMode(image.alpha_mode), space, ocio_config(), told, data=data).run)


@dataclass
class _Job:
    """An image file to be read in a thread: holds nothing of Blender's."""

    name: str
    mode: AlphaMode
    space: _Space
    config: str
    told: Report
    path: str | None = None
    data: bytes | None = None

    def run(self) -> ImageData:
        """Read the image and convert its colours if need be."""
        try:
            picture = read_file(self.path) if self.data is None else read_bytes(self.data)
        except (ImageUnreadable, MemoryError):
            return ImageData(name=self.name, path=self.path or "the packed file", missing=True)
        if picture.cmyk:
            _tell(self.told, self.name, "is CMYK, converted to RGB without its colour profile")
        mode = self.mode
        if self.path and mode in (AlphaMode.STRAIGHT, AlphaMode.PREMUL):
            # A file on disk says itself whether it is premultiplied; of packed ones Blender's setting decides.
            mode = AlphaMode.STRAIGHT if picture.straight else AlphaMode.PREMUL
        return _finish(self.name, picture, mode, self.space, self.config, self.told)


def _finish(name: str, picture: FilePixels, mode: AlphaMode, space: _Space, config: str, told: Report) -> ImageData:
    """Return ImageData of pixels, converted to the working space if they need it."""
    pixels, encoding, space_name = picture.pixels, space.encoding, space.name
    if encoding is None:
        straight = FilePixels(pixels, picture.has_alpha, mode is not AlphaMode.PREMUL)
        converted = to_linear(straight, space.name, space.working, config) if config else None
        if converted is None:
            encoding = ColorEncoding.SRGB if pixels.dtype == np.uint8 else ColorEncoding.LINEAR
            kind = "sRGB" if encoding is ColorEncoding.SRGB else "linear"
            _tell(told, name, f"is in colour space '{space.name}', which could not be converted: read as {kind}")
        else:
            pixels, encoding, space_name = converted, ColorEncoding.LINEAR, space.working
    return ImageData(name=name, pixels=pixels, encoding=encoding, source_colorspace=space_name, alpha_mode=mode)


def _from_blender(image: bpy.types.Image, space: _Space, told: Report) -> ImageData:
    """Copy the pixels that Blender holds."""
    if image.source == "MOVIE":
        _tell(told, image.name, "is a movie, drawn as a still picture")
    mode, loaded = AlphaMode(image.alpha_mode), image.has_data
    width, height = image.size
    if min(width, height) < 1 or len(image.pixels) != width * height * image.channels:
        return ImageData(name=image.name, path="what Blender holds of it", missing=True)
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    pixels = np.ascontiguousarray(values.reshape(height, width, image.channels)[::-1])
    is_float = image.is_float
    if not loaded and not image.is_dirty:
        image.buffers_free()
    if is_float:
        if not space.is_data:
            space = _Space(space.working, space.working)
            mode = AlphaMode.PREMUL if mode is AlphaMode.STRAIGHT else mode
    else:
        np.multiply(pixels, 255.0, out=pixels)
        pixels = np.rint(pixels, out=pixels).astype(np.uint8)
        mode = AlphaMode.STRAIGHT if mode is AlphaMode.PREMUL else mode
    picture = FilePixels(pixels, pixels.shape[2] in (2, 4), False)
    return _finish(image.name, picture, mode, space, ocio_config(), told)


def _tell(told: Report, name: str, message: str) -> None:
    told.add(ReportKind.APPROXIMATED, f"image '{name}'", message)
