# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of the render tab for both integrators: light paths, simplification, motion blur, film, performance."""

from __future__ import annotations

from typing import Any

from bpy.types import Panel

from .panel import BurnishPanel

__all__ = ["classes"]

SHUTTER_SHAPES = {'SMOOTHCURVE': 'SMOOTH', 'SPHERECURVE': 'ROUND', 'ROOTCURVE': 'ROOT', 'SHARPCURVE': 'SHARP',
                  'LINCURVE': 'LINE', 'NOCURVE': 'MAX'}
"""Blender's ready-made curves by their icons"""


class BURNISH_RENDER_PT_light_paths(BurnishPanel, Panel):
    """How long light is followed."""

    bl_label = "Light Paths"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, paths = self.split_layout(), context.scene.burnish.light_paths
        layout.prop(paths, "max_bounces")
        layout.prop(paths, "roulette_start")


class BURNISH_RENDER_PT_light_paths_clamping(BurnishPanel, Panel):
    """Limits on single samples."""

    bl_label = "Clamping"
    bl_parent_id = "BURNISH_RENDER_PT_light_paths"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, paths = self.split_layout(), context.scene.burnish.light_paths
        column = layout.column(align=True)
        column.prop(paths, "clamp_direct", text="Direct Light")
        column.prop(paths, "clamp_indirect", text="Indirect Light")


class BURNISH_RENDER_PT_simplify(BurnishPanel, Panel):
    """Blender's own simplification, which it applies before the scene is read."""

    bl_label = "Simplify"
    bl_options = {'DEFAULT_CLOSED'}

    def draw_header(self, context: Any) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.render, "use_simplify", text="")

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, render = self.split_layout(), context.scene.render
        layout.active = render.use_simplify
        for heading, suffix in (("Viewport", ""), ("Render", "_render")):
            column = layout.column(heading=heading)
            column.prop(render, f"simplify_subdivision{suffix}", text="Max Subdivision")
            column.prop(render, f"simplify_child_particles{suffix}", text="Child Particles")


class BURNISH_RENDER_PT_motion_blur(BurnishPanel, Panel):
    """The shutter of final renders, as Blender's other engines have it."""

    bl_label = "Motion Blur"
    bl_options = {'DEFAULT_CLOSED'}

    def draw_header(self, context: Any) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, render = self.split_layout(), context.scene.render
        layout.active = render.use_motion_blur
        layout.prop(render, "motion_blur_position", text="Position")
        layout.prop(render, "motion_blur_shutter")
        layout.prop(context.scene.burnish.sampling, "motion_steps", text="Steps")
        if hasattr(context.view_layer, "use_motion_blur"):
            layout.prop(context.view_layer, "use_motion_blur", text="In This View Layer")


class BURNISH_RENDER_PT_motion_blur_curve(BurnishPanel, Panel):
    """How the shutter opens and closes."""

    bl_label = "Shutter Curve"
    bl_parent_id = "BURNISH_RENDER_PT_motion_blur"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, render = self.split_layout(), context.scene.render
        layout.active = render.use_motion_blur
        layout.template_curve_mapping(render, "motion_blur_shutter_curve")
        row = layout.row(align=True)
        for icon, shape in SHUTTER_SHAPES.items():
            row.operator("render.shutter_curve_preset", icon=icon, text="").shape = shape


class BURNISH_RENDER_PT_film(BurnishPanel, Panel):
    """How samples become pixels."""

    bl_label = "Film"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw."""
        layout = self.split_layout()
        layout.prop(context.scene.burnish.film, "exposure")
        layout.prop(context.scene.render, "film_transparent", text="Transparent")


class BURNISH_RENDER_PT_film_filter(BurnishPanel, Panel):
    """Reconstruction filter."""

    bl_label = "Pixel Filter"
    bl_parent_id = "BURNISH_RENDER_PT_film"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, film = self.split_layout(), context.scene.burnish.film
        layout.prop(film, "pixel_filter", text="Type")
        if film.pixel_filter != 'BOX':
            layout.prop(film, "filter_width", text="Width")


class BURNISH_RENDER_PT_performance(BurnishPanel, Panel):
    """What the machine may spend."""

    bl_label = "Performance"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw."""
        layout = self.split_layout()
        performance = context.scene.burnish.performance
        layout.prop(performance, "instancing_threshold")
        layout.prop(performance, "opacity_maps")
        layout.prop(performance, "deterministic")
        layout.prop(context.scene.render, "use_persistent_data", text="Persistent Data")
        layout.operator("burnish.warm_up", icon='SHADERFX')


class BURNISH_RENDER_PT_performance_viewport(BurnishPanel, Panel):
    """Speed of the viewport."""

    bl_label = "Viewport"
    bl_parent_id = "BURNISH_RENDER_PT_performance"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, performance = self.split_layout(), context.scene.burnish.performance
        layout.prop(performance, "viewport_pixel_size", text="Pixel Size")
        column = layout.column()
        column.active = performance.viewport_pixel_size == 0
        column.prop(performance, "frame_time")


class BURNISH_RENDER_PT_performance_textures(BurnishPanel, Panel):
    """Memory for textures."""

    bl_label = "Textures"
    bl_parent_id = "BURNISH_RENDER_PT_performance"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, performance = self.split_layout(), context.scene.burnish.performance
        layout.prop(performance, "texture_budget", text="Budget (MiB)")
        layout.prop(performance, "texture_size_limit", text="Size Limit")


classes = (
    BURNISH_RENDER_PT_light_paths,
    BURNISH_RENDER_PT_light_paths_clamping,
    BURNISH_RENDER_PT_simplify,
    BURNISH_RENDER_PT_motion_blur,
    BURNISH_RENDER_PT_motion_blur_curve,
    BURNISH_RENDER_PT_film,
    BURNISH_RENDER_PT_film_filter,
    BURNISH_RENDER_PT_performance,
    BURNISH_RENDER_PT_performance_viewport,
    BURNISH_RENDER_PT_performance_textures,
)
