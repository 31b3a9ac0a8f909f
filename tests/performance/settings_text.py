# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings given on the command line of the measuring scripts."""

from __future__ import annotations

import ast
from typing import Any


def parse_settings(texts: list[str]) -> dict[str, dict[str, Any]]:
    """Return {group: {field: value}} from texts like `cache.bounces=1`."""
    groups: dict[str, dict[str, Any]] = {}
    for text in texts:
        name, value = text.split("=", 1)
        group, field = name.split(".", 1)
        try:
            groups.setdefault(group, {})[field] = ast.literal_eval(value)
        except (SyntaxError, ValueError):
            groups.setdefault(group, {})[field] = value
    return groups
