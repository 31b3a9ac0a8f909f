# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark's results as JSON and as Markdown tables. Knows no bpy."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .bench_store import write_text

__all__ = ["NoiseRow", "SceneResult", "format_row", "save"]

COLUMNS = ("render", "seconds", "sampling", "FLIP", "FLIP 4x4", "relMSE", "lum", "dark", "p5", "p95", "bad")
LEGEND = """\
Seconds: wall time of a whole render with kernels loaded, scene set-up included; sampling: the part of it spent adding
samples. FLIP: mean LDR-FLIP of the sRGB pictures, and the same after a 4x4 box filter. relMSE: squared error over the
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
    truth_noise: float | None = None
    """RMSE of the truth's own noise"""
    rows: list[dict[str, Any]] = field(default_factory=list)
    """`label`, the job's record, `errors` and, where it failed, `failure`"""
    noise: list[NoiseRow] = field(default_factory=list)
    failure: str | None = None
    """Why there are no rows"""

    def as_dict(self) -> dict[str, Any]:
        """Return everything for JSON."""
        return {**vars(self), "noise": [vars(row) for row in self.noise]}


def cells(row: dict[str, Any]) -> list[str]:
    """Return a row's cells, or the label and its failure."""
    if row.get("failure"):
        return [row["label"], row["failure"]]
    errors, sampling = row["errors"], row.get("sampling_seconds")
    return [row["label"], f"{row['seconds']:.2f}" if "seconds" in row else "",
            f"{sampling:.2f}" if sampling is not None else "", f"{errors['flip']:.4f}", f"{errors['flip_box']:.4f}",
            f"{errors['relative_mse']:.4f}", f"{errors['luminance']:.3f}", f"{errors['dark_luminance']:.3f}",
            f"{errors['block_p5']:.3f}", f"{errors['block_p95']:.3f}", str(errors["bad_pixels"])]


def format_row(row: dict[str, Any]) -> str:
    """Return a row as one line of text."""
    if row.get("failure"):
        return f"{row['label']}: failed: {row['failure']}"
    names = dict(zip(COLUMNS, cells(row), strict=True))
    seconds = f"{names['seconds']} s, " if names["seconds"] else ""
    return (f"{names['render']}: {seconds}FLIP {names['FLIP']} (4x4 {names['FLIP 4x4']}), "
            f"relMSE {names['relMSE']}, lum {names['lum']}, dark {names['dark']} [{names['p5']}, {names['p95']}], "
            f"bad {names['bad']}")


def scene_markdown(result: SceneResult) -> list[str]:
    """Return a scene's section."""
    lines = [f"## {result.name}", "", f"{result.size[0]} x {result.size[1]} on {result.device}; truth: {result.truth}"
             + (f", its own noise {result.truth_noise:.5f} RMSE" if result.truth_noise is not None else "") + ".", ""]
    if result.failure:
        return [*lines, f"Failed: {result.failure}", ""]
    lines += ["| " + " | ".join(COLUMNS) + " |", "|---" + "|---:" * (len(COLUMNS) - 1) + "|"]
    for row in result.rows:
        shown = cells(row)
        lines.append("| " + " | ".join([*shown, *[""] * (len(COLUMNS) - len(shown))]) + " |")
    times = [row for row in result.rows if row.get("times")]
    if times:
        lines += ["", "Where Burnish's time went [s]:", ""]
        lines += [f"- {row['label']}: " + ", ".join(f"{name} {value:.3f}" for name, value in row["times"].items())
                  for row in times]
    return [*lines, "", *frame_markdown(result), *noise_markdown(result)]


def frame_markdown(result: SceneResult) -> list[str]:
    """Return the table of where a real-time frame's time goes, if there are any."""
    rows = [row for row in result.rows if row.get("frame_times")]
    if not rows:
        return []
    names = list(dict.fromkeys(name for row in rows for name in row["frame_times"]))
    lines = ["Milliseconds of one real-time frame, measured section by section:", "",
             "| render | sum | " + " | ".join(names) + " |", "|---" + "|---:" * (len(names) + 1) + "|"]
    for row in rows:
        times = row["frame_times"]
        shown = [f"{times[name]:.3f}" if name in times else "" for name in names]
        lines.append(f"| {row['label']} | {sum(times.values()):.3f} | " + " | ".join(shown) + " |")
    return [*lines, ""]


def noise_markdown(result: SceneResult) -> list[str]:
    """Return the table of noise against samples, if it was measured."""
    if not result.noise:
        return []
    lines = ["Noise of Burnish; four times the samples should halve it:", "",
             "| samples | RMSE | falls by | not noise |", "|---:|---:|---:|---:|"]
    previous = None
    for row in result.noise:
        fall = f"{previous / row.noise:.2f}" if previous and row.noise > 0.0 else ""
        left = f"{row.left:.5f}" if row.left is not None else ""
        lines.append(f"| {row.samples} | {row.noise:.5f} | {fall} | {left} |")
        previous = row.noise
    return [*lines, ""]


def save(output: Path, results: list[SceneResult], machine: dict[str, str]) -> None:
    """Write results.json and results.md."""
    write_text(output / "results.json",
               json.dumps({"machine": machine, "scenes": [result.as_dict() for result in results]}, indent=1) + "\n")
    lines = ["# Benchmark", "", "; ".join(f"{name} {value}" for name, value in machine.items()) + ".", ""]
    for result in results:
        lines += scene_markdown(result)
    write_text(output / "results.md", "\n".join([*lines, LEGEND, ""]))
