# SPDX-License-Identifier: GPL-3.0-or-later
"""The presets: they name real settings within their ranges, and Balanced is the defaults."""

from __future__ import annotations

from dataclasses import fields

import pytest
from burnish.engine.presets import GOVERNED, PRESETS, apply_preset, matching_preset, preset_values
from burnish.engine.settings import (
    DenoiserSettings,
    FilmSettings,
    Preset,
    ProbeSettings,
    RenderSettings,
    SamplingSettings,
)


@pytest.mark.parametrize("preset", PRESETS)
def test_values_fit_their_settings(preset: Preset) -> None:
    """Name settings that exist, with values of their type within their range."""
    defaults = RenderSettings()
    for path, value in PRESETS[preset].items():
        group, name = path.split(".")
        assert group in GOVERNED
        field = {field.name: field for field in fields(getattr(defaults, group))}[name]
        assert type(value) is type(field.default), path
        low, high = field.metadata["low"], field.metadata["high"]
        assert (low is None or value >= low) and (high is None or value <= high), path


def test_balanced_is_the_defaults() -> None:
    """Leave nothing of other presets behind, and everything else as it is."""
    assert apply_preset(RenderSettings(), Preset.BALANCED) == RenderSettings()
    film, sampling = FilmSettings(exposure=2.0), SamplingSettings(samples=7)
    changed = RenderSettings(film=film, sampling=sampling, probes=ProbeSettings(history=3),
                             denoiser=DenoiserSettings(direct_iterations=1, final_denoise=True))
    assert apply_preset(apply_preset(changed, Preset.PAPER), Preset.BALANCED) == RenderSettings(
        film=film, sampling=sampling, denoiser=DenoiserSettings(final_denoise=True))
    assert apply_preset(changed, Preset.CUSTOM) is changed


def test_presets_are_all_of_the_choices_and_frozen() -> None:
    """Have a table for each choice but the one that sets nothing; tables can't be changed."""
    assert set(PRESETS) == set(Preset) - {Preset.CUSTOM}
    with pytest.raises(TypeError):
        PRESETS[Preset.DRAFT]["probes.history"] = 1  # type: ignore[index]
    with pytest.raises(KeyError):
        preset_values(Preset.CUSTOM)


def test_a_preset_is_recognised() -> None:
    """Find the preset that settings are, and none after one edit."""
    for preset in PRESETS:
        assert matching_preset(preset_values(preset)) == preset
    assert matching_preset(preset_values(Preset.FINE) | {"probes.history": 31}) == Preset.CUSTOM


def test_costs_rise_from_draft_to_fine() -> None:
    """Spend at least as much in each setting that decides the cost."""
    draft, balanced, fine = (apply_preset(RenderSettings(), preset)
                             for preset in (Preset.DRAFT, Preset.BALANCED, Preset.FINE))
    rays = {"full": 1, "half": 4, "quarter": 16}
    for low, high in ((draft, balanced), (balanced, fine)):
        assert low.probes.spawn_tile >= 2 * high.probes.spawn_tile
        assert rays[low.reflections.resolution] >= 4 * rays[high.reflections.resolution]
        for name in ("roughness_traced", "roughness_diffuse", "bounces"):
            assert getattr(low.reflections, name) <= getattr(high.reflections, name), name
        assert low.direct_light.candidates < high.direct_light.candidates


def test_paper_switches_every_mend_off() -> None:
    """Use the published constants."""
    paper = apply_preset(RenderSettings(), Preset.PAPER)
    assert not (paper.probes.energy_exact or paper.cache.scan_all or paper.cache.level_blend or paper.cache.cone_test)
    assert not (paper.denoiser.reflection_ratio or paper.reflections.hit_lighting or paper.denoiser.path_traced_rest)
    assert (paper.reflections.roughness_traced, paper.reflections.roughness_diffuse) == (0.2, 0.6)
    assert (paper.denoiser.reflection_history, paper.denoiser.reflection_clamp, paper.cache.sample_cap) == (8, 1.0, 16)
