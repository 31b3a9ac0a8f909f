# SPDX-License-Identifier: GPL-3.0-or-later
"""Test that means of reflections follow what is seen in turning mirrors, rough floors and curved metal."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.scene import SceneDelta
from burnish.engine.session import Session
from burnish.engine.settings import CacheSettings, DenoiserSettings, Integrator, SamplingSettings

from tests import glossy_scenes, scenes
from tests.glossy_scenes import glossy, metal, panel
from tests.light_scenes import look_at, slab

SIZE = (64, 40)
WARM_UP = 24


def settings(integrator, **denoiser):
    """Return settings of frames alone, or of Reference."""
    return dataclasses.replace(
        scenes.SETTINGS, sampling=SamplingSettings(integrator=integrator),
        cache=CacheSettings(capacity=16, cell_pixels=8.0, minimum_cell=0.02),
        denoiser=DenoiserSettings(path_traced_rest=False, **denoiser))


def last_frame(delta, steps, integrator=Integrator.REALTIME, count=1, size=SIZE, **denoiser):
    """Return the picture after changes and cameras, one frame each; of Reference the last alone, of `count` samples."""
    chosen = settings(integrator, **denoiser)
    session = Session(chosen)
    session.update(delta)
    first = True
    for change, camera in steps if integrator == Integrator.REALTIME else steps[-1:]:
        if change is not None:
            session.update(change)
        session.configure(chosen, camera, *size)
        session.step(WARM_UP if first and integrator == Integrator.REALTIME else count)
        first = False
    picture = session.read()[..., :3].astype(np.float64)
    session.close()
    return picture


def errors(delta, steps, samples=96):
    """Return the mean errors of the last frame with means over frames and without, bright sparks left out."""
    truth = last_frame(delta, steps, Integrator.REFERENCE, samples)
    found = []
    for temporal in (True, False):
        picture = last_frame(delta, steps, reflection_temporal=temporal, antialiasing=False)
        found.append(np.minimum(np.abs(np.minimum(picture, 1.0) - np.minimum(truth, 1.0)), 0.5).mean())
    return found


def around(camera, degrees, steps):
    """Return cameras that go around the point (0, 0.6) of the floor."""
    cameras = []
    for i in range(steps):
        a = np.radians(degrees) * i
        turn, there, back = np.eye(4), np.eye(4), np.eye(4)
        turn[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
        there[1, 3], back[1, 3] = 0.6, -0.6
        matrix = there @ turn @ back @ np.array(camera.transform).reshape(4, 4)
        cameras.append((None, dataclasses.replace(camera, transform=tuple(matrix.ravel()))))
    return cameras


def turning_mirror(steps=12):
    """Make a mirror that turns before a checkered wall with a bright panel, in the even light of a sky."""
    meshes = {"floor": slab((-3, -4, -0.1), (3, 3, 0)), "front": slab((-4, -4.1, 0), (4, -4, 3)),
              "picture": slab((0.2, -3.99, 0.9), (1.2, -3.9, 1.7)), "plate": slab((-1.0, -0.02, 0.1), (1.0, 0.02, 1.6))}
    materials = {"floor": scenes.material(color=0.4), "picture": panel((1.0, 0.9, 0.6), 3.0), "plate": metal(0.0),
                 "front": glossy_scenes.checker((0.7, 0.2, 0.1), (0.1, 0.3, 0.7), 0.5)}

    def objects(step):
        a = np.radians(-15.0 + 1.7 * step)
        turn = scenes.place(0.0, 0.8, 0.0)
        turn[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
        return [(name, turn if name == "plate" else np.eye(4), name) for name in meshes]

    camera = look_at((0.3, -2.9, 1.2), (0.0, 0.8, 0.8), SIZE, 0.9)
    delta = scenes.delta(meshes, objects(0), materials, background=0.6)
    return delta, [(SceneDelta(instances=scenes.instances(objects(step))), camera) for step in range(steps)]


def test_turning_mirrors_leave_no_ghosts():
    """Keep no light that a mirror showed before it turned, and what it showed where that is seen now."""
    kept, alone = errors(*turning_mirror())
    assert kept < 0.85 * alone


@pytest.mark.slow
@pytest.mark.parametrize(("made", "share"), [
    (lambda: glossy_scenes.colored_room(SIZE, metal(0.4)), 0.95),
    (lambda: glossy_scenes.colored_room(SIZE, glossy(color=0.05, roughness=0.3)), 0.97),
    (lambda: glossy_scenes.rough_metal(SIZE), 0.95)])
def test_highlights_follow_the_camera(made, share):
    """Follow the image of what rough floors and balls show as the camera goes around them: better than no means."""
    scene = made()
    kept, alone = errors(scene.delta, around(scene.camera, 0.9, 16), 128)
    assert kept < share * alone


@pytest.mark.slow
def test_mirrored_movers_are_seen_where_they_are():
    """Show in a mirror what moves there where it is now, not what each pixel showed before."""
    made = glossy_scenes.mirrored_mover(SIZE)
    steps = [(made.change(frame), made.camera) for frame in range(17)]
    first, truth = (last_frame(made.delta, part, Integrator.REFERENCE, 128) for part in (steps[:1], steps))
    truth, first = np.minimum(truth, 1.0), np.minimum(first, 1.0)
    # The balls' images, where they are and where they were.
    changed = (np.abs(truth - first).max(-1) > 0.12) & (np.arange(SIZE[1]) > 15)[:, None]
    assert changed.sum() > 30
    pictures = (np.minimum(last_frame(made.delta, steps, reflection_temporal=temporal, antialiasing=False), 1.0)
                for temporal in (True, False))
    kept, alone = (np.abs(picture - truth)[changed].mean() for picture in pictures)
    assert kept < 1.5 * alone


@pytest.mark.slow
def test_turning_mirrors_forget_what_stood_before_the_wall():
    """Leave no trail of a near thing on the farther one behind, whose image a turning mirror moves faster."""
    size = (112, 70)
    made = glossy_scenes.moving_mirror(size)
    steps = [(made.change(frame), made.camera) for frame in range(25)]
    truth, picture = (np.minimum(found, 1.0) for found in (
        last_frame(made.delta, steps, Integrator.REFERENCE, 96, size=size),
        last_frame(made.delta, steps, antialiasing=False, size=size)))
    # The green wall beside the ball's image.
    green = truth[..., 1] > 1.2 * truth[..., 0]
    green[:, size[0] * 2 // 3:] = False
    assert green.sum() > 500
    redder = (picture[..., 0] - picture[..., 1]) - (truth[..., 0] - truth[..., 1])
    assert np.maximum(redder[green] - 0.2, 0.0).sum() < 1.5


@pytest.mark.slow
def test_movers_are_lit_by_what_is_around_them():
    """Show in a mirror a ball that passes out of view with the light that reaches it from walls, known nowhere yet."""
    size = (112, 70)
    made = glossy_scenes.mirrored_mover(size)
    steps = [(made.change(frame), made.camera) for frame in range(13)]
    truth, picture = (np.minimum(found, 1.0) for found in (
        last_frame(made.delta, steps, Integrator.REFERENCE, 96, size=size),
        last_frame(made.delta, steps, antialiasing=False, size=size)))
    # The red ball's image; the wall on the left is as red.
    ball = truth[..., 0] > 3.0 * truth[..., 1]
    ball[:, :size[0] * 2 // 5] = False
    assert ball.sum() > 30
    assert picture[ball, 0].mean() > 0.61 * truth[ball, 0].mean()


def moving_wall(step, size=SIZE):
    """Return a scene, a camera and a change: a striped wall behind the camera slides past a flat mirror before it."""
    meshes = {"mirror": slab((-3, 2.0, -2), (3, 2.1, 2)), "stripe": slab((0.0, -3.1, -3), (0.4, -3.0, 3)),
              "post": slab((-0.2, 1.0, -2), (0.2, 1.1, 2))}
    materials = {"mirror": metal(0.0), "red": scenes.material(color=(0.7, 0.2, 0.1)),
                 "blue": scenes.material(color=(0.1, 0.3, 0.7)), "post": scenes.material(color=0.5)}

    def objects(frame):
        return [("mirror", np.eye(4), "mirror"), ("post", np.eye(4), "post"), *(
            ("stripe", scenes.place(0.4 * i + step * frame, 0.0, 0.0), "red" if i % 2 else "blue")
            for i in range(-12, 13))]

    camera = look_at((0.0, -1.0, 0.0), (0.0, 1.0, 0.0), size, 0.5)
    return (scenes.delta(meshes, objects(0), materials, background=0.6), camera,
            lambda frame: SceneDelta(instances=scenes.instances(objects(frame))))


@pytest.mark.parametrize("step", [0.06, -0.1])
def test_images_of_movers_lay_where_they_were(step):
    """Find by how many pixels the image of a sliding wall lay aside, and nothing for what stands still."""
    delta, camera, change = moving_wall(step)
    chosen = settings(Integrator.REALTIME)
    session = Session(chosen)
    session.update(delta)
    session.configure(chosen, camera, *SIZE)
    session.step(2)
    session.update(change(1))
    session.step(1)
    samples = session._realtime.pipeline.reflections.samples
    found = samples.shift.numpy().view(np.float16).reshape(SIZE[1] // 2, SIZE[0] // 2, 2).astype(np.float64)
    session.close()
    # The image of the wall lies 3 + 5 metres away, where the picture is 0.5 * 8 wide; that of the post stands still.
    expected = -step * SIZE[0] / (0.5 * 8.0)
    assert np.abs(found[4:-4, 4:8, 0] / expected - 1.0).max() < 0.02
    assert np.abs(found[..., 1]).max() < 0.01
    assert (np.abs(found[4:-4, SIZE[0] // 4 - 1, 0]) < 0.01).all()


@pytest.mark.slow
def test_movers_keep_their_means_in_mirrors():
    """Show a wall that slides past a mirror with less error than each pixel's samples of its own have."""
    delta, camera, change = moving_wall(0.06, (96, 60))
    kept, alone = errors(delta, [(change(frame), camera) for frame in range(12)], 48)
    assert kept < 0.92 * alone


@pytest.mark.slow
def test_light_over_a_mirror_moves_with_it():
    """Take the patch of light that a turning mirror throws onto the floor along: little is left where it was."""
    width, height = size = (128, 76)
    scene = glossy_scenes.moving_mirror(size)
    chosen = dataclasses.replace(scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME),
                                 denoiser=DenoiserSettings(path_traced_rest=False))

    def light(first, changes, after):
        """Return diffuse indirect light before the changes, one frame each, and `after` frames later."""
        session = Session(chosen)
        session.update(scene.delta)
        session.update(first)
        session.configure(chosen, scene.camera, *size, passes=("Combined", "Diffuse Indirect"))
        session.step(WARM_UP)
        before = session.read("Diffuse Indirect").mean(-1)
        for change in changes:
            session.update(change)
            session.step(1)
        session.step(after)
        picture = session.read("Diffuse Indirect").mean(-1)
        session.close()
        return before, picture

    _, steady = light(scene.change(scene.frames), [], 40)
    before, found = light(scene.change(0), [scene.change(frame + 1) for frame in range(scene.frames)], 8)
    floor = slice(height // 12, height // 4), slice(0, width // 5)
    start, end, now = (float(picture[floor].mean()) for picture in (before, steady, found))
    assert start > 1.5 * end
    assert (now - end) / (start - end) < 0.42, (start, end, now)
