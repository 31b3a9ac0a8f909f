# SPDX-License-Identifier: GPL-3.0-or-later
"""The host side: everything that touches Blender, except panels. Registers and unregisters all of it, in order.

Imports happen inside the functions, so that importing the package (for `burnish.engine`) never loads bpy.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["register", "registered", "unregister"]


def register() -> None:
    """Register the engine, its settings, panels, preferences, handlers and command with Blender."""
    from .. import ui
    from . import cli, early_import, handlers, preferences, render_engine, services

    ui.register(services.make_services())
    preferences.register()
    render_engine.register()
    handlers.register()
    early_import.register()
    cli.register()


def unregister() -> None:
    """Undo `register`, in reverse, and stop everything that still runs."""
    from .. import ui
    from . import cli, early_import, handlers, preferences, render_engine

    cli.unregister()
    early_import.unregister()
    handlers.unregister()
    render_engine.unregister()
    preferences.unregister()
    ui.unregister()


@contextmanager
def registered(in_blender: bool) -> Iterator[None]:
    """Have the add-on registered inside; in a Blender where it is that changes nothing."""
    if in_blender:
        yield
        return
    register()
    try:
        yield
    finally:
        # Blender may hang or crash at exit while a Python RenderEngine that has rendered is registered.
        unregister()
