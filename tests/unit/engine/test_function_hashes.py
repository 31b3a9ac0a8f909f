# SPDX-License-Identifier: GPL-3.0-or-later
"""Hashes of kernels' functions are worked out once for all modules, and are those that Warp makes of each."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable

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


def test_shared_hashes_are_those_of_each_module(run_python: Callable[..., subprocess.CompletedProcess]) -> None:
    """Make the same hash of a module with shared hashes, so that built kernels are found, for less work."""
    runs = [run_python(CODE, how) for how in ("alone", "shared")]
    assert all(run.returncode == 0 for run in runs), [run.stderr for run in runs]
    alone, shared = (json.loads(run.stdout.splitlines()[-1]) for run in runs)
    assert shared["hashes"] == alone["hashes"] and len(set(shared["hashes"].values())) == 3
    assert shared["calls"] < 0.75 * alone["calls"]
