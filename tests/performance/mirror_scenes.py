# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure mirrors, glass, chrome, coats and rough metal against Reference, at rest and while things move.

    python tests/performance/mirror_scenes.py [--device cuda] [--size 320 192] [--frames 1,8,64,256] [--truth 4096]
        [--only off_screen,coated] [--set GROUP.FIELD=VALUE] [--output out/mirror_scenes]

Run by hand; needs no Blender. Judges frames alone: the path-traced samples that at rest join them from the eighth on
are off (scene_pair.filtered_settings). Writes tables (Markdown and JSON) and for each scene pictures beside
Reference's with their error enlarged four times. Movers: error in every fourth frame of the movement, and 8 and 64
frames after it.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from tests import glossy_scenes  # noqa: E402
from tests.performance.measured_session import COLUMNS, LEGEND, attempt, compare, error_cells  # noqa: E402
from tests.performance.scene_pair import ScenePair, add_options, dark  # noqa: E402
from tests.performance.sheets import Table, error_map, save_sheet, tone  # noqa: E402

REST = 64
"""Frames before anything moves"""
EVERY = 4
AFTER = 8
GOALS = """\
Frames alone, without path-traced samples at rest.
Goals at 256 frames: lum and dark 0.98..1.02, no bad pixels; movers 8 and 64 frames after: FLIP as anew."""


def measure(name: str, options: argparse.Namespace, table: Table) -> None:
    """Add the rows of a scene and save its pictures."""
    scene = glossy_scenes.MIRRORS[name](tuple(options.size))
    pair = ScenePair(scene, options, name)
    rows: list[list[tuple[np.ndarray, str]]] = []

    def take(label: str, picture: np.ndarray, truth: np.ndarray, milliseconds: float) -> None:
        error = compare(truth, picture)
        table.add(name, label, milliseconds, *error_cells(error), pair.noise(truth, dark(truth)))
        rows.append([(tone(picture), f"{name}, {label}: FLIP {error.flip:.3f}"), (tone(truth), "Reference"),
                     (error_map(truth, picture), f"error x4, dark {error.dark_luminance:.3f}")])

    truth = pair.truth()
    done = 0
    for count in sorted(int(text) for text in options.frames.split(",")):
        seconds = pair.measured.frames(count - done)
        take(f"{count} frames", pair.measured.picture(), truth, seconds / (count - done) * 1e3)
        done = count
    if scene.change is not None:
        move(scene, pair, take)
    for line in pair.measured.session.report.text().splitlines():
        print("   ", line, flush=True)
    print("   ", pair.measured.counts(), flush=True)
    pair.close()
    save_sheet(options.output / f"{name}.png", rows)


def move(scene: glossy_scenes.GlossyScene, pair: ScenePair, take: object) -> None:
    """Let things move, one frame a step, and stop."""
    pair.measured.session.reset()
    pair.frames(REST)
    seconds = 0.0
    for frame in range(1, scene.frames + 1):
        pair.measured.load(scene.change(frame))
        seconds += pair.measured.frames(1)
        if frame % EVERY == 0:
            picture = pair.measured.picture()
            pair.reference.load(scene.change(frame))
            pair.state = f"frame{frame}"
            take(f"moving, frame {frame}", picture, pair.truth(), seconds / frame * 1e3)
    last = pair.truth()
    for before, after in ((0, AFTER), (AFTER, REST)):
        take(f"{after} frames after", pair.frames(after - before), last, seconds / scene.frames * 1e3)
    pair.measured.session.reset()
    for before, after in ((0, AFTER), (AFTER, REST)):
        take(f"anew, {after} frames", pair.frames(after - before), last, 0.0)


def main() -> int:
    """Measure all scenes; one that fails is told and skipped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_options(parser, "out/mirror_scenes", (320, 192), "1,8,64,256", 4096)
    options = parser.parse_args()
    table = Table(("scene", "picture", "ms", *COLUMNS, "truth's noise"))
    names = [name for name in options.only.split(",") if name] or glossy_scenes.MIRRORS
    failed = sum(attempt(name, measure, name, options, table) for name in names)
    title = f"Mirrors and glass: {options.integrator}, {options.size[0]} x {options.size[1]}, {options.device}"
    table.save(options.output / "mirror_scenes.md", title, f"{LEGEND}\n{GOALS}")
    table.save_json(options.output / "mirror_scenes.json")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
