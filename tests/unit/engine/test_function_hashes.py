# SPDX-License-Identifier: GPL-3.0-or-later
"""Hashes of kernels' functions are worked out once for all modules, and are those that Warp makes of each.

Nor are functions looked through for others when they are defined.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

CODE = """
import json
from burnish.engine import device
from burnish.kernels import cache_lean, direct_shade, gbuffer_lean
import warp as wp
if sys.argv[1] == "alone":
    device.share_function_hashes = lambda: None
device.start_warp()
hasher = sys.modules[wp.Module.__module__].ModuleHasher
counted, calls = hasher.hash_adjoint, []
hasher.hash_adjoint = lambda self, adjoint: (calls.append(0), counted(self, adjoint))[1]
names = [module.__name__ for module in (cache_lean, direct_shade, gbuffer_lean)]
hashes = {name: wp.get_module(name).get_module_hash(1).hex() for name in names}
print(json.dumps({"hashes": hashes, "calls": len(calls)}))
"""


@pytest.mark.slow
def test_shared_hashes_are_those_of_each_module(run_python: Callable[..., subprocess.CompletedProcess]) -> None:
    """Make the same hash of a module with shared hashes, so that built kernels are found, for less work."""
    runs = [run_python(CODE, how) for how in ("alone", "shared")]
    assert all(run.returncode == 0 for run in runs), [run.stderr for run in runs]
    alone, shared = (json.loads(run.stdout.splitlines()[-1]) for run in runs)
    assert shared["hashes"] == alone["hashes"] and len(set(shared["hashes"].values())) == 3
    assert shared["calls"] < 0.75 * alone["calls"]


REFERENCES = """
import warp as wp
looked = wp.Module._find_references
seen = []
wp.Module._find_references = lambda self, adjoint: (seen.append(self.name), looked(self, adjoint))[1]
import burnish.kernels.cache_lean
import other_kernels
print(sorted(name for name in seen if "burnish" in name), [n for n in seen if n == "other_kernels"])
"""

OTHER = """
import warp as wp

@wp.func
def twice(x: float) -> float:
    return 2.0 * x
"""


def test_functions_are_not_looked_through(
    run_python: Callable[..., subprocess.CompletedProcess], tmp_path: Path,
) -> None:
    """Look through the functions of others alone."""
    (tmp_path / "other_kernels.py").write_text(OTHER)
    run = run_python(f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n{REFERENCES}")
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-1] == "[] ['other_kernels']"
