# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's preferences: compute device, where built kernels are kept, and text to copy for a bug report."""

from __future__ import annotations

import dataclasses
from typing import Any

import bpy

from ..engine.kernel_cache import set_cache_folder
from ..engine.settings import Device, RenderSettings
from ..ui.properties import enum_property

__all__ = ["PACKAGE", "BurnishPreferences", "preferred_device", "register", "unregister", "with_device"]

PACKAGE = __package__.rpartition(".")[0]
"""The extension's module name: what Blender files its preferences under."""


def update_cache(self: Any, context: Any) -> None:
    """Pass a change of the cache folder on; Warp reads it when it starts."""
    set_cache_folder(bpy.path.abspath(self.kernel_cache))


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


def register() -> None:
    """Register the preferences and pass the cache folder on."""
    bpy.utils.register_class(BurnishPreferences)
    own = preferences()
    if own is not None:
        update_cache(own, None)


def unregister() -> None:
    """Unregister the preferences."""
    bpy.utils.unregister_class(BurnishPreferences)
