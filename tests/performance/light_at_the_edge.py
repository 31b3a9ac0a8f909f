# SPDX-License-Identifier: GPL-3.0-or-later
"""Hold the light of what has just come into view against the same at rest. Run by hand.

    python tests/performance/light_at_the_edge.py SCENE.blend... [--device cuda] [--size 320 180] [--at 20 40]
        [--slower 1 8] [--columns 20] [--strips 2] [--rest 256] [--set GROUP.FIELD=VALUE]

Where a camera turns, the picture's edge shows what was out of view some frames ago, and light that follows the camera
shows there first. A row for each speed, frame and edge: diffuse light of strips of so many columns, the outermost
first, by what frames alone show after a rest in the same view. --slower 8 flies the same way in eight times as many
frames.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.measure_moving import fly_over  # noqa: E402

from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.measured_session import Measured, attempt, positions_of, settings_for  # noqa: E402
from tests.performance.settings_text import FILTERED, merged, parse_settings  # noqa: E402
from tests.performance.sheets import Table  # noqa: E402

FRAMES = 60
"""Of the flight"""
DIFFUSE = ("Diffuse Direct", "Diffuse Indirect", "Diffuse Color")


def diffuse_light(measured: Measured) -> np.ndarray:
    """Return the diffuse light that the picture holds [h, w], the mean of its channels."""
    direct, indirect, color = (measured.session.read(name)[..., :3] for name in DIFFUSE)
    return ((direct + indirect) * color).mean(-1)


def strip_ratios(light: np.ndarray, rest: np.ndarray, columns: int, strips: int) -> list[float]:
    """Return the light of strips by that at rest, of the left edge and then of the right one, the outermost first."""
    from_left = [slice(i * columns, (i + 1) * columns) for i in range(strips)]
    from_right = [slice(-(i + 1) * columns, -i * columns or None) for i in range(strips)]
    return [float(light[:, each].sum() / max(rest[:, each].sum(), 1e-12)) for each in (*from_left, *from_right)]


def measure(path: Path, options: argparse.Namespace, table: Table) -> None:
    """Add the rows of one scene."""
    size = tuple(options.size)
    scene = BlendScene(path, size, options.device, matte=False)
    content = scene.extract()
    settings = settings_for("realtime", options.device, **merged(FILTERED, parse_settings(options.set)))
    resting = Measured(settings)
    resting.load(content)
    places = positions_of(resting, scene.camera, size)
    at_rest: dict[int, np.ndarray] = {}
    for slower in options.slower:
        cameras = fly_over(scene.camera, places, (FRAMES - 1) * slower + 1)
        moving = Measured(settings)
        moving.load(content)
        for number, camera in enumerate(cameras[:max(options.at) * slower + 1]):
            moving.look(camera, size, passes=("Combined", *DIFFUSE))
            moving.frames(1)
            frame = number // slower
            if number % slower or frame not in options.at:
                continue
            if frame not in at_rest:
                resting.session.reset()
                resting.look(camera, size, passes=("Combined", *DIFFUSE))
                resting.frames(options.rest)
                at_rest[frame] = diffuse_light(resting)
            ratios = strip_ratios(diffuse_light(moving), at_rest[frame], options.columns, options.strips)
            table.add(scene.name, slower, frame, *ratios)
        moving.close()
    resting.close()


def main() -> int:
    """Measure all scenes; one that fails is told and skipped."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(320, 180))
    parser.add_argument("--at", type=int, nargs="+", default=(20, 40), help="frames of the flight")
    parser.add_argument("--slower", type=int, nargs="+", default=(1, 8), help="frames for each of the flight's")
    parser.add_argument("--columns", type=int, default=20)
    parser.add_argument("--strips", type=int, default=2)
    parser.add_argument("--rest", type=int, default=256)
    parser.add_argument("--set", action="append", default=[], metavar="GROUP.FIELD=VALUE")
    parser.add_argument("--output", type=Path, default=Path("out/edge"))
    options = parser.parse_args()
    names = [f"{side} {i}" for side in ("left", "right") for i in range(options.strips)]
    table = Table(("scene", "slower", "frame", *names))
    failed = sum(attempt(path.stem, measure, path, options, table) for path in options.scenes)
    table.save(options.output / "edge.md", "Light at the edge, {} x {}, {}".format(*options.size, options.device))
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
