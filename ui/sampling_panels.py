# SPDX-License-Identifier: GPL-3.0-or-later
"""First panels of the render tab: integrator, device, samples."""

from __future__ import annotations

from typing import Any

from bpy.types import Panel

from .panel import BurnishPanel
from .presets import draw_presets

__all__ = ["classes"]


def counted(sampling: Any) -> str:
    """Return what the integrator counts: the real-time one adds whole frames."""
    return "Frames" if sampling.integrator == 'REALTIME' else "Samples"


class BURNISH_RENDER_PT_device(BurnishPanel, Panel):
    """How the picture is made and where the kernels run."""

    bl_label = "Device"
    bl_options = {'HIDE_HEADER'}

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, settings = self.split_layout(), context.scene.burnish
        layout.prop(settings.sampling, "integrator")
        layout.prop(settings, "device")
        if settings.sampling.integrator == 'REALTIME':
            draw_presets(layout, context)


class BURNISH_RENDER_PT_sampling(BurnishPanel, Panel):
    """Samples of viewport and final render."""

    bl_label = "Sampling"

    def draw(self, context: Any) -> None:
        """Draw nothing: the panels below do."""


class BURNISH_RENDER_PT_sampling_viewport(BurnishPanel, Panel):
    """Samples of the viewport."""

    bl_label = "Viewport"
    bl_parent_id = "BURNISH_RENDER_PT_sampling"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, sampling = self.split_layout(), context.scene.burnish.sampling
        layout.prop(sampling, "viewport_samples", text=counted(sampling))
        if sampling.integrator == 'REALTIME':
            layout.prop(sampling, "viewport_denoise", text="Denoise")
            layout.prop(sampling, "viewport_preset", text="Preset")


class BURNISH_RENDER_PT_sampling_render(BurnishPanel, Panel):
    """Samples of the final render."""

    bl_label = "Render"
    bl_parent_id = "BURNISH_RENDER_PT_sampling"

    def draw(self, context: Any) -> None:
        """Draw."""
        layout, sampling = self.split_layout(), context.scene.burnish.sampling
        layout.prop(sampling, "samples", text=counted(sampling))
        layout.prop(sampling, "time_limit")
        layout.prop(context.scene.burnish.denoiser, "final_denoise", text="Denoise")


class BURNISH_RENDER_PT_sampling_advanced(BurnishPanel, Panel):
    """Random numbers."""

    bl_label = "Advanced"
    bl_parent_id = "BURNISH_RENDER_PT_sampling"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw."""
        self.split_layout().prop(context.scene.burnish.sampling, "seed")


classes = (
    BURNISH_RENDER_PT_device,
    BURNISH_RENDER_PT_sampling,
    BURNISH_RENDER_PT_sampling_viewport,
    BURNISH_RENDER_PT_sampling_render,
    BURNISH_RENDER_PT_sampling_advanced,
)
