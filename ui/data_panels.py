# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of lamps, objects and view layers. Settings that Cycles has too are Cycles' own, so that files are shared."""

from __future__ import annotations

from typing import Any

from bl_ui.properties_view_layer import ViewLayerAOVPanelHelper, ViewLayerCryptomattePanelHelper
from bpy.types import Panel

from .panel import BurnishPanel, draw_node_input

__all__ = ["classes"]

DRAWN_TYPES = {'MESH', 'CURVE', 'SURFACE', 'META', 'FONT', 'LIGHT'}


class LightPanel(BurnishPanel):
    """Panel of a lamp."""

    bl_context = "data"

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show for lamps."""
        return bool(context.light) and super().poll(context)


class BURNISH_LIGHT_PT_light(LightPanel, Panel):
    """A lamp's colour, power and shape."""

    bl_label = "Light"

    def draw(self, context: Any) -> None:
        """Draw."""
        light = context.light
        self.layout.row().prop(light, "type", expand=True)
        layout = self.split_layout()
        row = layout.row(align=True, heading="Temperature")
        row.prop(light, "use_temperature", text="")
        sub = row.row()
        sub.active = light.use_temperature
        sub.prop(light, "temperature", text="")
        layout.prop(light, "color", text="Tint" if light.use_temperature else "Color")
        column = layout.column()
        column.prop(light, "energy", text="Strength" if light.type == 'SUN' else "Power")
        column.prop(light, "exposure")
        column.prop(light, "normalize")
        self._draw_shape(layout.column(), light)

    @staticmethod
    def _draw_shape(column: Any, light: Any) -> None:
        if light.type in {'POINT', 'SPOT'}:
            column.prop(light, "shadow_soft_size", text="Radius")
            column.prop(light, "use_soft_falloff")
        elif light.type == 'SUN':
            column.prop(light, "angle")
        elif light.type == 'AREA':
            column.prop(light, "shape")
            sides = column.column(align=True)
            two = light.shape in {'RECTANGLE', 'ELLIPSE'}
            sides.prop(light, "size", text="Size X" if two else "Size")
            if two:
                sides.prop(light, "size_y", text="Y")


class BURNISH_LIGHT_PT_beam(LightPanel, Panel):
    """Where a lamp shines to."""

    bl_label = "Beam Shape"
    bl_parent_id = "BURNISH_LIGHT_PT_light"

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show for lamps that have one."""
        return super().poll(context) and context.light.type in {'SPOT', 'AREA'}

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, light = self.split_layout(), context.light
        if light.type == 'AREA':
            layout.prop(light, "spread")
            return
        layout.prop(light, "spot_size", text="Angle")
        layout.prop(light, "spot_blend", text="Blend", slider=True)
        layout.prop(light, "show_cone")


class BURNISH_LIGHT_PT_settings(LightPanel, Panel):
    """How a lamp is sampled."""

    bl_label = "Settings"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, light = self.split_layout(), context.light
        layout.prop(light, "use_shadow", text="Cast Shadow")
        if hasattr(light, "cycles"):
            layout.prop(light.cycles, "use_multiple_importance_sampling", text="Multiple Importance")


class BURNISH_LIGHT_PT_nodes(LightPanel, Panel):
    """A lamp's nodes."""

    bl_label = "Nodes"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw."""
        draw_node_input(self.split_layout(), context.light, "Surface")


class BURNISH_OBJECT_PT_visibility(BurnishPanel, Panel):
    """Where an object is seen."""

    bl_label = "Visibility"
    bl_context = "object"
    bl_options = {'DEFAULT_CLOSED'}

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show for objects."""
        return bool(context.object) and super().poll(context)

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, item = self.split_layout(), context.object
        layout.prop(item, "hide_select", text="Selectable", invert_checkbox=True, toggle=False)
        column = layout.column(heading="Show In")
        column.prop(item, "hide_viewport", text="Viewports", invert_checkbox=True, toggle=False)
        column.prop(item, "hide_render", text="Renders", invert_checkbox=True, toggle=False)
        if item.type in DRAWN_TYPES and item.type != 'LIGHT':
            layout.column(heading="Mask").prop(item, "is_holdout")


class BURNISH_OBJECT_PT_ray_visibility(BurnishPanel, Panel):
    """Which rays see an object."""

    bl_label = "Ray Visibility"
    bl_parent_id = "BURNISH_OBJECT_PT_visibility"
    bl_context = "object"

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show for what is drawn."""
        return bool(context.object) and context.object.type in DRAWN_TYPES and super().poll(context)

    def draw(self, context: Any) -> None:
        """Draw."""
        column, item = self.split_layout().column(), context.object
        for name in ("camera", "diffuse", "glossy", "transmission"):
            column.prop(item, f"visible_{name}", text=name.title())
        if item.type != 'LIGHT':
            column.prop(item, "visible_shadow", text="Shadow")


class BURNISH_VIEWLAYER_PT_passes(BurnishPanel, Panel):
    """Passes of a view layer."""

    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: Any) -> None:
        """Draw nothing: the panels below do."""


class BURNISH_VIEWLAYER_PT_passes_data(BurnishPanel, Panel):
    """Passes of geometry."""

    bl_label = "Data"
    bl_context = "view_layer"
    bl_parent_id = "BURNISH_VIEWLAYER_PT_passes"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, layer = self.split_layout(), context.view_layer
        column = layout.column(heading="Include", align=True)
        for name in ("combined", "z", "mist", "position", "normal", "vector", "uv"):
            column.prop(layer, f"use_pass_{name}")
        column = layout.column(heading="Indexes", align=True)
        column.prop(layer, "use_pass_object_index")
        column.prop(layer, "use_pass_material_index")


class BURNISH_VIEWLAYER_PT_passes_light(BurnishPanel, Panel):
    """Passes of light."""

    bl_label = "Light"
    bl_context = "view_layer"
    bl_parent_id = "BURNISH_VIEWLAYER_PT_passes"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, layer = self.split_layout(), context.view_layer
        for lobe in ("diffuse", "glossy", "transmission"):
            column = layout.column(heading=lobe.title(), align=True)
            for name in ("direct", "indirect", "color"):
                column.prop(layer, f"use_pass_{lobe}_{name}", text=name.title())
        # Blender keeps some switches in Cycles' settings, which are there while that is enabled.
        cycles = getattr(layer, "cycles", None)
        if cycles is not None:
            column = layout.column(heading="Volume", align=True)
            for name in ("direct", "indirect"):
                column.prop(cycles, f"use_pass_volume_{name}", text=name.title())
        column = layout.column(heading="Other", align=True)
        column.prop(layer, "use_pass_emit", text="Emission")
        column.prop(layer, "use_pass_environment")
        column.prop(layer, "use_pass_ambient_occlusion", text="Ambient Occlusion")
        column.prop(layer, "use_pass_shadow")
        if cycles is not None:
            column.prop(cycles, "use_pass_shadow_catcher", text="Shadow Catcher")


class BURNISH_VIEWLAYER_PT_passes_cryptomatte(BurnishPanel, ViewLayerCryptomattePanelHelper, Panel):
    """Passes of coverage by things."""

    bl_label = "Cryptomatte"
    bl_context = "view_layer"
    bl_parent_id = "BURNISH_VIEWLAYER_PT_passes"


class BURNISH_VIEWLAYER_PT_passes_aov(BurnishPanel, ViewLayerAOVPanelHelper, Panel):
    """Passes of AOV Output nodes."""

    bl_label = "Shader AOV"
    bl_context = "view_layer"
    bl_parent_id = "BURNISH_VIEWLAYER_PT_passes"


classes = (
    BURNISH_LIGHT_PT_light,
    BURNISH_LIGHT_PT_beam,
    BURNISH_LIGHT_PT_settings,
    BURNISH_LIGHT_PT_nodes,
    BURNISH_OBJECT_PT_visibility,
    BURNISH_OBJECT_PT_ray_visibility,
    BURNISH_VIEWLAYER_PT_passes,
    BURNISH_VIEWLAYER_PT_passes_data,
    BURNISH_VIEWLAYER_PT_passes_light,
    BURNISH_VIEWLAYER_PT_passes_cryptomatte,
    BURNISH_VIEWLAYER_PT_passes_aov,
)
