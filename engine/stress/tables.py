# SPDX-License-Identifier: GPL-3.0-or-later
"""The stress test's results as a Markdown table, as JSON and as one line."""

from __future__ import annotations

import json
from collections.abc import Sequence

from .cases import Result

__all__ = ["as_json", "as_line", "as_markdown", "summary"]

COLUMNS = ("case", "goal", "pictures", "not finite", "negative", "energy", "FLIP", "s", "")
LEGEND = """\
Every picture's pixels must be finite and not negative, and each case has a goal of its own. Energy: the ratio of mean
luminances to what they should be that is furthest from 1. FLIP: the largest difference of two pictures that should be
the same."""


def figures(result: Result) -> list[str]:
    """Return a result's cells after the name and the goal."""
    energy = f"{result.energy:.4f}" if result.energy is not None else ""
    flip = f"{result.flip:.4f}" if result.flip is not None else ""
    return [str(result.pictures), str(result.non_finite), str(result.negative), energy, flip, f"{result.seconds:.1f}",
            "" if result.passed else "missed"]


def as_line(result: Result) -> str:
    """Return a result as a line of text."""
    pictures, _, _, energy, flip, seconds, _ = figures(result)
    parts = [f"{pictures} pictures"] + [f"{name} {text}" for name, text in (("energy", energy), ("FLIP", flip)) if text]
    state = "ok    " if result.passed else "MISSED"
    return f"{state} {result.name}: {', '.join(parts)}, {seconds} s"


def summary(results: Sequence[Result]) -> str:
    """Return the counts of all results, as one line."""
    failed = sum(not result.passed for result in results)
    pixels, pictures = sum(result.pixels for result in results), sum(result.pictures for result in results)
    bad = sum(result.non_finite for result in results), sum(result.negative for result in results)
    return (f"{len(results)} cases, {failed} failed; {bad[0]} non-finite and {bad[1]} negative of {pixels} pixels in "
            f"{pictures} pictures; {sum(result.seconds for result in results):.0f} s")


def as_markdown(results: Sequence[Result], device: str) -> str:
    """Return the table, what was missed, and the notes."""
    lines = [f"On {device}: {summary(results)}.", "", "| " + " | ".join(COLUMNS) + " |",
             "|---|---" + "|---:" * 6 + "|---|"]
    lines += ["| " + " | ".join([result.name, result.goal, *figures(result)]) + " |" for result in results]
    lines += ["", LEGEND, ""]
    missed = [f"- {result.name}: {sentence}" for result in results for sentence in result.missed]
    if missed:
        lines += ["Missed:", "", *missed, ""]
    return "\n".join(lines)


def as_json(results: Sequence[Result], device: str) -> str:
    """Return everything found."""
    return json.dumps({"device": device, "summary": summary(results),
                       "cases": [result.as_dict() for result in results]}, indent=1) + "\n"
