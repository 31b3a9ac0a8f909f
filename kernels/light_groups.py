# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's light groups in the path tracer: a path's light by the group of the lamp, object or world it comes from.

As in light_split.py the kernels that add light know nothing of it: what a path has gathered before and after them is
compared. Between two looks light comes from one source: the world or the surface that is met; the light that a shadow
ray goes to. Lamps that rays meet are found once more, as misses.py finds them.
"""

from __future__ import annotations

import warp as wp

from .environment_table import sample_environment
from .geometry_math import is_finite3, max_component, power_heuristic
from .intersect import MISS, surface_point
from .lamp_hit import FAR
from .lamp_sample import LightSample, no_light, sample_lamp
from .lamp_tables import meet_lamp
from .light_linking import is_for, lamp_counts
from .light_tree import choose_by_tree
from .lights import choose_class, class_total, lamp_chance, sample_emitter
from .packing import rgb, rgba
from .path_shading import LIGHT_CANDIDATES, candidate_place
from .paths import ENDED, Options, Paths, clamp_light, limit_at, make_hit
from .sampling import (
    DIMENSION_FIRST_BOUNCE,
    DIMENSION_LIGHT,
    DIMENSION_LIGHT_CHOICE,
    DIMENSIONS_PER_BOUNCE,
    sample_number,
    sample_pair,
)
from .types import LIGHT_HITTABLE, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

NO_GROUP = wp.constant(-1)


@wp.struct
class GroupTables:
    """The group of everything that emits, NO_GROUP for none that is asked for."""

    lamps: wp.array[int]
    instances: wp.array[int]
    world: int


@wp.struct
class GroupLight:
    """What is kept of each path, one slot a path as in Paths."""

    light: wp.array2d[wp.vec3]
    """[group, path] gathered so far"""
    known: wp.array[wp.vec3]
    """The whole of what the path has gathered, as far as it has been told apart"""
    shadow_group: wp.array[int]
    """Of the light that its shadow ray goes to"""


@wp.struct
class FoundLight:
    """A light sample drawn again, and what it is of."""

    sample: LightSample
    group: int


@wp.func
def add_to_group(groups: GroupLight, group: int, path: int, light: wp.vec3):
    """Add to a path's light of a group; rounding may leave less than nothing."""
    if group != NO_GROUP and max_component(light) > 0.0:
        groups.light[group, path] = groups.light[group, path] + wp.max(light, wp.vec3(0.0, 0.0, 0.0))


@wp.func
def forget_groups(groups: GroupLight, path: int):
    """Take a path's light away from all groups."""
    group = int(0)
    while group < groups.light.shape[0]:
        groups.light[group, path] = wp.vec3(0.0, 0.0, 0.0)
        group = group + 1


@wp.kernel
def add_lamps_met(
    # In:
    scene: Scene,
    options: Options,
    tables: GroupTables,
    paths: Paths,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    groups_out: GroupLight,
):
    """Add the lamps that rays meet to their groups, see misses.gather_lamps; comes before that. Paths start here."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        bounce = paths.state[path]
        # Outside of a fisheye's circle they have ended before they started.
        if bounce == 0 or bounce == ENDED:
            forget_groups(groups_out, path)
        gathered = rgb(paths.radiance[path])
        t_max = paths.t[path]
        if paths.hit[path][0] == MISS:
            t_max = FAR
        lamp = int(0)
        while bounce != ENDED and lamp < scene.lights.lamp_count:
            visibility = scene.lights.lamps[lamp].visibility
            if (visibility & paths.kind[path]) != 0 and (scene.lights.lamps[lamp].flags & LIGHT_HITTABLE) != 0:
                hit = meet_lamp(scene.lights, lamp, paths.origin[path], paths.direction[path], t_max)
                if hit.t > 0.0 and lamp_counts(scene, visibility, bounce, paths, path):
                    weight = float(1.0)
                    if paths.pdf[path] > 0.0:
                        chance = lamp_chance(scene.lights, lamp, paths.origin[path], paths.side[path])
                        weight = power_heuristic(paths.pdf[path], hit.pdf * chance)
                    light = wp.cw_mul(paths.throughput[path], hit.radiance) * weight
                    if is_finite3(light):
                        light = clamp_light(light, limit_at(options, bounce))
                        gathered += light
                        add_to_group(groups_out, tables.lamps[lamp], path, light)
            lamp = lamp + 1
        groups_out.known[path] = gathered


@wp.func
def light_again(
    scene: Scene, tables: GroupTables, position: wp.vec3, normal: wp.vec3, u: wp.vec2, refill: float,
) -> FoundLight:
    """Draw a light sample once more, see lights.sample_light_of for the numbers; sample.kind -1 for none.

    Its pdf is not that of sample_light_of.
    """
    lights = scene.lights
    found = FoundLight()
    found.sample = no_light()
    found.group = NO_GROUP
    total = class_total(lights, normal)
    if total <= 0.0:
        return found
    choice = choose_class(lights, total, normal, u[0])
    chosen = choice.index
    left = choice.left
    if chosen == lights.environment_class:
        found.sample.kind = 0
        found.sample.wi = sample_environment(scene.environment, wp.vec2(left, u[1])).direction
        found.sample.distance = FAR
        found.group = tables.world
        return found
    lamp = lights.local_lamp_count + chosen - 1
    if chosen == 0:
        local = choose_by_tree(lights.tree, position, normal, wp.vec2(left, refill))
        lamp = local.entry
        left = local.left
    if lamp >= 0:
        if lamp < lights.lamp_count and (chosen > 0 or lamp < lights.local_lamp_count):
            found.sample = sample_lamp(lights.lamps[lamp], position, wp.vec2(left, u[1]))
            found.group = tables.lamps[lamp]
        else:
            found.sample = sample_emitter(scene, lamp - lights.local_lamp_count, position, wp.vec2(left, u[1]))
            found.group = tables.instances[found.sample.instance]
    return found


@wp.func
def shadow_light_group(scene: Scene, tables: GroupTables, paths: Paths, path: int, bounce: int) -> int:
    """Return the group of the light that a path's shadow ray goes to.

    The light samples are drawn once more with their numbers (see path_shading.sample_direct_light), for a surface
    without a back and for both of its sides: where shading normals lean away, light from behind may count. The one kept
    is that where the shadow ray ends. A path that has met no surface has been scattered by a medium, without sides.
    """
    seed = paths.seed[path]
    index = paths.index[path]
    dimension = DIMENSION_FIRST_BOUNCE + bounce * DIMENSIONS_PER_BOUNCE
    place = sample_pair(seed, index, dimension + DIMENSION_LIGHT)
    refill = sample_number(seed, index, dimension + DIMENSION_LIGHT_CHOICE)
    direction = paths.shadow_direction[path]
    distance = wp.abs(paths.shadow_distance[path])
    position = paths.shadow_origin[path]
    normal = wp.vec3(0.0, 0.0, 0.0)
    scattered = paths.hit[path][0] == MISS
    if not scattered:
        point = surface_point(scene, make_hit(0.0, paths.hit[path], paths.barycentrics[path]), -direction)
        position = point.position
        normal = point.normal
    group = int(NO_GROUP)
    nearest = float(FAR)
    k = int(0)
    while k < 3 * LIGHT_CANDIDATES:
        side = normal * float(k % 3 - 1)
        found = light_again(
            scene, tables, position, side,
            candidate_place(place, float(k // 3), LIGHT_CANDIDATES), refill)
        s = found.sample
        # Lights for other objects may lie in the same place.
        known = s.kind >= 0
        if known and not scattered:
            known = is_for(scene, s.visibility, paths.hit[path][0])
        if known and (s.distance >= FAR) == (distance >= FAR):
            off = s.wi - direction
            if distance < FAR:
                off = (position + s.wi * s.distance - paths.shadow_origin[path]) / distance - direction
            if wp.length_sq(off) < nearest:
                nearest = wp.length_sq(off)
                group = found.group
        k = k + 1
    return group


@wp.kernel
def add_surface_met(
    # In:
    scene: Scene,
    tables: GroupTables,
    paths: Paths,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    groups_out: GroupLight,
):
    """Add what the surface or the world that rays meet shines to its group; comes after shading.

    Find the group of the light that shadow rays go to.
    """
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        gathered = rgb(paths.radiance[path])
        known = groups_out.known[path]
        met = gathered - known
        hit = paths.hit[path]
        if max_component(known) > 0.0 and not max_component(gathered) > 0.0:
            # A holdout hides the lamps in front of it too.
            forget_groups(groups_out, path)
        elif hit[0] == MISS:
            add_to_group(groups_out, tables.world, path, met)
        else:
            add_to_group(groups_out, tables.instances[hit[0]], path, met)
        groups_out.known[path] = gathered
        if paths.shadow_distance[path] != 0.0:
            groups_out.shadow_group[path] = shadow_light_group(scene, tables, paths, path, bounces[0])


@wp.kernel
def note_exit_lights(
    # In:
    scene: Scene,
    tables: GroupTables,
    paths: Paths,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    groups_out: GroupLight,
):
    """Find the group of the light that shadow rays go to from where paths come out of surfaces."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        groups_out.known[path] = rgb(paths.radiance[path])
        if paths.shadow_distance[path] != 0.0:
            groups_out.shadow_group[path] = shadow_light_group(scene, tables, paths, path, bounces[0])


@wp.kernel
def add_shadow_light_met(
    # In:
    paths: Paths,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    groups_out: GroupLight,
):
    """Add what shadow rays have brought to the group of their light; comes when all have been traced."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        brought = rgb(paths.radiance[path]) - groups_out.known[path]
        if max_component(brought) > 0.0:
            add_to_group(groups_out, groups_out.shadow_group[path], path, brought)


@wp.kernel
def accumulate_group(
    # In:
    paths: Paths,
    groups: GroupLight,
    group: int,
    exposure: float,
    first_pixel: int,
    pixel_count: int,
    sample_count: int,
    # Out:
    sum_out: wp.array[wp.vec4],
):
    """Add one group's light of the finished paths of each pixel to its sum; w counts the samples."""
    local = wp.tid()
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for sample in range(sample_count):
        path = sample * pixel_count + local
        if is_finite3(rgb(paths.radiance[path])):
            total += rgba(groups.light[group, path] * exposure, 1.0)
    sum_out[first_pixel + local] = sum_out[first_pixel + local] + total


@wp.kernel
def resolve_group(
    first: int,
    # In:
    sum: wp.array[wp.vec4],
    # Out:
    picture_out: wp.array[wp.vec3],
):
    """Divide a group's sum by its samples."""
    pixel = first + wp.tid()
    picture_out[pixel] = rgb(sum[pixel]) / wp.max(sum[pixel][3], 1.0)
