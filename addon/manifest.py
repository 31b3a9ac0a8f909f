# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension's manifest says of itself. Loads no bpy."""

from __future__ import annotations

import tomllib
from pathlib import Path

__all__ = ["package_version"]


def package_version() -> str:
    """Return Burnish's version, or "unknown" without a readable manifest."""
    try:
        manifest = tomllib.loads((Path(__file__).parent.parent / "blender_manifest.toml").read_text("utf-8"))
        return str(manifest["version"])
    except (OSError, KeyError, tomllib.TOMLDecodeError):
        return "unknown"
