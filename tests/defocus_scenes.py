# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes and cameras with depth of field: plain data, no Blender. Lengths in metres."""

from dataclasses import replace

from burnish.engine.session import Session
from burnish.engine.settings import DenoiserSettings, Integrator
from burnish.engine.stress import scenes as made
from burnish.engine.stress.scenes import look_at

from tests import scenes
from tests.glossy_scenes import checker, panel
from tests.light_scenes import ceiling_lamp

__all__ = ["SCENES", "before_bulbs", "behind_a_ball", "camera", "floor", "frames", "truth"]


def camera(eye, target, focus, radius, size=(160, 90), **fields):
    """Make a perspective camera with a lens of a radius [m] that sees 0.8 m at 1 m, in a picture of a size [px]."""
    return look_at(eye, target, size, 0.8, aperture_radius=radius, focus_distance=focus, **fields)


def behind_a_ball(size=(160, 90)):
    """A wall of squares in focus behind a ball and a post close to the camera."""
    delta = scenes.delta(
        {"wall": scenes.box(3.0), "ball": scenes.sphere(0.22),
         "post": made.box((-0.04, -0.04, -1.0), (0.04, 0.04, 1.0))},
        [("wall", scenes.place(0.0, 6.0, 0.0), "wall"), ("ball", scenes.place(-0.28, -1.4, 0.0), "red"),
         ("post", scenes.place(0.45, -1.5, 0.0), "grey")],
        {"wall": checker((0.8, 0.7, 0.3), (0.1, 0.15, 0.3), 0.3), "red": scenes.material(color=(0.7, 0.1, 0.08)),
         "grey": scenes.material(color=0.6)}, [ceiling_lamp(300.0)], background=0.5)
    return delta, camera((0.0, -3.0, 0.0), (0.0, 0.0, 0.0), 6.0, 0.06, size=size)


def before_bulbs(size=(160, 90), **fields):
    """A ball in focus before a dark wall with small bright bulbs, and a box half way."""
    bulbs = [("bulb", scenes.place(x, 5.0 + 0.3 * (i % 3), z), "bulb" if i % 2 else "warm")
             for i, (x, z) in enumerate([(-2.6, 0.9), (-1.8, -0.5), (-1.0, 0.8), (0.1, 1.2), (0.9, 0.3), (1.7, 1.0),
                                         (2.5, -0.2), (1.5, -0.9), (-2.7, -1.2)])]
    delta = scenes.delta(
        {"wall": scenes.box(4.0), "ball": scenes.sphere(0.35), "box": scenes.box(0.3),
         "bulb": scenes.sphere(0.04, rings=8)},
        [("wall", scenes.place(0.0, 10.5, 0.0), "wall"), ("ball", scenes.place(-0.15, 0.0, 0.0), "ball"),
         ("box", scenes.place(0.8, 1.2, -0.3), "box"), *bulbs],
        {"wall": checker((0.25, 0.2, 0.2), (0.1, 0.12, 0.2), 0.8),
         "ball": checker((0.7, 0.6, 0.2), (0.2, 0.4, 0.6), 0.12), "box": scenes.material(color=(0.3, 0.6, 0.3)),
         "bulb": panel((0.6, 0.8, 1.0), 150.0), "warm": panel((1.0, 0.7, 0.4), 150.0)},
        [ceiling_lamp(60.0)], background=0.15)
    return delta, camera((0.0, -3.0, 0.2), (0.0, 0.0, 0.0), 3.0, 0.08, size=size, **fields)


def floor(size=(160, 90)):
    """A floor of squares at a grazing angle, with balls along it, the middle one in focus."""
    balls = [("ball", scenes.place(0.35 * (i - 2), 1.4 * (i - 2) ** 3 / 4.0 + 0.4 * i, 0.2), "ball") for i in range(5)]
    delta = scenes.delta(
        {"floor": scenes.quad(30.0), "ball": scenes.sphere(0.2)}, [("floor", scenes.place(), "floor"), *balls],
        {"floor": checker((0.7, 0.7, 0.7), (0.12, 0.12, 0.12), 0.35), "ball": scenes.material(color=(0.2, 0.35, 0.7))},
        [ceiling_lamp(300.0)], background=0.6)
    return delta, camera((0.0, -3.2, 0.5), (0.0, 0.5, 0.15), 4.0, 0.05, size=size)


SCENES = {"ball": behind_a_ball, "bulbs": before_bulbs, "floor": floor}


def frames(delta, view, count=8, size=(160, 90), moves=(), settings=scenes.SETTINGS, **denoiser):
    """Return the session after frames without path-traced samples; `moves` are cameras of frames before the last."""
    settings = replace(
        settings, sampling=replace(settings.sampling, integrator=Integrator.REALTIME),
        denoiser=DenoiserSettings(**{"path_traced_rest": False, **denoiser}))
    session = Session(settings)
    session.update(delta)
    for each in moves:
        session.configure(settings, each, *size)
        session.step(1)
    session.configure(settings, view, *size)
    session.step(count)
    return session


def truth(delta, view, samples=256, size=(160, 90)):
    """Return the path-traced picture, float32 [h, w, 4]."""
    return scenes.render(delta, view, size, samples)
