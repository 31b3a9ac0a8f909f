# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure scenes of scattered instances: a path-traced sample, a frame with a moving camera, one with a moved object.

    python tests/performance/scattered.py [--device cuda] [--size 1920 1080] [--only stones:200000,rocks:600,...]

stones: bumpy balls of 80 triangles; rocks: of 20,000; trees: 3,000 leaves each, cut out by an image. The number after
the colon is how many are scattered over a yard. Knows nothing of Blender. Prints a row a scene.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import statistics
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.generated_scenes import SceneRecipe, generate_scene, scene_flight, stone_mesh  # noqa: E402
from burnish.engine.program import ProgramBuilder  # noqa: E402
from burnish.engine.scene import ImageData, MaterialData, MeshData, SceneDelta  # noqa: E402

from tests.performance.measured_session import Measured, settings_for  # noqa: E402

SCENES = "stones:200000,rocks:600,rocks:20000,trees:2000,trees:50000"
MATERIALS = 4
LEAVES = 3000
ROCK_FACES = 20000
WARM_UP = 8
"""Frames before those that are timed"""
MOVES = 12


def leaf_image() -> np.ndarray:
    """Return a picture of 8 bits [256, 256, 4]: greens, an alpha with soft edges and holes."""
    y, x = np.mgrid[0:256, 0:256] / 256.0
    alpha = np.clip(3.0 * (0.5 + np.sin(9.0 * x + 2.0 * np.sin(7.0 * y)) * np.cos(11.0 * y)), 0.0, 1.0)
    return np.stack([60.0 + 0.0 * x, 140.0 + 60.0 * x, 40.0 + 0.0 * x, 255.0 * alpha], -1).astype(np.uint8)


def tree_mesh() -> MeshData:
    """Return a ball of leaves, a triangle each."""
    rng = np.random.default_rng(5)
    centers = rng.normal(size=(LEAVES, 1, 3))
    centers *= rng.uniform(0.5, 1.0, (LEAVES, 1, 1)) / np.linalg.norm(centers, axis=2, keepdims=True)
    points = (centers + 0.06 * rng.normal(size=(LEAVES, 3, 3))).astype(np.float32)
    normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    uvs = np.tile(np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 1.0]], np.float32), (LEAVES, 1, 1))
    return MeshData(
        name="tree", positions=points.reshape(-1, 3), triangles=np.arange(3 * LEAVES, dtype=np.int32).reshape(-1, 3),
        material_slots=np.zeros(LEAVES, np.int32), corner_normals=np.repeat(normals[:, None], 3, 1).astype(np.float32),
        uv_maps={"UVMap": uvs})


def leaf_material(name: str) -> MaterialData:
    """Return a matte material cut out by the image."""
    build = ProgramBuilder()
    look = build.image("leaf", build.uv("UVMap"))
    alpha = build.component(look, 3)
    build.transparent(1.0, build.math("SUBTRACT", 1.0, alpha))
    build.closure("DIFFUSE", alpha, color=look)
    return MaterialData(name=name, program=build.finish(), has_transparency=True)


def scattered(kind: str, count: int) -> SceneDelta:
    """Return a yard with so many things of a kind."""
    delta = generate_scene(SceneRecipe(triangles=0, instances=count, materials=MATERIALS))
    if kind != "stones":
        mesh = tree_mesh() if kind == "trees" else stone_mesh(ROCK_FACES)
        delta.meshes.update({key: mesh for key in delta.meshes if key != "yard"})
    if kind == "trees":
        delta.materials.update({f"stone {i}": leaf_material(f"leaf {i}") for i in range(MATERIALS)})
        delta.images["leaf"] = ImageData(name="leaf", pixels=leaf_image())
    return delta


def measure(name: str, device: str, size: tuple[int, int]) -> str:
    """Return a row of the table."""
    kind, count = name.split(":")
    delta, cameras = scattered(kind, int(count)), scene_flight(24, size)
    samples = 16 if device == "cuda" else 4
    tracer = Measured(settings_for("reference", device))
    tracer.load(delta)
    tracer.look(cameras[0], size)
    tracer.frames(2)
    sample = tracer.frames(samples) / samples
    mean, structure = float(tracer.picture().mean()), tracer.session.stats.structure
    tracer.close()
    frames = Measured(settings_for("realtime", device))
    frames.load(delta)
    times = []
    for camera in cameras:
        frames.look(camera, size)
        times.append(frames.frames(1))
    table, moves = delta.instances, []
    for step in range(MOVES):
        transforms = table.transforms.copy()
        transforms[len(transforms) // 2, 2, 3] += 0.05 * (step + 1)
        frames.load(SceneDelta(instances=dataclasses.replace(table, transforms=transforms)))
        frames.look(cameras[-1], size)
        moves.append(frames.frames(1))
    frames.close()
    cells = [1e3 * value for value in (
        sample, statistics.median(times[WARM_UP:]), statistics.median(moves[MOVES // 2:]))]
    row = [kind, f"{int(count):,}", *(f"{cell:.2f}" for cell in cells), f"{mean:.5f}", structure]
    return f"| {' | '.join(row)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(160, 90))
    parser.add_argument("--only", default=SCENES)
    options = parser.parse_args()
    print("| of | number | ms a sample | a frame, moving camera | a frame, moved object | mean light | structure |")
    print("|---|---|---|---|---|---|---|")
    for name in options.only.split(","):
        print(measure(name, options.device, tuple(options.size)), flush=True)


if __name__ == "__main__":
    main()
