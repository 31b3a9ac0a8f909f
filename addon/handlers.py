# SPDX-License-Identifier: GPL-3.0-or-later
"""Application handlers: stop workers before a file is loaded and at exit; drop what undo may have replaced.

None of them does anything before the engine is wanted, and there is no depsgraph handler.
"""

from __future__ import annotations

import atexit
import sys
from typing import Any

import bpy
from bpy.app.handlers import persistent

from . import compat, early_import, report

__all__ = ["register", "stop_viewports", "unregister"]


def _viewports() -> Any:
    """Return the viewport module if something has rendered in a viewport, else None."""
    return sys.modules.get(f"{__package__}.viewport")


def release_denoiser() -> None:
    """Give back what the final denoiser keeps, if there was one."""
    denoiser = sys.modules.get(f"{__package__}.oidn")
    if denoiser is not None:
        denoiser.release()


def stop_viewports() -> None:
    """Stop all viewports and wait for their threads."""
    viewport = _viewports()
    if viewport is not None:
        viewport.stop_all()


@persistent
def before_load(*_: Any) -> None:
    """Stop everything: the data that viewports refer to is about to go."""
    stop_viewports()
    report.clear()


@persistent
def after_undo(*_: Any) -> None:
    """Make viewports read the whole scene again: undo replaces data-blocks."""
    viewport = _viewports()
    if viewport is not None:
        viewport.forget_scenes()


@persistent
def before_exit(*_: Any) -> None:
    """Stop the worker threads while the interpreter still lives."""
    early_import.stop()
    stop_viewports()
    release_denoiser()


def _handlers() -> list[tuple[list[Any], Any]]:
    handlers = bpy.app.handlers
    pairs = [(handlers.load_pre, before_load), (handlers.undo_post, after_undo), (handlers.redo_post, after_undo)]
    if not bpy.app.background:
        pairs.append((handlers.load_post, early_import.after_load))
    exit_list = compat.exit_handlers()
    if exit_list is not None:
        pairs.append((exit_list, before_exit))
    return pairs


def register() -> None:
    """Add the handlers."""
    for handlers, function in _handlers():
        if function not in handlers:
            handlers.append(function)
    atexit.register(at_interpreter_exit)


def at_interpreter_exit() -> None:
    """Stop the threads where bpy is a module: there Blender's exit comes after Python's modules are taken apart."""
    stop_viewports()
    unregister()


def unregister() -> None:
    """Remove the handlers and what they look after."""
    release_denoiser()
    for handlers, function in _handlers():
        if function in handlers:
            handlers.remove(function)
    atexit.unregister(at_interpreter_exit)
