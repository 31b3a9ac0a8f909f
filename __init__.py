# SPDX-License-Identifier: GPL-3.0-or-later
"""Burnish, a render engine for Blender: what Blender calls to switch the extension on and off.

Both functions import the add-on inside, so that `import burnish.engine` never loads bpy.
"""


def register() -> None:
    """Register everything with Blender."""
    from . import addon

    addon.register()


def unregister() -> None:
    """Take everything back from Blender."""
    from . import addon

    addon.unregister()
