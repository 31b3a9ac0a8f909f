# SPDX-License-Identifier: GPL-3.0-or-later
"""The report: what was approximated, skipped or missing, counted and clickable; and the figures of the last picture."""

from __future__ import annotations

from itertools import groupby
from typing import Any

from bpy.types import Panel

from .operators import owner_parts
from .panel import BurnishPanel
from .services import services

__all__ = ["classes"]

ENTRIES_MAX = 40
"""Entries drawn; more make the panel slow and are only in the copied text."""

KIND_ICONS = {
    "ERROR": 'ERROR', "MISSING": 'LIBRARY_DATA_BROKEN', "SKIPPED": 'GHOST_DISABLED', "APPROXIMATED": 'SHADING_TEXTURE',
    "INFO": 'INFO',
}


class BURNISH_RENDER_PT_report(BurnishPanel, Panel):
    """What the picture lacks."""

    bl_label = "Report"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw the entries of the viewport and of the last render, the gravest first."""
        layout = self.layout
        by_source = services().report_entries()
        if not any(by_source.values()):
            layout.label(text="Nothing to report", icon='CHECKMARK')
        for source, entries in by_source.items():
            if entries:
                draw_entries(layout, source, entries)
        layout.operator("burnish.copy_report", icon='COPYDOWN')


def draw_entries(layout: Any, source: str, entries: list[Any]) -> None:
    """Draw the entries of one source, grouped by kind."""
    layout.label(text=source)
    for kind, group in groupby(entries[:ENTRIES_MAX], key=lambda entry: entry.kind):
        members = list(group)
        box = layout.box()
        box.label(text=f"{kind.name.title()} ({sum(entry.count for entry in members)})",
                  icon=KIND_ICONS.get(kind.name, 'DOT'))
        column = box.column(align=True)
        for entry in members:
            draw_entry(column, entry)
    if len(entries) > ENTRIES_MAX:
        layout.label(text=f"and {len(entries) - ENTRIES_MAX} more (copy the report to see all)")


def draw_entry(column: Any, entry: Any) -> None:
    """Draw one entry as a line, with a button where its owner can be selected."""
    times = f"  (x{entry.count})" if entry.count > 1 else ""
    row = column.row(align=True)
    if entry.owner and owner_parts(entry.owner) is not None:
        row.operator("burnish.select_owner", text="", icon='RESTRICT_SELECT_OFF', emboss=False).owner = entry.owner
    row.label(text=f"{entry.owner}: {entry.message}{times}" if entry.owner else f"{entry.message}{times}")


class BURNISH_RENDER_PT_statistics(BurnishPanel, Panel):
    """Figures of the last pictures."""

    bl_label = "Statistics"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context: Any) -> None:
        """Draw names and values."""
        layout = self.layout
        details = services().report_details()
        if not details:
            layout.label(text="Nothing rendered yet")
        for source, lines in details.items():
            layout.label(text=source)
            column = layout.box().column(align=True)
            for name, value in lines:
                row = column.split(factor=0.45)
                row.label(text=name)
                row.label(text=value)


classes = (BURNISH_RENDER_PT_report, BURNISH_RENDER_PT_statistics)
