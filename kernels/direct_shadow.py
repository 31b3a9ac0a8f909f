# SPDX-License-Identifier: GPL-3.0-or-later
"""The thin kernels of each pixel's shadow ray: tracing opaque triangles, and what is left for programs of lights.

Where the scene has triangles that need a test, tracing.trace_shadow_layers and shadow_layers.py go on after the first;
after the second shadow_lights.py runs the programs of lights. Knows no lights and no materials.
"""

from __future__ import annotations

import warp as wp

from .direct_reservoir import UNTRACED, Shadows
from .intersect import any_hit
from .packing import rgba, to_half
from .paths import PENDING_NONE, Paths
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def trace_direct_shadows(
    # In:
    first: int,
    scene: Scene,
    # Out:
    rays_out: Paths,
):
    """Set the distance of blocked shadow rays to 0; below 0 it says that the light casts no shadow."""
    pixel = first + wp.tid()
    distance = rays_out.shadow_distance[pixel]
    if distance > 0.0:
        if any_hit(scene.geometry, rays_out.shadow_origin[pixel], rays_out.shadow_direction[pixel], distance):
            rays_out.shadow_distance[pixel] = 0.0


@wp.kernel
def finish_shadows(
    # In:
    first: int,
    # Out:
    rays_out: Paths,
    shadows_out: Shadows,
):
    """Store what the shadow rays found, and leave those rays waiting whose light is a program.

    Pixels without a shadow ray need their light's radiance too.
    """
    pixel = first + wp.tid()
    distance = rays_out.shadow_distance[pixel]
    seen = wp.vec3(0.0, 0.0, 0.0)
    if distance != 0.0:
        seen = rays_out.shadow_light[pixel]
    shadows_out.visibility[pixel] = to_half(rgba(seen, 1.0))
    program = int(shadows_out.program[pixel])
    pending = program & (UNTRACED - 1)
    rays_out.radiance[pixel] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    rays_out.shadow_light[pixel] = wp.vec3(1.0, 1.0, 1.0)
    rays_out.shadow_pending[pixel] = pending
    if (program & UNTRACED) != 0 and pending != PENDING_NONE:
        # No ray: any distance will do.
        rays_out.shadow_distance[pixel] = -1.0
