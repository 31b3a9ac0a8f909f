# SPDX-License-Identifier: GPL-3.0-or-later
"""Hold hair in real-time frames against path tracing: balls of fur in several colours and lights.

    python tests/performance/hair_frames.py [--size 160 120] [--frames 1 8 64] [--truth 256]
        [--balls white:white,sky:brown,...]
    python tests/performance/hair_frames.py --wig FILE.blend

With a Python that has bpy. The first prints FLIP and the light of the fur over path tracing's, in each channel, with
the setting `reflections.hair` off and on, of frames alone. The second saves a scene of a wig and two balls of fur
before two lamps, for `burnish bench` and its like.
"""

from __future__ import annotations

import argparse
import importlib
import math
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
from tests.performance.settings_text import FILTERED, merged, parse_settings  # noqa: E402

LOOKS = {
    "clear": {"parametrization": 'ABSORPTION', "Absorption Coefficient": (0.0, 0.0, 0.0)},
    "white": {"parametrization": 'COLOR', "Color": (0.85, 0.82, 0.75, 1.0), "Roughness": 0.4, "Radial Roughness": 0.6},
    "blond": {"Melanin": 0.25},
    "brown": {"Melanin": 0.6, "Roughness": 0.3, "Radial Roughness": 0.4},
    "black": {"Melanin": 0.95, "Melanin Redness": 0.3, "Roughness": 0.25, "Radial Roughness": 0.3},
}
"""Sockets of the Principled Hair BSDF"""
WORLDS = {"white": (1.0, 1.0, 1.0), "sky": (0.5, 0.6, 0.8), "sun": (0.0, 0.0, 0.0), "back": (0.0, 0.0, 0.0)}
BALLS = "white:clear,sky:brown,sun:white,sun:black,back:blond"


def hair_material(look: str) -> bpy.types.Material:
    """Return a material of hair."""
    made = bpy.data.materials.new(look)
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    node = tree.nodes.new("ShaderNodeBsdfHairPrincipled")
    node.parametrization = LOOKS[look].get("parametrization", 'MELANIN')
    for name, value in LOOKS[look].items():
        if name != "parametrization":
            node.inputs[name].default_value = value
    tree.links.new(node.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
    return made


def add_ball(center: tuple, radius: float, color: tuple) -> None:
    """Add a ball."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=radius, location=center)
    bpy.ops.object.shade_smooth()
    bpy.context.object.data.materials.append(surface(color))


def add_hair(
    center: tuple, radius: float, directions: np.ndarray, ways: np.ndarray, length: float, width: float, droop: tuple,
    look: str, points: int = 5, seed: int = 3,
) -> None:
    """Add strands that start on a ball and stay outside of it.

    Args:
        center: Of the ball.
        radius: Of the ball.
        directions: [C, 3], where the strands start.
        ways: [C, 3], in which direction.
        length: Of the strands, in the mean.
        width: Radius of a strand at its root.
        droop: What is added to a strand at its tip, by its length.
        look: One of LOOKS.
        points: Of a strand.
        seed: Of chance.
    """
    random, count = np.random.default_rng(seed), len(directions)
    t = np.linspace(0.0, 1.0, points)[None, :, None]
    lengths = length * random.uniform(0.85, 1.1, (count, 1, 1))
    places = directions[:, None] * radius + ways[:, None] * lengths * t + np.array(droop) * lengths * t ** 2
    places += random.normal(0.0, 0.09, (count, 1, 3)) * t ** 2 * lengths
    distance = np.linalg.norm(places, axis=2, keepdims=True)
    places *= np.maximum(distance, 1.02 * radius) / distance
    hair = bpy.data.hair_curves.new("hair")
    hair.add_curves([points] * count)
    hair.attributes["position"].data.foreach_set("vector", (places + center).astype(np.float32).ravel())
    widths = hair.attributes.get("radius") or hair.attributes.new("radius", 'FLOAT', 'POINT')
    taper = np.broadcast_to(width * (1.0 - 0.7 * t[..., 0]), (count, points))
    widths.data.foreach_set("value", taper.astype(np.float32).ravel())
    hair.materials.append(hair_material(look))
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("hair", hair))


def unit_vectors(count: int, seed: int) -> np.ndarray:
    """Return directions, evenly spread by chance: [count, 3]."""
    found = np.random.default_rng(seed).normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def save_ball(path: Path, light: str, look: str) -> None:
    """Save a ball of fur without anything below it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    center, roots = (0.0, 0.0, 0.8), unit_vectors(7000, 3)
    add_hair(center, 0.5, roots, roots, 0.25, 0.0045, (0.1, 0.0, -0.5), look)
    if light in ("sun", "back"):
        sun = bpy.data.lights.new("sun", 'SUN')
        sun.energy, sun.angle = 3.0, 0.01
        add(sun, (2.0, -3.0, 3.0) if light == "sun" else (1.0, 4.0, 2.0), (0.0, 0.0, 0.0))
    finish(path, WORLDS[light], (0.0, -5.0, 0.8), (0.0, 0.0, 0.75), 60.0)


def save_wig(path: Path) -> None:
    """Save a wig of brown hair and balls of white and black fur before two lamps."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    head, fur, black = (-0.9, 0.0, 1.15), (0.75, -0.3, 0.55), (1.75, 0.5, 0.45)
    add_ball(head, 0.6, (0.6, 0.42, 0.35))
    roots = unit_vectors(14000, 1)
    roots = roots[(roots[:, 2] > 0.1) & ((roots[:, 1] > -0.55) | (roots[:, 2] > 0.75))][:6000]
    add_hair(head, 0.6, roots, 0.5 * roots + (0.0, 0.0, 0.1), 1.1, 0.004, (0.0, 0.0, -1.1), "brown", 7)
    add_ball(fur, 0.4, (0.3, 0.25, 0.2))
    roots = unit_vectors(9000, 2)
    add_hair(fur, 0.4, roots, roots, 0.18, 0.0035, (0.1, 0.0, -0.5), "white", 4)
    add_ball(black, 0.35, (0.1, 0.1, 0.1))
    roots = unit_vectors(7000, 4)
    add_hair(black, 0.35, roots, roots, 0.15, 0.0035, (0.1, 0.0, -0.4), "black", 4)
    for place, turn in (((0.0, 0.0, 0.0), 0.0), ((0.0, 4.0, 0.0), math.pi / 2.0)):
        bpy.ops.mesh.primitive_plane_add(size=20.0, location=place, rotation=(turn, 0.0, 0.0))
        bpy.context.object.data.materials.append(surface((0.4, 0.4, 0.42), 0.7))
    for place, power, size, color in (((3.0, -3.0, 4.0), 200.0, 1.0, (1.0, 1.0, 1.0)),
                                      ((-2.5, 2.5, 3.0), 250.0, 0.6, (1.0, 0.85, 0.7))):
        lamp = bpy.data.lights.new("lamp", 'AREA')
        lamp.energy, lamp.size, lamp.color = power, size, color
        add(lamp, place, (0.0, 0.0, 1.0))
    finish(path, (0.25, 0.3, 0.38), (0.0, -6.0, 1.8), (0.2, 0.0, 0.75), 50.0)


def survey(options: argparse.Namespace) -> None:
    """Print a row for each ball, setting and number of frames."""
    size = tuple(options.size)
    rows, columns = np.mgrid[:size[1], :size[0]]
    where = np.hypot(columns - size[0] / 2, rows - size[1] / 2) < 0.32 * size[1]
    print("| light | hair | setting | frames | FLIP | light R G B |\n|---|---|---|---|---|---|")
    for ball in options.balls.split(","):
        light, look = ball.split(":")
        with tempfile.TemporaryDirectory() as folder:
            save_ball(Path(folder) / "ball.blend", light, look)
            scene = BlendScene(Path(folder) / "ball.blend", size, "cpu", matte=False)
            delta = scene.extract()
        truth = truth_of(delta, scene.camera, size, "cpu", options.truth)
        for on in (False, True):
            measured, done = Measured(settings_for(
                "realtime", "cpu", **merged(FILTERED, parse_settings([f"reflections.hair={on}"])))), 0
            measured.load(delta)
            measured.look(scene.camera, size)
            for frames in options.frames:
                measured.frames(frames - done)
                picture, done = measured.picture(), frames
                share = picture[where].mean(0) / truth[where].mean(0)
                print(f"| {light} | {look} | {'on' if on else 'off'} | {frames} | {compare(truth, picture).flip:.4f} | "
                      f"{' '.join(f'{each:.3f}' for each in share)} |", flush=True)
            measured.close()


def main() -> int:
    """Measure, or save the scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, nargs=2, default=(160, 120))
    parser.add_argument("--frames", type=int, nargs="+", default=(1, 8, 64))
    parser.add_argument("--truth", type=int, default=256)
    parser.add_argument("--balls", default=BALLS)
    parser.add_argument("--wig", type=Path)
    options = parser.parse_args()
    if options.wig is not None:
        save_wig(options.wig)
    else:
        survey(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
