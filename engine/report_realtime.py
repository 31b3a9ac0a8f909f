# SPDX-License-Identifier: GPL-3.0-or-later
"""What a real-time frame draws otherwise than the path tracer: found in the scene and named once in the report.

Reads compiled programs, so that it knows what a material's nodes come to whatever they are called.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from ..kernels import node_codes as codes
from ..kernels import types as kernel_types
from .program import Program
from .report import Report, ReportKind
from .scene import MaterialData
from .settings import Integrator, RenderSettings

__all__ = ["SceneFacts", "realtime_approximations", "scene_facts"]

ROUGHNESS_DIFFUSE = 0.6
"""Roughness from which a reflection is so blurred that diffuse light stands in for it (Eto et al. 2023, r_diffuse)"""


@dataclass(frozen=True, kw_only=True)
class SceneFacts:
    """How many materials have what."""

    reflective: int = 0
    """Reflections sharper than ROUGHNESS_DIFFUSE"""
    refractive: int = 0
    """Refraction (glass, transmission)"""
    translucent: int = 0
    """Light from behind, scattered"""


def scene_facts(materials: Iterable[MaterialData]) -> SceneFacts:
    """Return the facts about all materials in a scene."""
    counts = {"reflective": 0, "refractive": 0, "translucent": 0}
    for material in materials:
        for fact in set(material_facts(material.program)):
            counts[fact] += 1
    return SceneFacts(**counts)


def realtime_approximations(settings: RenderSettings, facts: SceneFacts, aperture_radius: float) -> Report:
    """Return what real-time frames of a scene approximate; empty for the reference integrator.

    Args:
        settings: Decide whether and when path tracing takes over. `sampling.samples` is the number of frames, 0
            without end.
        facts: Of the scene's materials.
        aperture_radius: Of the camera [m]; 0 is a pinhole.
    """
    report = Report()
    if settings.sampling.integrator != Integrator.REALTIME or settings.debug.view:
        return report
    until = rest_clause(settings)
    if facts.reflective:
        report.add(ReportKind.APPROXIMATED, "",
                   f"materials with a roughness below {ROUGHNESS_DIFFUSE:g} reflect their surroundings as diffuse light"
                   f"{until}", facts.reflective)
    if facts.refractive:
        report.add(ReportKind.APPROXIMATED, "", f"materials that refract are drawn as diffuse{until}", facts.refractive)
    if facts.translucent:
        report.add(ReportKind.APPROXIMATED, "",
                   f"translucent materials take indirect light from their front alone{until}", facts.translucent)
    if aperture_radius > 0.0:
        report.add(ReportKind.APPROXIMATED, "", f"depth of field is not drawn{until}")
    return report


def rest_clause(settings: RenderSettings) -> str:
    """Return the end of a sentence that says when path tracing takes over."""
    denoiser, samples = settings.denoiser, settings.sampling.samples
    if not denoiser.path_traced_rest:
        return "; turn on path tracing at rest, or use the reference integrator, to draw it"
    if 0 < samples <= denoiser.rest_frames:
        return f"; render more than {denoiser.rest_frames} frames, or use the reference integrator, to draw it"
    return f" until the picture has rested for {denoiser.rest_frames} frames"


def material_facts(program: Program) -> Iterator[str]:
    """Yield the facts about one material: names of SceneFacts' fields, perhaps repeatedly."""
    for kind, arguments in closures(program):
        sharp = may_be(arguments[codes.ARG_ROUGHNESS], lambda value: value < ROUGHNESS_DIFFUSE)
        if kind == kernel_types.CLOSURE_TRANSLUCENT:
            yield "translucent"
        if kind in (kernel_types.CLOSURE_GLASS, kernel_types.CLOSURE_REFRACTION):
            yield "refractive"
        if kind in (kernel_types.CLOSURE_GLOSSY, kernel_types.CLOSURE_GLASS) and sharp:
            yield "reflective"
        if kind == kernel_types.CLOSURE_PRINCIPLED:
            yield from principled_facts(arguments, sharp)


def principled_facts(arguments: list[float | None], sharp: bool) -> Iterator[str]:
    """Yield the facts about one Principled BSDF, whose arguments are numbers, or None where they vary."""
    def above_zero(slot: int) -> bool:
        return may_be(arguments[slot], lambda value: value > 0.0)

    transmits, thin = above_zero(codes.ARG_TRANSMISSION), above_zero(codes.ARG_THIN_WALL)
    ior = may_be(arguments[codes.ARG_IOR], lambda value: value != 1.0)
    mirrors = above_zero(codes.ARG_METALLIC) or (above_zero(codes.ARG_SPECULAR_LEVEL) and ior)
    if sharp and mirrors:
        yield "reflective"
    if above_zero(codes.ARG_COAT) and may_be(arguments[codes.ARG_COAT_ROUGHNESS],
                                             lambda value: value < ROUGHNESS_DIFFUSE):
        yield "reflective"
    if transmits:
        yield "refractive"
    if thin and above_zero(codes.ARG_SUBSURFACE):
        yield "translucent"


def may_be(value: float | None, test: Callable[[float], bool]) -> bool:
    """Return whether a value passes a test, or varies and so may pass it somewhere."""
    return value is None or test(value)


def closures(program: Program) -> Iterator[tuple[int, list[float | None]]]:
    """Yield each closure's kind (kernels.types.CLOSURE_*) and arguments by slot: numbers, or None where they vary."""
    code = program.surface
    for position, (head, _, words, _) in enumerate(code):
        if head & 255 != codes.OP_CLOSURE:
            continue
        operands = [operand for line in code[position + 1:position + 1 + words] for operand in line[1:]]
        arguments = [program.constants[-1 - operand][0] if operand < 0 else None for operand in operands]
        yield head >> 16 & 255, arguments + [0.0] * (codes.ARGUMENT_COUNT - len(arguments))
