# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the table of docs/settings.md from engine.settings: `--write` renews it, else exit 1 where it is stale."""

from __future__ import annotations

import enum
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from burnish.engine.settings import RenderSettings

PAGE = Path(__file__).resolve().parent.parent / "docs" / "settings.md"
BEGIN = "<!-- The table down to `end of settings` is made by `make docs`. -->"
END = "<!-- end of settings -->"


def shown(value: Any) -> str:
    """Return a default as a person reads it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if value == "":
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def domain(default: Any, metadata: dict[str, Any]) -> str:
    """Return what values a setting may take."""
    if isinstance(default, bool):
        return "on, off"
    if isinstance(default, enum.Enum):
        return ", ".join(type(default))
    if metadata["choices"]:
        return "a name that `burnish render --help` lists"
    unit = f" {metadata['unit']}" if metadata["unit"] else ""
    return f"{shown(metadata['low'])} to {shown(metadata['high'])}{unit}"


def rows(settings: Any, group: str = "") -> list[str]:
    """Return a table row for each setting, groups in their order."""
    lines = []
    for field in fields(settings):
        default = getattr(settings, field.name)
        if is_dataclass(default):
            lines += rows(default, field.name.replace("_", " "))
        else:
            lines.append(f"| {group} | `{field.name}` | {shown(default)} | {domain(default, field.metadata)} "
                         f"| {field.metadata['help']} |")
    return lines


def renewed(page: str) -> str:
    """Return the page with its table made anew."""
    before, rest = page.split(BEGIN)
    after = rest.split(END)[1]
    table = "\n".join(["| group | setting | default | values | meaning |", "|---|---|---|---|---|",
                       *rows(RenderSettings())])
    return f"{before}{BEGIN}\n\n{table}\n\n{END}{after}"


def main() -> int:
    """Renew the page's table, or tell whether it is stale."""
    page = PAGE.read_text("utf-8")
    if "--write" in sys.argv:
        PAGE.write_text(renewed(page), "utf-8")
    elif renewed(page) != page:
        print("The table of docs/settings.md is stale; run `make docs`.", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
