# SPDX-License-Identifier: GPL-3.0-or-later
"""What all panels share: the base class, the node slot, and the list of Blender's own panels that are shown too."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy

__all__ = ["ENGINE", "BurnishPanel", "draw_node_input", "foreign_panels"]

ENGINE = 'BURNISH'

# Panels for every engine, which make no sense here: their settings are not read or ours take their place.
EXCLUDED_PANELS = {
    'DATA_PT_falloff_curve', 'DATA_PT_light', 'DATA_PT_preview', 'DATA_PT_spot', 'NODE_DATA_PT_light',
    'NODE_DATA_PT_spot', 'OBJECT_PT_visibility', 'RENDER_PT_freestyle', 'VIEWLAYER_PT_freestyle',
    'RENDER_PT_simplify', 'RENDER_PT_simplify_viewport', 'RENDER_PT_simplify_render',
    'RENDER_PT_simplify_greasepencil', 'MATERIAL_PT_freestyle_line',
}

# EEVEE's panels for what is common to both engines.
EEVEE_PANELS = {
    'DATA_PT_camera_dof', 'DATA_PT_camera_dof_aperture', 'EEVEE_MATERIAL_PT_context_material', 'MATERIAL_PT_preview',
    'EEVEE_WORLD_PT_mist', 'OBJECT_PT_shadow_terminator',
}


class BurnishPanel:
    """A panel in the Properties editor, shown while this engine is chosen."""

    bl_space_type = 'PROPERTIES'
    bl_region_type = 'WINDOW'
    bl_context = "render"
    COMPAT_ENGINES = {ENGINE}

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show with our engine only."""
        return context.engine in cls.COMPAT_ENGINES

    def split_layout(self) -> Any:
        """Return the layout, set up as a column of labelled properties."""
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        return self.layout


def draw_node_input(layout: Any, data: Any, input_name: str) -> bool:
    """Draw the node that feeds an output socket of a data-block; return False where it has no nodes."""
    from bpy_extras.node_utils import find_node_input

    tree = data.node_tree
    if tree is None:
        return False
    # Cycles' output: materials are shared with Cycles and EEVEE.
    node = tree.get_output_node('CYCLES')
    if node is None:
        layout.label(text="No output node")
        return True
    socket = find_node_input(node, input_name)
    if socket is None:
        layout.label(text="Incompatible output node")
    else:
        layout.template_node_view(tree, node, socket)
    return True


def foreign_panels() -> Iterator[type]:
    """Yield Blender's panels that this engine takes over."""
    for panel in bpy.types.Panel.__subclasses__():
        engines = getattr(panel, 'COMPAT_ENGINES', None)
        if engines is None or issubclass(panel, BurnishPanel):
            continue
        for_all = 'BLENDER_RENDER' in engines and panel.__name__ not in EXCLUDED_PANELS
        for_all = for_all and not panel.__name__.startswith('VIEWLAYER_PT_freestyle')
        if for_all or ('BLENDER_EEVEE' in engines and panel.__name__ in EEVEE_PANELS):
            yield panel
