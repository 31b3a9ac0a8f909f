# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties, panels and operators: what the user sees. Imports bpy, engine.settings and engine.presets only."""

from __future__ import annotations

from typing import Any

__all__ = ["register", "unregister"]


def _classes() -> tuple[type, ...]:
    from . import (
        data_panels,
        light_group_panels,
        operators,
        presets,
        realtime_panels,
        render_panels,
        report_panels,
        sampling_panels,
        shading_panels,
    )

    return (*operators.classes, *presets.classes, *sampling_panels.classes, *realtime_panels.classes,
            *render_panels.classes, *report_panels.classes, *data_panels.classes, *light_group_panels.classes,
            *shading_panels.classes)


def register(services: Any) -> None:
    """Register everything; `services` (a services.Services) is what the panels ask of the host side."""
    import bpy

    from . import panel, properties
    from .services import install

    install(services)
    properties.register()
    for cls in _classes():
        bpy.utils.register_class(cls)
    for foreign in panel.foreign_panels():
        foreign.COMPAT_ENGINES.add(panel.ENGINE)


def unregister() -> None:
    """Undo `register`, in reverse."""
    import bpy

    from . import panel, properties
    from .services import install

    for foreign in panel.foreign_panels():
        foreign.COMPAT_ENGINES.discard(panel.ENGINE)
    for cls in reversed(_classes()):
        bpy.utils.unregister_class(cls)
    properties.unregister()
    install(None)
