# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures of the tests that run bpy in a child process."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import BLENDER_TIMEOUT, SCRIPT_START
from tests.script_server import ScriptServer

FOLDER = str(Path(__file__).resolve().parent)

IMPORTS = "sys.path.insert(0, {folder!r})\nfrom {module} import *\n"

PICTURES_TIMEOUT = 1200.0
"""The first run may have to build all kernels"""


def result_of(process: subprocess.CompletedProcess) -> Any:
    """Return what a script has finished with; it must have come to its end."""
    lines = [line for line in process.stdout.splitlines() if line.startswith("RESULT ")]
    assert process.returncode == 0 and lines, process.stdout + process.stderr
    return json.loads(lines[-1].removeprefix("RESULT "))


@pytest.fixture(scope="session")
def run_python(
    fresh_python: Callable[..., subprocess.CompletedProcess], device: str,
) -> Iterator[Callable[..., subprocess.CompletedProcess]]:
    """Return a function that runs a script as if in a process of its own, where `burnish` and bpy can be imported.

    A fork of one that has the kernels, where there are forks, and no GPU, which a fork can't use.
    """
    if device != "cpu" or not hasattr(os, "fork"):
        yield fresh_python
        return
    server = ScriptServer(SCRIPT_START)

    def run(script: str, *arguments: object, timeout: float = BLENDER_TIMEOUT) -> subprocess.CompletedProcess:
        return server.run(script, *arguments, timeout=timeout)

    yield run
    server.close()


@pytest.fixture(scope="session")
def run_extraction(run_python: Callable[..., subprocess.CompletedProcess]) -> Callable[[str], dict]:
    """Return a function that runs a script with everything of extract_scenes.py and returns what it finished with."""
    def run(script: str) -> dict:
        return result_of(run_python(IMPORTS.format(folder=FOLDER, module="extract_scenes") + script))

    return run


@pytest.fixture(scope="session")
def run_pictures(
    run_python: Callable[..., subprocess.CompletedProcess], device: str, tmp_path_factory: pytest.TempPathFactory,
) -> Callable[..., Any]:
    """Return a function that runs a script with everything of pictures.py, `run(script, *arguments)`.

    It returns what the script finished with; arguments are its third and further ones.
    """
    def run(script: str, *arguments: object) -> Any:
        chosen = "CPU" if device == "cpu" else "CUDA"
        return result_of(run_python(
            IMPORTS.format(folder=FOLDER, module="pictures") + script, chosen, tmp_path_factory.mktemp("pictures"),
            *arguments, timeout=PICTURES_TIMEOUT))

    return run
