# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of the documentation that plots are made from (plots.py), and what a plot's file says that it shows.

A table is marked by <!-- table: NAME --> above it. Needs the standard library alone.
"""

from __future__ import annotations

import functools
import html
import json
import re
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[2] / "docs"
PLOTS = DOCS / "plots"

WAYS = ("Burnish, frames", "Burnish, denoised", "Cycles", "Cycles, OpenImageDenoise")
"""The four pictures in a cell of an equal-time table, in its order"""

MARK = re.compile(r"^<!-- table: ([a-z0-9-]+) -->$")
SECONDS = {"ms": 1e-3, "s": 1.0}

Rows = list[dict[str, str]]


class TableError(Exception):
    """A table of the documentation that can't be read; the message names it."""


def cells(line: str) -> list[str]:
    """Return the cells of a table's line, without emphasis."""
    return [cell.strip().replace("**", "") for cell in line.strip().strip("|").split("|")]


def named_tables(text: str) -> dict[str, Rows]:
    """Return the marked tables of a page: a dictionary for each row, by the columns' titles.

    Raises:
        TableError: For a mark that no table follows, a name used twice, or a row that is too long or too short.
    """
    tables: dict[str, Rows] = {}
    lines = text.splitlines()
    for number, line in enumerate(lines):
        if not (mark := MARK.match(line)):
            continue
        name, start = mark[1], number + 1
        while start < len(lines) and not lines[start].strip():
            start += 1
        block = []
        while start < len(lines) and lines[start].startswith("|"):
            block.append(cells(lines[start]))
            start += 1
        if len(block) < 3 or name in tables:
            raise TableError(f"{name}: " + ("a second table of this name" if name in tables else "no table below"))
        titles = block[0]
        if any(len(row) != len(titles) for row in block):
            raise TableError(f"{name}: a row has not as many cells as the titles")
        tables[name] = [dict(zip(titles, row, strict=True)) for row in block[2:]]
    return tables


@functools.cache
def documented() -> dict[str, Rows]:
    """Return the marked tables of all pages of docs/."""
    tables: dict[str, Rows] = {}
    for page in sorted(DOCS.glob("*.md")):
        for name, rows in named_tables(page.read_text("utf-8")).items():
            if name in tables:
                raise TableError(f"{name}: on two pages")
            tables[name] = rows
    return tables


def table(name: str) -> Rows:
    """Return a table of docs/ by its name; raises TableError."""
    if name not in documented():
        raise TableError(f"{name}: no such table in docs/*.md")
    return documented()[name]


def cell(name: str, row: dict[str, str], title: str) -> str:
    """Return a cell by the beginning of its column's title; raises TableError."""
    found = [value for key, value in row.items() if key.startswith(title)]
    if not found:
        raise TableError(f"{name}: no column {title!r}")
    return found[0]


def number(name: str, text: str) -> float | None:
    """Return a cell's number, None for a dash; raises TableError."""
    if text == "-":
        return None
    try:
        return float(text)
    except ValueError:
        raise TableError(f"{name}: {text!r} is no number") from None


def numbers(name: str, text: str, separator: str, count: int) -> list[float | None]:
    """Return the numbers of a cell with several; raises TableError."""
    values = [number(name, part.strip()) for part in text.split(separator)]
    if len(values) != count:
        raise TableError(f"{name}: {text!r} has not {count} numbers")
    return values


def equal_time(name: str) -> dict[str, Any]:
    """Return seconds and FLIP of the four ways (None where no picture fits) by scene."""
    data = {}
    for row in table(name):
        points = []
        for title, text in row.items():
            amount, _, unit = title.partition(" ")
            if unit in SECONDS:
                points.append([round(float(amount) * SECONDS[unit], 6), *numbers(name, text, " / ", len(WAYS))])
        if not points:
            raise TableError(f"{name}: no column of a time")
        data[cell(name, row, "scene")] = points
    return data


def at_rest() -> dict[str, Any]:
    """Return frames, FLIP after as many, and Cycles' denoised FLIP, by scene."""
    name = "at-rest"
    title = next((key for key in table(name)[0] if key.startswith("FLIP after")), "")
    counts = [int(count) for count in re.findall(r"\d+", title)]
    return {cell(name, row, "scene"): {
        "frames": counts, "flip": numbers(name, cell(name, row, "FLIP after"), ",", len(counts)),
        "cycles": number(name, cell(name, row, "Cycles"))} for row in table(name)}


def flights() -> dict[str, Any]:
    """Return multiples of the error at rest (as shown, and of frames alone) and flicker by scene."""
    name = "flights"
    return {cell(name, row, "scene"): {
        "shown": numbers(name, cell(name, row, "frames 20, 40"), ",", 2),
        "alone": numbers(name, cell(name, row, "times that"), ",", 2),
        "flicker": number(name, cell(name, row, "flicker")),
        "cycles": number(name, cell(name, row, "Cycles' flicker"))} for row in table(name)}


def frame_time() -> dict[str, Any]:
    """Return milliseconds and goal of a frame by scene; the last row is their mean."""
    name = "frame-1080"
    return {cell(name, row, "scene"): [number(name, cell(name, row, "ms")), number(name, cell(name, row, "goal"))]
            for row in table(name)}


def waterfall() -> dict[str, Any]:
    """Return the changes, and a frame's milliseconds after each of them by scene, None where it was not measured."""
    name = "waterfall"
    rows = table(name)
    scenes = [scene for scene in frame_time() if scene in rows[0]]
    if not scenes:
        raise TableError(f"{name}: no column of a scene")
    return {"changes": [cell(name, row, "change") for row in rows],
            "ms": {scene: [number(name, row[scene]) for row in rows] for scene in scenes},
            "goals": sorted({goal for _, goal in frame_time().values()})}


def stress_energy() -> dict[str, Any]:
    """Return lowest and highest energy, and the goal's two ends (None: open), by case."""
    name = "stress-energy"
    titles = ("lowest", "highest", "goal from", "goal to")
    return {cell(name, row, "case"): [number(name, cell(name, row, title)) for title in titles]
            for row in table(name)}


def description(data: dict[str, Any]) -> str:
    """Return what a plot shows as the text that its file holds."""
    return json.dumps(data, separators=(",", ":"))


def shown_by(svg: str) -> dict[str, Any]:
    """Return what a plot's file says that it shows; raises TableError."""
    found = re.search(r"<dc:description>(.*?)</dc:description>", svg, re.DOTALL)
    if found is None:
        raise TableError("a plot without a description")
    return json.loads(html.unescape(found[1]))
