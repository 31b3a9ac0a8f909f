# SPDX-License-Identifier: GPL-3.0-or-later
"""A process with the common kernels loaded that runs scripts in forks of itself.

Loading them takes a script that renders three seconds, a fork some milliseconds. A fork knows nothing of those before
it. It loads Blender itself: libraries that come with it start threads, which a fork lacks and would wait for. What is
about starting or ending a process belongs in a new one (`fresh_python`).
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import types
import warnings
from pathlib import Path
from typing import NoReturn

__all__ = ["ScriptServer"]

BLENDER_IMPORTS = ("cattrs.preconf.json", "multiprocessing.connection", "multiprocessing.synchronize", "requests")
"""The longest of what Blender itself imports when it starts, where its version does"""

POLL = 0.005
"""Seconds between two looks whether a script has ended"""


class ScriptServer:
    """Starts the process when it is needed, once, and again should it have died."""

    def __init__(self, start: str) -> None:
        """Make a server; `start`: code that the process and each script begin with (conftest.SCRIPT_START)."""
        self._start = start
        self._process: subprocess.Popen | None = None

    def run(self, script: str, *arguments: object, timeout: float) -> subprocess.CompletedProcess:
        """Run a script as `python -c script arguments...` would; see subprocess.run.

        Raises:
            subprocess.TimeoutExpired: It took longer than `timeout` seconds, and was ended.
            RuntimeError: The server itself has ended.
        """
        with tempfile.TemporaryDirectory() as folder:
            script, words = self._start + script, list(map(str, arguments))
            answer = self._ask({"script": script, "arguments": words, "timeout": timeout, "folder": folder})
            output, errors = (Path(folder, name).read_text(errors="replace") for name in ("output", "errors"))
        command = [sys.executable, "-c", script, *words]
        if answer["timed_out"]:
            raise subprocess.TimeoutExpired(command, timeout, output, errors)
        return subprocess.CompletedProcess(command, answer["returncode"], output, errors)

    def _ask(self, request: dict) -> dict:
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(
                [sys.executable, "-c", self._start + "import script_server; script_server.serve()"],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the script server has ended, {self._process.wait()}")
        return json.loads(line)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.stdin.close()
            self._process.wait()
            self._process = None


def serve() -> None:
    """Answer requests from standard input until it ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    _load()
    for line in sys.stdin:
        request = json.loads(line)
        answers.write(json.dumps(_run(request)) + "\n")
        answers.flush()


def _load() -> None:
    """Load what most scripts do, but Blender."""
    from burnish.engine.device import load_module, start_warp
    from burnish.engine.warmup import FIRST_MODULES

    start_warp()
    for module in {module.__name__ for modules in FIRST_MODULES.values() for module in modules}:
        load_module(module, "cpu")
    importlib.import_module("burnish.engine.session")
    for module in BLENDER_IMPORTS:
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    # Blender's library is read and linked here; only its start, which makes threads, is left to forks.
    ctypes.CDLL(importlib.util.find_spec("bpy").origin)
    # Forks import thousands of objects, and would look through all that is here for garbage again and again.
    gc.collect()
    gc.freeze()


def _run(request: dict) -> dict:
    """Run one request in a fork, and wait for it."""
    sys.stdout.flush()
    sys.stderr.flush()
    with warnings.catch_warnings():
        # Warp's and NumPy's threads are idle here, and a fork starts its own.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        _be_script(request)
    end = time.monotonic() + request["timeout"]
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return {"timed_out": False, "returncode": os.waitstatus_to_exitcode(status)}
        if time.monotonic() > end:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return {"timed_out": True, "returncode": None}
        time.sleep(POLL)


def _be_script(request: dict) -> NoReturn:
    """Run the script in this process, and end it."""
    os.setsid()
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    for descriptor, name in ((1, "output"), (2, "errors")):
        file = os.open(Path(request["folder"], name), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(file, descriptor)
    sys.argv = ["-c", *request["arguments"]]
    module = sys.modules["__main__"] = types.ModuleType("__main__")
    code = 0
    try:
        exec(compile(request["script"], "<string>", "exec"), module.__dict__)  # noqa: S102
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
    except BaseException:  # noqa: BLE001 - as an interpreter does
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.CDLL(None).fflush(None)
    os._exit(code)
