# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of light groups: those of a view layer, and which of them an object's or the world's light is in."""

from __future__ import annotations

from typing import Any

from bl_ui.properties_view_layer import ViewLayerLightgroupsPanelHelper
from bpy.types import Panel

from .panel import BurnishPanel

__all__ = ["classes"]


def draw_choice(layout: Any, item: Any, view_layer: Any) -> None:
    """Draw the light group of an object or a world, and a button that makes it one of the view layer's."""
    row = layout.row(align=True)
    row.prop_search(item, "lightgroup", view_layer, "lightgroups", text="Light Group", results_are_suggestions=True)
    button = row.column(align=True)
    button.enabled = bool(item.lightgroup) and item.lightgroup not in {group.name for group in view_layer.lightgroups}
    button.operator("scene.view_layer_add_lightgroup", icon='ADD', text="").name = item.lightgroup


class BURNISH_VIEWLAYER_PT_passes_light_groups(BurnishPanel, ViewLayerLightgroupsPanelHelper, Panel):
    """The light groups that a view layer has passes of."""

    bl_label = "Light Groups"
    bl_context = "view_layer"
    bl_parent_id = "BURNISH_VIEWLAYER_PT_passes"

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show with the integrator that has them."""
        return super().poll(context) and context.scene.burnish.sampling.integrator == 'REFERENCE'


class BURNISH_OBJECT_PT_light_group(BurnishPanel, Panel):
    """The light group of what an object emits."""

    bl_label = "Light Group"
    bl_context = "object"
    bl_options = {'DEFAULT_CLOSED'}

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show for objects."""
        return bool(context.object) and super().poll(context)

    def draw(self, context: Any) -> None:
        """Draw."""
        draw_choice(self.split_layout(), context.object, context.view_layer)


class BURNISH_WORLD_PT_light_group(BurnishPanel, Panel):
    """The light group of the world."""

    bl_label = "Light Group"
    bl_context = "world"
    bl_options = {'DEFAULT_CLOSED'}

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show for worlds."""
        return bool(context.world) and super().poll(context)

    def draw(self, context: Any) -> None:
        """Draw."""
        draw_choice(self.split_layout(), context.world, context.view_layer)


classes = (
    BURNISH_VIEWLAYER_PT_passes_light_groups,
    BURNISH_OBJECT_PT_light_group,
    BURNISH_WORLD_PT_light_group,
)
