# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure what the passes of a frame that trace no rays take, in matte copies with a moving camera. Run by hand.

    python tests/performance/passes_without_rays.py SCENE.blend... [--device cuda] [--size 1920 1080] [--frames 40]
        [--as-is] [--least 0.04] [--output out/passes]

Kernels are timed one by one; in the frame they run side by side, so that their sum exceeds it. Three sums: kernels in
sections of rays and drawn triangles, kernels that evaluate materials, and all else. Beside them the time to touch once
each byte that the passes hold, at the device's copy rate, which is the least that all else could take.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.frame_profile import buffer_bytes, copy_rate  # noqa: E402
from burnish.engine.measure_moving import FrameTimes, fly_over, measure_frames  # noqa: E402

from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.measured_session import Measured, attempt, positions_of, settings_for  # noqa: E402
from tests.performance.sheets import Table  # noqa: E402

FLIGHT = 60
"""Cameras of the flight"""
RAYS = ("rays", "bounces", "shadows", "walks")
"""How sections that trace rays end, those that draw triangles in their place among them"""
MATERIALS = ("materials", "hits")
"""How sections that evaluate materials end"""
LEGEND = """\
frame: of frames in a row. kernels: all of them, one by one. touched once: the bytes that the passes hold, at the copy
rate. long: kernels of all else that take longer than --least, and the longest of them."""


def kind_of(section: str) -> str:
    """Return which of the three sums a section belongs to."""
    last = section.lower().split()[-1]
    return "rays" if last in RAYS else "materials" if last in MATERIALS else "else"


def sums_of(times: FrameTimes) -> dict[str, float]:
    """Return the milliseconds of each kind of section."""
    sums = dict.fromkeys(("rays", "materials", "else"), 0.0)
    for section, milliseconds in times.sections.items():
        sums[kind_of(section)] += milliseconds
    return sums


def measure(path: Path, options: argparse.Namespace, table: Table) -> None:
    """Add a scene's row and print the kernels of all else, the longest first."""
    size = tuple(options.size)
    scene = BlendScene(path, size, options.device, matte=not options.as_is)
    measured = Measured(settings_for("realtime", options.device))
    try:
        measured.load(scene.extract())
        cameras = fly_over(scene.camera, positions_of(measured, scene.camera, size), FLIGHT)
        times = measure_frames(measured.session, measured.settings, cameras, size, frames=options.frames)
        pipeline = measured.session.pipeline
        sections = {kernel: section for section, kernel in pipeline.launches()}
        rest = sorted(((ms, name) for name, ms in times.kernels.items()
                       if kind_of(sections.get(name, "rays")) == "else"), reverse=True)
        touched = sum(buffer_bytes(pipeline).values()) / copy_rate(pipeline.device) * 1e3
        sums = sums_of(times)
        longer = [ms for ms, _ in rest if ms > options.least]
        table.add(scene.name, times.in_a_row, sum(sums.values()), *sums.values(), touched, len(longer),
                  max(longer, default=0.0))
        for section, milliseconds in sorted(times.sections.items(), key=lambda item: -item[1]):
            print(f"    {milliseconds:7.3f}  {kind_of(section):9} {section}")
        for milliseconds, name in rest:
            print(f"    {milliseconds:7.3f}  {sections[name]:28} {name}")
    finally:
        measured.close()


def main() -> int:
    """Measure the scenes of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device", default="cuda", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(1920, 1080))
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--as-is", action="store_true")
    parser.add_argument("--least", type=float, default=0.04, help="milliseconds from which a kernel counts as long")
    parser.add_argument("--output", type=Path, default=Path("out/passes"))
    options = parser.parse_args()
    table = Table(("scene", "frame", "kernels", "rays", "materials", "all else", "touched once", "long", "longest"))
    failed = sum(attempt(path.stem, measure, path, options, table) for path in options.scenes)
    title = f"Passes without rays, {options.size[0]} x {options.size[1]}, {options.device}, milliseconds"
    table.save(options.output / "passes.md", title, LEGEND)
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
