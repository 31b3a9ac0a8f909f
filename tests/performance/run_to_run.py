# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure how much frames differ from run to run, and what the option against it costs. Run by hand.

    python tests/performance/run_to_run.py SCENE.blend ... [--device cuda] [--size 640 360] [--frames 120]
        [--repeat 2] [--set GROUP.FIELD=VALUE] [--output out/run_to_run]

The same flight of the camera is rendered several times with performance.deterministic off and on, in turns. Without
the option runs part once threads compete: for buckets that are full, or for slots that old cells leave (after
cache.lifetime frames). Needs Blender's module.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import itertools
import sys
from pathlib import Path

import numpy as np
import warp as wp

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.measure_moving import fly_over  # noqa: E402

from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.measured_session import Measured, settings_for  # noqa: E402
from tests.performance.settings_text import parse_settings  # noqa: E402
from tests.performance.sheets import Table  # noqa: E402

COLUMNS = ("scene", "option", "frame", "largest", "mean", "mean / mean light", "ms a frame", "on / off")


def fly(measured: Measured, cameras: list, size: tuple[int, int], kept: list[int]) -> tuple[list[np.ndarray], float]:
    """Render a flight from its start; returns the pictures of the frames in `kept` (from 1), and seconds a frame."""
    measured.session.reset()
    pictures, seconds = [], 0.0
    for first, last in itertools.pairwise([0, *kept]):
        measured.wait()
        for camera in cameras[first:last]:
            measured.look(camera, size)
            seconds += measured.frames(1)
        pictures.append(measured.picture())
    return pictures, seconds / kept[-1]


def measure(path: Path, options: argparse.Namespace, table: Table) -> bool:
    """Fill the table's rows for a scene; returns whether all runs with the option on were the same."""
    size = tuple(options.size)
    scene = BlendScene(path, size, options.device, matte=False)
    delta = scene.extract()
    base = settings_for("realtime", options.device, **parse_settings(options.set))
    kept = sorted({max(1, options.frames // 3), max(1, 2 * options.frames // 3), options.frames})
    sessions = {}
    for on in (False, True):
        settings = dataclasses.replace(base, performance=dataclasses.replace(base.performance, deterministic=on))
        sessions[on] = Measured(settings)
        sessions[on].load(delta)
        sessions[on].look(scene.camera, size, passes=("Combined", "Position"))
        sessions[on].frames(1)
    cameras = fly_over(scene.camera, sessions[False].session.read("Position"), options.frames)
    pictures, seconds = {False: [], True: []}, {False: [], True: []}
    for run in range(-1, options.repeat):
        for on, measured in sessions.items():
            made, time = fly(measured, cameras, size, kept if run >= 0 else kept[:1])
            if run >= 0:
                pictures[on].append(made)
                seconds[on].append(time)
    for measured in sessions.values():
        measured.close()
    means = {on: float(np.median(seconds[on])) for on in seconds}
    for on in (False, True):
        for index, frame in enumerate(kept):
            first = pictures[on][0][index]
            apart = [np.abs(other[index].astype(np.float64) - first) for other in pictures[on][1:]]
            mean = max(float(each.mean()) for each in apart)
            table.add(scene.name, "on" if on else "off", frame, max(float(each.max()) for each in apart), mean,
                      mean / float(first.mean()), 1e3 * means[on], means[True] / means[False])
    return all(np.array_equal(a, b) for other in pictures[True] for a, b in zip(other, pictures[True][0], strict=True))


def main() -> int:
    """Measure all scenes; returns 1 where runs with the option on differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device", default="cuda", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(640, 360))
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--repeat", type=int, default=2)
    parser.add_argument("--set", action="append", default=[], metavar="GROUP.FIELD=VALUE")
    parser.add_argument("--output", type=Path, default=Path("out/run_to_run"))
    options = parser.parse_args()
    if options.repeat < 2 or options.frames < 1:
        parser.error("two runs of a frame at least are needed")
    table = Table(COLUMNS)
    same = [measure(path, options, table) for path in options.scenes]
    table.save(options.output / "run_to_run.md", f"Differences from run to run, {options.device}")
    if wp.get_device(options.device).is_cuda:
        print(f"Warp's pool in use at the end: {wp.get_mempool_used_mem_current(options.device) / 2**20:.1f} MiB")
    print(f"{sum(same)} of {len(same)} scenes are the same in every run with the option on")
    return int(not all(same))


if __name__ == "__main__":
    raise SystemExit(main())
