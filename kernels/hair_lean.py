# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels that follow light through hair whose programs are all lean: hair_full.py's with half of the registers."""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .environment_split import EnvironmentSplit
from .gbuffer import GBuffer
from .hair_walk import HairWalks, begin_in_hair, met_strand, scatter
from .intersect import closest_hit
from .lamp_hit import FAR
from .list_order import first_dealt
from .node_strands import run_strand, strand_start
from .paths import ENDED, Paths, store_hit
from .reflection_rays import ReflectionRays
from .reflection_types import ReflectionOptions, ReflectionSamples
from .types import Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.kernel(cuda_max_registers=128)
def enter_lean_hair(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    split: EnvironmentSplit,
    emitters: wp.array[wp.uint64],
    options: ReflectionOptions,
    gbuffer: GBuffer,
    strands: int,
    # Out:
    samples_out: ReflectionSamples,
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
    lit_out: Paths,
    walks_out: HairWalks,
):
    """Scatter each ray in the strand that its pixel shows."""
    slot = first + wp.tid()
    point = begin_in_hair(
        views, scene, options, gbuffer, samples_out, rays_out, paths_out, vertices_out, lit_out, walks_out, slot)
    if point.instance >= 0:
        closure = run_strand(scene, point, strand_start(scene, point.material))
        scatter(
            scene, split, emitters, point, closure, 0, strands, walks_out, paths_out, lit_out, slot)


@wp.kernel(cuda_max_registers=128)
def scatter_in_lean_hair(
    # In:
    scene: Scene,
    split: EnvironmentSplit,
    emitters: wp.array[wp.uint64],
    strands: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    lit_out: Paths,
    walks_out: HairWalks,
):
    """Scatter listed rays in the strands that they have met."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        strand = paths_out.state[slot]
        if strand != ENDED:
            point = met_strand(scene, paths_out, slot)
            if point.instance >= 0:
                closure = run_strand(scene, point, strand_start(scene, point.material))
                scatter(
                    scene, split, emitters, point, closure, strand, strands, walks_out, paths_out, lit_out, slot)


@wp.kernel(cuda_max_registers=128)
def follow_lean_hair(
    # In:
    scene: Scene,
    split: EnvironmentSplit,
    emitters: wp.array[wp.uint64],
    strands: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    lit_out: Paths,
    walks_out: HairWalks,
):
    """Follow listed rays to their ends: few are left, and none waits for the longest one at each strand."""
    i = first_dealt(wp.tid(), stride)
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        strand = paths_out.state[slot]
        while strand != ENDED:
            store_hit(paths_out, slot, closest_hit(
                scene.geometry, paths_out.origin[slot], paths_out.direction[slot], FAR))
            point = met_strand(scene, paths_out, slot)
            if point.instance >= 0:
                closure = run_strand(scene, point, strand_start(scene, point.material))
                scatter(
                    scene, split, emitters, point, closure, strand, strands, walks_out, paths_out, lit_out, slot)
            strand = paths_out.state[slot]
