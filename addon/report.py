# SPDX-License-Identifier: GPL-3.0-or-later
"""Tells Blender and the user what went wrong or was not drawn; the only file that does.

A failed render must call `report({'ERROR'})`: an exception, `error_set` or a cancelled result alone make Blender save
an empty frame and call it finished (measured in 5.0 and 5.2).
"""

from __future__ import annotations

import logging
import threading
from typing import Any

from ..engine.errors import BurnishError
from ..engine.report import Report, ReportEntry

__all__ = [
    "clear", "error_sentence", "fail", "publish", "publish_details", "published", "published_details",
    "published_entries", "published_text", "session_details", "stats_details", "timing_details",
]

log = logging.getLogger(__name__)

SOURCES = ("Render", "Viewport")

_lock = threading.Lock()
_reports: dict[str, Report] = {}
_details: dict[str, list[tuple[str, str]]] = {}


def error_sentence(error: BaseException) -> str:
    """Return what to tell the user: a BurnishError's own sentence, else the error's type and text (and log it)."""
    if isinstance(error, BurnishError):
        return str(error)
    if isinstance(error, MemoryError):
        return "Out of memory; make the picture, its textures or its meshes smaller"
    log.error("Unexpected error", exc_info=error)
    return f"Unexpected {type(error).__name__}: {error}" if str(error) else f"Unexpected {type(error).__name__}"


def fail(engine: Any, error: BaseException) -> str:
    """Make the running render count as failed in Blender, with a sentence; return the sentence."""
    sentence = f"Burnish: {error_sentence(error)}"
    engine.report({'ERROR'}, sentence)
    engine.error_set(sentence)
    return sentence


def publish(source: str, report: Report, details: list[tuple[str, str]] | None = None) -> None:
    """Show `report` (and name-value lines of figures) in the panel as the newest of `source`; from any thread."""
    assert source in SOURCES, source
    with _lock:
        _reports[source] = Report(dict(report.counts))
        if details is not None:
            _details[source] = list(details)


def publish_details(source: str, details: list[tuple[str, str]]) -> None:
    """Show name-value lines of figures beside the report of `source`; from any thread."""
    assert source in SOURCES, source
    with _lock:
        _details[source] = list(details)


def published(source: str) -> Report:
    """Return the newest report of "Render" or "Viewport" (an empty one before the first)."""
    with _lock:
        return _reports.get(source, Report())


def published_entries() -> dict[str, list[ReportEntry]]:
    """Return the newest entries by source, for the panel."""
    with _lock:
        return {source: _reports[source].entries() for source in SOURCES if source in _reports}


def published_details() -> dict[str, list[tuple[str, str]]]:
    """Return the newest figures by source, for the panel."""
    with _lock:
        return {source: list(_details[source]) for source in SOURCES if source in _details}


def published_text() -> str:
    """Return everything published, as lines to copy."""
    lines = []
    details = published_details()
    for source in published_entries():
        lines.append(f"{source}:")
        lines += [f"  {name}: {value}" for name, value in details.get(source, [])]
        text = published(source).text()
        lines += [f"  {line}" for line in text.splitlines()] or ["  nothing to report"]
    return "\n".join(lines)


def clear() -> None:
    """Forget all reports (file load, unregister)."""
    with _lock:
        _reports.clear()
        _details.clear()


def session_details(session: Any) -> list[tuple[str, str]]:
    """Return a session's figures as name-value lines."""
    stats = getattr(session, "stats", None)
    lines = [("Device", str(getattr(session, "device_name", "")))]
    return lines + stats_details(stats) + timing_details(session.frame_times, session.skipped)


def timing_details(frame_times: dict[str, float], skipped: dict[str, str]) -> list[tuple[str, str]]:
    """Return the milliseconds of a real-time frame's sections, and why others were left out, as name-value lines."""
    if not frame_times:
        return []
    lines = [("Real-time frame", f"{sum(frame_times.values()):.2f} ms")]
    lines += [(f"  {name}", f"{milliseconds:.2f} ms") for name, milliseconds in frame_times.items()]
    return lines + [(f"  {name}", f"skipped: {reason}") for name, reason in skipped.items()]


def stats_details(stats: Any) -> list[tuple[str, str]]:
    """Return a SessionStats as name-value lines."""
    if stats is None:
        return []
    lines = [
        ("Triangles", f"{stats.triangles:,}"),
        ("Instances", f"{stats.instances:,}"),
        ("Lights", f"{stats.lights:,}"),
        ("Textures", f"{stats.texture_bytes / 2**20:.1f} MiB"),
        ("Device memory", f"{stats.device_bytes / 2**20:.1f} MiB"),
        ("Structure", str(stats.structure)),
    ]
    return lines + [(f"Time: {name}", f"{seconds:.3f} s") for name, seconds in stats.times.items()]
