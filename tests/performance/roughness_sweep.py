# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure reflections of every roughness against Reference: energy, steps between roughnesses, width of lobes.

    python tests/performance/roughness_sweep.py [--device cuda] [--size 128 96] [--frames 128] [--truth 1024]
        [--step 0.05] [--only ball,room,ramp,width,lamps] [--set GROUP.FIELD=VALUE] [--output out/roughness_sweep]

Run by hand; needs no Blender. Judges frames alone: the path-traced samples that at rest join them from the eighth on
are off (scene_pair.filtered_settings). Writes a table (Markdown and JSON) and pictures; returns 1 where a goal is
missed.
ball, room: a ball under a sky and a lamp, a floor before coloured walls, of one roughness after the other; ramp: all
of them in one floor; width: a thin bar's reflection in a floor; lamps: radii of 0 to 1 m reflected in a floor.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from tests import glossy_scenes as made  # noqa: E402
from tests.performance.measured_session import attempt  # noqa: E402
from tests.performance.scene_pair import (  # noqa: E402
    ScenePair,
    add_options,
    bad_pixels,
    dark,
    inside,
    luminance,
    ratio,
)
from tests.performance.sheets import Table, error_map, save_sheet, tone  # noqa: E402

COLUMNS = ("scene", "metallic", "roughness", "ratio", "ratio below 1", "step", "width", "truth's noise", "bad", "met")
LEGEND = """\
Frames alone, without path-traced samples at rest.
ratio: luminance over the reflecting surface by Reference's (goal 0.98..1.02, judged below 1.0; of lamps, of all
pixels). step: change of that ratio from the roughness before (goal: at most 0.01). width: ratio of the RMS widths of a
bar's reflection (goal 0.9..1.1, judged alone). Mirror images of lamps smaller than 0.1 m are too few pixels to judge.
truth's noise: what Reference's own mean may be off by, by the first eighth of its
samples (0: the truth was kept from an earlier run)."""
RATIO, STEP, WIDTH = 0.02, 0.01, 0.1
RADII = (0.0, 0.02, 0.1, 0.3, 1.0)


class Sweep:
    """Rows and pictures of one scene as its roughness changes."""

    def __init__(self, name: str, options: argparse.Namespace, table: Table):
        self.name, self.options, self.table = name, options, table
        self.columns: list[list[tuple[np.ndarray, str]]] = []
        self.missed = 0

    def run(self, label: Any, scene: Any, key: str, materials: Iterable[tuple[float, Any]], *, exact: bool = False,
            width: Callable | None = None, judged_from: float = 0.0) -> None:
        """Add a row for each (roughness, material).

        Args:
            label: Second column: metallic or the like.
            scene: The scene, whose material `key` is replaced.
            key: Of the material.
            materials: What to put there.
            exact: Judge all pixels, not only those below 1, and no steps.
            width: Returns the ratio of RMS widths of a truth and a picture in a mask; judged alone.
            judged_from: Roughness from which rows are judged.
        """
        pair = ScenePair(scene, self.options, f"{self.name}_{label}")
        mask = inside(scene.mask(pair.positions))
        before = None
        for roughness, material in materials:
            pair.start_with(key, material, f"{roughness:.3f}")
            picture, truth = pair.frames(int(self.options.frames.split(",")[-1])), pair.truth()
            seen = mask & dark(truth)
            of_all, of_dark = ratio(truth, picture, mask), ratio(truth, picture, seen)
            judged = of_all if exact else of_dark
            step = 0.0 if before is None else judged / before - 1.0
            wide = width(truth, picture, mask) if width else 1.0
            bad = bad_pixels(picture)
            good = abs(wide - 1.0) <= WIDTH if width else abs(judged - 1.0) <= RATIO and (exact or abs(step) <= STEP)
            counts = roughness >= judged_from
            self.missed += counts and not (good and bad == 0)
            self.table.add(self.name, label, roughness, of_all, of_dark, step, wide, pair.noise(truth, seen), bad,
                           ("yes" if good and bad == 0 else "NO") if counts else "")
            before = judged
            self.columns.append([
                (tone(truth), f"{roughness:g} {label}"), (tone(picture), f"{judged:.3f}"),
                (error_map(truth, picture), "error x4")])
        pair.close()

    def save(self, wide: int = 21) -> None:
        """Save the pictures: Reference, measured and error one below the other."""
        rows = []
        for first in range(0, len(self.columns), wide):
            part = self.columns[first:first + wide]
            rows += [[column[i] for column in part] for i in range(3)]
        if rows:
            save_sheet(self.options.output / f"{self.name}.png", rows, narrow=96)


def roughnesses(step: float) -> list[float]:
    """Return 0..1 in steps."""
    return [float(x) for x in np.arange(0.0, 1.0 + 1e-6, step)]


def both(options: argparse.Namespace, color: Any) -> Iterable[tuple[float, list[tuple[float, Any]]]]:
    """Yield metallic and its materials by roughness."""
    for metallic in (0.0, 1.0):
        yield metallic, [(r, made.glossy(color=color, roughness=r, metallic=metallic))
                         for r in roughnesses(options.step)]


def ball(sweep: Sweep) -> None:
    """Sweep a ball, as a dielectric and as a metal."""
    for metallic, materials in both(sweep.options, (0.6, 0.5, 0.4)):
        sweep.run(metallic, made.ball(sweep.options.size, materials[0][1]), "glossy", materials)


def room(sweep: Sweep) -> None:
    """Sweep a floor before coloured walls and shining panels."""
    for metallic, materials in both(sweep.options, (0.4, 0.35, 0.3)):
        sweep.run(metallic, made.colored_room(sweep.options.size, materials[0][1]), "floor", materials)


def ramp(sweep: Sweep) -> None:
    """Look at all roughnesses side by side in one floor: its columns are the rows of the table."""
    for metallic in (0.0, 1.0):
        scene = made.ramp_floor(sweep.options.size, metallic)
        pair = ScenePair(scene, sweep.options, f"ramp_{metallic}")
        picture, truth = pair.frames(int(sweep.options.frames.split(",")[-1])), pair.truth()
        mask = inside(scene.mask(pair.positions))
        before = None
        edges = roughnesses(sweep.options.step)
        for low, high in zip(edges, edges[1:], strict=False):
            x = pair.positions[..., 0] / 2.0 + 0.5
            strip = mask & (x >= low) & (x < high)
            if strip.sum() < 16:
                continue
            of_all, of_dark = ratio(truth, picture, strip), ratio(truth, picture, strip & dark(truth))
            step = 0.0 if before is None else of_dark / before - 1.0
            good = abs(of_dark - 1.0) <= RATIO and abs(step) <= STEP
            sweep.missed += not good
            sweep.table.add("ramp", metallic, 0.5 * (low + high), of_all, of_dark, step, 1.0,
                            pair.noise(truth, strip & dark(truth)), bad_pixels(picture), "yes" if good else "NO")
            before = of_dark
        sweep.columns.append([(tone(truth), f"Reference, metallic {metallic:g}"), (tone(picture), "measured"),
                              (error_map(truth, picture), "error x4")])
        pair.close()


def width(sweep: Sweep) -> None:
    """Sweep a metal floor that reflects a thin bar, lying and upright."""
    for label, upright in (("lying", False), ("upright", True)):
        materials = [(r, made.metal(r)) for r in roughnesses(sweep.options.step)]
        scene = made.thin_emitter(sweep.options.size, materials[0][1], upright)
        sweep.run(label, scene, "glossy", materials, exact=True,
                  width=lambda truth, picture, mask, axis=int(upright): (
                      rms_width(picture, truth, mask, axis) / rms_width(truth, truth, mask, axis)))


def rms_width(picture: np.ndarray, truth: np.ndarray, mask: np.ndarray, axis: int) -> float:
    """Return the RMS width [px] of a profile of the masked luminance, where the truth's is above 1 % of its peak.

    Args:
        picture: Whose width.
        truth: Which tells where to look.
        mask: What to look at.
        axis: Along which the profile runs: 0 upwards, 1 to the right.
    """
    profile, known = (np.where(mask, luminance(p), 0.0).sum(1 - axis) for p in (picture, truth))
    profile = np.where(known > 0.01 * known.max(), profile, 0.0)
    x = np.arange(len(profile)) + 0.5
    total = max(profile.sum(), 1e-12)
    center = (profile * x).sum() / total
    # A pixel has a width of its own.
    return float(np.sqrt((profile * (x - center) ** 2).sum() / total + 1.0 / 12.0))


def lamps(sweep: Sweep) -> None:
    """Sweep a metal floor under lamps of several radii; a lamp without extent has no mirror image."""
    for radius in RADII:
        materials = [(r, made.metal(r)) for r in roughnesses(2.0 * sweep.options.step) if r > 0.0 or radius > 0.0]
        sweep.run(f"{radius:g} m", made.round_lamp(sweep.options.size, materials[0][1], radius), "glossy", materials,
                  exact=True, judged_from=0.05 if radius < 0.1 else 0.0)


SWEEPS = {sweep.__name__: sweep for sweep in (ball, room, ramp, width, lamps)}


def main() -> int:
    """Sweep all that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_options(parser, "out/roughness_sweep", (128, 96), "128", 1024)
    parser.add_argument("--step", type=float, default=0.05)
    options = parser.parse_args()
    wanted = [name for name in options.only.split(",") if name] or list(SWEEPS)
    table = Table(COLUMNS)
    missed = 0
    for name in wanted:
        sweep = Sweep(name, options, table)
        missed += attempt(name, SWEEPS[name], sweep)
        sweep.save()
        missed += sweep.missed
        print(f"    {name}: {sweep.missed} goals missed", flush=True)
    frames = options.frames.split(",")[-1]
    title = f"Roughness: {options.integrator}, {frames} frames, {options.size[0]} x {options.size[1]}, {options.device}"
    table.save(options.output / "roughness_sweep.md", title, LEGEND)
    table.save_json(options.output / "roughness_sweep.json")
    return int(missed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
