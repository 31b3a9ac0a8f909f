# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoramic cameras through a session: path-traced by both integrators, black around fisheyes, depth along the ray."""

import math
from dataclasses import replace

import numpy as np
import pytest
from burnish.engine.pass_names import OCCLUSION
from burnish.engine.passes.composite import LIGHT_PASSES
from burnish.engine.report import ReportKind
from burnish.engine.report_realtime import SceneFacts, realtime_approximations
from burnish.engine.scene import CameraData, CameraKind, MistData
from burnish.engine.session import Session
from burnish.engine.settings import CacheSettings, DebugSettings, Integrator, SamplingSettings

from tests import scenes

REALTIME = replace(
    scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=12))
SIZE = (32, 16)
FISHEYE = CameraData(kind=CameraKind.FISHEYE_EQUIDISTANT, fov=3.0, window=(-1.5, 1.5, -1.5, 1.5), clip_start=1e-3)
AROUND = CameraData(kind=CameraKind.EQUIRECTANGULAR, clip_start=1e-3,
                    window=(-math.pi, math.pi, -0.5 * math.pi, 0.5 * math.pi))
PASSES = ("Combined", "Depth", "Normal", "Position", "Mist", "Vector", OCCLUSION, "CryptoObject00", *LIGHT_PASSES)


def box_room(background=0.3):
    """Return a scene seen from within a cube of half side 1, lit by its walls and by the sky through a window."""
    delta = scenes.delta({"box": scenes.box(1.0, inward=True), "veil": scenes.quad(0.3)},
                         [("box", np.eye(4), "wall"), ("veil", scenes.place(z=-0.5), "veil")],
                         {"wall": scenes.material(color=0.5, emission=(0.2, 0.3, 0.4)),
                          "veil": scenes.transparent(0.5)},
                         background=background)
    delta.world = replace(delta.world, mist=MistData(start=0.0, depth=2.0, falloff=1.0), occlusion_distance=0.3)
    return delta


def opened(delta, camera, settings=scenes.SETTINGS, size=SIZE, passes=("Combined",), crop=None, samples=4):
    """Return a session that has rendered."""
    session = Session(settings)
    session.update(delta)
    session.configure(settings, camera, *size, crop=crop, passes=passes)
    session.step(samples)
    return session


def outside(size=SIZE):
    """Return which pixels lie wholly outside of FISHEYE's circle, and which wholly inside."""
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    radius = np.hypot(3.0 * x / size[0] - 1.5, 3.0 * y / size[1] - 1.5)
    return radius > 1.5 + 0.13, radius < 1.5 - 0.13


@pytest.mark.parametrize("transparent", [False, True])
def test_fisheye_is_black_outside_of_its_circle(transparent):
    """Show the sky within the circle and black around it, transparent with a transparent film."""
    settings = replace(scenes.SETTINGS, film=replace(scenes.SETTINGS.film, transparent=transparent))
    delta = scenes.delta({"floor": scenes.quad(0.1)}, [("floor", scenes.place(z=-1.0), "floor")],
                         {"floor": scenes.material(color=0.0)}, background=1.0)
    picture = opened(delta, FISHEYE, settings).read()
    beyond, within = outside()
    assert (picture[beyond] == (0.0, 0.0, 0.0, 0.0 if transparent else 1.0)).all()
    sky = np.median(picture[within], axis=0)
    assert sky == pytest.approx((0.0, 0.0, 0.0, 0.0) if transparent else (1.0, 1.0, 1.0, 1.0), abs=1e-5)


def test_both_integrators_make_the_same_passes():
    """Trace paths alone with the real-time integrator: a sample a frame, no pipeline, bit for bit the same passes."""
    pictures = []
    for settings in (scenes.SETTINGS, REALTIME):
        session = opened(box_room(), FISHEYE, settings, passes=PASSES)
        assert session.pipeline is None and session.samples_done == 4
        pictures.append({name: session.read(name) for name in PASSES})
    assert all(np.array_equal(pictures[0][name], pictures[1][name]) for name in PASSES)
    light = pictures[0]
    total = sum(light[f"{lobe} Color"] * (light[f"{lobe} Direct"] + light[f"{lobe} Indirect"])
                for lobe in ("Diffuse", "Glossy", "Transmission"))
    assert total[light["Depth"][..., 0] < 1e9].max() > 0.05


def test_frames_come_back_with_another_camera():
    """Go over to real-time frames when the camera is perspective again, and to samples when it is not."""
    session = opened(box_room(), AROUND, REALTIME, samples=1)
    window = CameraData(clip_start=1e-3)
    session.configure(REALTIME, window, *SIZE)
    session.step(1)
    assert session.pipeline is not None and np.isfinite(session.read()).all()
    session.configure(REALTIME, AROUND, *SIZE)
    session.step(1)
    assert session.pipeline is None and session.samples_done == 1


def test_first_surfaces_around_the_camera():
    """Know how far the walls are along the rays, where they are, and which way they face."""
    session = opened(box_room(), AROUND, passes=("Combined", "Depth", "Position", "Normal", "Mist"), samples=16)
    depth, position, normal = (session.read(name) for name in ("Depth", "Position", "Normal"))
    assert depth[..., 0] == pytest.approx(np.linalg.norm(position, axis=2), abs=1e-5), "the distance along the ray"
    walls = np.abs(position).max(2) > 0.999
    assert walls.mean() > 0.8 and depth.min() >= 0.5 - 1e-4 and depth.max() <= math.sqrt(3.0)
    # The middle of the left wall, a quarter of the way round: face and mist are even there.
    assert normal[8, 8] == pytest.approx([1.0, 0.0, 0.0], abs=1e-3)
    assert session.read("Mist")[8, 8, 0] == pytest.approx(0.5, abs=0.05)


def test_nothing_is_known_outside_of_the_circle():
    """Leave the passes of first surfaces as they are without a surface, and so what guides the denoiser."""
    session = opened(box_room(), FISHEYE, passes=PASSES)
    beyond, within = outside()
    assert (session.read("Depth")[beyond] >= 1e9).all() and (session.read("Depth")[within] < 2.0).all()
    for name in ("Normal", "Position", "Vector", OCCLUSION, "CryptoObject00", "Diffuse Color"):
        found = session.read(name)
        assert (found[beyond] == 0.0).all(), name
        assert name == "Vector" or np.abs(found[within]).max(1).min() > 0.0, name
    albedo, normal = (each.numpy().reshape(16, 32, 3) for each in session.guides())
    assert (albedo[beyond] == 0.0).all() and (normal[beyond] == 0.0).all()
    # A guide sample of a pixel at the edge may lie outside.
    assert (albedo[within].min(1) > 0.1).mean() > 0.9 and (np.linalg.norm(normal[within], axis=1) > 0.3).mean() > 0.9


def test_batches_do_not_mix():
    """Forget what the slots of paths outside of the circle held before, which had met something."""
    names = ("Combined", "Emission", "Environment", "Combined_sky", "Combined_lamp", *LIGHT_PASSES)
    delta = box_room()
    del delta.meshes["box"]
    delta.instances = scenes.instances([("veil", scenes.place(z=-0.5), "veil")])
    delta.lights = [scenes.lamp("POINT", 20.0, scenes.place(x=0.5, y=0.3, z=-0.3), radius=0.1, light_group="lamp")]
    delta.world = replace(delta.world, light_group="sky")
    session = opened(delta, AROUND, passes=names)
    assert session.read("Combined_sky").max() > 0.2 and session.read("Combined_lamp").max() > 0.2
    session.configure(scenes.SETTINGS, FISHEYE, *SIZE, passes=names)
    for _ in range(4):
        session.step(1)
    fresh = opened(delta, FISHEYE, passes=names)
    beyond, _ = outside()
    for name in names:
        assert np.array_equal(session.read(name), fresh.read(name)), name
        assert not session.read(name)[beyond][:, :3].any(), name


def test_regions_are_parts_of_the_picture():
    """Render a border as the same pixels have it in the whole picture."""
    whole = opened(box_room(), AROUND).read()
    assert np.array_equal(opened(box_room(), AROUND, crop=(5, 3, 11, 7)).read(), whole[3:10, 5:16])


def test_report_names_it_once():
    """Say that panoramas are path-traced, and nothing of what frames approximate."""
    facts = SceneFacts(reflective=(0.9,))
    entry, = realtime_approximations(REALTIME, facts, 0.1, panoramic=True).entries()
    assert (entry.kind, entry.owner, entry.message) == (ReportKind.INFO, "", "panoramic cameras are path-traced")
    shown = replace(REALTIME, debug=DebugSettings(view="gbuffer.normal"))
    entry, = realtime_approximations(shown, facts, 0.1, panoramic=True).entries()
    assert "without debug views" in entry.message
    assert not realtime_approximations(scenes.SETTINGS, facts, 0.1, panoramic=True).counts


@pytest.mark.parametrize(("name", "reported"), [("WINDOW", True), ("GENERATED", False)])
def test_window_coordinates_are_reported(name, reported):
    """Tell where a material looks at the film, which a panorama has no window for."""
    from burnish.engine.program import ProgramBuilder
    from burnish.engine.scene import MaterialData

    builder = ProgramBuilder()
    builder.closure("DIFFUSE", 1.0, color=builder.input(name))
    delta = scenes.delta({"floor": scenes.quad(1.0)}, [("floor", scenes.place(z=-1.0), "floor")],
                         {"floor": MaterialData(name="floor", program=builder.finish())})
    session = opened(delta, AROUND, samples=1)
    assert any("Window" in entry.message for entry in session.report.entries()) == reported
    session.configure(scenes.SETTINGS, CameraData(), *SIZE)
    assert not any("Window" in entry.message for entry in session.report.entries())
