# SPDX-License-Identifier: GPL-3.0-or-later
"""The shadow rays of the path tracer: which kernels find what stands in their way, by what the scene has."""

from __future__ import annotations

from dataclasses import replace

import warp as wp

from ...kernels import (
    clear_tracing,
    decided_instances,
    decided_layers,
    flat_paths,
    path_lists,
    shadow_layers,
    shadow_layers_lean,
    shadow_lights,
    tracing,
)
from ...kernels.paths import Options
from ...kernels.types import Scene
from ..clear_glass import passes_glass
from ..structures import decides_layers, is_flat, without_opaque
from .wavefront import Step, Wavefront

__all__ = ["shadow_steps", "shadows_may_wait"]


def shadow_steps(
    slot: Wavefront, scene: Scene, options: Options, over: str = "living", layered: str = "layered_shadows",
    late: bool = False,
) -> list[Step]:
    """Return what traces the shadow rays of the paths of a list and adds their light.

    Args:
        slot: States of the paths.
        scene: The device scene.
        options: Settings for the kernels.
        over: The list.
        layered: List for those that transparent triangles stand in the way of, empty so far.
        late: Whether they are traced in the next round, see shadows_may_wait().
    """
    rounds = slot.late_rounds if late else slot.rounds
    shadows, steps, between = [scene, options, rounds], [], scene
    if passes_glass(scene):
        if len(slot.paths.clear_way) < slot.capacity:
            slot.paths.clear_way = wp.zeros(slot.capacity, dtype=wp.vec4, device=slot.device)
        dim = clear_tracing.dim_flat_path_shadows if is_flat(scene) else clear_tracing.dim_path_shadows
        steps.append(Step(dim, [scene], over))
        between = without_opaque(scene)
    among = [between, options, rounds]
    if options.filtered == 1 and decides_layers(scene):
        trace = (decided_layers.trace_decided_shadows if is_flat(scene)
                 else decided_instances.trace_all_decided_shadows)
        steps.append(Step(trace, among, over))
    elif is_flat(scene):
        steps.append(Step(flat_paths.trace_flat_path_shadows, among, over, fills=(layered,)))
    else:
        steps.append(Step(tracing.trace_shadows, among, over))
        if options.filtered == 1:
            steps += [Step(tracing.trace_shadow_layers, among, over),
                      Step(path_lists.list_layered_shadows, [slot.paths], over, fills=(layered,), changes=False)]
    if options.filtered == 1 and not decides_layers(scene):
        weaken = shadow_layers_lean.weaken_shadow_rays_lean if options.lean_layers else shadow_layers.weaken_shadow_rays
        steps.append(Step(weaken, shadows, layered))
    if options.programs == 1:
        steps.append(Step(shadow_lights.shade_lights, shadows, over))
    return [replace(step, late=late) for step in steps]


def shadows_may_wait(slot: Wavefront, scene: Scene, options: Options) -> bool:
    """Return whether shadow rays may be traced beside the next round's rays: whether nothing between asks for them.

    Layers that need lists of their own are counted with those that the next rays meet.
    """
    asks = slot.light or slot.media or slot.catching or options.passes == 1 or options.subsurface == 1
    return not asks and (options.filtered == 0 or decides_layers(scene))
