# SPDX-License-Identifier: GPL-3.0-or-later
"""Presets in panels: the operator that applies one to the scene, and which one the scene's settings are."""

from __future__ import annotations

import enum
from typing import Any

import bpy

from ..engine.presets import matching_preset, preset_values, write_values
from ..engine.settings import Preset
from .properties import enum_items, title

__all__ = ["BURNISH_OT_apply_preset", "classes", "current_preset", "draw_presets"]

# Not in the annotation: before Python 3.12 Blender can't evaluate one that has a loop.
CHOICES = [item for item in enum_items(Preset) if item[0] != Preset.CUSTOM.name]


def current_preset(settings: Any) -> Preset:
    """Return the preset that a scene's settings (`scene.burnish`) are, Preset.CUSTOM for none."""
    values = {}
    for path, default in preset_values(Preset.BALANCED).items():
        group, name = path.split(".")
        value = getattr(getattr(settings, group), name)
        if isinstance(default, enum.Enum):
            value = type(default)[value]
        elif isinstance(default, float):
            # Blender keeps single precision.
            value = float(f"{value:.6g}")
        values[path] = value
    return matching_preset(values)


def draw_presets(layout: Any, context: Any) -> None:
    """Draw the menu of presets, under the name of the one in use."""
    name = title(current_preset(context.scene.burnish).name)
    layout.operator_menu_enum("burnish.apply_preset", "preset", text=f"Preset: {name}")


class BURNISH_OT_apply_preset(bpy.types.Operator):
    """Set all settings of the real-time integrator."""

    bl_idname = "burnish.apply_preset"
    bl_label = "Apply Preset"
    bl_description = "Set probes, cache, direct light, reflections and denoiser of this scene; samples stay"
    bl_options = {'REGISTER', 'UNDO'}

    preset: bpy.props.EnumProperty(name="Preset", items=CHOICES)

    def execute(self, context: Any) -> set[str]:
        """Set."""
        write_values(context.scene.burnish, preset_values(Preset[self.preset]))
        return {'FINISHED'}


classes = (BURNISH_OT_apply_preset,)
