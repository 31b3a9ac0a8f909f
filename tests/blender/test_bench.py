# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark: its options, its memory of what is done, and whole runs with a broken and with the real engine."""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from burnish.addon import bench, bench_report, bench_store
from burnish.addon.bench_store import Job, SceneStore
from burnish.engine.errors import BurnishError

ROOT = Path(__file__).resolve().parents[2]
CORNELL = ROOT / "sample_blends" / "cornell.blend"

BROKEN_BURNISH = """
from burnish.addon import cli, final, report
from burnish.engine.errors import BurnishError

def render(engine, depsgraph):
    report.fail(engine, BurnishError("The lamp oil has run out; refill it"))

final.render = render
raise SystemExit(cli.main())
"""


def parse(*arguments: str) -> argparse.Namespace:
    """Return parsed options."""
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    return parser.parse_args([*arguments])


def test_jobs_follow_the_options() -> None:
    """Plan the truth's halves, each engine at each count and budget, and the noise pairs."""
    truth, rows, noise = bench.plan_jobs(parse(
        "a.blend", "--samples", "4,16", "--budgets", "0.5", "--peers", "cycles,eevee", "--truth", "256", "--noise"))
    assert [(job.samples, job.seed) for job in truth] == [(128, 101), (128, 202)]
    assert [job.label for job in rows] == [
        "Burnish Reference 4 spp", "Burnish Reference 16 spp", "Cycles 4 spp", "Cycles 16 spp", "EEVEE 4 spp",
        "EEVEE 16 spp", "Burnish Reference 0.5 s", "Cycles 0.5 s"]
    assert [job.samples for job in noise] == [4, 4, 16, 16, 64, 64]
    assert len({job.name for job in [*truth, *rows, *noise]}) == 2 + 8 + 6


def test_realtime_has_frames_of_its_own() -> None:
    """Plan 1, 8, 64 and 256 frames of the real-time integrator, its peers at 64 samples, and obey --samples."""
    rows = bench.plan_jobs(parse("a.blend", "--integrator", "realtime", "--peers", "cycles", "--budgets", "2"))[1]
    assert [job.label for job in rows] == [
        "Burnish Realtime 1 frame", "Burnish Realtime 8 frames", "Burnish Realtime 64 frames",
        "Burnish Realtime 256 frames", "Cycles 64 spp", "Burnish Realtime 2 s", "Cycles 2 s"]
    rows = bench.plan_jobs(parse("a.blend", "--integrator", "realtime", "--peers", "cycles", "--samples", "4"))[1]
    assert [job.label for job in rows] == ["Burnish Realtime 4 frames", "Cycles 4 spp"]
    assert not bench_store.OWN & set(bench.PEERS)


def test_sections_of_a_frame_are_a_table() -> None:
    """Show each section's milliseconds in a column of its own, and their sum."""
    errors = dict.fromkeys(("flip", "flip_box", "relative_mse", "luminance", "dark_luminance", "block_p5",
                            "block_p95", "bad_pixels"), 0.0)
    result = bench_report.SceneResult(name="a", hash="", size=(1, 1), device="cpu", truth="none", rows=[
        {"label": "One", "errors": errors, "frame_times": {"Rays": 1.0, "Rest": 0.25}},
        {"label": "Two", "errors": errors, "frame_times": {"Rays": 2.0}}, {"label": "Cycles", "errors": errors}])
    lines = bench_report.frame_markdown(result)
    assert "| render | sum | Rays | Rest |" in lines and "| One | 1.250 | 1.000 | 0.250 |" in lines
    assert "| Two | 2.000 | 2.000 |  |" in lines and not any("Cycles" in line for line in lines)


def test_reference_replaces_the_truth() -> None:
    """Render no truth where a picture is given."""
    assert bench.plan_jobs(parse("a.blend", "--reference", "a.exr"))[0] == []


@pytest.mark.parametrize("arguments", [
    ("--samples", "0"), ("--samples", "a"), ("--peers", "luxcore"), ("--size", "0", "9"), ("--budgets", "-1")])
def test_wrong_options_are_refused(arguments: tuple[str, ...], capsys: pytest.CaptureFixture) -> None:
    """Refuse impossible values, naming the option."""
    with pytest.raises(SystemExit):
        parse("a.blend", *arguments)
    assert arguments[0] in capsys.readouterr().err


def test_missing_files_are_named(tmp_path: Path) -> None:
    """Name the missing scene, and a wrong number of references, before anything is rendered."""
    with pytest.raises(BurnishError, match=r"none\.blend.*does not exist"):
        bench.run(parse(str(tmp_path / "none.blend")))
    with pytest.raises(BurnishError, match="1 scenes but 2 references"):
        bench.run(parse("a.blend", "--reference", "a.exr", "--reference", "b.exr"))


def test_store_remembers_finished_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Know a picture with its record as done, until its file is gone or Burnish's source has changed."""
    scene = tmp_path / "scene.blend"
    scene.write_bytes(b"one")
    store = SceneStore(tmp_path / "out", scene, (32, 18), "cuda:0")
    burnish, realtime, cycles = (Job(engine=engine, samples=4) for engine in ("burnish", "realtime", "cycles"))
    for job in (burnish, realtime, cycles):
        store.save(job, {"source": bench_store.source_hash()})
        assert store.record(job) is None, "a record without its picture"
        store.path(job, ".exr").write_bytes(b"")
    assert list(store.missing([burnish, realtime, cycles])) == []
    monkeypatch.setattr(bench_store, "source_hash", lambda: "changed")
    assert list(store.missing([burnish, realtime, cycles])) == [burnish, realtime]
    scene.write_bytes(b"two")
    assert SceneStore(tmp_path / "out", scene, (32, 18), "cuda:0").folder != store.folder


def test_truth_is_shared_between_devices(tmp_path: Path) -> None:
    """Keep one truth for all devices, but times of each device apart."""
    scene = tmp_path / "scene.blend"
    scene.write_bytes(b"")
    cpu, cuda = (SceneStore(tmp_path, scene, (32, 18), device) for device in ("cpu", "cuda:0"))
    truth, cycles = Job(engine="truth", samples=4), Job(engine="cycles", samples=4)
    assert cpu.path(truth, ".exr") == cuda.path(truth, ".exr")
    assert cpu.path(cycles, ".exr") != cuda.path(cycles, ".exr")


def test_noise_table_shows_the_fall() -> None:
    """Show by which factor noise falls from row to row."""
    result = bench_report.SceneResult(name="a", hash="", size=(1, 1), device="cpu", truth="none", noise=[
        bench_report.NoiseRow(samples=4, noise=0.2, left=None),
        bench_report.NoiseRow(samples=16, noise=0.1, left=0.01)])
    assert "| 16 | 0.10000 | 2.00 | 0.01000 |" in bench_report.noise_markdown(result)


@pytest.fixture(scope="module")
def broken_run(tmp_path_factory: pytest.TempPathFactory, run_python: Callable[..., subprocess.CompletedProcess],
               ) -> tuple[Path, subprocess.CompletedProcess, subprocess.CompletedProcess]:
    """Return folder and output of two identical runs in which Burnish fails."""
    output = tmp_path_factory.mktemp("bench")
    arguments = ("bench", CORNELL, "--device", "cpu", "--size", 64, 36, "--samples", 4, "--truth", 16, "--peers",
                 "cycles", "--output", output)
    return output, *(run_python(BROKEN_BURNISH, *arguments) for _ in range(2))


def test_failing_engine_is_a_row(broken_run: tuple) -> None:
    """Report an engine's failure as its row, measure the others, and exit with 0."""
    output, first, _ = broken_run
    assert first.returncode == 0, first.stdout + first.stderr
    scene = json.loads((output / "results.json").read_text("utf-8"))["scenes"][0]
    rows = {row["label"]: row for row in scene["rows"]}
    assert rows["Burnish Reference 4 spp"]["failure"] == "The lamp oil has run out; refill it"
    assert "The lamp oil has run out" in (output / "results.md").read_text("utf-8")
    cycles = rows["Cycles 4 spp"]
    assert cycles["seconds"] > 0.0 and 0.02 < cycles["errors"]["flip"] < 0.9
    assert 0.7 < cycles["errors"]["luminance"] < 1.4
    halves = rows["Truth's halves against each other"]["errors"]
    assert halves["flip"] < cycles["errors"]["flip"] and scene["truth_noise"] > 0.0


def test_run_saves_side_by_side_pictures(broken_run: tuple) -> None:
    """Save one labelled PNG per row: four enlarged panels under a bar."""
    import OpenImageIO as oiio

    picture, = broken_run[0].glob("*/*.png")
    pixels = np.asarray(oiio.ImageBuf(str(picture)).get_pixels(oiio.FLOAT))
    assert pixels.shape[:2] == (8 * 36 + 26, 4 * 8 * 64)
    assert pixels[:26].std() > 0.02, "no text in the bar"


def test_second_run_renders_only_what_failed(broken_run: tuple) -> None:
    """Render nothing again but the row that failed."""
    _, first, second = broken_run
    assert "[4/4]" in first.stdout and "[1/1] Burnish Reference 4 spp" in second.stdout
    assert "Cycles 4 spp: " in second.stdout and second.returncode == 0


def test_wrong_reference_is_a_sentence(broken_run: tuple,
                                       run_python: Callable[..., subprocess.CompletedProcess]) -> None:
    """Say in one sentence that a reference has another size."""
    output = broken_run[0]
    truth = next(output.glob("*/truth*.exr"))
    result = run_python(BROKEN_BURNISH, "bench", CORNELL, "--device", "cpu", "--size", 32, 18, "--samples", 4,
                        "--peers", "cycles", "--reference", truth, "--output", output)
    assert result.returncode == 1
    assert "has 64 x 36 pixels, not 32 x 18" in result.stdout


@pytest.mark.slow
def test_burnish_is_measured(tmp_path: Path, burnish: Callable[..., subprocess.CompletedProcess]) -> None:
    """Measure the real engine: times in parts, the truth's mean luminance, and noise that falls as 1/sqrt(N)."""
    result = burnish("bench", CORNELL, "--device", "cpu", "--size", 64, 36, "--samples", 8, "--truth", 1024, "--peers",
                     "", "--noise", "--output", tmp_path, timeout=900.0)
    assert result.returncode == 0, result.stdout + result.stderr
    scene = json.loads((tmp_path / "results.json").read_text("utf-8"))["scenes"][0]
    row = scene["rows"][1]
    assert not row.get("failure"), row
    assert row["samples_done"] == 8 and 0.0 < row["sampling_seconds"] < row["seconds"] and row["times"]
    assert row["errors"]["bad_pixels"] == 0 and row["errors"]["dark_luminance"] == pytest.approx(1.0, abs=0.1)
    noise = [entry["noise"] for entry in scene["noise"]]
    # From 8 to 128 samples a Monte Carlo estimate's noise falls by 4; well distributed samples may do better.
    assert 3.0 < noise[0] / noise[2] < 7.0
