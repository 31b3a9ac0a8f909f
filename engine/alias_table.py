# SPDX-License-Identifier: GPL-3.0-or-later
"""Alias tables for drawing an index in constant time, built by prefix sums over whole arrays."""

from __future__ import annotations

import numpy as np

__all__ = ["build_alias_table"]


def build_alias_table(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (probability float32 [N], alias int32 [N]) that draw index i with probability weights[i] / sum.

    Walker's and Vose's table; built as in Huebschle-Schneider and Sanders, "Parallel Weighted Random Sampling"
    (2022): light entries are matched to heavy ones by prefix sums of what they lack and have in excess.

    Args:
        weights: float [N], finite, not negative; all zero means uniform.
    """
    weights = np.asarray(weights, np.float64).ravel()
    count = len(weights)
    total = weights.sum()
    if count == 0 or not total > 0:
        return np.ones(count, np.float32), np.arange(count, dtype=np.int32)
    scaled = weights * (count / total)
    probability = np.ones(count, np.float64)
    alias = np.arange(count, dtype=np.int32)
    light = np.flatnonzero(scaled < 1.0)
    heavy = np.flatnonzero(scaled >= 1.0)
    if len(light) == 0 or len(heavy) == 0:
        return probability.astype(np.float32), alias
    lack = np.cumsum(1.0 - scaled[light])
    excess = np.cumsum(scaled[heavy] - 1.0)
    # Each light entry is filled up by the heavy one that is in use when its turn comes.
    served_by = np.searchsorted(excess, lack - (1.0 - scaled[light]), side="right")
    probability[light] = scaled[light]
    alias[light] = heavy[np.minimum(served_by, len(heavy) - 1)]
    # A heavy entry that gave more than its excess to its last customer lacks the difference: the next one fills it.
    last_customer = np.searchsorted(lack, excess, side="left")
    exhausted = last_customer < len(light)
    exhausted[-1] = False
    overdraft = lack[np.minimum(last_customer, len(light) - 1)] - excess
    probability[heavy[exhausted]] = np.clip(1.0 - overdraft[exhausted], 0.0, 1.0)
    alias[heavy[exhausted]] = heavy[np.flatnonzero(exhausted) + 1]
    return probability.astype(np.float32), alias
