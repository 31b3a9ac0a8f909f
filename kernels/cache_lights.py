# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache's kernel that chooses a light for every hit: next-event estimation over all lights of the scene."""

from __future__ import annotations

import warp as wp

from .cache_highlights import highlight_excess, is_glossy, shows_highlights
from .cache_rays import DIMENSION_LIGHT, DIMENSION_PLACE, UNWATCHED, Vertices, is_near, slot_seed
from .environment_table import has_texels, texel_of
from .geometry_math import INV_PI, is_finite3, max_component, power_heuristic
from .hash_grid import NO_CELL, HashGrid
from .intersect import surface_point
from .lamp_sample import LightSample
from .light_linking import is_linked, kinds_lit
from .lights import cell_side, sample_light
from .moved_ways import shadow_mark
from .packing import unpack_normal
from .path_shading import set_shadow_ray
from .paths import PENDING_NONE, PENDING_WORLD, Paths, has_hit, load_hit
from .sampling import hash_combine, hashed_unit, sample_number, sample_pair
from .types import LIGHT_TRIANGLE, VISIBLE_DIFFUSE, Scene, ShadingPoint
from .view import View
from .wide_loads import load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


# Share of the hits in cells that know their direct light which look for a light nevertheless: a cell's mean is of as
# many samples, over more frames.
WATCHED_SHARE = wp.constant(0.25)
STREAM_WATCH = wp.constant(wp.uint32(0x57415443))


@wp.func
def watched_share(grid: HashGrid, view: View, vertices: Vertices, slot: int, known_from: float) -> float:
    """Return the share of such hits that look for a light: few where the cell knows enough, else all.

    Hits nearer than a cell take their own light (cache_shade.cached_light), very glossy ones show it.
    """
    cell = vertices.cell[slot]
    if cell == NO_CELL or view.rest > 0:
        return 1.0
    if grid.direct[cell][3] < known_from:
        return 1.0
    if is_glossy(vertices, slot) or is_near(grid, view, vertices, slot):
        return 1.0
    return WATCHED_SHARE


@wp.func
def settle_world(scene: Scene, world: wp.array[wp.vec3], paths: Paths, slot: int):
    """Give a shadow ray towards the world the light of its texel, where that is known: no program has to be run.

    The table has chosen the direction for just that light.
    """
    if has_texels(world) and paths.shadow_distance[slot] != 0.0 and paths.shadow_pending[slot] == PENDING_WORLD:
        light = wp.cw_mul(
            paths.shadow_light[slot], world[texel_of(scene.environment, paths.shadow_direction[slot])])
        paths.shadow_light[slot] = light
        paths.shadow_pending[slot] = PENDING_NONE
        if not max_component(light) > 0.0:
            paths.shadow_distance[slot] = 0.0


@wp.func
def density_of(normal: wp.vec3, behind: float, wi: wp.vec3) -> float:
    """Return the density that turns radiance from a direction into irradiance / pi; by the shares of both sides."""
    cosine = wp.dot(normal, wi)
    return wp.abs(cosine) * INV_PI * wp.where(cosine > 0.0, 1.0 - behind, behind)


@wp.func
def sampled_density(normal: wp.vec3, behind: float, weighed: int, s: LightSample) -> float:
    """Return density_of a light sample; `weighed` 1: less what rays bring of triangles' emission."""
    density = density_of(normal, behind, s.wi)
    if weighed == 1 and s.kind == LIGHT_TRIANGLE and not is_linked(s.visibility):
        density = density * power_heuristic(s.pdf, density)
    return density


@wp.func
def send_to_light(
    scene: Scene, world: wp.array[wp.vec3], ways: wp.array[wp.vec3], point: ShadingPoint, s: LightSample,
    light: wp.vec3, paths: Paths, slot: int,
):
    """Set up the shadow ray of a hit's light sample, which carries so much light; `ways`: of HashGrid."""
    if is_finite3(light) and max_component(light) > 0.0:
        set_shadow_ray(scene, point, s, light, paths, slot)
        settle_world(scene, world, paths, slot)
        if paths.shadow_distance[slot] != 0.0:
            # For count_rays and accumulate_light.
            paths.radiance[slot] = wp.vec4(0.0, 0.0, 0.0, shadow_mark(ways, paths, slot))


@wp.kernel
def choose_cache_lights(
    first: int,
    # In:
    views: wp.array[View],
    scene: Scene,
    world: wp.array[wp.vec3],
    grid: HashGrid,
    known_from: float,
    # Out:
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Sample one light at every hit and set up its shadow ray, which carries irradiance / pi.

    Translucent surfaces get the light of both sides by their shares, as the cell's light is read for both at once.
    With grid.weighed bounce rays bring their share of the emission of triangles, see cache_materials.py. Cells that
    have `known_from` samples get a light for few of their hits. Vertices.highlight tells what a hit's lobe makes of it.
    """
    slot = first + wp.tid()
    paths_out.shadow_distance[slot] = 0.0
    paths_out.radiance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if not has_hit(paths_out, slot) or scene.lights.class_count == 0:
        return
    reflectance = vertices_out.reflectance[slot]
    if not wp.max(reflectance[0], wp.max(reflectance[1], reflectance[2])) > 0.0:
        # Black: whatever arrives is lost. The cell is not told anything either.
        return
    view = load_view(views)
    watched = watched_share(grid, view, vertices_out, slot, known_from)
    if watched < hashed_unit(hash_combine(slot_seed(slot), STREAM_WATCH), wp.uint32(view.frame)):
        paths_out.radiance[slot] = wp.vec4(0.0, 0.0, 0.0, UNWATCHED)
        return
    point = surface_point(scene, load_hit(paths_out, slot), paths_out.direction[slot])
    normal = unpack_normal(vertices_out.normal[slot])
    seed = slot_seed(slot)
    index = wp.uint32(view.frame)
    s = sample_light(
        scene, point.position, cell_side(normal, reflectance[3], grid.weighed),
        sample_pair(seed, index, DIMENSION_LIGHT), sample_number(seed, index, DIMENSION_PLACE))
    if s.kind < 0:
        return
    kinds = kinds_lit(scene, s.visibility, point.instance)
    if (kinds & VISIBLE_DIFFUSE) == 0:
        return
    density = sampled_density(normal, reflectance[3], grid.weighed, s)
    send_to_light(scene, world, grid.ways, point, s, s.radiance * (density / s.pdf), paths_out, slot)
    if paths_out.shadow_distance[slot] != 0.0 and shows_highlights(vertices_out):
        word = vertices_out.lobe[slot]
        if word != wp.uint64(0):
            whole = density_of(normal, reflectance[3], s.wi)
            excess = highlight_excess(scene.tables, word, point, normal, s, kinds, whole)
            # Of all that are not watched, too.
            vertices_out.highlight[slot] = excess / watched
