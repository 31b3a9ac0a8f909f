# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of the passes of light groups, as Blender and Cycles have them. Imports nothing: registering needs it."""

from __future__ import annotations

__all__ = ["GROUP_PREFIX"]

GROUP_PREFIX = "Combined_"
"""Before a light group's name in that of its pass"""
