# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of the render tab for the real-time integrator: probes, cache, lights, reflections, denoiser, debug view."""

from __future__ import annotations

from typing import Any

from bpy.types import Panel

from .panel import BurnishPanel

__all__ = ["classes"]


class RealtimePanel(BurnishPanel):
    """A panel that shows with the real-time integrator only."""

    bl_options = {'DEFAULT_CLOSED'}

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show with our engine and the real-time integrator only."""
        return super().poll(context) and context.scene.burnish.sampling.integrator == 'REALTIME'


class BURNISH_RENDER_PT_probes(RealtimePanel, Panel):
    """Where diffuse light from all around is gathered."""

    bl_label = "Screen Probes"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, probes = self.split_layout(), context.scene.burnish.probes
        layout.prop(probes, "spawn_tile")
        layout.prop(probes, "dense_small", text="Dense Small Pictures")
        layout.prop(probes, "history")
        column = layout.column(heading="Rays")
        column.prop(probes, "guiding")
        column.prop(probes, "specular_rays")
        column.prop(probes, "update_interval")
        column.prop(probes, "half_rate")
        column = layout.column(heading="Light")
        column.prop(probes, "persistence")
        column.prop(probes, "filtering")
        column.prop(probes, "contact_detail")
        column.prop(probes, "energy_exact")


class BURNISH_RENDER_PT_cache(RealtimePanel, Panel):
    """Light at the points that rays hit."""

    bl_label = "Radiance Cache"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, cache = self.split_layout(), context.scene.burnish.cache
        column = layout.column(align=True)
        column.prop(cache, "cell_pixels")
        column.prop(cache, "minimum_cell")
        column.prop(cache, "refine")
        layout.prop(cache, "capacity")
        column = layout.column(align=True)
        column.prop(cache, "bounces")
        column.prop(cache, "bounce_share")
        column = layout.column(align=True)
        column.prop(cache, "sample_cap")
        column.prop(cache, "lifetime")


class BURNISH_RENDER_PT_cache_method(RealtimePanel, Panel):
    """Parts of the method that can be switched off to see what they do."""

    bl_label = "Method"
    bl_parent_id = "BURNISH_RENDER_PT_cache"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, cache = self.split_layout(), context.scene.burnish.cache
        layout.prop(cache, "key")
        layout.prop(cache, "scan_all")
        layout.prop(cache, "level_blend")
        layout.prop(cache, "cone_test")
        layout.prop(cache, "follow_mirrors")
        layout.prop(cache, "highlights")
        layout.prop(cache, "follow_shadows")
        layout.prop(cache, "ends_paths")


class BURNISH_RENDER_PT_direct_light(RealtimePanel, Panel):
    """Light from lamps, emissive surfaces and suns."""

    bl_label = "Direct Light"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, direct_light = self.split_layout(), context.scene.burnish.direct_light
        layout.prop(direct_light, "candidates")
        layout.prop(direct_light, "temporal_reuse")
        layout.prop(direct_light, "half_rate")
        column = layout.column()
        column.active = direct_light.half_rate
        column.prop(direct_light, "quarter_rate")
        layout.prop(direct_light, "clear_glass")


class BURNISH_RENDER_PT_reflections(RealtimePanel, Panel):
    """Glossy reflections and refraction, by roughness."""

    bl_label = "Reflections"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, reflections = self.split_layout(), context.scene.burnish.reflections
        layout.prop(reflections, "resolution")
        layout.prop(reflections, "half_rate")
        layout.prop(reflections, "bounces")
        column = layout.column(align=True)
        column.prop(reflections, "roughness_traced", text="Traced up to Roughness")
        column.prop(reflections, "roughness_weak", text="Weak Ones up to")
        column.prop(reflections, "roughness_diffuse", text="Diffuse from")
        column.prop(reflections, "roughness_blend", text="Blend")
        layout.prop(reflections, "subsurface")
        layout.prop(reflections, "hair")


class BURNISH_RENDER_PT_reflections_method(RealtimePanel, Panel):
    """Parts of the method that can be switched off to see what they do."""

    bl_label = "Method"
    bl_parent_id = "BURNISH_RENDER_PT_reflections"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, reflections = self.split_layout(), context.scene.burnish.reflections
        layout.prop(reflections, "screen_reuse")
        layout.prop(reflections, "hit_lighting")
        layout.prop(reflections, "jitter")


class BURNISH_RENDER_PT_denoiser(RealtimePanel, Panel):
    """Filters over frames and neighbouring pixels, and what happens at rest."""

    bl_label = "Denoiser"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, denoiser = self.split_layout(), context.scene.burnish.denoiser
        column = layout.column(align=True)
        column.prop(denoiser, "direct_iterations", text="Direct Passes")
        column.prop(denoiser, "direct_history", text="History")
        column = layout.column(align=True)
        column.prop(denoiser, "diffuse_radius", text="Indirect Radius")
        column.prop(denoiser, "diffuse_history", text="History")
        layout.prop(denoiser, "rest_gather", text="Gather at Rest")
        layout.prop(denoiser, "antialiasing", text="Anti-Aliasing")
        row = layout.row()
        row.active = denoiser.antialiasing
        row.prop(denoiser, "supersample_small", text="Supersample Small Pictures")
        layout.prop(denoiser, "depth_of_field", text="Depth of Field")


class BURNISH_RENDER_PT_denoiser_reflections(RealtimePanel, Panel):
    """Filters of reflections and refraction."""

    bl_label = "Reflections"
    bl_parent_id = "BURNISH_RENDER_PT_denoiser"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, denoiser = self.split_layout(), context.scene.burnish.denoiser
        column = layout.column(align=True)
        column.prop(denoiser, "reflection_iterations", text="Passes")
        column.prop(denoiser, "reflection_kernel", text="Kernel")
        column = layout.column(heading="Spatial")
        column.prop(denoiser, "reflection_ratio", text="Weigh by Ratio")
        column.prop(denoiser, "reflection_cleanup", text="Clean Up")
        layout.prop(denoiser, "reflection_temporal", text="Temporal")
        column = layout.column(align=True)
        column.active = denoiser.reflection_temporal
        column.prop(denoiser, "reflection_history", text="History")
        column.prop(denoiser, "reflection_clamp", text="Clamp")


class BURNISH_RENDER_PT_denoiser_rest(RealtimePanel, Panel):
    """What the time goes into once nothing moves."""

    bl_label = "Path Tracing at Rest"
    bl_parent_id = "BURNISH_RENDER_PT_denoiser"

    def draw_header(self, context: Any) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.burnish.denoiser, "path_traced_rest", text="")

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, denoiser = self.split_layout(), context.scene.burnish.denoiser
        layout.active = denoiser.path_traced_rest
        layout.prop(denoiser, "rest_frames", text="After Frames")


class BURNISH_RENDER_PT_debug(RealtimePanel, Panel):
    """An intermediate result in place of the picture."""

    bl_label = "Debug View"

    def draw(self, context: Any) -> None:
        """Draw the choice and what it shows."""
        layout, debug = self.split_layout(), context.scene.burnish.debug
        layout.prop(debug, "view", text="Show")
        help = debug.bl_rna.properties["view"].enum_items[debug.view].description
        if help:
            column = layout.column(align=True)
            column.scale_y = 0.8
            for sentence in help.split(": "):
                column.label(text=sentence[:1].upper() + sentence[1:])


classes = (
    BURNISH_RENDER_PT_probes,
    BURNISH_RENDER_PT_cache,
    BURNISH_RENDER_PT_cache_method,
    BURNISH_RENDER_PT_direct_light,
    BURNISH_RENDER_PT_reflections,
    BURNISH_RENDER_PT_reflections_method,
    BURNISH_RENDER_PT_denoiser,
    BURNISH_RENDER_PT_denoiser_reflections,
    BURNISH_RENDER_PT_denoiser_rest,
    BURNISH_RENDER_PT_debug,
)
