# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that take samples into the fog's cells, between which light goes on.

Each cell has a ray in a frame. What fog does along it is found once, with some places that stand for all where it
scatters light (`link_cells`); the cells at these are asked again and again while light spreads (`spread_fog`).
"""

from __future__ import annotations

import warp as wp

from .fog import MOMENTS, Fog, cell_width, cells_a_grid, scattered_light
from .fog_blend import factor_of
from .fog_passage import link_fog
from .froxels import FroxelOptions, has_changed
from .geometry_math import TWO_PI, is_finite3, to_frame
from .intersect import MISS, closest_hit
from .lamp_hit import FAR
from .packing import rgb, rgba
from .paths import Paths
from .probe_rays import MISS_DISTANCE, ProbeRays
from .sampling import hash_combine, hashed_unit, pixel_seed_of
from .types import VISIBLE_DIFFUSE, Scene
from .view import View, eye_position

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

STREAM = wp.constant(0x464F4743)
LINKS = wp.constant(4)
"""Of a cell: its ray, and three others that have equal angles with it and each other, along which fog is looked at.
Of light that prefers a direction no more than a cosine does these four have the very mean: noise of directions is
multiplied each time that light is scattered on, so that most cells would lose what a few gain"""
BESIDE = wp.constant(0.94280904)
"""Sine of the angle between them"""
CELL_FRAMES = wp.constant(64.0)
CELL_CHANGED = wp.constant(4.0)
"""Most frames in a cell's means: as a rule, and where something but the camera has just moved or light changed"""
CELL_GROWTH = wp.constant(6.0)
"""See fog_blend.GROWTH"""


mat34 = wp.types.matrix((3, 4), float)
"""Of each channel what a cell keeps of light"""


@wp.struct
class FogLinks:
    """What fog is along the rays of cells, LINKS a cell."""

    place: wp.array[wp.vec4]
    """One place where light is scattered; w = mean cosine of that"""
    weight: wp.array[wp.vec4]
    """Of what is scattered there, in rgb"""
    light: wp.array[wp.vec4]
    """What fog emits, unexposed, in rgb"""
    direction: wp.array[wp.vec4]
    """Of the ray in xyz"""


@wp.kernel
def open_cells(
    first: int,
    # In:
    views: wp.array[View],
    options: FroxelOptions,
    place: wp.array[wp.vec4],
    # Out:
    fog_out: Fog,
    weight_out: wp.array[float],
):
    """Find the weight of this frame's samples in each cell's means; those that know nothing start with black."""
    cell = first + wp.tid()
    slot = options.columns * options.rows * options.slices + cell
    weight_out[cell] = 0.0
    if place[slot][3] == 0.0:
        return
    most = wp.where(has_changed(views[0]), CELL_CHANGED, CELL_FRAMES)
    count = wp.min(fog_out.count[cell], most - 1.0)
    if count == 0.0:
        for word in range(MOMENTS):
            fog_out.light[cell * MOMENTS + word] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    weight_out[cell] = CELL_GROWTH / (count + CELL_GROWTH)
    fog_out.count[cell] = count + 1.0


@wp.kernel(cuda_max_registers=128)
def link_cells(
    first: int,
    # In:
    views: wp.array[View],
    scene: Scene,
    fog: Fog,
    answers: ProbeRays,
    weight: wp.array[float],
    # Out:
    links_out: FogLinks,
):
    """Find what fog is along the cells' rays, and where one of its places is that scatter light, one thread a link."""
    index = first + wp.tid()
    cell = index // LINKS
    number = index - cell * LINKS
    links_out.weight[index] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if weight[cell] == 0.0:
        return
    view = views[0]
    ray = fog.first_ray + cell
    origin = answers.origin[ray]
    direction = answers.direction[ray]
    length = answers.radiance[ray][3]
    if number > 0:
        turn = hashed_unit(hash_combine(pixel_seed_of(cell, 1, STREAM), wp.uint32(view.frame)), wp.uint32(0))
        angle = TWO_PI * (turn + float(number) / 3.0)
        direction = wp.normalize(to_frame(direction, wp.vec3(
            wp.cos(angle) * BESIDE, wp.sin(angle) * BESIDE, -1.0 / 3.0)))
        hit = closest_hit(scene.geometry, origin, direction, FAR)
        length = wp.where(hit.instance == MISS, MISS_DISTANCE, hit.t)
    length = wp.where(length < MISS_DISTANCE, length, FAR)
    link = link_fog(
        scene, fog, origin, direction, length, VISIBLE_DIFFUSE,
        cell_width(fog, cell // cells_a_grid(fog)), True,
        hash_combine(pixel_seed_of(index, 0, STREAM), wp.uint32(view.frame)))
    links_out.place[index] = rgba(link.place, link.anisotropy)
    links_out.weight[index] = rgba(link.weight, 0.0)
    links_out.light[index] = rgba(link.light, 0.0)
    links_out.direction[index] = rgba(direction, 0.0)


@wp.func
def link_light(fog: Fog, eye: wp.vec3, links: FogLinks, link: int, seed: wp.uint32) -> wp.vec3:
    """Return what comes from the fog along a link, unexposed."""
    light = rgb(links.light[link])
    share = rgb(links.weight[link])
    if wp.length_sq(share) > 0.0:
        place = links.place[link]
        anisotropy = wp.where(fog.even == 1, 0.0, place[3])
        scattered = scattered_light(fog, eye, rgb(place), rgb(links.direction[link]), anisotropy, 1, seed)
        light = light + wp.cw_mul(share, scattered)
    return light


@wp.func
def weighed(direction: wp.vec3) -> wp.vec4:
    """Return what a cell keeps of unit light from a direction."""
    return wp.vec4(1.0, direction[0], direction[1], direction[2])


@wp.kernel
def spread_fog(
    first: int,
    # In:
    views: wp.array[View],
    fog: Fog,
    options: FroxelOptions,
    sweep: int,
    rays: Paths,
    answers: ProbeRays,
    links: FogLinks,
    light: wp.array[wp.vec4],
    weight: wp.array[float],
    before: wp.array[wp.vec4],
    # Out:
    light_out: wp.array[wp.vec4],
):
    """Take the samples of cells into their means, and what their rays bring: of surfaces, and of fog on the way.

    The latter is asked of the cells as the sweep before has left them (`fog`), so that light goes on from cell to cell
    within a frame; `before` is what they were at its begin.
    """
    cell = first + wp.tid()
    view = views[0]
    slot = options.columns * options.rows * options.slices + cell
    newest = weight[cell]
    direct = wp.vec3(0.0, 0.0, 0.0)
    around = mat34()
    to_light = rays.shadow_direction[slot]
    if newest > 0.0:
        ray = fog.first_ray + cell
        eye = eye_position(view.camera)
        direct = wp.cw_mul(rgb(light[slot]), factor_of(rays, slot))
        seed = hash_combine(pixel_seed_of(cell, sweep, STREAM), wp.uint32(view.frame))
        # What comes from the ray's end is dimmed by fog already.
        surface = rgb(answers.radiance[ray]) / wp.max(view.exposure, 1.0e-20)
        around = wp.outer(surface, weighed(answers.direction[ray]))
        if fog.even == 1:
            # Another each time: along the same ways again and again light would grow by more than over their mean.
            link = cell * LINKS + int(hash_combine(seed, wp.uint32(LINKS)) % wp.uint32(LINKS))
            found = link_light(fog, eye, links, link, seed)
            around = around + wp.outer(found, weighed(rgb(links.direction[link])))
        else:
            for k in range(LINKS):
                link = cell * LINKS + k
                found = link_light(fog, eye, links, link, hash_combine(seed, wp.uint32(k)))
                around = around + wp.outer(found / float(LINKS), weighed(rgb(links.direction[link])))
        brought = wp.vec3(around[0][0], around[1][0], around[2][0])
        if not (is_finite3(direct) and is_finite3(brought)):
            newest = 0.0
    for c in range(3):
        known = before[cell * MOMENTS + c]
        light_out[cell * MOMENTS + c] = known + (weighed(to_light) * direct[c] - known) * newest
        known = before[cell * MOMENTS + 3 + c]
        moments = wp.vec4(around[c, 0], around[c, 1], around[c, 2], around[c, 3])
        light_out[cell * MOMENTS + 3 + c] = known + (moments - known) * newest
