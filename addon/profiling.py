# SPDX-License-Identifier: GPL-3.0-or-later
"""`burnish bench SCENE --profile`: where a real-time frame's time goes, pass by pass, beside the device's floor.

Owns the options, the tables and the plot; the figures come from engine/frame_profile.py.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from ..engine.device import choose_device
from ..engine.errors import BurnishError
from ..engine.frame_profile import FrameProfile, PassProfile, profile_frame
from ..engine.measure_moving import measure_frames
from . import registered
from .bench_plots import new_figure
from .cli_output import Console, diverted_output
from .measured_scene import open_measured
from .scaling import machine_facts

__all__ = ["run"]

SIZES = {True: (1920, 1080), False: (480, 270)}
FRAMES = {True: 60, False: 6}
FLIGHT = 60
KERNELS = 20
"""Dearest kernels in the table"""

LEGEND = """\
ms: each launch between two events, so that the sum exceeds the frame by the gaps. Floor: each byte of the pass's
buffers touched once at the device's measured copy rate, and its rays at the rate of thin traversal kernels (rays of
the probes are traced by the cache). An estimate to aim at: caches can be faster, and most passes touch buffers
repeatedly."""


def run(arguments: argparse.Namespace) -> int:
    """Profile all scenes; write profile.json, profile.md and a plot for each scene. 1 if one failed."""
    if not arguments.scenes:
        raise BurnishError("--profile needs a scene; name one .blend file or more")
    device = choose_device(arguments.device)
    size = tuple(arguments.size or SIZES[device != "cpu"])
    facts = {**machine_facts(device), "Picture": f"{size[0]} x {size[1]}"}
    with (diverted_output(show_all=getattr(arguments, "show_all", False)) as console,
          registered(getattr(arguments, "in_blender", False))):
        found: dict[str, FrameProfile] = {}
        failed = 0
        for path in arguments.scenes:
            try:
                found[path.stem] = profile_scene(path, size, device)
            except BurnishError as error:
                console.print(f"{path.stem}: failed: {error}")
                failed += 1
                continue
            console.print(summary(path.stem, found[path.stem]))
            save(arguments.output, found, facts, console)
        return int(failed > 0)


def profile_scene(path: Path, size: tuple[int, int], device: str) -> FrameProfile:
    """Return the profile of a scene's frames with a moving camera."""
    scene = open_measured(path, size, device)
    try:
        cameras = scene.flight(size, FLIGHT)
        times = measure_frames(scene.session, scene.settings, cameras, size, frames=FRAMES[device != "cpu"])
        return profile_frame(scene.session, times)
    finally:
        scene.close()


def summary(name: str, profile: FrameProfile) -> str:
    """Return a profile as a line."""
    times, floor = profile.times, sum(each.floor for each in profile.passes)
    return (f"{name}: {times.frame:.2f} ms a frame, {times.in_a_row:.2f} ms in a row, {profile.at_rest:.2f} ms at rest"
            f", Python {times.python:.3f} ms, {sum(profile.launches.values())} launches; floor {floor:.2f} ms; "
            f"{profile.triangles:,} triangles")


def save(output: Path, found: dict[str, FrameProfile], facts: dict[str, str], console: Console) -> None:
    """Write results, tables and plots."""
    output.mkdir(parents=True, exist_ok=True)
    scenes = {name: profile.as_dict() for name, profile in found.items()}
    text = json.dumps({"machine": facts, "scenes": scenes}, indent=1, default=float)
    (output / "profile.json").write_text(text + "\n", encoding="utf-8")
    lines = ["# Profile of a frame", "", *(f"- {name}: {value}" for name, value in facts.items()), "", LEGEND]
    for name, profile in found.items():
        lines += ["", f"## {name}", "", summary(name, profile).partition(": ")[2] + ".", "", *tables(profile)]
    (output / "profile.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    try:
        for name, profile in found.items():
            plot(output / f"profile_{name}.png", name, profile)
    except BurnishError as error:
        console.print(f"No plot: {error}")
    console.print(f"Results: {output / 'profile.md'} and profile.json beside it")


def tables(profile: FrameProfile) -> list[str]:
    """Return the lines of a profile's tables: passes, sections, kernels, counts, what was left out."""
    passes = profile.passes
    total = sum(each.milliseconds for each in passes)
    floor = sum(each.floor for each in passes)
    lines = [f"Copy rate {profile.copy_rate / 1e9:,.0f} GB/s (bytes read and written).", "",
             "| pass | ms | share | launches | buffers MB | rays | floor: bytes | floor: rays | times the floor |",
             "|---|---|---|---|---|---|---|---|---|"]
    lines += [pass_row(each, total) for each in passes]
    size, rays = sum(each.buffer_bytes for each in passes), sum(each.rays for each in passes)
    lines += [f"| sum | {total:.2f} | 100 % | {sum(each.launches for each in passes)} | {size / 1e6:,.0f} | {rays:,} "
              f"| {sum(each.floor_bytes for each in passes):.2f} "
              f"| {sum(each.floor_rays or 0.0 for each in passes):.2f} | {total / max(floor, 1e-9):.1f} |", "",
              "| section | ms |", "|---|---|"]
    lines += [f"| {section} | {value:.3f} |" for section, value in profile.times.sections.items()]
    lines += ["", "| kernel | ms | launches |", "|---|---|---|"]
    dearest = sorted(profile.times.kernels.items(), key=lambda item: -item[1])
    lines += [f"| `{name}` | {value:.3f} | {profile.launches.get(name, 0)} |" for name, value in dearest[:KERNELS]]
    rest = sum(value for _, value in dearest[KERNELS:])
    lines += [f"| the other {len(dearest) - KERNELS} | {rest:.3f} | |"] if rest > 0.0 else []
    lines += ["", "| counted | number |", "|---|---|"]
    lines += [f"| {name} | {value:,} |" for name, value in profile.times.counts.items()]
    lines += ["", "Left out: " + "; ".join(f"{name} ({reason})" for name, reason in profile.skipped.items()) + "."]
    return lines


def pass_row(each: PassProfile, total: float) -> str:
    """Return a pass as a line of its table."""
    rays = "-" if each.floor_rays is None else f"{each.floor_rays:.3f}"
    return (f"| {each.name} | {each.milliseconds:.3f} | {100.0 * each.milliseconds / max(total, 1e-9):.0f} % | "
            f"{each.launches} | {each.buffer_bytes / 1e6:,.1f} | {each.rays:,} | {each.floor_bytes:.3f} | {rays} | "
            f"{each.milliseconds / max(each.floor, 1e-9):.1f} |")


def plot(path: Path, name: str, profile: FrameProfile) -> None:
    """Draw each pass's time beside its floor; raises BurnishError without matplotlib."""
    passes: list[PassProfile] = sorted(profile.passes, key=lambda each: each.milliseconds)
    places = list(range(len(passes)))
    figure = new_figure(8.5, 0.45 * len(passes) + 1.6)
    axis = figure.subplots()
    axis.barh([place + 0.2 for place in places], [each.milliseconds for each in passes], 0.38, label="measured",
              color="tab:blue")
    lower: Any = [each.floor_bytes for each in passes]
    axis.barh([place - 0.2 for place in places], lower, 0.38, label="floor: bytes", color="tab:gray")
    axis.barh([place - 0.2 for place in places], [each.floor_rays or 0.0 for each in passes], 0.38, left=lower,
              label="floor: rays", color="tab:orange")
    axis.set_yticks(places, [each.name for each in passes])
    axis.set_xlabel("ms")
    axis.grid(True, axis="x", alpha=0.3)
    axis.legend()
    axis.set_title(f"{name}, {profile.device}: {profile.times.frame:.2f} ms a frame", fontsize=10)
    figure.savefig(path)
