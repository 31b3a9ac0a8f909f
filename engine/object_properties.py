# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties of objects that materials read: how programs name them, and their values on the device.

Programs name them among their attributes, with a prefix. An InstanceTable holds their values for all instances, of the
names that any program has; without such programs there are none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
import warp as wp

from ..kernels.types import Materials
from .staging import overwrite

__all__ = ["PROPERTY_PREFIX", "ObjectProperties", "particle_name", "particle_output", "property_name",
           "property_names", "split_name"]

PROPERTY_PREFIX = ".property:"

OF_OBJECT, OF_INSTANCER, OF_PARTICLE = "object:", "instancer:", "particle:"


def property_name(name: str, *, instancer: bool) -> str:
    """Return the name under which programs have a property of the object, or of what made an instance of it."""
    return PROPERTY_PREFIX + (OF_INSTANCER if instancer else OF_OBJECT) + name


def particle_name(output: str) -> str:
    """Return the name of what the Particle Info node tells of the particle that made an instance."""
    return PROPERTY_PREFIX + OF_PARTICLE + output


def particle_output(name: str) -> str:
    """Return the output that such a name means, empty for other names."""
    kind = PROPERTY_PREFIX + OF_PARTICLE
    return name.removeprefix(kind) if name.startswith(kind) else ""


def split_name(name: str) -> tuple[str, bool]:
    """Return the property that a program's name means, and whether it is the instancer's."""
    kind, _, rest = name.removeprefix(PROPERTY_PREFIX).partition(":")
    return rest, kind + ":" == OF_INSTANCER


def property_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of properties among those of attributes, sorted."""
    return tuple(sorted({name for name in names if name.startswith(PROPERTY_PREFIX)}))


class ObjectProperties:
    """The values on one device."""

    def __init__(self, device: str) -> None:
        self._names: tuple[str, ...] = ()
        self._values: np.ndarray | None = None
        self._array = wp.zeros(1, dtype=wp.vec4, device=device)

    def update(self, names: tuple[str, ...], values: np.ndarray | None) -> bool:
        """Take in a table's properties; return whether any changed, hence what materials say.

        Args:
            names: As programs have them.
            values: float32 [names, N, 4], None without any.
        """
        same = names == self._names and (values is None if self._values is None else np.array_equal(
            self._values, values))
        if not same:
            self._names, self._values = names, values
            flat = np.zeros((1, 4), np.float32) if values is None or not values.size else values.reshape(-1, 4)
            self._array = overwrite(self._array, np.ascontiguousarray(flat))
        return not same

    def resolver(self, attribute_id: Callable[[str], int]) -> Callable[[str], int]:
        """Return what numbers names of properties, -1 for those not there, and leaves others to `attribute_id`."""
        names: Sequence[str] = self._names

        def number(name: str) -> int:
            if not name.startswith(PROPERTY_PREFIX):
                return attribute_id(name)
            return names.index(name) if name in names else -1

        return number

    def write(self, materials: Materials) -> None:
        """Hand the values over to kernels."""
        materials.properties = self._array
