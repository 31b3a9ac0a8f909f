# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports the engine while the user still looks at a scene that it will draw, so that the first picture does not wait.

Importing the kernels takes Python 1.5 to 4 s, as Warp parses each. It begins when a file is loaded whose scene has the
engine, or when somebody chooses it; without a window nobody would gain from it. Nothing is built, loaded or asked of
the device before a picture is wanted. The thread imports nothing that knows bpy.
"""

from __future__ import annotations

import importlib
import logging
import pkgutil
import threading
from collections.abc import Iterator
from typing import Any

import bpy
from bpy.app.handlers import persistent

from .render_engine import BurnishRenderEngine

__all__ = ["after_load", "begin", "register", "stop", "unregister"]

log = logging.getLogger(__name__)

_owner = object()
_stopping = threading.Event()
_thread: threading.Thread | None = None


def begin() -> None:
    """Begin to import the engine, once."""
    global _thread
    if _thread is None:
        _thread = threading.Thread(target=_import, name="burnish import")
        _thread.start()


def _modules() -> Iterator[str]:
    """Return what to import: the kernels one by one, so that it can be stopped, then what has the rest."""
    kernels = importlib.import_module("..kernels", __package__)
    yield from (f"..kernels.{module.name}" for module in pkgutil.iter_modules(kernels.__path__))
    yield from ("..engine.warmup", "..engine.session")


def _import() -> None:
    try:
        for name in _modules():
            if _stopping.is_set():
                return
            importlib.import_module(name, __package__)
    except Exception:
        # Whoever needs it will tell.
        log.debug("Importing ahead of time failed", exc_info=True)


def stop() -> None:
    """Import nothing further and wait for the module at work."""
    global _thread
    thread, _thread = _thread, None
    if thread is not None:
        _stopping.set()
        thread.join()
        _stopping.clear()


def _asked_for() -> None:
    """Begin if the window's scene has the engine."""
    scene = getattr(bpy.context, "scene", None)
    if scene is not None and scene.render.engine == BurnishRenderEngine.bl_idname:
        begin()


@persistent
def after_load(*_: Any) -> None:
    """Look at the scene of a file that was loaded."""
    _asked_for()


def register() -> None:
    """Notice when the engine is chosen; handlers.py notices files that are loaded."""
    if not bpy.app.background:
        bpy.msgbus.subscribe_rna(
            key=(bpy.types.RenderSettings, "engine"), owner=_owner, args=(), notify=_asked_for, options={'PERSISTENT'})


def unregister() -> None:
    """Notice no more, and wait for what has begun."""
    stop()
    bpy.msgbus.clear_by_owner(_owner)
