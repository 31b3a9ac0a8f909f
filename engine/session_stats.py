# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures about a session, for panels and measurements."""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["SessionStats"]


@dataclass
class SessionStats:
    """What a session holds and how long its stages took."""

    triangles: int = 0
    instances: int = 0
    lights: int = 0
    texture_bytes: int = 0
    device_bytes: int = 0
    structure: str = ""
    times: dict[str, float] = field(default_factory=dict)
    """Seconds by stage of the last update (textures, upload, structures, lights) and of sampling and reading"""
