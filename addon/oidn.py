# SPDX-License-Identifier: GPL-3.0-or-later
"""Where Blender keeps its Open Image Denoise library, and final renders denoised by it."""

from __future__ import annotations

import ctypes
import functools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..engine import oidn
from ..engine.errors import BurnishError

__all__ = ["denoise", "library", "release"]

NAMES = {"linux": "libOpenImageDenoise.so.2", "darwin": "libOpenImageDenoise.dylib", "win32": "OpenImageDenoise.dll"}


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
    """Return the library, ready to be called; None where there is none that can be."""
    for path in candidates():
        if path.is_file():
            try:
                return oidn.load(path)
            except BurnishError:
                continue
    return None


def denoise(session: Any) -> np.ndarray:
    """Return the combined picture of an engine.session.Session denoised: float32 [h, w, 4], bottom row first.

    Raises:
        BurnishError: There is no library, or it failed.
    """
    found = library()
    if found is None:
        raise BurnishError("This Blender has no Open Image Denoise library; switch off Denoise in Sampling > Render.")
    return session.read_denoised(found)


def release() -> None:
    """Give back what the library keeps between pictures."""
    oidn.release()
