# SPDX-License-Identifier: GPL-3.0-or-later
"""Open Image Denoise, from the library that Blender itself ships: a last filter over final renders, if asked for.

Called through ctypes: the extension ships no second copy, which could clash with Blender's. The C interface is that of
version 2 (OpenImageDenoise/oidn.h); other versions count as absent.
"""

from __future__ import annotations

import ctypes
import functools
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

from ..engine.errors import BurnishError

__all__ = ["denoise", "library"]

DEVICE_CPU = 1
FORMAT_FLOAT3 = 3

NAMES = {"linux": "libOpenImageDenoise.so.2", "darwin": "libOpenImageDenoise.dylib", "win32": "OpenImageDenoise.dll"}

SIGNATURES = {
    "oidnNewDevice": (ctypes.c_void_p, [ctypes.c_int]),
    "oidnCommitDevice": (None, [ctypes.c_void_p]),
    "oidnReleaseDevice": (None, [ctypes.c_void_p]),
    "oidnGetDeviceError": (ctypes.c_int, [ctypes.c_void_p, ctypes.POINTER(ctypes.c_char_p)]),
    "oidnNewFilter": (ctypes.c_void_p, [ctypes.c_void_p, ctypes.c_char_p]),
    "oidnSetSharedFilterImage": (None, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p, ctypes.c_int,
                                        *[ctypes.c_size_t] * 5]),
    "oidnSetFilterBool": (None, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_bool]),
    "oidnCommitFilter": (None, [ctypes.c_void_p]),
    "oidnExecuteFilter": (None, [ctypes.c_void_p]),
    "oidnReleaseFilter": (None, [ctypes.c_void_p]),
}
"""Result and argument types of the functions that are used."""


def candidates() -> Iterator[Path]:
    """Yield where Blender may keep the library, as a program and as a Python module."""
    name = NAMES.get(sys.platform, NAMES["linux"])
    # The folder of a version ("5.2") lies beside `lib`, in the Python module too.
    root = Path(bpy.utils.resource_path('LOCAL')).parent
    yield root / "lib" / name
    if bpy.app.binary_path:
        program = Path(bpy.app.binary_path).parent
        yield program / "lib" / name
        yield program / "blender.shared" / name


@functools.cache
def library() -> ctypes.CDLL | None:
    """Return the library, ready to be called; None where there is none."""
    for path in candidates():
        if path.is_file():
            try:
                found = ctypes.CDLL(str(path))
                for name, (result, arguments) in SIGNATURES.items():
                    function = getattr(found, name)
                    function.restype, function.argtypes = result, arguments
            except (OSError, AttributeError):
                continue
            return found
    return None


def denoise(pixels: np.ndarray, albedo: np.ndarray | None = None, normal: np.ndarray | None = None) -> np.ndarray:
    """Return a picture with its noise filtered.

    Args:
        pixels: float32 [h, w, 3 or more], scene-linear; channels after the third stay as they are.
        albedo: float32 [h, w, 3] of what is seen, 0..1: keeps textures sharp.
        normal: float32 [h, w, 3]: keeps edges sharp; only used with an albedo.

    Raises:
        BurnishError: There is no library, or it failed.
    """
    oidn = library()
    if oidn is None:
        raise BurnishError("This Blender has no Open Image Denoise library; switch off Denoise in Sampling > Render.")
    height, width = pixels.shape[:2]
    images = {"color": pixels[..., :3]}
    if albedo is not None:
        images["albedo"] = np.clip(albedo[..., :3], 0.0, 1.0)
        if normal is not None:
            images["normal"] = normal[..., :3]
    # The library reads these until the filter is released.
    images = {name: np.ascontiguousarray(np.nan_to_num(image), np.float32) for name, image in images.items()}
    images["output"] = np.empty_like(images["color"])
    device = oidn.oidnNewDevice(DEVICE_CPU)
    oidn.oidnCommitDevice(device)
    handle = oidn.oidnNewFilter(device, b"RT")
    for name, image in images.items():
        oidn.oidnSetSharedFilterImage(
            handle, name.encode(), image.ctypes.data, FORMAT_FLOAT3, width, height, 0, 0, 0)
    oidn.oidnSetFilterBool(handle, b"hdr", True)
    oidn.oidnCommitFilter(handle)
    oidn.oidnExecuteFilter(handle)
    message = ctypes.c_char_p()
    failed = oidn.oidnGetDeviceError(device, ctypes.byref(message))
    reason = (message.value or b"").decode(errors="replace")
    oidn.oidnReleaseFilter(handle)
    oidn.oidnReleaseDevice(device)
    if failed:
        raise BurnishError(f"Open Image Denoise failed: {reason}.")
    result = np.array(pixels, np.float32)
    result[..., :3] = images["output"]
    return result
