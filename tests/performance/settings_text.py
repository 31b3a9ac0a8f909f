# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that the measuring scripts change: from their command lines, and of their own."""

from __future__ import annotations

import ast
from typing import Any

Groups = dict[str, dict[str, Any]]
"""{group: {field: value}}"""

FILTERED: Groups = {"denoiser": {"path_traced_rest": False}}
"""Frames alone at rest: the filtered picture stays, path tracing does not take over"""


def merged(*groups: Groups | None) -> Groups:
    """Return settings with those of later groups over those of earlier ones."""
    total: Groups = {}
    for group in groups:
        for name, fields in (group or {}).items():
            total[name] = {**total.get(name, {}), **fields}
    return total


def parse_settings(texts: list[str]) -> Groups:
    """Return settings from texts like `cache.bounces=1`."""
    groups: Groups = {}
    for text in texts:
        name, value = text.split("=", 1)
        group, field = name.split(".", 1)
        try:
            groups.setdefault(group, {})[field] = ast.literal_eval(value)
        except (SyntaxError, ValueError):
            groups.setdefault(group, {})[field] = value
    return groups
