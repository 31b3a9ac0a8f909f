# SPDX-License-Identifier: GPL-3.0-or-later
"""Prove that frames do without what a scene lacks, by counting recorded launches, buffers and rays; never by timing."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import warp as wp
from burnish.engine.passes.cache_spreading import SWEEPS, LightPhase
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import MaterialData, SceneDelta, WorldData
from burnish.engine.session import Session
from burnish.engine.settings import CacheSettings, Device, Integrator, SamplingSettings
from burnish.kernels.cache_spread import SWEEP_FRAMES

from tests import scenes
from tests.glossy_scenes import glass, glossy, metal
from tests.hair_scenes import hair
from tests.light_scenes import look_at

SIZE = (24, 16)
SETTINGS = replace(
    scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=12))
MATTE = scenes.material(color=0.6)
COATED = glossy(color=0.5, roughness=0.7, coat=1.0, coat_roughness=0.1)
LAMP = scenes.lamp("POINT", 60.0, scenes.place(1.0, -1.0, 2.5), radius=0.2)


def wax():
    """Make a material that scatters light below its surface."""
    return scenes.material(
        "PRINCIPLED", color=0.8, roughness=0.5, ior=1.5, subsurface=1.0, subsurface_ior=1.4, subsurface_radius=0.2,
        subsurface_method="WALK")


def textured_emitter():
    """Make a material whose emission varies over its surface."""
    builder = ProgramBuilder()
    builder.emit((1.0, 1.0, 1.0), builder.component(builder.uv(""), 0), 1.0)
    return MaterialData(name="textured", program=builder.finish(), has_emission=True)


def sunny(strength):
    """Make a world that is dark but for a small sun of a radiance; even where that is 0."""
    builder = ProgramBuilder()
    up = builder.math("GREATER_THAN", builder.component(builder.input("POSITION"), 2), 0.95)
    builder.emit((1.0, 1.0, 1.0), builder.math("MULTIPLY", up, strength), 1.0)
    builder.emit((0.2, 0.2, 0.2), 1.0, 1.0)
    return WorldData(name="sunny", program=builder.finish(), importance_resolution=64)


def room(box=MATTE, lights=(LAMP,), background=0.2):
    """Make a matte floor with a ball on it."""
    return scenes.delta(
        {"floor": scenes.quad(3.0), "ball": scenes.sphere(0.5, 12)},
        [("floor", scenes.place(), "floor"), ("ball", scenes.place(z=0.5), "ball")],
        {"floor": MATTE, "ball": box}, lights, background)


def ball(material):
    """Make the edit that gives the ball a material."""
    return SceneDelta(materials={"ball": material})


@dataclass(frozen=True)
class Feature:
    """Something that a scene has or lacks."""

    skip: str
    """Under which name the timing panel tells that it is left out"""
    add: SceneDelta
    remove: SceneDelta
    kernels: tuple[str, ...] = ()
    """Parts of names of kernels that nothing else needs"""
    sections: tuple[str, ...] = ()
    rays: tuple[str, ...] = ()
    """What pipeline.counts() has of it"""
    scene: SceneDelta | None = None
    """Without it"""


FEATURES = {
    "glossy reflections": Feature(
        "reflections", ball(metal(0.3)), ball(MATTE), ("start_reflections", "look_up_probes", "resolve_glossy"),
        ("Reflection rays", "Reflection denoising"), ("reflection rays",)),
    "a coat": Feature(
        "reflections", ball(COATED), ball(MATTE), ("start_reflections",), ("Reflection rays",),
        ("reflection rays",)),
    "glass": Feature(
        "refraction", ball(glass(0.1)), ball(MATTE), ("start_refractions",),
        ("Refraction rays", "Refraction denoising"), ("refraction rays",)),
    "a mirror": Feature(
        "chains of mirrors", ball(metal(0.0)), ball(metal(0.4)), ("_further",), scene=room(metal(0.4))),
    "highlights in mirrors": Feature(
        "highlights in mirrors", ball(metal(0.4)), ball(metal(0.1)), ("choose_glossy_lights", "resolve_glossy"),
        scene=room(metal(0.1))),
    "highlights of lights": Feature(
        "highlights in mirrors", SceneDelta(lights=[LAMP]), SceneDelta(lights=[]), ("choose_glossy", "resolve_glossy"),
        scene=room(metal(0.4), lights=(), background=0.0)),
    "transparency": Feature(
        "alpha layers", ball(scenes.transparent(0.5, color=0.5)), ball(MATTE),
        ("layer" if SETTINGS.device == Device.CPU else "veil", "filter_primary")),
    "an emissive mesh": Feature(
        "emissive meshes", ball(scenes.emitter(5.0)), ball(MATTE), ("bake_emitters",), ("Direct light",),
        ("direct shadow rays",), room(lights=())),
    "textured emission": Feature(
        "light programs", ball(textured_emitter()), ball(MATTE), ("shade_lights", "finish_cache_lights")),
    "lamps": Feature(
        "lamps in view", SceneDelta(lights=[LAMP]), SceneDelta(lights=[]), ("add_lamps", "resample_lights"),
        ("Direct light", "Direct shadows", "Direct denoising"), ("direct shadow rays",), room(lights=())),
    "a sun in the world": Feature(
        "sun in the world", SceneDelta(world=sunny(1e4)), SceneDelta(world=sunny(0.0)), ("resample_lights",),
        ("Direct light", "Direct shadows", "Direct denoising"), ("direct shadow rays",),
        room(lights=(), background=sunny(0.0))),
    "a world that varies": Feature(
        "", SceneDelta(world=sunny(0.0)), SceneDelta(world=scenes.world(0.2)), ("shade_primary",)),
    "any light": Feature(
        "shadow rays of hits", SceneDelta(world=scenes.world(0.3)), SceneDelta(world=scenes.world(0.0)),
        ("choose_cache_lights", "cache_shadows"), ("Cache lights", "Cache shadow rays"), ("cache shadow rays",),
        room(lights=(), background=0.0)),
    "light below surfaces": Feature(
        "walks below surfaces", ball(wax()), ball(MATTE),
        ("note_scattering", "enter_surfaces", "walk_below", "settle_walks", "go_on_outside", "add_seen_light"),
        ("Refraction walks", "Refraction denoising"), ("refraction rays",)),
    "light in hair": Feature(
        "hair", ball(hair()), ball(MATTE),
        ("find_hair", "enter_lean_hair", "scatter_in_lean_hair", "follow_lean_hair", "leave_hair", "average_hair",
         "spread_hair", "show_hair"),
        ("Hair rays", "Hair denoising"), ("hair rays",)),
    "light of other shapes": Feature(
        "lobes of other shapes", ball(scenes.material("DIFFUSE", color=0.5, roughness=0.5)), ball(MATTE),
        ("shape_direct",)),
    "materials beyond the lean machine": Feature(
        "full node machine", ball(scenes.material("GLOSSY", color=0.5, roughness=0.8)), ball(MATTE),
        ("shade_primary", "evaluate_cache_materials")),
}


def open_session(delta):
    """Open a session on a scene and render a frame of motion and some at rest."""
    made = Session(SETTINGS)
    made.update(delta)
    made.configure(SETTINGS, look_at((0.2, -2.6, 1.6), (0.0, 0.0, 0.4), SIZE, 1.0), *SIZE)
    made.step(5)
    return made


def edit(made, delta):
    """Take in an edit, and render a frame of motion and some at rest."""
    made.update(delta)
    made.step(5)
    return made


def recorded(made):
    """Return the names of all kernels and sections with launches in the recorded frames of motion."""
    steps = [step for (_, resting, *_), (graph, *_) in made._realtime.pipeline._graphs.items() if not resting
             for step in graph._steps if step.launches]
    assert len(steps) > 40
    return {step.kernel for step in steps}, {step.section for step in steps}


def is_there(feature, made):
    """Return whether anything of a feature, and whether all of it, is recorded and counted."""
    kernels, sections = recorded(made)
    found = [any(part in name for name in kernels) for part in feature.kernels]
    found += [name in sections for name in feature.sections]
    counts = made.counts()
    found += [counts.get(name, 0) > 0 for name in feature.rays]
    return any(found), all(found)


@pytest.mark.parametrize("name", FEATURES)
def test_what_a_scene_lacks_has_no_launches(name):
    """Record no launch, and trace no ray, for what is not there; bring it back when an edit needs it, and drop it."""
    feature = FEATURES[name]
    made = open_session(feature.scene or room())
    assert not is_there(feature, made)[0]
    assert not feature.skip or feature.skip in made.skipped
    edit(made, feature.add)
    assert is_there(feature, made)[1] and feature.skip not in made.skipped
    edit(made, feature.remove)
    assert not is_there(feature, made)[0]
    assert not feature.skip or feature.skip in made.skipped


def test_an_edit_brings_the_right_picture():
    """Show a metal ball after an edit as if it had been there from the start, with the light of now."""
    made = open_session(room())
    edit(made, ball(metal(0.2)))
    edit(made, ball(MATTE))
    edit(made, SceneDelta(lights=[]))
    edit(made, SceneDelta(lights=[LAMP], materials={"ball": metal(0.2)}))
    fresh = open_session(room(metal(0.2)))
    pictures = []
    for each in (made, fresh):
        each.step(59)
        pictures.append(each.read()[..., :3])
    difference = np.abs(pictures[0] - pictures[1])
    assert difference.mean() < 0.03 * pictures[1].mean()
    other = open_session(room())
    other.step(59)
    assert np.abs(other.read()[..., :3] - pictures[1]).mean() > 3.0 * difference.mean()


def test_what_a_scene_lacks_has_no_buffers():
    """Give buffers to passes that the scene needs alone."""
    pipeline = open_session(room(lights=()))._realtime.pipeline
    idle = (pipeline.reflections, pipeline.reflection_denoise, pipeline.refraction, pipeline.refraction_denoise,
            pipeline.direct, pipeline.direct_denoise, pipeline.fog, pipeline.hair)
    assert [each.width for each in idle] == [0] * len(idle)
    assert pipeline.gbuffer.width == SIZE[0] and pipeline.gather.width == SIZE[0]
    pipeline = open_session(room(glass(0.0)))._realtime.pipeline
    assert all(each.width == SIZE[0] for each in pipeline.passes
               if each not in (pipeline.fog, pipeline.hair, pipeline.depth_of_field))
    assert pipeline.fog.width == 0


def test_only_materials_on_something_count():
    """Take no notice of materials that nothing drawn has, nor of those of objects that are gone."""
    delta = room(glass(0.0))
    delta.materials["unused"] = scenes.transparent(0.5, "GLOSSY", color=0.5, roughness=0.1)
    made = open_session(delta)
    assert "refraction" not in made.skipped and "alpha layers" in made.skipped
    # A slot that no triangle has.
    table = scenes.instances([("floor", scenes.place(), "floor")])
    table.material_sets = [("floor", "ball", "unused")]
    edit(made, SceneDelta(instances=table))
    assert {"reflections", "refraction", "alpha layers", "chains of mirrors", "full node machine"} <= set(made.skipped)
    assert not any("refract" in name or "further" in name for name in recorded(made)[0])


def test_matte_scenes_have_fewer_launches():
    """Record half of the launches or fewer where nothing reflects, refracts, shines or lets light through.

    Sweeps from cell to cell aside, which the first frames of all scenes have.
    """
    everything = room(glass(0.0))
    everything.materials["floor"] = scenes.transparent(0.3, "GLOSSY", color=0.5, roughness=0.2)
    counts = [
        sum(bool(step.launches) and step.kernel not in ("spread_cells", "spread_light")
            for step in graphs[0, False, LightPhase.SWEEPING, False][0]._steps)
        for graphs in (open_session(delta)._realtime.pipeline._graphs for delta in (room(lights=()), everything))]
    assert counts[0] < 0.5 * counts[1], counts


def test_nothing_is_copied_while_nothing_moves(monkeypatch):
    """Send no transforms and no positions to the device in frames in which no object has moved."""
    sent = []
    copy = wp.copy

    def noted_copy(target, *arguments, **more):
        sent.append(target.ptr)
        copy(target, *arguments, **more)

    monkeypatch.setattr(wp, "copy", noted_copy)
    made = open_session(room())
    tracker = made._realtime.pipeline.motion

    def copies():
        kept = {tracker.motion.previous_to_world.ptr, tracker.motion.previous_positions.ptr}
        return [each for each in sent if each in kept]

    sent.clear()
    made.configure(SETTINGS, look_at((0.3, -2.6, 1.6), (0.0, 0.0, 0.4), SIZE, 1.0), *SIZE)
    made.step(3)
    assert copies() == []
    moved = room().instances
    moved.transforms[1, 0, 3] += 0.1
    edit(made, SceneDelta(instances=moved))
    assert copies()


def test_frames_at_rest_are_the_only_ones_to_gather():
    """Record the final gather for frames at rest alone."""
    made = open_session(room())
    graphs = made._realtime.pipeline._graphs
    for (_, resting, *_), (graph, *_) in graphs.items():
        assert any(step.section.startswith("Final gather") for step in graph._steps) == resting
    assert {resting for _, resting, *_ in graphs} == {False, True}


def test_light_sweeps_only_after_edits():
    """Record sweeps of light from cell to cell for the first frames, and for those after an edit of the light."""
    made = open_session(room())
    pipeline = made._realtime.pipeline

    def sweeps():
        return sum(kernel == "spread_cells" for _, kernel in pipeline.launches())

    assert sweeps() == SWEEPS
    for frame in range(int(SWEEP_FRAMES)):
        made.configure(SETTINGS, look_at((0.3 + 0.01 * frame, -2.6, 1.6), (0.0, 0.0, 0.4), SIZE, 1.0), *SIZE)
        made.step(1)
    assert sweeps() == 0
    edit(made, SceneDelta(lights=(replace(LAMP, color=(30.0, 30.0, 30.0)),)))
    assert sweeps() == SWEEPS
