# SPDX-License-Identifier: GPL-3.0-or-later
"""Participating media: what extraction says of them, and all of a scene's as the path tracer's kernels read them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ..kernels.media import Media, Medium, Phase

if TYPE_CHECKING:
    from .device_scene import DeviceScene

__all__ = ["MediumData", "PhaseData", "scene_media"]

Color = tuple[float, float, float]

COEFFICIENT_MAX = 1e20
"""[1/m]; what is denser is opaque at any scale, and sums of such still fit a float"""

ANISOTROPY_MAX = 0.999
"""As Cycles has it: beyond it nothing is scattered but straight on or back"""


@dataclass(frozen=True)
class PhaseData:
    """One way in which a medium scatters, after Henyey and Greenstein."""

    scattering: Color
    """[1/m]"""
    anisotropy: float = 0.0


@dataclass(frozen=True)
class MediumData:
    """A homogeneous medium, in world space."""

    extinction: Color = (0.0, 0.0, 0.0)
    """What absorption and scattering take away [1/m]"""
    emission: Color = (0.0, 0.0, 0.0)
    """Radiance per metre"""
    phases: tuple[PhaseData, ...] = ()

    def __bool__(self) -> bool:
        return any((*self.extinction, *self.emission))


def scene_media(source: DeviceScene) -> Media | None:
    """Return the media of a scene's world and of what is drawn in it; None without any."""
    table, world = source.table, source.world.medium if source.world is not None else None
    keys = {key for keys in table.material_sets for key in keys}
    found = {key: data.medium for key in keys if (data := source.materials.get(key)) is not None and data.medium}
    filled = np.array([any(key in found for key in keys) for keys in table.material_sets], bool)
    drawn = source.drawn & filled[table.material_set_index] if len(source.drawn) else np.zeros(0, bool)
    if not drawn.any() and not world:
        return None
    rows = np.full(len(source.material_table.indices), -1, np.int32)
    records, phases = [], []

    def add(medium: MediumData) -> int:
        records.append((medium, len(phases)))
        phases.extend(medium.phases)
        return len(records) - 1

    for key, medium in found.items():
        rows[source.material_table.index(key)] = add(medium)
    media = Media()
    media.world = add(world) if world else -1
    low, high = (bounds[drawn] for bounds in (source.low, source.high))
    # Nothing is between bounds the wrong way round.
    media.low = wp.vec3(*low.min(0)) if len(low) else wp.vec3(1.0, 1.0, 1.0)
    media.high = wp.vec3(*high.max(0)) if len(low) else wp.vec3(-1.0, -1.0, -1.0)
    media.of_material = wp.array(rows, dtype=int, device=source.device)
    media.media = _rows(Medium, [(m.extinction, m.emission, first, len(m.phases)) for m, first in records],
                        source.device)
    media.phases = _rows(Phase, [(p.scattering, p.anisotropy) for p in phases], source.device)
    return media


def _rows(kind: type, values: list[tuple], device: str) -> wp.array:
    """Return structs with these fields on the device, at least one."""
    rows = np.zeros(max(len(values), 1), kind.numpy_dtype())
    for row, fields in zip(rows, values, strict=False):
        for name, value in zip(rows.dtype.names, fields, strict=True):
            limit = ANISOTROPY_MAX if name == "anisotropy" else COEFFICIENT_MAX
            row[name] = np.clip(np.nan_to_num(np.asarray(value, np.float64)), -limit, limit)
    return wp.array(rows, dtype=kind, device=device)
