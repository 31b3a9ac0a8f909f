# SPDX-License-Identifier: GPL-3.0-or-later
"""Time frames of the real-time integrator with a moving camera, by section, with rays and cells. Run by hand.

    python tests/performance/frame_timing.py SCENE.blend... [--device cuda] [--size 1920 1080] [--frames 100]
        [--as-is] [--set GROUP.FIELD=VALUE] [--output out/frame_timing]

The total is wall time of frames issued one after the other and waited for once at the end; sections are timed in
frames of their own, each launch between two events (CUDA) or clocks (processor), so that their sum is larger by what
overlaps and by the gaps. On the processor the default is 480x270 and 12 frames.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import traceback
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

import numpy as np  # noqa: E402

from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.camera_path import flight  # noqa: E402
from tests.performance.measured_session import Measured, positions_of, settings_for  # noqa: E402
from tests.performance.settings_text import parse_settings  # noqa: E402
from tests.performance.sheets import Table  # noqa: E402

WARM_UP = 24
"""Frames before anything is timed: kernels loaded, both graphs captured, cache filled"""
TIMED = 10
"""Frames whose sections are timed; the median is taken"""
SMALL = (160, 90)
"""Size at which the flight is planned"""


def measure(path: Path, options: argparse.Namespace, totals: Table, sections: Table, counted: Table) -> None:
    """Add the rows of one scene."""
    size = tuple(options.size)
    scene = BlendScene(path, size, options.device, matte=not options.as_is)
    delta = scene.extract()
    reference = Measured(settings_for("reference", options.device))
    reference.load(delta)
    places = positions_of(reference, scene.camera_for(SMALL), SMALL)
    reference.close()
    # The speed of a 60-frame flight, however many frames are timed.
    cameras = flight(scene.camera, places, 60)

    measured = Measured(settings_for(options.integrator, options.device, **parse_settings(options.set)))
    measured.load(delta)
    number = 0

    def frames(count: int) -> None:
        nonlocal number
        for _ in range(count):
            measured.look(cameras[abs((number + 59) % 118 - 59)], size)  # there and back again
            measured.session.step(1)
            number += 1

    frames(min(WARM_UP, options.frames))
    measured.wait()
    seconds = timed(measured, lambda: frames(options.frames))
    rest = timed(measured, lambda: measured.session.step(options.frames))
    totals.add(scene.name, seconds / options.frames * 1e3, options.frames / seconds, rest / options.frames * 1e3,
               measured.session.stats.triangles)
    frames(2)
    counts = measured.counts()
    for name, value in counts.items():
        counted.add(scene.name, name, value)
    shares(scene.name, measured, frames, sections)
    measured.close()


def timed(measured: Measured, work: Callable[[], object]) -> float:
    """Return the wall seconds of some work, waited for once."""
    import time

    measured.wait()
    start = time.perf_counter()
    work()
    measured.wait()
    return time.perf_counter() - start


def section_medians(measured: Measured, frames: Callable[[int], None]) -> dict[str, float]:
    """Return the median milliseconds of each section of TIMED frames, in the frame's order."""
    measured.session.timed = True
    runs: list[dict[str, float]] = []
    for _ in range(TIMED):
        frames(1)
        runs.append(dict(measured.session.frame_times))
    measured.session.timed = False
    names = list(dict.fromkeys(key for run in runs for key in run))
    return {key: float(np.median([run.get(key, 0.0) for run in runs])) for key in names}


def shares(name: str, measured: Measured, frames: Callable[[int], None], table: Table) -> None:
    """Add the median milliseconds and share of each section."""
    median = section_medians(measured, frames)
    total = sum(median.values())
    for key, value in median.items():
        table.add(name, key, value, 100.0 * value / max(total, 1e-9))
    table.add(name, "sum", total, 100.0)


def main() -> int:
    """Time all scenes; one that fails is told and skipped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2)
    parser.add_argument("--integrator", default="realtime")
    parser.add_argument("--frames", type=int)
    parser.add_argument("--as-is", action="store_true")
    parser.add_argument("--set", action="append", default=[], metavar="GROUP.FIELD=VALUE")
    parser.add_argument("--output", type=Path, default=Path("out/frame_timing"))
    options = parser.parse_args()
    options.size = options.size or ((1920, 1080) if options.device == "cuda" else (480, 270))
    options.frames = options.frames or (100 if options.device == "cuda" else 12)
    totals = Table(("scene", "ms a frame, moving", "frames/s, moving", "ms a frame, at rest", "triangles"))
    sections = Table(("scene", "section", "ms", "%"))
    counted = Table(("scene", "counted in a frame", "number"))
    failed = 0
    for path in options.scenes:
        try:
            measure(path, options, totals, sections, counted)
        except Exception:  # noqa: BLE001  one bad scene must not cost the others
            traceback.print_exc()
            failed += 1
    file = options.output / "timing.md"
    totals.save(file, f"Frame time, {options.size[0]} x {options.size[1]}, {options.device}")
    sections.save(file, "Sections (moving camera, median)")
    counted.save(file, "Counts (moving camera)")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
