# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of render passes: one line each; drives their registration with Blender and the writing of pixels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..engine.pass_names import COLOR_AOV, GROUP_PREFIX, MATTE_KINDS, SHADOW_CATCHER, VALUE_AOV
from ..engine.report import Report, ReportKind
from ..engine.settings import Integrator
from . import compat

__all__ = ["AOVS", "Aov", "aov_source", "enabled_aovs", "missing_passes", "register_passes", "write_pass"]


@dataclass(frozen=True)
class Aov:
    """One pass: its name in Blender, the engine's name for it, its channels and the switch that asks for it."""

    name: str
    source: str
    """What Session.configure and Session.read call it."""
    channels: str
    kind: str
    """Blender's pass type: COLOR, VECTOR or VALUE."""
    switch: str
    """The property of a view layer that turns it on."""


LIGHT_PASSES = tuple(
    f"{lobe} {part}" for lobe in ("Diffuse", "Glossy", "Transmission") for part in ("Direct", "Indirect", "Color"))

AOVS = (
    Aov("Combined", "Combined", "RGBA", 'COLOR', "use_pass_combined"),
    Aov("Depth", "Depth", "Z", 'VALUE', "use_pass_z"),
    Aov("Mist", "Mist", "Z", 'VALUE', "use_pass_mist"),
    Aov("Position", "Position", "XYZ", 'VECTOR', "use_pass_position"),
    Aov("Normal", "Normal", "XYZ", 'VECTOR', "use_pass_normal"),
    Aov("Vector", "Vector", "XYZW", 'VECTOR', "use_pass_vector"),
    Aov("UV", "UV", "UVA", 'VECTOR', "use_pass_uv"),
    Aov(compat.pass_name("Object Index"), "Object Index", "X", 'VALUE', "use_pass_object_index"),
    Aov(compat.pass_name("Material Index"), "Material Index", "X", 'VALUE', "use_pass_material_index"),
    Aov(compat.pass_name("Emission"), "Emission", "RGB", 'COLOR', "use_pass_emit"),
    Aov(compat.pass_name("Environment"), "Environment", "RGB", 'COLOR', "use_pass_environment"),
    Aov(compat.pass_name("Ambient Occlusion"), "Ambient Occlusion", "RGB", 'COLOR', "use_pass_ambient_occlusion"),
    Aov(compat.pass_name("Shadow"), "Shadow", "RGB", 'COLOR', "use_pass_shadow"),
    *(Aov(compat.pass_name(name), name, "RGB", 'COLOR', f"use_pass_{name.lower().replace(' ', '_')}")
      for name in LIGHT_PASSES),
)

MATTE_SWITCHES = {kind: f"use_pass_cryptomatte_{kind.removeprefix('Crypto').lower()}" for kind in MATTE_KINDS}

VOLUME_SWITCHES = {"Volume Direct": "use_pass_volume_direct", "Volume Indirect": "use_pass_volume_indirect"}
"""Passes of the reference integrator alone, by their switches"""

CATCHER_SWITCH = "use_pass_shadow_catcher"

NOT_DRAWN = {"Subsurface Direct": "use_pass_subsurface_direct",
             "Subsurface Indirect": "use_pass_subsurface_indirect", "Subsurface Color": "use_pass_subsurface_color",
             "Volume Scatter": "use_pass_volume_scatter", "Volume Transmit": "use_pass_volume_transmit"}
"""Passes that neither integrator has, by their switches: of the view layer or of Cycles' settings of it"""


def enabled_aovs(view_layer: Any, integrator: Integrator) -> Iterator[Aov]:
    """Yield the passes that a view layer asks for and `integrator` has; Combined always: Blender adds it anyway."""
    for aov in AOVS:
        if aov.name == "Combined" or getattr(view_layer, aov.switch, False):
            yield aov
    for kind, switch in MATTE_SWITCHES.items():
        # Two things a pass. Small letters: by these names OpenEXR's lossy compression leaves ids alone.
        for number in range((view_layer.pass_cryptomatte_depth + 1) // 2 if getattr(view_layer, switch) else 0):
            name = f"{kind}{number:02d}"
            yield Aov(name, name, "rgba", 'COLOR', switch)
    for aov in view_layer.aovs:
        if aov.is_valid and aov.type == 'VALUE':
            yield Aov(aov.name, aov_source(aov), "X", 'VALUE', "aovs")
        elif aov.is_valid:
            yield Aov(aov.name, aov_source(aov), "RGBA", 'COLOR', "aovs")
    if has_switch(view_layer, CATCHER_SWITCH):
        yield Aov(compat.pass_name(SHADOW_CATCHER), SHADOW_CATCHER, "RGB", 'COLOR', CATCHER_SWITCH)
    if integrator == Integrator.REFERENCE:
        for name, switch in VOLUME_SWITCHES.items():
            if has_switch(view_layer, switch):
                yield Aov(compat.pass_name(name), name, "RGB", 'COLOR', switch)
        for name in light_groups(view_layer):
            yield Aov(f"{GROUP_PREFIX}{name}", f"{GROUP_PREFIX}{name}", "RGB", 'COLOR', "lightgroups")


def has_switch(view_layer: Any, switch: str) -> bool:
    """Return whether a switch of the view layer or of Cycles' settings of it is on."""
    return any(getattr(owner, switch, False) for owner in (view_layer, getattr(view_layer, "cycles", None)))


def aov_source(aov: Any) -> str:
    """Return the engine's name of a shader AOV's pass."""
    return (VALUE_AOV if aov.type == 'VALUE' else COLOR_AOV) + aov.name


def light_groups(view_layer: Any) -> list[str]:
    """Return the names of a view layer's light groups."""
    return [group.name for group in getattr(view_layer, "lightgroups", ())]


def missing_passes(view_layer: Any, integrator: Integrator) -> Report:
    """Return a report of the passes that a view layer asks for and `integrator` does not have."""
    report, groups = Report(), light_groups(view_layer)
    if groups and integrator != Integrator.REFERENCE:
        names = ", ".join(groups)
        report.add(ReportKind.SKIPPED, "", f"the light groups {names} are left out; the reference integrator has them")
    for name, switch in VOLUME_SWITCHES.items():
        if integrator != Integrator.REFERENCE and has_switch(view_layer, switch):
            report.add(ReportKind.SKIPPED, "", f"the pass {name} is left out; the reference integrator has it")
    for name, switch in NOT_DRAWN.items():
        if has_switch(view_layer, switch):
            report.add(ReportKind.SKIPPED, "", f"the pass {name} is left out; this version does not have it")
    return report


def register_passes(engine: Any, scene: Any, view_layer: Any) -> None:
    """Tell Blender which passes a render of `view_layer` will have."""
    integrator = Integrator[scene.burnish.sampling.integrator]
    for aov in enabled_aovs(view_layer, integrator):
        engine.register_pass(scene, view_layer, aov.name, len(aov.channels), aov.channels, aov.kind)


def write_pass(render_pass: Any, pixels: np.ndarray) -> None:
    """Copy float32 [h, w, c], bottom row first, into a Blender RenderPass of the same channels.

    Only a flat, contiguous float32 buffer takes foreach_set's fast path: 17 ms for 1080p RGBA, assignment takes 5 s.
    """
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    assert channels == render_pass.channels, (render_pass.name, pixels.shape, render_pass.channels)
    render_pass.rect.foreach_set(np.ascontiguousarray(pixels, np.float32).reshape(-1))
