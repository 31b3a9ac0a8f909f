# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's settings as its kernels read them."""

from __future__ import annotations

import warp as wp

from ..kernels.paths import Options
from .device_scene import DeviceScene
from .settings import RenderSettings

__all__ = ["path_options"]

ENDED_HARDER = 8
"""Bounces after which paths are ended harder on a GPU: a hundredth of them took as long there as all others, round by
round. Not in media, where light of dozens of bounces makes the picture; on a processor it would bring noise alone."""


def path_options(settings: RenderSettings, scene: DeviceScene, passes: bool) -> Options:
    """Return the kernels' settings for a scene; `passes`: whether the first hits' data are kept."""
    paths, options = settings.light_paths, Options()
    options.max_bounces, options.roulette_start = paths.max_bounces, paths.roulette_start
    waits = wp.get_device(scene.device).is_cuda and scene.media is None
    options.ended_harder = ENDED_HARDER if waits else 0
    options.clamp_direct, options.clamp_indirect = paths.clamp_direct, paths.clamp_indirect
    options.transparent = int(settings.film.transparent)
    options.exposure = settings.film.exposure
    options.passes = int(passes)
    options.filtered = int(scene.structures.has_filtered)
    options.programs = int(scene.has_light_programs)
    lean = scene.material_table.lean
    below = scene.material_table.subsurface
    options.subsurface, options.subsurface_bump = below.scatters, below.bumped
    options.all_lean, options.all_plain = (all_of and not below.scatters for all_of in (lean.surface, lean.plain))
    options.lean_layers, options.films = lean.transparency, lean.films
    return options
