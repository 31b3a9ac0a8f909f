# SPDX-License-Identifier: GPL-3.0-or-later
"""The real-time integrator with one part off, or otherwise set: what `burnish bench --ablation` measures in turn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from .presets import apply_preset
from .settings import CacheKey, Preset, ReflectionResolution, RenderSettings

__all__ = ["DEFAULT", "VARIANTS", "variant_settings"]

DEFAULT = "default"

VARIANTS: Mapping[str, Mapping[str, Any] | Preset] = MappingProxyType({
    DEFAULT: {},
    "another seed": {"sampling.seed": 1},
    "no guiding": {"probes.guiding": False},
    "no persistence": {"probes.persistence": False},
    "no probe filter": {"probes.filtering": False},
    "no probe rays into reflections": {"probes.specular_rays": False},
    "every probe in every frame": {"probes.update_interval": 1},
    "small pictures not denser": {"probes.dense_small": False},
    "contact detail": {"probes.contact_detail": True},
    "published probe energy": {"probes.energy_exact": False},
    "probes for 32 px": {"probes.spawn_tile": 32},
    "one bounce in the cache": {"cache.bounces": 1},
    "two bounces in the cache": {"cache.bounces": 2},
    "cells by direction": {"cache.key": CacheKey.DIRECTION},
    "no scan behind holes": {"cache.scan_all": False},
    "no level blend": {"cache.level_blend": False},
    "no cone test": {"cache.cone_test": False},
    "no light over mirrors": {"cache.follow_mirrors": False},
    "no highlights in the cache": {"cache.highlights": False},
    "shadows that lag in cells": {"cache.follow_shadows": False},
    "no paths that end in the cache": {"cache.ends_paths": False},
    "cells of 16 px": {"cache.cell_pixels": 16.0},
    "cells as wide as the first": {"cache.refine": False},
    "cap of 16 samples in cells": {"cache.sample_cap": 16},
    "a bounce ray for every hit": {"cache.bounce_share": 1.0},
    "one light candidate": {"direct_light.candidates": 1},
    "16 light candidates": {"direct_light.candidates": 16},
    "reuse of lights": {"direct_light.temporal_reuse": 1},
    "a shadow ray for every pixel": {"direct_light.half_rate": False},
    "every pixel's light in its turn": {"direct_light.quarter_rate": False},
    "every pixel's probes in each frame": {"probes.half_rate": False},
    "no light behind glass": {"direct_light.clear_glass": False},
    "reflections traced to 0.2": {"reflections.roughness_traced": 0.2},
    "weak reflections traced as far": {"reflections.roughness_weak": 0.5},
    "no traced reflections": {"reflections.roughness_traced": 0.0, "reflections.roughness_blend": 0.0},
    "no blend of reflections": {"reflections.roughness_blend": 0.0},
    "full reflection resolution": {"reflections.resolution": ReflectionResolution.FULL},
    "quarter reflection resolution": {"reflections.resolution": ReflectionResolution.QUARTER},
    "every reflection in its turn": {"reflections.half_rate": False},
    "no mirrors in mirrors": {"reflections.bounces": 0},
    "no screen reuse": {"reflections.screen_reuse": False},
    "no lighting of hits": {"reflections.hit_lighting": False},
    "nothing scattered below surfaces": {"reflections.subsurface": False},
    "hair as surfaces": {"reflections.hair": False},
    "no jitter of reflections": {"reflections.jitter": False},
    "no direct filter": {"denoiser.direct_iterations": 0},
    "no diffuse blur": {"denoiser.diffuse_radius": 0},
    "one reflection filter pass": {"denoiser.reflection_iterations": 1},
    "published reflection weights": {"denoiser.reflection_ratio": False},
    "no clean-up": {"denoiser.reflection_cleanup": False},
    "no reflection history": {"denoiser.reflection_temporal": False},
    "no clamp of reflections": {"denoiser.reflection_clamp": 0.0},
    "no anti-aliasing": {"denoiser.antialiasing": False},
    "small pictures not supersampled": {"denoiser.supersample_small": False},
    "no depth of field": {"denoiser.depth_of_field": False},
    "no final gather": {"denoiser.rest_gather": False},
    "preset draft": Preset.DRAFT,
    "preset fine": Preset.FINE,
    "preset paper": Preset.PAPER,
})
"""Changes of the defaults, by "group.setting", or a preset. The second tells how much of a difference is noise"""


def variant_settings(settings: RenderSettings, name: str) -> RenderSettings:
    """Return settings with the real-time integrator's defaults and a variant's changes.

    Raises:
        KeyError: No such variant.
    """
    changes = VARIANTS[name]
    if isinstance(changes, Preset):
        return apply_preset(settings, changes)
    result = apply_preset(settings, Preset.BALANCED)
    for path, value in changes.items():
        group, field = path.split(".")
        result = replace(result, **{group: replace(getattr(result, group), **{field: value})})
    return result
