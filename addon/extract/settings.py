# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's properties to RenderSettings.

Reads `scene.burnish`, whose groups are made from the same dataclasses; without it (the add-on isn't registered)
every setting has its default. What Blender already has a property for is read from there: film transparency.
"""

from __future__ import annotations

import enum
from dataclasses import is_dataclass, replace
from typing import Any, get_type_hints

import bpy
import numpy as np

from ...engine import settings as engine_settings
from ...engine.presets import apply_preset
from ...engine.settings import RenderSettings, setting_info

__all__ = ["settings_from_scene"]


def settings_from_scene(scene: bpy.types.Scene, viewport: bool) -> RenderSettings:
    """Return the settings of `scene`.

    Args:
        scene: Original or evaluated scene.
        viewport: Put `sampling.viewport_samples` into `sampling.samples` too, so that a session has one number to
            obey. There 0 means no limit. And apply `sampling.viewport_preset`.
    """
    settings = _read_group(getattr(scene, "burnish", None), RenderSettings)
    film = replace(settings.film, transparent=bool(scene.render.film_transparent))
    sampling = settings.sampling
    if viewport:
        sampling = replace(sampling, samples=sampling.viewport_samples)
        settings = apply_preset(settings, sampling.viewport_preset)
    return replace(settings, film=film, sampling=sampling)


def _read_group(group: Any, settings_class: type) -> Any:
    """Return an instance of `settings_class` with the values of a property group (None or partial: defaults)."""
    hints = get_type_hints(settings_class, vars(engine_settings))
    values = {}
    for name, info in setting_info(settings_class).items():
        kind = hints[name]
        if is_dataclass(kind):
            values[name] = _read_group(getattr(group, name, None), kind)
        elif hasattr(group, name):
            values[name] = _read_value(getattr(group, name), kind, info.metadata)
    return settings_class(**values)


def _read_value(value: Any, kind: type, limits: Any) -> Any:
    """Return `value` as the setting's own type, within its hard range."""
    if issubclass(kind, enum.Enum):
        # Blender's enum identifiers may be names or values.
        return kind[value] if value in kind.__members__ else kind(value)
    if limits.get("choices"):
        # Blender has 'NONE' for the empty text.
        return value if value in limits["choices"] else ""
    # Blender keeps single precision: 0.3 comes back as 0.30000001; the shortest text of that number is what was set.
    value = float(str(np.float32(value))) if kind is float else kind(value)
    if limits.get("low") is not None:
        value = max(value, limits["low"])
    if limits.get("high") is not None:
        value = min(value, limits["high"])
    return value
