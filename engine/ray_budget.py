# SPDX-License-Identifier: GPL-3.0-or-later
"""How many rays frames have by their size: on a GPU small pictures have as many as large ones.

A launch waits there for its longest rays, so that a few ten thousand take nearly as long as ten times as many. On a
processor each ray costs its share.
"""

from __future__ import annotations

import math
from dataclasses import replace

from ..kernels.hash_grid import SCREEN_LINES
from ..kernels.probe_turns import SHORT_INTERVAL
from ..kernels.probe_types import TILE
from .settings import ReflectionResolution, RenderSettings

__all__ = [
    "HALF_RATE_PIXELS", "SMALLEST_PIXELS", "SMALL_INTERVAL", "SMALL_PIXELS", "densified", "is_small", "spreading_rays"]

HALF_RATE_PIXELS = 1_000_000
"""Frames of no more pixels have a shadow ray for each in every frame, on any device, and their probes wait for
SMALL_INTERVAL frames at most: they are coarser, and it costs little"""

SMALL_INTERVAL = int(SHORT_INTERVAL)
"""ProbeSettings.update_interval at most in pictures of up to HALF_RATE_PIXELS: twice as much has 1 to 4 % more FLIP"""

SMALL_PIXELS = 1920 * 1080 // 4
"""Pixels of a small picture at most: with half the distance between probes, and a reflection ray for each pixel instead
of four, it has no more of either than a 1080p frame"""

SMALLEST_PIXELS = SMALL_PIXELS // 16
"""Pixels of a small picture at least: icons have so few rays in all that finer cells show single ones"""

SPREADING_RAYS = 1 << 17
"""Bounce rays of frames of up to HALF_RATE_PIXELS while light spreads, at most: twice as many would make first frames
an eighth longer and one or two percent better"""

LEAST_SHRINK = 0.5
"""Width of cells by that in other pictures, at least: then each has about as many rays"""

DENSER = {ReflectionResolution.QUARTER: ReflectionResolution.HALF, ReflectionResolution.HALF: ReflectionResolution.FULL}


def is_small(width: int, height: int) -> bool:
    """Return whether a picture of a size [px] leaves a GPU idle, and is no icon."""
    return SMALLEST_PIXELS <= width * height <= SMALL_PIXELS


def densified(
    settings: RenderSettings, width: int, height: int, lines: int, device: str, factor: int = 1, *, seen: bool = True,
) -> RenderSettings:
    """Return the settings that frames are made with: denser ones for a small picture on a GPU.

    Args:
        settings: What the user has chosen.
        width: Of the rendered region [px].
        height: Of the rendered region [px].
        lines: Height of the full frame [px].
        device: Where the kernels run.
        factor: Frames have so many times the width and height of a picture that is small (supersampling.py).
        seen: Whether anybody sees the frames; others only fill the radiance cache.
    """
    probes, cache, reflections = settings.probes, settings.cache, settings.reflections
    small = is_small(width, height)
    if device == "cpu" or not (probes.dense_small and (small or factor > 1)):
        return settings
    # Cells are seen smaller by the root of the lines (wanted_size in kernels/hash_grid.py). With as many rays as 1080p
    # frames they can be as small in the scene as there; with four times as many as before, half as wide at least.
    shrink = max(math.sqrt(min(lines / float(SCREEN_LINES), 1.0)), LEAST_SHRINK)
    settings = replace(settings, cache=replace(cache, cell_pixels=cache.cell_pixels * shrink))
    # Probes that are twice as near take a seventh off the error of first frames, for 2 ms of them and 1 ms of others.
    if small or (seen and width * height <= HALF_RATE_PIXELS):
        settings = replace(settings, probes=replace(probes, spawn_tile=max(probes.spawn_tile // 2, int(TILE))))
    return settings if not small else replace(
        settings,
        reflections=replace(reflections, resolution=DENSER.get(reflections.resolution, reflections.resolution)))


def spreading_rays(count: int, width: int, height: int) -> int:
    """Return how many of `count` hits send a ray on while light spreads, in frames of a size [px]."""
    return min(count, SPREADING_RAYS) if width * height <= HALF_RATE_PIXELS else count
