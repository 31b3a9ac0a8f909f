# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of the path tracer that run the programs of the materials that paths have hit, and shade hair."""

from __future__ import annotations

from ...kernels import materials, materials_exact, materials_hair, reference_hair
from ...kernels.types import Scene
from .wavefront import Step, Wavefront

__all__ = ["evaluate_step", "hair_steps"]


def evaluate_step(slot: Wavefront, scene: Scene, over: str = "living") -> Step:
    """Return what finds the closures of the hits of a list's paths, by programs that say more where there are any."""
    kernel = materials_exact.evaluate_exact_materials if slot.exact else materials.evaluate_materials
    if slot.hair:
        kernel = materials_hair.evaluate_hair_materials
    return Step(kernel, [scene], over=over)


def hair_steps(slot: Wavefront, shading: list) -> tuple[list[Step], str]:
    """Return what shades hits on hair that scatters light, whose closures are known, and the list of what is left.

    `shading`: as of reference.path_steps.
    """
    if not slot.hair:
        return [], "full_hits"
    step = Step(reference_hair.shade_hair_paths, shading, over="full_hits", fills=("next", "other_hits"))
    return [step], "other_hits"
