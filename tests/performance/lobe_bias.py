# SPDX-License-Identifier: GPL-3.0-or-later
"""Find where the real-time method is too bright or too dark, lobe by lobe, in maps of ratios. Run by hand.

    python tests/performance/lobe_bias.py SCENE.blend [--device cuda] [--size 320 180] [--camera 10] [--frames 64]
        [--seeds 3] [--truth 1024] [--block 8] [--variant "name: GROUP.FIELD=VALUE ..."]... [--output out/lobe_bias]

Averages `seeds` runs of frames at rest (without path-traced samples, which would hide the bias) from the camera of a
frame of the flight (flight.py), and holds the light of each lobe (direct and indirect light times its colour) against
Reference's. Deviations of opposite sign cancel in a picture's mean, and noise hides them in its pixels; ratios of
blocks in the single lobes show them. Prints a table and saves maps: red is brighter, blue darker, by 25 % in full.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.image_error import LUMINANCE_WEIGHTS, box_filter, signed_difference  # noqa: E402
from burnish.engine.measure_moving import fly_over  # noqa: E402

from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.measured_session import Measured, positions_of, settings_for  # noqa: E402
from tests.performance.settings_text import FILTERED, merged, parse_settings  # noqa: E402
from tests.performance.sheets import Table, save_sheet, tone  # noqa: E402

LOBES = ("Diffuse", "Glossy", "Transmission")
PASSES = ("Combined", *(f"{lobe} {part}" for lobe in LOBES for part in ("Direct", "Indirect", "Color")))
FLIGHT_FRAMES = 60
DIM = 0.02
"""Blocks of less luminance than this by the picture's mean are left out"""


def lobes_of(measured: Measured) -> dict[str, np.ndarray]:
    """Return the light of each lobe [h, w, 3] and the whole picture."""
    read = {name: measured.session.read(name)[..., :3] for name in PASSES}
    lobes = {"Combined": read["Combined"]}
    for lobe in LOBES:
        for part in ("Direct", "Indirect"):
            # Light of the sky is direct in one integrator and indirect in the other: only the sum compares.
            lobes[lobe] = lobes.get(lobe, 0.0) + read[f"{lobe} {part}"] * read[f"{lobe} Color"]
    return lobes


def ratio_map(truth: np.ndarray, found: np.ndarray, block: int) -> np.ndarray:
    """Return a picture of the blocks' ratios, of the size of the pictures."""
    blocks = signed_difference(box_filter(truth, block), box_filter(found, block))
    enlarged = np.repeat(np.repeat(blocks, block, 0), block, 1)
    rows, columns = np.subtract(truth.shape[:2], enlarged.shape[:2])
    return np.pad(enlarged, ((0, rows), (0, columns), (0, 0)), "edge")


def mean_of(runs: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the mean of several runs."""
    return {name: np.mean([run[name] for run in runs], 0) for name in runs[0]}


def add_rows(
    table: Table, variant: str, truth: dict[str, np.ndarray], found: dict[str, np.ndarray], block: int,
) -> None:
    """Add a row for each lobe that the scene has."""
    whole = float((truth["Combined"] @ LUMINANCE_WEIGHTS).clip(0.0, 1.0).mean())
    dark = (box_filter(truth["Combined"], block) @ LUMINANCE_WEIGHTS) < 1.0
    for name, picture in truth.items():
        expected, shown = (box_filter(image, block) @ LUMINANCE_WEIGHTS for image in (picture, found[name]))
        lit = dark & (expected > DIM * whole)
        if not lit.any():
            continue
        ratios = shown[lit] / expected[lit]
        table.add(variant, name, float(shown[dark].sum() / expected[dark].sum()), *(
            float(value) for value in np.percentile(ratios, (5, 50, 95))), float(np.abs(ratios - 1.0).mean()))


def main() -> int:
    """Measure a scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(320, 180))
    parser.add_argument("--camera", type=int, default=0, help="frame of the flight")
    parser.add_argument("--frames", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--truth", type=int, default=1024)
    parser.add_argument("--block", type=int, default=8)
    parser.add_argument("--variant", action="append", default=[], metavar="NAME: GROUP.FIELD=VALUE ...")
    parser.add_argument("--output", type=Path, default=Path("out/lobe_bias"))
    options = parser.parse_args()
    size = tuple(options.size)
    scene = BlendScene(options.scene, size, options.device, matte=False)
    delta = scene.extract()
    reference = Measured(settings_for("reference", options.device, seed=12345))
    reference.load(delta)
    camera = fly_over(scene.camera, positions_of(reference, scene.camera, size), FLIGHT_FRAMES)[options.camera]
    file = options.output / "truth" / f"{scene.name}_{size[0]}_{options.camera}_{options.truth}.npz"
    if file.exists():
        truth = dict(np.load(file))
    else:
        reference.look(camera, size, passes=PASSES)
        reference.frames(options.truth)
        truth = lobes_of(reference)
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savez(file, **truth)
    reference.close()
    table = Table(("variant", "lobe", "dark", "p5", "median", "p95", "mean deviation"))
    shown = ("Combined", *LOBES)
    rows = [[(tone(truth[name], scene.exposure), f"Reference: {name}") for name in shown]]
    for text in options.variant or ["default:"]:
        name, _, settings = text.partition(":")
        groups = merged(FILTERED, parse_settings(settings.split()))
        runs = []
        for seed in range(options.seeds):
            measured = Measured(settings_for("realtime", options.device, seed=seed, **groups))
            measured.load(delta)
            measured.look(camera, size, passes=PASSES)
            measured.frames(options.frames)
            runs.append(lobes_of(measured))
            measured.close()
        found = mean_of(runs)
        np.savez(options.output / f"{scene.name}_{options.camera}_{name}.npz", **found)
        add_rows(table, name, truth, found, options.block)
        rows.append([(ratio_map(truth[lobe], found[lobe], options.block), f"{name}: {lobe}") for lobe in shown])
    save_sheet(options.output / f"{scene.name}_{options.camera}.png", rows)
    table.save(options.output / "bias.md", f"{scene.name}, camera {options.camera}, {size[0]} x {size[1]}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
