# SPDX-License-Identifier: GPL-3.0-or-later
"""`burnish bench SCENE --ablation`: what each part of the real-time integrator is worth, in error and in time.

Every variant of engine/variants.py renders the same frames in one session: error at rest against a truth, the time of a
frame while the camera moves and, where asked for, the error in flight; each beside its difference to the default.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from ..engine.device import choose_device
from ..engine.errors import BurnishError
from ..engine.image_error import ImageError, compare
from ..engine.measure_moving import MovingCamera, settling_frames, there_and_back
from ..engine.variants import DEFAULT, VARIANTS, variant_settings
from . import registered
from .bench_plots import new_figure
from .cli_output import Console, diverted_output
from .measured_scene import MeasuredScene, open_measured
from .scaling import machine_facts

__all__ = ["run"]

SIZE = (640, 360)
TRUTH_SECONDS = 60.0
FLIGHT = 60
"""Frames of the flight whose steps are taken"""
MIDDLE = 24
"""Frame of the flight at which errors are measured"""
TIMED = 16
"""Moving frames that are timed, in a row"""
FIGURES = (("FLIP", "flip"), ("relMSE", "relative_mse"), ("dark", "dark_luminance"), ("p5", "block_p5"),
           ("p95", "block_p95"), ("bad", "bad_pixels"))


def run(arguments: argparse.Namespace) -> int:
    """Measure all scenes; write ablation.json, ablation.md and ablation.png after each. 1 if one failed."""
    if not arguments.scenes:
        raise BurnishError("--ablation needs a scene; name one .blend file or more")
    if arguments.reference and len(arguments.reference) != len(arguments.scenes):
        raise BurnishError(f"There are {len(arguments.scenes)} scenes but {len(arguments.reference)} references; "
                           "give --reference once for each scene")
    names = chosen_variants(arguments.ablation)
    with (diverted_output(show_all=getattr(arguments, "show_all", False)) as console,
          registered(getattr(arguments, "in_blender", False))):
        return measure_all(arguments, names, console)


def chosen_variants(text: str) -> list[str]:
    """Return the names of the variants that any of the given parts is in, the default first.

    Raises:
        BurnishError: A part is in no name.
    """
    parts = [part.strip() for part in text.split(",") if part.strip()]
    for part in parts:
        if not any(part in name for name in VARIANTS):
            raise BurnishError(f"No variant has '{part}' in its name; there are {', '.join(VARIANTS)}")
    return [name for name in VARIANTS if name == DEFAULT or not parts or any(part in name for part in parts)]


def measure_all(arguments: argparse.Namespace, names: list[str], console: Console) -> int:
    """Measure scene after scene."""
    device = choose_device(arguments.device)
    size = tuple(arguments.size or SIZE)
    facts = {**machine_facts(device), "Picture": f"{size[0]} x {size[1]}"}
    if arguments.time_size:
        facts["Moving frames"] = "{} x {}".format(*arguments.time_size)
    results, failed = [], 0
    for index, path in enumerate(arguments.scenes):
        reference = arguments.reference[index] if arguments.reference else None
        try:
            results.append(measure_scene(arguments, path, reference, size, device, names, console))
        except BurnishError as error:
            console.print(f"{path.stem}: failed: {error}")
            failed += 1
        except KeyboardInterrupt:
            console.print("Interrupted; what was measured is kept")
            break
        if results:
            save(arguments.output, results, facts, console)
    return int(failed > 0 or not results)


def measure_scene(
    arguments: argparse.Namespace, path: Path, reference: Path | None, size: tuple[int, int], device: str,
    names: Sequence[str], console: Console,
) -> dict[str, Any]:
    """Return a scene's rows, one for each variant."""
    from .bench_engines import read_exr

    scene = open_measured(path, size, device)
    try:
        if reference is None:
            truth = scene.truth(scene.camera, size, arguments.truth, TRUTH_SECONDS)
            source = f"the path tracer, {scene.session.samples_done} samples"
        else:
            truth, source = read_exr(reference), f"'{reference.name}'"
        if truth.shape[:2] != size[::-1]:
            raise BurnishError(f"The reference '{reference}' has {truth.shape[1]} x {truth.shape[0]} pixels, "
                               f"not {size[0]} x {size[1]}; give its size by --size")
        bench = SceneAblation(arguments, scene, truth, size)
        end = time.perf_counter() + arguments.scene_seconds
        left_out = []
        for name in names:
            if name != DEFAULT and time.perf_counter() > end:
                left_out.append(name)
                continue
            bench.measure(name)
            console.progress(f"{scene.name}: {name}")
        rows = bench.rows()
        for row in rows:
            console.print(f"{scene.name}: {row_text(row)}")
        if left_out:
            console.print(f"{scene.name}: no time left for {', '.join(left_out)}")
        return {"scene": scene.name, "truth": source, "frames": arguments.frames, "rows": rows, "left_out": left_out}
    finally:
        scene.close()


class SceneAblation:
    """Renders variants of one scene; errors are computed beside the next variant's frames."""

    def __init__(self, arguments: argparse.Namespace, scene: MeasuredScene, truth: np.ndarray, size: tuple[int, int]):
        self.scene, self.truth, self.size = scene, truth, size
        self.frames = arguments.frames
        self.time_size = tuple(arguments.time_size or size)
        self.cameras = scene.flight(size, FLIGHT)
        self.flight_truth = None
        if arguments.flight_truth > 0:
            self.flight_truth = scene.truth(
                self.cameras[MIDDLE], size, arguments.flight_truth, TRUTH_SECONDS)
        # A picture of another shape needs the camera for it.
        self.timed_cameras = [reshaped(camera, self.time_size) for camera in self.cameras]
        self._pool = ThreadPoolExecutor(2)
        self._found: list[tuple[dict[str, Any], dict[str, Future]]] = []

    def measure(self, name: str) -> None:
        """Render one variant's frames: at rest, in flight, and timed."""
        session, settings = self.scene.session, variant_settings(self.scene.settings, name)
        session.configure(settings, self.scene.camera, *self.size)
        session.reset()
        errors, done = {}, 0
        for count in self.frames:
            session.step(count - done)
            done = count
            errors[str(count)] = self._pool.submit(compare, self.truth, session.read("Combined")[..., :3])
        if self.flight_truth is not None:
            session.reset()
            camera = there_and_back(self.cameras)
            for number in range(MIDDLE + 1):
                session.configure(settings, camera(number), *self.size)
                session.step(1)
            errors["flight"] = self._pool.submit(compare, self.flight_truth, session.read("Combined")[..., :3])
        moving = MovingCamera(session, settings, self.timed_cameras, self.time_size)
        for _ in range(settling_frames(session.device)):
            moving.frame()
        in_a_row = moving.in_a_row(TIMED)
        singles = [moving.frame()[1] for _ in range(TIMED)]
        row = {"variant": name, "ms": float(np.median(singles)), "ms_in_a_row": in_a_row}
        self._found.append((row, errors))

    def rows(self) -> list[dict[str, Any]]:
        """Return all rows with their differences to the default, the first."""
        result = []
        for row, errors in self._found:
            row["errors"] = {key: figures(future.result()) for key, future in errors.items()}
            base = result[0] if result else row
            row["ms_difference"] = row["ms"] - base["ms"]
            row["flip_difference"] = {key: each["FLIP"] - base["errors"][key]["FLIP"]
                                      for key, each in row["errors"].items()}
            result.append(row)
        self._pool.shutdown()
        return result


def reshaped(camera: Any, size: tuple[int, int]) -> Any:
    """Return a camera whose window has the shape of a picture [px]; its width and middle stay. Panoramas stay whole."""
    if camera.panoramic:
        return camera
    left, right, bottom, top = camera.window
    half, middle = 0.5 * (right - left) * size[1] / size[0], 0.5 * (bottom + top)
    return dataclasses.replace(camera, window=(left, right, middle - half, middle + half))


def figures(error: ImageError) -> dict[str, float]:
    """Return the figures that are shown."""
    return {label: getattr(error, name) for label, name in FIGURES}


def row_text(row: dict[str, Any]) -> str:
    """Return a row as a line."""
    parts = [f"FLIP {each['FLIP']:.4f} ({row['flip_difference'][key]:+.4f}) at {key}"
             for key, each in row["errors"].items()]
    return f"{row['variant']}: {', '.join(parts)}; {row['ms']:.2f} ms ({row['ms_difference']:+.2f})"


def save(output: Path, results: list[dict[str, Any]], facts: dict[str, str], console: Console) -> None:
    """Write results, table and plot."""
    output.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": facts, "scenes": results}, indent=1, default=float)
    (output / "ablation.json").write_text(text + "\n", encoding="utf-8")
    (output / "ablation.md").write_text(markdown(results, facts), encoding="utf-8")
    try:
        plot(output / "ablation.png", results)
    except BurnishError as error:
        console.print(f"No plot: {error}")
    console.print(f"Results: {output / 'ablation.md'}, ablation.json and ablation.png beside it")


def markdown(results: list[dict[str, Any]], facts: dict[str, str]) -> str:
    """Return the tables of all scenes."""
    lines = ["# Ablation", "", *(f"- {name}: {value}" for name, value in facts.items()), "",
             "FLIP and relMSE against the truth after so many frames at rest, with FLIP's difference to the default; "
             "*dark*: luminance ratio over pixels below 1, *p5* and *p95* of its 16x16 blocks, of the last; ms: median "
             "of frames with a moving camera that are waited for, and of frames in a row."]
    for result in results:
        keys = list(result["rows"][0]["errors"])
        last = keys[-1] if keys[-1] != "flight" else keys[-2]
        columns = [f"FLIP {key} | difference" for key in keys]
        lines += ["", f"## {result['scene']}", "", f"Truth: {result['truth']}.", "",
                  f"| variant | {' | '.join(columns)} | relMSE {last} | dark | p5 | p95 | bad | ms | difference "
                  "| in a row |",
                  "|---" * (2 * len(keys) + 9) + "|"]
        for row in result["rows"]:
            cells = [f"{row['errors'][key]['FLIP']:.4f} | {row['flip_difference'][key]:+.4f}" for key in keys]
            e = row["errors"][last]
            share = 100.0 * row["ms_difference"] / max(result["rows"][0]["ms"], 1e-9)
            lines.append(f"| {row['variant']} | {' | '.join(cells)} | {e['relMSE']:.4f} | {e['dark']:.3f} | "
                         f"{e['p5']:.3f} | {e['p95']:.3f} | {e['bad']} | {row['ms']:.2f} | {row['ms_difference']:+.2f} "
                         f"({share:+.0f} %) | {row['ms_in_a_row']:.2f} |")
        if result["left_out"]:
            lines += ["", f"No time left for: {', '.join(result['left_out'])}."]
    return "\n".join(lines) + "\n"


def plot(path: Path, results: list[dict[str, Any]]) -> None:
    """Draw difference of FLIP after the most frames and of time, by variant; raises BurnishError without matplotlib."""
    rows = max(len(result["rows"]) for result in results)
    figure = new_figure(6.0 * len(results) + 3.0, 0.24 * rows + 1.6)
    axes = figure.subplots(1, 2 * len(results), squeeze=False)
    for index, result in enumerate(results):
        key = str(max(result["frames"]))
        names = [row["variant"] for row in result["rows"]][::-1]
        pairs = (([row["flip_difference"][key] for row in result["rows"]][::-1], f"FLIP after {key} frames"),
                 ([row["ms_difference"] for row in result["rows"]][::-1], "ms, camera moving"))
        for part, (values, label) in enumerate(pairs):
            axis = axes[0][2 * index + part]
            axis.barh(names, values, color=["tab:red" if value > 0 else "tab:green" for value in values])
            axis.axvline(0.0, color="black", linewidth=0.8)
            axis.set_xlabel(f"{label}, difference to the default")
            axis.tick_params(axis="y", labelsize=7, labelleft=part == 0)
            axis.grid(True, axis="x", alpha=0.3)
            axis.margins(y=0.01)
        axes[0][2 * index].set_title(result["scene"], fontsize=10)
    figure.savefig(path)
