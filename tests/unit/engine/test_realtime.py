# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the real-time integrator as a whole: what is recorded anew and when, histories, the rest regime, its views."""

from dataclasses import replace

import numpy as np
import pytest
from burnish.engine.debug_views import DEBUG_VIEWS
from burnish.engine.passes.cache_spreading import LightPhase
from burnish.engine.passes.composite import LIGHT_PASSES
from burnish.engine.scene import LightKind, SceneDelta
from burnish.engine.session import Session
from burnish.engine.settings import (
    CacheSettings,
    DebugSettings,
    DenoiserSettings,
    FilmSettings,
    Integrator,
    SamplingSettings,
)

from tests import scenes

SIZE = (24, 16)
REALTIME = replace(
    scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=14))


def room(shift=0.0):
    """Make a floor, a box on it that may be shifted, and a lamp above."""
    meshes = {"floor": scenes.quad(3.0), "box": scenes.box(0.3)}
    objects = [("floor", scenes.place(), "white"), ("box", scenes.place(x=shift, z=0.3), "white")]
    return scenes.delta(
        meshes, objects, {"white": scenes.material(color=0.7)},
        [scenes.lamp(LightKind.POINT, 50.0, scenes.place(1.0, 1.0, 2.0), radius=0.2)], 0.2)


def camera(x=0.0):
    """Make a perspective camera above the room."""
    made = scenes.camera_above(3.0, 1.0, orthographic=False)
    transform = np.array(made.transform).reshape(4, 4)
    transform[0, 3] = x
    return replace(made, transform=tuple(transform.ravel()))


def session(settings=REALTIME, delta=None):
    """Open a session on the room."""
    made = Session(settings)
    made.update(delta or room())
    made.configure(settings, camera(), *SIZE)
    return made


def graphs_of(made):
    """Return the recorded frames."""
    graphs = made._realtime.pipeline._graphs
    return [graphs.get((parity, resting, phase, False)) for phase in LightPhase for resting in (False, True)
            for parity in (0, 1)]


def test_replay_with_another_camera():
    """Replay the recorded frames with another camera and get what frames recorded for it give."""
    moving, fresh = session(), session()
    moving.step(4)
    before = graphs_of(moving)
    moving.configure(REALTIME, camera(0.4), *SIZE)
    moving.step(2)
    assert graphs_of(moving) == before
    fresh.step(4)
    fresh._realtime.pipeline._forget_records()
    fresh.configure(REALTIME, camera(0.4), *SIZE)
    fresh.step(2)
    assert graphs_of(fresh) != before
    np.testing.assert_array_equal(moving.read(), fresh.read())


def test_moving_object_is_not_recorded_anew():
    """Move an object every frame and record only when it leaves the flattened structure."""
    made = session()
    made.step(4)
    recorded = []
    for i in range(1, 6):
        made.update(SceneDelta(instances=room(0.1 * i).instances))
        made.step(2)
        recorded.append(graphs_of(made))
    assert recorded[1] == recorded[2] == recorded[4]
    still = session(delta=room(0.5))
    still.step(64)
    made.step(64)
    assert np.abs(made.read()[..., :3] - still.read()[..., :3]).mean() < 0.02 * still.read()[..., :3].mean()


def test_rebuilt_structures_are_recorded_anew():
    """Record anew when the flattened triangles get a structure of their own, and draw what is there then."""
    made = session()
    made.step(4)
    before, address = [each for each in graphs_of(made) if each], made._scene.structures.opaque.wide.nodes.ptr
    grown = room()
    grown.meshes["box"] = scenes.sphere(0.3, 24)
    made.update(SceneDelta(meshes=grown.meshes, instances=replace(
        grown.instances, object_keys=["floor", "ball"])))
    assert made._scene.structures.opaque.wide.nodes.ptr != address
    made.step(64)
    assert before and not any(now is old for now in graphs_of(made) for old in before)
    fresh = session(delta=grown)
    fresh.step(64)
    assert np.abs(made.read()[..., :3] - fresh.read()[..., :3]).mean() < 0.02 * fresh.read()[..., :3].mean()


def test_frames_are_the_same_from_run_to_run():
    """Render the same frames twice and get the same bits."""
    pictures = []
    for _ in range(2):
        made = session()
        made.step(5)
        pictures.append(made.read())
    np.testing.assert_array_equal(*pictures)


def test_rest_goes_over_to_path_tracing():
    """Come to rest and trace paths, down to Reference's picture but for noise."""
    settings = replace(REALTIME, denoiser=DenoiserSettings(rest_frames=8))
    made = session(settings)
    made.step(8)
    assert made._realtime.reference.samples_done == 0
    filtered = made.read()
    made.step(1)
    assert made._realtime.reference.samples_done == 1
    # A sample says nothing yet.
    np.testing.assert_array_equal(made.read(), filtered)
    made.step(1015)
    truth = scenes.render(room(), camera(), SIZE, 1024)
    error = np.abs(made.read() - truth)[..., :3].mean() / truth[..., :3].mean()
    assert error < 0.01
    assert made.samples_done == 1024
    made.configure(settings, camera(0.1), *SIZE)
    assert made.samples_done == 0
    made.step(1)
    assert made._realtime.reference.samples_done == 0


def test_frames_and_samples_take_turns():
    """Start to trace paths when light has spread, in turns with frames up to their number, in steps of any size."""
    for step in (1, 5, 64):
        made = session(replace(REALTIME, denoiser=DenoiserSettings(rest_frames=32)))
        while made.samples_done < 8:
            made.step(min(step, 8 - made.samples_done))
        assert made._realtime.frames == 8
        while made.samples_done < 50:
            made.step(min(step, 50 - made.samples_done))
            ahead = made._realtime.frames - made._realtime.reference.samples_done
            assert 0 <= ahead <= 8
        made.step(50)
        assert (made._realtime.frames, made._realtime.reference.samples_done) == (32, 100 - 32)


@pytest.mark.slow
def test_limit_is_the_reference():
    """Rest for 16,384 frames and differ from Reference by no more than its own noise."""
    settings = replace(REALTIME, denoiser=DenoiserSettings(rest_frames=64))
    made = session(settings)
    made.step(16384)
    one = scenes.render(room(), camera(), SIZE, 16384)
    other = scenes.render(room(), camera(), SIZE, 16384, replace(
        scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REFERENCE, seed=7)))
    noise = np.sqrt(np.mean((one - other)[..., :3] ** 2))
    assert np.sqrt(np.mean((made.read() - one)[..., :3] ** 2)) < 2.0 * noise


def test_every_debug_view_draws():
    """Choose each debug view without losing history and get a finite picture unlike the usual one."""
    made = session()
    made.step(3)
    usual = made.read()
    frames = made._realtime.views.frame
    for name in DEBUG_VIEWS:
        if name == "rest.weight":
            continue
        settings = replace(REALTIME, debug=DebugSettings(view=name))
        made.configure(settings, camera(), *SIZE)
        made.step(1)
        picture = made.read()
        assert np.isfinite(picture).all(), name
        assert not np.array_equal(picture, usual), name
        frames += 1
        assert made._realtime.views.frame == frames, name


def test_light_passes_make_up_the_picture():
    """Read the light passes and put the picture together from them, as Blender's compositor does."""
    made = Session(REALTIME)
    delta = room()
    delta.materials = {"white": scenes.material(
        "PRINCIPLED", color=0.7, roughness=0.4, ior=1.5, specular_level=0.5, specular_tint=1.0, transmission=0.3)}
    made.update(delta)
    made.configure(REALTIME, camera(), *SIZE, passes=("Combined", *LIGHT_PASSES, "Depth"))
    made.step(64)
    total = 0.0
    for lobe in ("Diffuse", "Glossy", "Transmission"):
        direct, indirect, color = (made.read(f"{lobe} {part}") for part in ("Direct", "Indirect", "Color"))
        assert (color.mean() > 0.01) and (lobe == "Transmission" or direct.any()) and indirect.any(), lobe
        total = total + (direct + indirect) * color
    combined = made.read()[..., :3]
    assert np.abs(total - combined).mean() < 0.02 * combined.mean()
    assert (made.read("Depth") < 4.0).all()


def test_exposure_scales_the_picture():
    """Expose a thousandfold brighter and darker and get the same picture, scaled."""
    usual = session()
    usual.step(8)
    for factor in (1e-3, 1e3):
        settings = replace(REALTIME, film=replace(FilmSettings(), exposure=factor,
                                                  pixel_filter=REALTIME.film.pixel_filter))
        made = session(settings)
        made.step(8)
        np.testing.assert_allclose(made.read()[..., :3].mean(), usual.read()[..., :3].mean() * factor, rtol=0.01)


def test_resize_and_crop():
    """Change size and border and get finite pictures of the new size."""
    made = session()
    made.step(2)
    made.configure(REALTIME, camera(), 33, 17, crop=(5, 3, 20, 11))
    made.step(2)
    picture = made.read()
    assert picture.shape == (11, 20, 4)
    assert np.isfinite(picture).all()
