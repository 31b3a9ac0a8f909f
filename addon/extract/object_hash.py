# SPDX-License-Identifier: GPL-3.0-or-later
"""The random number that Object Info gives objects that aren't instanced."""

from __future__ import annotations

import functools

__all__ = ["object_random_id"]


@functools.lru_cache(maxsize=1 << 16)
def object_random_id(name: str) -> int:
    """Return Object Info's random id of an object that isn't instanced: Cycles' hash of its name (util/hash.h)."""
    mask = 0xFFFFFFFF
    text = 0
    for byte in name.encode():
        text = (text * 37 + byte) & mask
    a = b = c = (0xDEADBEEF + (2 << 2) + 13) & mask
    a = (a + text) & mask
    # The last step of Bob Jenkins' lookup3.
    for left, right, bits in ((2, 1, 14), (0, 2, 11), (1, 0, 25), (2, 1, 16), (0, 2, 4), (1, 0, 14), (2, 1, 24)):
        state = [a, b, c]
        other = state[right]
        rotated = ((other << bits) | (other >> (32 - bits))) & mask
        state[left] = ((state[left] ^ other) - rotated) & mask
        a, b, c = state
    return c
