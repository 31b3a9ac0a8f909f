# SPDX-License-Identifier: GPL-3.0-or-later
"""A room whose pictures are denoised, and sessions on it."""

from dataclasses import replace

from burnish.engine.scene import LightKind
from burnish.engine.session import DENOISED, Session
from burnish.engine.settings import CacheSettings, FilmSettings, Integrator, SamplingSettings

from tests import scenes

SIZE = (48, 32)
BOTH = (Integrator.REFERENCE, Integrator.REALTIME)


def room():
    """Make a white hall with boxes on its floor, most of its light indirect: a lamp shines at the ceiling."""
    meshes = {"hall": scenes.box(4.0, inward=True), "box": scenes.box(0.2)}
    objects = [("hall", scenes.place(z=4.0), "white")] + [
        ("box", scenes.place(x, 0.4 * x, 0.2), name) for x, name in ((-0.6, "red"), (0.0, "white"), (0.6, "red"))]
    return scenes.delta(
        meshes, objects, {"white": scenes.material(color=0.7), "red": scenes.material(color=(0.8, 0.1, 0.1))},
        [scenes.lamp(LightKind.POINT, 500.0, scenes.place(3.0, 1.0, 7.5), radius=0.1)])


def settings_of(integrator, **film):
    """Return settings of an integrator."""
    return replace(scenes.SETTINGS, sampling=SamplingSettings(integrator=integrator),
                   cache=CacheSettings(capacity=14), film=FilmSettings(**film))


def open_session(integrator, passes=("Combined", DENOISED), delta=None, camera=None, **film):
    """Open a session on the room, to be denoised."""
    settings = settings_of(integrator, **film)
    made = Session(settings)
    made.update(delta or room())
    made.configure(settings, camera or scenes.camera_above(3.0, 1.0), *SIZE, passes=passes)
    return made
