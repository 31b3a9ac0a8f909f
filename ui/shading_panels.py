# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of materials and worlds, and of the viewport's shading popover."""

from __future__ import annotations

from typing import Any

from bpy.types import Panel

from .panel import BurnishPanel, draw_node_input

__all__ = ["classes"]


class MaterialPanel(BurnishPanel):
    """A panel of a material that is no grease pencil's."""

    bl_context = "material"

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show for surface materials."""
        material = context.material
        return bool(material) and not material.grease_pencil and super().poll(context)


class BURNISH_MATERIAL_PT_surface(MaterialPanel, Panel):
    """A material's surface."""

    bl_label = "Surface"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout = self.split_layout()
        if not draw_node_input(layout, context.material, "Surface"):
            layout.prop(context.material, "diffuse_color")


class BURNISH_MATERIAL_PT_settings(MaterialPanel, Panel):
    """A material's settings."""

    bl_label = "Settings"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, material = self.split_layout(), context.material
        layout.prop(material, "pass_index")
        if hasattr(material, "cycles"):
            layout.prop(material.cycles, "emission_sampling")


class WorldPanel(BurnishPanel):
    """A panel of a world."""

    bl_context = "world"

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show for worlds."""
        return bool(context.world) and super().poll(context)


class BURNISH_WORLD_PT_preview(WorldPanel, Panel):
    """A world's preview."""

    bl_label = "Preview"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw."""
        self.layout.template_preview(context.world)


class BURNISH_WORLD_PT_surface(WorldPanel, Panel):
    """A world's surface."""

    bl_label = "Surface"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout = self.split_layout()
        if not draw_node_input(layout, context.world, "Surface"):
            layout.prop(context.world, "color")


class BURNISH_WORLD_PT_ray_visibility(WorldPanel, Panel):
    """Which rays see a world."""

    bl_label = "Ray Visibility"
    bl_options = {'DEFAULT_CLOSED'}

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show where Cycles' settings exist."""
        return super().poll(context) and hasattr(context.world, "cycles_visibility")

    def draw(self, context: Any) -> None:
        """Draw."""
        column = self.split_layout().column()
        for name in ("camera", "diffuse", "glossy", "transmission"):
            column.prop(context.world.cycles_visibility, name)


class BURNISH_WORLD_PT_occlusion(WorldPanel, Panel):
    """How far a world's Ambient Occlusion pass looks."""

    bl_label = "Ambient Occlusion Pass"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw."""
        self.split_layout().prop(context.world.light_settings, "distance")


class BURNISH_VIEW3D_PT_lighting(Panel):
    """The popover's lighting: shown, so that it is clear what is not followed."""

    bl_label = "Lighting"
    bl_space_type = 'VIEW_3D'
    bl_region_type = 'HEADER'
    bl_parent_id = 'VIEW3D_PT_shading'
    COMPAT_ENGINES = BurnishPanel.COMPAT_ENGINES

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show in rendered shading."""
        return context.engine in cls.COMPAT_ENGINES and context.space_data.shading.type == 'RENDERED'

    def draw(self, context: Any) -> None:
        """Draw."""
        column = self.layout.column()
        column.prop(context.space_data.shading, "use_scene_lights_render")
        column.prop(context.space_data.shading, "use_scene_world_render")


classes = (
    BURNISH_MATERIAL_PT_surface,
    BURNISH_MATERIAL_PT_settings,
    BURNISH_WORLD_PT_preview,
    BURNISH_WORLD_PT_surface,
    BURNISH_WORLD_PT_ray_visibility,
    BURNISH_WORLD_PT_occlusion,
    BURNISH_VIEW3D_PT_lighting,
)
