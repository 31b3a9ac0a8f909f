# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of twice the picture's size, averaged (engine/supersampling.py), as small pictures on a GPU have them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine import supersampling
from burnish.engine.pixel_filter import filter_table, motion_reach
from burnish.engine.scene import LightKind
from burnish.engine.session import Session
from burnish.engine.settings import (
    CacheSettings,
    DenoiserSettings,
    FilmSettings,
    Integrator,
    PixelFilter,
    RenderSettings,
    SamplingSettings,
)
from burnish.engine.supersampling import Supersampling, fine_width
from burnish.engine.view_data import ViewTracker
from burnish.kernels.types import FrameData

from tests import scenes
from tests.larger_frames import draw_larger

W, H = 64, 40
FRAMES = dataclasses.replace(
    scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=14),
    denoiser=DenoiserSettings(path_traced_rest=False))
FILTERS = [FilmSettings(), FilmSettings(pixel_filter=PixelFilter.GAUSSIAN, filter_width=2.0),
           FilmSettings(pixel_filter=PixelFilter.BOX), FilmSettings(filter_width=4.0)]


@pytest.fixture
def doubled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw small pictures on a processor as on a GPU."""
    draw_larger(monkeypatch.setattr)


def render(device_settings: RenderSettings, frames: int, names: tuple[str, ...] = ("Combined",),
           crop: tuple[int, int, int, int] | None = None) -> dict[str, np.ndarray]:
    """Return pictures of a striped floor and a box in a lamp's light."""
    floor = scenes.material("PRINCIPLED", color=0.7, roughness=0.3, metallic=0.5)
    meshes = {"floor": scenes.quad(3.0), "box": scenes.box(0.3)}
    objects = [("floor", scenes.place(), "white"), ("box", scenes.place(z=0.3), "white")]
    lamps = [scenes.lamp(LightKind.POINT, 50.0, scenes.place(1.0, 1.0, 2.0), radius=0.05)]
    session = Session(device_settings)
    session.update(scenes.delta(meshes, objects, {"white": floor}, lamps, 0.2))
    session.configure(device_settings, scenes.camera_above(3.0, 1.0, orthographic=False), W, H, crop, names)
    session.step(frames)
    pictures = {name: session.read(name)[..., :3] for name in names}
    pictures["counts"] = session.counts()
    session.close()
    return pictures


@pytest.mark.parametrize("film", FILTERS)
def test_the_filter_stays_as_wide(film: FilmSettings) -> None:
    """Give blocks' means and jitter together the variance of the picture's filter, and a box exactly its width."""
    width = fine_width(film, 2)
    jitter = filter_table(film.pixel_filter, width).astype(float)
    # Two pixels of a frame side by side lie half of one from the middle of theirs.
    samples = np.concatenate([jitter - 0.5, jitter + 0.5]) / 2.0
    wanted = filter_table(film.pixel_filter, film.filter_width).astype(float)
    assert samples.var() == pytest.approx(wanted.var(), rel=2e-3)
    assert samples.mean() == pytest.approx(0.0, abs=1e-6)
    if film.pixel_filter == PixelFilter.BOX:
        assert samples.min() == pytest.approx(-0.5) and samples.max() == pytest.approx(0.5)


@pytest.mark.parametrize(("device", "width", "height", "changed", "factor"), [
    ("cuda:0", 640, 360, {}, 2),
    ("cuda:0", 960, 540, {}, 2),
    ("cuda:0", 1280, 720, {}, 1),
    ("cuda:0", 128, 128, {}, 1),
    ("cpu", 640, 360, {}, 1),
    ("cuda:0", 640, 360, {"denoiser": DenoiserSettings(supersample_small=False)}, 1),
    ("cuda:0", 640, 360, {"denoiser": DenoiserSettings(antialiasing=False)}, 1),
    ("cuda:0", 640, 360, {"film": FilmSettings(filter_width=0.5)}, 1),
])
def test_small_pictures_on_a_gpu_are_drawn_larger(
    device: str, width: int, height: int, changed: dict, factor: int,
) -> None:
    """Leave large pictures, icons and processors alone, and filters that are narrower than the mean of a block."""
    made = Supersampling(device)
    made.configure(dataclasses.replace(RenderSettings(), **changed), width, height)
    assert made.factor == factor


def test_blocks_are_averaged(device: str, doubled: None) -> None:
    """Average each block of a frame, rows and columns of which are no multiple of anything."""
    made = Supersampling(device)
    made.configure(RenderSettings(), 3, 5)
    for dtype, channels in ((wp.vec3, 3), (wp.vec4, 4)):
        frame = np.random.default_rng(0).random((10, 6, channels)).astype(np.float32)
        averaged = made.average(wp.array(frame.reshape(-1, channels), dtype=dtype, device=device)).numpy()
        wanted = frame.reshape(5, 2, 3, 2, channels).mean((1, 3))
        np.testing.assert_allclose(averaged.reshape(5, 3, channels), wanted, rtol=1e-6)


@pytest.mark.slow
def test_frames_have_four_times_the_pixels(doubled: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """See the same picture in light and shape, from four times as many pixels, and nearer to what it comes to."""
    larger = render(FRAMES, 4)
    far = render(FRAMES, 64)["Combined"]
    monkeypatch.setattr(supersampling, "is_small", lambda width, height: False)
    plain = render(FRAMES, 4)
    plain_far = render(FRAMES, 64)["Combined"]
    assert larger["counts"]["primary rays"] == 4 * W * H == 4 * plain["counts"]["primary rays"]
    assert far.mean() == pytest.approx(plain_far.mean(), rel=0.02)
    # The filter of frames at rest is the picture's.
    assert np.abs(far - plain_far).mean() < 0.03 * plain_far.mean()
    errors = [np.square(picture["Combined"] - other).mean() for picture, other in ((larger, plain_far), (plain, far))]
    assert errors[0] < 0.8 * errors[1]


@pytest.mark.slow
def test_a_region_is_where_it_was(doubled: None) -> None:
    """Draw a region of a frame at the same place as all of it."""
    whole = render(FRAMES, 16)["Combined"]
    part = render(FRAMES, 16, crop=(10, 6, 33, 21))["Combined"]
    assert part.shape == (21, 33, 3)
    assert np.abs(part - whole[6:27, 10:43]).mean() < 0.03 * whole.mean()


@pytest.mark.parametrize("frames", [6, pytest.param(32, marks=pytest.mark.slow)])
def test_light_passes_make_up_the_picture(frames: int, doubled: None) -> None:
    """Sum up direct and indirect light times colours to the picture, at its size, while light spreads and after."""
    names = tuple(f"{lobe} {part}" for lobe in ("Diffuse", "Glossy") for part in ("Direct", "Indirect", "Color"))
    found = render(FRAMES, frames, ("Combined", *names))
    total = sum((found[f"{lobe} Direct"] + found[f"{lobe} Indirect"]) * found[f"{lobe} Color"]
                for lobe in ("Diffuse", "Glossy"))
    seen = found["Diffuse Color"].sum(-1) + found["Glossy Color"].sum(-1) > 0.2
    assert total.shape == (H, W, 3) and seen.mean() > 0.3
    assert np.abs(total - found["Combined"])[seen].mean() < 0.001 * found["Combined"][seen].mean()


@pytest.mark.slow
def test_a_picture_at_rest_takes_samples_in(doubled: None) -> None:
    """Blend frames of twice the size with path-traced samples of the picture's; the mean stays."""
    rested = dataclasses.replace(FRAMES, denoiser=DenoiserSettings(rest_frames=12))
    blended = render(rested, 200)["Combined"]
    traced = dataclasses.replace(FRAMES, sampling=SamplingSettings(integrator=Integrator.REFERENCE))
    truth = render(traced, 256)["Combined"]
    assert blended.mean() == pytest.approx(truth.mean(), rel=0.01)
    assert np.abs(blended - truth).mean() < 0.04 * truth.mean()


@pytest.mark.parametrize("film", FILTERS)
def test_motion_is_filtered_as_rest(film: FilmSettings, doubled: None) -> None:
    """Weigh samples in motion by the filter that the jitter is drawn from at rest, of larger frames too."""
    settings = dataclasses.replace(FRAMES, film=film)
    session = Session(settings)
    session.update(scenes.delta({"floor": scenes.quad()}, [("floor", scenes.place(), "white")],
                                {"white": scenes.material("DIFFUSE", color=0.8)}, [], 1.0))
    session.configure(settings, scenes.camera_above(), W, H)
    session.step(1)
    composite = session.pipeline.composite
    width = film.filter_width if film.pixel_filter == PixelFilter.BOX else fine_width(film, 2)
    assert 1.0 / (2.0 * composite.sharpness) == pytest.approx(filter_table(film.pixel_filter, width).var(), rel=1e-4)
    session.close()


@pytest.mark.parametrize("film", FILTERS)
def test_frames_in_motion_sample_all_of_the_pixel_alike(film: FilmSettings) -> None:
    """Draw jitter from the filter at rest, and evenly from the pixel, or what is narrower, while a camera moves."""
    table = filter_table(film.pixel_filter, film.filter_width)
    views, camera, found = ViewTracker("cpu"), np.zeros(1, FrameData.numpy_dtype()), {False: [], True: []}
    for frame in range(2048):
        moved = frame >= 1024
        camera["pixel_size"] += float(moved)
        views.advance(camera, moved=False, lit=False, exposure=1.0, transparent=False, filter_quantiles=table,
                      motion_reach=motion_reach(table))
        found[moved].append(views.row["jitter"][0].copy())
    rest, motion = np.array(found[False]), np.array(found[True])
    reach = min(0.5, np.sqrt(3.0) * table.std())
    for axis in range(2):
        assert rest[:, axis].std() == pytest.approx(table.std(), rel=0.05)
        assert np.abs(rest[:, axis]).max() > 0.6 * np.abs(table).max()
        np.testing.assert_allclose(np.sort(motion[:, axis]), np.linspace(-reach, reach, 1024), atol=0.01)
