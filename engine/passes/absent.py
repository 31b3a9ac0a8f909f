# SPDX-License-Identifier: GPL-3.0-or-later
"""Which kernels a frame does without, as the timing panel tells."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..frame_graph import FrameGraph
from .ray_scene import RayScene

if TYPE_CHECKING:
    from ..device_scene import DeviceScene

__all__ = ["note_absent"]


def note_absent(graph: FrameGraph, scene: DeviceScene, what: RayScene) -> None:
    """Tell which kernels a frame does without, for the timing panel."""
    lights, lean = scene.scene.lights, scene.material_table.lean
    absent = {
        "alpha layers": ("nothing lets light through unbent", not what.filtered),
        "lamps in view": ("there are no lamps", lights.lamp_count == 0),
        "emissive meshes": ("none shines", len(scene.emitters.power) == 0),
        "light programs": ("no light varies", not scene.emitters.textured),
        "sun in the world": ("no part of it is bright enough", what.split.share == 0.0),
        "shadow rays of hits": ("nothing shines", lights.class_count == 0),
        "chains of mirrors": ("no mirror and no glass", not what.mirrors),
        "highlights in mirrors": ("nothing glossy is lit", not what.glossy or lights.class_count == 0),
        "walks below surfaces": ("nothing scatters light there", not what.below),
        "lobes of other shapes": ("all are Lambert's or round", not scene.material_table.reflectors.shaped),
        "full node machine": ("all materials are plain", lean.surface and lean.flat and lean.transparency),
    }
    for name, (reason, is_absent) in absent.items():
        if is_absent:
            graph.skip(name, reason)
