# SPDX-License-Identifier: GPL-3.0-or-later
"""The end of paths in the radiance cache: what a surface there throws back of the light that the cache knows."""

from __future__ import annotations

import warp as wp

from .geometry_math import mean_component
from .known_light import known_light, may_end, path_seed
from .packing import rgb
from .paths import Options, Paths, add_light, limit_at
from .reflectance import bsdf_albedo
from .types import Bsdf, Scene, ShadingPoint


@wp.func
def ends_in_cache(scene: Scene, options: Options, point: ShadingPoint, bsdf: Bsdf, paths: Paths, path: int) -> bool:
    """Add what the cache knows of a hit's reflected light and tell whether that was done.

    Not of what lets light through, nor of what mirrors more than it scatters: cells know no directions, and one side.
    """
    if not may_end(options.known, paths.index[path], point.ray_depth, paths.pdf[path]):
        return False
    if bsdf.pick_glass + bsdf.pick_translucent > 0.0:
        return False
    seed = path_seed(paths.seed[path], paths.index[path], point.ray_depth)
    light = known_light(options.known, point, paths.direction[path], seed)
    if light[3] == 0.0:
        return False
    albedo = bsdf_albedo(scene.tables, bsdf, point.wo)
    if mean_component(albedo.specular) > mean_component(albedo.diffuse):
        return False
    reflected = wp.cw_mul(albedo.diffuse + albedo.specular, rgb(light))
    add_light(paths, path, wp.cw_mul(paths.throughput[path], reflected), limit_at(options, point.ray_depth + 1))
    return True
