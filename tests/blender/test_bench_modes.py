# SPDX-License-Identifier: GPL-3.0-or-later
"""`burnish bench --scaling`, `--ablation` and `--profile` as whole commands: what they write, what they refuse."""

from __future__ import annotations

import importlib.util
import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CORNELL = ROOT / "sample_blends" / "cornell.blend"
TIMEOUT = 400.0
"""Seconds: kernels may have to be built first"""
Burnish = Callable[..., subprocess.CompletedProcess]

plots = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("matplotlib", "flip_evaluator")),
    reason="needs the extra `bench`")


def read(folder: Path, name: str) -> tuple[dict, str]:
    """Return a measurement's results and its tables."""
    return json.loads((folder / f"{name}.json").read_text("utf-8")), (folder / f"{name}.md").read_text("utf-8")


@pytest.mark.slow
@plots
def test_scaling_needs_no_scene(burnish: Burnish, tmp_path: Path) -> None:
    """Measure one sweep, tell each point, write results, table and plot."""
    done = burnish("bench", "--scaling", "glossy,lamps", "--budget-seconds", 2, "--device", "cpu", "--size", 16, 12,
                   "--output", tmp_path, timeout=TIMEOUT)
    assert done.returncode == 0, done.stderr
    results, table = read(tmp_path, "scaling")
    glossy, lamps = results["sweeps"]
    assert glossy["points"][0]["value"] == 0 and glossy["points"][0]["frame"] > 0
    assert len(lamps["points"]) + len(lamps["left_out"]) == 4 and "lamps 1: " in done.stdout
    assert "Left out" in table or len(lamps["points"]) == 4
    drawn = max(len(glossy["points"]), len(lamps["points"])) > 1
    assert (tmp_path / "scaling.png").is_file() == drawn or "No plot" in done.stdout


@pytest.mark.slow
@plots
def test_ablation_holds_variants_against_the_default(burnish: Burnish, tmp_path: Path) -> None:
    """Render the chosen variants and the default, with errors at rest and in flight and the time in motion."""
    done = burnish("bench", CORNELL, "--ablation", "clean-up,draft", "--frames", "2,4", "--truth", 4, "--flight-truth",
                   2, "--device", "cpu", "--size", 32, 20, "--time-size", 16, 16, "--output", tmp_path, timeout=TIMEOUT)
    assert done.returncode == 0, done.stderr
    results, table = read(tmp_path, "ablation")
    rows = results["scenes"][0]["rows"]
    assert [row["variant"] for row in rows] == ["default", "no clean-up", "preset draft"]
    assert all(set(row["errors"]) == {"2", "4", "flight"} and row["ms"] > 0 for row in rows)
    assert rows[0]["flip_difference"] == {"2": 0, "4": 0, "flight": 0} and rows[2]["flip_difference"]["4"] != 0
    assert "| no clean-up |" in table and (tmp_path / "ablation.png").is_file()


@pytest.mark.slow
@plots
def test_profile_lists_passes_and_their_floor(burnish: Burnish, tmp_path: Path) -> None:
    """Tell milliseconds, launches, bytes and rays of each pass, and draw them."""
    done = burnish("bench", CORNELL, "--profile", "--device", "cpu", "--size", 32, 20, "--output", tmp_path,
                   timeout=TIMEOUT)
    assert done.returncode == 0, done.stderr
    results, table = read(tmp_path, "profile")
    passes = {each["name"]: each for each in results["scenes"]["cornell"]["passes"]}
    assert passes["G-buffer"]["rays"] == 32 * 20 and passes["Radiance cache"]["launches"] > 10
    assert passes["Reflections"]["milliseconds"] > 0 and "| Composite |" in table
    assert "| Primary rays |" in table and " ms at rest, " in table
    assert (tmp_path / "profile_cornell.png").is_file()


REFUSED = {
    "There is no sweep 'cows'": ("--scaling", "cows"),
    "--ablation needs a scene": ("--ablation",),
    "--profile needs a scene": ("--profile",),
    "No variant has 'cows' in its name": (str(CORNELL), "--ablation", "cows"),
    "--frames must be whole numbers from 1": (str(CORNELL), "--ablation", "--frames", "0"),
    "give --reference once for each scene": (
        str(CORNELL), "--ablation", "--reference", "a.exr", "--reference", "b.exr"),
}
"""Options that can not work, by what is said of them"""

COMMANDS = """
import contextlib, io, json
from burnish.addon.cli import main

results = {}
for sentence, arguments in json.loads(sys.argv[1]).items():
    with contextlib.redirect_stderr(io.StringIO()) as error:
        results[sentence] = main(["bench", *arguments]), error.getvalue()
print("RESULT " + json.dumps(results))
"""


@pytest.fixture(scope="module")
def refusals(run_python: Burnish) -> dict[str, list]:
    """Return exit status and errors of all refused commands, run one after another in one child process."""
    done = run_python(COMMANDS, json.dumps(REFUSED), timeout=TIMEOUT)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.rpartition("RESULT ")[2])


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_can_not_work_is_a_sentence(refusals: dict[str, list], sentence: str) -> None:
    """Say in one sentence what is wrong with the options."""
    status, error = refusals[sentence]
    assert status == 1 and sentence in error and error.count("\n") == 1
