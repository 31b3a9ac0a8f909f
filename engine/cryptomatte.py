# SPDX-License-Identifier: GPL-3.0-or-later
"""Cryptomatte: ids made of names, the manifest that leads back from them, and the header entries of a file.

After the Cryptomatte specification 1.2 (Psyop 2017) as Cycles follows it: MurmurHash3 (x86, 32 bits, seed 0) of the
name in UTF-8, whose bits are those of a float once the exponent is kept from being that of a denormal, infinity or NaN.
"""

from __future__ import annotations

import json
from collections.abc import Iterable

import numpy as np

__all__ = ["manifest", "matte_header", "matte_ids", "murmur_hash"]

DEFAULT_MATERIAL = "default_surface"
"""What Cycles calls the material of surfaces without one"""

MASK = 0xFFFFFFFF


def _rotated(value: int, bits: int) -> int:
    return ((value << bits) | (value >> (32 - bits))) & MASK


def _mixed(word: int) -> int:
    return (_rotated((word * 0xCC9E2D51) & MASK, 15) * 0x1B873593) & MASK


def murmur_hash(name: str) -> int:
    """Return MurmurHash3_x86_32 of a name in UTF-8, with seed 0 (Appleby 2011)."""
    data = name.encode()
    state, whole = 0, len(data) // 4 * 4
    for start in range(0, whole, 4):
        state = _rotated(state ^ _mixed(int.from_bytes(data[start:start + 4], "little")), 13)
        state = (state * 5 + 0xE6546B64) & MASK
    if whole < len(data):
        state ^= _mixed(int.from_bytes(data[whole:], "little"))
    state ^= len(data)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        state = ((state ^ (state >> shift)) * factor) & MASK
    return state ^ (state >> 16)


def matte_ids(names: Iterable[str]) -> np.ndarray:
    """Return the ids of names: float32 [n], all of them normal numbers."""
    known: dict[str, int] = {}
    bits = np.array([known[name] if name in known else known.setdefault(name, murmur_hash(name)) for name in names],
                    np.uint32)
    exponent = np.clip((bits >> 23) & 0xFF, 1, 254)
    return ((bits & np.uint32(0x807FFFFF)) | (exponent << 23).astype(np.uint32)).view(np.float32)


def manifest(names: Iterable[str]) -> str:
    """Return the table from names to hashes, as JSON."""
    return json.dumps({name: f"{murmur_hash(name):08x}" for name in names}, ensure_ascii=False, separators=(",", ":"))


def matte_header(layer: str, manifests: dict[str, str]) -> dict[str, str]:
    """Return the header entries for a view layer's passes.

    Args:
        layer: Name of the view layer as it stands before the passes' names in the file.
        manifests: By kind, one of pass_names.MATTE_KINDS.
    """
    entries = {}
    for kind, text in manifests.items():
        name = f"{layer}.{kind}"
        prefix = f"cryptomatte/{murmur_hash(name):08x}"[:len("cryptomatte/") + 7]
        entries |= {f"{prefix}/name": name, f"{prefix}/hash": "MurmurHash3_32",
                    f"{prefix}/conversion": "uint32_to_float32", f"{prefix}/manifest": text}
    return entries
