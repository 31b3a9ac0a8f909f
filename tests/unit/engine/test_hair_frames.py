# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair in real-time frames: the path tracer's light, through strands too, all of it, and none where it has gone off."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from burnish.engine.lean import is_lean_strand
from burnish.engine.scene import SceneDelta

from tests import scenes
from tests.hair_scenes import fur, hair
from tests.light_checks import Setup
from tests.light_scenes import LitScene, look_at

SIZE = (64, 48)
WHITE, PALE, BROWN, BLACK = (0.0, 0.0, 0.0), (0.02, 0.03, 0.06), (0.1, 0.2, 0.5), (0.8, 1.0, 1.3)
COLORS = {WHITE: 0.9, PALE: (0.45, 0.38, 0.26), BROWN: (0.17, 0.08, 0.02), BLACK: 0.01}
BEFORE, BEHIND = (1.5, -3.0, 2.0), (0.5, 3.0, 1.5)
SURFACES = {"reflections": {"hair": False}}


MESHES = {"fur": fur(), "ball": scenes.sphere(0.4, 24)}
OBJECTS = [("fur", scenes.place(), "hair"), ("ball", scenes.place(), "skin")]


def materials(absorption):
    """Make hair and the skin below it."""
    return {"hair": hair(absorption, COLORS[absorption]), "skin": scenes.material(color=0.02)}


@functools.cache
def furry(absorption, place=None, background=0.0):
    """Make a ball of hair before a lamp, or behind it, or in an even world."""
    lamps = () if place is None else (scenes.lamp("POINT", 150.0, scenes.place(*place), radius=0.2),)
    return LitScene(scenes.delta(MESHES, OBJECTS, materials(absorption), lamps, background), camera())


def camera(x=0.0):
    """Return a camera that looks at the ball."""
    return look_at((x, -4.0, 0.3), (0.0, 0.0, 0.0), SIZE, 0.5)


def inside(scene):
    """Return which pixels show nothing but hair: bool [h, w]."""
    rows, columns = np.mgrid[:SIZE[1], :SIZE[0]]
    return np.hypot(columns - SIZE[0] / 2 + 0.5, rows - SIZE[1] / 2 + 0.5) < 22


def light(scene, frames, **groups):
    """Return the mean light of the hair, of frames alone and of path tracing: [3] each."""
    setup = Setup(SIZE, truth_samples=512, groups=groups)
    where = inside(scene)
    return setup.picture(scene, frames)[where].mean(0), setup.truth(scene)[where].mean(0)


@pytest.mark.slow
@pytest.mark.parametrize(("absorption", "place", "surface"), [
    pytest.param(PALE, BEFORE, 0.1, id="pale"),
    pytest.param(BROWN, BEFORE, 0.25, id="brown"),
    pytest.param(BLACK, BEFORE, 0.4, id="black"),
    pytest.param(PALE, BEHIND, 0.5, id="pale lit from behind"),
    pytest.param(BROWN, BEHIND, 0.7, id="brown lit from behind"),
])
def test_hair_has_the_light_of_path_tracing(absorption, place, surface) -> None:
    """Bring the light that strands scatter; drawn as surfaces, hair is off by far more."""
    scene = furry(absorption, place)
    ours, truth = light(scene, 32)
    np.testing.assert_allclose(ours, truth, rtol=0.14)
    matte, _ = light(scene, 32, **SURFACES)
    assert np.abs(matte / truth - 1.0).max() > surface


def test_white_hair_in_a_white_world() -> None:
    """Hair without absorption can't be seen in a world of one colour: sixteen strands lose next to nothing."""
    delta = scenes.delta({"fur": fur()}, OBJECTS[:1], materials(WHITE), (), 1.0)
    picture = Setup(SIZE).picture(LitScene(delta, camera()), 24)
    assert picture.mean() == pytest.approx(1.0, abs=0.01)
    assert np.isfinite(picture).all() and picture.min() >= 0.0


def test_lean_programs_of_hair_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw with the lean machine of hair what the full one draws: frames and path tracing, over strands and skin."""
    scene, setup = furry(BROWN, BEFORE), Setup(SIZE, truth_samples=4)
    assert is_lean_strand(materials(BROWN)["hair"].hair)
    lean, traced = setup.picture(scene, 3), setup.truth(scene)
    monkeypatch.setattr("burnish.engine.materials.is_lean_strand", lambda program: False)
    for ours, full in ((lean, Setup(SIZE).picture(scene, 3)), (traced, Setup(SIZE, truth_samples=4).truth(scene))):
        # On CUDA some rays go other ways by rounding.
        assert np.isclose(ours, full, rtol=1e-2, atol=1e-4).mean() > 0.99
        assert ours.mean() == pytest.approx(full.mean(), rel=1e-3)


@pytest.mark.slow
def test_first_frame_is_near_the_mean() -> None:
    """Have no dark and no blown-up first frame, and no speckles: sparks are spread over neighbours."""
    scene, setup = furry(PALE, BEFORE), Setup(SIZE)
    first, later, where = setup.picture(scene, 1), setup.picture(scene, 48), inside(None)
    assert first[where].mean() == pytest.approx(later[where].mean(), rel=0.12)
    assert np.percentile(first[where], 99) < 3.0 * np.percentile(later[where], 99)


def test_hair_in_motion() -> None:
    """Keep the light while the camera moves: no frame is darker or brighter than at rest."""
    scene, setup = furry(BROWN, BEFORE), Setup(SIZE)
    session, where = setup.session(scene), inside(None)
    session.step(16)
    rest = session.read()[..., :3][where].mean()
    for x in np.linspace(0.0, 0.2, 9)[1:]:
        session.configure(setup.settings(), camera(float(x)), *SIZE)
        session.step(1)
        assert session.read()[..., :3][where].mean() == pytest.approx(rest, rel=0.12)


def test_hair_that_moves() -> None:
    """Keep the light of hair that moves itself, as an instance, and leave none where it was."""
    scene, setup = furry(BROWN, None, 1.0), Setup(SIZE)
    session = setup.session(scene)
    session.step(8)
    rest = session.read()[..., :3]
    for step in range(1, 9):
        moved = [(mesh, scenes.place(x=0.03 * step), material) for mesh, _, material in OBJECTS]
        session.update(SceneDelta(instances=scenes.instances(moved)))
        session.step(1)
    before, after = 1.0 - rest.mean(-1), 1.0 - session.read()[..., :3].mean(-1)
    assert after.sum() == pytest.approx(before.sum(), rel=0.05)
    columns = np.arange(SIZE[0])
    way = (after.sum(0) @ columns) / after.sum() - (before.sum(0) @ columns) / before.sum()
    # A ball of 0.65 m is 20 pixels wide from the middle.
    assert way == pytest.approx(0.24 * 20 / 0.65, rel=0.15)


@pytest.mark.slow
def test_light_that_goes_off() -> None:
    """Twelve frames after the lamp went off at most 2 % of its light is left in the hair."""
    scene, setup = furry(BROWN, BEFORE), Setup(SIZE)
    session, where = setup.session(scene), inside(None)
    session.step(24)
    lit = session.read()[..., :3][where].mean()
    session.update(SceneDelta(lights=[]))
    session.step(12)
    assert session.read()[..., :3][where].mean() < 0.02 * lit


def test_same_bits() -> None:
    """Give the same picture in two runs."""
    scene, setup = furry(BROWN, BEHIND), Setup(SIZE)
    np.testing.assert_array_equal(setup.picture(scene, 6), setup.picture(scene, 6))


@pytest.mark.slow
def test_hair_that_shines() -> None:
    """Show what black hair itself emits once, in its colour; what white hair makes of it is noise without bound."""
    made = materials(BLACK) | {"hair": hair(BLACK, COLORS[BLACK], emission=(0.2, 0.1, 0.05))}
    scene = LitScene(scenes.delta(MESHES, OBJECTS, made, (), 0.0), camera())
    ours, truth = light(scene, 24)
    np.testing.assert_allclose(ours, truth, rtol=0.08)


def test_hair_mixed_with_other_shaders_stays_a_surface() -> None:
    """Scatter no light in hair that is half diffuse: what is not hair would be missing."""
    made = materials(BROWN) | {"hair": hair(BROWN, mixed=True)}
    session = Setup(SIZE).session(LitScene(scenes.delta(MESHES, OBJECTS, made, (), 1.0), camera()))
    session.step(1)
    assert "hair rays" not in session.counts()


@pytest.mark.slow
def test_hair_behind_a_veil() -> None:
    """Dim hair by what is half transparent before it."""
    veil = scenes.box(2.0)
    veil.positions[:, 1] *= 0.0
    made = materials(BROWN) | {"veil": scenes.transparent(0.5, color=0.0)}
    lamp = scenes.lamp("POINT", 150.0, scenes.place(*BEHIND), radius=0.2)
    delta = scenes.delta(
        MESHES | {"veil": veil}, [*OBJECTS, ("veil", scenes.place(y=-1.5), "veil")], made, (lamp,), 0.0)
    ours, truth = light(LitScene(delta, camera()), 48)
    np.testing.assert_allclose(ours, truth, rtol=0.15)
