# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure anti-aliasing of moving frames by itself: edges and textures without any light. Run by hand.

    python tests/performance/edges_in_motion.py SCENE.blend... [--device cuda] [--size 320 180] [--slower 1] [--large]
        [--samples 256] [--at 20 30]

Surfaces emit their base colour (8 where they have none), nothing else gives light: what a flight's frames differ by
from Reference is where edges and textures lie, and how wide they are. --slower divides the way between frames around
frame 20. --large draws frames of twice the size on any device, as small pictures are drawn on a GPU.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.image_error import compare  # noqa: E402
from burnish.engine.measure_moving import fly_over  # noqa: E402
from burnish.engine.scene import CameraData  # noqa: E402

from tests.larger_frames import draw_larger  # noqa: E402
from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.matte_copy import take_over  # noqa: E402
from tests.performance.measured_session import Measured, attempt, positions_of, settings_for  # noqa: E402

COLORED = {'BSDF_PRINCIPLED': "Base Color", 'BSDF_DIFFUSE': "Color", 'BSDF_GLOSSY': "Color", 'BSDF_GLASS': "Color"}
"""The socket of each node that has a surface's colour"""

BRIGHT = 8.0
"""What surfaces of other nodes emit, as windows and lamps do"""

FRAMES = 60
"""Of a flight"""

MIDDLE = 20
"""Frame around which --slower slows the flight down"""


def make_unlit() -> None:
    """Make all materials emit their base colour, and turn lamps off."""
    for material in bpy.data.materials:
        tree = material.node_tree
        output = tree and next((n for n in tree.nodes if n.type == 'OUTPUT_MATERIAL' and n.is_active_output), None)
        if not output:
            continue
        emission = tree.nodes.new('ShaderNodeEmission')
        source = next((node for node in tree.nodes if node.type in COLORED), None)
        color = source and source.inputs[COLORED[source.type]]
        emission.inputs["Strength"].default_value = 1.0 if color else BRIGHT
        if color:
            take_over(tree, color, emission.inputs["Color"])
        tree.links.new(emission.outputs[0], output.inputs["Surface"])
    for item in bpy.data.objects:
        if item.type == 'LIGHT':
            item.hide_render = item.hide_viewport = True
    bpy.context.view_layer.update()


def slowed(cameras: list[CameraData], factor: float) -> list[CameraData]:
    """Return a flight through the MIDDLE one's place that goes so many times as slowly, in a straight line."""
    here = np.array(cameras[MIDDLE].transform)
    step = (here - np.array(cameras[MIDDLE - 1].transform)) / factor
    return [replace(cameras[MIDDLE], transform=tuple(here + step * (i - MIDDLE))) for i in range(len(cameras))]


def measure(file: Path, options: argparse.Namespace) -> None:
    """Measure one scene."""
    size = tuple(options.size)
    scene = BlendScene(file, size, options.device, matte=False)
    make_unlit()
    first = scene.extract()
    reference = Measured(settings_for("reference", options.device, seed=5))
    reference.load(first)
    cameras = fly_over(scene.camera, positions_of(reference, scene.camera, size), FRAMES)
    if options.slower != 1.0:
        cameras = slowed(cameras, options.slower)
    moving = Measured(settings_for("realtime", options.device, denoiser={"path_traced_rest": False}))
    moving.load(first)
    for frame, camera in enumerate(cameras[:max(options.at) + 1]):
        moving.look(camera, size)
        moving.frames(1)
        if frame in options.at:
            reference.look(camera, size)
            reference.frames(options.samples)
            error = compare(reference.picture(), moving.picture())
            print(f"EDGES {file.stem} frame {frame}: FLIP {error.flip:.4f}, relMSE {error.relative_mse:.4f}, "
                  f"light {error.luminance:.3f}", flush=True)
    moving.close()
    reference.close()


def main() -> int:
    """Measure all scenes; one that fails is told and skipped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(320, 180))
    parser.add_argument("--at", type=int, nargs="+", default=(20, 30))
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--slower", type=float, default=1.0)
    parser.add_argument("--large", action="store_true")
    options = parser.parse_args()
    if options.large:
        draw_larger()
    return int(sum(attempt(file.stem, measure, file, options) for file in options.scenes) > 0)


if __name__ == "__main__":
    raise SystemExit(main())
