# SPDX-License-Identifier: GPL-3.0-or-later
"""How whoever wants a scene extracted is told and asked meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .instances import ExtractionCancelled

__all__ = ["Callbacks", "Progress"]

Progress = Callable[[str, float], None]


@dataclass
class Callbacks:
    """How the caller is told and asked."""

    progress: Progress | None
    cancelled: Callable[[], bool] | None

    def step(self, text: str, fraction: float) -> None:
        """Tell the progress; raises ExtractionCancelled where the caller wants no more."""
        if self.progress is not None:
            self.progress(text, fraction)
        if self.cancelled is not None and self.cancelled():
            raise ExtractionCancelled
