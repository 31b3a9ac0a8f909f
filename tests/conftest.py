# SPDX-License-Identifier: GPL-3.0-or-later
"""What all tests share: the package under its name, a quiet Warp, the device, and Blender in a process of its own.

Tests import `burnish` as installed by `make setup`. bpy is only ever loaded in child processes: it takes over the
process that imports it and a crash in it must not end the run.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BLENDER_TIMEOUT = 120.0
"""Seconds after which a child process with bpy counts as hanging."""

SCRIPT_START = f"import sys; sys.path.insert(0, {str(ROOT / 'tests')!r}); import conftest\n"
"""What scripts in child processes begin with: makes `burnish` this checkout"""


def _load_package() -> None:
    """Make `burnish` this checkout, even where another one (or none) is installed."""
    spec = importlib.util.find_spec("burnish")
    if spec and spec.origin and Path(spec.origin).resolve().parent == ROOT:
        return
    spec = importlib.util.spec_from_file_location(
        "burnish", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    module = importlib.util.module_from_spec(spec)
    sys.modules["burnish"] = module
    spec.loader.exec_module(module)


_load_package()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--device cuda`, to run the kernel tests on a GPU."""
    parser.addoption("--device", default="cpu", help="Warp device of the tests: cpu or cuda:0")


def pytest_configure(config: pytest.Config) -> None:
    """Tell tests/scenes.py which device to render on."""
    os.environ["BURNISH_TEST_DEVICE"] = config.getoption("--device").partition(":")[0]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip tests marked `gpu` where there is no CUDA device."""
    marked = [item for item in items if item.get_closest_marker("gpu")]
    if not marked:
        return
    from burnish.engine.device import start_warp

    start_warp()
    import warp as wp

    if not wp.is_cuda_available():
        for item in marked:
            item.add_marker(pytest.mark.skip(reason="no CUDA device"))


@pytest.fixture(scope="session", autouse=True)
def shared_cores() -> None:
    """Divide the cores between processes that run tests side by side: more threads would only take turns."""
    from burnish.engine.device import thread_count, use_threads

    use_threads(max(1, thread_count() // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))))


@pytest.fixture(scope="session", autouse=True)
def quiet_warp(request: pytest.FixtureRequest) -> None:
    """Let Warp print errors only, and build kernels that tests launch by themselves as those that the engine loads."""
    import warp as wp
    from burnish.engine.device import FUSED

    wp.config.log_level = wp.LOG_ERROR
    # Warp would look for kernels of a GPU by these flags too, and build all of them anew.
    on_processor = request.config.getoption("--device") == "cpu"
    if on_processor and getattr(wp.config, "cpu_compiler_flags", None) is not None:
        wp.config.cpu_compiler_flags += f" {FUSED}"


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> str:
    """Return the Warp device that tests run on."""
    return request.config.getoption("--device")


@pytest.fixture(scope="session")
def fresh_python() -> Callable[..., subprocess.CompletedProcess]:
    """Return a function that runs a Python script in a new process, where `burnish` and bpy can be imported."""

    def run(script: str, *arguments: object, timeout: float = BLENDER_TIMEOUT,
            environment: dict[str, str] | None = None) -> subprocess.CompletedProcess:
        return subprocess.run(
            [sys.executable, "-c", SCRIPT_START + script, *map(str, arguments)], capture_output=True, text=True,
            errors="replace", timeout=timeout, stdin=subprocess.DEVNULL, env={**os.environ, **(environment or {})})

    return run


@pytest.fixture(scope="session")
def run_python(fresh_python: Callable[..., subprocess.CompletedProcess]) -> Callable[..., subprocess.CompletedProcess]:
    """Return the same; tests/blender has a quicker one for scripts that are not about the process itself."""
    return fresh_python


@pytest.fixture(scope="session")
def burnish(fresh_python: Callable[..., subprocess.CompletedProcess]) -> Callable[..., subprocess.CompletedProcess]:
    """Return a function that runs the command line: `burnish("render", scene, "--output", path)`."""

    def run(*arguments: object, **options: object) -> subprocess.CompletedProcess:
        return fresh_python("from burnish.addon.cli import main; raise SystemExit(main())", *arguments, **options)

    return run
