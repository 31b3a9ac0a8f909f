# SPDX-License-Identifier: GPL-3.0-or-later
"""Hold volumes that vary in space in real-time frames against path tracing.

    python tests/performance/volume_frames.py [--size 160 120] [--frames 8 64] [--truth 512]
        [--volumes mist,smoke,cloud,...]
    python tests/performance/volume_frames.py --room FILE.blend

With a Python that has bpy. The first prints FLIP of frames alone, their light over path tracing's in the middle of the
picture, and FLIP of as many path-traced samples. The second saves a room with smoke, fire, a cloud and mist, for
`burnish bench` and its like.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.made_scene import add, finish, surface  # noqa: E402
from tests.performance.measured_session import Measured, compare, settings_for, truth_of  # noqa: E402
from tests.performance.settings_text import FILTERED, merged  # noqa: E402

LOOKS = {
    "mist": {"density": 0.8, "color": 0.9},
    "smoke": {"density": 8.0, "color": 0.6},
    "black smoke": {"density": 30.0, "color": 0.2},
    "cloud": {"density": 40.0, "color": 0.999},
    "forward cloud": {"density": 40.0, "color": 0.999, "anisotropy": 0.6},
    "thick cloud": {"density": 160.0, "color": 0.999, "anisotropy": 0.3},
    "fire": {"density": 2.0, "color": 0.3, "glow": 4.0},
}
"""Of volumes that fill a ball of noise: density [1/m] at most, and sockets of the Principled Volume"""


def link(tree: bpy.types.NodeTree, kind: str, **inputs: object) -> bpy.types.Node:
    """Add a node with values or links as inputs, by names with _ for blanks or by places with a leading _."""
    node = tree.nodes.new("ShaderNode" + kind)
    for name, value in inputs.items():
        socket = node.inputs[int(name[1:]) if name[1:].isdigit() else name.replace("_", " ")]
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, socket)
        else:
            socket.default_value = value
    return node


def maths(tree: bpy.types.NodeTree, operation: str, *values: object) -> bpy.types.NodeSocket:
    """Add a Math node."""
    node = link(tree, "Math", **{f"_{i}": value for i, value in enumerate(values)})
    node.operation = operation
    return node.outputs[0]


def volume_material(
    look: str, shape: str = "ball", scale: float = 2.0, density: float | None = None,
) -> bpy.types.Material:
    """Return a material of a volume of noise that fades out towards the sides of its box."""
    values = LOOKS[look]
    made = bpy.data.materials.new(look)
    tree = made.node_tree
    tree.nodes.clear()
    place = tree.nodes.new("ShaderNodeTexCoord").outputs["Object"]
    noise = link(tree, "TexNoise", Vector=place, Scale=scale, Detail=4.0).outputs[0]
    x, y, z = link(tree, "SeparateXYZ", Vector=place).outputs
    if shape == "ball":
        away = link(tree, "VectorMath", _0=place)
        away.operation = 'LENGTH'
        inside = maths(tree, 'SUBTRACT', 1.0, away.outputs["Value"])
    elif shape == "column":
        away = maths(tree, 'SQRT', maths(tree, 'ADD', maths(tree, 'MULTIPLY', x, x), maths(tree, 'MULTIPLY', y, y)))
        width = maths(tree, 'MULTIPLY_ADD', z, 0.35, 0.55)
        inside = maths(tree, 'MINIMUM', maths(tree, 'SUBTRACT', width, away), maths(tree, 'SUBTRACT', 1.0, z))
    else:
        inside = maths(tree, 'MULTIPLY', maths(tree, 'SUBTRACT', 1.0, z), 0.5)
    share = maths(tree, 'MULTIPLY', link(tree, "MapRange", Value=noise, From_Min=0.42, From_Max=0.62).outputs[0],
                  link(tree, "MapRange", Value=inside, From_Max=0.35).outputs[0])
    node = link(tree, "VolumePrincipled", Color=(*(values["color"],) * 3, 1.0),
                Density=maths(tree, 'MULTIPLY', share, values["density"] if density is None else density),
                Anisotropy=values.get("anisotropy", 0.0))
    if "glow" in values:
        node.inputs["Emission Color"].default_value = (1.0, 0.4, 0.1, 1.0)
        tree.links.new(maths(tree, 'MULTIPLY', share, values["glow"]), node.inputs["Emission Strength"])
    tree.links.new(node.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
    return made


def add_box(material: bpy.types.Material, place: tuple, size: tuple) -> None:
    """Add a box of half sides `size`."""
    bpy.ops.mesh.primitive_cube_add(location=place, scale=size)
    bpy.context.object.data.materials.append(material)


def add_plane(material: bpy.types.Material, place: tuple, turn: tuple = (0.0, 0.0, 0.0)) -> None:
    """Add a plane of 20 m."""
    bpy.ops.mesh.primitive_plane_add(size=20.0, location=place, rotation=turn)
    bpy.context.object.data.materials.append(material)


def follow_light() -> None:
    """Let Cycles follow light as far as Burnish does."""
    for name in ("max", "diffuse", "glossy", "transmission", "transparent_max", "volume"):
        setattr(bpy.context.scene.cycles, f"{name}_bounces", 64)


def add_sun(energy: float, place: tuple) -> None:
    """Add a sun that shines from a place to the middle."""
    sun = bpy.data.lights.new("sun", 'SUN')
    sun.energy, sun.angle = energy, 0.01
    add(sun, place, (0.0, 0.0, 0.0))


def save_ball(path: Path, look: str) -> None:
    """Save a ball of a volume over a floor, in the sun but where it shines."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    add_box(volume_material(look), (0.0, 0.0, 1.2), (1.0, 1.0, 1.0))
    add_plane(surface((0.5, 0.5, 0.5), 0.8), (0.0, 0.0, 0.0))
    glows = "glow" in LOOKS[look]
    if not glows:
        add_sun(3.0, (3.0, -2.0, 4.0))
    follow_light()
    finish(path, (0.02,) * 3 if glows else (0.3, 0.35, 0.45), (0.0, -7.0, 2.2), (0.0, 0.0, 1.1), 70.0)


def save_room(path: Path) -> None:
    """Save smoke over a fire, a cloud, mist on the floor, a mirror ball and a glass one, in lamp light."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    add_plane(surface((0.45, 0.42, 0.4), 0.3), (0.0, 0.0, 0.0))
    add_plane(surface((0.5, 0.5, 0.55), 0.8), (0.0, 4.0, 0.0), (1.5708, 0.0, 0.0))
    add_box(volume_material("smoke", "column", density=14.0), (-1.2, 0.6, 1.35), (0.8, 0.8, 1.2))
    add_box(volume_material("fire", scale=3.0), (-1.2, 0.6, 0.3), (0.35, 0.35, 0.3))
    add_box(volume_material("forward cloud", density=30.0), (1.1, 0.8, 1.9), (0.9, 0.6, 0.5))
    add_box(volume_material("mist", "layer", scale=3.0), (0.0, 0.0, 0.21), (4.0, 3.0, 0.2))
    for place, material in (((0.3, -0.9, 0.45), surface((0.9, 0.9, 0.9), 0.05, 1.0)),
                            ((1.4, -0.7, 0.35), surface((0.8, 0.3, 0.2), 0.4))):
        bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=place[2] - 0.02, location=place)
        bpy.ops.object.shade_smooth()
        bpy.context.object.data.materials.append(material)
    lamp = bpy.data.lights.new("lamp", 'AREA')
    lamp.energy, lamp.size = 300.0, 0.8
    add(lamp, (3.0, -2.5, 4.0), (0.0, 0.5, 1.0))
    spot = bpy.data.lights.new("spot", 'SPOT')
    spot.energy, spot.spot_size, spot.shadow_soft_size, spot.color = 400.0, 0.7, 0.05, (0.7, 0.8, 1.0)
    add(spot, (-3.5, -1.0, 3.5), (0.0, 0.0, 0.0))
    follow_light()
    finish(path, (0.05, 0.06, 0.08), (0.0, -6.0, 1.7), (0.0, 0.0, 1.1), 42.0)


def survey(options: argparse.Namespace) -> None:
    """Print a row for each volume and number of frames."""
    size = tuple(options.size)
    rows, columns = np.mgrid[:size[1], :size[0]]
    where = np.hypot(columns - size[0] / 2, rows - size[1] / 2) < 0.27 * size[1]
    print("| volume | frames | FLIP | path-traced | light R G B |\n|---|---|---|---|---|")
    for look in options.volumes.split(","):
        with tempfile.TemporaryDirectory() as folder:
            save_ball(Path(folder) / "ball.blend", look)
            scene = BlendScene(Path(folder) / "ball.blend", size, "cpu", matte=False)
            delta = scene.extract()
        truth = truth_of(delta, scene.camera, size, "cpu", options.truth)
        found = {}
        for integrator in ("realtime", "reference"):
            measured, done = Measured(settings_for(integrator, "cpu", **merged(FILTERED, {}))), 0
            measured.load(delta)
            measured.look(scene.camera, size)
            for frames in options.frames:
                measured.frames(frames - done)
                picture, done = measured.picture(), frames
                found[integrator, frames] = compare(truth, picture).flip, picture[where].mean(0) / truth[where].mean(0)
            measured.close()
        for frames in options.frames:
            flip, light = found["realtime", frames]
            print(f"| {look} | {frames} | {flip:.4f} | {found['reference', frames][0]:.4f} | "
                  f"{' '.join(f'{each:.3f}' for each in light)} |", flush=True)


def main() -> int:
    """Measure, or save the scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, nargs=2, default=(160, 120))
    parser.add_argument("--frames", type=int, nargs="+", default=(1, 8, 64))
    parser.add_argument("--truth", type=int, default=512)
    parser.add_argument("--volumes", default=",".join(LOOKS))
    parser.add_argument("--room", type=Path)
    options = parser.parse_args()
    if options.room is not None:
        save_room(options.room)
    else:
        survey(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
