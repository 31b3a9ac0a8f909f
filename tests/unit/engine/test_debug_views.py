# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of debug views against the passes that draw them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.debug_views import DEBUG_VIEWS
from burnish.engine.passes.rest import RestBlend
from burnish.engine.pipeline import Pipeline
from burnish.engine.scene import LightData, LightKind
from burnish.engine.session import Session
from burnish.engine.settings import CacheSettings, DebugSettings, DenoiserSettings, Integrator, SamplingSettings

from tests import scenes
from tests.glossy_scenes import metal

SETTINGS = dataclasses.replace(
    scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=14))


def test_table_names_what_the_passes_draw(device: str) -> None:
    """Have the same names in the table and in the passes of a frame."""
    pipeline = Pipeline(device)
    pipeline.configure(SETTINGS, 8, 8, ())
    drawn = [name for each in (*pipeline.passes, RestBlend(device)) for name in each.debug_views]
    assert len(drawn) == len(set(drawn))
    assert set(drawn) == set(DEBUG_VIEWS), set(drawn) ^ set(DEBUG_VIEWS)
    assert all(DEBUG_VIEWS.values())


@pytest.fixture(scope="module")
def session() -> Session:
    """Return a session that has drawn some frames of a lit ball of metal over a floor."""
    lamp = LightData(name="Lamp", kind=LightKind.POINT, transform=scenes.place(x=1.0, y=-1.0, z=2.0),
                     color=(200.0, 150.0, 100.0), radius=0.2)
    made = Session(SETTINGS)
    made.update(scenes.delta(
        {"ball": scenes.sphere(0.5, 16), "floor": scenes.quad(2.0)},
        [("ball", scenes.place(z=0.5), "metal"), ("floor", scenes.place(), "grey")],
        {"grey": scenes.material(color=0.5), "metal": metal(0.1)}, background=0.3, lights=[lamp]))
    show(made, "", 6)
    return made


def show(session: Session, view: str, frames: int) -> np.ndarray:
    """Render frames with a debug view and return the picture."""
    settings = dataclasses.replace(SETTINGS, debug=DebugSettings(view=view))
    session.configure(settings, scenes.camera_above(half=1.5), 48, 32)
    session.step(frames)
    return session.read()


@pytest.mark.parametrize("view", [name for name in DEBUG_VIEWS if name not in RestBlend.debug_views])
def test_every_view_shows_something_else(session: Session, view: str) -> None:
    """Draw each view as finite colours other than the picture's, and the picture again afterwards."""
    picture = show(session, "", 2)
    shown = show(session, view, 2)
    assert np.isfinite(shown).all() and (shown >= 0.0).all()
    assert not np.allclose(shown[..., :3], picture[..., :3], rtol=0.05, atol=1e-3)
    np.testing.assert_allclose(show(session, "", 2).mean(), picture.mean(), rtol=0.05)


def test_debug_view_at_rest_leaves_the_picture(device: str) -> None:
    """Show a debug view after path tracing has begun, and the picture again, not a blend of both."""
    settings = dataclasses.replace(SETTINGS, denoiser=DenoiserSettings(rest_frames=3))
    session = Session(settings)
    session.update(scenes.delta({"ball": scenes.sphere(0.5, 16)}, [("ball", scenes.place(z=0.5), "grey")],
                                {"grey": scenes.material(color=0.5)}, background=0.3))

    def picture(view: str, frames: int) -> np.ndarray:
        session.configure(dataclasses.replace(settings, debug=DebugSettings(view=view)), scenes.camera_above(), 32, 32)
        session.step(frames)
        return session.read()[..., :3]

    before = picture("", 40)
    normals = picture("gbuffer.normal", 1)
    again = picture("", 40)
    assert session.samples_done == 40
    # The ball from above: normals are 0.5 + 0.5 n, bright in z.
    assert normals[16, 16, 2] == pytest.approx(1.0, abs=0.02) and normals[16, 16, 0] == pytest.approx(0.5, abs=0.1)
    # Noise of other samples; a blend with the normals would differ by 0.2 and more.
    assert np.abs(again - before).mean() < 0.01


def test_weight_of_path_tracing_is_drawn(device: str) -> None:
    """Show how far the picture at rest is path traced: not at all at first, further with every sample."""
    settings = dataclasses.replace(
        SETTINGS, denoiser=DenoiserSettings(rest_frames=3), debug=DebugSettings(view="rest.weight"))
    session = Session(settings)
    session.update(scenes.delta({"ball": scenes.sphere(0.5, 16)}, [("ball", scenes.place(z=0.5), "grey")],
                                {"grey": scenes.material(color=0.5)}, background=0.3))
    session.configure(settings, scenes.camera_above(), 16, 16)
    means = []
    for samples in (4, 64, 512):
        session.step(samples)
        means.append(session.read()[..., :3].mean())
    assert 0.0 <= means[0] < means[1] < means[2] <= 1.0


def test_settings_of_the_host_keep_the_frames(device: str) -> None:
    """Go on where the frames were when only the number of samples or the viewport's pixel size changes."""
    session = Session(SETTINGS)
    session.update(scenes.delta({"floor": scenes.quad()}, [("floor", scenes.place(), "grey")],
                                {"grey": scenes.material(color=0.5)}, background=0.3))
    session.configure(SETTINGS, scenes.camera_above(), 8, 8)
    session.step(5)
    sampling = dataclasses.replace(SETTINGS.sampling, samples=9, viewport_samples=7, time_limit=3.0)
    performance = dataclasses.replace(SETTINGS.performance, frame_time=0.1, viewport_pixel_size=2)
    other = dataclasses.replace(SETTINGS, sampling=sampling, performance=performance)
    session.configure(other, scenes.camera_above(), 8, 8)
    assert session.samples_done == 5 and session.step(1) == 6
    session.configure(dataclasses.replace(other, sampling=dataclasses.replace(sampling, seed=3)),
                      scenes.camera_above(), 8, 8)
    assert session.samples_done == 0
