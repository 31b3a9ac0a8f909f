# SPDX-License-Identifier: GPL-3.0-or-later
"""The world's sampling table, baked from its program by a kernel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from ..kernels import node_codes, types
from ..kernels.environment import bake_environment
from .device import launch, load_module, run_bands
from .program import Program
from .scene import Visibility, WorldData

__all__ = ["build_environment", "no_environment", "texel_chances"]

# Share of directions drawn uniformly: texels that the table thinks black may not be quite.
UNIFORM_SHARE = 0.05

# Directions evaluated for each texel.
POINTS = 4


def no_environment(device: str, world: WorldData | None = None) -> types.Environment:
    """Return the struct of a world without a table; None is black."""
    environment = types.Environment()
    environment.probability = wp.zeros(1, dtype=float, device=device)
    environment.alias = wp.zeros(1, dtype=int, device=device)
    environment.rows = wp.zeros(1, dtype=float, device=device)
    environment.columns = wp.zeros(1, dtype=float, device=device)
    environment.weight = wp.zeros(1, dtype=float, device=device)
    constant = (0.0, 0.0, 0.0) if world is None else world.constant
    environment.constant = 0 if constant is None else 1
    environment.radiance = wp.vec3(*(constant or (0.0, 0.0, 0.0)))
    environment.visibility = 31 if world is None else world.visibility
    return environment


def running_sums(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the running sums by which texels are drawn.

    Args:
        weights: float64 [h, w], not negative, not all zero.

    Returns:
        float32 [h]: of the rows; float32 [h, w]: of each row's texels, ending at 1.
    """
    by_row = weights.sum(1)
    rows = np.cumsum(by_row / by_row.sum()).astype(np.float32)
    columns = np.cumsum(weights / np.maximum(by_row, 1e-300)[:, None], 1).astype(np.float32)
    rows[-1] = columns[:, -1] = 1.0
    return rows, columns


def texel_chances(environment: types.Environment) -> np.ndarray:
    """Return the probability of each texel of the table: float64 [h, w]. Waits for the device."""
    columns = environment.columns.numpy().astype(np.float64).reshape(environment.height, environment.width)
    rows = environment.rows.numpy().astype(np.float64)
    return np.diff(columns, prepend=0.0, axis=1) * np.diff(rows, prepend=0.0)[:, None]


def build_environment(
    scene: types.Scene, world: WorldData | None, device: str,
    assemble: Callable[[types.Environment, float], types.Scene],
) -> wp.array:
    """Bake the table of a world that varies; a constant world needs none.

    Args:
        scene: The scene so far.
        world: None is black.
        device: Where to bake.
        assemble: Takes the struct and the world's radiance integrated over the sphere into the scene.

    Returns:
        Mean radiance of each texel, vec3; only one entry where the world is constant or not the same for all rays.
    """
    environment = no_environment(device, world)
    if environment.constant == 1:
        assemble(environment, float(np.mean(np.array(environment.radiance, np.float64))) * 4.0 * np.pi)
        return wp.zeros(1, dtype=wp.vec3, device=device)
    scene = assemble(environment, 0.0)
    width = max(int(world.importance_resolution), 4)
    height = max(width // 2, 2)
    importance = wp.zeros(width * height, dtype=float, device=device)
    radiance = wp.zeros(width * height, dtype=wp.vec3, device=device)
    if wp.get_device(device).is_cuda:
        launch(bake_environment, width * height, [scene, width, height, 0, POINTS], [importance, radiance], device)
    else:
        load_module(bake_environment.module.name, device)
        rows = np.linspace(0, height, 17).astype(int)

        def bake(low: int, high: int) -> Callable[[], None]:
            return lambda: launch(
                bake_environment, (high - low) * width, [scene, width, height, low * width, POINTS],
                [importance, radiance], device)

        run_bands(bake(low, high) for low, high in zip(rows[:-1], rows[1:], strict=True) if high > low)
    values = np.nan_to_num(importance.numpy().astype(np.float64))
    theta = np.pi * (np.arange(height) + 0.5) / height
    integral = values.sum() * (2.0 * np.pi / width) * (np.pi / height)
    uniform = np.repeat(np.sin(theta), width)
    total = values.sum()
    weights = UNIFORM_SHARE * uniform / uniform.sum()
    weights += (1.0 - UNIFORM_SHARE) * (values / total if total > 0 else uniform / uniform.sum())
    rows, columns = running_sums(weights.reshape(height, width))
    environment.width, environment.height = width, height
    environment.rows = wp.array(rows, dtype=float, device=device)
    environment.columns = wp.array(columns.ravel(), dtype=float, device=device)
    assemble(environment, float(integral))
    return radiance if _is_same_for_all(world.program) else wp.zeros(1, dtype=wp.vec3, device=device)


def _is_same_for_all(program: Program) -> bool:
    """Return whether a world's program depends on nothing but the direction, for rays that aren't the camera's.

    No camera ray takes a texel's mean, and the table is baked for rays of no kind.
    """
    inputs = [(head >> 16 & 255, mask) for head, _, mask, _ in program.surface if head & 255 == node_codes.OP_INPUT]
    of_path = tuple(int(code) for code in (
        node_codes.INPUT_RAY_LENGTH, node_codes.INPUT_RAY_DEPTH, node_codes.INPUT_KIND_DEPTH))
    return not program.uses_camera and not any(
        kind in of_path or kind == int(node_codes.INPUT_RAY_KIND) and mask != int(Visibility.CAMERA)
        for kind, mask in inputs)
