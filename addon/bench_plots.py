# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark's plots, by matplotlib: error against time, sections of a frame, error maps. Knows no bpy.

matplotlib is optional (the extra `bench`) and imported only when a plot is asked for.
"""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np

from ..engine.errors import BurnishError
from ..engine.image_error import encode_srgb, flip_map, signed_difference
from .bench_report import METRICS, SceneResult
from .bench_store import ENGINES, MOVING

__all__ = ["encode_jpeg", "error_maps", "find_matplotlib", "mean_plot", "pass_bars", "time_plot"]

COLORS = {"realtime": "#d62728", "realtime+oidn": "#ff9a3c", "draft": "#e377c2", "reference": "#8c564b",
          "reference+oidn": "#c49c94", "cycles": "#1f77b4", "cycles+oidn": "#17a2b8", "eevee": "#7a7a7a"}
MARKERS = {"realtime": "o", "realtime+oidn": "s", "draft": "*", "reference": "D",
           "reference+oidn": "d", "cycles": "^", "cycles+oidn": "v", "eevee": "x"}
CLOCK_TITLES = {"warm": "scene resident", "cold": "second F12, everything in"}
FLOORS = {"flip": 0.5, "relative_mse": 0.25}
"""Errors of a perfect picture as shares of the difference between the truth's halves (see truth_text)"""
MAP_COLUMNS = 6
FULL_SCALE = 0.25
"""Relative difference of the signed maps' full colours"""
DPI = 110


def find_matplotlib() -> ModuleType:
    """Return matplotlib; raises BurnishError, with the way to install it, where there is none."""
    try:
        importlib.import_module("matplotlib.figure")
        return importlib.import_module("matplotlib")
    except ImportError as error:
        raise BurnishError("The benchmark's plots need the module 'matplotlib'; install it with `pip install "
                           "matplotlib flip-evaluator`, the extra `bench`") from error


def new_figure(width: float, height: float) -> Any:
    """Return an empty figure [inch]."""
    return find_matplotlib().figure.Figure(figsize=(width, height), dpi=DPI, layout="constrained")


def encoded(figure: Any, kind: str = "png") -> bytes:
    """Return a figure as a file's content."""
    buffer = io.BytesIO()
    options = {"pil_kwargs": {"quality": 85}} if kind == "jpg" else {}
    figure.savefig(buffer, format=kind, **options)
    return buffer.getvalue()


def encode_jpeg(linear: np.ndarray, exposure: float, quality: int, shrink: int = 1) -> bytes:
    """Return a scene-linear picture [h, w, 3], bottom row first, as a JPEG file's content; `exposure` in stops."""
    image = importlib.import_module("matplotlib.image")
    pixels = encode_srgb(np.nan_to_num(linear[::-1]) * 2.0 ** exposure)
    buffer = io.BytesIO()
    image.imsave(buffer, (255.0 * pixels[::shrink, ::shrink] + 0.5).astype(np.uint8), format="jpg",
                 pil_kwargs={"quality": quality})
    return buffer.getvalue()


def draw_lines(axes: Any, lines: dict[str, list[tuple[float, float]]], metric: str) -> None:
    """Draw a line for each engine: error against seconds, both logarithmic."""
    for engine, points in lines.items():
        points = [(seconds, error) for seconds, error in points if seconds > 0.0 and error > 0.0]
        if points:
            axes.plot(*zip(*sorted(points), strict=True), color=COLORS[engine], marker=MARKERS[engine], markersize=5,
                      label=ENGINES[engine])
    ticker = importlib.import_module("matplotlib.ticker")
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(ticker.LogLocator(subs=(2.0, 5.0)))
        axis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(ticker.FuncFormatter(lambda value, _: f"{value:g}"))
    axes.tick_params(which="both", labelsize=8)
    axes.set_xlabel("seconds")
    axes.set_ylabel(METRICS[metric])
    axes.grid(True, which="both", alpha=0.25)


def add_legend(figure: Any, axes: Any) -> None:
    """Name the lines of `axes` below the figure, where they cover nothing."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)


def time_plot(result: SceneResult, clock: str) -> bytes | None:
    """Return the plot (PNG) of FLIP and relMSE against time on one clock; None where there is nothing to draw."""
    rows = [row for row in result.rows if row.get("clock") == clock and row.get("errors")]
    if not rows:
        return None
    figure = new_figure(11.0, 4.4)
    for axes, metric in zip(figure.subplots(1, 2), METRICS, strict=True):
        lines: dict[str, list[tuple[float, float]]] = {}
        for row in rows:
            lines.setdefault(row["engine"], []).append((row["seconds"], row["errors"][metric]))
        draw_lines(axes, lines, metric)
        moving = [row for row in result.rows if row.get("clock") == MOVING and row.get("errors") and clock == "warm"]
        for row in moving:
            axes.plot([row["seconds"]], [row["errors"][metric]], color=COLORS[row["engine"]], marker="*",
                      markersize=11, linestyle="none", label="Burnish Realtime, a frame in motion")
        if result.truth_errors:
            axes.axhline(max(FLOORS[metric] * result.truth_errors[metric], 1e-9), color="black", linestyle=":",
                         linewidth=1, label="the truth's own noise")
    add_legend(figure, axes)
    width, height = result.size
    figure.suptitle(f"{result.name}, {width} x {height}, {result.device}: {CLOCK_TITLES[clock]}", fontsize=11)
    return encoded(figure)


def mean_plot(results: list[SceneResult], clock: str) -> bytes | None:
    """Return the plot (PNG) of geometric means over scenes, at budgets where an engine has pictures of all of them."""
    measured = [result for result in results if not result.failure]
    groups: dict[tuple[str, float], list[dict[str, Any]]] = {}
    for row in (row for result in measured for row in result.rows):
        if row.get("clock") == clock and row.get("errors"):
            groups.setdefault((row["engine"], row["budget"]), []).append(row)
    whole = {key: rows for key, rows in groups.items() if len(rows) == len(measured)}
    if len(measured) < 2 or not whole:
        return None
    figure = new_figure(11.0, 4.4)
    for axes, metric in zip(figure.subplots(1, 2), METRICS, strict=True):
        lines: dict[str, list[tuple[float, float]]] = {}
        for (engine, _), rows in whole.items():
            times, errors = [row["seconds"] for row in rows], [row["errors"][metric] for row in rows]
            lines.setdefault(engine, []).append(tuple(float(np.exp(np.mean(np.log(np.maximum(values, 1e-12)))))
                                                      for values in (times, errors)))
        draw_lines(axes, lines, metric)
    add_legend(figure, axes)
    figure.suptitle(f"Geometric means of {len(measured)} scenes: {CLOCK_TITLES[clock]}", fontsize=11)
    return encoded(figure)


def pass_bars(result: SceneResult) -> bytes | None:
    """Return the bars (PNG) of a real-time frame's sections, at rest and in motion; None where none were timed."""
    frames = {f"{ENGINES[engine]}, at rest": facts["frame_times"] for engine, facts in result.engines.items()
              if facts.get("frame_times") and engine == "realtime"}
    frames |= {row["label"]: row["frame_times"] for row in result.rows
               if row.get("frame_times") and row.get("clock") == MOVING}
    if not frames:
        return None
    names = list(dict.fromkeys(name for times in frames.values() for name in times))[::-1]
    figure = new_figure(9.0, 1.4 + 0.28 * len(names))
    axes = figure.subplots()
    thickness, places = 0.8 / len(frames), np.arange(len(names), dtype=float)
    for index, (label, times) in enumerate(frames.items()):
        values = [times.get(name, 0.0) for name in names]
        bars = axes.barh(places + 0.4 - (index + 0.5) * thickness, values, thickness,
                         color=("#d62728", "#ff9a3c")[index % 2], label=f"{label}: {sum(values):.2f} ms")
        axes.bar_label(bars, [f"{value:.2f}" if value else "" for value in values], padding=2, fontsize=7)
    axes.set_yticks(places, names, fontsize=8)
    axes.margins(x=0.1, y=0.01)
    axes.set_xlabel("milliseconds, each section waited for")
    axes.legend(fontsize=8)
    axes.set_title(f"{result.name}: one real-time frame, {result.size[0]} x {result.size[1]}", fontsize=10)
    return encoded(figure)


def map_budget(result: SceneResult) -> tuple[str, float] | None:
    """Return the clock and budget at which most engines have a picture; the shortest of those."""
    counts: dict[tuple[str, float], int] = {}
    for row in result.rows:
        if row.get("errors") and row.get("budget"):
            key = row["clock"], row["budget"]
            counts[key] = counts.get(key, 0) + 1
    # On equal terms the warm clock's, then the shorter time.
    return max(counts, key=lambda key: (counts[key], key[0] == "warm", -key[1]), default=None)


def error_maps(result: SceneResult, truth: np.ndarray, read: Callable[[dict[str, Any]], np.ndarray]) -> bytes | None:
    """Return pictures, FLIP maps and signed differences (JPEG) of all engines at one budget.

    Args:
        result: The scene's rows.
        truth: Scene-linear [h, w, 3], bottom row first.
        read: Gives a row's picture of the same shape.
    """
    chosen = map_budget(result)
    if chosen is None:
        return None
    rows = [row for row in result.rows if (row.get("clock"), row.get("budget")) == chosen and row.get("errors")]
    rows = rows[:MAP_COLUMNS]
    height, width = truth.shape[:2]
    figure = new_figure(3.3 * len(rows) + 0.6, 3 * 3.3 * height / width + 1.0)
    grid = figure.subplots(3, len(rows), squeeze=False)
    factor = 2.0 ** result.exposure
    for column, row in enumerate(rows):
        picture = np.nan_to_num(read(row))
        shown = grid[1][column].imshow(flip_map(truth, picture)[::-1], cmap="magma", vmin=0.0, vmax=0.6)
        grid[0][column].imshow(encode_srgb(picture[::-1] * factor))
        grid[2][column].imshow(signed_difference(truth, picture, FULL_SCALE)[::-1])
        grid[0][column].set_title(f"{row['label']}\nFLIP {row['errors']['flip']:.3f}, relMSE "
                                  f"{row['errors']['relative_mse']:.3g}", fontsize=9)
    for axes in grid.ravel():
        axes.set_xticks([])
        axes.set_yticks([])
    names = ("picture", "FLIP", f"red brighter, blue\ndarker by {100 * FULL_SCALE:g} %")
    for line, name in zip(grid, names, strict=True):
        line[0].set_ylabel(name, fontsize=9)
    figure.colorbar(shown, ax=grid[1].tolist(), fraction=0.02)
    return encoded(figure, "jpg")
