# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure the real-time integrator at rest against Reference, beside Cycles with OpenImageDenoise. Run by hand.

    python tests/performance/realtime_error.py SCENE.blend... [--device cuda] [--size 640 360] [--frames 1,8,64,256]
        [--truth 4096] [--truth-exr cycles_640x360.exr] [--cycles 64] [--as-is | --both] [--alone] [--shrink 2]
        [--set cache.bounces=1] [--output out/realtime_error]

Scenes are made matte (matte_copy.py) unless --as-is; --both measures the unmodified scene and its matte copy. The truth
is Reference's picture of the same copy, kept in the output folder; with --truth-exr unmodified scenes are held against
the file of that name beside the scene, and Reference is measured against it too. At rest path-traced samples join the
frames from the eighth on, and steps count both; --alone measures frames alone, the real-time method by itself. Prints
and saves a table (Markdown and JSON) and, for each scene, pictures side by side.
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
from burnish.engine.image_error import signed_difference  # noqa: E402
from burnish.engine.read import read_exr  # noqa: E402

from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.measured_session import (  # noqa: E402
    COLUMNS,
    LEGEND,
    Measured,
    attempt,
    compare,
    error_cells,
    settings_for,
    truth_of,
)
from tests.performance.settings_text import FILTERED, merged, parse_settings  # noqa: E402
from tests.performance.sheets import Table, error_map, flip_map, save_sheet, tone  # noqa: E402

GOALS = "Goals at 256 frames: dark 0.98..1.02, p5 >= 0.9, p95 <= 1.1, FLIP below that of Cycles."


def read_truth(file: Path, size: tuple[int, int]) -> np.ndarray:
    """Return a picture [h, w, 3] from an EXR, bottom row first.

    Raises:
        BurnishError: It can't be read.
        ValueError: It has another size.
    """
    picture = read_exr(file)
    if picture.shape[:2] != (size[1], size[0]):
        raise ValueError(f"'{file}' is not a picture of {size[0]} x {size[1]} pixels")
    return picture


def measure(path: Path, matte: bool, options: argparse.Namespace, table: Table) -> None:
    """Add the rows of one scene, as it is or as its matte copy, and save its pictures."""
    size = tuple(options.size)
    scene = BlendScene(path, size, options.device, matte=matte)
    kind = "matte" if matte else "as is"
    delta = scene.extract()
    kept = options.output / "truth" / f"{scene.name}_{size[0]}x{size[1]}_{options.truth}{'' if matte else '_as_is'}.npy"
    ours = truth_of(delta, scene.camera, size, options.device, options.truth, kept, options.truth_seconds)
    from_file = options.truth_exr is not None and not matte
    truth = read_truth(path.parent / options.truth_exr, size) if from_file else ours
    source = options.truth_exr if from_file else f"Reference, {options.truth} spp"
    panels = [(tone(truth, scene.exposure), f"{scene.name}, {kind}: {source}")]
    maps = []

    def take(label: str, picture: Any, cost: Any) -> None:
        error = compare(truth, picture)
        table.add(scene.name, kind, label, cost, *error_cells(error))
        panels.append((tone(picture, scene.exposure), f"{label}: FLIP {error.flip:.3f}"))
        maps[:] = [(flip_map(truth, picture)[0], f"FLIP map of {label}"),
                   (signed_difference(truth, picture), f"{label}: red brighter, blue darker by 25 %"),
                   (error_map(truth, picture, exposure=scene.exposure), f"{label}: error x4")]

    if from_file:
        take("Reference", ours, "")
    groups = merged(FILTERED if options.alone else None, parse_settings(options.set))
    measured = Measured(settings_for(options.integrator, options.device, **groups))
    measured.load(delta)
    measured.look(scene.camera, size)
    kind_of_steps = f"{options.integrator} alone" if options.alone else options.integrator
    done = 0
    for count in sorted(int(text) for text in options.frames.split(",")):
        seconds = measured.frames(count - done)
        take(f"{kind_of_steps} {count}", measured.picture(), f"{seconds / (count - done) * 1e3:.2f}")
        done = count
    own = list(maps)
    for line in measured.session.report.text().splitlines():
        print("   ", line, flush=True)
    print("   ", measured.counts(), flush=True)
    measured.close()
    if options.cycles:
        scene.cycles(1, denoise=True)  # loads its kernels
        picture, seconds = scene.cycles(options.cycles, denoise=True)
        take(f"Cycles {options.cycles} + OIDN", picture, f"{seconds * 1e3:.0f}")
    panels += own + maps[:1] * bool(options.cycles)
    half = -(-len(panels) // 2)
    save_sheet(options.output / f"{scene.name}{'' if matte else '_as_is'}.png", [panels[:half], panels[half:]],
               shrink=options.shrink)


def main() -> int:
    """Measure all scenes; one that fails is told and skipped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(640, 360))
    parser.add_argument("--integrator", default="realtime")
    parser.add_argument("--frames", default="1,8,64,256")
    parser.add_argument("--truth", type=int, default=4096)
    parser.add_argument("--truth-seconds", type=float, default=60.0, help="take the truth as it is after this time")
    parser.add_argument("--cycles", type=int, default=64, help="samples of Cycles; 0: none")
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--as-is", action="store_true", help="leave the materials as they are")
    kinds.add_argument("--both", action="store_true", help="measure unmodified scenes and their matte copies")
    parser.add_argument("--truth-exr", help="name of a file beside each scene, the truth of the unmodified scene")
    parser.add_argument("--alone", action="store_true", help="frames alone, without path-traced samples at rest")
    parser.add_argument("--shrink", type=int, default=1, help="save pictures smaller by this factor")
    parser.add_argument("--set", action="append", default=[], metavar="GROUP.FIELD=VALUE")
    parser.add_argument("--output", type=Path, default=Path("out/realtime_error"))
    options = parser.parse_args()
    table = Table(("scene", "materials", "picture", "ms", *COLUMNS))
    copies = (False, True) if options.both else (not options.as_is,)
    failed = sum(attempt(path.stem, measure, path, matte, options, table)
                 for path in options.scenes for matte in copies)
    kind = "frames alone at rest" if options.alone else "at rest"
    title = f"{options.integrator}, {kind}, {options.size[0]} x {options.size[1]}, {options.device}"
    table.save(options.output / "error.md", title, f"{LEGEND}\nms: a frame, or Cycles' whole render. {GOALS}")
    table.save_json(options.output / "error.json")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
