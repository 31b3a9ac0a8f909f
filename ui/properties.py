# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender properties, generated from the dataclasses of engine.settings: no default or range is repeated here.

`Scene.burnish` holds `device` and one group for each nested settings class, by the same names. Enum identifiers are
the member names in capitals (`Integrator.REFERENCE` is 'REFERENCE'); texts with choices are enums of these texts, with
'NONE' for the empty one.
"""

from __future__ import annotations

import ast
import enum
import inspect
import textwrap
from collections.abc import Callable
from dataclasses import Field, fields, is_dataclass
from typing import Any

import bpy

from ..engine.settings import FilmSettings, RenderSettings, SamplingSettings, setting_info

__all__ = ["classes", "enum_items", "enum_property", "member_docs", "register", "unregister"]

ELSEWHERE = {FilmSettings: {"transparent"}}
"""Settings that Blender has a property for already: render.film_transparent."""

UNITS = {"s": {"unit": 'TIME_ABSOLUTE'}, "px": {"subtype": 'PIXEL'}}
"""Blender's name for a setting's unit; other units only appear in the label."""

def redraw_views(self: Any, context: Any) -> None:
    """Draw all 3D views anew: Blender does so after an edit in a panel, but not after one by a script or preset."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == 'VIEW_3D':
                area.tag_redraw()


def update_passes(self: Any, context: Any) -> None:
    """Tell the scene's view layers that they may have other passes now."""
    for layer in self.id_data.view_layers:
        layer.update_render_passes()
    redraw_views(self, context)


UPDATES = {(SamplingSettings, "integrator"): update_passes}
"""What a change of a property calls instead of `redraw_views`, by settings class and name."""

NO_CHOICE = 'NONE'

MAX_INT = (1 << 31) - 1


def member_docs(enum_class: type[enum.Enum]) -> dict[str, str]:
    """Return the docstrings under the members of an enum class; empty where the source is not at hand."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(enum_class)))
    except (OSError, TypeError, SyntaxError):
        return {}
    docs, member = {}, None
    for node in tree.body[0].body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            member = node.targets[0].id
        elif member and isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            docs[member] = " ".join(str(node.value.value).split())
            member = None
    return docs


def title(name: str) -> str:
    """Return a Python or enum name as Blender writes labels."""
    return name.replace("_", " ").title().replace("Cpu", "CPU").replace("Cuda", "CUDA").replace("Gbuffer", "G-Buffer")


def description(text: str) -> str:
    """Return a help text as Blender wants tooltips: without the full stop."""
    return text.removesuffix(".")


def enum_items(enum_class: type[enum.Enum]) -> list[tuple[str, str, str]]:
    """Return an enum class as items of an EnumProperty."""
    docs = member_docs(enum_class)
    items = []
    for member in enum_class:
        label = member.value.replace("_", "-").title() if member.name == "BLACKMAN_HARRIS" else title(member.name)
        items.append((member.name, label, description(docs.get(member.name, ""))))
    return items


def choice_items(choices: dict[str, str], empty: str) -> list[tuple[str, str, str]]:
    """Return a text's choices ("pass.name" with their help) as items of an EnumProperty, each pass under a heading.

    `empty` is the label of 'NONE', the empty text.
    """
    items, heading = [(NO_CHOICE, empty, "")], ""
    for name, help in choices.items():
        section, _, label = name.partition(".")
        if section != heading:
            # An item without identifier is a heading.
            items.append(("", title(section), ""))
            heading = section
        items.append((name, title(label), description(help)))
    return items


def enum_property(enum_class: type[enum.Enum], default: enum.Enum, name: str, help: str,
                  update: Callable[[Any, Any], None] | None = None) -> Any:
    """Return an EnumProperty for an enum class."""
    return bpy.props.EnumProperty(name=name, description=description(help), items=enum_items(enum_class),
                                  default=default.name, update=update)


def setting_property(field: Field, update: Callable[[Any, Any], None] = redraw_views) -> Any:
    """Return the Blender property of one setting, which calls `update` after a change."""
    info, default = field.metadata, field.default
    label = info["label"] or title(field.name)
    if isinstance(default, enum.Enum):
        return enum_property(type(default), default, label, info["help"], update)
    common = {"name": label, "description": description(info["help"]), "default": default, "options": {'ANIMATABLE'},
              "update": update}
    if info["choices"]:
        common["default"] = default or NO_CHOICE
        return bpy.props.EnumProperty(items=choice_items(info["choices"], "None"), **common)
    if isinstance(default, bool):
        return bpy.props.BoolProperty(**common)
    if info["unit"] and info["unit"] not in UNITS:
        common["name"] = f"{label} ({info['unit']})"
    common |= UNITS.get(info["unit"], {})
    limits = {"min": info["low"], "max": info["high"], "soft_max": info["soft_high"]}
    common |= {key: value for key, value in limits.items() if value is not None}
    if isinstance(default, int):
        common |= {key: min(common[key], MAX_INT) for key in ("max", "soft_max") if key in common}
        return bpy.props.IntProperty(**common)
    return bpy.props.FloatProperty(precision=3, **common)


def make_group(name: str, settings_class: type) -> type:
    """Return a PropertyGroup class with the settings of a dataclass."""
    skipped = ELSEWHERE.get(settings_class, set())
    annotations = {key: setting_property(field, UPDATES.get((settings_class, key), redraw_views))
                   for key, field in setting_info(settings_class).items() if key not in skipped}
    return type(name, (bpy.types.PropertyGroup,), {
        "__annotations__": annotations, "__doc__": settings_class.__doc__, "__module__": __name__})


def make_classes() -> tuple[type, ...]:
    """Return all PropertyGroup classes, the one for the scene last."""
    groups, annotations = [], {}
    defaults = RenderSettings()
    for field in fields(RenderSettings):
        default = getattr(defaults, field.name)
        if is_dataclass(default):
            group = make_group(f"BURNISH_PG_{field.name}", type(default))
            groups.append(group)
            annotations[field.name] = bpy.props.PointerProperty(type=group)
        else:
            annotations[field.name] = setting_property(field)
    scene = type("BURNISH_PG_scene", (bpy.types.PropertyGroup,), {
        "__annotations__": annotations, "__doc__": "Settings of the engine in a scene.", "__module__": __name__})
    return (*groups, scene)


classes = make_classes()


def register() -> None:
    """Register the groups and attach them to scenes."""
    for cls in classes:
        bpy.utils.register_class(cls)
    bpy.types.Scene.burnish = bpy.props.PointerProperty(type=classes[-1], name="Burnish")


def unregister() -> None:
    """Detach and unregister the groups."""
    del bpy.types.Scene.burnish
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
