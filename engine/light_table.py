# SPDX-License-Identifier: GPL-3.0-or-later
"""All lights together on the device: classes with their chances, and the tree of the local ones."""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels import types
from .emitters import EmitterTable
from .lamps import lamp_bounds, lamp_power
from .light_tree import build_light_tree

__all__ = ["SUN", "build_lights"]

SUN = 1
"""Light.kind of suns"""


def build_lights(
    lamps: np.ndarray, emitters: EmitterTable, environment_power: float, radius: float, device: str, *,
    linked: bool = False, tables: wp.array | None = None,
) -> types.Lights:
    """Return the struct that light sampling reads.

    Classes (local lights, suns, the world) have equal chances: what a sun or the world delivers grows with the
    scene's extent, which a ground plane makes huge, and says nothing of what arrives at a point.

    Args:
        lamps: As from lamp_array: local lamps, then suns.
        emitters: The emissive triangles.
        environment_power: The world's radiance over the sphere; 0 where it is not sampled.
        radius: Of the scene [m], to compare suns with each other.
        device: Where to put it.
        linked: Whether any light is for some objects alone.
        tables: Of lamps whose node trees vary (lamp_tables.py).
    """
    power = lamp_power(lamps, radius)
    local = int((lamps["kind"] != SUN).sum())
    low, high = lamp_bounds(lamps[:local])
    tree = build_light_tree(
        np.concatenate([low, emitters.low]), np.concatenate([high, emitters.high]),
        np.concatenate([power[:local], emitters.power]))
    suns = power[local:]
    totals = np.array([power[:local].sum() + emitters.power.sum(), suns.sum(), environment_power])
    share = (totals > 0) / max(np.count_nonzero(totals > 0), 1)
    weights = np.concatenate([share[:1], suns * (share[1] / max(totals[1], 1e-30)), share[2:]])
    lights = types.Lights()
    lights.lamps = _array(lamps, types.Light, device)
    lights.lamp_count, lights.local_lamp_count = len(lamps), local
    lights.tables = tables if tables is not None else wp.zeros(1, dtype=wp.vec4, device=device)
    lights.triangles, lights.emitter_offset, lights.emitter_index = emitters.faces, emitters.offset, emitters.index
    lights.emitter_power = _array(emitters.power.astype(np.float32), float, device)
    lights.environment_power = environment_power
    lights.linked = int(linked)
    lights.tree.low = _array(tree.low, wp.vec4, device)
    lights.tree.high = _array(tree.high, wp.vec4, device)
    lights.tree.entries = _array(tree.entries, int, device)
    lights.tree.places = _array(tree.places, int, device)
    lights.tree.levels = tree.levels
    lights.class_count = len(weights) if weights.sum() > 0 else 0
    lights.environment_class = len(weights) - 1 if share[2] > 0 else -1
    lights.weight = _array(weights.astype(np.float32), float, device)
    return lights


def _array(values: np.ndarray, dtype: type, device: str) -> wp.array:
    """Put values on the device; kernels need arrays that are never empty."""
    return wp.array(values, dtype=dtype, device=device) if len(values) else wp.zeros(1, dtype=dtype, device=device)
