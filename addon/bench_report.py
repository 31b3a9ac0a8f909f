# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark's results as JSON and as Markdown tables, and who is best at each budget. Knows no bpy."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .bench_store import ENGINES, MOVING, OWN, write_text

__all__ = ["CLOCK_TEXT", "LEGEND", "METRICS", "NoiseRow", "SceneResult", "Table", "Verdict", "format_row", "save",
           "scene_tables", "truth_text", "verdicts"]

Table = tuple[str, list[str], list[list[str]]]
"""A caption, the column names and the rows of cells"""

COLUMNS = ("render", "samples", "seconds", "FLIP", "FLIP 4x4", "relMSE", "lum", "dark", "p5", "p95", "bad")
METRICS = {"flip": "FLIP", "relative_mse": "relMSE"}
"""Errors that decide who is better, with their names in tables"""
IN_TIME = 1.05
"""Share of a budget that a picture of Burnish may take and still count"""
CLOCK_TEXT = {
    "warm": "Warm clock: the scene is on the device. Burnish: wall time of so many frames or samples from nothing and "
            "the picture's read-back (median of the repetitions; above 0.5 s one run). Rivals: time per sample, the "
            "slope between the shortest renders of three sample counts, times the samples, and denoising; what else "
            "they spend is not counted.",
    "cold": "Cold clock: wall time of a second F12 with everything in: reading the scene, upload, structures, samples, "
            "read-back. Kernels are compiled and loaded.",
    MOVING: "Camera moving: one frame of a slow pan and its read-back, the last of which is compared.",
    "": "Fixed numbers of samples: wall time of a second F12 with everything in.",
}
LEGEND = """\
FLIP: mean LDR-FLIP of the sRGB pictures, and the same after a 4x4 box filter. relMSE: squared error over the
squared truth + 0.01, the worst 0.5 % of pixels clipped. lum: ratio of mean luminances; dark: the same where it is
below 1; p5, p95: its percentiles over 16x16 blocks. bad: pixels that are not finite or negative."""


@dataclass(kw_only=True)
class NoiseRow:
    """Noise of Burnish at one sample count."""

    samples: int
    noise: float
    """RMSE of one picture, from two with different seeds"""
    left: float | None
    """RMSE against the truth that noise (its own and the truth's) does not explain"""


@dataclass(kw_only=True)
class SceneResult:
    """All rows of one scene."""

    name: str
    hash: str
    size: tuple[int, int]
    device: str
    truth: str
    """How the truth was made"""
    folder: str = ""
    """Of the scene's pictures, in the output folder"""
    truth_file: str = ""
    exposure: float = 0.0
    """Of the scene's view, for showing the pictures [stops]"""
    truth_noise: float | None = None
    """RMSE of the truth's own noise; None: not known"""
    truth_errors: dict[str, float] | None = None
    """Errors of the truth's halves against each other"""
    rows: list[dict[str, Any]] = field(default_factory=list)
    """`label`, the job's record, `errors` and, where there is no picture, `failure` or `no_picture`"""
    engines: dict[str, dict[str, Any]] = field(default_factory=dict)
    """What was measured of each engine itself"""
    noise: list[NoiseRow] = field(default_factory=list)
    failure: str | None = None
    """Why there are no rows"""
    interrupted: bool = False
    """Some rows are missing because the run was interrupted"""

    def as_dict(self) -> dict[str, Any]:
        """Return everything for JSON."""
        verdict = [vars(each) for each in verdicts(self)]
        return {**vars(self), "noise": [vars(row) for row in self.noise], "verdicts": verdict}


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The best of both sides at one budget."""

    clock: str
    budget: float
    metric: str
    own: str | None
    """Burnish's best engine; None: it has no picture"""
    own_error: float | None
    rival: str | None
    rival_error: float | None

    @property
    def text(self) -> str:
        """Return who is better; where a side has no picture nobody is."""
        if self.own is None and self.rival is None:
            return "nobody has a picture"
        if self.own is None:
            return "lost: Burnish has no picture in time"
        if self.rival is None:
            return "not won: no rival has a picture"
        return "won" if self.own_error < self.rival_error else "lost"


def verdicts(result: SceneResult) -> Iterator[Verdict]:
    """Yield the comparison for each clock, budget and error, where rivals took part.

    A picture of Burnish that came too late does not count; one of a rival does, to its advantage.
    """
    timed = [row for row in result.rows if row.get("budget") and row.get("clock")]
    if all(row["engine"] in OWN for row in timed) or not any(row["engine"] in OWN for row in timed):
        return
    for clock, budget in dict.fromkeys((row["clock"], row["budget"]) for row in timed):
        there = [row for row in timed if (row["clock"], row["budget"]) == (clock, budget) and row.get("errors")]
        for metric in METRICS:
            best: list[Any] = []
            for side in ([row for row in there if row["engine"] in OWN and row["seconds"] <= IN_TIME * budget],
                         [row for row in there if row["engine"] not in OWN]):
                row = min(side, key=lambda each: each["errors"][metric], default=None)
                best += [row["engine"], row["errors"][metric]] if row else [None, None]
            yield Verdict(clock=clock, budget=budget, metric=metric, own=best[0], own_error=best[1], rival=best[2],
                          rival_error=best[3])


def error_cells(errors: dict[str, float]) -> list[str]:
    """Return the cells of COLUMNS that are errors."""
    return [f"{errors['flip']:.4f}", f"{errors['flip_box']:.4f}", f"{errors['relative_mse']:.4g}",
            f"{errors['luminance']:.3f}", f"{errors['dark_luminance']:.3f}", f"{errors['block_p5']:.3f}",
            f"{errors['block_p95']:.3f}", str(errors["bad_pixels"])]


def cells(row: dict[str, Any]) -> list[str]:
    """Return a row's cells, or the label and why there is no picture."""
    missing = row.get("failure") or row.get("no_picture")
    if missing:
        return [row["label"], missing]
    seconds = f"{row['seconds']:.4g}" if row.get("seconds") is not None else ""
    return [row["label"], str(row.get("samples_done", row.get("samples", ""))), seconds, *error_cells(row["errors"])]


def format_row(row: dict[str, Any]) -> str:
    """Return a row as one line of text."""
    if row.get("failure"):
        return f"{row['label']}: failed: {row['failure']}"
    if row.get("no_picture"):
        return f"{row['label']}: {row['no_picture']}"
    names = dict(zip(COLUMNS, cells(row), strict=True))
    seconds = f"{names['seconds']} s, " if names["seconds"] else ""
    return (f"{names['render']}: {seconds}FLIP {names['FLIP']} (4x4 {names['FLIP 4x4']}), "
            f"relMSE {names['relMSE']}, lum {names['lum']}, dark {names['dark']} [{names['p5']}, {names['p95']}], "
            f"bad {names['bad']}")


def truth_text(result: SceneResult) -> str:
    """Return how the truth was made and how noisy it is, in one sentence."""
    if result.truth_noise is None or result.truth_errors is None:
        return (f"Truth: {result.truth}; its own noise is not known, because the two halves that it is the mean of are "
                "not there")
    errors = result.truth_errors
    # Each half has twice the truth's variance, their difference four times.
    return (f"Truth: {result.truth}; its own noise: {result.truth_noise:.5f} RMSE; its halves differ by FLIP "
            f"{errors['flip']:.4f} and relMSE {errors['relative_mse']:.4g}, so a picture without any error measures "
            f"about {0.5 * errors['flip']:.4f} and {0.25 * errors['relative_mse']:.4g}")


def scene_tables(result: SceneResult) -> list[Table]:
    """Return a scene's tables: renders by clock, who is best, parts of the times, sections of frames, noise."""
    tables: list[Table] = []
    for clock in ("warm", MOVING, "cold", ""):
        rows = [row for row in result.rows if row.get("clock", "") == clock]
        if rows:
            # Every table carries the truth's own noise.
            halves = [["Truth's halves against each other", "", "", *error_cells(result.truth_errors)]
                      if result.truth_errors else ["Truth's own noise", "not known"]]
            tables.append((CLOCK_TEXT[clock], list(COLUMNS), halves + [cells(row) for row in rows]))
    found = list(verdicts(result))
    if found:
        rows = [[each.clock, f"{each.budget:g} s", METRICS[each.metric], name_of(each.own, each.own_error),
                 name_of(each.rival, each.rival_error), each.text] for each in found]
        tables.append((f"The lower error at each budget (Burnish's pictures count up to {IN_TIME:g} times the budget):",
                       ["clock", "budget", "error", "best of Burnish", "best rival", "Burnish"], rows))
    return [*tables, *parts_tables(result), *noise_tables(result)]


def name_of(engine: str | None, error: float | None) -> str:
    """Return an engine's name with its error."""
    return "no picture" if engine is None else f"{ENGINES[engine]} {error:.4g}"


def parts_tables(result: SceneResult) -> Iterator[Table]:
    """Yield the tables of where times went: getting the scene there, each picture, each real-time frame."""
    facts = next((facts["scene"] for facts in result.engines.values() if "scene" in facts), None)
    if facts:
        times = facts["times"]
        yield ("Getting the scene onto the device, once [s] (drawing is not in it: in background there is no window):",
               [*times], [[f"{seconds:.4f}" for seconds in times.values()]])
    slopes = [[ENGINES[engine], f"{1e3 * facts['per_sample']:.4g}",
               ", ".join(f"{count}: {seconds:.3f} s" for count, seconds in zip(
                   facts["counts"], facts["times"], strict=True)), facts.get("note", "")]
              for engine, facts in result.engines.items() if "counts" in facts and "+" not in engine]
    if slopes:
        yield "Rivals' times per sample:", ["render", "ms", "shortest render by samples", "note"], slopes
    rows = [(row["label"], row["parts"]) for row in result.rows if row.get("parts") and not row.get("no_picture")]
    yield from (wide_table("Parts of each picture's time [s]:", rows, 1.0, sums=False),) if rows else ()
    frames = [(f"{ENGINES[engine]}, at rest", facts["frame_times"]) for engine, facts in result.engines.items()
              if facts.get("frame_times")]
    frames += [(row["label"], row["frame_times"]) for row in result.rows if row.get("frame_times")]
    if frames:
        yield wide_table("Milliseconds of one real-time frame, measured section by section, each waited for:", frames,
                         1.0)
    skipped = {name: why for facts in result.engines.values() for name, why in facts.get("skipped", {}).items()}
    if skipped:
        yield "Sections that this scene does without:", ["section", "reason"], [[*pair] for pair in skipped.items()]


def wide_table(caption: str, rows: Sequence[tuple[str, dict[str, float]]], factor: float, sums: bool = True) -> Table:
    """Return a table with a column for each name that any of the rows has."""
    names = list(dict.fromkeys(name for _, values in rows for name in values))
    head = ["render", *(["sum"] if sums else []), *names]
    lines = [[label, *([f"{factor * sum(values.values()):.3f}"] if sums else []),
              *(f"{factor * values[name]:.4g}" if name in values else "" for name in names)] for label, values in rows]
    return caption, head, lines


def noise_tables(result: SceneResult) -> Iterator[Table]:
    """Yield the table of noise against samples, if it was measured."""
    rows, previous = [], None
    for row in result.noise:
        fall = f"{previous / row.noise:.2f}" if previous and row.noise > 0.0 else ""
        rows.append([str(row.samples), f"{row.noise:.5f}", fall, f"{row.left:.5f}" if row.left is not None else ""])
        previous = row.noise
    if rows:
        yield ("Noise of Burnish; four times the samples should halve it:",
               ["samples", "RMSE", "falls by", "not noise"], rows)


def markdown_table(table: Table) -> list[str]:
    """Return a table as Markdown."""
    caption, head, rows = table
    lines = [caption, "", "| " + " | ".join(head) + " |", "|---" + "|---:" * (len(head) - 1) + "|"]
    return [*lines, *("| " + " | ".join([*row, *[""] * (len(head) - len(row))]) + " |" for row in rows), ""]


def scene_markdown(result: SceneResult) -> list[str]:
    """Return a scene's section."""
    lines = [f"## {result.name}", "", f"{result.size[0]} x {result.size[1]} on {result.device}."]
    if result.failure:
        return [*lines, "", f"Failed: {result.failure}", ""]
    lines += [truth_text(result) + ".", ""]
    if result.interrupted:
        lines += ["The run was interrupted: rows are missing.", ""]
    return lines + [line for table in scene_tables(result) for line in markdown_table(table)]


def save(output: Path, results: list[SceneResult], machine: dict[str, str], options: dict[str, Any]) -> None:
    """Write results.json and results.md."""
    whole = {"machine": machine, "options": options, "scenes": [result.as_dict() for result in results]}
    write_text(output / "results.json", json.dumps(whole, indent=1) + "\n")
    lines = ["# Benchmark", "", "; ".join(f"{name} {value}" for name, value in machine.items()) + ".", ""]
    for result in results:
        lines += scene_markdown(result)
    write_text(output / "results.md", "\n".join([*lines, LEGEND, ""]))
