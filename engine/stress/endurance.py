# SPDX-License-Identifier: GPL-3.0-or-later
"""Thousands of frames that feed on the ones before, at rest and in motion; a full cache; forced collisions of cells."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..scene import SceneDelta
from ..session import Session
from ..settings import Integrator
from .cases import Case, Trial, luminance
from .furnaces import EMISSION, closed_box, white_share
from .scenes import Placed, StressScene, emitter, look_at, make_scene, make_table, material, place, room, sphere

__all__ = ["CASES"]

SIZE = (32, 20)
REST_FRAMES = {"quick": 120, "full": 10000}
MOVING_FRAMES = {"quick": 60, "full": 10000}
LOOKS = 12
"""Pictures counted on the way"""
RT = Integrator.REALTIME

DISTANCE = 16384.0
"""Metres: 2^17 cells of 1/8 m, after which keys repeat, and those of all smaller cells too"""


def advance(trial: Trial, session: Session, frames: int, looks: int) -> list[np.ndarray]:
    """Render so many frames and return the pictures at some of them, counted."""
    pictures = []
    for i in range(looks):
        session.step(frames * (i + 1) // looks - frames * i // looks)
        pictures.append(trial.take(session))
    return pictures


def run_rest(trial: Trial) -> None:
    """Rest for long: light neither grows nor fades once it has settled, and is what path tracing finds."""
    frames = REST_FRAMES["quick" if trial.quick else "full"]
    session, _ = trial.start(room(SIZE), RT, SIZE)
    settled, *_, last = (luminance(each).mean() for each in advance(trial, session, frames, LOOKS)[LOOKS // 3:])
    trial.check_energy(f"after {frames} frames against a third of them", last / settled, 0.02)
    truth = luminance(trial.render(room(SIZE), Integrator.REFERENCE, trial.choose(96, 2048), SIZE)).mean()
    trial.check_energy("against path tracing", last / truth, 0.05)


def run_furnace(trial: Trial) -> None:
    """Rest for long in a closed box, where an error of 1 % a bounce would grow tenfold."""
    frames = REST_FRAMES["full"]
    for metallic, roughness in ((0.0, 1.0), (1.0, 0.25)):
        scene = closed_box(0.9, SIZE, metallic=metallic, roughness=roughness)
        session, _ = trial.start(scene, RT, SIZE)
        expected = EMISSION / (1.0 - 0.9 * white_share(metallic=metallic, roughness=roughness))
        pictures = advance(trial, session, frames, LOOKS)
        for number in (LOOKS // 2, LOOKS - 1):
            trial.check_energy(f"metallic {metallic:g} after {frames * (number + 1) // LOOKS} frames",
                               luminance(pictures[number]).mean() / expected, 0.01)


def moving(frame: int) -> tuple[StressScene, SceneDelta]:
    """Return the room as seen in a frame of a round trip of 97 frames, and what moves in it."""
    scene, angle = room(SIZE), 2.0 * math.pi * frame / 97.0
    eye = (0.5 + math.sin(angle), -3.5 + 0.8 * math.cos(angle) - 0.8, 1.5 + 0.5 * math.sin(2.0 * angle))
    scene.camera = look_at(eye, (0.0, 0.5, 0.625), SIZE, 1.0)
    table = scene.delta.instances
    transforms = table.transforms.copy()
    transforms[4, :3, 3] += (0.5 * math.sin(angle), 0.0, 0.25 - 0.25 * math.cos(angle))
    return scene, SceneDelta(instances=replace(table, transforms=transforms))


def run_motion(trial: Trial) -> None:
    """Move camera and a thing for long, switch lamps now and then: no bad pixel, and no light left over."""
    frames = MOVING_FRAMES["quick" if trial.quick else "full"]
    base, _ = moving(0)
    session, settings = trial.start(base, RT, SIZE)
    for frame in range(1, frames + 1):
        scene, delta = moving(frame)
        if frame % 500 in (60, 90):
            delta.lights = [] if frame % 500 == 60 else scene.delta.lights
        session.update(delta)
        session.configure(settings, scene.camera, *SIZE)
        session.step(1)
        if frame % max(frames // (20 * LOOKS), 1) == 0:
            trial.take(session)
    # Come to rest in the view of the start.
    scene, delta = moving(0)
    delta.lights = scene.delta.lights
    session.update(delta)
    session.configure(settings, scene.camera, *SIZE)
    session.step(trial.choose(96, 192))
    after = luminance(trial.take(session)).mean()
    fresh = luminance(trial.render(scene, RT, trial.choose(96, 256), SIZE, fresh=True)).mean()
    trial.check_energy(f"at rest after {frames} moving frames", after / fresh, 0.03)


def run_burst(trial: Trial) -> None:
    """Flash a panel of 1e6 and 1e30 for some frames: its light is gone soon after."""
    frames = trial.choose(40, 256)
    expected = luminance(trial.render(room(SIZE), RT, frames, SIZE)).mean()
    for radiance in trial.choose((1e6,), (1e6, 1e30)):
        scene = room(SIZE)
        calm = scene.delta.materials["panel"]
        session, _ = trial.start(scene, RT, SIZE)
        session.step(8)
        session.update(SceneDelta(materials={"panel": emitter(radiance)}))
        session.step(6)
        trial.take(session)
        session.update(SceneDelta(materials={"panel": calm}))
        session.step(4)
        trial.take(session)
        session.step(frames)
        ratio = luminance(trial.take(session)).mean() / expected
        trial.check_energy(f"{frames} frames after a flash of {radiance:g}", ratio, 0.05)


# The cache.


def run_full_cache(trial: Trial) -> None:
    """Fill the smallest cache with the smallest cells: noisier light, not less of it."""
    amount = trial.choose(40, 512)
    expected = luminance(trial.render(room(SIZE), RT, amount, SIZE)).mean()
    cache = {"capacity": 10, "cell_pixels": 2.0, "minimum_cell": 0.002}
    session, _ = trial.start(room(SIZE), RT, SIZE, cache=cache)
    session.step(amount)
    light, counts = luminance(trial.take(session)).mean(), session.counts()
    trial.check("share of the cache in use", counts["cache cells live"] / counts["cache cells"], 0.75, 1.0)
    trial.check("cells that found no room in a frame", counts["cache cells failed"], 1, np.inf)
    trial.check_energy("full cache", light / expected, 0.1)


def run_one_bucket(trial: Trial) -> None:
    """Let all cells collide in one bucket of 16, so that nearly all are refused."""
    amount = trial.choose(40, 512)
    expected = luminance(trial.render(room(SIZE), RT, amount, SIZE)).mean()
    session, _ = trial.start(room(SIZE), RT, SIZE, fresh=True)
    session.pipeline.cache.grid.bucket_mask = 0
    session.step(amount)
    light, counts = luminance(trial.take(session)).mean(), session.counts()
    trial.check("cells in use", counts["cache cells live"], 1, 16)
    trial.check_energy("one bucket", light / expected, 0.1)


def run_same_keys(trial: Trial) -> None:
    """Jump from a bright room into a dark one 2^17 cells away, whose cells have the bright ones' keys."""
    bright, dark = 100.0, 1.0
    meshes = {"hall": sphere(3.0, 12), "ball": sphere(0.5, 12), "lamp": sphere(0.25, 8)}
    objects = []
    for name, shift in (("bright", 0.0), ("dark", DISTANCE)):
        objects += [Placed("hall", "grey", place(shift)), Placed("ball", "grey", place(shift, 0.5, -1.0)),
                    Placed("lamp", name, place(shift, 0.0, 2.0))]
    materials = {"grey": material(color=0.6), "bright": emitter(bright), "dark": emitter(dark)}
    cameras = [look_at((shift, -2.0, 0.0), (shift, 0.5, -0.5), SIZE, 1.0) for shift in (0.0, DISTANCE)]
    scene = make_scene(meshes, objects, materials, cameras[1])
    frames = trial.choose(24, 256)
    expected = luminance(trial.render(scene, RT, frames, SIZE)).mean()
    scene.camera = cameras[0]
    session, settings = trial.start(scene, RT, SIZE)
    session.step(32)
    trial.take(session)
    session.configure(settings, cameras[1], *SIZE)
    session.step(frames)
    light = luminance(trial.take(session)).mean()
    trial.check_energy(f"{frames} frames after the jump", light / expected, 0.05)


def run_churn(trial: Trial) -> None:
    """Let objects come and go, and the scene be replaced, every few frames."""
    session, settings = trial.start(room(SIZE), RT, SIZE)
    table = room(SIZE).delta.instances
    for step in range(trial.choose(12, 60)):
        objects = [
            Placed(table.mesh_keys[table.mesh_index[row]], table.material_sets[table.material_set_index[row]][0],
                   table.transforms[row]) for row in range(len(table.mesh_index)) if (row + step) % 4]
        # Meshes that no instance uses are forgotten: they come again with those that do.
        some = SceneDelta(instances=make_table(objects), meshes=room(SIZE).delta.meshes)
        session.update(some if step % 5 else room(SIZE).delta)
        session.step(2)
        trial.take(session)
    session.update(SceneDelta(instances=make_table([])))
    session.configure(settings, room(SIZE).camera, *SIZE)
    session.step(2)
    trial.take(session)


CASES = (
    Case("frames: at rest", "energy within 2 % of a third of the frames, 5 % of path tracing", run_rest),
    Case("frames: at rest in a furnace", "energy within 1 %", run_furnace, quick=False),
    Case("frames: in motion", "energy within 3 % of a new start", run_motion),
    Case("frames: a flash of 1e6 and 1e30", "energy within 5 % afterwards", run_burst),
    Case("frames: things come and go", "no bad pixel", run_churn),
    Case("cache: full", "energy within 10 %", run_full_cache),
    Case("cache: all cells in one bucket", "energy within 10 %", run_one_bucket),
    Case("cache: equal keys 16 km apart", "energy within 5 %", run_same_keys),
)
