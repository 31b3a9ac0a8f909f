# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel for rays that leave the scene, and for the paths that end where they hit."""

from __future__ import annotations

import warp as wp

from .environment_table import environment_pdf
from .geometry_math import power_heuristic
from .intersect import MISS, may_emit, triangle_material
from .lights import environment_chance
from .nodes import evaluate_world
from .paths import ENDED, Options, Paths, add_light, limit_at, survives
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def shade_misses(
    # In:
    scene: Scene,
    options: Options,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Add the world to the paths that leave the scene, which shade_paths ends, and play roulette with the others.

    Not yet where the hit may emit: shade_paths adds that first.
    """
    path = queue[wp.tid()]
    bounce = paths_out.state[path]
    if bounce == ENDED:
        return
    if paths_out.hit[path][0] != MISS:
        hit = paths_out.hit[path]
        if not may_emit(scene, triangle_material(scene, hit[0], hit[1])):
            survives(options, paths_out, path, bounce)
        return
    kind = paths_out.kind[path]
    direction = paths_out.direction[path]
    if bounce == 0 and options.transparent == 1:
        r = paths_out.radiance[path]
        paths_out.radiance[path] = wp.vec4(r[0], r[1], r[2], 0.0)
        return
    if (scene.environment.visibility & kind) == 0:
        return
    radiance = scene.environment.radiance
    if scene.environment.constant == 0:
        # Filtered for the camera alone: light sampling sees the world unfiltered, and both must agree.
        radiance = evaluate_world(scene, direction, kind, bounce, wp.where(bounce == 0, paths_out.cone[path][1], 0.0))
    weight = float(1.0)
    pdf = paths_out.pdf[path]
    if pdf > 0.0 and scene.lights.environment_class >= 0:
        light_pdf = environment_pdf(scene.environment, direction)
        weight = power_heuristic(pdf, light_pdf * environment_chance(scene, paths_out.side[path]))
    light = wp.cw_mul(paths_out.throughput[path], radiance) * weight
    add_light(paths_out, path, light, limit_at(options, bounce))
    if options.passes == 1 and bounce == 0:
        paths_out.environment[path] = radiance
