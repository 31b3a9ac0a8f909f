# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that follows final gather rays further where the radiance cache would be too coarse to end them.

A cell's light is a mean over its size. Far off that is as good as the light itself; seen from near by it would lighten
corners, shelves and the space below a bed by what is around them. So rays that end nearer than a few cells go on, as
in photon mapping (Jensen 2001, section 9.3: secondary final gather): by chance such a hit brings either its direct
light, found by its own shadow ray, or one more ray's.
"""

from __future__ import annotations

import warp as wp

from .cache_materials import sane
from .cache_rays import Vertices, cell_seed
from .geometry_math import INV_PI, max_component, to_frame
from .hash_grid import HashGrid, cell_level, cell_size
from .intersect import offset_origin
from .lamp_hit import FAR
from .packing import rgb, unpack_normal
from .paths import Paths
from .reflection_rays import (
    DIMENSION_DIRECTION,
    DIMENSION_LOBE,
    DIMENSIONS,
    FOUND_DIRECT,
    FOUND_HIT,
    FOUND_NONE,
    FOUND_WHOLE_HIT,
    ReflectionRays,
)
from .sampling import sample_cosine, sample_pair
from .types import VISIBLE_DIFFUSE
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Sizes of a cell from which on the cache answers.
NEAR_CELLS = wp.constant(2.0)

# Chance with which a near hit brings its direct light.
DIRECT_CHANCE = wp.constant(0.5)


@wp.kernel
def follow_near_hits(
    first: int,
    # In:
    views: wp.array[View],
    grid: HashGrid,
    surfaces: int,
    # Out:
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Send rays on, by a cosine-distributed direction, from hits that have just been found; `surfaces` met so far."""
    slot = first + wp.tid()
    r = vertices_out.reflectance[slot]
    if not max_component(rgb(r)) > 0.0 or rays_out.found[slot] != FOUND_WHOLE_HIT:
        return
    view = views[0]
    p = vertices_out.position[slot]
    t = paths_out.t[slot]
    size = cell_size(cell_level(grid, view, rgb(p), cell_seed(slot, view.frame)))
    rays_out.found[slot] = FOUND_HIT
    if t > NEAR_CELLS * size:
        return
    seed = paths_out.seed[slot]
    index = paths_out.index[slot]
    choice = sample_pair(seed, index, DIMENSION_LOBE + DIMENSIONS * surfaces)
    if choice[0] < DIRECT_CHANCE:
        rays_out.found[slot] = FOUND_DIRECT
        vertices_out.reflectance[slot] = wp.vec4(
            r[0] / DIRECT_CHANCE, r[1] / DIRECT_CHANCE, r[2] / DIRECT_CHANCE, r[3])
        return
    rays_out.found[slot] = FOUND_NONE
    vertices_out.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    side = unpack_normal(vertices_out.geometric_normal[slot])
    normal = unpack_normal(vertices_out.normal[slot])
    share = 1.0 - r[3]
    if choice[1] >= share:
        side = -side
        normal = -normal
        share = 1.0 - share
    local = sample_cosine(sample_pair(seed, index, DIMENSION_DIRECTION + DIMENSIONS * surfaces))
    direction = wp.normalize(to_frame(normal, local))
    if not wp.dot(direction, side) > 0.0:
        # Below the triangle: absorbed.
        return
    paths_out.state[slot] = surfaces + 1
    paths_out.origin[slot] = offset_origin(rgb(p), side, p[3], direction)
    paths_out.direction[slot] = direction
    paths_out.t[slot] = FAR
    paths_out.kind[slot] = VISIBLE_DIFFUSE
    paths_out.throughput[slot] = sane(wp.cw_mul(paths_out.throughput[slot], rgb(r)) / (1.0 - DIRECT_CHANCE))
    paths_out.pdf[slot] = wp.min(paths_out.pdf[slot], wp.max(local[2] * share * INV_PI, 1.0e-6))
    cone = paths_out.cone[slot]
    paths_out.cone[slot] = wp.vec2(cone[0] + cone[1] * t, cone[1])
