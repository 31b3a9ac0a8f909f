# SPDX-License-Identifier: GPL-3.0-or-later
"""What was approximated, skipped or missing: deduplicated, counted, per object or material.

Knows nothing of Blender; addon/report.py shows it.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

__all__ = ["Report", "ReportEntry", "ReportKind"]


class ReportKind(enum.IntEnum):
    """How much an entry matters, least first."""

    NONE = 0
    INFO = 1
    """Told for interest: which acceleration structure was chosen, what was skipped as unused."""
    APPROXIMATED = 2
    """Drawn, but not exactly as Cycles would."""
    SKIPPED = 3
    """In the scene and not drawn."""
    MISSING = 4
    """Input that could not be read (an image, a library, a UV map)."""
    ERROR = 5
    """The picture can't be trusted."""


@dataclass(frozen=True)
class ReportEntry:
    """One deduplicated message."""

    kind: ReportKind
    owner: str
    """The data-block it concerns, as its kind and name: `material 'Floor'`; empty for the whole scene."""
    message: str
    count: int = 1


@dataclass
class Report:
    """Collects messages; the same (kind, owner, message) is counted, not repeated."""

    counts: dict[tuple[ReportKind, str, str], int] = field(default_factory=dict)

    def add(self, kind: ReportKind, owner: str, message: str, count: int = 1) -> None:
        """Record `message` about `owner`; adding it again raises its count by `count`."""
        key = (kind, owner, message)
        self.counts[key] = self.counts.get(key, 0) + count

    def merge(self, other: Report) -> None:
        """Add all entries of `other`."""
        for (kind, owner, message), count in other.counts.items():
            self.add(kind, owner, message, count)

    def entries(self) -> list[ReportEntry]:
        """Return all entries, the gravest first, then by owner."""
        keys = sorted(self.counts, key=lambda key: (-key[0], key[1], key[2]))
        return [ReportEntry(*key, count=self.counts[key]) for key in keys]

    def text(self) -> str:
        """Return the report as lines to copy."""
        lines = []
        for entry in self.entries():
            times = f" (x{entry.count})" if entry.count > 1 else ""
            owner = f"{entry.owner}: " if entry.owner else ""
            lines.append(f"{entry.kind.name.lower()}: {owner}{entry.message}{times}")
        return "\n".join(lines)
