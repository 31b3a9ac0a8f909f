# SPDX-License-Identifier: GPL-3.0-or-later
"""What the real-time frame is said to approximate, from compiled materials."""

from __future__ import annotations

import dataclasses

import pytest
from burnish.engine.media import MediumData
from burnish.engine.program import ProgramBuilder
from burnish.engine.report import ReportKind
from burnish.engine.report_realtime import SceneFacts, realtime_approximations, scene_facts
from burnish.engine.scene import MaterialData, WorldData
from burnish.engine.settings import (
    DebugSettings,
    DenoiserSettings,
    Integrator,
    ReflectionSettings,
    RenderSettings,
    SamplingSettings,
)

from tests.hair_scenes import hair

EVERYTHING = SceneFacts(reflective=(0.1, 0.7, 0.6, 1.0), anisotropic=4, refractive=2, linked_unsampled=5,
                        scattering=6, media=7, hair=8, mixed_hair=9)

BELOW = {"subsurface_method": "WALK", "subsurface_radius": 0.1}


def material(kind: str, **arguments) -> MaterialData:
    """Return a material of one BSDF; UV stands for a value that varies."""
    builder = ProgramBuilder()
    values = {name: builder.uv("") if value == "UV" else value for name, value in arguments.items()}
    builder.closure(kind, 1.0, color=(0.2, 0.5, 0.8), **values)
    return MaterialData(name=kind, program=builder.finish())


def realtime(samples: int = 1024, **changes) -> RenderSettings:
    """Return settings of the real-time integrator."""
    return RenderSettings(sampling=SamplingSettings(integrator=Integrator.REALTIME, samples=samples), **changes)


@pytest.mark.parametrize(("kind", "arguments", "expected"), [
    ("DIFFUSE", {}, SceneFacts()),
    ("SHEEN", {"roughness": 0.1}, SceneFacts()),
    ("GLOSSY", {"roughness": 0.25}, SceneFacts(reflective=(0.25,))),
    ("GLOSSY", {"roughness": "UV"}, SceneFacts(reflective=(1.0,))),
    ("GLOSSY", {"roughness": 0.25, "anisotropic": -0.5}, SceneFacts(reflective=(0.25,), anisotropic=1)),
    ("GLASS", {"roughness": 0.75, "ior": 1.5}, SceneFacts(reflective=(0.75,), refractive=1)),
    ("REFRACTION", {"roughness": 0.0, "ior": 1.5}, SceneFacts(refractive=1)),
    ("TRANSLUCENT", {}, SceneFacts()),
    ("PRINCIPLED", {"roughness": 0.5, "ior": 1.5, "specular_level": 0.5}, SceneFacts(reflective=(0.5,))),
    ("PRINCIPLED", {"roughness": 0.5, "ior": 1.0, "specular_level": 0.5}, SceneFacts()),
    ("PRINCIPLED", {"roughness": 0.5, "ior": 1.5}, SceneFacts()),
    ("PRINCIPLED", {"roughness": 0.5, "ior": 1.5, "anisotropic": 0.5}, SceneFacts()),
    ("PRINCIPLED", {"roughness": 0.75, "metallic": 1.0, "anisotropic": "UV"},
     SceneFacts(reflective=(0.75,), anisotropic=1)),
    ("PRINCIPLED", {"roughness": 0.25, "metallic": 1.0, "coat": "UV", "coat_roughness": 0.5},
     SceneFacts(reflective=(0.5,))),
    ("PRINCIPLED", {"roughness": 0.75, "transmission": 0.1}, SceneFacts(refractive=1)),
    ("PRINCIPLED", {"roughness": 0.75, "subsurface": 1.0}, SceneFacts()),
    ("PRINCIPLED", {"roughness": 0.75, "subsurface": 1.0, "thin_wall": 1.0}, SceneFacts()),
    ("PRINCIPLED", {"subsurface": 1.0, **BELOW}, SceneFacts(scattering=1)),
    ("PRINCIPLED", {"subsurface": "UV", "thin_wall": "UV", **BELOW}, SceneFacts(scattering=1)),
    ("PRINCIPLED", {"subsurface": 1.0, "thin_wall": 1.0, **BELOW}, SceneFacts()),
])
def test_facts_follow_the_closures(kind: str, arguments: dict, expected: SceneFacts) -> None:
    """Find what a BSDF has, and count what varies as if it had it."""
    assert scene_facts([material(kind, **arguments)]) == expected


def test_facts_count_materials() -> None:
    """Count a material once whatever number of closures it has, and all materials that have something."""
    builder = ProgramBuilder()
    for roughness in (0.125, 0.25):
        builder.closure("GLOSSY", builder.uv(""), color=(1.0, 1.0, 1.0), roughness=roughness)
    double = MaterialData(name="Double", program=builder.finish())
    assert scene_facts([double, material("GLOSSY", roughness=0.5), material("DIFFUSE")]) == SceneFacts(
        reflective=(0.25, 0.5))


def test_emission_that_frames_cannot_link() -> None:
    """Count, of objects that light some objects alone, what shines without being sampled as light."""
    shining = {sampled: dataclasses.replace(material("DIFFUSE"), has_emission=True, emission_sampling=sampled)
               for sampled in (True, False)}
    facts = scene_facts(shining.values(), [*shining.values(), material("DIFFUSE")])
    assert facts == SceneFacts(linked_unsampled=1) and scene_facts(shining.values()) == SceneFacts()


def test_each_approximation_is_named_once() -> None:
    """Name every approximation once, with the number of materials."""
    entries = realtime_approximations(realtime(), EVERYTHING, aperture_radius=0.01).entries()
    assert all(entry.kind == ReportKind.APPROXIMATED and entry.owner == "" for entry in entries)
    assert sorted(entry.count for entry in entries) == [1, 2, 3, 4, 5, 6, 7, 8, 9]
    text = " ".join(entry.message for entry in entries)
    for word in ("reflections", "anisotropic", "refracted", "not linked to", "depth of field", "subsurface scattering",
                 "volumes", "hair in mirrors", "hair that is mixed"):
        assert word in text, word
    assert text.count("until the picture has rested for 12 frames") == 9


def test_hair_follows_its_setting() -> None:
    """Count materials of hair, and say whether frames scatter light in it."""
    facts = scene_facts([hair(), hair(mixed=True), material("DIFFUSE")])
    assert facts.hair == 1 and facts.mixed_hair == 1
    for on, words in ((True, "hair in mirrors"), (False, "hair is drawn as a surface")):
        entries = realtime_approximations(realtime(reflections=ReflectionSettings(hair=on)), facts, 0.0).entries()
        assert any(entry.message.startswith(words) for entry in entries)


def test_depth_of_field_follows_its_setting() -> None:
    """Say that depth of field is a filter of a pinhole's picture, or that it is switched off."""
    for on, words in ((True, "depth of field blurs what a pinhole shows"), (False, "depth of field is not drawn")):
        entries = realtime_approximations(
            realtime(denoiser=DenoiserSettings(depth_of_field=on)), SceneFacts(), 0.01).entries()
        assert [entry.message.startswith(words) for entry in entries] == [True]


def test_media_are_counted() -> None:
    """Count materials with a medium, and apart from them those without a surface and the world."""
    medium = MediumData(extinction=(1.0, 0.0, 0.0))
    filled = dataclasses.replace(material("DIFFUSE"), medium=medium)
    world = WorldData(name="fog", program=filled.program, medium=medium)
    assert scene_facts([filled, material("DIFFUSE")]) == SceneFacts(media=1)
    assert scene_facts([filled, dataclasses.replace(filled, bare=True)], (), world) == SceneFacts(media=1, open_media=2)
    assert scene_facts([dataclasses.replace(filled, medium=MediumData())]).media == 0


@pytest.mark.parametrize(("limit", "count"), [(0.05, 4), (0.65, 2), (1.0, 1)])
def test_rough_reflections_follow_the_setting(limit: float, count: int) -> None:
    """Count the materials whose reflections take diffuse light by the scene's own limit."""
    settings = realtime(reflections=ReflectionSettings(roughness_diffuse=limit, bounces=3))
    entries = realtime_approximations(settings, EVERYTHING, 0.0).entries()
    rough, = (entry for entry in entries if "take diffuse light" in entry.message)
    assert rough.count == count and f"from {limit:g} on" in rough.message
    assert any("at most 3 more surfaces" in entry.message for entry in entries)
    assert not realtime_approximations(settings, SceneFacts(reflective=(0.02,)), 0.0).counts


def test_nothing_is_said_without_need() -> None:
    """Say nothing about the reference integrator, a debug view, or a scene without any of it."""
    assert not realtime_approximations(RenderSettings(
        sampling=SamplingSettings(integrator=Integrator.REFERENCE)), EVERYTHING, 0.01).counts
    assert not realtime_approximations(realtime(debug=DebugSettings(view="gbuffer.normal")), EVERYTHING, 0.01).counts
    assert not realtime_approximations(realtime(), SceneFacts(), 0.0).counts


@pytest.mark.parametrize(("samples", "denoiser", "words"), [
    (0, {}, "rested for 12 frames"),
    (13, {}, "rested for 12 frames"),
    (12, {}, "render more than 12 frames"),
    (1024, {"path_traced_rest": False}, "turn on path tracing at rest"),
    (9, {"rest_frames": 4}, "rested for 8 frames"),
])
def test_remedy_fits_the_settings(samples: int, denoiser: dict, words: str) -> None:
    """Tell when path tracing takes over, or what to change where it never does."""
    settings = dataclasses.replace(realtime(samples), denoiser=DenoiserSettings(**denoiser))
    entries = realtime_approximations(settings, EVERYTHING, 0.01).entries()
    assert len(entries) == 9 and all(words in entry.message for entry in entries), entries
