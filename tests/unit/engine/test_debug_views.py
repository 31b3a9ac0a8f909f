# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of debug views against the passes that draw them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.debug_views import DEBUG_VIEWS
from burnish.engine.pipeline import Pipeline
from burnish.engine.scene import LightData, LightKind
from burnish.engine.session import Session
from burnish.engine.settings import CacheSettings, DebugSettings, Integrator, SamplingSettings

from tests import scenes

SETTINGS = dataclasses.replace(
    scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=14))


def test_table_names_what_the_passes_draw(device: str) -> None:
    """Have the same names in the table and in the passes of a frame."""
    pipeline = Pipeline(device)
    pipeline.configure(SETTINGS, 8, 8, False)
    drawn = [name for each in pipeline.passes for name in each.debug_views]
    assert len(drawn) == len(set(drawn))
    # The rest regime is no pass of the frame: it comes after it.
    assert set(drawn) | {"rest.weight"} == set(DEBUG_VIEWS), set(drawn) ^ set(DEBUG_VIEWS)
    assert all(DEBUG_VIEWS.values())


@pytest.fixture(scope="module")
def session() -> Session:
    """Return a session that has drawn some frames of a lit ball over a floor."""
    lamp = LightData(name="Lamp", kind=LightKind.POINT, transform=scenes.place(x=1.0, y=-1.0, z=2.0),
                     color=(200.0, 150.0, 100.0), radius=0.2)
    made = Session(SETTINGS)
    made.update(scenes.delta(
        {"ball": scenes.sphere(0.5, 16), "floor": scenes.quad(2.0)},
        [("ball", scenes.place(z=0.5), "grey"), ("floor", scenes.place(), "grey")],
        {"grey": scenes.material(color=0.5)}, background=0.3, lights=[lamp]))
    show(made, "", 6)
    return made


def show(session: Session, view: str, frames: int) -> np.ndarray:
    """Render frames with a debug view and return the picture."""
    settings = dataclasses.replace(SETTINGS, debug=DebugSettings(view=view))
    session.configure(settings, scenes.camera_above(half=1.5), 48, 32)
    session.step(frames)
    return session.read()


@pytest.mark.parametrize("view", [name for name in DEBUG_VIEWS if name != "rest.weight"])
def test_every_view_shows_something_else(session: Session, view: str) -> None:
    """Draw each view as finite colours other than the picture's, and the picture again afterwards."""
    picture = show(session, "", 2)
    shown = show(session, view, 2)
    assert np.isfinite(shown).all() and (shown >= 0.0).all()
    assert not np.allclose(shown[..., :3], picture[..., :3], rtol=0.05, atol=1e-3)
    np.testing.assert_allclose(show(session, "", 2).mean(), picture.mean(), rtol=0.05)
