# SPDX-License-Identifier: GPL-3.0-or-later
"""Which materials are clear glass, behind which light goes on in real-time frames (kernels/clear_glass.py).

A single closure of glass that lets all light through but what it reflects, with one colour. What varies, is rough, is
mixed with something else or filled with a volume stops light as before. Where a program makes it transparent (a Light
Path trick) rays ask that program.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels import node_codes as codes
from ..kernels import types as kernel_types
from ..kernels.types import Scene
from .closure_arguments import closure_constants
from .history import copy_struct
from .scene import MaterialData
from .settings import DirectLightSettings

__all__ = ["clear_glass", "light_scene", "passes_glass", "path_scene"]

ROUGHNESS_MAX = 0.3
"""Glass that is rougher spreads light instead"""

TRANSMISSION_MIN = 0.95
"""Least share of a Principled BSDF's base that is glass"""


def clear_glass(data: MaterialData) -> tuple[float, float, float, float]:
    """Return the tint of light that passes a surface of a material, and its index.

    The index is 0 where it isn't clear glass, and negative where paths don't share light behind it
    (kernels/clear_paths.py): it is not smooth, or reflects otherwise than by Fresnel's equations alone.
    """
    none = (0.0, 0.0, 0.0, 0.0)
    found = list(closure_constants(data.program))
    more = data.has_transparency or data.has_emission or data.medium is not None
    if more or len(found) != 1 or any(head & 255 == codes.OP_HOLDOUT for head, *_ in data.program.surface):
        return none
    kind, arguments = found[0]

    def number(slot: int, varying: float) -> float:
        return varying if arguments[slot] is None else float(arguments[slot][0])

    if number(codes.ARG_WEIGHT, 0.0) != 1.0 or number(codes.ARG_ROUGHNESS, 0.0) > ROUGHNESS_MAX:
        return none
    if arguments[codes.ARG_COLOR] is None:
        return none
    color = [float(np.clip(c, 0.0, 1.0)) for c in arguments[codes.ARG_COLOR][:3]]
    ior = max(number(codes.ARG_IOR, 1.5), 1.0e-3)
    if arguments[codes.ARG_NORMAL] is None or number(codes.ARG_ROUGHNESS, 1.0) != 0.0:
        ior = -ior
    if kind == kernel_types.CLOSURE_PRINCIPLED:
        share = number(codes.ARG_TRANSMISSION, 0.0) * (1.0 - number(codes.ARG_METALLIC, 1.0))
        if share < TRANSMISSION_MIN or number(codes.ARG_COAT, 1.0) > 0.0:
            return none
        if number(codes.ARG_THIN_WALL, 0.0) != 0.0:
            # One surface, which bends nothing; with what two reflect of light from straight ahead.
            reflected = ((abs(ior) - 1.0) / (abs(ior) + 1.0)) ** 2
            return *(share * c * (1.0 - reflected) / (1.0 + reflected) for c in color), -1.0
        # A slab, with its two surfaces, has the colour.
        tint = arguments[codes.ARG_SPECULAR_TINT]
        plain = share == 1.0 and tint is not None and tint[:3] == (1.0, 1.0, 1.0)
        return *(share * c**0.5 for c in color), ior if plain else -abs(ior)
    if kind == kernel_types.CLOSURE_GLASS:
        return *color, ior
    if kind == kernel_types.CLOSURE_REFRACTION:
        # Reflects nothing.
        return *color, -1.0
    return none


def passes_glass(scene: Scene) -> bool:
    """Return whether a scene has clear glass."""
    return scene.materials.clear.shape[0] > 0


def light_scene(scene: Scene, settings: DirectLightSettings) -> Scene:
    """Return the scene as rays of real-time frames meet it: without clear glass where settings leave it out."""
    return scene if settings.clear_glass else without_clear_glass(scene)


def path_scene(scene: Scene, *, plain: bool) -> Scene:
    """Return the scene as the path tracer meets it: with light samples through panes.

    Not where paths keep more than their light (`plain` False: media, passes of light, shadow catchers), nor where
    lights are linked.
    """
    return scene if plain and scene.lights.linked == 0 else without_clear_glass(scene)


def without_clear_glass(scene: Scene) -> Scene:
    """Return a scene without clear glass, the same where it has none."""
    if not passes_glass(scene):
        return scene
    changed, materials = copy_struct(scene), copy_struct(scene.materials)
    materials.clear = wp.empty(0, dtype=wp.vec4, device=scene.materials.clear.device)
    # Structs hold copies of those in them.
    changed.materials = materials
    return changed
