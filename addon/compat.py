# SPDX-License-Identifier: GPL-3.0-or-later
"""Every difference between Blender versions, nowhere else. Written for 5.2; 5.0 and 5.1 are supported too."""

from __future__ import annotations

from typing import Any

import bpy

__all__ = ["exit_handlers", "pass_name", "set_texture_filter"]

# Pass names before 5.0 (Blender renamed its built-in passes then).
OLD_PASS_NAMES = {
    "Object Index": "IndexOB", "Material Index": "IndexMA", "Emission": "Emit", "Environment": "Env",
    "Ambient Occlusion": "AO", "Diffuse Direct": "DiffDir", "Diffuse Indirect": "DiffInd", "Diffuse Color": "DiffCol",
    "Glossy Direct": "GlossDir", "Glossy Indirect": "GlossInd", "Glossy Color": "GlossCol",
    "Transmission Direct": "TransDir", "Transmission Indirect": "TransInd", "Transmission Color": "TransCol",
}


def pass_name(name: str) -> str:
    """Return Blender's internal name of a built-in pass."""
    return name if bpy.app.version >= (5, 0, 0) else OLD_PASS_NAMES.get(name, name)


def exit_handlers() -> list[Any] | None:
    """Return the list of functions that Blender calls before it quits, or None where it has no such list."""
    return getattr(bpy.app.handlers, "exit_pre", None)


def set_texture_filter(texture: Any, linear: bool) -> None:
    """Choose linear or nearest sampling of a GPUTexture; without the method (before 5.0) the default stays."""
    if hasattr(texture, "filter_mode"):
        texture.filter_mode(linear)
