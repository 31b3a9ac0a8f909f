# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's lamps to LightData, in Blender's units; the engine makes radiance of them.

Follows Cycles' sync of lamps (intern/cycles/blender/light.cpp): strength = colour * temperature colour * energy *
2**exposure, times what the node tree says: a constant factor or a program. Main thread only; keeps nothing of bpy.
"""

from __future__ import annotations

import math

import bpy
import numpy as np

from ...engine.program import Program
from ...engine.report import Report, ReportKind
from ...engine.scene import LightData, LightKind

__all__ = ["extract_light"]

_ENERGY_LIMIT = 1e30


def extract_light(light: bpy.types.Light, transform: np.ndarray, visibility: int,
                  shader: tuple[tuple[float, float, float], Program | None], owner: str, report: Report,
                  light_group: str = "", links: tuple[int, int] = (0, 0)) -> LightData | None:
    """Copy one lamp instance.

    Args:
        light: Evaluated lamp.
        transform: float64 [4, 4], lamp to world.
        visibility: Visibility bits of the lamp's object.
        shader: Constant colour times strength of the lamp's node tree, and its program if it varies.
        owner: Name for messages, such as `light 'Key'`.
        report: Takes what is not drawn.
        light_group: Of the lamp's object.
        links: Numbers of the sets of objects that it lights and of what casts its shadows.

    Returns:
        None where the lamp can't light anything (a portal, a broken transform or colour).
    """
    settings = getattr(light, "cycles", None)
    if light.type == 'AREA' and getattr(settings, "is_portal", False):
        report.add(ReportKind.SKIPPED, owner, "is a light portal; portals are not used, the world is sampled directly")
        return None
    if not np.isfinite(transform).all():
        report.add(ReportKind.SKIPPED, owner, "has a transform that is not finite and was left out")
        return None
    color = _strength(light, shader[0])
    if not all(math.isfinite(value) and abs(value) < _ENERGY_LIMIT for value in color):
        report.add(ReportKind.SKIPPED, owner, "has a colour or power that is not finite and was left out")
        return None
    common = {
        "name": light.name,
        "kind": LightKind(light.type),
        "transform": transform,
        "color": color,
        "normalize": bool(getattr(light, "normalize", True)),
        "cast_shadow": bool(light.use_shadow),
        "use_mis": bool(getattr(settings, "use_multiple_importance_sampling", True)),
        "visibility": visibility,
        "light_group": light_group,
        "linked_to": links[0],
        "blocked_by": links[1],
        "program": shader[1],
    }
    return LightData(**common, **_shape(light))


def _strength(light: bpy.types.Light, factor: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return colour times power; see Blender's BKE_light_color and BKE_light_power."""
    power = light.energy * 2.0 ** min(getattr(light, "exposure", 0.0), 1000.0)
    color = np.array(light.color[:3], np.float64) * factor
    if getattr(light, "use_temperature", False):
        color *= light.temperature_color[:3]
    return tuple(float(value) for value in color * power)


def _shape(light: bpy.types.Light) -> dict:
    """Return the fields of LightData that depend on the kind of lamp."""
    if light.type == 'SUN':
        return {"angle": light.angle}
    if light.type == 'AREA':
        # The second length only counts for the two shapes that show it.
        size_y = light.size_y if light.shape in {'RECTANGLE', 'ELLIPSE'} else light.size
        return {"shape": light.shape, "size_x": light.size, "size_y": size_y, "spread": light.spread}
    shape = {"radius": light.shadow_soft_size, "soft_falloff": bool(getattr(light, "use_soft_falloff", True))}
    if light.type == 'SPOT':
        shape |= {"spot_size": light.spot_size, "spot_blend": light.spot_blend}
    return shape
