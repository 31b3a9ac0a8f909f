# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras inside things, on surfaces, with extreme clipping and fields of view; pictures of odd sizes."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

from ..scene import CameraData, CameraKind
from ..settings import Integrator, ReflectionResolution
from .cases import BOTH, Case, Trial, luminance
from .scenes import StressScene, changed, look_at, room

__all__ = ["CASES", "SIZES"]

SIZE = (32, 24)
SIZES = ((1, 1), (1, 7), (3, 1), (2, 2), (17, 5), (5, 17), (33, 1), (1, 64), (7, 13), (129, 3))
FIELDS_OF_VIEW = (0.1, 1.0, 90.0, 150.0, 179.0)
CLIPS = ((1e-6, 1e9), (1e-6, 1e3), (1e-3, 1e9), (0.0, 1e17))


def seen_from(eye: tuple[float, float, float], target: tuple[float, float, float], **fields: float) -> StressScene:
    """Return the room from another place."""
    scene = room(SIZE)
    return changed(scene, camera=look_at(eye, target, SIZE, 1.0, **fields))


def run_places(trial: Trial, integrator: Integrator) -> None:
    """Look from inside an opaque thing, glass and metal, from on surfaces, along them, from lamps and from far off."""
    places = {
        "in a block": ((-0.75, 0.75, 0.5), (0.0, 0.0, 0.5)), "in metal": ((0.75, 0.75, 0.5), (0.0, -1.0, 0.5)),
        "in glass": ((0.125, -0.25, 0.375), (0.0, 1.0, 0.5)), "on the floor": ((0.5, -2.0, 0.0), (0.0, 0.5, 0.5)),
        "along the floor": ((0.5, -2.0, 0.0), (0.5, 2.0, 0.0)), "below the floor": ((0.0, -2.0, -1.0), (0, 0.5, 0.5)),
        "on a wall": ((-2.0, 0.0, 1.0), (0.0, 0.5, 0.5)), "in a lamp": ((-1.5, -1.0, 1.75), (0.0, 0.5, 0.5)),
        "on the area lamp": ((0.0, 0.0, 2.5), (0.0, 0.5, 0.5)), "in a corner": ((-2.0, 2.0, 0.0), (0.0, 0.0, 0.5)),
        "on a ball's pole": ((0.75, 0.75, 1.0), (0.0, -1.0, 0.5)), "far off": ((0.0, -1e5, 1e4), (0.0, 0.0, 0.5)),
        "very far off": ((0.0, -1e9, 1e8), (0.0, 0.0, 0.5)), "straight down": ((0.0, 0.0, 2.0), (0.0, 0.0, 0.0)),
    }
    for eye, target in list(places.values())[::trial.choose(2, 1)]:
        trial.render(seen_from(eye, target, clip_start=0.0), integrator, trial.choose(3, 32), SIZE)


def run_clips(trial: Trial, integrator: Integrator) -> None:
    """Find the same picture with any clipping range that holds the whole room, and a sound one where it cuts."""
    amount = trial.choose(6, 64)
    expected = trial.render(room(SIZE), integrator, amount, SIZE)
    for start, end in trial.choose(CLIPS[::3], CLIPS):
        scene = room(SIZE)
        scene.camera = replace(scene.camera, clip_start=start, clip_end=end)
        trial.check_same(f"clip {start:g} to {end:g}", expected, trial.render(scene, integrator, amount, SIZE))
    for start, end in ((3.0, 4.0), (1e9, 1e10), (5.0, 1.0), (1e-6, 1e-5), (-1.0, 2.0)):
        scene.camera = replace(scene.camera, clip_start=start, clip_end=end)
        trial.render(scene, integrator, 4, SIZE)


def run_lenses(trial: Trial, integrator: Integrator) -> None:
    """Look through every field of view, shifted, orthographic and with open lenses; the light stays what it is."""
    amount = trial.choose(16, 256)
    for degrees in trial.choose((0.1, 179.0), FIELDS_OF_VIEW):
        scene = seen_from((0.5, -1.9, 1.5), (0.0, 2.0, 1.25))
        half = math.tan(math.radians(0.5 * degrees))
        camera = replace(scene.camera, window=(-half, half, -0.75 * half, 0.75 * half))
        picture = trial.render(changed(scene, camera=camera), integrator, amount, SIZE)
        if integrator == Integrator.REALTIME:
            truth = trial.render(changed(scene, camera=camera), Integrator.REFERENCE, 2 * amount, SIZE)
            ratio = luminance(picture).mean() / luminance(truth).mean()
            trial.check_energy(f"field of view of {degrees:g} degrees", ratio, 0.15)
    base = room(SIZE)
    for camera in (
        replace(base.camera, window=(10.0, 10.001, -5.0, -4.999)), replace(base.camera, window=(0.5, -0.5, 0.4, -0.4)),
        replace(base.camera, window=(-1e-9, 1e-9, -1e-9, 1e-9)), replace(base.camera, window=(0.0, 0.0, 0.0, 0.0)),
        orthographic(4.0), orthographic(1e-6), orthographic(1e6),
        replace(base.camera, aperture_radius=1e-9, focus_distance=3.0),
        replace(base.camera, aperture_radius=10.0, focus_distance=1e-6),
        replace(base.camera, aperture_radius=0.1, focus_distance=1e15, aperture_blades=3, aperture_ratio=1e-3),
    ):
        trial.render(changed(base, camera=camera), integrator, 4, SIZE)


def orthographic(width: float) -> CameraData:
    """Return a camera without perspective."""
    base = room(SIZE).camera
    return replace(base, kind=CameraKind.ORTHOGRAPHIC, window=(-width / 2, width / 2, -0.375 * width, 0.375 * width))


def run_sizes(trial: Trial, integrator: Integrator) -> None:
    """Render pictures of one pixel, one row, one column and odd sides, growing and shrinking the same session."""
    amount = trial.choose(3, 64)
    resolutions = tuple(ReflectionResolution) if integrator == Integrator.REALTIME else (None,)
    for resolution in resolutions[:trial.choose(1, 3)]:
        groups = {"reflections": {"resolution": resolution}} if resolution is not None else {}
        for size in trial.choose(SIZES[:5], SIZES):
            picture = trial.render(room(size), integrator, amount, size, **groups)
            trial.check(f"{size}: rows and columns", float(picture.shape[:2] == size[::-1]), 1.0, 1.0)
            trial.check(f"{size}: light", luminance(picture).mean(), 1e-3, 1e3)


def run_crops(trial: Trial, integrator: Integrator) -> None:
    """Render regions down to a pixel at every edge of the frame."""
    session, settings = trial.start(room(SIZE), integrator, SIZE)
    for crop in ((0, 0, 1, 1), (31, 23, 1, 1), (0, 23, 32, 1), (13, 0, 1, 24), (5, 7, 3, 2)):
        session.configure(settings, room(SIZE).camera, *SIZE, crop=crop)
        session.step(trial.choose(4, 16))
        picture = trial.take(session)
        trial.check(f"region {crop}: rows and columns", float(picture.shape[:2] == (crop[3], crop[2])), 1.0, 1.0)


def make_cases() -> tuple[Case, ...]:
    """Return all cases."""
    cases = []
    for integrator in BOTH:
        cases += [
            Case(f"cameras: inside, on and far from things, {integrator}", "no bad pixel", partial(
                run_places, integrator=integrator)),
            Case(f"cameras: clip 1e-6 to 1e9 m, {integrator}", "FLIP at most 0.01 where nothing is cut", partial(
                run_clips, integrator=integrator)),
            Case(f"cameras: field of view 0.1 to 179 degrees, {integrator}",
                 "energy within 15 % of path tracing in real time", partial(run_lenses, integrator=integrator)),
            Case(f"sizes: from 1 x 1, {integrator}", "right shape, light", partial(
                run_sizes, integrator=integrator)),
            Case(f"sizes: regions, {integrator}", "right shape", partial(run_crops, integrator=integrator)),
        ]
    return tuple(cases)


CASES = make_cases()
