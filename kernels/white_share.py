# SPDX-License-Identifier: GPL-3.0-or-later
"""Which share of a white surrounding's light a white Principled BSDF returns.

Its layers are Cycles', which pass on what a table says that the layer above leaves: with the default IOR, of roughness
0.5 they keep 0.9986 of the light, which takes 2.7 % of it away in a closed room of albedo 0.95.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import mean_component, safe_sqrt
from .node_lean import LeanClosure, lean_surface
from .shading_types import ShadingPoint
from .types import Tables

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def measure_white_shares(
    first: int,
    # In:
    tables: Tables,
    lean: LeanClosure,
    views: int,
    # Out:
    share_out: wp.array[float],
):
    """Write the albedo for each of `views` views, which are spread by the cosine: their mean is that of all light."""
    i = first + wp.tid()
    cosine = wp.sqrt((float(i) + 0.5) / float(views))
    up = wp.vec3(0.0, 0.0, 1.0)
    point = ShadingPoint()
    point.wo = wp.vec3(safe_sqrt(1.0 - cosine * cosine), 0.0, cosine)
    point.normal = up
    point.geometric_normal = up
    albedo = lean_surface(tables, lean, point).albedo
    share_out[i] = mean_component(albedo.diffuse + albedo.specular)
