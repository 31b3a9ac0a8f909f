# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of the path tracer that run the programs of the materials that paths have hit, and shade hair."""

from __future__ import annotations

from ...kernels import materials, materials_exact, materials_hair, reference_hair, reference_hair_lean
from ...kernels.types import Scene
from .wavefront import Step, Wavefront

__all__ = ["evaluate_step", "full_steps"]


def evaluate_step(slot: Wavefront, scene: Scene, over: str = "living", *, hair: bool = True) -> Step:
    """Return what finds the closures of the hits of a list's paths, by programs that say more where there are any.

    `hair`: whether hair that scatters light may be among the hits.
    """
    kernel = materials_exact.evaluate_exact_materials if slot.programs.exact else materials.evaluate_materials
    if hair and slot.programs.hair:
        kernel = materials_hair.evaluate_hair_materials
    return Step(kernel, [scene], over=over)


def full_steps(slot: Wavefront, scene: Scene, shading: list) -> tuple[list[Step], str]:
    """Return what finds the closures of "full_hits" and shades hair among them, and the list of what is left to shade.

    `shading`: as of reference.path_steps.
    """
    if not slot.programs.hair:
        return [evaluate_step(slot, scene, "full_hits")], "full_hits"
    lists = {"over": "full_hits", "fills": ("next", "other_hits")}
    if slot.programs.lean_strands:
        return [Step(reference_hair_lean.shade_lean_hair_paths, shading, **lists),
                evaluate_step(slot, scene, "other_hits", hair=False)], "other_hits"
    return [evaluate_step(slot, scene, "full_hits"),
            Step(reference_hair.shade_hair_paths, shading, **lists)], "other_hits"
