# SPDX-License-Identifier: GPL-3.0-or-later
"""Open Image Denoise 2, called through ctypes: device and filter are kept between pictures, images stay on the device.

The extension ships no copy, which could clash with Blender's: the caller tells where Blender's library is. On CUDA the
library's own CUDA device filters Warp's arrays in place, on Warp's stream; where that fails its processor device gets
copies. The C interface is that of OpenImageDenoise/oidn.h, version 2.2 and later.
"""

from __future__ import annotations

import atexit
import ctypes
import functools
import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import warp as wp

from .errors import BurnishError

__all__ = ["Images", "denoise", "load", "release"]

log = logging.getLogger(__name__)

CANCELLED = 6
"""OIDN_ERROR_CANCELLED"""
DEVICE_CPU = 1
"""OIDN_DEVICE_TYPE_CPU"""
FORMAT_FLOAT3 = 3
"""OIDN_FORMAT_FLOAT3"""
QUALITY_BALANCED = 5
"""OIDN_QUALITY_BALANCED: a smaller network. For guides it does as well, in a third of the time on a processor"""

_handle, _text, _size = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t
_Monitor = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_double)
"""OIDNProgressMonitorFunction: told how far a filter is, returns whether it goes on"""

SIGNATURES = {
    "oidnNewDevice": (_handle, [ctypes.c_int]),
    "oidnNewCUDADevice": (_handle, [ctypes.POINTER(ctypes.c_int), ctypes.POINTER(ctypes.c_void_p), ctypes.c_int]),
    "oidnSetDeviceBool": (None, [_handle, _text, ctypes.c_bool]),
    "oidnCommitDevice": (None, [_handle]),
    "oidnReleaseDevice": (None, [_handle]),
    "oidnGetDeviceError": (ctypes.c_int, [_handle, ctypes.POINTER(_text)]),
    "oidnNewFilter": (_handle, [_handle, _text]),
    "oidnSetSharedFilterImage": (None, [_handle, _text, ctypes.c_void_p, ctypes.c_int, *[_size] * 5]),
    "oidnSetFilterBool": (None, [_handle, _text, ctypes.c_bool]),
    "oidnSetFilterInt": (None, [_handle, _text, ctypes.c_int]),
    "oidnSetFilterProgressMonitorFunction": (None, [_handle, _Monitor, ctypes.c_void_p]),
    "oidnCommitFilter": (None, [_handle]),
    "oidnExecuteFilter": (None, [_handle]),
    "oidnReleaseFilter": (None, [_handle]),
}
"""Result and argument types of the functions that are used"""

_lock = threading.Lock()
_kept: dict[tuple[str, int, int], Denoiser] = {}
"""Devices with their filters, by library, CUDA device and its stream; -1 and 0 for the processor"""


@dataclass(frozen=True, kw_only=True)
class Images:
    """What a filter reads and writes, all on one Warp device, one entry a pixel."""

    color: wp.array
    """vec4, scene-linear; the fourth channel is not read"""
    output: wp.array
    """vec4; the fourth channel is not written"""
    albedo: wp.array | None = None
    """vec3, 0..1: keeps textures sharp"""
    normal: wp.array | None = None
    """vec3, keeps edges sharp; only together with `albedo`"""
    width: int
    height: int
    clean: bool = False
    """Whether albedo and normal are free of noise"""
    prefilter: bool = False
    """Whether to free them of noise first, in place"""


@functools.cache
def load(path: Path) -> ctypes.CDLL:
    """Return the library in a file, ready to be called.

    Raises:
        BurnishError: It can't be loaded, or is of another version.
    """
    try:
        found = ctypes.CDLL(str(path))
        for name, (result, arguments) in SIGNATURES.items():
            function = getattr(found, name)
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        raise BurnishError(f"The Open Image Denoise library '{path}' can't be used: {error}") from error
    return found


def never() -> bool:
    """Return that nobody asks to stop."""
    return False


def denoise(library: ctypes.CDLL, images: Images, should_stop: Callable[[], bool] = never,
            processor: bool = False) -> str:
    """Filter `images.color` into `images.output` and return what did it: "cuda" or "cpu", "" where told to stop.

    Args:
        library: From `load`.
        images: On the processor or a CUDA device.
        should_stop: Polled often by the library's processor device, from its threads.
        processor: Use the library's processor device although the images are on a CUDA device.

    Raises:
        BurnishError: The library failed, on the processor too.
    """
    device = images.color.device
    with _lock:
        if device.is_cuda and not processor:
            try:
                keep_denoiser(library, device.ordinal, device.stream.cuda_stream or 0).run(images)
                return "cuda"
            except BurnishError as error:
                # A driver that is too old, no memory left: the processor makes the same picture, later.
                log.warning("%s Denoising on the processor instead.", error)
                drop_denoiser(library, device.ordinal, device.stream.cuda_stream or 0)
        kept = keep_denoiser(library, -1, 0)
        if not device.is_cuda:
            return "cpu" if kept.run(images, should_stop) else ""
        copies = Images(
            **{name: None if image is None else wp.array(image.numpy(), dtype=image.dtype, device="cpu")
               for name, image in (("color", images.color), ("output", images.output), ("albedo", images.albedo),
                                   ("normal", images.normal))},
            width=images.width, height=images.height, clean=images.clean, prefilter=images.prefilter)
        if not kept.run(copies, should_stop):
            return ""
        wp.copy(images.output, copies.output)
        for guide, filtered in ((images.albedo, copies.albedo), (images.normal, copies.normal)):
            if images.prefilter and guide is not None:
                wp.copy(guide, filtered)
        return "cpu"


def keep_denoiser(library: ctypes.CDLL, ordinal: int, stream: int) -> Denoiser:
    """Return the denoiser of a CUDA device and stream, or with -1 of the processor; made when first asked for."""
    key = library._name, ordinal, stream
    if key not in _kept:
        if not _kept:
            atexit.register(release)
        _kept[key] = Denoiser(library, ordinal, stream)
    return _kept[key]


def drop_denoiser(library: ctypes.CDLL, ordinal: int, stream: int) -> None:
    """Release the denoiser of a CUDA device and stream, if there is one."""
    denoiser = _kept.pop((library._name, ordinal, stream), None)
    if denoiser is not None:
        denoiser.release()


def release() -> None:
    """Release all devices and filters; the next picture makes them anew."""
    with _lock:
        while _kept:
            _kept.popitem()[1].release()
        atexit.unregister(release)


class Denoiser:
    """A device of the library and its filter, set up for the size and guides of the newest picture."""

    def __init__(self, library: ctypes.CDLL, ordinal: int, stream: int):
        """Make the device: the CUDA device of Warp's `stream`, or with -1 the processor.

        Raises:
            BurnishError: There is none.
        """
        self.library = library
        self._filters: dict[str, tuple[tuple, int]] = {}
        """Of the picture and of each guide: what a filter was made for, and its handle"""
        if ordinal < 0:
            self._device = library.oidnNewDevice(DEVICE_CPU)
            if self._device:
                # Pinned threads would stay in the way of the renderer's own.
                library.oidnSetDeviceBool(self._device, b"setAffinity", False)
        else:
            self._device = library.oidnNewCUDADevice(
                ctypes.byref(ctypes.c_int(ordinal)), ctypes.byref(ctypes.c_void_p(stream)), 1)
        try:
            # Without a device the error is that of its creation.
            if self._device:
                library.oidnCommitDevice(self._device)
            self._check()
            if not self._device:
                raise BurnishError("Open Image Denoise failed: no device.")
        except BurnishError:
            self.release()
            raise

    def _check(self) -> bool:
        """Return whether the library went through; not if it was told to stop."""
        message = ctypes.c_char_p()
        code = self.library.oidnGetDeviceError(self._device, ctypes.byref(message))
        if code and code != CANCELLED:
            reason = (message.value or b"unknown error").decode(errors="replace").rstrip(".")
            raise BurnishError(f"Open Image Denoise failed: {reason}.")
        return code == 0

    def run(self, images: Images, should_stop: Callable[[], bool] | None = None) -> bool:
        """Filter a picture and wait for it; first its guides, in place, if they are to be. False if told to stop.

        Raises:
            BurnishError: The library failed.
        """
        used = {"color": images.color, "output": images.output}
        if images.albedo is not None:
            used["albedo"] = images.albedo
            if images.normal is not None:
                used["normal"] = images.normal
        monitor = _Monitor() if should_stop is None else _Monitor(lambda _, __: not should_stop())
        if images.prefilter:
            for name in used.keys() & {"albedo", "normal"}:
                if not self._execute(name, {name: used[name], "output": used[name]}, images, (), monitor):
                    return False
        clean = "normal" in used and (images.clean or images.prefilter)
        return self._execute("color", used, images, (b"hdr", b"cleanAux") if clean else (b"hdr",), monitor)

    def _execute(self, kind: str, used: dict[str, wp.array], images: Images, switches: tuple[bytes, ...],
                 monitor: Any) -> bool:
        """Run the filter of a kind of picture over arrays, by the library's names, with some switches on."""
        library = self.library
        made_for = images.width, images.height, tuple(used), switches
        if self._filters.get(kind, ((), 0))[0] != made_for:
            self._release_filter(kind)
            handle = library.oidnNewFilter(self._device, b"RT")
            self._check()
            self._filters[kind] = made_for, handle
            for switch in switches:
                library.oidnSetFilterBool(handle, switch, True)
            if kind != "color":
                library.oidnSetFilterInt(handle, b"quality", QUALITY_BALANCED)
        handle = self._filters[kind][1]
        for name, image in used.items():
            stride = 4 * (4 if image.dtype == wp.vec4 else 3)
            library.oidnSetSharedFilterImage(
                handle, name.encode(), image.ptr, FORMAT_FLOAT3, images.width, images.height, 0, stride,
                stride * images.width)
        library.oidnSetFilterProgressMonitorFunction(handle, monitor, None)
        library.oidnCommitFilter(handle)
        library.oidnExecuteFilter(handle)
        return self._check()

    def _release_filter(self, kind: str) -> None:
        if kind in self._filters:
            self.library.oidnReleaseFilter(self._filters.pop(kind)[1])

    def release(self) -> None:
        """Give everything back."""
        for kind in list(self._filters):
            self._release_filter(kind)
        if self._device:
            self.library.oidnReleaseDevice(self._device)
        self._device = None
