# SPDX-License-Identifier: GPL-3.0-or-later
"""Hashes of kernels' functions, shared by all modules: Warp works each out anew for every module that calls it.

By its hash a module's built kernels are found on disk. Of some 940 functions 190 modules make 11,700 hashes, which was
most of the time from Blender's start to the first picture. What a function's hash is made of (its source, types,
constants and the functions that it calls) does not depend on the module that calls it.
"""

from __future__ import annotations

import sys
from typing import Any

import warp as wp

from ..kernels.registration import PACKAGE

__all__ = ["share_function_hashes"]


def share_function_hashes() -> None:
    """Let Warp keep the hashes of this package's functions, if it works them out as the versions known here do."""
    hasher = getattr(sys.modules[wp.Module.__module__], "ModuleHasher", None)
    worked_out = getattr(hasher, "hash_function", None)
    if worked_out is None or getattr(worked_out, "shares", False):
        return
    known: dict[Any, bytes] = {}

    def hash_function(self: Any, func: Any) -> bytes:
        if func not in known:
            found = worked_out(self, func)
            if not _is_lasting(func):
                return found
            known[func] = found
        return known[func]

    hash_function.shares = True
    hasher.hash_function = hash_function


def _is_lasting(func: Any) -> bool:
    """Tell whether a function's hash can't change any more, and is the same for all modules."""
    overloads = (getattr(func, "user_overloads", {}) | getattr(func, "user_templates", {})).values()
    return getattr(func, "__module__", "").startswith(PACKAGE) and not any(
        getattr(overload.adj, "deferred_static_expressions", ()) for overload in overloads)
