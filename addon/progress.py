# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress of a final render: Blender's status line and, in background, lines that a render farm can parse."""

from __future__ import annotations

import os
import sys
import time
from typing import Any

__all__ = ["Cancelled", "RenderProgress", "format_duration"]

STATS_SECONDS = 0.25
"""Shortest time between two status lines in the window."""
BACKGROUND_SECONDS = 1.0
"""Shortest time between two lines in background, where each is printed."""

OPENJD_VARIABLE = "BURNISH_OPENJD"
"""Environment variable that asks for `openjd_progress:` lines too (Open Job Description, as Deadline Cloud reads)."""


class Cancelled(Exception):
    """The user cancelled the render: not a failure."""


def format_duration(seconds: float) -> str:
    """Return a time as [h:]mm:ss."""
    whole = round(max(seconds, 0.0))
    hours, minutes, rest = whole // 3600, whole // 60 % 60, whole % 60
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes:02d}:{rest:02d}"


class RenderProgress:
    """Tells one call of RenderEngine.render how far it is; checks for cancellation."""

    def __init__(self, engine: Any, *, frame: int, layer: str, parts: int, background: bool) -> None:
        self.engine = engine
        self.frame = frame
        self.title = layer
        """View layer, and view where there are several."""
        self.parts = parts
        """Pictures (views) that this call renders."""
        self.part = 0
        self.background = background
        self._told_at = 0.0
        self._peak = 0

    def stage(self, text: str, progress: float = 0.0) -> None:
        """Show what is being prepared; raises Cancelled when the user has cancelled."""
        if self.engine.test_break():
            raise Cancelled
        if self._due() or progress == 0.0:
            self.engine.update_stats(self.title, text)

    def samples(self, done: int, total: int, elapsed: float, remaining: float | None, device_bytes: int,
                fraction: float) -> None:
        """Show the samples done of the current picture, with times [s] and memory [bytes]."""
        self.engine.update_progress(min((self.part + fraction) / max(self.parts, 1), 1.0))
        self._peak = max(self._peak, device_bytes)
        self.engine.update_memory_stats(memory_used=device_bytes / 2**20, memory_peak=self._peak / 2**20)
        last = done >= total
        if not self._due() and not last:
            return
        text = f"Sample {done}/{total}"
        remaining_text = f"Remaining {format_duration(remaining)} | " if remaining is not None and not last else ""
        self.engine.update_stats(f"{self.title} | {remaining_text}Mem {device_bytes / 2**20:.0f}M", text)
        if self.background:
            self._print(f"Fra:{self.frame} Mem:{device_bytes / 2**20:.2f}M Time:{format_duration(elapsed)} | "
                        f"{remaining_text}{self.title} | {text}")
            if os.environ.get(OPENJD_VARIABLE):
                self._print(f"openjd_progress: {100.0 * fraction:.1f}")

    def _due(self) -> bool:
        now = time.perf_counter()
        if now - self._told_at < (BACKGROUND_SECONDS if self.background else STATS_SECONDS):
            return False
        self._told_at = now
        return True

    @staticmethod
    def _print(line: str) -> None:
        # Blender prefixes its own lines with a time stamp, so only lines written here match "^Fra:".
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
