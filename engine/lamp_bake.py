# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the table of a lamp whose node tree varies, as fine as the tree asks for."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels import lamp_tables as layout
from ..kernels import types
from ..kernels.lamp_bake import LampTable, bake_lamp
from .device import launch_bands
from .lamp_needs import Needs, lamp_axes, widest_angle
from .materials import single_program
from .scene import LightData, LightKind

__all__ = ["BakedLamp", "bake", "distance_grid"]

WIDTH_FIRST = 64
"""Texels across the coarsest picture"""

TOLERANCE = 2e-3
"""Mean error of a picture, of its mean, with which it is fine enough"""

POINTS, POINTS_MIXED = 4, 64
"""Evaluated in each texel; the second where the mean is taken over what the table isn't over"""

DISTANCE_WIDTH = 16
"""Texels across the pictures that are made for each distance"""

LOG_RANGE = 100.0
"""Largest logarithm to the base of 2 of a factor of distance"""

FAR = 1.0e18
"""Distance of suns [m], as the kernels have it"""


@dataclass(eq=False)
class BakedLamp:
    """What a lamp's program emits."""

    kind: int
    """TABLE_* of kernels/lamp_tables.py"""
    scale: float
    """Of the pictures' projection"""
    mean: np.ndarray
    """float64 [3], of the light that leaves the lamp"""
    texels: np.ndarray | None
    """float32 [pictures, width, width, 3], over the mean, bottom row first; None: all the same"""
    distances: np.ndarray | None
    """float64 [DISTANCE_COUNT, 3], logarithms to the base of 2 of a factor; None: distance doesn't count"""
    product_error: float = 0.0
    """Largest error of a factor of distance times one of the rest, of the largest value"""


def distance_grid() -> np.ndarray:
    """Return the distances of a table [m]."""
    steps = np.arange(int(layout.DISTANCE_COUNT)) / float(layout.DISTANCE_STEPS)
    return 2.0 ** (float(layout.DISTANCE_FIRST) + steps)


@dataclass(eq=False)
class _Oven:
    """Runs one lamp's program over tables."""

    light: LightData
    row: np.void
    needs: Needs
    scene: types.Scene
    image_index: Callable[[Hashable], int]
    device: str

    def __post_init__(self) -> None:
        """Put the program and the lamp on the device."""
        matrix = np.asarray(self.light.transform, np.float64)
        position = tuple(float(x) for x in matrix[:3, 3])
        self._lone = types.Scene()
        self._lone.materials, self._start = single_program(self.light.program, self.image_index, position, self.device)
        geometry = types.Geometry()
        geometry.instances = wp.array(_lamp_instance(matrix), dtype=types.Instance, device=self.device)
        self._lone.geometry = geometry
        self._lone.textures = self.scene.textures
        self._lone.luminance = self.scene.luminance
        self._light = types.Light()
        for name in self.row.dtype.names:
            value = self.row[name]
            setattr(self._light, name, wp.vec3(*map(float, value)) if value.ndim else value.item())
        self._light.position = wp.vec3(*position)
        self.axes = lamp_axes(self.light)
        self.angle = widest_angle(self.light, self.needs.kind)
        self.pictures = 2 if self.angle is None else 1

    def scale(self, width: int) -> float:
        """Return the projection's scale: a sphere's two pictures overlap by a texel."""
        return 1.0 - 3.0 / width if self.angle is None else 1.0 / math.tan(0.5 * self.angle)

    def colors(self, width: int, points: int, distances: np.ndarray) -> np.ndarray:
        """Return what is emitted: float64 [distances, pictures, width, width, 3], bottom row first."""
        table = LampTable()
        table.kind, table.width, table.height, table.pictures = self.needs.kind, width, width, self.pictures
        table.scale, table.points, table.start = self.scale(width), points, self._start
        table.x, table.y, table.z = (wp.vec3(*map(float, axis)) for axis in self.axes)
        if self.light.kind == LightKind.SPOT:
            table.across = 0.5 / math.tan(0.5 * min(max(self.light.spot_size, 1e-4), math.pi - 1e-4))
        elif self.light.kind == LightKind.SUN and self.light.angle > 0.0:
            table.across = 0.5 / math.sin(0.25 * self.light.angle)
        count = len(distances) * self.pictures * width * width
        at = wp.array(distances.astype(np.float32), dtype=float, device=self.device)
        out = wp.zeros(count, dtype=wp.vec3, device=self.device)
        launch_bands(bake_lamp, 0, count, [self._lone, self._light, table, at], [out])
        return out.numpy().astype(np.float64).reshape(len(distances), self.pictures, width, width, 3)

    def weights(self, width: int) -> np.ndarray:
        """Return how much each texel counts for the lamp's power: float64 [pictures, width, width], sums to 1."""
        x = (np.arange(width) + 0.5) / width * 2.0 - 1.0
        x, y = np.meshgrid(x, x)
        if self.needs.kind == layout.TABLE_PLACE:
            round_lamp = self.light.shape in ("DISK", "ELLIPSE")
            weights = (x * x + y * y <= 1.0).astype(np.float64) if round_lamp else np.ones_like(x)
        else:
            r2 = (x * x + y * y) / self.scale(width) ** 2
            cosine = (1.0 - r2) / (1.0 + r2)
            weights = (1.0 + r2) ** -2.0 * (cosine >= (0.0 if self.angle is None else math.cos(self.angle)))
            if self.light.kind == LightKind.AREA:
                weights *= np.maximum(cosine, 0.0)
            elif self.light.kind == LightKind.SPOT and self.angle is not None:
                inside = np.clip((cosine - self.row["spot_cos"]) * self.row["spot_smooth"], 0.0, 1.0)
                weights *= inside * inside * (3.0 - 2.0 * inside)
        total = max(float(weights.sum()), 1e-30) * self.pictures
        return np.repeat(weights[None] / total, self.pictures, 0)


def bake(
    light: LightData, row: np.void, needs: Needs, scene: types.Scene, image_index: Callable[[Hashable], int],
    width_max: int, device: str,
) -> BakedLamp:
    """Return the table of a lamp's program.

    Args:
        light: The lamp.
        row: As from lamps.lamp_array.
        needs: What its program depends on.
        scene: Whose images the program reads.
        image_index: Returns the texture of an image key.
        width_max: Texels across the finest picture.
        device: Where to run it.
    """
    oven = _Oven(light, row, needs, scene, image_index, device)
    at, distances, error = 1.0, None, 0.0
    if light.kind == LightKind.SUN:
        at = FAR
    elif needs.distance:
        at, distances, error = _distances(oven)
    points = POINTS_MIXED if needs.mixed else POINTS
    width = min(WIDTH_FIRST, width_max)
    colors = oven.colors(width, points, np.array([at]))[0]
    varies = bool((np.ptp(colors, axis=(0, 1, 2)) > 1e-5 * max(float(colors.max()), 1e-30)).any())
    while varies and width < width_max:
        coarse, width = colors, 2 * width
        colors = oven.colors(width, points, np.array([at]))[0]
        weights = oven.weights(width)[..., None]
        if (weights * np.abs(colors - _doubled(coarse))).sum() <= TOLERANCE * (weights * colors).sum():
            break
    mean = (oven.weights(width)[..., None] * colors).sum((0, 1, 2))
    texels = (colors / np.where(mean > 0.0, mean, 1.0)).astype(np.float32) if varies else None
    return BakedLamp(needs.kind, oven.scale(width), mean, texels, distances, error)


def _distances(oven: _Oven) -> tuple[float, np.ndarray, float]:
    """Return the distance [m] to make the picture for, the logarithms of what the others are to it, and the error."""
    grid = distance_grid()
    colors = oven.colors(DISTANCE_WIDTH, POINTS, grid)
    means = colors.mean((1, 2, 3))
    best = int(np.argmax(means.sum(1)))
    ratio = np.where(means[best] > 0.0, means / np.where(means[best] > 0.0, means[best], 1.0), 1.0)
    product = colors[best][None] * ratio[:, None, None, None]
    # Each distance's error by itself: those far away may be brighter by far.
    largest = np.maximum(colors.max((1, 2, 3, 4)), 1e-30)
    error = float((np.abs(product - colors).max((1, 2, 3, 4)) / largest).max())
    return float(grid[best]), np.clip(np.log2(np.maximum(ratio, 1e-30)), -LOG_RANGE, LOG_RANGE), error


def _doubled(colors: np.ndarray) -> np.ndarray:
    """Return pictures [n, width, width, 3] twice as fine, as a bilinear look-up has them."""
    for axis in (1, 2):
        moved = np.moveaxis(colors, axis, 0)
        before, after = np.concatenate([moved[:1], moved[:-1]]), np.concatenate([moved[1:], moved[-1:]])
        both = np.stack([0.75 * moved + 0.25 * before, 0.75 * moved + 0.25 * after], 1)
        colors = np.moveaxis(both.reshape(-1, *moved.shape[1:]), 0, axis)
    return colors


def _lamp_instance(matrix: np.ndarray) -> np.ndarray:
    """Return the row of an instance that stands where the lamp does, relative to its own place."""
    row = np.zeros(1, types.Instance.numpy_dtype())
    linear = np.eye(4)
    linear[:3, :3] = matrix[:3, :3]
    row["to_world"] = linear
    row["to_object"] = np.linalg.inv(linear) if abs(np.linalg.det(linear)) > 1e-30 else np.linalg.pinv(linear)
    # Generated coordinates are those of the object.
    row["generated_location"], row["generated_size"] = 0.5, 0.5
    return row
