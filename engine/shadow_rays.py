# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow rays outside of the path tracer: their states and options."""

from __future__ import annotations

import warp as wp

from ..kernels.paths import Options, Paths
from ..kernels.shading_types import Closure

__all__ = ["make_options", "make_shadow_rays"]

RAY = {"shadow_origin": wp.vec3, "shadow_direction": wp.vec3, "shadow_distance": float}
"""What every shadow ray has"""

EXTRA = {
    "shadow_light": wp.vec3, "shadow_pending": int, "shadow_emitter": wp.vec2i, "shadow_barycentrics": wp.vec2,
    "radiance": wp.vec4,
}
"""For rays whose light is weakened by layers or comes from a program"""

LAYERS = {"layer_t": float, "layer": wp.vec2i, "layer_barycentrics": wp.vec2, "overruns": int}
"""For rays that may meet triangles that need a test"""

CONE = {"cone": wp.vec2}
"""For programs of emissive triangles; zero: textures unfiltered"""

UNUSED = {
    "state": int, "seed": wp.uint32, "index": wp.uint32, "origin": wp.vec3, "direction": wp.vec3, "t": float,
    "hit": wp.vec2i, "barycentrics": wp.vec2, "throughput": wp.vec3, "pdf": float, "kind": int, "receiver": int,
    "closure": Closure, "surface_normal": wp.vec4, "surface_position": wp.vec4, "surface_uv": wp.vec4,
    "surface_emission": wp.vec3, "environment": wp.vec3,
}


def make_shadow_rays(count: int, device: str, *, layers: bool, programs: bool) -> Paths:
    """Return path states with room for `count` shadow rays; arrays that stay unused have one element.

    Args:
        count: Number of rays.
        device: Where to put them.
        layers: Whether triangles that need a test may be in the way.
        programs: Whether lights may be programs.
    """
    paths = Paths()
    groups = (
        (RAY, count), (EXTRA, count if layers or programs else 1), (LAYERS, count if layers else 1),
        (CONE, count if programs else 1), (UNUSED, 1))
    for arrays, size in groups:
        for name, dtype in arrays.items():
            setattr(paths, name, wp.zeros(size, dtype=dtype, device=device))
    return paths


def make_options(*, filtered: bool) -> Options:
    """Return options that clamp nothing."""
    options = Options()
    options.exposure = 1.0
    options.filtered = int(filtered)
    options.programs = 1
    return options
