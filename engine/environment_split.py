# SPDX-License-Identifier: GPL-3.0-or-later
"""Splits the world's light: what probes gather, and suns and windows that are sampled as lights.

Probes send 64 rays over the hemisphere and would turn a sun of half a degree into sparks; light above a threshold is
therefore sampled directly (kernels/environment_split.py). The threshold follows from the world's sampling table.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels import types
from ..kernels.environment_split import NO_THRESHOLD, EnvironmentSplit
from ..kernels.lamp_hit import FAR
from ..kernels.paths import PENDING_WORLD
from ..kernels.shadow_lights import shade_lights
from ..kernels.world_split import aim_at_texels, cut_texels, measure_texels
from .alias_table import build_alias_table
from .device import launch, launch_bands, run_bands
from .environment import UNIFORM_SHARE, no_environment, texel_chances
from .shadow_rays import make_options, make_shadow_rays
from .work_list import ONCE, make_queue, one_number

__all__ = ["no_split", "split_environment"]

THRESHOLD_RATIO = 4.0
"""Threshold over the mean luminance of the soft part: 64 rays average that much contrast away"""

LEAST_SHARE = 0.01
"""Of the excess in all light, below which it is left to the probes"""

SUSPECT_RATIO = 2.0
"""A texel is looked at closely where its mean, or a neighbour's, is above the threshold over this"""

CLOSE_LOOKS = 1 << 19
"""Directions evaluated in all suspect texels together"""

POINTS_MAX = 40
"""Points a side at which a texel is looked at: a sun of half a degree covers some hundred of them"""

CHUNK = 1 << 18
"""Directions evaluated at once"""

PRECISION = 1e-9
"""Relative change of the threshold that ends its search"""


def no_split(device: str) -> EnvironmentSplit:
    """Return the split of a world without excess."""
    split = EnvironmentSplit()
    split.threshold = float(NO_THRESHOLD)
    split.table = no_environment(device)
    split.points = 1
    split.excess = wp.zeros(1, dtype=wp.vec3, device=device)
    split.box = wp.zeros(1, dtype=wp.uint32, device=device)
    return split


def split_environment(scene: types.Scene, device: str) -> EnvironmentSplit:
    """Choose the threshold and bake the table of the excess; call it when the world or its images change.

    Args:
        scene: With its environment built.
        device: Where to put the table.
    """
    environment = scene.environment
    if environment.constant == 1 or environment.width == 0:
        return no_split(device)
    width, height = environment.width, environment.height
    sin_theta = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    solid_angle = np.broadcast_to(sin_theta[:, None], (height, width)) / (sin_theta.sum() * width)
    mean = _relative_radiance(environment, solid_angle)
    suspects, points = _suspects(mean, solid_angle)
    if len(suspects) == 0:
        return no_split(device)
    radiance = _look_closely(scene, suspects, points, device)
    spots = solid_angle.ravel()[suspects]
    # The table knows brightness up to a factor; the close look gives it (of the largest channel, as there).
    peaks = wp.empty(len(suspects), dtype=float, device=device)
    launch_bands(measure_texels, 0, len(suspects), [points, radiance], [peaks])
    scale = (peaks.numpy().astype(np.float64) @ spots) / max(mean.ravel()[suspects] @ spots, 1e-30)
    mean = mean * scale
    threshold = _threshold(mean, solid_angle)
    cut = [wp.empty(len(suspects), dtype=kind, device=device) for kind in (float, wp.uint32, wp.vec3)]
    launch_bands(cut_texels, 0, len(suspects), [points, threshold, scene.luminance, radiance], cut)
    excess, box, color = (values.numpy() for values in cut)
    power = excess * spots
    total = power.sum()
    share = total / max(mean.ravel() @ solid_angle.ravel(), 1e-30)
    if not np.isfinite(share) or share < LEAST_SHARE:
        return no_split(device)
    split = EnvironmentSplit()
    split.threshold, split.power, split.share = float(threshold), float(total * 4.0 * np.pi), float(min(share, 1.0))
    split.points = points
    held = excess > 0.0
    _fill_tables(split, scene, suspects[held], power[held] / total, box[held], color[held], device)
    return split


def _fill_tables(
    split: EnvironmentSplit, scene: types.Scene, texels: np.ndarray, chances: np.ndarray, box: np.ndarray,
    color: np.ndarray, device: str,
) -> None:
    """Put what is known of the texels with excess onto the device."""
    environment = scene.environment
    count = environment.width * environment.height
    weights, boxes, colors = np.zeros(count), np.zeros(count, np.uint32), np.zeros((count, 3), np.float32)
    weights[texels] = chances / chances.sum()
    boxes[texels], colors[texels] = box, color
    probability, alias = build_alias_table(weights)
    table = no_environment(device)
    table.width, table.height = environment.width, environment.height
    table.visibility = environment.visibility
    table.constant = 0
    table.probability = wp.array(probability, dtype=float, device=device)
    table.alias = wp.array(alias, dtype=int, device=device)
    table.weight = wp.array(weights.astype(np.float32), dtype=float, device=device)
    split.table = table
    split.excess = wp.array(colors, dtype=wp.vec3, device=device)
    split.box = wp.array(boxes, dtype=wp.uint32, device=device)


def _relative_radiance(environment: types.Environment, solid_angle: np.ndarray) -> np.ndarray:
    """Return each texel's mean radiance (largest channel) over that of the sphere, from the sampling table."""
    return np.maximum(texel_chances(environment) / solid_angle - UNIFORM_SHARE, 0.0) / (1.0 - UNIFORM_SHARE)


def _threshold(mean: np.ndarray, solid_angle: np.ndarray) -> float:
    """Return the threshold: a multiple of the mean of all light that is limited to it.

    The mean of all light itself would be drawn up by the very sun that is to be cut out.
    """
    mean, solid_angle = mean.ravel(), np.ravel(solid_angle)
    whole = float(mean @ solid_angle)
    threshold, limited = THRESHOLD_RATIO * whole, np.empty_like(mean)
    for _ in range(16):
        before, soft = threshold, float(np.minimum(mean, threshold, out=limited) @ solid_angle)
        # A sun in a black sky has no soft part: keep the threshold above nothing.
        threshold = max(THRESHOLD_RATIO * soft, 1e-3 * whole)
        if abs(threshold - before) <= PRECISION * before:
            break
    return threshold


def _dilate(values: np.ndarray) -> np.ndarray:
    """Return the largest of each texel and its eight neighbours; around the poles' axis the map is closed."""
    wide = np.pad(values, ((1, 1), (0, 0)), mode="edge")
    tall = np.maximum(np.maximum(wide[:-2], wide[1:-1]), wide[2:])
    return np.maximum(np.maximum(np.roll(tall, 1, 1), tall), np.roll(tall, -1, 1))


def _suspects(mean: np.ndarray, solid_angle: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the texels that may hold excess, and at how many points a side each is looked at."""
    bright = mean > _threshold(mean, solid_angle) / SUSPECT_RATIO
    if not bright.any():
        return np.zeros(0, np.int64), 0
    suspects = np.flatnonzero(_dilate(bright.astype(float)))
    return suspects, int(np.clip(np.sqrt(CLOSE_LOOKS / len(suspects)), 2, POINTS_MAX))


def _look_closely(scene: types.Scene, texels: np.ndarray, points: int, device: str) -> wp.array:
    """Return the world's radiance, unfiltered, at points x points places in each texel, one after another: vec4.

    By the path tracer's kernel for rays that wait for the world.
    """
    environment, total = scene.environment, len(texels) * points * points
    aims = [wp.array(texels.astype(np.int32), dtype=int, device=device), points, environment.width, environment.height]
    size = min(CHUNK, total)
    rays, queue = make_shadow_rays(size, device, layers=False, programs=True), make_queue(size, device)
    options = make_options(filtered=False)
    rays.shadow_pending.fill_(int(PENDING_WORLD))
    rays.shadow_light.fill_(wp.vec3(1.0, 1.0, 1.0))
    result = wp.empty(total, dtype=wp.vec4, device=device)
    parts = 1 if wp.get_device(device).is_cuda else 16
    none, whole = one_number(0, device), one_number(size, device)
    for low in range(0, total, size):
        count = min(size, total - low)
        launch_bands(aim_at_texels, low, count, [low, *aims], [rays.shadow_direction])
        rays.shadow_distance.fill_(float(FAR))
        rays.radiance.zero_()
        edges = [count * i // parts for i in range(parts + 1)]
        run_bands([
            lambda a=a, b=b: launch(
                shade_lights, b - a, [scene, options, none, ONCE, whole, queue[a:b]], [rays], device)
            for a, b in zip(edges[:-1], edges[1:], strict=True) if b > a])
        wp.copy(result, rays.radiance, dest_offset=low, count=count)
    return result
