# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties that Attribute nodes name: of objects, of what instances them, and of the view layer.

By Blender's rules (its manual, "Attribute Node"; BKE_object_dupli_find_rgba_attribute and
BKE_view_layer_find_rgba_attribute): a custom property of the name counts before the data path, the instancer before
the object, the object before its data; the view layer before the scene, that before its world. A number fills red,
green and blue; alpha is 1; what nobody has is 0. Main thread only; keeps nothing of bpy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import bpy
import numpy as np

from ...engine.mesh_features import hashed
from ...engine.object_properties import particle_output, split_name
from .mesh import ATTRIBUTE_TYPES, read_vec4

__all__ = ["UNUSED_ID", "LayerProperties", "property_columns", "property_of"]

Color = tuple[float, float, float, float]

NOTHING: Color = (0.0, 0.0, 0.0, 0.0)

UNUSED_ID = 0x7FFFFFFF
"""What persistent ids hold of levels that an instance does not have"""


def property_of(owners: Iterable[Any], name: str) -> Color:
    """Return the property of the first owner that has it as a number or a few of them."""
    for owner in owners:
        value = None if owner is None else as_color(found_property(owner, name))
        if value is not None:
            return value
    return NOTHING


def found_property(owner: Any, name: str) -> Any:
    """Return a custom property or what a data path leads to, None for nothing."""
    value = owner.get(name)
    if value is not None:
        return value
    try:
        return owner.path_resolve(name)
    except (ValueError, TypeError):
        return None


def as_color(value: Any) -> Color | None:
    """Return a number, or up to four, as a colour; None for all else."""
    if isinstance(value, (bool, int, float)):
        return float(value), float(value), float(value), 1.0
    try:
        parts = list(value)
    except TypeError:
        return None
    if 0 < len(parts) <= 4 and all(type(part) in (int, float) for part in parts):
        return tuple([float(part) for part in parts] + [0.0, 0.0, 0.0, 1.0][len(parts):])
    return None


class LayerProperties:
    """Properties of a view layer that materials have asked for."""

    def __init__(self) -> None:
        self._values: dict[str, Color] = {}
        self._owners: tuple = ()

    def begin(self, depsgraph: bpy.types.Depsgraph) -> bool:
        """Look at a graph until `end`; return whether what was asked for before has another value now."""
        scene = depsgraph.scene_eval
        self._owners = (depsgraph.view_layer_eval, scene, scene.world)
        changed = any(property_of(self._owners, name) != value for name, value in self._values.items())
        if changed:
            self._values = {}
        return changed

    def end(self) -> None:
        """Let go of the graph."""
        self._owners = ()

    def __call__(self, name: str) -> Color:
        """Return a property."""
        self._values[name] = property_of(self._owners, name)
        return self._values[name]


def property_columns(names: tuple[str, ...], placements: list[Any], sources: list[Any], rows: np.ndarray,
                     persistent_ids: np.ndarray, frame: float) -> dict[str, Any]:
    """Return the columns of an InstanceTable.

    Args:
        names: Properties as programs have them.
        placements: All placements.
        sources: Theirs.
        rows: int [N], the instances' placements.
        persistent_ids: int32 [N, 8].
        frame: The scene's, for ages.
    """
    if not names:
        return {}
    values = np.zeros((len(names), len(rows), 4), np.float32)
    used = np.unique(rows).tolist()
    for number, name in enumerate(names):
        output = particle_output(name)
        if output:
            _read_particles(output, placements, rows, persistent_ids, values[number], frame)
            continue
        prop, of_instancer = split_name(name)
        by_placement = np.zeros((len(placements), 4), np.float32)
        for index in used:
            placement = placements[index]
            source = sources[placement.source]
            settings = None if placement.particles is None else placement.particles.settings
            instancers = (settings, placement.parent) if of_instancer else ()
            by_placement[index] = property_of((*instancers, source.owner, source.data), prop)
        values[number] = by_placement[rows]
        if of_instancer:
            _read_instance_attributes(prop, placements, rows, persistent_ids, values[number])
    return {"property_names": names, "properties": np.nan_to_num(values, posinf=0.0, neginf=0.0)}


def _read_particles(output: str, placements: list[Any], rows: np.ndarray, persistent_ids: np.ndarray,
                    values: np.ndarray, frame: float) -> None:
    """Put in what Particle Info tells of the particles that made instances; children have none, as in Cycles."""
    for index in np.unique(rows).tolist():
        system = placements[index].particles
        if system is None:
            continue
        chosen = np.flatnonzero(rows == index)
        numbers = persistent_ids[chosen, 0]
        known = (numbers >= 0) & (numbers < len(system.particles))
        values[chosen[known]] = _particle_values(output, system.particles, frame)[numbers[known]]


def _particle_values(output: str, particles: Any, frame: float) -> np.ndarray:
    """Return float32 [particles, 4] of an output."""
    count = len(particles)

    def read(name: str, size: int = 1) -> np.ndarray:
        found = np.zeros((count, size), np.float32)
        particles.foreach_get(name, found.reshape(-1))
        return found

    if output == "Index":
        found = np.arange(count, dtype=np.float32)[:, None]
    elif output == "Random":
        found = (hashed(np.arange(count), 2) / np.float32(0xFFFFFFFF))[:, None]
    elif output == "Age":
        found = frame - read("birth_time")
    elif output in ("Lifetime", "Size"):
        found = read(output.lower())
    else:
        found = read(output.lower().replace(" ", "_"), 3)
    widened = np.ones((count, 4), np.float32)
    widened[:, :3] = found
    return widened


def _read_instance_attributes(name: str, placements: list[Any], rows: np.ndarray, persistent_ids: np.ndarray,
                              values: np.ndarray) -> None:
    """Put in what geometry nodes have stored on instances: those of the object itself, not on instances within them."""
    found: dict[int, np.ndarray | None] = {}
    for index in np.unique(rows).tolist():
        parent = placements[index].parent
        if parent is None:
            continue
        key = parent.as_pointer()
        if key not in found:
            found[key] = _instance_attribute(parent, name)
        if found[key] is None:
            continue
        chosen = np.flatnonzero(rows == index)
        ids = persistent_ids[chosen]
        # The outermost level is the last one.
        levels = (ids != UNUSED_ID).sum(1) - 1
        numbers = ids[np.arange(len(ids)), levels]
        good = (levels >= 0) & (numbers >= 0) & (numbers < len(found[key]))
        values[chosen[good]] = found[key][numbers[good]]


def _instance_attribute(parent: bpy.types.Object, name: str) -> np.ndarray | None:
    """Return an attribute of an object's instances, float32 [instances, 4], None without one."""
    read: Callable | None = getattr(parent, "evaluated_geometry", None)
    # Empties and the like have none. The points die with the set.
    geometry = read() if read is not None and parent.data is not None else None
    points = None if geometry is None else geometry.instances_pointcloud()
    attribute = None if points is None else points.attributes.get(name)
    if attribute is None or attribute.data_type not in ATTRIBUTE_TYPES:
        return None
    return read_vec4(attribute)
