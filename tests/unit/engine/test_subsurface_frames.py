# SPDX-License-Identifier: GPL-3.0-or-later
"""Light below surfaces in real-time frames: the path tracer's light, from the backs of things too, and no more."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.scene import CameraData
from burnish.engine.session import Session
from burnish.engine.settings import ReflectionSettings

from tests import scenes
from tests.light_checks import Setup
from tests.light_scenes import LitScene, look_at
from tests.unit.engine.test_subsurface import wax

SIZE = (64, 48)
FAR = (0.5, 0.15, 0.05)
NEAR = (0.1, 0.03, 0.01)
BEHIND, BEFORE = (0.5, 2.5, 1.5), (2.0, -1.0, 2.0)
MATTE = {"reflections": {"subsurface": False}}


def lit(radius, place=BEFORE, mesh=None, **arguments) -> LitScene:
    """Make a body of wax on a floor, a lamp before or behind it."""
    materials = {"wax": wax((0.8, 0.5, 0.4), radius, **arguments), "floor": scenes.material(color=0.5)}
    lamp = scenes.lamp("POINT", 120.0, scenes.place(*place), radius=0.2)
    return LitScene(scenes.delta(
        {"floor": scenes.quad(6.0), "body": mesh or scenes.sphere(0.5, 32)},
        [("floor", scenes.place(), "floor"), ("body", scenes.place(z=0.5), "wax")], materials, [lamp], 0.1), camera())


def camera(x: float = 0.0) -> CameraData:
    """Return a camera that looks at the body."""
    return look_at((x, -4.0, 1.5), (0.0, 0.0, 0.5), SIZE, 0.45)


def slab():
    """Make an upright slab of a twentieth of its breadth."""
    mesh = scenes.box(1.0)
    mesh.positions[:, 1] *= 0.05
    return mesh


def body_light(scene: LitScene, frames: int, **groups) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean light of the body's pixels, of frames alone and of path tracing: [3] each."""
    setup = Setup(SIZE, truth_samples=192, groups=groups)
    body = setup.positions(scene)[..., 2] > 0.04
    return setup.picture(scene, frames)[body].mean(0), setup.truth(scene)[body].mean(0)


@pytest.mark.slow
@pytest.mark.parametrize(("radius", "place", "mesh", "error", "matte"), [
    pytest.param(FAR, BEFORE, None, 0.1, 0.15, id="ball"),
    pytest.param(FAR, BEHIND, None, 0.1, 0.6, id="ball lit from behind"),
    pytest.param(NEAR, BEHIND, None, 0.1, 0.25, id="less far"),
    pytest.param(FAR, BEHIND, slab(), 0.12, 0.8, id="slab lit from behind"),
])
def test_bodies_have_the_light_of_path_tracing(radius, place, mesh, error, matte) -> None:
    """Bring the light that walks bring; drawn as diffuse, bodies are off by far more."""
    scene = lit(radius, place, mesh)
    found, expected = body_light(scene, 32)
    assert found == pytest.approx(expected, rel=error)
    diffuse, _ = body_light(scene, 32, **MATTE)
    assert np.abs(diffuse / expected - 1.0).max() > matte


@pytest.mark.slow
@pytest.mark.parametrize("method", ["LEGACY", "SKIN"])
def test_methods_and_anisotropy_count(method) -> None:
    """Follow the media of all methods, and light that is scattered forward."""
    # The legacy walk's distances are 1 / 4 pi of the radius.
    radius = FAR if method == "SKIN" else tuple(6.0 * r for r in FAR)
    found, expected = body_light(lit(radius, method=method, anisotropy=0.5), 32)
    assert found == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("radius", [2e-3, 0.03, 0.2])
@pytest.mark.parametrize("method", ["WALK", "LEGACY", "SKIN"])
def test_planes_return_what_walks_bring(radius, method) -> None:
    """Return what a plane does in path tracing, within a pixel, by the profile and by walks: less than if diffuse."""
    distance = radius * 4.0 * np.pi if method == "LEGACY" else radius
    delta = scenes.delta({"body": scenes.box(5.0)}, [("body", np.eye(4), "wax")],
                         {"wax": wax((0.2, 0.5, 0.8), distance, method)}, background=1.0)
    scene = LitScene(delta, scenes.camera_above(height=10.0, half=0.5))
    setup = Setup((32, 32), truth_samples=64)
    expected = setup.truth(scene).mean((0, 1))
    assert setup.picture(scene, 24).mean((0, 1)) == pytest.approx(expected, rel=0.03)
    assert (expected < (0.19, 0.48, 0.8)).all()


def test_a_white_body_makes_no_light() -> None:
    """Return no more of an even white world than arrives, after many frames too."""
    delta = scenes.delta({"body": scenes.sphere(1.0, 24)}, [("body", np.eye(4), "wax")],
                         {"wax": wax(1.0, 0.2)}, background=1.0)
    scene = LitScene(delta, scenes.camera_above(half=0.6))
    picture = Setup((24, 24)).picture(scene, 96)
    # A third of the walks end outside of the picture, by chance.
    np.testing.assert_allclose(picture.mean((0, 1)), 1.0, atol=0.03)
    assert np.quantile(picture, 0.95) < 1.15


def test_colour_stays_at_the_surface() -> None:
    """Keep a pattern of colours sharp: light takes its colour where it comes out."""
    materials = {"red": wax((0.8, 0.1, 0.1), 0.3), "blue": wax((0.1, 0.1, 0.8), 0.3)}
    left, right = (scenes.box(1.0) for _ in range(2))
    left.positions[:, 0] -= 1.0
    right.positions[:, 0] += 1.0
    delta = scenes.delta({"left": left, "right": right}, [("left", np.eye(4), "red"), ("right", np.eye(4), "blue")],
                         materials, background=1.0)
    picture = Setup((48, 16)).picture(LitScene(delta, scenes.camera_above(half=0.5)), 16)
    red, blue = picture[:, 8:23].mean(0), picture[:, 25:40].mean(0)
    assert (red[..., 0] > 2.0 * red[..., 2]).all() and (blue[..., 2] > 2.0 * blue[..., 0]).all()


@pytest.mark.slow
def test_a_moving_camera_keeps_the_light() -> None:
    """Show a body lit from behind with its light while the camera pans, and without sparks."""
    scene = lit(FAR, BEHIND)
    setup = Setup(SIZE, truth_samples=192)
    settings = setup.settings()
    session = Session(settings)
    session.update(scene.delta)
    for frame in range(24):
        session.configure(settings, camera(0.02 * (frame - 23)), *SIZE)
        session.step(1)
    picture, truth = session.read()[..., :3], setup.truth(scene)
    body = setup.positions(scene)[..., 2] > 0.04
    assert picture[body].mean(0) == pytest.approx(truth[body].mean(0), rel=0.08)
    assert picture[body].max() < 3.0 * truth[body].max()


@pytest.mark.slow
@pytest.mark.parametrize("changes", [
    {"subsurface_radius": (np.nan, 0.1, np.inf)}, {"subsurface_radius": (-1.0, 1e30, 1e-30)},
    {"subsurface_anisotropy": np.nan}, {"color": (np.inf, -1.0, 1e9)}, {"roughness": np.nan}], ids=str)
def test_no_input_makes_a_bad_pixel(changes) -> None:
    """Stay finite, and not negative, whatever the sockets say."""
    scene = lit(NEAR)
    scene.delta.materials["wax"] = wax(
        changes.get("color", 0.8), 0.2, **{name: value for name, value in changes.items() if name != "color"})
    for frames in (1, 3):
        picture = Setup(SIZE).picture(scene, frames)
        assert np.isfinite(picture).all() and picture.min() >= 0.0


def test_open_meshes_end_walks() -> None:
    """Draw a plane of wax, which encloses nothing: dimmer than if it did, and finite."""
    picture = Setup(SIZE).picture(lit(FAR, mesh=scenes.quad(0.6)), 4)
    assert np.isfinite(picture).all() and picture.min() >= 0.0


@pytest.mark.slow
def test_an_edit_reaches_what_is_below() -> None:
    """Show another radius after an edit as from the start, with all records made anew."""
    scene, other = lit(NEAR, BEHIND), lit(FAR, BEHIND)
    setup = Setup(SIZE)
    session = setup.session(scene)
    session.step(8)
    session.update(dataclasses.replace(
        scenes.delta({}, [], {}), full=False, instances=None, meshes={}, lights=None, world=None,
        materials={"wax": other.delta.materials["wax"]}))
    session.step(32)
    body = setup.positions(scene)[..., 2] > 0.04
    expected = setup.picture(other, 32)[body].mean(0)
    assert session.read()[..., :3][body].mean(0) == pytest.approx(expected, rel=0.05)
    assert ReflectionSettings().subsurface
