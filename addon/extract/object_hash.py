# SPDX-License-Identifier: GPL-3.0-or-later
"""The random number that Object Info gives objects that aren't instanced."""

from __future__ import annotations

import functools

import numpy as np

from ...engine.mesh_features import hashed

__all__ = ["object_random_id"]


@functools.lru_cache(maxsize=1 << 16)
def object_random_id(name: str) -> int:
    """Return Object Info's random id of an object that isn't instanced: Cycles' hash of its name (util/hash.h)."""
    text = 0
    for byte in name.encode():
        text = (text * 37 + byte) & 0xFFFFFFFF
    return int(hashed(np.array([text], np.uint32), 2)[0])
