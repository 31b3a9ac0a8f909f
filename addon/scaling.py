# SPDX-License-Identifier: GPL-3.0-or-later
"""`burnish bench --scaling`: cost of a frame against triangles, lamps, instances, materials, textures, pixels, gloss.

Owns the options, the table and the plots; what is measured and fitted is in engine/scaling.py. Needs no Blender.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from pathlib import Path

from ..engine.device import choose_device, device_info
from ..engine.errors import BurnishError
from ..engine.scaling import SWEEPS, SweepResult, run_sweep
from ..engine.session import Session
from ..engine.settings import Device, Integrator, RenderSettings, SamplingSettings
from .bench_plots import new_figure
from .cli_output import Console, diverted_output

__all__ = ["machine_facts", "run"]

SIZES = {True: (1920, 1080), False: (160, 90)}
"""Picture on CUDA and on the processor [px]"""
TOP_SECTIONS = 5
"""Drawn besides the whole frame"""


def run(arguments: argparse.Namespace) -> int:
    """Measure, and write scaling.json, scaling.md and scaling.png to the output folder."""
    chosen = [name.strip() for name in arguments.scaling.split(",") if name.strip()]
    for name in chosen:
        if name not in SWEEPS:
            raise BurnishError(f"There is no sweep '{name}'; there are {', '.join(SWEEPS)}")
    with diverted_output(show_all=getattr(arguments, "show_all", False)) as console:
        return measure(arguments, chosen, console)


def measure(arguments: argparse.Namespace, chosen: list[str], console: Console) -> int:
    """Run the chosen sweeps within the time; what the first leave over the later ones have."""
    device = choose_device(arguments.device)
    cuda = device != "cpu"
    size = tuple(arguments.size or SIZES[cuda])
    seconds = arguments.budget_seconds
    settings = RenderSettings(device=Device.CUDA if cuda else Device.CPU,
                              sampling=SamplingSettings(integrator=Integrator.REALTIME))
    session = Session(settings)
    end = time.perf_counter() + seconds
    results: list[SweepResult] = []
    output: Path = arguments.output
    output.mkdir(parents=True, exist_ok=True)
    facts = {**machine_facts(device), "Picture": f"{size[0]} x {size[1]}"}
    try:
        for index, name in enumerate(chosen):
            sweep = SWEEPS[name]
            weights = [SWEEPS[each].weight for each in chosen[index:]]
            share = (end - time.perf_counter()) * weights[0] / sum(weights)
            results.append(run_sweep(
                sweep, settings, session, sweep.values if cuda else sweep.small, size, share, console.print))
            save(output, results, facts)
    except KeyboardInterrupt:
        console.print("Interrupted; what was measured is kept")
    finally:
        session.close()
    save(output, results, facts)
    try:
        plot(output / "scaling.png", results, facts)
    except BurnishError as error:
        console.print(f"No plot: {error}")
    for result in results:
        if result.goal:
            console.print(result.goal)
    console.print(f"Results: {output / 'scaling.md'}, scaling.json and scaling.png beside it")
    return 0 if any(result.points for result in results) else 1


def machine_facts(device: str) -> dict[str, str]:
    """Return what the results say of the machine."""
    info = device_info(device)
    return {"Device": f"{info.name} ({device})", "Warp": info.warp_version, "System": platform.platform(),
            "Python": platform.python_version()}


def save(output: Path, results: list[SweepResult], facts: dict[str, str]) -> None:
    """Write scaling.json and scaling.md."""
    (output / "scaling.json").write_text(
        json.dumps({"machine": facts, "sweeps": [each.as_dict() for each in results]}, indent=1, default=float) + "\n",
        encoding="utf-8")
    (output / "scaling.md").write_text(markdown(results, facts), encoding="utf-8")


def markdown(results: list[SweepResult], facts: dict[str, str]) -> str:
    """Return the tables: fits first, then all points."""
    lines = ["# Scaling", "", *(f"- {name}: {value}" for name, value in facts.items()), "",
             "Milliseconds are medians of frames that are waited for, camera moving; the exponent is that of a power "
             "law fitted to all points, with its standard error.", "",
             "| against | from | to | ms | factor | exponent | ms a doubling | R² against the logarithm "
             "| build exponent | goal |", "|---|---|---|---|---|---|---|---|---|---|"]
    for each in results:
        if each.fit is None:
            lines.append(f"| {each.label} | - | - | - | - | - | - | - | - | too few points |")
            continue
        first, last, fit = each.points[0], each.points[-1], each.fit
        exponent = "-" if fit.exponent is None else f"{fit.exponent:.3f} ± {fit.exponent_error:.3f}"
        logarithm = ("-", "-") if fit.log_slope is None else (f"{fit.log_slope:.3g}", f"{fit.log_share:.2f}")
        build = "-" if each.build_exponent is None else f"{each.build_exponent:.2f}"
        lines.append(f"| {each.label} | {first['value']:g} | {last['value']:g} | {first['frame']:.3g} to "
                     f"{last['frame']:.3g} | {fit.ratio:.2f} | {exponent} | {logarithm[0]} | {logarithm[1]} "
                     f"| {build} | {each.goal or '-'} |")
    for each in results:
        lines += ["", f"## {each.label[:1].upper()}{each.label[1:]}", "",
                  "| value | ms a frame | 95th percentile | ms in a row | build s | structures s "
                  "| dearest sections [ms] |", "|---|---|---|---|---|---|---|"]
        for point in each.points:
            dearest = sorted(point["sections"].items(), key=lambda item: -item[1])[:TOP_SECTIONS]
            sections = ", ".join(f"{name} {value:.2f}" for name, value in dearest)
            lines.append(f"| {point['value']:g} | {point['frame']:.3g} | {point['slowest']:.3g} | "
                         f"{point['in_a_row']:.3g} | {point['build_seconds']:.3g} | "
                         f"{point['build_stages'].get('structures', 0.0):.3g} | {sections} |")
        lines += [f"\nLeft out: {value} ({reason})" for value, reason in each.left_out.items()]
        steep = {name: value for name, value in each.section_fits.items() if value is not None and value > 0.05}
        if steep and each.name != "resolution":
            parts = ", ".join(f"{name} {value:.2f}" for name, value in sorted(steep.items(), key=lambda i: -i[1]))
            lines += ["", f"Exponents of sections that grow: {parts}"]
    return "\n".join(lines) + "\n"


def plot(path: Path, results: list[SweepResult], facts: dict[str, str]) -> None:
    """Draw each sweep: the frame and its dearest sections, with the fit; raises BurnishError without matplotlib."""
    drawn = [each for each in results if len(each.points) > 1]
    if not drawn:
        raise BurnishError("no sweep has two points")
    columns = min(len(drawn), 4)
    rows = -(-len(drawn) // columns)
    figure = new_figure(4.6 * columns, 3.6 * rows)
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat[len(drawn):]:
        axis.set_axis_off()
    for axis, each in zip(axes.flat, drawn, strict=False):
        x = [point["value"] for point in each.points]
        power = each.fit is not None and each.fit.exponent is not None
        label = f"frame, power {each.fit.exponent:.2f}" if power else "frame"
        axis.plot(x, [point["frame"] for point in each.points], "o-", color="black", linewidth=2, label=label)
        largest = sorted({name for point in each.points for name in point["sections"]},
                         key=lambda name: -each.points[-1]["sections"].get(name, 0.0))[:TOP_SECTIONS]
        for name in largest:
            axis.plot(x, [point["sections"].get(name, float("nan")) for point in each.points], ".-", linewidth=1,
                      label=name)
        axis.set_xscale("log" if min(x) > 0 else "linear")
        axis.set_yscale("log")
        axis.set_xlabel(each.label)
        axis.set_ylabel("ms")
        axis.grid(True, which="both", alpha=0.2)
        axis.legend(fontsize=7, framealpha=0.6)
    figure.suptitle(", ".join(f"{value}" for name, value in facts.items() if name in ("Device", "Picture")))
    figure.savefig(path)
