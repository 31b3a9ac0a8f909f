# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores of whole vectors at once: Warp stores them number by number, each of which is a request to the cache.

The arrays must be contiguous and begin where Warp's allocators begin.
"""

from __future__ import annotations

import warp as wp

__all__ = ["store_vec2", "store_vec4", "store_vec4h"]

_STORE = """
#ifdef __CUDA_ARCH__
    TYPE w;
    memcpy(&w, &value, sizeof(w));
    *reinterpret_cast<TYPE*>(rows_out.data + index) = w;
#else
    rows_out.data[index] = value;
#endif
"""


@wp.func_native(_STORE.replace("TYPE", "float2"))
def store_vec2(rows_out: wp.array[wp.vec2], index: int, value: wp.vec2):
    """Write rows_out[index]."""
    ...


@wp.func_native(_STORE.replace("TYPE", "float4"))
def store_vec4(rows_out: wp.array[wp.vec4], index: int, value: wp.vec4):
    """Write rows_out[index]."""
    ...


@wp.func_native(_STORE.replace("TYPE", "uint2"))
def store_vec4h(rows_out: wp.array[wp.vec4h], index: int, value: wp.vec4h):
    """Write rows_out[index]."""
    ...
