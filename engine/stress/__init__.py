# SPDX-License-Identifier: GPL-3.0-or-later
"""The stress test of the numbers: scenes that no one would make on purpose, and what must hold for them all the same.

Everything here works on plain scene data, without Blender; addon/stress.py is the command. Cases are in one file for
each subject, scenes that they share in scenes.py, what a case may do in cases.py.
"""

from __future__ import annotations

import fnmatch

from . import endurance, furnaces, fuzz, inputs, invariance, lights, surfaces, views
from .cases import Case, Result, Trial, run_case

__all__ = ["Case", "Result", "Trial", "all_cases", "choose_cases", "run_case"]

MODULES = (furnaces, invariance, inputs, lights, surfaces, views, endurance, fuzz)


def all_cases() -> tuple[Case, ...]:
    """Return every case, by subject."""
    return tuple(case for module in MODULES for case in module.CASES)


def choose_cases(cases: tuple[Case, ...], *, quick: bool, only: str = "") -> tuple[Case, ...]:
    """Return the cases to run: the quick subset or all, of them those whose name holds or matches `only`."""
    chosen = tuple(case for case in cases if case.quick or not quick)
    pattern = only.lower()
    return tuple(case for case in chosen if pattern in case.name.lower() or fnmatch.fnmatch(
        case.name.lower(), pattern))
