# SPDX-License-Identifier: GPL-3.0-or-later
"""Time rays through wp.Mesh (builders, leaf sizes) and the 8-wide BVH, and check that both agree. Run by hand.

    python tests/performance/traversal.py SCENE... [--device cuda:0] [--size 1920 1080] [--rounds 7] [--save FOLDER]

A scene is a .blend (needs bpy) or the .npz that --save wrote. Rays are those of a frame (ray_sets.py). A row holds
milliseconds a launch (the median), and, against wp.Mesh, how many rays in a million end at another distance (by more
than 1e-4 of it). Sets called `sorted` show what a perfect order of rays would bring; sorting itself is not timed.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

import numpy as np  # noqa: E402
import warp as wp  # noqa: E402
from burnish.engine.device import start_warp  # noqa: E402
from burnish.engine.wide_bvh import build_wide  # noqa: E402
from burnish.kernels.wide_bvh import any_wide, closest_wide  # noqa: E402

from tests.performance.ray_sets import Rays, Triangles, load_triangles, make_rays  # noqa: E402

BLOCK = 64
"""As the renderer launches its tracing kernels"""
OPTIONS = {"enable_backward": False, "default_grid_stride": False}
MESHES = [("cubql", 1), ("cubql", 2), ("cubql", 4), ("sah", 1), ("sah", 2), ("sah", 4), ("median", 1), ("lbvh", 1)]


def mesh_kernels() -> tuple[wp.Kernel, wp.Kernel]:
    """Return kernels that follow rays through a wp.Mesh, with the register limits of the renderer's."""
    @wp.kernel(module="unique", module_options=OPTIONS, cuda_max_registers=64)
    def closest(
        # In:
        mesh: wp.uint64, origin: wp.array[wp.vec3], direction: wp.array[wp.vec3], t_max: wp.array[float],
        # Out:
        t_out: wp.array[float], face_out: wp.array[int], weights_out: wp.array[wp.vec2],
    ):
        i = wp.tid()
        query = wp.mesh_query_ray(mesh, origin[i], direction[i], t_max[i])
        t_out[i] = wp.where(query.result, query.t, t_max[i])
        face_out[i] = wp.where(query.result, query.face, -1)
        weights_out[i] = wp.vec2(query.u, query.v)

    @wp.kernel(module="unique", module_options=OPTIONS, cuda_max_registers=56)
    def blocked(
        # In:
        mesh: wp.uint64, origin: wp.array[wp.vec3], direction: wp.array[wp.vec3], t_max: wp.array[float],
        # Out:
        t_out: wp.array[float], face_out: wp.array[int], weights_out: wp.array[wp.vec2],
    ):
        i = wp.tid()
        face_out[i] = wp.where(wp.mesh_query_ray_anyhit(mesh, origin[i], direction[i], t_max[i]), 0, -1)
    return closest, blocked


def wide_kernels() -> tuple[wp.Kernel, wp.Kernel]:
    """Return kernels that follow rays through an 8-wide BVH."""
    @wp.kernel(module="unique", module_options=OPTIONS, cuda_max_registers=56)
    def closest(
        # In:
        nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32],
        origin: wp.array[wp.vec3], direction: wp.array[wp.vec3], t_max: wp.array[float],
        # Out:
        t_out: wp.array[float], face_out: wp.array[int], weights_out: wp.array[wp.vec2],
    ):
        i = wp.tid()
        hit = closest_wide(nodes, triangles, origin[i], direction[i], t_max[i])
        t_out[i] = hit[0]
        face_out[i] = wp.cast(hit[3], int)
        weights_out[i] = wp.vec2(hit[1], hit[2])

    @wp.kernel(module="unique", module_options=OPTIONS, cuda_max_registers=48)
    def blocked(
        # In:
        nodes: wp.array[wp.uint32], triangles: wp.array[wp.uint32],
        origin: wp.array[wp.vec3], direction: wp.array[wp.vec3], t_max: wp.array[float],
        # Out:
        t_out: wp.array[float], face_out: wp.array[int], weights_out: wp.array[wp.vec2],
    ):
        i = wp.tid()
        face_out[i] = wp.where(any_wide(nodes, triangles, origin[i], direction[i], t_max[i]), 0, -1)
    return closest, blocked


class Tracer:
    """Follows sets of rays on one device and times it."""

    def __init__(self, device: str, rounds: int):
        self.device, self.rounds = device, rounds
        self._rays: dict[str, list[wp.array]] = {}

    def put(self, rays: Rays) -> list[wp.array]:
        """Return a set's rays on the device."""
        if rays.name not in self._rays:
            self._rays[rays.name] = [
                wp.array(rays.origin, dtype=wp.vec3, device=self.device),
                wp.array(rays.direction, dtype=wp.vec3, device=self.device),
                wp.array(rays.t_max, dtype=float, device=self.device)]
        return self._rays[rays.name]

    def run(self, kernels: tuple[wp.Kernel, wp.Kernel], structure: list[Any], rays: Rays, rounds: int | None = None,
            ) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the median milliseconds of a launch, t and faces (0 for blocked, -1 for free rays)."""
        inputs, count = [*structure, *self.put(rays)], len(rays.origin)
        outputs = [wp.zeros(count, dtype=kind, device=self.device) for kind in (float, int, wp.vec2)]
        block = BLOCK if self.device != "cpu" else 1

        def launch() -> None:
            wp.launch(kernels[rays.any_hit], count, inputs, outputs, device=self.device, block_dim=block)

        times = [milliseconds(launch, self.device) for _ in range(1 + (rounds or self.rounds))]
        return float(np.median(times[1:] or times)), outputs[0].numpy(), outputs[1].numpy()


def milliseconds(launch: Callable[[], None], device: str) -> float:
    """Return how long a launch takes."""
    if device == "cpu":
        start = time.perf_counter()
        launch()
        return (time.perf_counter() - start) * 1e3
    events = [wp.Event(device, enable_timing=True) for _ in range(2)]
    stream = wp.get_stream(device)
    stream.record_event(events[0])
    launch()
    stream.record_event(events[1])
    return wp.get_event_elapsed_time(*events)


def differing(rays: Rays, expected: tuple[np.ndarray, np.ndarray], found: tuple[np.ndarray, np.ndarray]) -> float:
    """Return how many rays in a million end elsewhere."""
    (t, face), (other_t, other_face) = expected, found
    wrong = (face < 0) != (other_face < 0)
    if not rays.any_hit:
        wrong |= (face >= 0) & (np.abs(t - other_t) > 1e-4 * np.abs(t))
    return float(wrong.mean() * 1e6)


def measure(scene: Triangles, options: argparse.Namespace, meshes: tuple, wides: tuple) -> None:
    """Print the table of one scene."""
    device, tracer = options.device, Tracer(options.device, options.rounds)
    points = wp.array(scene.points, dtype=wp.vec3, device=device)
    indices = wp.array(scene.indices.ravel(), dtype=int, device=device)
    usual = wp.Mesh(points, indices, bvh_constructor="cubql" if device != "cpu" else "sah", bvh_leaf_size=1)

    sets = make_rays(scene, tuple(options.size), lambda rays: tracer.run(meshes, [usual.id], rays, 1)[1:])
    tracer = Tracer(device, options.rounds)
    sets += [rays.sorted() for rays in sets if rays.name in ("diffuse", "reflection")]
    expected = {rays.name: tracer.run(meshes, [usual.id], rays)[1:] for rays in sets}
    print(f"\n{scene.name}: {len(scene.indices):,} triangles; rays: "
          + ", ".join(f"{rays.name} {len(rays.origin):,}" for rays in sets) + "\n")
    print("| structure | build [ms] | MB | " + " | ".join(rays.name for rays in sets) + " | best Mrays/s | other |")
    print("|---" * (5 + len(sets)) + "|", flush=True)

    def row(name: str, build: float, size: str, kernels: tuple, structure: list) -> None:
        cells, wrong, best = [], 0.0, 0.0
        for rays in sets:
            ms, t, face = tracer.run(kernels, structure, rays)
            best = max(best, len(rays.origin) / ms * 1e-3)
            wrong = max(wrong, differing(rays, expected[rays.name], (t, face)))
            cells.append(f"{ms:.3f}")
        print(f"| {name} | {build:.0f} | {size} | " + " | ".join(cells) + f" | {best:.0f} | {wrong:.1f} |", flush=True)

    for constructor, leaf in MESHES:
        if available(constructor, device) and not options.wide_only:
            start = time.perf_counter()
            mesh = wp.Mesh(points, indices, bvh_constructor=constructor, bvh_leaf_size=leaf)
            wp.synchronize_device(device)
            row(f"wp.Mesh {constructor}, leaf {leaf}", (time.perf_counter() - start) * 1e3, "", meshes, [mesh.id])
    start = time.perf_counter()
    wide = build_wide(points, indices)
    wp.synchronize_device(device)
    build = (time.perf_counter() - start) * 1e3
    row("wide", build, f"{4e-6 * len(wide.nodes):.1f} + {4e-6 * len(wide.triangles):.1f}", wides,
        [wide.nodes, wide.triangles])


def available(constructor: str, device: str) -> bool:
    """Return whether Warp builds so on the device."""
    if constructor == "cubql":
        return device != "cpu" and wp.is_cubql_available()
    return constructor != "lbvh" or device != "cpu"


def main() -> None:
    """Print a table for each scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device")
    parser.add_argument("--size", type=int, nargs=2)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--save", type=Path)
    parser.add_argument("--wide-only", action="store_true")
    options = parser.parse_args()
    start_warp()
    options.device = options.device or ("cuda:0" if wp.is_cuda_available() else "cpu")
    options.size = options.size or ([1920, 1080] if options.device != "cpu" else [320, 180])
    with wp.ScopedDevice(options.device):
        print(f"{wp.get_device(options.device).name}, Warp {wp.config.version}, {options.size[0]}x{options.size[1]}")
        meshes = mesh_kernels()
        wides = wide_kernels()
        for path in options.scenes:
            scene = load_triangles(path, tuple(options.size))
            if options.save:
                scene.save(options.save)
            measure(scene, options, meshes, wides)


if __name__ == "__main__":
    main()
