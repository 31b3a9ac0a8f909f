# SPDX-License-Identifier: GPL-3.0-or-later
"""Hold light below surfaces in real-time frames against path tracing: bodies of several shapes and radii.

    python tests/performance/subsurface_frames.py [--size 160 120] [--frames 8 64] [--truth 512] [--radii 0.02 0.1 0.5]
        [--bodies ball,back,slab,box]
    python tests/performance/subsurface_frames.py --skin FILE.blend

The first prints FLIP, relMSE and the light of the body in each channel over path tracing's, with the setting
`reflections.subsurface` off and on, of frames alone. The second, with a Python that has bpy, saves a scene of a Suzanne
of skin and two bodies of wax before two lamps, for `burnish bench` and its like.
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.image_error import compare  # noqa: E402

from tests import scenes  # noqa: E402
from tests.light_checks import Setup  # noqa: E402
from tests.light_scenes import LitScene, look_at  # noqa: E402
from tests.unit.engine.test_subsurface import wax  # noqa: E402

COLOR = (0.8, 0.5, 0.4)
SHARES = (1.0, 0.3, 0.1)
"""Of the radius, in each channel"""


def lit_body(kind: str, radius: float, size: tuple[int, int]) -> LitScene:
    """Return a body on a floor before a lamp, or behind it: a ball of a metre, a box of two or a slab of 0.1."""
    mesh = scenes.sphere(0.5, 48) if kind in ("ball", "back") else scenes.box(1.0)
    if kind == "slab":
        mesh.positions[:, 1] *= 0.05
    place = (0.5, 2.5, 1.5) if kind in ("back", "slab") else (2.0, -1.0, 2.0)
    lamp = scenes.lamp("POINT", 120.0, scenes.place(*place), radius=0.2)
    materials = {"wax": wax(COLOR, tuple(radius * share for share in SHARES)), "floor": scenes.material(color=0.5)}
    delta = scenes.delta({"floor": scenes.quad(6.0), "body": mesh},
                         [("floor", scenes.place(), "floor"), ("body", scenes.place(z=0.5), "wax")], materials, [lamp],
                         0.1)
    return LitScene(delta, look_at((0.0, -4.0, 1.5), (0.0, 0.0, 0.5), size, 0.45))


def survey(options: argparse.Namespace) -> None:
    """Print a row for each body, radius, setting and number of frames."""
    size = tuple(options.size)
    print("| body | radius [m] | setting | frames | FLIP | relMSE | light R G B |\n|---|---|---|---|---|---|---|")
    for kind in options.bodies.split(","):
        for radius in options.radii:
            scene = lit_body(kind, radius, size)
            truth = Setup(size, truth_samples=options.truth).truth(scene)
            body = Setup(size).positions(scene)[..., 2] > 0.02
            for on in (False, True):
                session, done = Setup(size, groups={"reflections": {"subsurface": on}}).session(scene), 0
                for frames in options.frames:
                    session.step(frames - done)
                    picture, done = session.read()[..., :3], frames
                    error = compare(truth, picture)
                    light = picture[body].mean(0) / truth[body].mean(0)
                    print(f"| {kind} | {radius:g} | {'on' if on else 'off'} | {frames} | {error.flip:.4f} | "
                          f"{error.relative_mse:.4f} | {' '.join(f'{each:.3f}' for each in light)} |", flush=True)


def save_skin(path: Path) -> None:
    """Save the scene of a Suzanne of skin."""
    import bpy
    from mathutils import Vector

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene

    def material(name: str, **inputs: object) -> object:
        made = bpy.data.materials.new(name)
        made.use_nodes = True
        for key, value in inputs.items():
            made.node_tree.nodes["Principled BSDF"].inputs[key.replace("_", " ")].default_value = value
        return made

    def dress(what: object) -> None:
        bpy.context.object.data.materials.append(what)

    def add(data: object, place: tuple, target: tuple) -> object:
        made = bpy.data.objects.new(data.name, data)
        scene.collection.objects.link(made)
        made.location = place
        made.rotation_euler = (Vector(target) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
        return made

    skin = material("skin", Base_Color=(0.8, 0.5, 0.4, 1.0), Subsurface_Weight=1.0, Subsurface_Scale=0.08,
                    Subsurface_Radius=(1.0, 0.2, 0.1), Roughness=0.45)
    soft = material("wax", Base_Color=(0.9, 0.85, 0.6, 1.0), Subsurface_Weight=1.0, Subsurface_Scale=0.3,
                    Subsurface_Radius=(1.0, 0.7, 0.4), Roughness=0.3)
    floor = material("floor", Base_Color=(0.4, 0.4, 0.42, 1.0), Roughness=0.7)
    bpy.ops.mesh.primitive_monkey_add(size=2, location=(0, 0, 1), rotation=(math.radians(-15), 0, math.radians(20)))
    smooth = bpy.context.object.modifiers.new("smooth", "SUBSURF")
    smooth.levels = smooth.render_levels = 3
    bpy.ops.object.shade_smooth()
    dress(skin)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.45, location=(1.5, -0.6, 0.45))
    bpy.ops.object.shade_smooth()
    dress(soft)
    bpy.ops.mesh.primitive_cylinder_add(vertices=64, radius=0.3, depth=0.9, location=(-1.5, -0.4, 0.45))
    dress(soft)
    for place, turn in (((0, 0, 0), 0.0), ((0, 4, 0), math.pi / 2.0)):
        bpy.ops.mesh.primitive_plane_add(size=20, location=place, rotation=(turn, 0, 0))
        dress(floor)
    for place, power, width, color in (((3, -3, 4), 200, 1.0, (1, 1, 1)), ((-2.5, 2.5, 3), 250, 0.6, (1, 0.85, 0.7))):
        light = bpy.data.lights.new("lamp", "AREA")
        light.energy, light.size, light.color = power, width, color
        add(light, place, (0, 0, 1))
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.1, 0.12, 0.15, 1.0)
    scene.camera = add(bpy.data.cameras.new("camera"), (0, -6, 1.8), (0, 0, 0.85))
    scene.camera.data.lens = 50
    scene.render.resolution_x, scene.render.resolution_y = 1920, 1080
    bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()))


def main() -> int:
    """Measure, or save the scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, nargs=2, default=(160, 120))
    parser.add_argument("--frames", type=int, nargs="+", default=(8, 64))
    parser.add_argument("--truth", type=int, default=512)
    parser.add_argument("--radii", type=float, nargs="+", default=(0.02, 0.1, 0.5))
    parser.add_argument("--bodies", default="ball,back,slab,box")
    parser.add_argument("--skin", type=Path)
    options = parser.parse_args()
    if options.skin is not None:
        save_skin(options.skin)
    else:
        survey(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
