# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures of the tests that run bpy in a child process."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def run_extraction(run_python: Callable[..., subprocess.CompletedProcess]) -> Callable[[str], dict]:
    """Return a function that runs a script with everything of extract_scenes.py and returns what it finished with."""
    folder = str(Path(__file__).resolve().parent)

    def run(script: str) -> dict:
        process = run_python(f"sys.path.insert(0, {folder!r})\nfrom extract_scenes import *\n" + script)
        lines = [line for line in process.stdout.splitlines() if line.startswith("RESULT ")]
        assert process.returncode == 0 and lines, process.stdout + process.stderr
        return json.loads(lines[-1].removeprefix("RESULT "))

    return run
