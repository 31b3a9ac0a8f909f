# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that notes in the G-buffer how much light surfaces scatter below, and how far.

Only scenes with such materials have it: their programs are run once more, so that no other scene's kernels know of it.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer
from .gbuffer_store import closure_number, stored_point
from .geometry_math import finite_or_zero, max_component
from .intersect import MISS
from .nodes import run
from .packing import pack_color, unpack_color, unpack_normal
from .reflection_types import fading
from .subsurface import medium_of, plane_albedo, scattered_share, spread_distance
from .types import MATERIAL_SUBSURFACE, Scene
from .view import View, pixel_footprint
from .wide_loads import load_material_flags

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Mean distance [px] up to which light comes out where it has gone in, as far as the picture shows, and the range over
# which all of it begins to be looked for elsewhere.
NARROW = wp.constant(0.5)
NARROW_RANGE = wp.constant(1.5)


@wp.kernel
def note_scattering(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    # Out:
    gbuffer_out: GBuffer,
):
    """Fill GBuffer.below of a frame whose other entries are there.

    Where light comes out within a pixel it is diffuse, of what a plane returns of it.
    """
    pixel = first + wp.tid()
    gbuffer_out.below[pixel] = wp.uint32(0)
    if gbuffer_out.hit[pixel][0] == MISS:
        return
    view = views[0]
    point = stored_point(view, scene, gbuffer_out, width, pixel)
    program = load_material_flags(scene.materials.materials, point.material)
    if (program[3] & MATERIAL_SUBSURFACE) == 0:
        return
    closure = run(scene, point, program[0], closure_number(view, width, pixel))
    share = scattered_share(closure)
    if not max_component(share) > 0.0:
        return
    seen = spread_distance(closure, medium_of(closure)) / pixel_footprint(view.camera, gbuffer_out.depth[pixel])
    normal = unpack_normal(gbuffer_out.normal[pixel])
    returned = plane_albedo(closure, normal, point.wo)
    diffuse = unpack_color(gbuffer_out.diffuse[pixel])
    for c in range(3):
        near = fading(seen[c], NARROW, NARROW_RANGE)
        whole = 1.0 - share[c] * near * (1.0 - returned[c])
        diffuse[c] = diffuse[c] * whole
        share[c] = share[c] * (1.0 - near) / whole
    gbuffer_out.below[pixel] = pack_color(finite_or_zero(share))
    gbuffer_out.diffuse[pixel] = pack_color(finite_or_zero(diffuse))
