# SPDX-License-Identifier: GPL-3.0-or-later
"""Time what finds what pixels show, by rays and by drawing triangles, and check that both agree. Run by hand.

    python tests/performance/primary_visibility.py SCENE.blend... [--device cuda:0] [--size 1920 1080] [--frames 60]

A row for each scene: milliseconds of the frame's first section both ways (each launch between two events), of whole
frames in a row with a moving camera, and, over five cameras of the flight, how many pixels in a million show another
triangle or have another layer before it. Then the dearest kernels of the second way.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

import numpy as np  # noqa: E402
from burnish.addon import registered  # noqa: E402
from burnish.addon.measured_scene import MeasuredScene, open_measured  # noqa: E402
from burnish.engine import pipeline  # noqa: E402
from burnish.engine.device import choose_device  # noqa: E402
from burnish.engine.measure import wait  # noqa: E402
from burnish.engine.measure_moving import FrameTimes, measure_frames, there_and_back  # noqa: E402
from burnish.engine.passes.gbuffer import GBufferPass  # noqa: E402

from tests.performance.measured_session import attempt  # noqa: E402

SECTION = "Primary rays"
FLIGHT = 60
CAMERAS = 5
"""Whose hits are compared"""
KERNELS = 40
"""The dearest, in the list"""


def choose(rasterizing: bool) -> None:
    """Let the pipelines to come draw triangles, or trace rays."""
    pipeline.GBufferPass = lambda device: GBufferPass(device, rasterizing=rasterizing)


def hits_of(scene: MeasuredScene, cameras: list, size: tuple[int, int]) -> list[dict[str, np.ndarray]]:
    """Return triangle and layer of each pixel for some cameras."""
    found = []
    session = scene.session
    view = there_and_back(cameras)
    for number in range(0, len(cameras), max(len(cameras) // CAMERAS, 1)):
        session.configure(scene.settings, view(number), *size)
        session.reset()
        session.step(1)
        wait(session)
        hits = session.pipeline.gbuffer.hits
        found.append({name: getattr(hits, name).numpy().copy() for name in ("hit", "layer")})
    return found


def differing(drawn: list[dict[str, np.ndarray]], traced: list[dict[str, np.ndarray]], name: str) -> float:
    """Return how many pixels in a million differ."""
    return 1e6 * float(np.mean([(a[name] != b[name]).any(1).mean() for a, b in zip(drawn, traced, strict=True)]))


def measure(path: Path, size: tuple[int, int], device: str, frames: int) -> None:
    """Print a scene's row and kernels."""
    scene = open_measured(path, size, device)
    try:
        cameras = scene.flight(size, FLIGHT)
        found, times = {}, {}
        for way in (False, True, False, True):
            choose(way)
            # Another size makes the passes anew.
            scene.session.configure(scene.settings, cameras[0], 32, 18)
            times.setdefault(way, []).append(
                measure_frames(scene.session, scene.settings, cameras, size, frames=frames))
            found[way] = hits_of(scene, cameras, size)
        print(row(path.stem, times, found), flush=True)
        kernels = times[True][-1].kernels
        dearest = sorted(kernels, key=kernels.get, reverse=True)[:KERNELS]
        print("    " + ", ".join(f"{name} {kernels[name]:.3f}" for name in dearest), flush=True)
        counts = scene.session.pipeline.gbuffer.raster.lists.counts.numpy().tolist()
        print(f"    triangles dealt out, tiles, blocks: {counts}", flush=True)
    finally:
        scene.close()


def row(name: str, times: dict[bool, list[FrameTimes]], found: dict[bool, Any]) -> str:
    """Return a scene's figures."""
    section = {way: min(each.sections[SECTION] for each in times[way]) for way in times}
    frame = {way: min(each.in_a_row for each in times[way]) for way in times}
    return (f"{name}: section {section[False]:.3f} by rays, {section[True]:.3f} drawn; frame {frame[False]:.3f}, "
            f"{frame[True]:.3f}; differing hits {differing(found[True], found[False], 'hit'):.1f}, layers "
            f"{differing(found[True], found[False], 'layer'):.1f} in a million")


def main() -> int:
    """Measure the scenes of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--size", nargs=2, type=int, default=(1920, 1080))
    parser.add_argument("--frames", type=int, default=60)
    arguments = parser.parse_args()
    device = choose_device(arguments.device)
    with registered(False):
        return sum(attempt(path.stem, measure, path, tuple(arguments.size), device, arguments.frames)
                   for path in arguments.scenes)


if __name__ == "__main__":
    sys.exit(main())
