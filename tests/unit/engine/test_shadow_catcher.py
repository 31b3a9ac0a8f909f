# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow catchers in the engine: nothing is seen of them but what other things take of their light."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.pass_names import SHADOW_CATCHER
from burnish.engine.scene import SceneDelta, Visibility
from burnish.engine.session import Session
from burnish.engine.settings import FilmSettings, Integrator, PixelFilter, SamplingSettings

from tests import scenes

CAMERA = scenes.camera_above(half=1.0)
CATCHER = int(Visibility.ALL | Visibility.SHADOW_CATCHER)
NO_SHADOW = int(Visibility.ALL & ~Visibility.SHADOW)
SEEN = int(Visibility.CAMERA)
SKY = 0.3


def caught(*others: tuple, lamp: float = 300.0, catcher: bool = True) -> SceneDelta:
    """Make a floor that catches shadows, a lamp behind the camera, a grey world, and other things."""
    materials = {"grey": scenes.material(color=0.5), "black": scenes.material(color=0.0),
                 "glow": scenes.material(color=0.0, emission=(8.0, 8.0, 8.0)), "veil": scenes.transparent(0.6)}
    lights = [scenes.lamp("POINT", lamp, scenes.place(z=4.5), radius=0.05)] if lamp else ()
    floor = ("floor", scenes.place(), "grey", CATCHER if catcher else int(Visibility.ALL))
    return scenes.delta(
        {"floor": scenes.quad(1.5), "roof": scenes.quad(0.8), "small": scenes.quad(0.4)},
        [floor, *others], materials, lights, SKY)


ROOF = ("roof", scenes.place(z=3.5), "black")


def session_of(made: SceneDelta, *, transparent: bool = True, integrator: Integrator = Integrator.REFERENCE,
               samples: int = 16, passes: tuple[str, ...] = ("Combined",)) -> Session:
    """Render."""
    settings = dataclasses.replace(
        scenes.SETTINGS, sampling=SamplingSettings(integrator=integrator),
        film=FilmSettings(pixel_filter=PixelFilter.BOX, transparent=transparent))
    session = Session(settings)
    session.update(made)
    session.configure(settings, CAMERA, 16, 16, passes=passes)
    session.step(samples)
    return session


def test_nothing_is_seen_of_one_alone() -> None:
    """Leave the film clear, or show the world, where nothing casts a shadow."""
    np.testing.assert_allclose(session_of(caught()).read(), 0.0, atol=1e-5)
    shown = session_of(caught(), transparent=False).read()
    np.testing.assert_allclose(shown[..., :3], SKY, rtol=1e-4)
    assert (shown[..., 3] == 1.0).all()


def test_shadows_are_the_light_that_others_take() -> None:
    """Show in alpha, or in the world behind, the share that a black roof takes of the lamp and the world together."""
    lit, shaded = (session_of(caught(*others, catcher=False), samples=256).read()[6:10, 6:10, :3].mean()
                   for others in ((), (ROOF,)))
    share = 1.0 - shaded / lit
    assert 0.3 < share < 0.98
    middle = session_of(caught(ROOF), samples=256).read()[6:10, 6:10]
    np.testing.assert_allclose(middle[..., 3].mean(), share, rtol=0.02)
    assert middle[..., :3].max() < 1e-5
    behind = session_of(caught(ROOF), transparent=False, samples=256).read()[6:10, 6:10, :3]
    np.testing.assert_allclose(behind.mean(), SKY * (1.0 - share), rtol=0.05)


def test_other_things_are_seen_as_always() -> None:
    """Show what is before a catcher with its own light and alpha 1, and veils with theirs."""
    box = ("small", scenes.place(z=0.5), "grey", NO_SHADOW)
    plain = session_of(caught(box, catcher=False), samples=64).read()[7:9, 7:9]
    seen = session_of(caught(box), samples=64).read()[7:9, 7:9]
    np.testing.assert_allclose(seen, plain, rtol=1e-5)
    veil = session_of(caught(("small", scenes.place(z=0.5), "veil", SEEN)), samples=512).read()[6:10, 6:10]
    np.testing.assert_allclose(veil[..., 3].mean(), 0.4, atol=0.02)


def test_light_of_other_things_is_no_shadow() -> None:
    """Leave out what an emissive mesh adds, at alpha 0 and at the world's brightness."""
    glow = ("small", scenes.place(z=3.5), "glow", NO_SHADOW)
    assert session_of(caught(glow, lamp=0.0), samples=64).read()[6:10, 6:10, 3].max() < 0.2
    shown = session_of(caught(glow, lamp=0.0), transparent=False, samples=64).read()[6:10, 6:10, :3]
    np.testing.assert_allclose(shown.mean(), SKY, rtol=0.03)


@pytest.mark.parametrize("transparent", [True, False])
def test_the_pass_has_the_shadow_and_the_picture_lacks_it(transparent: bool) -> None:
    """Tell by what a background is to be multiplied: less in shadow, more by light of others, 1 beside catchers."""
    passes = "Combined", SHADOW_CATCHER
    shadow = session_of(caught(ROOF), samples=256).read()[6:10, 6:10, 3].mean()
    session = session_of(caught(ROOF), transparent=transparent, samples=256, passes=passes)
    factor = session.read(SHADOW_CATCHER)
    assert factor.shape == (16, 16, 3)
    np.testing.assert_allclose(factor[6:10, 6:10].mean(), 1.0 - shadow, rtol=0.02)
    np.testing.assert_allclose(session.read(), 0.0, atol=1e-5)
    glow = session_of(caught(("small", scenes.place(z=3.5), "glow", NO_SHADOW), lamp=0.0), samples=64, passes=passes)
    assert glow.read(SHADOW_CATCHER)[6:10, 6:10].mean() > 1.05
    box = ("small", scenes.place(z=0.5), "grey", NO_SHADOW)
    before = session_of(caught(box), samples=16, passes=passes)
    np.testing.assert_array_equal(before.read(SHADOW_CATCHER)[7:9, 7:9], 1.0)
    assert before.read()[7:9, 7:9, 3].min() == 1.0
    plain = session_of(caught(ROOF, catcher=False), passes=passes)
    np.testing.assert_array_equal(plain.read(SHADOW_CATCHER), 1.0)
    assert plain.read()[..., 3].min() > 0.0


def test_both_integrators_are_path_traced() -> None:
    """Give real-time pictures of catchers the very samples of the reference integrator."""
    reference, frames = (session_of(caught(ROOF), integrator=kind) for kind in (
        Integrator.REFERENCE, Integrator.REALTIME))
    assert frames.pipeline is None and np.array_equal(reference.read(), frames.read())


@pytest.mark.parametrize("integrator", [Integrator.REFERENCE, Integrator.REALTIME])
def test_edits_are_followed(integrator: Integrator) -> None:
    """Take the flag off and on again, and follow what moves away; scenes without catchers have nothing of them."""
    made = caught(ROOF)
    session = session_of(made, integrator=integrator)
    assert session._pass.catchers is not None

    def after(**edit: object) -> np.ndarray:
        session.update(SceneDelta(instances=dataclasses.replace(made.instances, **edit)))
        session.configure(session.settings if integrator == Integrator.REFERENCE else dataclasses.replace(
            session.settings, sampling=SamplingSettings(integrator=integrator)), CAMERA, 16, 16)
        session.step(16)
        return session.read()[6:10, 6:10]

    plain = after(visibility=made.instances.visibility & ~int(Visibility.SHADOW_CATCHER))
    assert session._pass.catchers is None and (plain[..., 3] > 0.99).all()
    assert after()[..., 3].mean() > 0.3
    moved = made.instances.transforms.copy()
    moved[1, 0, 3] = 50.0
    assert after(transforms=moved)[..., 3].mean() < 0.02
