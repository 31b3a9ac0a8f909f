# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark: its options, plans, arithmetic and tables, its memory of what is done, its report."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from burnish.addon import bench, bench_html, bench_plan, bench_plots, bench_progress, bench_report, bench_store
from burnish.addon.bench_report import SceneResult, verdicts
from burnish.addon.bench_store import Job, SceneStore
from burnish.engine.errors import BurnishError

ERRORS = dict.fromkeys(
    ("flip", "flip_box", "relative_mse", "luminance", "dark_luminance", "block_p5", "block_p95"), 0.5)
ERRORS["bad_pixels"] = 0


def parse(*arguments: str) -> argparse.Namespace:
    """Return parsed options, those that depend on others filled in."""
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    parsed = parser.parse_args([__file__, *arguments])
    bench.check(parsed)
    return parsed


def row(engine: str, budget: float, flip: float | None, clock: str = "warm", **more: Any) -> dict[str, Any]:
    """Return a row of results; without an error it has no picture."""
    job = Job(engine=engine, budget=budget, clock=clock)
    found = {"label": job.label, "engine": engine, "clock": clock, "budget": budget, "seconds": budget, "samples": 3}
    if flip is None:
        return found | {"seconds": None, "no_picture": "no picture: one sample takes 7 s"} | more
    return {**found, "errors": {**ERRORS, "flip": flip, "relative_mse": flip}, **more}


def result(*rows: dict[str, Any], **more: Any) -> SceneResult:
    """Return a scene's result."""
    return SceneResult(name="a", hash="", size=(16, 8), device="cpu", truth="none", rows=[*rows], **more)


def test_jobs_follow_the_options() -> None:
    """Plan the truth's halves, each engine at each budget on both clocks, fixed samples and the noise pairs."""
    plan = bench_plan.make_plan(parse(
        "--engines", "realtime,reference", "--peers", "cycles,eevee", "--samples", "16,4", "--budgets", "2,0.5",
        "--cold-budgets", "4", "--truth", "256", "--noise"))
    assert [(job.samples, job.seed) for job in plan.truth] == [(128, 101), (128, 202)]
    assert [job.label for job in plan.fixed][:4] == [
        "Burnish Realtime 4 frames", "Burnish Realtime 16 frames", "Burnish Reference 4 spp",
        "Burnish Reference 16 spp"]
    assert [job.label for job in plan.warm] == [f"{engine} {budget} s warm" for engine in (
        "Burnish Realtime", "Burnish Reference", "Cycles", "EEVEE") for budget in ("0.5", "2")]
    assert [job.label for job in plan.moving] == ["Burnish Realtime, camera moving"]
    assert {job.budget for job in plan.cold} == {4.0} and len(plan.cold) == 4
    assert [job.samples for job in plan.noise] == [4, 4, 16, 16, 64, 64]
    assert len({job.name for job in plan.all}) == len(plan.all)


def test_budgets_are_the_default() -> None:
    """Compare at the default budgets unless samples or noise are asked for; render no truth where one is given."""
    assert parse().budgets == parse().cold_budgets == list(bench_plan.BUDGETS)
    assert parse("--samples", "4").budgets == parse("--noise").budgets == []
    plan = bench_plan.make_plan(parse("--reference", __file__, "--clocks", "cold", "--budgets", "1"))
    assert plan.truth == plan.warm == plan.moving == [] and plan.cold


def test_slope_survives_a_disturbed_render() -> None:
    """Find fixed time and time per sample in spite of one render that took far too long."""
    counts = [1, 2, 4, 8, 16, 32]
    seconds = [0.5 + 0.25 * count for count in counts]
    assert bench_plan.fit_line(counts, seconds) == pytest.approx((0.5, 0.25))
    seconds[2] += 60.0
    assert bench_plan.fit_line(counts, seconds) == pytest.approx((0.5, 0.25), rel=0.05)
    assert bench_plan.fit_line((1, 5), (1.0, 3.0)) == pytest.approx((0.5, 0.5))
    with pytest.raises(ValueError, match="two different"):
        bench_plan.fit_line([4, 4], [1.0, 2.0])


def test_samples_fit_into_a_budget() -> None:
    """Take what fits beside the fixed time: all of an exact division, nothing below one sample."""
    found = [bench_plan.samples_within(budget, 0.1, 0.05) for budget in (0.01, 0.14, 0.15, 0.3499, 0.35, 10.05)]
    assert found == [0, 0, 1, 2, 3, 100]
    assert bench_plan.samples_within(1.0, 0.0, 0.0) == 0


@pytest.mark.parametrize("arguments", [
    ("--samples", "0"), ("--samples", "a"), ("--peers", "luxcore"), ("--size", "0", "9"), ("--budgets", "-1"),
    ("--budgets", "inf"), ("--engines", "cycles"), ("--clocks", "hot"), ("--repetitions", "0")])
def test_wrong_options_are_refused(arguments: tuple[str, ...], capsys: pytest.CaptureFixture) -> None:
    """Refuse impossible values, naming the option."""
    with pytest.raises(SystemExit):
        parse(*arguments)
    assert arguments[0] in capsys.readouterr().err


def test_missing_files_are_named(tmp_path: Path) -> None:
    """Name what is missing, and a wrong number of references, before anything is rendered."""
    def run(*arguments: str) -> None:
        parser = argparse.ArgumentParser()
        bench.add_arguments(parser)
        bench.run(parser.parse_args([*arguments]))

    with pytest.raises(BurnishError, match="No scene is named"):
        run()
    with pytest.raises(BurnishError, match=r"none\.blend.*does not exist"):
        run(str(tmp_path / "none.blend"))
    with pytest.raises(BurnishError, match="1 scenes but 2 references"):
        run("a.blend", "--reference", "a.exr", "--reference", "b.exr")


def test_missing_plots_are_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Say before anything is rendered that matplotlib is missing and how to install it."""
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(BurnishError, match="pip install matplotlib"):
        parse()


def test_store_remembers_finished_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Know a picture with its record as done, until its file is gone or Burnish's source has changed."""
    scene = tmp_path / "scene.blend"
    scene.write_bytes(b"one")
    store = SceneStore(tmp_path / "out", scene, (32, 18), "cuda:0")
    jobs = [Job(engine=engine, budget=1.0, clock="warm") for engine in ("reference", "realtime", "cycles")]
    for job in jobs:
        store.save(job, {})
        assert store.record(job) is None, "a record without its picture"
        store.path(job, ".exr").write_bytes(b"")
    late = Job(engine="cycles", budget=0.1, clock="warm")
    store.save(late, {"no_picture": "too short"})
    store.save_facts("realtime", {"curve": []})
    assert list(store.missing([*jobs, late])) == [] and store.facts("realtime") is not None
    monkeypatch.setattr(bench_store, "source_hash", lambda: "changed")
    changed = SceneStore(tmp_path / "out", scene, (32, 18), "cuda:0")
    assert list(changed.missing([*jobs, late])) == jobs[:2] and changed.facts("realtime") is None
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


def test_a_budget_without_a_rival_is_not_won() -> None:
    """Call a budget won only where both sides have a picture and Burnish's best has the lower error."""
    found = verdicts(result(
        row("realtime", 0.1, 0.3), row("cycles", 0.1, None), row("realtime", 1.0, 0.3), row("reference", 1.0, 0.1),
        row("cycles", 1.0, 0.2), row("realtime", 2.0, 0.3), row("cycles", 2.0, 0.4), row("cycles+oidn", 2.0, 0.2),
        row("realtime", 4.0, None), row("cycles", 4.0, 0.1), row("realtime", 5.0, None), row("cycles", 5.0, None)))
    texts = {each.budget: (each.own, each.rival, each.text) for each in found if each.metric == "flip"}
    assert texts == {
        0.1: ("realtime", None, "not won: no rival has a picture"), 1.0: ("reference", "cycles", "won"),
        2.0: ("realtime", "cycles+oidn", "lost"), 4.0: (None, "cycles", "lost: Burnish has no picture in time"),
        5.0: (None, None, "nobody has a picture")}
    assert list(verdicts(result(row("realtime", 0.1, 0.3)))) == []
    late = result(row("realtime", 1.0, 0.1, seconds=1.2), row("reference", 1.0, 0.4), row("cycles", 1.0, 0.3))
    assert {(each.own, each.text) for each in verdicts(late)} == {("reference", "lost")}


def test_clocks_are_never_mixed() -> None:
    """Compare the same budget on each clock by itself, in tables of their own that carry the truth's noise."""
    scene = result(row("realtime", 1.0, 0.1), row("cycles", 1.0, 0.2), row("realtime", 1.0, 0.4, "cold"),
                   row("cycles", 1.0, 0.3, "cold"), truth_noise=0.01, truth_errors=dict(ERRORS))
    assert {(each.clock, each.text) for each in verdicts(scene)} == {("warm", "won"), ("cold", "lost")}
    tables = bench_report.scene_tables(scene)[:2]
    for clock, (_, _, rows) in zip(("warm", "cold"), tables, strict=True):
        assert rows[0][0] == "Truth's halves against each other"
        assert all(cells[0].endswith(f" 1 s {clock}") for cells in rows[1:]) and len(rows) == 3
    scene.truth_errors = None
    assert bench_report.scene_tables(scene)[0][2][0] == ["Truth's own noise", "not known"]
    assert "not known" in bench_report.truth_text(scene)


def test_parts_of_times_are_tables() -> None:
    """Show what getting the scene there took, each picture's parts and each section of a frame with their sum."""
    facts = {"scene": {"times": {"extraction": 0.25, "upload": 0.5}}, "frame_times": {"Rays": 1.0, "Rest": 0.25},
             "skipped": {"refraction": "nothing lets light through"}}
    scene = result(row("realtime", 1.0, 0.1, parts={"device frames": 0.75, "read-back": 0.25}),
                   row("cycles", 1.0, 0.1, parts={"sampling": 0.5}), engines={"realtime": facts})
    tables = {table[0].partition(" ")[0]: table for table in bench_report.parts_tables(scene)}
    assert tables["Getting"][1:] == (["extraction", "upload"], [["0.2500", "0.5000"]])
    assert tables["Parts"][2][0] == ["Burnish Realtime 1 s warm", "0.75", "0.25", ""]
    assert tables["Milliseconds"][1:] == (["render", "sum", "Rays", "Rest"],
                                          [["Burnish Realtime, at rest", "1.250", "1", "0.25"]])
    assert tables["Sections"][2] == [["refraction", "nothing lets light through"]]


def test_noise_table_shows_the_fall() -> None:
    """Show by which factor noise falls from row to row."""
    scene = result(noise=[bench_report.NoiseRow(samples=4, noise=0.2, left=None),
                          bench_report.NoiseRow(samples=16, noise=0.1, left=0.01)])
    assert next(bench_report.noise_tables(scene))[2][1] == ["16", "0.10000", "2.00", "0.01000"]


@pytest.fixture
def saved_report(tmp_path: Path) -> tuple[Path, str]:
    """Return the folder of a made-up report and its text."""
    frames = {"frame_times": {"Rays": 1.0}, "per_frame": 0.004, "scene": {"times": {"upload": 0.1}}}
    scenes = [result(row("realtime", 1.0, 0.1, file="realtime"), row("realtime", 0.1, 0.2, file="realtime"),
                     row("cycles", 1.0, 0.2, file="cycles"), row("cycles", 0.1, None),
                     truth_file="truth", engines={"realtime": frames, "cycles": {"per_sample": 0.002}})
              for _ in range(2)]
    scenes[1].name = "<b>&"
    broken = result(failure="The scene 'x' can't be opened")
    pictures = {"truth": 0.5, "realtime": 0.4, "cycles": 0.6}
    bench_html.save_report(tmp_path, [*scenes, broken], {"Device": "a"}, {"size": None},
                           lambda path: np.full((8, 16, 3), pictures[path.name], np.float32))
    return tmp_path, (tmp_path / "report.html").read_text("utf-8")


@pytest.fixture(autouse=True)
def files_exist(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Let the made-up report's pictures be there."""
    if "saved_report" in request.fixturenames:
        monkeypatch.setattr(bench_html.Path, "is_file", lambda path: True)


def test_report_needs_no_other_file(saved_report: tuple[Path, str]) -> None:
    """Put pictures, plots, tables and failures into one file that loads nothing."""
    folder, text = saved_report
    assert not re.search(r"""(?:src|href)=['"]?(?!data:|#)[\w./]""", text), "refers to another file"
    assert "http" not in text.replace("http-equiv", "")
    assert text.count("data:image/jpeg") >= 2 * 4 and text.count("data:image/png") >= 2 * 2 + 1
    assert "no picture: one sample takes 7 s" in text and "The scene &#x27;x&#x27; can&#x27;t be opened" in text
    assert "not won: no rival has a picture" in text and "<b>&" not in text.replace('"<b>&', "")
    names = {path.name for path in (folder / "plots").iterdir()}
    assert {"a_warm.png", "a_errors.jpg", "a_passes.png", "mean_warm.png"} <= names


def test_report_counts_scenes_won(saved_report: tuple[Path, str]) -> None:
    """Count over all scenes at which budgets Burnish is better, and leave out what can't be compared."""
    scenes = [result(row("realtime", 1.0, flip), row("cycles", 1.0, 0.2), row("realtime", 0.1, 0.3),
                     row("cycles", 0.1, None)) for flip in (0.1, 0.3)]
    rows = next(bench_html.summary_tables(scenes))[2]
    assert [cells[3:] for cells in rows if cells[1:3] == ["1 s", "FLIP"]] == [["1", "1", "0", "a"]]
    assert [cells[3:] for cells in rows if cells[1:3] == ["0.1 s", "FLIP"]] == [["0", "0", "2", ""]]


def test_pictures_grow_coarser_until_they_fit(saved_report: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Choose the best quality at which all pictures together stay below the limit."""
    noise = np.random.default_rng(1).random((64, 64, 3), np.float32)
    scene = result(row("cycles", 1.0, 0.2, file="cycles"), truth_file="truth")
    sizes = []
    for limit in (1 << 20, 4000):
        monkeypatch.setattr(bench_html, "PICTURE_BYTES", limit)
        entries = bench_html.encode_pictures([scene], Path(), lambda path: noise)[0]
        sizes.append(sum(len(entry["src"]) for entry in entries))
    assert sizes[1] < 4000 * 1.5 < sizes[0]


def test_error_maps_are_of_the_fullest_budget() -> None:
    """Draw the maps where most engines have a picture: the warm clock's, then the shorter time."""
    scene = result(row("realtime", 0.1, 0.3), row("cycles", 0.1, None), row("realtime", 1.0, 0.3, "cold"),
                   row("cycles", 1.0, 0.3, "cold"), row("realtime", 1.0, 0.3), row("cycles", 1.0, 0.3),
                   row("realtime", 2.0, 0.3), row("cycles", 2.0, 0.3))
    assert bench_plots.map_budget(scene) == ("warm", 1.0)
    assert bench_plots.map_budget(result()) is None


def test_time_left_follows_the_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tell the time left from the costs that are done, of all that are expected."""
    class Lines:
        def __init__(self) -> None:
            self.printed: list[str] = []
            self.shown: list[str] = []
            self.print, self.progress = self.printed.append, self.shown.append

    now = [100.0]
    monkeypatch.setattr(bench_progress.time, "perf_counter", lambda: now[0])
    lines = Lines()
    progress = bench_progress.Progress(lines)
    progress.expect([1.0, 3.0])
    progress.expect([4.0])
    progress.begin("a")
    now[0] += 10.0
    progress.end(1.0)
    progress.begin("b")
    now[0] += 10.0
    progress.end(3.0)
    progress.begin("c")
    assert lines.printed == ["[1/3] a", "[2/3] b, about 01:10 left", "[3/3] c, about 00:20 left"]
    assert lines.shown[-1].startswith("[" + 12 * "#" + 12 * " " + "] 50 %")


@pytest.mark.parametrize(("latency", "each", "rest", "budget", "first", "expected"), [
    (0.008, 0.003, 0.007, 0.0300, 2, 5),  # Too low a guess, a long tail shared by all samples.
    (0.008, 0.003, 0.007, 0.0300, 40, 5),
    (0.000, 0.003, 0.001, 0.0300, 9, 9),
    (0.000, 0.003, 0.001, 0.0100, 3, 3),
    (0.008, 0.003, 0.007, 0.0182, 7, 1),
    (0.008, 0.003, 0.007, 0.0100, 7, 0),
    (0.008, 0.003, 0.007, 0.5000, 100, 164),
])
def test_budget_is_filled_with_frames(latency, each, rest, budget, first, expected):
    """Find how many frames fit where the first costs more than the others; a few tries are enough."""
    tried: list[int] = []

    def measure(frames: int) -> tuple[float, float]:
        tried.append(frames)
        return latency + each * frames + rest, rest

    found = bench_plan.most_frames(measure, budget, first)
    assert len(tried) <= bench_plan.ATTEMPTS + 1 and len(set(tried)) == len(tried)
    most = bench_plan.FULL * expected if expected > 20 else expected
    assert most <= found <= max(expected, bench_plan.TOLERANCE * expected)
