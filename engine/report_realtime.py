# SPDX-License-Identifier: GPL-3.0-or-later
"""What a real-time frame draws otherwise than the path tracer: found in the scene and named once in the report.

Reads compiled programs, so that it knows what a material's nodes come to whatever they are called.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from ..kernels import node_codes as codes
from ..kernels import types as kernel_types
from ..kernels.rest_blend import TELLING_SAMPLES
from .closure_arguments import closures, is_hair_alone
from .passes.rest import SETTLING
from .program import Program
from .report import Report, ReportKind
from .scene import MaterialData, WorldData
from .settings import Integrator, RenderSettings
from .subsurface import subsurface_flags

__all__ = ["SceneFacts", "realtime_approximations", "scene_facts"]

@dataclass(frozen=True, kw_only=True)
class SceneFacts:
    """How many materials have what."""

    reflective: tuple[float, ...] = ()
    """Roughness of each reflecting material's roughest lobe, 1 where it varies"""
    anisotropic: int = 0
    """Reflections stretched along a tangent"""
    refractive: int = 0
    """Refraction (glass, transmission)"""
    scattering: int = 0
    """Light scattered below the surface"""
    hair: int = 0
    """Light scattered in hair"""
    mixed_hair: int = 0
    """The same, mixed with other shaders"""
    media: int = 0
    """Volumes within surfaces"""
    open_media: int = 0
    """Volumes without a surface, the world's included"""
    linked_unsampled: int = 0
    """Emission that is not sampled as light, of objects that light some objects alone"""
    catchers: bool = False
    """Whether there are shadow catchers"""

    @property
    def traced(self) -> bool:
        """Whether the scene is path-traced in every frame (Session.configure)."""
        return self.catchers


def scene_facts(
    materials: Iterable[MaterialData], linked: Iterable[MaterialData] = (), world: WorldData | None = None, *,
    catchers: bool = False,
) -> SceneFacts:
    """Return the facts about a scene.

    Args:
        materials: All of them.
        linked: Those of objects that light some objects alone.
        world: Its world.
        catchers: Whether there are shadow catchers.
    """
    counts = {"anisotropic": 0, "refractive": 0, "scattering": 0, "hair": 0, "mixed_hair": 0, "media": 0,
              "open_media": int(bool(world and world.medium))}
    reflective = []
    for material in materials:
        facts = list(material_facts(material.program))
        for fact in {fact for fact in facts if isinstance(fact, str)}:
            counts[fact] += 1
        counts["scattering"] += subsurface_flags(material.program) != 0
        if material.hair:
            counts["hair" if is_hair_alone(material.hair) else "mixed_hair"] += 1
        if material.medium:
            counts["open_media" if material.bare else "media"] += 1
        lobes = [fact for fact in facts if isinstance(fact, float)]
        if lobes:
            reflective.append(max(lobes))
    unsampled = sum(material.has_emission and not material.emission_sampling for material in linked)
    return SceneFacts(reflective=tuple(reflective), linked_unsampled=unsampled, catchers=catchers, **counts)


def realtime_approximations(
    settings: RenderSettings, facts: SceneFacts, aperture_radius: float, panoramic: bool = False,
    blurred: bool = False,
) -> Report:
    """Return what real-time frames of a scene approximate; empty for the reference integrator.

    Args:
        settings: Decide whether and when path tracing takes over. `sampling.samples` is the number of frames, 0
            without end.
        facts: Of the scene's materials.
        aperture_radius: Of the camera [m]; 0 is a pinhole.
        panoramic: Whether the camera is; then there are no frames.
        blurred: Whether the picture is a mean over moments; no frames either.
    """
    report = Report()
    reasons = {"panoramic cameras are": panoramic, "motion blur is": blurred, "shadow catchers are": facts.catchers}
    what = next((what for what, there in reasons.items() if there), "")
    if what and settings.sampling.integrator == Integrator.REALTIME:
        without = ", without debug views" if settings.debug.view else ""
        report.add(ReportKind.INFO, "", f"{what} path-traced{without}")
        return report
    if settings.sampling.integrator != Integrator.REALTIME or settings.debug.view:
        return report
    until = rest_clause(settings)
    limit = settings.reflections.roughness_diffuse
    rough = sum(roughness >= limit for roughness in facts.reflective)
    if rough:
        report.add(ReportKind.APPROXIMATED, "",
                   f"reflections of a roughness from {limit:.3g} on take diffuse light{until}", rough)
    if facts.anisotropic:
        report.add(ReportKind.APPROXIMATED, "", f"anisotropic reflections, but of lights, are drawn round{until}",
                   facts.anisotropic)
    if facts.refractive:
        report.add(ReportKind.APPROXIMATED, "",
                   f"refracted light is followed over at most {settings.reflections.bounces} more surfaces, from two "
                   f"on three times as many in smooth glass{until}", facts.refractive)
    if facts.scattering:
        where = ", in mirrors and to other surfaces," if settings.reflections.subsurface else ""
        report.add(ReportKind.APPROXIMATED, "", f"subsurface scattering{where} is drawn as diffuse reflection{until}",
                   facts.scattering)
    if facts.hair:
        where = " in mirrors, and as other surfaces see it," if settings.reflections.hair else ""
        report.add(ReportKind.APPROXIMATED, "", f"hair{where} is drawn as a surface of its color{until}", facts.hair)
    if facts.mixed_hair:
        report.add(ReportKind.APPROXIMATED, "",
                   f"hair that is mixed with other shaders is drawn as a surface of its color{until}",
                   facts.mixed_hair)
    if facts.media:
        report.add(ReportKind.APPROXIMATED, "",
                   f"volumes in surfaces, but for what they absorb and emit in glass, are left out{until}", facts.media)
    if facts.open_media:
        report.add(ReportKind.APPROXIMATED, "",
                   f"light that fog scatters more than once is coarse{until}; the densest fog is path-traced",
                   facts.open_media)
    if facts.linked_unsampled:
        report.add(ReportKind.APPROXIMATED, "",
                   f"emission that is not sampled as light lights objects that it is not linked to{until}",
                   facts.linked_unsampled)
    if aperture_radius > 0.0 and settings.denoiser.depth_of_field:
        report.add(ReportKind.APPROXIMATED, "", f"depth of field blurs what a pinhole shows{until}")
    elif aperture_radius > 0.0:
        report.add(ReportKind.APPROXIMATED, "", f"depth of field is not drawn{until}")
    return report


def rest_clause(settings: RenderSettings) -> str:
    """Return the end of a sentence that says when path tracing takes over."""
    denoiser, samples = settings.denoiser, settings.sampling.samples
    if not denoiser.path_traced_rest:
        return "; turn on path tracing at rest, or use the reference integrator, to draw it"
    frames = min(max(denoiser.rest_frames, 1), SETTLING) + int(TELLING_SAMPLES)
    if 0 < samples <= frames:
        return f"; render more than {frames} frames, or use the reference integrator, to draw it"
    return f" until the picture has rested for {frames} frames"


def material_facts(program: Program) -> Iterator[str | float]:
    """Yield the facts about one material: names of SceneFacts' counts, perhaps repeatedly, and lobes' roughness."""
    for kind, arguments in closures(program):
        roughness, stretched = arguments[codes.ARG_ROUGHNESS], arguments[codes.ARG_ANISOTROPIC]
        if kind in (kernel_types.CLOSURE_GLASS, kernel_types.CLOSURE_REFRACTION):
            yield "refractive"
        if kind in (kernel_types.CLOSURE_GLOSSY, kernel_types.CLOSURE_GLASS):
            yield 1.0 if roughness is None else roughness
        if kind == kernel_types.CLOSURE_GLOSSY and may_be(stretched, lambda value: value != 0.0):
            yield "anisotropic"
        if kind == kernel_types.CLOSURE_PRINCIPLED:
            yield from principled_facts(arguments)


def principled_facts(arguments: list[float | None]) -> Iterator[str | float]:
    """Yield the facts about one Principled BSDF, whose arguments are numbers, or None where they vary."""
    def above_zero(slot: int) -> bool:
        return may_be(arguments[slot], lambda value: value > 0.0)

    def roughness(slot: int) -> float:
        return 1.0 if arguments[slot] is None else arguments[slot]

    transmits = above_zero(codes.ARG_TRANSMISSION)
    ior = may_be(arguments[codes.ARG_IOR], lambda value: value != 1.0)
    if above_zero(codes.ARG_METALLIC) or (above_zero(codes.ARG_SPECULAR_LEVEL) and ior):
        yield roughness(codes.ARG_ROUGHNESS)
        if above_zero(codes.ARG_ANISOTROPIC):
            yield "anisotropic"
    if above_zero(codes.ARG_COAT):
        yield roughness(codes.ARG_COAT_ROUGHNESS)
    if transmits:
        yield "refractive"


def may_be(value: float | None, test: Callable[[float], bool]) -> bool:
    """Return whether a value passes a test, or varies and so may pass it somewhere."""
    return value is None or test(value)
