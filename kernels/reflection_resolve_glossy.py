# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that puts together what reflection rays bring in scenes where their hits may show highlights."""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .geometry_math import max_component
from .hash_grid import HashGrid
from .packing import rgb
from .paths import Paths
from .reflection_highlights import is_mirrored, lobe_albedo
from .reflection_rays import FOUND_SCREEN, ReflectionRays, ray_count
from .reflection_resolve import hit_light, store_sample
from .reflection_types import ReflectionOptions, ReflectionSamples
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.kernel
def resolve_glossy_reflections(
    # In:
    first: int,
    views: wp.array[View],
    options: ReflectionOptions,
    grid: HashGrid,
    own_light: int,
    jitter: int,
    paths: Paths,
    vertices: Vertices,
    # Out:
    rays_out: ReflectionRays,
    samples_out: ReflectionSamples,
):
    """Do what resolve_reflections does; a hit's lobe takes the light sample instead of the matte direct light.

    What the frame before shows of a hit has all of its light as matte light; its sample carries the difference.
    """
    slot = first + wp.tid()
    if slot >= ray_count(rays_out, options.columns * options.rows):
        return
    view = views[0]
    light = rgb(vertices.emission[slot])
    reflectance = rgb(vertices.reflectance[slot])
    sampled = rgb(paths.radiance[slot])
    if max_component(sampled) > 0.0:
        sampled = sampled * rays_out.highlight[slot]
    if max_component(reflectance) > 0.0:
        arriving = hit_light(view, grid, paths, vertices, rays_out, slot, own_light, jitter)
        reflected = wp.cw_mul(reflectance, arriving.direct + arriving.indirect)
        word = rays_out.lobe[slot]
        if word != wp.uint64(0):
            counted = arriving.direct
            if is_mirrored(word):
                counted = wp.vec3(0.0, 0.0, 0.0)
            reflected = reflected + wp.cw_mul(lobe_albedo(word), sampled - counted)
        light = light + wp.cw_mul(paths.throughput[slot], reflected)
    elif rays_out.found[slot] == FOUND_SCREEN:
        light = light + wp.cw_mul(paths.throughput[slot], wp.cw_mul(lobe_albedo(rays_out.lobe[slot]), sampled))
    store_sample(view, options, paths, vertices, rays_out, samples_out, slot, light)
