# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension, installed from its zip into a real Blender with a window, driven by drive.py (`make gui`).

Needs a command that runs its arguments on a screen with Blender, xdotool and ImageMagick: the environment variable
BURNISH_WINDOW, else the one beside the checkout. Without any the test is skipped.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "out" / "gui"
SCENE = "sample_blends/gallery.blend"
INSTALL_SECONDS = 300
DRIVE_SECONDS = 1500
SIZE = ("640", "480")
"""Of screen and window; Blender makes no smaller one."""

TROUBLE = re.compile(r"Traceback|EXCEPTION|Segmentation fault|Burnish: |ReferenceError|Error: |Warp (CUDA )?error")
"""What must not be in Blender's output."""
HARMLESS = re.compile(r"ALSA|XDG_RUNTIME_DIR|vk_|Vulkan|libdecor|wayland|color management", re.IGNORECASE)

pytestmark = pytest.mark.window


@pytest.fixture(scope="session")
def window_command() -> list[str]:
    """Return the command that shows a window."""
    command = os.environ.get("BURNISH_WINDOW")
    if command:
        return shlex.split(command)
    beside = ROOT.parent / "shared" / "gui" / "run"
    if not beside.exists():
        pytest.skip("no Blender window here: set BURNISH_WINDOW to a command that shows one")
    return [os.path.relpath(beside, ROOT)]


def run(command: list[str], timeout: int) -> subprocess.CompletedProcess:
    """Run a command in the root with this test's own Blender preferences; output and errors together."""
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(OUT / "user"), "LIMIT": str(timeout),
                   "SCREEN": "x".join(SIZE), "WARP_CACHE_PATH": str(OUT / "kernels")}
    return subprocess.run(command, cwd=ROOT, env=environment, timeout=timeout + 60, text=True, errors="replace",
                          stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


@pytest.fixture(scope="session")
def installed(window_command: list[str]) -> list[str]:
    """Install the zip into fresh preferences; return the command that shows a window."""
    packages = sorted((ROOT / "dist").glob("burnish-*-linux_x64.zip"))
    assert packages, "there is no package; run `make package`"
    shutil.rmtree(OUT / "user", ignore_errors=True)
    (OUT / "user").mkdir(parents=True)
    (OUT / "kernels").mkdir(exist_ok=True)
    zip_path = str(packages[-1].relative_to(ROOT))
    result = run([*window_command, "blender", "--command", "extension", "install-file", "-r", "user_default", "-e",
                  zip_path], INSTALL_SECONDS)
    assert result.returncode == 0, result.stdout
    assert not troubles(result.stdout), result.stdout
    return window_command


def troubles(log: str) -> list[str]:
    """Return the lines of Blender's output that tell of an exception or error."""
    return [line for line in log.splitlines() if TROUBLE.search(line) and not HARMLESS.search(line)]


@pytest.mark.parametrize(("backend", "integrator"), [
    ("opengl", "REALTIME"), ("vulkan", "REFERENCE")])
def test_window(installed: list[str], backend: str, integrator: str) -> None:
    """Render in the viewport, orbit, move, edit, undo, switch a lamp, modes and press F12; every step must show."""
    folder = OUT / f"{backend}-{integrator.lower()}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    result = run([*installed, "blender", "--gpu-backend", backend, "-p", "0", "0", *SIZE, SCENE, "--python",
                  "tests/gui/drive.py", "--", str(folder), integrator], DRIVE_SECONDS)
    (folder / "blender.log").write_text(result.stdout)
    tail = result.stdout[-3000:]
    assert (folder / "result.json").exists(), f"Blender ended early, status {result.returncode}:\n{tail}"
    notes = json.loads((folder / "result.json").read_text())
    assert "error" not in notes, f"{notes['error']}\n{tail}"
    assert notes.get("finished"), notes
    assert not troubles(result.stdout), "\n".join(troubles(result.stdout))
    assert result.returncode == 0, f"Blender ended with {result.returncode}:\n{tail}"
    assert all(step["structure"] > 0.3 for step in notes["steps"]), notes["steps"]


def test_command_in_blender(installed: list[str]) -> None:
    """Render with `blender --command burnish`, the same command as outside Blender, and fail with its exit status."""
    picture = OUT / "command.png"
    picture.unlink(missing_ok=True)
    command = [*installed, "blender", "--command", "burnish", "render", "--output", str(picture), "--samples", "1"]
    result = run([*command, "--size", "64", "36", SCENE], INSTALL_SECONDS)
    assert result.returncode == 0, result.stdout
    assert f"{picture} 64x36 1 samples" in result.stdout
    assert picture.stat().st_size > 1000
    result = run([*command, "missing.blend"], INSTALL_SECONDS)
    assert result.returncode == 1, result.stdout
    assert "The scene 'missing.blend' does not exist." in result.stdout
