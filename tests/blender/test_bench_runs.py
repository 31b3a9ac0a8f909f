# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole runs of the benchmark: broken engines and scenes, resumed and interrupted runs, budgets on both clocks."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from burnish.engine.image_error import relative_mse
from burnish.engine.read import read_exr
from burnish.engine.write import LayerPixels, PassPixels, write_exr

Run = Callable[..., subprocess.CompletedProcess]

ROOT = Path(__file__).resolve().parents[2]
CORNELL = ROOT / "sample_blends" / "cornell.blend"
TIMEOUT = 900.0

BROKEN_BURNISH = """
from burnish.addon import cli, final, report
from burnish.engine.errors import BurnishError

def render(engine, depsgraph):
    report.fail(engine, BurnishError("The lamp oil has run out; refill it"))

final.render = render
"""
RUN = """
raise SystemExit(cli.main())
"""
INTERRUPTING = """
import signal, threading, time
from burnish.addon.bench_progress import Progress

begin = Progress.begin

def interrupt(progress, text):
    begin(progress, text)
    if "Cycles 4 spp" in text:
        signal.raise_signal(signal.SIGINT)
        time.sleep(0.5)

Progress.begin = interrupt
"""


def scenes_of(output: Path) -> list[dict[str, Any]]:
    """Return the scenes of results.json."""
    return json.loads((output / "results.json").read_text("utf-8"))["scenes"]


def rows_of(output: Path, index: int = 0) -> dict[str, dict[str, Any]]:
    """Return a scene's rows by label."""
    return {row["label"]: row for row in scenes_of(output)[index]["rows"]}


@pytest.fixture(scope="module")
def broken_run(tmp_path_factory: pytest.TempPathFactory, fresh_python: Run,
               ) -> tuple[Path, subprocess.CompletedProcess, subprocess.CompletedProcess]:
    """Return folder and output of two identical runs in which Burnish fails."""
    output = tmp_path_factory.mktemp("bench")
    arguments = ("bench", CORNELL, "--device", "cpu", "--size", 64, 36, "--samples", 4, "--truth", 16, "--engines",
                 "reference", "--peers", "cycles", "--output", output)
    return output, *(fresh_python(BROKEN_BURNISH + RUN, *arguments, timeout=TIMEOUT) for _ in range(2))


@pytest.mark.slow
def test_failing_engine_is_a_row(broken_run: tuple) -> None:
    """Report an engine's failure as its row, measure the others, and exit with 0."""
    output, first, _ = broken_run
    assert first.returncode == 0, first.stdout + first.stderr
    scene, rows = scenes_of(output)[0], rows_of(output)
    assert rows["Burnish Reference 4 spp"]["failure"] == "The lamp oil has run out; refill it"
    for name in ("results.md", "report.html"):
        assert "The lamp oil has run out" in (output / name).read_text("utf-8")
    cycles = rows["Cycles 4 spp"]
    assert cycles["seconds"] > 0.0 and 0.02 < cycles["errors"]["flip"] < 0.9
    assert 0.7 < cycles["errors"]["luminance"] < 1.4
    assert scene["truth_errors"]["flip"] < cycles["errors"]["flip"] and scene["truth_noise"] > 0.0


@pytest.mark.slow
def test_run_saves_side_by_side_pictures(broken_run: tuple) -> None:
    """Save one labelled PNG per row: four enlarged panels under a bar."""
    import OpenImageIO as oiio

    picture, = broken_run[0].glob("cornell*/*.png")
    pixels = np.asarray(oiio.ImageBuf(str(picture)).get_pixels(oiio.FLOAT))
    assert pixels.shape[:2] == (8 * 36 + 26, 4 * 8 * 64)
    assert pixels[:26].std() > 0.02, "no text in the bar"


@pytest.mark.slow
def test_second_run_renders_only_what_failed(broken_run: tuple) -> None:
    """Render nothing again but the row that failed."""
    _, first, second = broken_run
    assert "[4/4]" in first.stdout and "[1/1] cornell: Burnish Reference 4 spp" in second.stdout
    assert "Cycles 4 spp: " in second.stdout and second.returncode == 0


@pytest.mark.slow
def test_wrong_reference_is_a_sentence(broken_run: tuple, fresh_python: Run) -> None:
    """Say in one sentence that a reference has another size, and go on with the next scene."""
    output = broken_run[0]
    truth = next(output.glob("*/truth.exr"))
    small = output / "small.exr"
    write_exr(small, [LayerPixels("a", (PassPixels("Combined", "RGB", np.ones((18, 32, 3), np.float32)),))], {})
    result = fresh_python(
        BROKEN_BURNISH + RUN, "bench", CORNELL, CORNELL, "--device", "cpu", "--size", 32, 18, "--samples", 4,
        "--engines", "", "--peers", "cycles", "--reference", truth, "--reference", small, "--output", output / "wrong",
        timeout=TIMEOUT)
    assert result.returncode == 1
    assert "has 64 x 36 pixels, not 32 x 18" in result.stdout
    first, second = scenes_of(output / "wrong")
    assert first["failure"] and not second["failure"] and second["truth_noise"] is None
    assert "its own noise is not known" in (output / "wrong" / "report.html").read_text("utf-8")


@pytest.mark.slow
def test_interrupted_run_keeps_what_it_has(tmp_path: Path, fresh_python: Run) -> None:
    """After Ctrl-C finish the picture, report what is there, exit with 130, and go on from there the next time."""
    arguments = ("bench", CORNELL, CORNELL, "--device", "cpu", "--size", 48, 27, "--samples", "4,8", "--truth", 8,
                 "--engines", "", "--peers", "cycles", "--output", tmp_path)
    result = fresh_python(BROKEN_BURNISH + INTERRUPTING + RUN, *arguments, timeout=TIMEOUT)
    assert result.returncode == 130, result.stdout + result.stderr
    assert list(rows_of(tmp_path)) == ["Cycles 4 spp"]
    first, second = scenes_of(tmp_path)
    assert first["interrupted"] and "interrupted before this scene" in second["failure"]
    text = (tmp_path / "report.html").read_text("utf-8")
    assert "rows are missing" in text and "Cycles 4 spp" in text
    result = fresh_python(BROKEN_BURNISH + RUN, *arguments, timeout=TIMEOUT)
    assert result.returncode == 0 and list(rows_of(tmp_path, 1)) == ["Cycles 4 spp", "Cycles 8 spp"]
    assert "Truth" not in "".join(line for line in result.stdout.splitlines() if line.startswith("["))


@pytest.fixture(scope="module")
def budget_run(tmp_path_factory: pytest.TempPathFactory, burnish: Run) -> tuple[Path, subprocess.CompletedProcess]:
    """Return folder and output of a run of a broken scene and a good one at a time nobody meets and two others."""
    output = tmp_path_factory.mktemp("budgets")
    broken = output / "broken.blend"
    broken.write_bytes(b"no blend file")
    return output, burnish(
        "bench", broken, CORNELL, "--device", "cpu", "--size", 32, 18, "--truth", 64, "--engines",
        "realtime,reference", "--budgets", "0.000001,0.4,4", "--cold-budgets", "0.000001,8", "--repetitions", 2,
        "--output", output, timeout=TIMEOUT)


@pytest.mark.slow
def test_broken_scene_stops_nobody(budget_run: tuple) -> None:
    """Say what is wrong with a scene in a sentence, measure the next one, and exit with 1."""
    output, result = budget_run
    assert result.returncode == 1
    broken, good = scenes_of(output)
    assert "can't be opened" in broken["failure"] and not broken["rows"]
    assert good["failure"] is None and len(good["rows"]) == 4 * 3 + 1 + 4 * 2


@pytest.mark.slow
def test_nobody_meets_a_microsecond(budget_run: tuple) -> None:
    """Give no engine a picture at a time that is too short for one, say why, and call nobody better."""
    output, _ = budget_run
    rows = rows_of(output, 1)
    short = [row for label, row in rows.items() if " 1e-06 s " in label]
    assert len(short) == 8 and all(row["no_picture"].startswith("no picture: ") for row in short)
    verdicts = [each for each in scenes_of(output)[1]["verdicts"] if each["budget"] < 1e-5]
    assert verdicts and all(each["own"] is None and each["rival"] is None for each in verdicts)
    report = (output / "report.html").read_text("utf-8")
    assert "nobody has a picture" in report and "one frame, read back, takes" in report


@pytest.mark.slow
def test_budgets_are_filled(budget_run: tuple) -> None:
    """Fill each budget with samples, more of them in a longer time, and tell the parts of the time."""
    rows = rows_of(budget_run[0], 1)
    for engine in ("Burnish Realtime", "Burnish Reference", "Cycles"):
        short, long = rows[f"{engine} 0.4 s warm"], rows[f"{engine} 4 s warm"]
        if not short.get("no_picture"):
            assert 1 <= short["samples"] < long["samples"]
        assert long["errors"]["bad_pixels"] == 0 and 0.8 < long["errors"]["luminance"] < 1.25
        assert sum(long["parts"].values()) == pytest.approx(long["seconds"])
    cold = rows["Burnish Realtime 8 s cold"]
    assert {"extraction", "upload", "structures", "sampling", "read", "rest"} <= set(cold["parts"])
    moving = rows["Burnish Realtime, camera moving"]
    assert moving["samples"] >= 3 and moving["frame_times"] and moving["errors"]["flip"] < 0.5


@pytest.mark.slow
def test_cycles_shares_long_renders(budget_run: tuple) -> None:
    """Take a long budget's picture with and without denoising out of one render, where denoising is short."""
    output, _ = budget_run
    rows = rows_of(output, 1)
    plain, denoised = (rows[f"{engine} 4 s warm"] for engine in ("Cycles", "Cycles + OIDN"))
    if "shared" in plain:
        assert plain["samples"] == denoised["samples"]
    pictures = [read_exr(output / row["file"]) for row in (plain, denoised)]
    assert 0.0 < relative_mse(*pictures) < 0.2


@pytest.mark.slow
def test_burnish_is_measured(tmp_path: Path, burnish: Run) -> None:
    """Measure the real engine: times in parts, the truth's mean luminance, and noise that falls as 1/sqrt(N)."""
    result = burnish("bench", CORNELL, "--device", "cpu", "--size", 64, 36, "--samples", 8, "--truth", 1024,
                     "--engines", "reference", "--peers", "", "--noise", "--output", tmp_path, timeout=TIMEOUT)
    assert result.returncode == 0, result.stdout + result.stderr
    row = rows_of(tmp_path)["Burnish Reference 8 spp"]
    assert not row.get("failure"), row
    assert row["samples_done"] == 8 and 0.0 < row["sampling_seconds"] < row["seconds"]
    assert {"extraction", "sampling", "read"} <= set(row["times"])
    assert row["errors"]["bad_pixels"] == 0 and row["errors"]["dark_luminance"] == pytest.approx(1.0, abs=0.1)
    noise = [entry["noise"] for entry in scenes_of(tmp_path)[0]["noise"]]
    # From 8 to 128 samples a Monte Carlo estimate's noise falls by 4; well distributed samples may do better.
    assert 3.0 < noise[0] / noise[2] < 7.0


@pytest.mark.slow
def test_draft_leaves_other_engines_as_they_are(tmp_path: Path, burnish: Run) -> None:
    """Render the Draft preset as an engine of its own; the scene's settings are there again for those after it."""
    errors = {}
    for engines in ("draft,realtime", "realtime"):
        result = burnish("bench", CORNELL, "--device", "cpu", "--size", 64, 36, "--samples", 2, "--truth", 32,
                         "--engines", engines, "--peers", "", "--budgets", "2", "--clocks", "warm", "--output",
                         tmp_path / engines, timeout=TIMEOUT)
        assert result.returncode == 0, result.stdout + result.stderr
        errors[engines] = {name: row["errors"]["flip"] for name, row in rows_of(tmp_path / engines).items()}
    both = errors["draft,realtime"]
    assert {"Burnish Draft 2 frames", "Burnish Draft 2 s warm", "Burnish Realtime 2 s warm"} < set(both)
    assert both["Burnish Draft 2 frames"] != both["Burnish Realtime 2 frames"]
    assert both["Burnish Realtime 2 frames"] == errors["realtime"]["Burnish Realtime 2 frames"]


SUBSETS = """
import sys
from pathlib import Path
import numpy as np
from burnish import addon
from burnish.addon.bench_engines import open_scene
from burnish.addon.bench_store import Job
from burnish.engine.read import read_exr

addon.register()
scene, folder = open_scene(Path(sys.argv[1]), (24, 16), "cpu"), Path(sys.argv[2])
whole, plain, denoised = (folder / f"{name}.exr" for name in ("whole", "plain", "denoised"))
scene.persistent = True
scene.configure(Job(engine="cycles", samples=12, seed=7))
scene.shoot(whole)
mean = 0.0
for offset, samples in ((0, 4), (4, 8)):
    part, _ = scene.shoot_part(Job(engine="cycles", samples=samples, seed=7), offset, 12,
                               folder / "part.exr")
    mean = mean + part * (samples / 12)
scene.shoot_both(Job(engine="cycles+oidn", samples=12, seed=7), plain, denoised)
print("GROWN", float(np.abs(mean - read_exr(whole)).max()))
print("PLAIN", float(np.abs(read_exr(plain) - read_exr(whole)).max()))
print("DENOISED", float(np.abs(read_exr(denoised) - read_exr(whole)).mean()))
scene.configure(Job(engine="cycles+oidn", samples=12, seed=7))
scene.shoot(whole)
print("AGAIN", float(np.abs(read_exr(denoised) - read_exr(whole)).mean()))
addon.unregister()
"""


@pytest.mark.slow
def test_parts_of_a_render_add_up(tmp_path: Path, fresh_python: Run) -> None:
    """Grow a picture of Cycles by samples, and take it with and without denoising out of one render."""
    result = fresh_python(SUBSETS, CORNELL, tmp_path, timeout=TIMEOUT)
    assert result.returncode == 0, result.stdout + result.stderr
    lines = [line.split() for line in result.stdout.splitlines()]
    found = {line[0]: float(line[1]) for line in lines if line and line[0] in ("GROWN", "PLAIN", "DENOISED", "AGAIN")}
    assert found["GROWN"] < 1e-4 and found["PLAIN"] < 1e-4 and found["AGAIN"] < 1e-4
    assert found["DENOISED"] > 100.0 * found["AGAIN"]


PROBES = """
import subprocess, sys
from pathlib import Path
from burnish.addon import bench_rivals
from burnish.engine.errors import BurnishError

def crash(*arguments, **options):
    return subprocess.CompletedProcess(arguments, -6, "", "")

def hang(*arguments, **options):
    raise subprocess.TimeoutExpired(arguments, 1.0)

def work(*arguments, **options):
    (Path(sys.argv[1]) / ".eevee_probe.png").write_bytes(b"")
    return subprocess.CompletedProcess(arguments, 0, "noise\\nRENDERER Fast Card\\n", "")

for run in (crash, hang, work):
    bench_rivals.subprocess.run = run
    bench_rivals.probe_eevee.cache_clear()
    try:
        print("SAYS", bench_rivals.check_eevee(Path(sys.argv[1])))
    except BurnishError as error:
        print("SAYS", error)
"""


@pytest.mark.slow
def test_eevee_without_a_context_is_a_sentence(tmp_path: Path, fresh_python: Run) -> None:
    """Try EEVEE in a process of its own and say what became of it: a crash, a hang, or the card it runs on."""
    result = fresh_python(PROBES, tmp_path, timeout=TIMEOUT)
    says = [line.removeprefix("SAYS ") for line in result.stdout.splitlines() if line.startswith("SAYS ")]
    assert len(says) == 3, result.stdout + result.stderr
    assert "needs a graphics driver" in says[0] and "rasterizes on the processor" in says[1] and says[2] == "Fast Card"
