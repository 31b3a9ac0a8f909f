# SPDX-License-Identifier: GPL-3.0-or-later
"""The reference path tracer's shading of most hits: those whose materials the lean node machine runs.

Program, BSDF, light sample and next ray in one kernel: nothing of the closure goes through memory, and what a lean
closure lacks (glass, coat, sheen, thin walls) is no code.
"""

from __future__ import annotations

import warp as wp

from .list_order import first_listed
from .node_lean import lean_bsdf, run_lean
from .path_shading import is_held_out, shade_hit
from .paths import ENDED, Options, Paths, has_hit, hit_point
from .types import MATERIAL_LEAN, MATERIAL_SUBSURFACE, FrameData, Scene
from .wide_loads import load_material_flags

# On the processor functions are inlined whatever their size: a call copies the array descriptors of scene and paths,
# five kilobytes, for every hit (a tenth of a sample's time).
wp.set_module_options({
    "enable_backward": False, "default_grid_stride": False, "fast_math": True,
    "cpu_compiler_flags": "-march=native -mllvm=-inline-threshold=200000 -mllvm=-slp-recursion-max-depth=4"})


@wp.func
def shade_path(frames: wp.array[FrameData], scene: Scene, options: Options, paths: Paths, path: int) -> bool:
    """Shade a hit with a lean material and return whether the path goes on; leave others alone."""
    paths.shadow_distance[path] = 0.0
    if not has_hit(paths, path):
        return False
    point = hit_point(scene, paths, path, paths.state[path])
    starts = load_material_flags(scene.materials.materials, point.material)
    if (starts[3] & (MATERIAL_LEAN | MATERIAL_SUBSURFACE)) != MATERIAL_LEAN:
        return False
    paths.state[path] = ENDED
    if is_held_out(scene, point, paths, path):
        return False
    bsdf = lean_bsdf(scene.tables, run_lean(scene, point, starts[0]), point)
    shade_hit(frames[0], scene, options, point, bsdf, paths, path)
    return paths.state[path] != ENDED


@wp.kernel(cuda_max_registers=168)
def shade_lean_paths(
    # In:
    frames: wp.array[FrameData],
    scene: Scene,
    options: Options,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Shade the hits of listed paths that the lean machine can shade, and list the paths that go on.

    Other paths do not end here, but have no shadow ray after it.
    """
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if shade_path(frames, scene, options, paths_out, path):
            queue_out[wp.atomic_add(count_out, 0, 1)] = path
