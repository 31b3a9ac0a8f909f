# SPDX-License-Identifier: GPL-3.0-or-later
"""Hold every socket of Blender's surface shaders against Cycles: a table of light ratios of both integrators.

    python tests/performance/socket_survey.py [--only base,coat] [--label Roughness] [--samples 256] [--cycles 512]
        [--frames 24] [--columns 6] [--rows 5] [--cell 40] [--output out/socket_survey]

Run by hand, with a Python that has bpy. Each material is on a ball and on a plane seen at 12 degrees, over a checkered
floor, under a sky of several colours and an area lamp; sheets of many such balls are rendered by Cycles, by path
tracing and by real-time frames, whose path tracing at rest is off. A row of the table is one material: the light of the
ball in each channel, and of the plane (mean of channels), over Cycles'. Channels in which Cycles has less than a
hundredth of white show a dash.
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

import bpy  # noqa: E402
from burnish.addon import final, register  # noqa: E402
from burnish.engine.read import read_exr  # noqa: E402
from mathutils import Vector  # noqa: E402

from tests.performance.sheets import save_sheet, tone  # noqa: E402
from tests.performance.socket_cases import SocketCase, all_cases  # noqa: E402

WIDTH, DEPTH = 2.4, 3.6
"""Distances of balls from each other"""
ELEVATION = math.radians(35.0)
GRAZING = math.radians(23.0)
"""The planes' tilt: they are seen at ELEVATION minus this"""
MARGIN = 1.2
"""Of the picture above and below the balls together"""
DARK = 0.01
"""Channels below this in Cycles are not compared"""


def build_vector(tree: Any, name: str) -> Any:
    """Return the output of nodes that compute a vector named in a case."""
    if name == "bumped":
        noise, bump = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeBump")
        noise.inputs["Scale"].default_value, bump.inputs["Distance"].default_value = 6.0, 0.1
        tree.links.new(noise.outputs["Fac"], bump.inputs["Height"])
        return bump.outputs[0]
    if name.endswith("tangent"):
        node = tree.nodes.new("ShaderNodeTangent")
        node.direction_type, node.axis = ('UV_MAP', 'Z') if name.startswith("uv") else ('RADIAL', 'X')
        return node.outputs[0]
    normal, add = tree.nodes.new("ShaderNodeNewGeometry"), tree.nodes.new("ShaderNodeVectorMath")
    unit = tree.nodes.new("ShaderNodeVectorMath")
    add.inputs[1].default_value, unit.operation = (0.4, 0.0, 0.2), 'NORMALIZE'
    tree.links.new(normal.outputs["Normal"], add.inputs[0])
    tree.links.new(add.outputs[0], unit.inputs[0])
    return unit.outputs[0]


def build_material(case: SocketCase) -> Any:
    """Return a case's material."""
    material = bpy.data.materials.new(case.label)
    tree = material.node_tree
    tree.nodes.clear()
    node = tree.nodes.new("ShaderNode" + case.node)
    for name, value in case.options.items():
        setattr(node, name, value)
    for identifier, value in case.inputs.items():
        socket = next(s for s in node.inputs if s.identifier == identifier)
        if isinstance(value, str):
            tree.links.new(build_vector(tree, value), socket)
        elif isinstance(value, tuple):
            socket.default_value = (*value, 1.0)[:len(socket.default_value)]
        else:
            socket.default_value = value
    shader = node.outputs[0]
    if case.mix:
        joint = tree.nodes.new("ShaderNodeAddShader" if case.mix.startswith("+") else "ShaderNodeMixShader")
        other = tree.nodes.new("ShaderNode" + case.mix.removeprefix("+"))
        tree.links.new(shader, joint.inputs[-2])
        tree.links.new(other.outputs[0], joint.inputs[-1])
        shader = joint.outputs[0]
    tree.links.new(shader, tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def build_surroundings(columns: int, rows: int, scene: Any) -> None:
    """Build the floor, the sky, the lamp and the camera."""
    width, depth = columns * WIDTH, rows * DEPTH
    floor = bpy.data.materials.new("floor")
    tree = floor.node_tree
    checker, place = tree.nodes.new("ShaderNodeTexChecker"), tree.nodes.new("ShaderNodeTexCoord")
    checker.inputs["Scale"].default_value = 1.0 / 0.6
    checker.inputs["Color1"].default_value, checker.inputs["Color2"].default_value = (.6, .6, .5, 1), (.1, .15, .2, 1)
    tree.links.new(place.outputs["Object"], checker.inputs["Vector"])
    tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.9
    tree.links.new(checker.outputs[0], tree.nodes["Principled BSDF"].inputs["Base Color"])
    bpy.ops.mesh.primitive_plane_add(size=200.0, location=(0.0, 0.0, -0.013))
    bpy.context.object.data.materials.append(floor)

    scene.world = bpy.data.worlds.new("world")
    tree = scene.world.node_tree
    ramp = tree.nodes.new("ShaderNodeVectorMath")
    ramp.operation = 'MULTIPLY_ADD'
    ramp.inputs[1].default_value, ramp.inputs[2].default_value = (.4, .4, .4), (.5, .5, .5)
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], ramp.inputs[0])
    tree.links.new(ramp.outputs[0], tree.nodes["Background"].inputs["Color"])

    lamp = bpy.data.lights.new("lamp", 'AREA')
    lamp.energy, lamp.size = 60.0 * width * depth, 5.0
    holder = bpy.data.objects.new("lamp", lamp)
    holder.location = (0.7 * width, -0.6 * depth, 12.0)
    holder.rotation_euler = (-Vector(holder.location)).to_track_quat('-Z', 'Y').to_euler()
    scene.collection.objects.link(holder)

    camera = bpy.data.cameras.new("camera")
    camera.type, camera.clip_end = 'ORTHO', 1000.0
    height = depth * math.sin(ELEVATION) + MARGIN
    camera.ortho_scale = max(width, height)
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.camera.location = (0.0, -60.0 * math.cos(ELEVATION), 60.0 * math.sin(ELEVATION) + 0.5 * MARGIN)
    scene.camera.rotation_euler = (math.pi / 2 - ELEVATION, 0.0, 0.0)
    scene.collection.objects.link(scene.camera)


def build_sheet(cases: list[SocketCase], options: argparse.Namespace) -> Any:
    """Return a scene of balls and planes; those of case i have the pass indices 2 i + 1 and 2 i + 2."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    columns, rows = options.columns, -(-len(cases) // options.columns)
    build_surroundings(columns, rows, scene)
    for i, case in enumerate(cases):
        x, y = (i % columns + 0.5 - columns / 2) * WIDTH, (rows / 2 - i // columns - 0.5) * DEPTH
        material = build_material(case)
        bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.8, location=(x, y + 0.6, 0.85))
        bpy.ops.object.shade_smooth()
        ball = bpy.context.object
        bpy.ops.mesh.primitive_plane_add(size=1.6, location=(x, y - 1.0, 0.5), rotation=(-GRAZING, 0.0, 0.0))
        for index, shape in ((1, ball), (2, bpy.context.object)):
            shape.pass_index = 2 * i + index
            shape.data.materials.append(material)
    render = scene.render
    render.resolution_x = columns * options.cell
    render.resolution_y = round(options.cell * (rows * DEPTH * math.sin(ELEVATION) + MARGIN) / WIDTH)
    render.resolution_percentage = 100
    render.image_settings.file_format, render.image_settings.color_depth = 'OPEN_EXR', '32'
    scene.view_settings.view_transform = 'Standard'
    bpy.context.view_layer.use_pass_object_index = True
    return scene


def render_cycles(scene: Any, samples: int, path: Path) -> np.ndarray:
    """Return Cycles' picture, without clamps and with as many bounces as light has."""
    scene.render.engine, scene.render.filepath = 'CYCLES', str(path)
    settings = scene.cycles
    settings.samples, settings.use_adaptive_sampling, settings.use_denoising = samples, False, False
    settings.sample_clamp_indirect, settings.blur_glossy, settings.max_bounces = 0.0, 0.0, 32
    settings.diffuse_bounces = settings.glossy_bounces = settings.transmission_bounces = 32
    settings.transparent_max_bounces = 32
    bpy.ops.render.render(write_still=True)
    return read_exr(path)[..., :3]


def render_burnish(scene: Any, integrator: str, samples: int) -> dict[str, Any]:
    """Return a picture's passes and its report."""
    found: dict[str, Any] = {}

    def keep(layer: str, view: str, pixels: Any, info: Any) -> None:
        found.update({name: np.array(values) for name, values in pixels.items()}, report=info.report)

    scene.render.engine = 'BURNISH'
    scene.burnish.sampling.integrator, scene.burnish.sampling.samples = integrator, samples
    scene.burnish.denoiser.path_traced_rest = False
    final.on_finished.append(keep)
    bpy.ops.render.render()
    final.on_finished.remove(keep)
    return found


def object_indices(scene: Any) -> np.ndarray:
    """Return the pass index of what each pixel shows, were everything opaque."""
    plain = bpy.data.materials.new("plain")
    shapes = {shape: shape.data.materials[0] for shape in scene.objects if shape.pass_index > 0}
    for shape in shapes:
        shape.data.materials[0] = plain
    passes = render_burnish(scene, 'REFERENCE', 1)
    for shape, material in shapes.items():
        shape.data.materials[0] = material
    return np.round(next(values for name, values in passes.items() if "Index" in name)[..., 0])


def ratios(picture: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> list[float]:
    """Return the light of a picture over that of the truth in each channel, NaN where that is dark."""
    mine, theirs = picture[mask].mean(0, dtype=np.float64), truth[mask].mean(0, dtype=np.float64)
    return [float(a / b) if b > DARK else math.nan for a, b in zip(mine, theirs, strict=True)]


def survey(cases: list[SocketCase], options: argparse.Namespace, number: int) -> list[str]:
    """Render one sheet and return the rows of its table."""
    scene = build_sheet(cases, options)
    truth = render_cycles(scene, options.cycles, options.output / f"cycles_{number}.exr")
    traced = render_burnish(scene, 'REFERENCE', options.samples)
    frames = render_burnish(scene, 'REALTIME', options.frames)
    for (kind, owner, message), count in frames["report"].counts.items():
        print(f"    {kind.name}: {owner} {message} ({count})")
    index = object_indices(scene)
    pictures = [traced["Combined"][..., :3], frames["Combined"][..., :3]]
    labels = ("Cycles", "path-traced", "frames")
    save_sheet(options.output / f"sheet_{number}.png",
               [[(tone(p), label) for p, label in zip((truth, *pictures), labels, strict=True)]])
    rows = []
    for i, case in enumerate(cases):
        ball, plane = (index == 2 * i + k for k in (1, 2))
        cells = []
        for picture in pictures:
            parts = ratios(picture, truth, ball)
            flat = float(picture[plane].mean() / max(truth[plane].mean(), 1e-6))
            cells.append(" ".join("  -  " if math.isnan(r) else f"{r:.3f}" for r in (*parts, flat)))
        rows.append(f"| {case.node} | {case.label} | {' | '.join(cells)} |")
    return rows


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="groups with commas between them")
    parser.add_argument("--label", default="", help="a part of the labels or nodes that are wanted")
    for name, value in (("samples", 256), ("cycles", 512), ("frames", 24), ("columns", 6), ("rows", 5), ("cell", 40)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--output", type=Path, default=Path("out/socket_survey"))
    options = parser.parse_args()
    options.output = options.output.resolve()
    options.output.mkdir(parents=True, exist_ok=True)
    groups = [name for name in options.only.split(",") if name]
    cases = [case for case in all_cases() if (not groups or case.group in groups)
             and options.label in f"{case.node} {case.label}"]
    register()
    print("| node | socket and value | path-traced: ball R G B, plane | frames: ball R G B, plane |\n|---|---|---|---|")
    page = options.columns * options.rows
    for number, first in enumerate(range(0, len(cases), page)):
        print("\n".join(survey(cases[first:first + page], options, number)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
