# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's preferences: compute device, where built kernels are kept, and text to copy for a bug report."""

from __future__ import annotations

import dataclasses
import logging
import os
from typing import Any

import bpy

from ..engine.settings import Device, RenderSettings
from ..ui.properties import enum_property

__all__ = ["PACKAGE", "BurnishPreferences", "package_version", "preferred_device", "register", "unregister",
           "with_device"]

log = logging.getLogger(__name__)

PACKAGE = __package__.rpartition(".")[0]
"""The extension's module name: what Blender files its preferences under."""

CACHE_VARIABLE = "WARP_CACHE_PATH"
"""Environment variable from which Warp takes its kernel cache; set by the user or a farm, it wins."""

_cache_is_ours = False


def update_cache(self: Any, context: Any) -> None:
    """Note a change of the cache folder; Warp reads it when it starts."""
    apply_cache_folder(self.kernel_cache)


class BurnishPreferences(bpy.types.AddonPreferences):
    """What concerns the machine rather than the scene."""

    bl_idname = PACKAGE

    device: enum_property(Device, Device.AUTO, "Device", "Where the kernels run, for scenes that leave it to Auto")
    kernel_cache: bpy.props.StringProperty(
        name="Kernel Cache", subtype='DIR_PATH', default="", update=update_cache,
        description="Folder for built kernels, used from the next start of Blender (empty: in the user's cache folder)")

    def draw(self, context: Any) -> None:
        """Draw the preferences."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "device")
        layout.prop(self, "kernel_cache")
        row = layout.row()
        row.operator("burnish.warm_up", icon='SHADERFX')
        row.operator("burnish.copy_diagnostics", icon='COPYDOWN')


def preferences() -> BurnishPreferences | None:
    """Return the preferences, or None where the package runs without being enabled as an add-on."""
    addon = bpy.context.preferences.addons.get(PACKAGE)
    return addon.preferences if addon is not None else None


def preferred_device() -> Device:
    """Return the device of the preferences."""
    own = preferences()
    return Device[own.device] if own is not None else Device.AUTO


def with_device(settings: RenderSettings) -> RenderSettings:
    """Return `settings` with the preferences' device where the scene leaves it to Auto."""
    if settings.device != Device.AUTO:
        return settings
    return dataclasses.replace(settings, device=preferred_device())


def apply_cache_folder(folder: str) -> None:
    """Make Warp keep built kernels in `folder` from its next start, unless the environment says otherwise."""
    global _cache_is_ours
    if os.environ.get(CACHE_VARIABLE) and not _cache_is_ours:
        return
    if folder:
        os.environ[CACHE_VARIABLE] = bpy.path.abspath(folder)
    elif _cache_is_ours:
        del os.environ[CACHE_VARIABLE]
    _cache_is_ours = bool(folder)


def package_version() -> str:
    """Return the extension's version from its manifest, or "unknown"."""
    import tomllib
    from pathlib import Path

    try:
        manifest = tomllib.loads((Path(__file__).parent.parent / "blender_manifest.toml").read_text("utf-8"))
        return str(manifest["version"])
    except (OSError, KeyError, tomllib.TOMLDecodeError):
        return "unknown"


def register() -> None:
    """Register the preferences and apply the cache folder."""
    bpy.utils.register_class(BurnishPreferences)
    own = preferences()
    if own is not None and own.kernel_cache:
        apply_cache_folder(own.kernel_cache)


def unregister() -> None:
    """Unregister the preferences."""
    bpy.utils.unregister_class(BurnishPreferences)
