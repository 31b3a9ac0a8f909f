# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the figures of Eto et al. 2023 from this engine, with the paper's recipe and with ours, and write their page.

    python tests/performance/figures.py [SCENE.blend...] [--device cpu] [--size 640 360] [--timing-size 1920 1080]
        [--truth 1024] [--only 2,7,curves,scenes,timing] [--output out/figures] [--page docs/figures.md]

Run by hand, as `make figures`. Figures 2 to 10 are of scenes made in code; Figures 1, 11, 12 and Table 1 of the scenes
given (without any, of a room made in code). Pictures go to the output folder; the page tells how to make them.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import os
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.device import choose_device  # noqa: E402
from burnish.engine.measure_moving import FrameTimes, fly_over, measure_frames  # noqa: E402
from burnish.engine.presets import apply_preset  # noqa: E402
from burnish.engine.scene import CameraData, SceneDelta  # noqa: E402
from burnish.engine.settings import Device, Preset, ReflectionResolution, RenderSettings  # noqa: E402
from burnish.engine.variants import VARIANTS  # noqa: E402

from tests import glossy_scenes  # noqa: E402
from tests.performance.figure_list import (  # noqa: E402
    FIGURES,
    OUTSIDE,
    PAPER_TABLE,
    Figure,
    table_row,
)
from tests.performance.measured_session import (  # noqa: E402
    Measured,
    attempt,
    compare,
    positions_of,
    settings_for,
    truth_of,
)
from tests.performance.settings_text import FILTERED, Groups, merged, parse_settings  # noqa: E402
from tests.performance.sheets import Table, error_map, save_sheet, tone  # noqa: E402

RECIPES = {"paper": Preset.PAPER, "ours": Preset.BALANCED}
WHOLE, WITHOUT = "whole frame, wall time", "the same without traced reflections"
UNTRACED: Groups = parse_settings([f"{name}={value}" for name, value in VARIANTS["no traced reflections"].items()])
"""Reflections of all roughnesses from probes"""
COLUMNS = ("recipe", "picture", "ms", "lum", "dark", "FLIP", "relMSE")
HEAD = """\
# The paper's figures

Figures and Table 1 of Eto, Meunier, Harada, Boissé, *Real-time rendering of glossy reflections using ray tracing and
two-level radiance caching* (SIGGRAPH Asia 2023 Technical Communications), from this engine. `make figures` draws them
to `out/figures` and writes this page; `make figures SCENES="A.blend B.blend"` adds those that need scenes.

Frames alone are shown: the path-traced samples that join them at rest, from the eighth frame on, are switched off.
*paper* is the preset Paper: the paper's constants, and what it does not mend left unmended. *ours* is the preset
Balanced. lum: ratio of mean luminances to Reference's; dark: the same below 1; FLIP of sRGB pictures; relMSE: squared
error over the squared truth + 0.01. ms: of a whole frame at this size.
"""


@dataclasses.dataclass
class Subject:
    """A scene to draw."""

    name: str
    delta: SceneDelta
    camera: Callable[[tuple[int, int]], CameraData]
    exposure: float = 0.0


class Page:
    """The page: sections that are drawn replace those of the same title, the others stay."""

    def __init__(self, options: argparse.Namespace):
        self.options = options
        text = options.page.read_text("utf-8") if options.page.exists() else ""
        self.sections = {part.split("\n", 1)[0]: part for part in text.split("\n## ")[1:]}

    def add(self, title: str, caption: str, pictures: Sequence[str] = (), table: Table | None = None) -> None:
        """Add a section and save the page."""
        o = self.options
        folder = Path(os.path.relpath(o.output, o.page.parent)).as_posix()
        parts = [f"{title}\n", *(f"![{name}]({folder}/{name})\n" for name in pictures), textwrap.fill(caption, 120)]
        if table is not None:
            parts.append("\n" + table.markdown().rstrip())
        self.sections[title] = "\n".join(parts) + "\n"
        ordered = sorted(self.sections, key=lambda name: [int(n) for n in re.findall(r"\d+", name)][:1])
        o.page.parent.mkdir(parents=True, exist_ok=True)
        o.page.write_text("\n## ".join([HEAD, *(self.sections[name] for name in ordered)]), encoding="utf-8")


def recipe_settings(recipe: str, options: argparse.Namespace, groups: Groups | None = None) -> RenderSettings:
    """Return the settings of a recipe with single fields changed; at rest the filtered picture stays.

    Figures are small, and show as many rays a pixel as large pictures have.
    """
    settings = apply_preset(settings_for("realtime", options.device), RECIPES[recipe])
    plain = {"probes": {"dense_small": False}, "denoiser": {"supersample_small": False}}
    for name, fields in merged(FILTERED, plain, groups).items():
        values = {key: ReflectionResolution(value) if key == "resolution" else value for key, value in fields.items()}
        settings = dataclasses.replace(settings, **{name: dataclasses.replace(getattr(settings, name), **values)})
    return settings


def cropped(picture: np.ndarray, part: tuple[float, float, float, float] | None) -> np.ndarray:
    """Return a part of a picture given by shares, enlarged to about the whole's width."""
    if part is None:
        return picture
    height, width = picture.shape[:2]
    x, y, w, h = (int(share * side) for share, side in zip(part, (width, height, width, height), strict=True))
    grow = max(1, round(width / w))
    return np.repeat(np.repeat(picture[y:y + h, x:x + w], grow, 0), grow, 1)


def draw(figure: Figure, options: argparse.Namespace, page: Page) -> None:
    """Draw one figure: a row of pictures for each recipe, and one of their errors."""
    size = tuple(options.size)
    scene = figure.scene(size)
    file = options.output / "truth" / f"{figure.number}_{size[0]}x{size[1]}_{options.truth}.npy"
    truth = truth_of(scene.delta, scene.camera, size, options.device, options.truth, file, options.truth_seconds)
    table, rows = Table(COLUMNS), []
    for recipe in RECIPES:
        row = [(cropped(tone(truth), figure.crop), f"Figure {figure.number}: Reference")]
        errors = [(cropped(tone(truth), figure.crop), "Reference")]
        for label, groups in figure.variants.items():
            measured = Measured(recipe_settings(recipe, options, merged(figure.shared, groups)))
            measured.load(scene.delta)
            measured.look(scene.camera, size)
            measured.frames(figure.frames - figure.frames // 2)
            seconds = measured.frames(figure.frames // 2)
            picture = measured.picture()
            measured.close()
            error = compare(truth, picture)
            table.add(recipe, label, seconds / (figure.frames // 2) * 1e3, error.luminance, error.dark_luminance,
                      error.flip, error.relative_mse)
            row.append((cropped(tone(picture), figure.crop), f"{recipe}: {label}, FLIP {error.flip:.3f}"))
            errors.append((cropped(error_map(truth, picture), figure.crop), "error x4"))
        rows += [row, errors]
    name = f"figure_{figure.number}.png"
    save_sheet(options.output / name, rows)
    caption = f"{figure.caption} After {figure.frames} frames at {size[0]} x {size[1]}, {options.device}."
    page.add(f"Figure {figure.number}. {figure.title}", caption, [name], table)


def curves(options: argparse.Namespace, page: Page) -> None:
    """Draw Figure 6: the spline kernel of the a-trous transform and the Gaussian in its place."""
    plot = importlib.import_module("matplotlib.figure")
    figure = plot.Figure(figsize=(6.4, 3.2), dpi=100)
    axes = figure.add_subplot()
    x = np.linspace(-3.0, 3.0, 601)
    a = np.abs(x)
    spline = np.where(a < 1, (4 - 6 * a**2 + 3 * a**3) / 6, np.where(a < 2, (2 - a) ** 3 / 6, 0.0))
    deviations = {}
    for sigma, style in ((1.065, "-"), (np.sqrt(1.0 / 3.0), "--")):
        gauss = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
        deviations[sigma] = float(np.abs(gauss - spline).max())
        axes.plot(x, gauss, style, label=f"Gaussian, sigma {sigma:.3f}")
    axes.plot(x, spline, label="cubic B-spline")
    taps = np.array((1, 4, 6, 4, 1)) / 16
    axes.plot(range(-2, 3), taps, "o", label="1 4 6 4 1 / 16")
    axes.legend()
    options.output.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.output / "figure_6.png")
    discrete = np.exp(-0.5 * (np.arange(-2, 3) / 1.065) ** 2)
    far = float(np.abs(discrete / discrete.sum() - taps).max())
    page.add(
        "Figure 6. Kernel of the filter's passes", "The paper fits a Gaussian of sigma 1.065 to the taps 1 4 6 4 1 "
        f"of the a-trous transform: at whole pixels they differ by at most {far:.4f}. The continuous B-spline is "
        f"narrower (its own sigma is 0.577; a Gaussian of that differs by {deviations[np.sqrt(1.0 / 3.0)]:.3f}).",
        ["figure_6.png"])


def subjects(options: argparse.Namespace) -> Iterator[Subject]:
    """Yield the scenes given, one open at a time; a room made in code where there are none."""
    for path in options.scenes:
        blend_scene = importlib.import_module("tests.performance.blend_scene")
        scene = blend_scene.BlendScene(path, tuple(options.size), options.device, matte=False)
        yield Subject(scene.name, scene.extract(), scene.camera_for, scene.exposure)
    if not options.scenes:
        made = glossy_scenes.rough_metal
        yield Subject(made.__name__, made(options.size).delta, lambda size: made(size).camera)


def draw_scene(subject: Subject, options: argparse.Namespace, table: Table) -> str:
    """Draw a scene for Figures 1, 11 and 12, with both recipes after 1 and 64 frames; returns its file's name."""
    size = tuple(options.size)
    camera = subject.camera(size)
    file = options.output / "truth" / f"{subject.name}_{size[0]}x{size[1]}_{options.truth}.npy"
    truth = truth_of(subject.delta, camera, size, options.device, options.truth, file, options.truth_seconds)
    rows = []
    for recipe in RECIPES:
        row = [(tone(truth, subject.exposure), f"{subject.name}: path traced, {options.truth} spp")]
        measured = Measured(recipe_settings(recipe, options))
        measured.load(subject.delta)
        measured.look(camera, size)
        done = 0
        for count in (1, 64):
            seconds = measured.frames(count - done)
            picture = measured.picture()
            error = compare(truth, picture)
            table.add(subject.name, recipe, f"{count} frames", seconds / (count - done) * 1e3, error.luminance,
                      error.dark_luminance, error.flip, error.relative_mse)
            row.append((tone(picture, subject.exposure), f"{recipe}, frame {count}: FLIP {error.flip:.3f}"))
            done = count
        row.append((error_map(truth, picture, exposure=subject.exposure), "error x4"))
        measured.close()
        rows.append(row)
    name = f"figure_11_{subject.name}.png"
    save_sheet(options.output / name, rows, shrink=2 if size[0] >= 640 else 1)
    return name


def time_scene(subject: Subject, options: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Return milliseconds by row of Table 1 for each recipe, of a moving camera."""
    size, small = tuple(options.timing_size), (160, 90)
    reference = Measured(settings_for("reference", options.device))
    reference.load(subject.delta)
    places = positions_of(reference, subject.camera(small), small)
    reference.close()
    cameras = fly_over(subject.camera(size), places, 60)

    def frame_times(recipe: str, groups: Groups | None = None) -> FrameTimes:
        measured = Measured(recipe_settings(recipe, options, groups))
        measured.load(subject.delta)
        try:
            return measure_frames(measured.session, measured.settings, cameras, size, frames=options.timing_frames)
        finally:
            measured.close()

    found: dict[str, dict[str, float]] = {}
    for recipe in RECIPES:
        times = frame_times(recipe)
        rows = dict.fromkeys((*list(PAPER_TABLE)[:-1], "total", OUTSIDE, WHOLE, WITHOUT), 0.0)
        rows[WHOLE] = times.in_a_row
        rows[WITHOUT] = frame_times(recipe, UNTRACED).in_a_row
        for section, milliseconds in times.sections.items():
            rows[table_row(section)] += milliseconds
        rows["total"] = sum(rows[name] for name in list(PAPER_TABLE)[:-1])
        found[recipe] = rows
    return found


def scene_pages(options: argparse.Namespace, page: Page, pictures: bool, timing: bool) -> None:
    """Add Figures 1, 11 and 12 and Table 1."""
    table, names, times = Table(("scene", *COLUMNS)), [], {}
    for subject in subjects(options):
        if pictures:
            names.append(draw_scene(subject, options, table))
        if timing:
            times[subject.name] = time_scene(subject, options)
    if names:
        page.add("Figures 1, 11 and 12. Scenes, against path tracing", "The paper's Figure 12 is darker than its path "
                 "tracer: its cache holds one bounce. Both recipes in the first frame and after 64 frames at rest.",
                 names, table)
    if times:
        columns = [f"{scene}, {recipe}" for scene in times for recipe in RECIPES]
        result = Table(("ms", *(f"paper's 11 {letter}" for letter in "abcd"), *columns))
        for row in next(iter(times.values()))["ours"]:
            result.add(row, *PAPER_TABLE.get(row, ("",) * 4),
                       *(round(times[scene][recipe][row], 3) for scene in times for recipe in RECIPES))
        size = options.timing_size
        page.add("Table 1. Time by part", f"Milliseconds at {size[0]} x {size[1]} with a moving camera on "
                 f"{device_name(options)}; the paper's on an RX 7900 XTX, which traces rays in hardware, with other "
                 "cameras. Its total leaves out visible surfaces, direct light of lamps and anti-aliasing. Rays of "
                 "reflections are lit through the cache, whose time is in GI-1.0's.", table=result)


def device_name(options: argparse.Namespace) -> str:
    """Return the name of the device."""
    measured = Measured(settings_for("reference", options.device))
    name = measured.session.device_name
    measured.close()
    return name


def main() -> int:
    """Draw all figures; one that fails is told and skipped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--device", default="", choices=("cpu", "cuda"), help="cuda where there is such a device")
    parser.add_argument("--size", type=int, nargs=2)
    parser.add_argument("--timing-size", type=int, nargs=2)
    parser.add_argument("--timing-frames", type=int)
    parser.add_argument("--truth", type=int)
    parser.add_argument("--truth-seconds", type=float, default=60.0)
    parser.add_argument("--only", default="", help="numbers of figures, curves, scenes, timing; commas between them")
    parser.add_argument("--output", type=Path, default=Path("out/figures"))
    parser.add_argument("--page", type=Path, default=Path("docs/figures.md"))
    options = parser.parse_args()
    cuda = "cuda" in (options.device or choose_device(Device.AUTO))
    options.device = "cuda" if cuda else "cpu"
    options.size = options.size or ((640, 360) if cuda else (192, 108))
    options.timing_size = options.timing_size or ((1920, 1080) if cuda else (320, 180))
    options.timing_frames = options.timing_frames or (100 if cuda else 8)
    options.truth = options.truth or (2048 if cuda else 128)
    wanted = {name for name in options.only.split(",") if name}
    page = Page(options)
    jobs: dict[str, Callable[[], None]] = {
        figure.number: lambda figure=figure: draw(figure, options, page) for figure in FIGURES}
    jobs["curves"] = lambda: curves(options, page)
    pictures, timing = (not wanted or name in wanted for name in ("scenes", "timing"))
    if pictures or timing:
        jobs["scenes"] = jobs["timing"] = lambda: scene_pages(options, page, pictures, timing)
        jobs.pop("timing" if pictures else "scenes")
    failed = 0
    for name, job in jobs.items():
        if wanted and name not in wanted:
            continue
        failed += attempt(name, job)
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
