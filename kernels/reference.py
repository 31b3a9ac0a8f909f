# SPDX-License-Identifier: GPL-3.0-or-later
"""The reference path tracer's shading of the hits that need the full node machine.

The tracer is a wavefront of small kernels with states in arrays (paths.py) between them: tracing.py finds hits,
layers.py looks through transparent triangles, misses.py adds the world and lamps, reference_lean.py shades most hits
and reference_plain.py those on plain glass, materials.py runs the other materials' programs, this file's kernel shades
those (reference_film.py's where any has a thin film), and shadow_layers.py and shadow_lights.py finish shadow rays. A
path owns its slot in every array, so any range of paths may run anywhere in any order. The node machine is called once
in each module that needs it: CUDA's compiler then inlines it, instead of copying the whole Scene for a call.
"""

from __future__ import annotations

import warp as wp

from .layering import prepare_under_film
from .list_order import first_listed
from .path_shading import is_held_out, shade_hit
from .paths import ENDED, Options, Paths, has_hit, hit_point
from .types import Bsdf, FrameData, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def without_film(bsdf: Bsdf) -> Bsdf:
    """Return a BSDF without a thin film, which it has none of anyway: compilers leave out its code then."""
    out = bsdf
    out.film_thickness = 0.0
    return out


@wp.kernel
def shade_paths(
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
    """Shade listed hits whose closures are known, see path_shading.shade_hit, and list the paths that go on."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            point = hit_point(scene, paths_out, path, paths_out.state[path])
            paths_out.state[path] = ENDED
            if not is_held_out(scene, point, paths_out, path):
                bsdf = without_film(prepare_under_film(scene.tables, paths_out.closure[path], point, 0.0))
                shade_hit(frames[0], scene, options, point, bsdf, paths_out, path)
                if paths_out.state[path] != ENDED:
                    queue_out[wp.atomic_add(count_out, 0, 1)] = path
