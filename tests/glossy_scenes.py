# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirrors, glass, metal, coats and rough floors for tests of reflections: plain data, no Blender. Lengths in metres."""

import dataclasses
from collections.abc import Callable

import numpy as np
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import ColorEncoding, ImageData, MaterialData, SceneDelta, WorldData

from tests import scenes
from tests.light_scenes import LitScene, ceiling_lamp, look_at, slab

EYE = np.eye(4)
SHARED = {"ior": 1.5, "specular_level": 0.5, "specular_tint": (1.0, 1.0, 1.0), "coat_ior": 1.5, "coat_tint": 1.0,
          "sheen_tint": 1.0, "sheen_roughness": 0.5}
"""Arguments of the Principled BSDF as Blender sets them"""


@dataclasses.dataclass
class GlossyScene(LitScene):
    """A scene with what is to be looked at, and with how it moves."""

    mask: Callable | None = None
    """Tells from world positions [h, w, 3] which pixels show the reflecting surface; None: all"""
    change: Callable[[int], SceneDelta] | None = None
    """Makes what changes for a frame, counted from 1; None: nothing moves"""
    frames: int = 0
    """Frames for which it moves"""


def glossy(emission=0.0, **arguments):
    """Make a Principled material; an argument may be a function of the ProgramBuilder that returns its value."""
    builder = ProgramBuilder()
    values = {name: value(builder) if callable(value) else value for name, value in {**SHARED, **arguments}.items()}
    if emission:
        builder.emit((emission,) * 3, 1.0, 1.0)
    builder.closure("PRINCIPLED", 1.0, multiscatter=True, **values)
    return MaterialData(name="glossy", program=builder.finish(), has_emission=emission > 0,
                        constant_emission=(emission,) * 3 if emission else None)


def metal(roughness, color=(0.9, 0.88, 0.85), **arguments):
    """Make a metal."""
    return glossy(color=color, metallic=1.0, roughness=roughness, **arguments)


def glass(roughness=0.0, color=1.0):
    """Make glass."""
    return glossy(color=color, transmission=1.0, roughness=roughness)


def panel(color, strength):
    """Make a material that shines in a colour and reflects nothing."""
    builder = ProgramBuilder()
    builder.emit(color, strength, 1.0)
    return MaterialData(name="panel", program=builder.finish(), has_emission=True,
                        constant_emission=tuple(strength * c for c in color))


def checker(first, second, size=0.5):
    """Make a matte checker board of cubes of a side [m]."""
    builder = ProgramBuilder()
    scaled = builder.vector("MULTIPLY", builder.input("SCENE_POSITION"), (1 / size,) * 3)
    shifted = builder.vector("ADD", scaled, (0.013, 0.017, 0.019))
    builder.closure("DIFFUSE", 1.0, color=builder.mix("MIX", builder.procedural("CHECKER", shifted), first, second))
    return MaterialData(name="checker", program=builder.finish())


def bumps(strength=0.6, size=0.12, distance=0.03):
    """Return a function that makes a bumpy normal."""

    def make(builder):
        point = builder.vector("MULTIPLY", builder.input("OBJECT"), (1 / size,) * 3)
        height = builder.component(builder.procedural("NOISE", point, (1.0, 0.5, 2.0), (0.0, 1.0, 0.0)), 0)
        return builder.bump(height, strength, distance, 0.1)

    return make


def turned(matrix, angle):
    """Return a transform after a turn about the vertical axis through its own origin."""
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return matrix @ turn


def sky():
    """Make a world of a blue gradient, a warm soft patch and a grey base."""
    builder = ProgramBuilder()
    direction = builder.input("POSITION")
    up = builder.math("MAXIMUM", builder.component(direction, 2), 0.0)
    builder.emit((0.4, 0.55, 0.8), up, 0.6)
    along = builder.vector("DOT_PRODUCT", direction, (-0.6, -0.64, 0.48))
    builder.emit((1.0, 0.7, 0.4), builder.math("POWER", builder.math("MAXIMUM", along, 0.0), 12.0), 1.5)
    builder.emit((1.0, 1.0, 1.0), 1.0, 0.1)
    return WorldData(name="sky", program=builder.finish(), importance_resolution=256)


# What the sweeps of roughness look at.


def ball(size, material):
    """Make a ball on a floor under a sky and an area lamp."""
    lamp = scenes.lamp("AREA", 30.0, turned_lamp((1.5, -1.5, 2.2), (0.0, 0.0, 0.4)), shape="SQUARE", size_x=0.8,
                       size_y=0.8)
    delta = scenes.delta(
        {"floor": scenes.quad(8.0), "ball": scenes.sphere(0.5, 64)},
        [("floor", EYE, "floor"), ("ball", scenes.place(z=0.5), "glossy")],
        {"floor": checker(0.5, 0.2), "glossy": material}, [lamp], sky())
    return GlossyScene(delta, look_at((0.0, -2.6, 1.1), (0.0, 0.0, 0.5), size, 0.62 * size[0] / size[1]), [lamp],
                       mask=lambda p: np.abs(np.linalg.norm(p - (0.0, 0.0, 0.5), axis=-1) - 0.5) < 0.01)


def turned_lamp(eye, target):
    """Return the transform of a lamp that shines from a point to another."""
    return np.array(look_at(eye, target, (1, 1)).transform).reshape(4, 4)


def floor_mask(p):
    """Tell which positions lie on the floor."""
    return (np.abs(p[..., 2]) < 1e-3) & p.any(-1)


def colored_room(size, material):
    """Make a floor before coloured walls, bright panels and a ball, open above to a dim sky."""
    walls = {"back": slab((-2, 2, 0), (2, 2.1, 1.5)), "left": slab((-2.1, -2, 0), (-2, 2, 1.5)),
             "right": slab((2, -2, 0), (2.1, 2, 1.5)), "floor": slab((-2, -2, -0.1), (2, 2, 0)),
             "blue": slab((-1.2, 1.9, 0.3), (-0.6, 1.95, 0.9)), "warm": slab((0.5, 1.9, 0.2), (0.7, 1.95, 1.2)),
             "ball": scenes.sphere(0.3, 32)}
    materials = {
        "back": checker((0.7, 0.7, 0.2), (0.6, 0.6, 0.6), 0.4), "left": scenes.material(color=(0.7, 0.1, 0.08)),
        "right": scenes.material(color=(0.1, 0.6, 0.12)), "blue": panel((0.2, 0.4, 1.0), 2.0),
        "warm": panel((1.0, 0.6, 0.25), 3.0), "floor": material, "ball": scenes.material(color=0.7)}
    objects = [(name, scenes.place(0.0, 0.9, 0.3) if name == "ball" else EYE, name) for name in walls]
    delta = scenes.delta(walls, objects, materials, [ceiling_lamp(20.0, z=2.5)], 0.1)
    return GlossyScene(delta, look_at((0.1, -2.3, 1.0), (0.0, 0.9, 0.1), size, 1.0), mask=floor_mask)


def ramp_floor(size, metallic):
    """Make a floor whose roughness goes from 0 at the left of the picture to 1 at its right, before a bright wall."""

    def roughness(builder):
        return builder.math("CLAMP", builder.component(builder.uv(""), 0), 0.0, 1.0)

    width = 2.0
    floor = scenes.quad(width / 2)
    objects = [("floor", EYE, "floor"), ("wall", EYE, "wall"), ("panel", EYE, "panel")]
    delta = scenes.delta(
        {"floor": floor, "wall": slab((-3, 1, 0), (3, 1.1, 1.2)), "panel": slab((-3, 0.95, 0.5), (3, 0.99, 0.55))},
        objects, {"floor": glossy(color=0.5, metallic=metallic, roughness=roughness), "panel": panel((1, 1, 1), 3.0),
                  "wall": checker((0.8, 0.5, 0.2), (0.2, 0.4, 0.7), 0.25)}, background=0.3)
    return GlossyScene(delta, look_at((0.0, -2.4, 0.9), (0.0, 0.1, 0.0), size, 0.95), mask=floor_mask)


def thin_emitter(size, material, upright):
    """Make a dark floor that shows a thin shining bar, lying across the picture or upright; all else is black."""
    ends = ((-0.01, 0.99, 0.15), (0.01, 1.01, 0.6)) if upright else ((-3.0, 0.99, 0.3), (3.0, 1.01, 0.32))
    delta = scenes.delta(
        {"floor": scenes.quad(8.0), "bar": slab(*ends)}, [("floor", EYE, "glossy"), ("bar", EYE, "bar")],
        {"glossy": material, "bar": panel((1.0, 1.0, 1.0), 20.0)})
    return GlossyScene(delta, look_at((0.0, -1.6, 0.8), (0.0, 0.3, 0.0), size, 0.9), mask=floor_mask)


def round_lamp(size, material, radius):
    """Make a floor under a lamp of a radius; all else is black."""
    lamp = scenes.lamp("POINT", 12.0, scenes.place(0.0, 1.2, 1.2), radius=radius)
    delta = scenes.delta({"floor": scenes.quad(8.0)}, [("floor", EYE, "glossy")], {"glossy": material}, [lamp])
    return GlossyScene(delta, look_at((0.0, -1.6, 1.2), (0.0, 0.0, 0.0), size, 1.0), [lamp], mask=floor_mask)


# What mirrors, glass and rough metal are measured with: things in one closed room.

ROOM = {"floor": ((-2.5, -4, -0.1), (2.5, 2, 0)), "ceiling": ((-2.5, -4, 2.6), (2.5, 2, 2.7)),
        "back": ((-2.5, 2, 0), (2.5, 2.1, 2.6)), "front": ((-2.5, -4.1, 0), (2.5, -4, 2.6)),
        "left": ((-2.6, -4, 0), (-2.5, 2, 2.6)), "right": ((2.5, -4, 0), (2.6, 2, 2.6)),
        "picture": ((0.6, -3.99, 0.9), (1.6, -3.96, 1.7))}
CHROME = metal(0.0)
MIRROR = ((-2.2, 1.9, 0.3), (2.2, 1.95, 2.2))
"""On the back wall"""


def stage(size, meshes, objects, materials, target=(0.0, 0.8, 0.75), eye=(0.3, -2.9, 1.3), images=None, power=70.0,
          **fields):
    """Make a closed room with coloured walls, a shining picture behind the camera and things in it."""
    walls = {
        "floor": checker((0.55, 0.5, 0.45), (0.25, 0.22, 0.2)), "ceiling": scenes.material(color=0.75),
        "back": scenes.material(color=(0.6, 0.6, 0.55)), "front": checker((0.6, 0.6, 0.3), (0.3, 0.4, 0.6), 0.4),
        "left": scenes.material(color=(0.65, 0.15, 0.1)), "right": scenes.material(color=(0.15, 0.5, 0.2)),
        "picture": panel((0.9, 0.8, 0.5), 1.5)}
    lamps = [ceiling_lamp(power, y=-0.5, z=2.55, side=0.9)] if power else []
    lamps += fields.pop("lamps", [])
    rest = [(name, EYE, name) for name in ROOM]
    delta = scenes.delta({**{name: slab(*ends) for name, ends in ROOM.items()}, **meshes}, rest + objects,
                         {**walls, **materials}, lamps)
    delta.images = images or {}
    change = fields.pop("change", None)
    if change is not None:
        fields["change"] = lambda frame: SceneDelta(instances=scenes.instances(rest + change(frame)))
    return GlossyScene(delta, look_at(eye, target, size, 1.1), lamps, **fields)


def off_screen(size):
    """Show in a mirror what the camera does not see: a ball and a cube behind it."""
    return stage(
        size, {"mirror": slab(*MIRROR), "ball": scenes.sphere(0.5, 32), "cube": scenes.box(0.4)},
        [("mirror", EYE, "mirror"), ("ball", scenes.place(-0.9, -3.2, 0.5), "red"),
         ("cube", turned(scenes.place(1.2, -3.0, 0.4), 0.5), "blue")],
        {"mirror": CHROME, "red": scenes.material(color=(0.8, 0.1, 0.08)),
         "blue": checker((0.1, 0.2, 0.8), (0.8, 0.8, 0.8), 0.2)})


def mirror_in_mirror(size):
    """Show a ball between two mirrors that face each other."""
    return stage(
        size, {"mirror": slab(*MIRROR), "other": slab((-2.2, -3.95, 0.3), (0.4, -3.9, 2.2)),
               "ball": scenes.sphere(0.35, 32)},
        [("mirror", EYE, "mirror"), ("other", EYE, "mirror"), ("ball", scenes.place(-0.6, 0.6, 0.35), "red")],
        {"mirror": CHROME, "red": scenes.material(color=(0.8, 0.1, 0.08))}, target=(-0.3, 0.8, 0.9))


def moving_mirror(size, frames=24):
    """Turn a mirror that stands on the floor by 40 degrees."""

    def objects(frame):
        angle = np.radians(-20.0 + 40.0 * min(frame, frames) / frames)
        return [("plate", turned(scenes.place(0.0, 0.8, 0.0), angle), "mirror"),
                ("ball", scenes.place(1.3, 0.0, 0.3), "red")]

    return stage(size, {"plate": slab((-0.9, -0.02, 0.1), (0.9, 0.02, 1.6)), "ball": scenes.sphere(0.3, 32)},
                 objects(0), {"mirror": CHROME, "red": scenes.material(color=(0.8, 0.1, 0.08))}, change=objects,
                 frames=frames)


def mirrored_mover(size, frames=24):
    """Let a ball pass behind the camera, seen in a mirror only, and another in view of both."""

    def objects(frame):
        x = -1.8 + 3.4 * min(frame, frames) / frames
        return [("mirror", EYE, "mirror"), ("ball", scenes.place(x, -3.4, 0.9), "red"),
                ("small", scenes.place(-x, 0.6, 0.25), "blue")]

    return stage(size, {"mirror": slab(*MIRROR), "ball": scenes.sphere(0.45, 32), "small": scenes.sphere(0.25, 32)},
                 objects(0), {"mirror": CHROME, "red": scenes.material(color=(0.8, 0.1, 0.08)),
                              "blue": scenes.material(color=(0.1, 0.2, 0.8))}, change=objects, frames=frames)


def glass_before_mirror(size):
    """Show a mirror through a pane of glass, beside it the mirror alone."""
    return stage(
        size, {"mirror": slab(*MIRROR), "pane": slab((-1.6, 0.9, 0.05), (0.1, 0.92, 2.0)),
               "ball": scenes.sphere(0.35, 32)},
        [("mirror", EYE, "mirror"), ("pane", EYE, "glass"), ("ball", scenes.place(-0.5, 1.4, 0.35), "red")],
        {"mirror": CHROME, "glass": glass(), "red": scenes.material(color=(0.8, 0.1, 0.08))})


def bumpy_chrome(size):
    """Show balls of chrome with shallow and with strong bumps."""
    return stage(
        size, {"ball": scenes.sphere(0.6, 64)},
        [("ball", scenes.place(-0.75, 0.6, 0.6), "strong"), ("ball", scenes.place(0.75, 0.6, 0.6), "weak")],
        {"strong": metal(0.03, normal=bumps()), "weak": metal(0.03, normal=bumps(0.2, 0.3))})


def brushed(size):
    """Show a metal plate whose roughness changes strongly along streaks and blots, and a ball of it."""
    rng = np.random.default_rng(1)
    streaks = np.repeat(rng.random((256, 8)), 32, 1)
    blots = np.kron(rng.random((16, 16)) < 0.3, np.ones((16, 16)))
    values = np.clip(0.05 + 0.35 * streaks + 0.4 * blots, 0.0, 1.0).astype(np.float32)
    image = ImageData(name="brushed", pixels=values[..., None], encoding=ColorEncoding.LINEAR)

    def roughness(builder):
        return builder.component(builder.image("brushed", builder.uv("")), 0)

    plate = scenes.place(0.0, 1.0, 0.9) @ tilted(93.0)
    return stage(size, {"plate": scenes.quad(0.9), "ball": scenes.sphere(0.3, 32)},
                 [("plate", plate, "brushed"), ("ball", scenes.place(0.5, -0.2, 0.3), "red")],
                 {"brushed": metal(roughness), "red": scenes.material(color=(0.8, 0.1, 0.08))},
                 images={"brushed": image})


def tilted(degrees):
    """Return a turn about the x axis."""
    a, matrix = np.radians(degrees), np.eye(4)
    matrix[1:3, 1:3] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
    return matrix


def lamp_in_rough_floor(size):
    """Show a small bright lamp in a rough dark floor, and a dim large one."""
    lamps = [scenes.lamp("POINT", 40.0, scenes.place(-0.5, 1.0, 0.8), radius=0.02)]
    return stage(size, {"plate": slab((-2.4, -3.9, 0), (2.4, 1.9, 0.01))}, [("plate", EYE, "plate")],
                 {"plate": glossy(color=0.02, roughness=0.35)}, power=10.0, lamps=lamps, target=(0.0, 0.4, 0.2))


def glass_sphere(size):
    """Show a ball of clear glass and one of rough glass."""
    return stage(
        size, {"ball": scenes.sphere(0.6, 64)},
        [("ball", scenes.place(-0.75, 0.6, 0.6), "clear"), ("ball", scenes.place(0.75, 0.6, 0.6), "rough")],
        {"clear": glass(), "rough": glass(0.25)})


def coated(size):
    """Show a smooth coat over a rough base, over a metal beside it."""
    coat = {"coat": 1.0, "coat_roughness": 0.03}
    return stage(
        size, {"ball": scenes.sphere(0.6, 64)},
        [("ball", scenes.place(-0.75, 0.6, 0.6), "paint"), ("ball", scenes.place(0.75, 0.6, 0.6), "metal")],
        {"paint": glossy(color=(0.6, 0.05, 0.04), roughness=0.6, **coat),
         "metal": metal(0.45, (0.3, 0.4, 0.7), **coat)})


def rough_metal(size):
    """Show balls of rough gold and of brushed steel on a polished floor."""
    return stage(
        size, {"ball": scenes.sphere(0.6, 64), "plate": slab((-2.4, -3.9, 0), (2.4, 1.9, 0.01))},
        [("ball", scenes.place(-0.75, 0.6, 0.61), "gold"), ("ball", scenes.place(0.75, 0.6, 0.61), "steel"),
         ("plate", EYE, "plate")],
        {"gold": metal(0.5, (1.0, 0.75, 0.35)), "steel": metal(0.3, (0.6, 0.6, 0.62)),
         "plate": glossy(color=(0.3, 0.2, 0.12), roughness=0.1)})


MIRRORS = {made.__name__: made for made in (
    off_screen, mirror_in_mirror, moving_mirror, mirrored_mover, glass_before_mirror, bumpy_chrome, brushed,
    lamp_in_rough_floor, glass_sphere, coated, rough_metal)}
"""Scenes by name, each a function of the picture's size"""


# White furnaces.

ROUGHNESSES = (0.0, 0.1, 0.25, 0.45, 0.7, 1.0)


def white_balls(size, rows):
    """Make rows of balls, one for each material of `rows`, under a sky of radiance 1, seen along the horizon.

    The mask of a ball is told by `ball_mask`.
    """
    columns = max(len(row) for row in rows)
    materials = {f"{i} {j}": material for j, row in enumerate(rows) for i, material in enumerate(row)}
    objects = [("ball", scenes.place(*ball_place(i, j, columns, len(rows))), f"{i} {j}")
               for j, row in enumerate(rows) for i in range(len(row))]
    delta = scenes.delta({"ball": scenes.sphere(0.45, 32)}, objects, materials, background=1.0)
    wide = max(columns, len(rows) * size[0] / size[1])
    return GlossyScene(delta, look_at((0.0, -20.0, 0.0), (0.0, 0.0, 0.0), size, wide / 20.0))


def ball_place(i, j, columns, rows):
    """Return the centre of a ball."""
    return i - 0.5 * (columns - 1), 0.0, 0.5 * (rows - 1) - j


def ball_mask(positions, i, j, columns, rows):
    """Return the pixels whose positions lie on a ball."""
    away = np.linalg.norm(positions - np.array(ball_place(i, j, columns, rows)), axis=-1)
    return (np.abs(away - 0.45) < 0.01) & positions.any(-1)


def glossy_box(size, emission=0.5, **arguments):
    """Make a closed cube of side 2 m that emits and reflects."""
    delta = scenes.delta({"box": scenes.box(1.0, inward=True)}, [("box", EYE, "wall")],
                         {"wall": glossy(emission, **arguments)})
    return GlossyScene(delta, look_at((0.3, -0.8, 0.2), (-0.2, 1.0, -0.3), size, 1.4))
