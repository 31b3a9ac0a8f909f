# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure the real-time integrator through a camera flight: error, flicker, steadiness. Run by hand.

    python tests/performance/flight.py SCENE.blend... [--device cuda] [--size 640 360] [--frames 60] [--every 10]
        [--truth 1024] [--window 8] [--cycles 16] [--as-is] [--alone] [--slower 1] [--set GROUP.FIELD=VALUE]
        [--output out/flight]

Rests for 64 frames at the first camera, whose error is the measure, then flies one frame a camera. Every tenth frame
is compared with Reference. --alone rests without path-traced samples: what the filters alone reach is the measure.
--slower 8 flies the same way in eight times as many frames, of which every eighth is looked at.
Flicker is the standard deviation over `window` frames of the sRGB values of the same points (steadiness.py), as they
are and after an 8x8 blur; Cycles renders those frames one by one, each with another seed, and denoises each alone.
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
from tests.performance.measured_session import (  # noqa: E402
    COLUMNS,
    LEGEND,
    Measured,
    attempt,
    compare,
    error_cells,
    positions_of,
    settings_for,
    truth_of,
)
from tests.performance.settings_text import FILTERED, merged, parse_settings  # noqa: E402
from tests.performance.sheets import Table, flip_map, save_sheet, tone  # noqa: E402
from tests.performance.steadiness import blurred, flicker  # noqa: E402

REST = 64
"""Frames at rest before the flight"""
GOALS = "Goals: FLIP at most 1.5 times that at rest; flicker at most that of Cycles + OIDN."


class Flight:
    """One scene's flight."""

    def __init__(self, path: Path, options: argparse.Namespace):
        self.options, self.size = options, tuple(options.size)
        self.scene = BlendScene(path, self.size, options.device, matte=not options.as_is)
        self.reference = Measured(settings_for("reference", options.device, seed=12345))
        self.reference.load(self.scene.extract())
        places = positions_of(self.reference, self.scene.camera, self.size)
        self.way = fly_over(self.scene.camera, places, (options.frames - 1) * options.slower + 1)
        self.cameras = self.way[::options.slower]
        first = max(0, options.frames // 2 - options.window)
        self.window = range(first, min(first + options.window, options.frames))
        self.rows: list[list[tuple[np.ndarray, str]]] = []

    def truth(self, frame: int) -> np.ndarray:
        """Return Reference's picture of a frame."""
        o = self.options
        file = o.output / "truth" / f"{self.scene.name}_{self.size[0]}_{o.frames}_{frame:03d}_{o.truth}.npy"
        return truth_of(None, self.cameras[frame], self.size, o.device, o.truth, file, o.truth_seconds, self.reference)

    def fly(self) -> tuple[np.ndarray, list[np.ndarray], float]:
        """Return the picture after the rest, those of `cameras`, and milliseconds a frame."""
        o = self.options
        groups = merged(FILTERED if o.alone else None, parse_settings(o.set))
        measured = Measured(settings_for(o.integrator, o.device, **groups))
        measured.load(self.scene.extract())
        measured.look(self.cameras[0], self.size)
        measured.frames(REST if o.integrator == "realtime" else 1)
        rest = measured.picture()
        pictures, seconds = [], 0.0
        for number, camera in enumerate(self.way):
            measured.look(camera, self.size)
            seconds += measured.frames(1)
            if number % o.slower == 0:
                pictures.append(measured.picture())
        print("   ", measured.counts(), flush=True)
        measured.close()
        return rest, pictures, seconds / len(self.way) * 1e3

    def measure(self, table: Table, flickers: Table) -> None:
        """Add all rows of the scene and save its contact sheet."""
        rest, pictures, milliseconds = self.fly()
        name, exposure = self.scene.name, self.scene.exposure
        at_rest = compare(self.truth(0), rest)
        table.add(name, "at rest", 1.0, *error_cells(at_rest))
        ratios = []
        for frame in range(self.options.every, self.options.frames, self.options.every):
            truth = self.truth(frame)
            error = compare(truth, pictures[frame])
            ratios.append(error.flip / max(at_rest.flip, 1e-9))
            table.add(name, f"frame {frame}", ratios[-1], *error_cells(error))
            self.rows.append([
                (tone(truth, exposure), f"{name} frame {frame}: Reference"),
                (tone(pictures[frame], exposure), f"{self.options.integrator}: FLIP {error.flip:.3f}"),
                (flip_map(truth, pictures[frame])[0], f"FLIP, {ratios[-1]:.2f} times that at rest")])
        self.measure_flicker(pictures, flickers)
        print(f"    {name}: {milliseconds:.1f} ms a frame; worst FLIP ratio {max(ratios, default=0.0):.2f} (goal 1.5)")
        self.reference.close()
        save_sheet(self.options.output / f"{name}.png", self.rows, shrink=2 if self.size[0] >= 640 else 1)

    def measure_flicker(self, pictures: list[np.ndarray], table: Table) -> None:
        """Add the rows about flicker in the window."""
        cameras = [self.cameras[frame] for frame in self.window]
        places = [positions_of(self.reference, camera, self.size) for camera in cameras]
        kinds = {self.options.integrator: [pictures[frame] for frame in self.window]}
        if self.options.cycles:
            kinds[f"Cycles {self.options.cycles} + OIDN"] = [
                self.scene.cycles(self.options.cycles, denoise=True, camera=camera, seed=frame)[0]
                for frame, camera in zip(self.window, cameras, strict=True)]
        for label, images in kinds.items():
            encoded = [tone(image, self.scene.exposure) for image in images]
            grain, share = flicker(encoded, cameras, places)
            blotches, _ = flicker([blurred(image, 8) for image in encoded], cameras, places)
            table.add(self.scene.name, label, grain, blotches, share)


def measure(path: Path, options: argparse.Namespace, table: Table, flickers: Table) -> None:
    """Add the rows of one scene."""
    Flight(path, options).measure(table, flickers)


def main() -> int:
    """Measure all scenes; one that fails is told and skipped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(640, 360))
    parser.add_argument("--integrator", default="realtime")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--every", type=int, default=10)
    parser.add_argument("--truth", type=int, default=1024)
    parser.add_argument("--truth-seconds", type=float, default=15.0)
    parser.add_argument("--window", type=int, default=8)
    parser.add_argument("--cycles", type=int, default=16, help="samples of Cycles; 0: none")
    parser.add_argument("--as-is", action="store_true")
    parser.add_argument("--alone", action="store_true", help="rest without path-traced samples")
    parser.add_argument("--slower", type=int, default=1, help="frames for each of the flight's")
    parser.add_argument("--set", action="append", default=[], metavar="GROUP.FIELD=VALUE")
    parser.add_argument("--output", type=Path, default=Path("out/flight"))
    options = parser.parse_args()
    table = Table(("scene", "picture", "of FLIP at rest", *COLUMNS))
    flickers = Table(("scene", "picture", "flicker", "flicker 8x8", "share of pixels"))
    failed = sum(attempt(path.stem, measure, path, options, table, flickers) for path in options.scenes)
    title = f"Flight of {options.frames} frames, {options.size[0]} x {options.size[1]}, {options.device}"
    table.save(options.output / "flight.md", title, f"{LEGEND} {GOALS}")
    flickers.save(options.output / "flight.md", "Flicker")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
