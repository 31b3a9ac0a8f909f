# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel for what rays meet besides surfaces: lamps and the world; and for paths that end at hits."""

from __future__ import annotations

import warp as wp

from .clear_paths import pane_length
from .environment_table import environment_pdf
from .geometry_math import power_heuristic
from .intersect import MISS, may_emit, triangle_material
from .lamp_hit import FAR
from .lamp_tables import meet_lamp
from .light_linking import lamp_counts, met_by_rays
from .lights import environment_chance, lamp_chance
from .list_order import first_listed
from .nodes import evaluate_world
from .path_guides import light_before, show_light
from .paths import ENDED, Options, Paths, add_light, limit_at, survives
from .types import LIGHT_HITTABLE, MATERIAL_LEAN, MATERIAL_PLAIN, MATERIAL_SUBSURFACE, Scene
from .wide_loads import load_material_flags

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def gather_lamps(scene: Scene, options: Options, paths: Paths, path: int):
    """Add the lamps that the ray meets before its hit; lamps hide nothing."""
    direction = paths.direction[path]
    bounce = paths.state[path]
    pdf = paths.pdf[path]
    t_max = paths.t[path]
    if paths.hit[path][0] == MISS:
        t_max = FAR
    # What lies before the panes has been met by then.
    before = pane_length(scene, paths, path)
    origin = paths.origin[path] - direction * before
    t_max = t_max + before
    for i in range(scene.lights.lamp_count):
        flags = scene.lights.lamps[i].flags
        visibility = scene.lights.lamps[i].visibility
        if (flags & LIGHT_HITTABLE) != 0 and (visibility & paths.kind[path]) != 0 and met_by_rays(
                scene, visibility, pdf):
            hit = meet_lamp(scene.lights, i, origin, direction, t_max)
            if hit.t > before and lamp_counts(scene, visibility, bounce, paths, path):
                weight = float(1.0)
                if pdf > 0.0:
                    weight = power_heuristic(pdf, hit.pdf * lamp_chance(scene.lights, i, origin, paths.side[path]))
                light = wp.cw_mul(paths.throughput[path], hit.radiance) * weight
                add_light(paths, path, light, limit_at(options, bounce))


@wp.func
def add_world(scene: Scene, options: Options, paths: Paths, path: int, bounce: int):
    """Add the world to a path that leaves the scene."""
    kind = paths.kind[path]
    direction = paths.direction[path]
    if bounce == 0 and options.transparent == 1:
        r = paths.radiance[path]
        paths.radiance[path] = wp.vec4(r[0], r[1], r[2], 0.0)
        return
    if (scene.environment.visibility & kind) == 0:
        return
    radiance = scene.environment.radiance
    if scene.environment.constant == 0:
        # Filtered for the camera alone: light sampling sees the world unfiltered, and both must agree.
        radiance = evaluate_world(scene, direction, kind, bounce, wp.where(bounce == 0, paths.cone[path][1], 0.0))
    weight = float(1.0)
    pdf = paths.pdf[path]
    if pdf > 0.0 and scene.lights.environment_class >= 0:
        light_pdf = environment_pdf(scene.environment, direction)
        weight = power_heuristic(pdf, light_pdf * environment_chance(scene, paths.side[path]))
    add_light(paths, path, wp.cw_mul(paths.throughput[path], radiance) * weight, limit_at(options, bounce))
    if options.passes == 1 and bounce == 0:
        paths.environment[path] = radiance


@wp.func
def list_hit(
    scene: Scene, options: Options, paths: Paths, path: int, bounce: int, plain: wp.array[int],
    plain_count: wp.array[int], full: wp.array[int], full_count: wp.array[int],
):
    """Play roulette at a hit that does not emit; list the path if it goes on and its material is not lean; atomic.

    Lean materials' kernel looks for its paths itself; lists are of plain materials and of those that need the full
    machine.
    """
    hit = paths.hit[path]
    material = triangle_material(scene, hit[0], hit[1])
    if not may_emit(scene, material):
        if not survives(options, paths, path, bounce):
            return
    flags = load_material_flags(scene.materials.materials, material)[3]
    if (flags & (MATERIAL_LEAN | MATERIAL_SUBSURFACE)) == MATERIAL_LEAN:
        return
    if (flags & (MATERIAL_PLAIN | MATERIAL_SUBSURFACE)) == MATERIAL_PLAIN:
        plain[wp.atomic_add(plain_count, 0, 1)] = path
    else:
        full[wp.atomic_add(full_count, 0, 1)] = path


@wp.kernel(cuda_max_registers=128)
def shade_misses(
    # In:
    scene: Scene,
    options: Options,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    plain_out: wp.array[int],
    plain_count_out: wp.array[int],
    full_out: wp.array[int],
    full_count_out: wp.array[int],
):
    """Add the lamps that rays meet, add the world to the paths that leave the scene and end them, play roulette.

    Not yet where the hit may emit: shade_hit adds that first. List the hits whose materials are not lean, plain ones
    apart.
    """
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        bounce = paths_out.state[path]
        if bounce != ENDED:
            before = light_before(paths_out, path)
            if scene.lights.lamp_count > 0:
                gather_lamps(scene, options, paths_out, path)
            hit = paths_out.hit[path]
            if hit[0] == MISS:
                add_world(scene, options, paths_out, path, bounce)
                paths_out.state[path] = ENDED
                show_light(options.exposure, paths_out, path, bounce, before)
            else:
                list_hit(
                    scene, options, paths_out, path, bounce, plain_out, plain_count_out, full_out, full_count_out)
