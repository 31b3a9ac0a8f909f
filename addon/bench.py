# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `burnish bench`: error and time of Burnish and its rivals on .blend files, against a Cycles truth.

Owns the options and the order of events; scenes are measured in bench_scene.py, tables made in bench_report.py, plots
in bench_plots.py, the report in bench_html.py. Options are parsed without bpy.
"""

from __future__ import annotations

import argparse
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..engine import image_error
from ..engine.errors import BurnishError
from ..engine.read import read_exr
from . import registered
from .bench_modes import add_arguments as add_modes
from .bench_modes import run_mode
from .bench_plan import BUDGETS, CLOCKS
from .bench_progress import Interruption, Progress
from .bench_report import save
from .bench_store import OWN, PEERS
from .cli_output import Console, diverted_output

__all__ = ["add_arguments", "run"]

DEFAULT_SIZE = (640, 360)
INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it"""


def comma_list(kind: Callable[[str], Any], what: str, low: float = 0.0) -> Callable[[str], list[Any]]:
    """Return a converter of comma-separated values above `low`, in ascending order and each once."""

    def convert(text: str) -> list[Any]:
        try:
            values = [kind(part) for part in text.split(",") if part.strip()]
        except ValueError:
            values = []
        if not values or not all(low < value < float("inf") for value in values):
            raise argparse.ArgumentTypeError(f"{what} must be positive numbers with commas between them, not '{text}'")
        return sorted(set(values))

    return convert


def name_list(names: tuple[str, ...], what: str) -> Callable[[str], list[str]]:
    """Return a converter of comma-separated names; an empty text means none."""

    def convert(text: str) -> list[str]:
        chosen = list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
        for name in chosen:
            if name not in names:
                raise argparse.ArgumentTypeError(f"there is no {what} '{name}'; there are {', '.join(names)}")
        return chosen

    return convert


def positive(text: str) -> int:
    """Convert a positive whole number."""
    return comma_list(int, "it")(text)[0]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    parser.add_argument("scenes", nargs="*", type=Path, metavar="SCENE.blend", help="files to render")
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="device of all engines")
    parser.add_argument("--size", nargs=2, type=positive, metavar=("W", "H"),
                        help=f"size in pixels; default: the reference's, else {DEFAULT_SIZE[0]} {DEFAULT_SIZE[1]}")
    default = [engine for engine in OWN if engine != "draft"]
    parser.add_argument("--engines", type=name_list(OWN, "engine"), default=default, metavar="NAME,...",
                        help=f"Burnish's own, of {', '.join(OWN)}; default: {','.join(default)}")
    parser.add_argument("--peers", type=name_list(PEERS, "peer"), default=["cycles", "cycles+oidn"],
                        metavar="NAME,...", help=f"of {', '.join(PEERS)}; '' for none; default: cycles,cycles+oidn")
    parser.add_argument("--budgets", type=comma_list(float, "--budgets"), metavar="SECONDS,...",
                        help="times at which engines are compared; default: "
                             f"{','.join(f'{budget:g}' for budget in BUDGETS)}, none with --samples or --noise")
    parser.add_argument("--clocks", type=name_list(CLOCKS, "clock"), default=list(CLOCKS), metavar="NAME,...",
                        help="warm: the scene is resident; cold: a second F12 with everything in; default: both")
    parser.add_argument("--cold-budgets", type=comma_list(float, "--cold-budgets"), metavar="SECONDS,...",
                        help="budgets of the cold clock; default: those of --budgets")
    parser.add_argument("--repetitions", type=positive, default=3, metavar="N",
                        help="runs of which the median time is taken; above 0.5 s one run; default: 3")
    parser.add_argument("--samples", type=comma_list(int, "--samples"), default=[], metavar="N,...",
                        help="also render fixed numbers of samples per pixel, or of frames, by F12")
    parser.add_argument("--truth", type=positive, default=4096, metavar="N",
                        help="samples per pixel of the truth, rendered in two independent halves; default: 4096")
    parser.add_argument("--reference", type=Path, action="append", default=[], metavar="FILE.exr",
                        help="take this picture as truth; once for each scene, in their order; with FILE_a.exr and "
                             "FILE_b.exr beside it, its two halves, its noise is known")
    parser.add_argument("--noise", action="store_true",
                        help="also render Burnish's reference at N, 4N and 16N samples with two seeds and show how "
                             "noise falls")
    parser.add_argument("--output", "-o", type=Path, default=Path("out/bench"), metavar="DIR",
                        help="folder of pictures and results, and of what an interrupted run goes on from; "
                             "default: out/bench")
    parser.add_argument("--no-strips", dest="strips", action="store_false",
                        help="save no picture of each render beside the truth")
    add_modes(parser)
    parser.add_argument("--show-all", action="store_true", help="show all that Blender and its engines print")


def check(arguments: argparse.Namespace) -> None:
    """Fill in what depends on other options; raises BurnishError for what can't work, before bpy is loaded."""
    if not arguments.scenes:
        raise BurnishError("No scene is named; give one .blend file or more")
    if arguments.reference and len(arguments.reference) != len(arguments.scenes):
        raise BurnishError(f"There are {len(arguments.scenes)} scenes but {len(arguments.reference)} references; "
                           "give --reference once for each scene")
    for path in [*arguments.scenes, *arguments.reference]:
        if not path.is_file():
            raise BurnishError(f"The file '{path}' does not exist")
    if arguments.budgets is None:
        arguments.budgets = [] if arguments.samples or arguments.noise else list(BUDGETS)
    if arguments.cold_budgets is None:
        arguments.cold_budgets = list(arguments.budgets)
    one = np.zeros((8, 8, 3), np.float32)
    image_error.flip(one, one)  # Missing, it should be missed before hours of rendering.
    from .bench_plots import find_matplotlib

    find_matplotlib()


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark and return the exit status: 1 if a scene could not be measured, 130 when interrupted."""
    other = run_mode(arguments)
    if other is not None:
        return other
    check(arguments)
    with (diverted_output(show_all=arguments.show_all) as console,
          registered(getattr(arguments, "in_blender", False))):
        return measure_all(arguments, console)


def measure_all(arguments: argparse.Namespace, console: Console) -> int:
    """Measure every scene, writing the results after each; the report at the end."""
    from .bench_html import save_report
    from .bench_scene import SceneBench

    device, machine = describe(arguments)
    options = {name: plain(value) for name, value in vars(arguments).items() if not callable(value)}
    progress, results, interrupted = Progress(console), [], False
    with Interruption(console) as interruption:
        benches = []
        for index, scene in enumerate(arguments.scenes):
            reference = arguments.reference[index] if arguments.reference else None
            size = size_for(arguments, reference)
            benches.append(SceneBench(arguments, scene, reference, size, device, console, progress, interruption))
        for bench in benches:
            try:
                interruption.check()
                bench.measure()
            except KeyboardInterrupt:
                interrupted = True
            if interrupted and not bench.result.rows and not bench.result.failure:
                bench.result.failure = "The run was interrupted before this scene"
            results.append(bench.result)
            save(arguments.output, results, machine, options)
    save_report(arguments.output, results, machine, options)
    console.print(f"Results: {arguments.output / 'report.html'}, results.md and results.json beside it")
    return INTERRUPTED if interrupted else int(any(result.failure for result in results))


def plain(value: Any) -> Any:
    """Return an option's value as JSON can have it."""
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def describe(arguments: argparse.Namespace) -> tuple[str, dict[str, str]]:
    """Return the device that the options choose and what the report says of the machine."""
    import os

    import bpy

    from ..engine.device import choose_device, device_info
    from .manifest import package_version

    device = choose_device(arguments.device)
    info = device_info(device)
    machine = {"Burnish": package_version(), "Blender": bpy.app.version_string, "Warp": info.warp_version,
               "Python": platform.python_version(), "Device": f"{info.name} ({device})",
               "Processor": f"{platform.processor() or platform.machine()}, {os.cpu_count()} threads",
               "System": platform.platform()}
    if info.cuda:
        machine["Driver"] = str(info.driver)
    return device, machine


def size_for(arguments: argparse.Namespace, reference: Path | None) -> tuple[int, int]:
    """Return the size asked for, else the reference's, else the default."""
    if arguments.size:
        return arguments.size[0], arguments.size[1]
    if reference is not None:
        try:
            height, width, _ = read_exr(reference).shape
        except BurnishError:
            return DEFAULT_SIZE  # The scene itself will say what is wrong with it.
        return width, height
    return DEFAULT_SIZE


