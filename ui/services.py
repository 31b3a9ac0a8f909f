# SPDX-License-Identifier: GPL-3.0-or-later
"""What panels and operators ask of the host side; filled in at registration, so that ui imports none of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

__all__ = ["Services", "install", "services"]


@dataclass(frozen=True, kw_only=True)
class Services:
    """Functions of the host side; all of them are quick and for the main thread."""

    report_entries: Callable[[], dict[str, list[Any]]]
    """Newest engine.report.ReportEntry list by source ("Render", "Viewport")"""
    report_details: Callable[[], dict[str, list[tuple[str, str]]]]
    """Newest figures by source, as (name, value)"""
    report_text: Callable[[], str]
    diagnostics_text: Callable[[], str]
    start_warm_up: Callable[[], Any]
    """Starts building the kernels; returns an object with `text`, `progress` (0..1), `error` and `done`"""


_installed: Services | None = None


def install(new: Services | None) -> None:
    """Set or, with None, take away the services."""
    global _installed
    _installed = new


def services() -> Services:
    """Return the services; only valid while the add-on is registered."""
    assert _installed is not None, "the add-on is not registered"
    return _installed
