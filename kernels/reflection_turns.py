# SPDX-License-Identifier: GPL-3.0-or-later
"""Which blocks do without a reflection sample while only the camera moves: their means do for them."""

from __future__ import annotations

import warp as wp

from .camera_motion import only_camera_moves
from .gbuffer import GBuffer, SurfaceMaterial, load_surface
from .geometry_math import max_component
from .long_mean import pixel_before, unpack_mean
from .packed_halves import unpack_halves
from .reflection_blocks import ReflectionHistory, filter_roughness, light_strength
from .reflection_types import LOBE_TRANSMISSION, ReflectionOptions, through_albedo
from .reprojection import Reprojection
from .view import View, pixel_of, project
from .wide_loads import load_previous_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Samples in a pixel's mean from which on its block may wait.
WAITING_FRAMES = wp.constant(4.0)
# Standard error of the mean, as a share of all light that the pixel shows, up to which it may.
EVEN = wp.constant(0.1)
# Roughness from which it may: what mirrors show moves, and changes, from frame to frame.
ROUGHNESS = wp.constant(0.1)


@wp.func
def has_turn(view: View, options: ReflectionOptions, block: int) -> bool:
    """Return whether a block has a sample even if it may wait: every other row, until all its pixels had theirs.

    Blocks of a row are in the same warps.
    """
    return ((block // options.columns + view.frame // (options.stride * options.stride)) & 1) == 0


@wp.func
def leaves_turn_out(
    views: wp.array[View], view: View, options: ReflectionOptions, gbuffer: GBuffer, history: ReflectionHistory,
    matte: wp.array[wp.uint64], block: int, pixel: int, m: SurfaceMaterial,
) -> bool:
    """Return whether a block has no sample in a frame, as the reflection at its pixel is known, rough and even.

    Reprojection runs at the same time: where the surface was is found anew, by the camera's motion alone. Where it has
    just come into view the mean of what hid it may be taken for its own, in one frame.

    Args:
        views: One element.
        view: The same without the camera of the frame before.
        options: Of the pass.
        gbuffer: Of this frame.
        history: Of the frame before; without elements: no means are kept.
        matte: CompositePass.matte of the frame before.
        block: The block.
        pixel: That of its pixels that would be sampled.
        m: Material there.
    """
    if options.half_rate == 0 or history.state.shape[0] == 0 or not only_camera_moves(view):
        return False
    if has_turn(view, options, block) or filter_roughness(options, m) < ROUGHNESS:
        return False
    both = load_previous_view(views)
    place = project(both.previous, load_surface(both, gbuffer, options.width, pixel).position)
    before = pixel_of(both.previous, both.jitter, place, options.width, options.height)
    if before < 0:
        return False
    state = unpack_halves(history.state[before])
    if not state[0] >= WAITING_FRAMES:
        return False
    albedo = max_component(wp.where(options.lobe == LOBE_TRANSMISSION, through_albedo(m), m.specular))
    shown = max_component(m.diffuse) * light_strength(unpack_mean(matte[before])) + albedo * state[1]
    error = albedo * state[2]
    return error * error <= EVEN * EVEN * shown * shown * state[0]


@wp.func
def is_known(
    options: ReflectionOptions, history: ReflectionHistory, reprojection: Reprojection, pixel: int,
) -> bool:
    """Return whether a pixel has a mean that does for it while its block waits."""
    before = pixel_before(reprojection, pixel, options.width)
    if before < 0:
        return False
    return unpack_halves(history.state[before])[0] >= WAITING_FRAMES
