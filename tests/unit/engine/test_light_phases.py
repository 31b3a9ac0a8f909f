# SPDX-License-Identifier: GPL-3.0-or-later
"""Test frames of a settled cache, whose cells take the light of bounce rays a frame later."""

from dataclasses import replace

import numpy as np
import pytest
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.passes.cache_spreading import SETTLED, LightPhase, light_phase
from burnish.engine.passes.radiance_cache import RadianceCachePass
from burnish.engine.scene import LightKind, SceneDelta
from burnish.engine.session import Session
from burnish.engine.settings import CacheSettings, Integrator, SamplingSettings
from burnish.kernels.cache_rays import UNWATCHED, resume_bounces
from burnish.kernels.hash_grid import NO_CELL
from burnish.kernels.paths import ENDED
from burnish.kernels.view import MOVED_FRAMES

from tests import scenes

SIZE = (24, 16)
REALTIME = replace(
    scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=14))
LAMP = scenes.lamp(LightKind.POINT, 60.0, scenes.place(0.3, 0.2, 1.6), radius=0.2)


def room(lights=(LAMP,)):
    """Make a closed white box with a ball in it, lit by a lamp: half of its light is indirect."""
    return scenes.delta(
        {"box": scenes.box(2.0), "ball": scenes.sphere(0.8, 12)},
        [("box", scenes.place(), "white"), ("ball", scenes.place(z=-1.0), "metal")],
        {"white": scenes.material(color=0.7), "metal": scenes.material("GLOSSY", color=0.8, roughness=0.1)},
        list(lights), 0.0)


def look(made, frame, settings=REALTIME):
    """Look from the next place of a small circle."""
    angle = 0.3 * frame
    camera = scenes.camera_above(1.5, 1.0, orthographic=False)
    transform = np.array(camera.transform).reshape(4, 4)
    transform[:2, 3] += 0.1 * np.cos(angle), 0.1 * np.sin(angle)
    made.configure(settings, replace(camera, transform=tuple(transform.ravel())), *SIZE)


def fly(made, frames, start=0, last=32):
    """Render frames with a moving camera; return the mean of the last pictures."""
    pictures = []
    for frame in range(start, start + frames):
        look(made, frame, made.settings)
        made.step(1)
        pictures.append(made.read()[..., :3].copy())
    return np.mean(pictures[-last:], 0)


def open_session(seed=0):
    """Open a session on the room."""
    settings = replace(REALTIME, sampling=replace(REALTIME.sampling, seed=seed))
    made = Session(settings)
    made.update(room())
    look(made, 0, settings)
    return made


def phases(made):
    """Return the phases of the frames recorded so far."""
    return {key[2] for key in made._realtime.pipeline._graphs}


@pytest.fixture(scope="module")
def settled():
    """Fly until the cache has settled, and some frames more."""
    made = open_session()
    return made, fly(made, SETTLED + 60)


def test_phases_by_age():
    """Sweep first, then spread, and settle; not while something but the camera moves."""
    ages = {0: LightPhase.SWEEPING, 15: LightPhase.SWEEPING, 16: LightPhase.SPREADING,
            SETTLED - 1: LightPhase.SPREADING, SETTLED: LightPhase.SETTLED}
    for age, phase in ages.items():
        assert light_phase(age, 10**6, 10**6, resting=False) is light_phase(10**6, age, 10**6, resting=True) is phase
    assert light_phase(10**6, 10**6, int(MOVED_FRAMES) - 1, resting=False) is LightPhase.SPREADING
    assert light_phase(10**6, 10**6, 1, resting=True) is LightPhase.SETTLED


@pytest.mark.slow
def test_settled_frames_keep_the_light(settled, monkeypatch):
    """Get as much light from settled frames as from those that wait for everything.

    The mean of three seeds: a room of few cells swings by 1.5 % with one of them.
    """
    assert LightPhase.SETTLED in phases(settled[0])
    pictures = [fly(open_session(seed), SETTLED + 156, last=128) for seed in range(3)]
    monkeypatch.setattr(RadianceCachePass, "is_settled", lambda self, phase: False)
    waiting = [fly(open_session(seed), SETTLED + 156, last=128) for seed in range(3)]
    assert np.mean(waiting) > 0.1
    assert abs(np.mean(pictures) / np.mean(waiting) - 1.0) < 0.02
    assert not np.array_equal(pictures, waiting)


def test_known_cells_are_watched_in_turns(settled):
    """Look for lights at few hits in cells that know enough while the camera moves; at all others, and at rest."""
    made, _ = settled
    fly(made, 2, 300)
    cache = made._realtime.pipeline.cache

    def unwatched():
        rays = cache.rays
        cells = rays.vertices.cell.numpy()[:rays.count]
        return cells, rays.paths.radiance.numpy()[:rays.count, 3] == float(UNWATCHED)

    cells, without = unwatched()
    known = cells[cells != NO_CELL]
    assert 0.1 < without.sum() / len(known) < 0.76
    assert (cache.grid.direct.numpy()[cells[without], 3] >= cache.settings.sample_cap).all()
    made.step(1)
    assert not unwatched()[1].any()


def test_bounce_rays_are_followed_once(settled):
    """Leave bounce rays to the next frame alone: after one that follows its own none is followed again."""
    made, _ = settled
    pipeline, views = made._realtime.pipeline, made._realtime.views
    rays, pending = pipeline.cache.rays, pipeline.cache.pending
    assert pending.numpy()[0] == views.frame + 1
    moved = room().instances
    moved.transforms[1, 0, 3] += 0.1
    made.update(SceneDelta(instances=moved))
    fly(made, 1, 400)
    assert pending.numpy()[0] == 0
    # Those after them are of the first frames alone.
    own = slice(rays.count, rays.count + rays.bounces)
    assert (rays.vertices.source.numpy()[:rays.bounces] != NO_CELL).any()
    assert (rays.paths.state.numpy()[own] != ENDED).any()
    graph = FrameGraph(made.device)
    graph.launch(resume_bounces, rays.bounces, [views.array, pending, rays.count], [rays.paths, rays.vertices])
    for frame, followed in ((views.frame, True), (views.frame + 1, False)):
        pending.fill_(frame)
        graph.replay()
        assert (rays.vertices.source.numpy()[:rays.bounces] != NO_CELL).any() == followed
        assert (rays.paths.state.numpy()[own] != ENDED).any() == followed


def test_edit_of_light_leaves_nothing_behind(settled):
    """Edit light in a settled frame: samples left for the next one are not taken for light of then."""
    made, picture = settled
    fly(made, int(MOVED_FRAMES) + 1, 500)
    grid = made._realtime.pipeline.cache.grid
    assert grid.counts.numpy().any()
    grid.counts.fill_(1)
    grid.sums.fill_(1 << 40)
    made.update(SceneDelta(lights=[]))
    fly(made, 2, 510)
    assert LightPhase.SWEEPING in phases(made)
    assert made.read()[..., :3].mean() < picture.mean()
