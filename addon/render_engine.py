# SPDX-License-Identifier: GPL-3.0-or-later
"""The RenderEngine that Blender sees: flags, and methods that only call into final.py and viewport.py.

Those two are imported at the first call: they load Warp, which nobody who renders with another engine should wait for.
"""

from __future__ import annotations

from typing import Any

import bpy

from . import handlers, passes

__all__ = ["BurnishRenderEngine", "register", "unregister"]


class BurnishRenderEngine(bpy.types.RenderEngine):
    """One instance per rendered viewport, two per final render, one per preview; nothing costly in its creation."""

    bl_idname = 'BURNISH'
    bl_label = "Burnish"
    bl_use_eevee_viewport = True
    bl_use_preview = True
    bl_use_postprocess = True
    bl_use_shading_nodes_custom = False
    bl_use_custom_freestyle = False
    bl_use_spherical_stereo = False
    bl_use_stereo_viewport = False
    bl_use_image_save = True

    def update_render_passes(self, scene: Any, renderlayer: Any) -> None:
        """Register the passes of a view layer."""
        passes.register_passes(self, scene, renderlayer)

    def render(self, depsgraph: Any) -> None:
        """Render one view layer for good; in the window this runs in a job's thread."""
        from . import final

        final.render(self, depsgraph)

    def view_update(self, context: Any, depsgraph: Any) -> None:
        """Take in what changed in the scene; called on the main thread."""
        from . import viewport

        viewport.view_update(self, context, depsgraph)

    def view_draw(self, context: Any, depsgraph: Any) -> None:
        """Draw the newest picture; called on the main thread at each redraw."""
        from . import viewport

        viewport.view_draw(self, context, depsgraph)


def register() -> None:
    """Register the engine."""
    bpy.utils.register_class(BurnishRenderEngine)


def unregister() -> None:
    """Stop the viewports and unregister the engine."""
    handlers.stop_viewports()
    bpy.utils.unregister_class(BurnishRenderEngine)
