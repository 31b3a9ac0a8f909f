# SPDX-License-Identifier: GPL-3.0-or-later
"""The step of the path tracer that runs the programs of the materials that paths have hit."""

from __future__ import annotations

from ...kernels import materials, materials_exact
from ...kernels.types import Scene
from .wavefront import Step, Wavefront

__all__ = ["evaluate_step"]


def evaluate_step(slot: Wavefront, scene: Scene, over: str = "living") -> Step:
    """Return what finds the closures of the hits of a list's paths, by exact programs where the scene has any."""
    kernel = materials_exact.evaluate_exact_materials if slot.exact else materials.evaluate_materials
    return Step(kernel, [scene], over=over)
