# SPDX-License-Identifier: GPL-3.0-or-later
"""Rooms, walls, contacts and movers for tests of global illumination: plain data, no Blender. Lengths in metres."""

import dataclasses

import numpy as np
from burnish.engine.scene import CameraData, SceneDelta, Visibility
from burnish.engine.stress.scenes import StressScene, look_at
from burnish.engine.stress.scenes import box as slab

from tests import scenes

UNSEEN = int(Visibility.ALL & ~Visibility.CAMERA)
"""Visible to all rays but the camera's"""


@dataclasses.dataclass
class LitScene(StressScene):
    """A scene with its camera and its lamps."""

    lamps: list = dataclasses.field(default_factory=list)


def above(center, size, width, height=20.0):
    """Make an orthographic camera that looks down on a rectangle `width` wide."""
    tall = width * size[1] / size[0]
    return CameraData(kind="orthographic", transform=tuple(scenes.place(*center, height).ravel().tolist()),
                      clip_start=1e-3, window=(-width / 2, width / 2, -tall / 2, tall / 2))


def ceiling_lamp(power, x=0.0, y=0.0, z=2.4, side=0.5):
    """Make a square area lamp that shines down and that the camera does not see."""
    return scenes.lamp("AREA", power, scenes.place(x, y, z), shape="SQUARE", size_x=side, size_y=side,
                       visibility=UNSEEN)


def furnace(albedo, size):
    """Make a closed cube of side 2 m that emits 1: radiance is 1 / (1 - albedo) everywhere."""
    delta = scenes.delta({"box": scenes.box(1.0, inward=True)}, [("box", np.eye(4), "wall")],
                         {"wall": scenes.emitter(1.0, albedo)})
    return LitScene(delta, look_at((0.3, -0.8, 0.2), (-0.2, 1.0, -0.3), size, 1.4))


def white_sky(albedo, size, shape="plane"):
    """Make a plane or a sphere under a sky of radiance 1: the picture of it is its albedo."""
    made = scenes.quad(200.0) if shape == "plane" else scenes.sphere(1.0, 32)
    delta = scenes.delta({"thing": made}, [("thing", np.eye(4), "grey")], {"grey": scenes.material(color=albedo)},
                         background=1.0)
    target = (0.0, 0.0, 0.0)
    return LitScene(delta, look_at((0.0, -3.0, 2.0), target, size, 0.8 if shape == "plane" else 0.7))


def white_niche(albedo, size):
    """Make a floor and a wall at right angles in a white sky, reflecting each other; no lamp."""
    delta = scenes.delta(
        {"floor": slab((-3, -3, -0.2), (3, 0, 0)), "wall": slab((-3, 0, -0.2), (3, 0.2, 3))},
        [("floor", np.eye(4), "grey"), ("wall", np.eye(4), "grey")], {"grey": scenes.material(color=albedo)},
        background=1.0)
    return LitScene(delta, look_at((0.0, -2.5, 1.5), (0.0, 0.0, 0.3), size, 1.0))


def divided_room(size, thickness=0.02):
    """Make a closed room of 4 x 3 x 2.5 m, seen from above, with a wall at x = 0: lit where x < 0, dark beyond it.

    A pixel is 6.25 mm wide, as if 640 of them showed the room: small pictures show what is near the wall. Cells grow
    with the pixels and filters count them, so that with larger ones nothing thin could be told apart.
    """
    wall = slab((-thickness / 2, -1.5, 0.0), (thickness / 2, 1.5, 2.5))
    lamps = [ceiling_lamp(20.0, x=-1.0)]
    objects = [("room", np.eye(4), "grey", UNSEEN), ("floor", np.eye(4), "grey"), ("wall", np.eye(4), "grey")]
    delta = scenes.delta(
        {"room": slab((-2, -1.5, -0.001), (2, 1.5, 2.5), inward=True), "floor": slab((-2, -1.5, -0.1), (2, 1.5, 0.0)),
         "wall": wall}, objects, {"grey": scenes.material(color=0.7)}, lamps)
    return LitScene(delta, above((0.0, 0.0), size, min(size[0] / 160.0, 4.0, 3.0 * size[0] / size[1])), lamps)


def closed_room(albedo, size, power=25.0):
    """Make a closed room of 4 x 4 x 2.5 m with a lamp under the ceiling, seen from inside, looking into a corner.

    A second lamp, a thousandth as bright, is the last of `lamps`.
    """
    lamps = [ceiling_lamp(power), ceiling_lamp(1e-3 * power, x=1.0)]
    delta = scenes.delta({"room": slab((-2, -2, 0), (2, 2, 2.5), inward=True)}, [("room", np.eye(4), "grey")],
                         {"grey": scenes.material(color=albedo)}, lamps)
    return LitScene(delta, look_at((-1.2, -1.5, 1.4), (1.6, 2.0, 0.7), size, 1.2), lamps)


def contact(size, angle=0.5):
    """Make a turned cube of side 0.6 m on a floor under a grey sky, with a lamp to one side."""
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    lamps = [ceiling_lamp(40.0, x=-2.0, y=-1.0, z=2.5, side=1.0)]
    delta = scenes.delta(
        {"floor": scenes.quad(10.0), "cube": slab((-0.3, -0.3, 0.0), (0.3, 0.3, 0.6))},
        [("floor", np.eye(4), "grey"), ("cube", turn, "white")],
        {"grey": scenes.material(color=0.5), "white": scenes.material(color=0.8)}, lamps, 0.3)
    return LitScene(delta, look_at((0.4, -2.4, 1.3), (0.0, 0.0, 0.15), size, 0.6), lamps)


class Passing:
    """A ball that passes through a hall open to one side, then leaves for far away, where it goes on moving."""

    FRAMES = 20
    """From one side of the picture to the other"""

    def __init__(self, size):
        self.ball = scenes.sphere(0.45, 16)
        lamps = [ceiling_lamp(40.0, y=0.4)]
        delta = scenes.delta(
            {"hall": slab((-4, -1, -0.2), (4, 2, 0.0)), "back": slab((-4, 2, -0.2), (4, 2.2, 2.5)), "ball": self.ball},
            self.objects(0), {"grey": scenes.material(color=0.6), "red": scenes.material(color=(0.8, 0.15, 0.1))},
            lamps, 0.05)
        self.scene = LitScene(delta, look_at((0.0, -4.0, 1.5), (0.0, 1.0, 0.7), size, 0.8), lamps)

    def objects(self, frame):
        """Return the objects at a frame; from FRAMES on the ball is 300 m away."""
        x = -2.6 + 5.2 * frame / self.FRAMES if frame < self.FRAMES else 300.0 + 0.01 * frame
        return [("hall", np.eye(4), "grey"), ("back", np.eye(4), "grey"), ("ball", scenes.place(x, 0.6, 0.5), "red")]

    def change(self, frame):
        """Return what changes for a frame."""
        return SceneDelta(instances=scenes.instances(self.objects(frame)))
