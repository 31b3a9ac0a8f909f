# SPDX-License-Identifier: GPL-3.0-or-later
"""All lights together on the device: classes with their chances, and the tree of the local ones."""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels import types
from .alias_table import build_alias_table
from .emitters import EmitterTable
from .lamps import lamp_bounds, lamp_power
from .light_tree import build_light_tree

__all__ = ["build_lights"]

SUN = 1
"""Light.kind of suns"""


def build_lights(
    lamps: np.ndarray, emitters: EmitterTable, environment_power: float, radius: float, device: str,
) -> types.Lights:
    """Return the struct that light sampling reads.

    Classes (local lights, suns, the world) share the samples by the roots of their power within the scene: a sun
    outside does not starve the lamps of a room.

    Args:
        lamps: As from lamp_array: local lamps, then suns.
        emitters: The emissive triangles.
        environment_power: The world's radiance over the sphere; 0 where it is not sampled.
        radius: Of the scene [m].
        device: Where to put it.
    """
    power = lamp_power(lamps, radius)
    local = int((lamps["kind"] != SUN).sum())
    low, high = lamp_bounds(lamps[:local])
    tree = build_light_tree(
        np.concatenate([low, emitters.low]), np.concatenate([high, emitters.high]),
        np.concatenate([power[:local], emitters.power]))
    suns = power[local:]
    totals = np.array([power[:local].sum() + emitters.power.sum(), suns.sum(),
                       environment_power * np.pi * radius**2])
    share = np.sqrt(np.maximum(totals, 0.0))
    share /= max(share.sum(), 1e-30)
    weights = np.concatenate([share[:1], suns * (share[1] / max(totals[1], 1e-30)), share[2:]])
    probability, alias = build_alias_table(weights)
    lights = types.Lights()
    lights.lamps = _array(lamps, types.Light, device)
    lights.lamp_count, lights.local_lamp_count = len(lamps), local
    lights.triangles, lights.emitter_offset, lights.emitter_index = emitters.faces, emitters.offset, emitters.index
    lights.tree.nodes = _array(tree.nodes, wp.vec4, device)
    lights.tree.power = _array(tree.power, float, device)
    lights.tree.entries = _array(tree.entries, int, device)
    lights.tree.places = _array(tree.places, int, device)
    lights.tree.levels = tree.levels
    lights.class_count = len(weights) if weights.sum() > 0 else 0
    lights.environment_class = len(weights) - 1 if share[2] > 0 else -1
    lights.probability = _array(probability, float, device)
    lights.alias = _array(alias, int, device)
    lights.weight = _array(weights.astype(np.float32), float, device)
    return lights


def _array(values: np.ndarray, dtype: type, device: str) -> wp.array:
    """Put values on the device; kernels need arrays that are never empty."""
    return wp.array(values, dtype=dtype, device=device) if len(values) else wp.zeros(1, dtype=dtype, device=device)
