# SPDX-License-Identifier: GPL-3.0-or-later
"""From the evaluated dependency graph to engine.scene: copies, main thread only, nothing of bpy is kept."""
