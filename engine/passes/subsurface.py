# SPDX-License-Identifier: GPL-3.0-or-later
"""Host side of scattering below surfaces in the path tracer: the steps of a round that scenes with it have beside.

Paths that go below a surface walk there and come out in the same round, and are lit where they do.
"""

from __future__ import annotations

from ...kernels import reference_subsurface, subsurface_walk
from ...kernels.paths import Options
from ...kernels.types import Scene
from .material_steps import evaluate_step
from .shadow_steps import shadow_steps
from .wavefront import Step, Wavefront

__all__ = ["below_step", "exit_steps"]


def below_step(shading: list, over: str) -> Step:
    """Return what shades a list's hits and lists the paths that go below the surface.

    `shading`: as of reference.path_steps.
    """
    return Step(reference_subsurface.shade_scattering_paths, shading, over, fills=("next", "below"))


def exit_steps(slot: Wavefront, scene: Scene, options: Options) -> list[Step]:
    """Return what walks below surfaces and lights paths where they come out; comes after the other shadow rays."""
    steps = [Step(subsurface_walk.walk_below, [scene, slot.rounds], over="below", fills=("exits",))]
    if options.subsurface_bump == 1:
        steps.append(evaluate_step(slot, scene, "exits"))
    steps.append(Step(
        reference_subsurface.shade_exits, [scene, options.subsurface_bump, slot.rounds], over="exits", fills=("next",)))
    if slot.light:
        steps += slot.light.steps_before_exit_shadows(scene, slot.rounds)
    if slot.media:
        steps += slot.media.shadow_steps(slot, scene, options, "exits")
    else:
        steps += shadow_steps(slot, scene, options, "exits", "layered_exits")
    return steps + slot.light.steps_after_exit_shadows(slot.rounds) if slot.light else steps
