# SPDX-License-Identifier: GPL-3.0-or-later
"""Presets: settings of the real-time integrator that go together, by their paths in RenderSettings.

A preset governs all settings of the groups in GOVERNED but those in KEPT: what its table leaves out has its default.
The rest (samples, device, film) stays as it is.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any

from .settings import CacheKey, Preset, ReflectionResolution, RenderSettings

__all__ = ["PRESETS", "apply_preset", "governed_values", "matching_preset", "preset_values", "write_values"]

GOVERNED = ("probes", "cache", "direct_light", "reflections", "denoiser")

KEPT = frozenset({"denoiser.final_denoise"})
"""A matter of the picture that is wanted, not of cost."""

PRESETS: Mapping[Preset, Mapping[str, Any]] = MappingProxyType({
    Preset.DRAFT: MappingProxyType({
        "probes.spawn_tile": 32,
        "probes.dense_small": False,
        "cache.bounce_share": 0.15,
        "direct_light.candidates": 2,
        "reflections.roughness_traced": 0.2,
        "reflections.roughness_diffuse": 0.45,
        "reflections.resolution": ReflectionResolution.QUARTER,
        "reflections.bounces": 2,
        "denoiser.supersample_small": False,
        "denoiser.rest_gather": False,
    }),
    Preset.BALANCED: MappingProxyType({}),
    Preset.FINE: MappingProxyType({
        "probes.spawn_tile": 8,
        "probes.update_interval": 1,
        "probes.half_rate": False,
        "cache.cell_pixels": 16.0,
        "cache.capacity": 22,
        "cache.bounce_share": 0.5,
        "direct_light.candidates": 16,
        "direct_light.half_rate": False,
        "reflections.roughness_traced": 0.7,
        "reflections.roughness_weak": 0.7,
        "reflections.roughness_diffuse": 0.8,
        "reflections.resolution": ReflectionResolution.FULL,
        "reflections.half_rate": False,
        "reflections.bounces": 12,
    }),
    Preset.PAPER: MappingProxyType({
        "probes.update_interval": 1,
        "probes.half_rate": False,
        "probes.dense_small": False,
        "probes.contact_detail": True,
        "probes.energy_exact": False,
        "cache.minimum_cell": 0.1,
        "cache.refine": False,
        "cache.bounces": 1,
        "cache.sample_cap": 16,
        "cache.key": CacheKey.DIRECTION,
        "cache.scan_all": False,
        "cache.level_blend": False,
        "cache.cone_test": False,
        "cache.follow_mirrors": False,
        "cache.highlights": False,
        "cache.follow_shadows": False,
        "direct_light.candidates": 4,
        "direct_light.temporal_reuse": 1,
        "direct_light.quarter_rate": False,
        "direct_light.clear_glass": False,
        "reflections.roughness_traced": 0.2,
        "reflections.roughness_diffuse": 0.6,
        "reflections.roughness_blend": 0.0,
        "reflections.resolution": ReflectionResolution.HALF,
        "reflections.half_rate": False,
        "reflections.bounces": 0,
        "reflections.hit_lighting": False,
        "reflections.subsurface": False,
        "reflections.hair": False,
        "denoiser.reflection_iterations": 4,
        "denoiser.reflection_kernel": 1.0,
        "denoiser.reflection_ratio": False,
        "denoiser.reflection_history": 8,
        "denoiser.reflection_clamp": 1.0,
        "denoiser.supersample_small": False,
        "denoiser.rest_gather": False,
        "denoiser.path_traced_rest": False,
    }),
})
"""What each preset changes of the defaults: values by "group.setting"."""


def preset_values(preset: Preset) -> dict[str, Any]:
    """Return the values of all settings that a preset governs, by "group.setting".

    Raises:
        KeyError: For Preset.CUSTOM, which sets nothing.
    """
    return governed_values(RenderSettings()) | PRESETS[preset]


def governed_values(settings: RenderSettings) -> dict[str, Any]:
    """Return the values of those settings that presets govern, by "group.setting"."""
    return {f"{group}.{field.name}": getattr(getattr(settings, group), field.name)
            for group in GOVERNED for field in fields(getattr(settings, group))
            if f"{group}.{field.name}" not in KEPT}


def write_values(settings: Any, values: Mapping[str, Any]) -> None:
    """Set values by "group.setting" in Blender's property groups (`scene.burnish`), where enumerations have names."""
    for path, value in values.items():
        group, name = path.split(".")
        setattr(getattr(settings, group), name, value.name if isinstance(value, enum.Enum) else value)


def apply_preset(settings: RenderSettings, preset: Preset) -> RenderSettings:
    """Return settings with a preset's values; Preset.CUSTOM changes nothing."""
    if preset == Preset.CUSTOM:
        return settings
    groups: dict[str, dict[str, Any]] = {group: {} for group in GOVERNED}
    for path, value in preset_values(preset).items():
        group, name = path.split(".")
        groups[group][name] = value
    return replace(settings, **{
        group: replace(getattr(settings, group), **values) for group, values in groups.items()})


def matching_preset(values: Mapping[str, Any]) -> Preset:
    """Return the preset whose values these are ("group.setting" of all governed), Preset.CUSTOM for none."""
    return next((preset for preset in PRESETS if preset_values(preset) == values), Preset.CUSTOM)
