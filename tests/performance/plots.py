# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the plots of the documentation, docs/plots/*.svg, from the tables of docs/*.md. Run by hand, as `make plots`.

    python tests/performance/plots.py [--output docs/plots] [--png out/plots]

The pages are the only source: a table that a plot is made from has the mark <!-- table: NAME --> above it. The same
table always gives the same file, which holds what it shows as its description, so that tests/unit/test_docs.py finds
plots that are not of their tables. --png also saves pictures to look at. Needs matplotlib, the extra `bench`; reading
the tables doesn't.
"""

from __future__ import annotations

import argparse
import importlib
import io
import math
import re
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
tables = importlib.import_module("tests.performance.plot_tables")

BLUE, RED, GREEN, ORANGE, PURPLE, SKY = "#0072b2", "#d55e00", "#009e73", "#e69f00", "#cc79a7", "#56b4e9"
"""Okabe and Ito's colours, which colour-blind people can tell apart; lines differ by their markers too"""
WAY_LINES = ((RED, "o", "-"), (ORANGE, "s", "-"), (BLUE, "^", "--"), (SKY, "D", "--"))
SCENE_LINES = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (PURPLE, "D"), (SKY, "v"), (RED, "P"))


def new_figure(width: float, height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Any, list]:
    """Return a figure [inch] and its axes, row by row."""
    figure = importlib.import_module("matplotlib.figure").Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for each in axes.flat:
        each.spines[["top", "right"]].set_visible(False)
        each.grid(True, color="#dddddd", linewidth=0.6)
        each.set_axisbelow(True)
    return figure, list(axes.flat)


def plain_ticks(axis: Any, positions: list[float], labels: list[str] | None = None) -> None:
    """Put ticks of a logarithmic axis where they are wanted, and nowhere else."""
    ticker = importlib.import_module("matplotlib.ticker")
    axis.set_major_locator(ticker.FixedLocator(positions))
    axis.set_major_formatter(ticker.FixedFormatter(labels or [f"{value:g}" for value in positions]))
    axis.set_minor_locator(ticker.NullLocator())


def logarithmic(axes: Any, errors: list[float]) -> None:
    """Make both axes logarithmic, with ticks of FLIP in round numbers."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    low, high = min(errors) * 0.85, max(errors) * 1.15
    axes.set_ylim(low, high)
    plain_ticks(axes.yaxis, [value for value in (0.02, 0.03, 0.05, 0.1, 0.2, 0.3, 0.5) if low <= value <= high])


def label_outer(axes: list, columns: int, below: str, beside: str) -> None:
    """Name the axes of the panels at the bottom and at the left."""
    for index, each in enumerate(axes):
        if index >= len(axes) - columns:
            each.set_xlabel(below)
        if index % columns == 0:
            each.set_ylabel(beside)


def draw_equal_time(data: dict[str, Any], title: str) -> Any:
    """Draw FLIP against time, a panel for each scene."""
    figure, axes = new_figure(10.0, 3.3 if len(data) <= 3 else 6.0, math.ceil(len(data) / 3), 3, sharex=True)
    for each, (scene, points) in zip(axes, data.items(), strict=True):
        for way, (color, marker, style) in enumerate(WAY_LINES, 1):
            line = [(point[0], point[way]) for point in points if point[way] is not None]
            each.plot(*zip(*line, strict=True), color=color, marker=marker, linestyle=style, markersize=4.5,
                      label=tables.WAYS[way - 1])
        logarithmic(each, [value for point in points for value in point[1:] if value is not None])
        seconds = [point[0] for point in points]
        plain_ticks(each.xaxis, seconds, [f"{value:g}".removeprefix("0") for value in seconds])
        each.tick_params(axis="x", labelsize=7.5)
        each.set_title(scene)
    label_outer(axes, 3, "seconds", "FLIP (lower is better)")
    figure.suptitle(title)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(WAY_LINES), frameon=False)
    return figure


def draw_at_rest(data: dict[str, Any], title: str) -> Any:
    """Draw FLIP after frames at rest, a panel for each scene."""
    figure, axes = new_figure(10.0, 5.4, math.ceil(len(data) / 3), 3, sharex=True)
    for each, (scene, values) in zip(axes, data.items(), strict=True):
        each.plot(values["frames"], values["flip"], color=RED, marker="o", label="Burnish")
        each.axhline(values["cycles"], color=BLUE, linestyle="--", label="Cycles, 64 samples and OpenImageDenoise")
        logarithmic(each, [*values["flip"], values["cycles"]])
        plain_ticks(each.xaxis, values["frames"])
        each.annotate(f"{values['flip'][-1]:.3f}", (values["frames"][-1], values["flip"][-1]), (0, -11),
                      textcoords="offset points", ha="center", fontsize=8, color=RED)
        each.annotate(f"{values['cycles']:.3f}", (values["frames"][0], values["cycles"]), (0, 3),
                      textcoords="offset points", ha="left", fontsize=8, color=BLUE)
        each.set_ylim(each.get_ylim()[0] * 0.92, None)
        each.set_title(scene)
    label_outer(axes, 3, "frames", "FLIP (lower is better)")
    figure.suptitle(title)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def draw_flights(data: dict[str, Any], title: str) -> Any:
    """Draw multiples of the error at rest, and flicker."""
    figure, (left, right) = new_figure(10.0, 4.2, 1, 2, sharey=True)
    rows = list(range(len(data)))
    for key, label, color, marker, offset in (("shown", "what is shown at rest", RED, "o", -0.14),
                                              ("alone", "frames alone at rest", GREEN, "s", 0.14)):
        for row, values in zip(rows, data.values(), strict=True):
            places = [row + offset] * 2
            left.plot(values[key], places, color=color, linewidth=1.5)
            left.plot(values[key][:1], places[:1], marker=marker, color=color, markersize=6, linestyle="none",
                      markerfacecolor="white", label=f"frame 20 by {label}" if row == 0 else None)
            left.plot(values[key][1:], places[1:], marker=marker, color=color, markersize=6, linestyle="none",
                      label=f"frame 40 by {label}" if row == 0 else None)
    left.axvline(1.5, color="black", linestyle="--", linewidth=1.2, label="goal: at most 1.5")
    left.set_xlabel("FLIP in flight, times that at rest")
    right.barh([row - 0.18 for row in rows], [values["flicker"] for values in data.values()], 0.34, color=RED,
               label="Burnish")
    right.barh([row + 0.18 for row in rows], [values["cycles"] for values in data.values()], 0.34, color=BLUE,
               label="Cycles, 16 samples and OpenImageDenoise: the goal")
    right.set_xlabel("flicker (standard deviation over eight frames)")
    left.set_yticks(rows, list(data))
    left.set_ylim(len(data) - 0.4, -0.6)
    for each in (left, right):
        each.grid(False, axis="y")
        each.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=1 if each is right else 2, frameon=False,
                    fontsize=8)
    figure.suptitle(title)
    return figure


def draw_frame_time(data: dict[str, Any], title: str) -> Any:
    """Draw milliseconds of a frame as bars, and the goals as lines across them."""
    figure, (axes,) = new_figure(8.0, 3.4)
    rows = list(range(len(data)))
    for row, (value, goal) in zip(rows, data.values(), strict=True):
        met = value <= goal
        axes.barh([row], [value], 0.6, color=BLUE if met else RED)
        axes.plot([goal, goal], [row - 0.42, row + 0.42], color="black", linewidth=2.0)
        axes.annotate(f"{value}" + ("" if met else " (goal missed)"), (max(value, goal), row), (5, 0),
                      textcoords="offset points", va="center", fontsize=9)
    patches = importlib.import_module("matplotlib.patches")
    lines = importlib.import_module("matplotlib.lines")
    goals = sorted({goal for _, goal in data.values()})
    axes.legend(handles=[patches.Patch(color=BLUE, label="goal met"), patches.Patch(color=RED, label="goal missed"),
                         lines.Line2D([], [], color="black", linewidth=2.0,
                                      label=f"goal: {goals[-1]} ms a scene, {goals[0]} in the mean")],
                loc="upper center", bbox_to_anchor=(0.45, -0.17), ncols=3, frameon=False, fontsize=9)
    axes.set_yticks(rows, list(data))
    axes.set_ylim(len(data) - 0.4, -0.6)
    axes.set_xlim(0.0, 1.25 * max(value for value, _ in data.values()))
    axes.grid(False, axis="y")
    axes.set_xlabel("ms a frame")
    figure.suptitle(title)
    return figure


def draw_waterfall(data: dict[str, Any], title: str) -> Any:
    """Draw milliseconds of a frame after each change, a line for each scene."""
    figure, (axes,) = new_figure(10.0, 6.2)
    count = len(data["changes"])
    for (scene, values), (color, marker) in zip(data["ms"].items(), SCENE_LINES, strict=True):
        line = [(step, value) for step, value in enumerate(values) if value is not None]
        axes.plot(*zip(*line, strict=True), color=color, marker=marker, markersize=5, label=scene)
    for goal, text in zip(data["goals"], ("goal of the mean", "goal of each"), strict=True):
        axes.axhline(goal, color="black", linestyle="--", linewidth=1.0)
        axes.annotate(f"{text}: {goal}", (0, goal), (-4, 3), textcoords="offset points", fontsize=8.5)
    axes.set_xticks(range(count), [f"{step + 1}. {wrapped(text)}" for step, text in enumerate(data["changes"])],
                    rotation=90, fontsize=8, linespacing=1.0)
    axes.set_ylim(0.0, None)
    axes.set_ylabel("ms a frame")
    axes.legend(loc="upper right", ncols=2, frameon=False)
    figure.suptitle(title)
    return figure


def wrapped(text: str, width: int = 34) -> str:
    """Return a text in lines of at most so many letters."""
    return textwrap.fill(text, width)


def draw_stress_energy(data: dict[str, Any], title: str) -> Any:
    """Draw energies as ranges over the bands of their goals."""
    figure, (axes,) = new_figure(8.0, 5.0)
    low, high = 0.84, 1.16
    for row, (lowest, highest, start, end) in enumerate(data.values()):
        ends = (low if start is None else start, high if end is None else end)
        met = ends[0] <= lowest and highest <= ends[1]
        axes.barh([row], [ends[1] - ends[0]], 0.66, left=ends[0], color="#cfe8dd")
        axes.plot([lowest, highest], [row, row], color=BLUE if met else RED, linewidth=2.0,
                  marker="o" if met else "X", markersize=5.5 if met else 8.0)
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set_yticks(range(len(data)), list(data))
    axes.set_ylim(len(data) - 0.4, -0.6)
    axes.set_xlim(low, high)
    axes.grid(False, axis="y")
    patches = importlib.import_module("matplotlib.patches")
    lines = importlib.import_module("matplotlib.lines")
    axes.legend(handles=[patches.Patch(color="#cfe8dd", label="goal"),
                         lines.Line2D([], [], color=BLUE, marker="o", label="within it"),
                         lines.Line2D([], [], color=RED, marker="X", markersize=8, label="missed")],
                loc="upper center", bbox_to_anchor=(0.4, -0.11), ncols=3, frameon=False, fontsize=9)
    axes.set_xlabel("energy, as a share of what is right")
    figure.suptitle(title)
    return figure


Plot = tuple[Callable[[], dict[str, Any]], Callable[[dict[str, Any], str], Any], str]

CATALOGUE: dict[str, Plot] = {
    "at_rest": (tables.at_rest, draw_at_rest, "FLIP at rest, 640x360: Burnish on an H200, Cycles on an H100"),
    "equal_time_640": (
        lambda: tables.equal_time("equal-time-640"), draw_equal_time, "FLIP at equal time, 640x360, one H100"),
    "equal_time_1080": (
        lambda: tables.equal_time("equal-time-1080"), draw_equal_time, "FLIP at equal time, 1920x1080, one H100"),
    "equal_time_processor": (
        lambda: tables.equal_time("equal-time-processor"), draw_equal_time,
        "FLIP at equal time, 480x270, two cores of a processor"),
    "flights": (tables.flights, draw_flights, "A flight of 60 frames, 640x360, one H200"),
    "frame_time": (tables.frame_time, draw_frame_time, "A frame at 1920x1080 with a moving camera, one H100"),
    "waterfall": (tables.waterfall, draw_waterfall, "A frame at 1920x1080 after each change, one H100"),
    "stress_energy": (tables.stress_energy, draw_stress_energy, "Energy in the stress test, beside its goals"),
}
"""How each plot's data is read, how it is drawn, and its title"""


def shortened(svg: str) -> str:
    """Return a plot's file without what nobody sees: indents, unused names, decimals of places."""
    svg = re.sub(r' id="(?![mp][0-9a-f]{10}")[^"]*"', "", re.sub(r"(?m)^ +", "", svg))
    places = re.compile(r"(?<=[0-9]\.[0-9]{2})[0-9]+")
    return "".join(line if "<text" in line or "<dc:" in line else places.sub("", line)
                   for line in svg.splitlines(keepends=True))


def main() -> int:
    """Draw all plots."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path, default=tables.PLOTS)
    parser.add_argument("--png", type=Path, help="folder of the same plots as pictures")
    arguments = parser.parse_args()
    matplotlib = importlib.import_module("matplotlib")
    matplotlib.rcParams.update({
        "svg.fonttype": "none", "svg.hashsalt": "burnish", "font.size": 9.0, "axes.titlesize": 10.0,
        "figure.titlesize": 11.0, "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans"]})
    for folder in filter(None, (arguments.output, arguments.png)):
        folder.mkdir(parents=True, exist_ok=True)
    for name, (read, draw, title) in CATALOGUE.items():
        data = read()
        figure = draw(data, title)
        path = arguments.output / f"{name}.svg"
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", facecolor="white", metadata={
            "Date": None, "Creator": None, "Title": title, "Description": tables.description(data)})
        path.write_text(shortened(buffer.getvalue()), "utf-8")
        if arguments.png:
            figure.savefig(arguments.png / f"{name}.png", facecolor="white", dpi=100)
        print(f"{path}: {path.stat().st_size / 1024.0:.0f} KB")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except tables.TableError as error:
        sys.exit(f"A table of the documentation can't be read: {error}")
