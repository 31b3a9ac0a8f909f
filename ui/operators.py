# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the panels: copy the report or the diagnostics, select what an entry is about, build the kernels."""

from __future__ import annotations

import re
from typing import Any

import bpy

from .services import services

__all__ = ["BURNISH_OT_copy_diagnostics", "BURNISH_OT_copy_report", "BURNISH_OT_select_owner", "BURNISH_OT_warm_up",
           "classes", "owner_parts"]

POLL_SECONDS = 0.1


def owner_parts(owner: str) -> tuple[str, str] | None:
    """Split an entry's owner ("material 'Floor'") into its kind and name; None where it has no such form."""
    match = re.fullmatch(r"([\w ]+?) '(.*)'", owner)
    return (match.group(1), match.group(2)) if match else None


class BURNISH_OT_copy_report(bpy.types.Operator):
    """Copy the whole report to the clipboard."""

    bl_idname = "burnish.copy_report"
    bl_label = "Copy Report"
    bl_description = "Copy what was approximated, skipped or missing to the clipboard"
    bl_options = {'REGISTER', 'INTERNAL'}

    def execute(self, context: Any) -> set[str]:
        """Copy."""
        context.window_manager.clipboard = services().report_text()
        self.report({'INFO'}, "Report copied")
        return {'FINISHED'}


class BURNISH_OT_copy_diagnostics(bpy.types.Operator):
    """Copy versions and devices to the clipboard."""

    bl_idname = "burnish.copy_diagnostics"
    bl_label = "Copy Diagnostics"
    bl_description = "Copy versions, device and driver to the clipboard, for a bug report"
    bl_options = {'REGISTER', 'INTERNAL'}

    def execute(self, context: Any) -> set[str]:
        """Copy."""
        context.window_manager.clipboard = services().diagnostics_text()
        self.report({'INFO'}, "Diagnostics copied")
        return {'FINISHED'}


class BURNISH_OT_select_owner(bpy.types.Operator):
    """Select the object, or the users of the material, that a report entry is about."""

    bl_idname = "burnish.select_owner"
    bl_label = "Select"
    bl_description = "Select the object, or all objects with the material, that this is about"
    bl_options = {'REGISTER', 'UNDO'}

    owner: bpy.props.StringProperty(name="Owner", options={'HIDDEN', 'SKIP_SAVE'})

    def execute(self, context: Any) -> set[str]:
        """Select in the active view layer."""
        parts = owner_parts(self.owner)
        if parts is None:
            self.report({'WARNING'}, f"There is nothing to select for {self.owner!r}")
            return {'CANCELLED'}
        objects = [item for item in context.view_layer.objects if concerns(item, *parts)]
        if not objects:
            self.report({'WARNING'}, f"No object in this view layer has the {self.owner}")
            return {'CANCELLED'}
        if context.mode != 'OBJECT':
            bpy.ops.object.mode_set(mode='OBJECT')
        for item in context.view_layer.objects:
            item.select_set(item in objects)
        context.view_layer.objects.active = objects[0]
        if parts[0] == "material":
            objects[0].active_material_index = objects[0].material_slots.find(parts[1])
        return {'FINISHED'}


def concerns(item: Any, kind: str, name: str) -> bool:
    """Tell whether an object is, uses or carries the data-block of a kind and name."""
    if kind == "material":
        return any(slot.material is not None and slot.material.name == name for slot in item.material_slots)
    if kind == "object":
        return item.name == name
    return item.name == name or (item.data is not None and item.data.name == name)


class BURNISH_OT_warm_up(bpy.types.Operator):
    """Build all kernels now, in a thread, with progress in the status bar."""

    bl_idname = "burnish.warm_up"
    bl_label = "Build Kernels"
    bl_description = "Build all kernels now, so that the first render starts at once; the result is kept on disk"
    bl_options = {'REGISTER', 'INTERNAL'}

    _running: Any = None

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Allow one build at a time."""
        running = BURNISH_OT_warm_up._running
        return running is None or running.done

    def invoke(self, context: Any, event: Any) -> set[str]:
        """Start the build and a timer."""
        BURNISH_OT_warm_up._running = services().start_warm_up()
        manager = context.window_manager
        manager.progress_begin(0.0, 100.0)
        self._timer = manager.event_timer_add(POLL_SECONDS, window=context.window)
        manager.modal_handler_add(self)
        return {'RUNNING_MODAL'}

    def modal(self, context: Any, event: Any) -> set[str]:
        """Show progress until the build is done; everything else goes on."""
        if event.type != 'TIMER':
            return {'PASS_THROUGH'}
        running = BURNISH_OT_warm_up._running
        if not running.done:
            context.window_manager.progress_update(100.0 * running.progress)
            context.workspace.status_text_set(f"Burnish: {running.text}")
            return {'PASS_THROUGH'}
        context.window_manager.progress_end()
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        return self._finish(running)

    def execute(self, context: Any) -> set[str]:
        """Build and wait (scripts, background)."""
        import time

        BURNISH_OT_warm_up._running = running = services().start_warm_up()
        while not running.done:
            time.sleep(POLL_SECONDS)
        return self._finish(running)

    def _finish(self, running: Any) -> set[str]:
        BURNISH_OT_warm_up._running = None
        if running.error:
            self.report({'ERROR'}, running.error)
            return {'CANCELLED'}
        self.report({'INFO'}, running.text)
        return {'FINISHED'}


classes = (BURNISH_OT_copy_report, BURNISH_OT_copy_diagnostics, BURNISH_OT_select_owner, BURNISH_OT_warm_up)
