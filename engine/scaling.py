# SPDX-License-Identifier: GPL-3.0-or-later
"""How the cost of a frame grows with the scene: which quantities are swept, what is fitted, what the goals are.

Time is fitted as a power of the quantity by least squares of the logarithms, and for triangles against the logarithm
of their number too. Measures with engine/measure_moving.py on engine/generated_scenes.py; writes nothing.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from .errors import BurnishError
from .generated_scenes import SceneRecipe, generate_scene, scene_flight
from .measure_moving import measure_frames
from .session import Session
from .settings import RenderSettings

__all__ = ["SWEEPS", "Fit", "Sweep", "SweepResult", "fit_growth", "goal_of", "run_sweep"]

FLIGHT = 60
"""Frames of the camera's flight"""
MIB = 1 << 20
FRAMES = {True: 40, False: 8}
"""Most frames timed at each point, on CUDA and elsewhere"""
LEAST_SECONDS = {True: 1.0, False: 3.0}
"""A point of a sweep is not begun with less time left, on CUDA and elsewhere"""
SPARED = 0.8
"""Share of a point's time that its frames may use up: larger scenes take longer"""
MEMORY_SHARE = 0.6
"""Of the free memory that a scene may be expected to take"""

FLAT_EXPONENT = 0.05
"""Time counts as flat up to this power"""
FLAT_FROM = 10
"""Lamps from which on flatness is judged: fewer lamps than candidates for each pixel are cheaper"""
LEAST_RANGE = 100
"""Factor between the most and the fewest below which growth is not judged"""
LOG_SLACK = 1.15
"""Time may grow by this factor more than the logarithm of the number of triangles"""


@dataclass(frozen=True)
class Sweep:
    """One quantity and its values."""

    name: str
    label: str
    values: tuple[float, ...]
    """On CUDA"""
    small: tuple[float, ...]
    """On the processor, by default"""
    recipe: Callable[[float], SceneRecipe]
    weight: float = 1.0
    """Share of the time for all sweeps, by the others': more where building takes long"""
    size: Callable[[float], tuple[int, int]] | None = None
    """Where the picture's size is what is swept [px]"""


def lines_of(lines: float) -> tuple[int, int]:
    """Return a size of 16:9 of so many lines [px]."""
    return round(lines * 16 / 9), round(lines)


SWEEPS: dict[str, Sweep] = {sweep.name: sweep for sweep in (
    Sweep("triangles", "triangles", (1e4, 3.2e4, 1e5, 3.2e5, 1e6, 3.2e6, 1e7), (1e4, 3.2e4, 1e5, 3.2e5),
          lambda n: SceneRecipe(triangles=int(n)), 2.5),
    Sweep("lamps", "lamps", (1, 10, 100, 1000, 10000), (1, 10, 100, 1000), lambda n: SceneRecipe(lamps=int(n))),
    Sweep("instances", "instances", (1, 10, 100, 1e3, 1e4, 1e5, 1e6), (1, 10, 100, 1e3),
          lambda n: SceneRecipe(triangles=0, instances=int(n)), 3.0),
    Sweep("materials", "materials", (1, 8, 64, 512), (1, 8, 64),
          lambda n: SceneRecipe(materials=int(n), instances=512)),
    Sweep("textures", "texture bytes", (16 * MIB, 64 * MIB, 256 * MIB, 1024 * MIB), (4 * MIB, 16 * MIB, 64 * MIB),
          lambda n: SceneRecipe(texture_bytes=int(n), materials=256, instances=256), 2.5),
    Sweep("resolution", "pixels", (540, 720, 1080, 1440, 2160), (68, 90, 135, 180), lambda n: SceneRecipe(),
          size=lines_of),
    Sweep("glossy", "share of glossy pixels", (0.0, 0.25, 0.5, 0.75, 1.0), (0.0, 0.5, 1.0),
          lambda n: SceneRecipe(glossy=n)),
)}


@dataclass
class Fit:
    """How time grows with a quantity."""

    exponent: float | None = None
    """Power of the quantity; None where it has been 0"""
    exponent_error: float | None = None
    """Standard error of it"""
    log_slope: float | None = None
    """Milliseconds for each doubling, in the fit against the logarithm"""
    log_share: float | None = None
    """Share of the variance that this fit explains (R^2)"""
    slope: float = 0.0
    """Milliseconds for each unit, in the straight fit"""
    ratio: float = 1.0
    """Time at the largest value over that at the smallest"""


@dataclass
class SweepResult:
    """One sweep's points and fits."""

    name: str
    label: str
    points: list[dict[str, Any]] = field(default_factory=list)
    """Value, milliseconds, sections, counts, seconds of the build by stage"""
    left_out: dict[str, str] = field(default_factory=dict)
    """Values that were not measured, with the reason"""
    fit: Fit | None = None
    section_fits: dict[str, float | None] = field(default_factory=dict)
    """Exponent of each section"""
    build_exponent: float | None = None
    goal: str = ""
    """What is asked of it, and whether that is met; empty where nothing is"""

    def as_dict(self) -> dict[str, Any]:
        """Return everything by name."""
        return {**vars(self), "fit": vars(self.fit) if self.fit else None}


def run_sweep(
    sweep: Sweep, settings: RenderSettings, session: Session, values: Sequence[float], size: tuple[int, int],
    seconds: float, tell: Callable[[str], None],
) -> SweepResult:
    """Measure a sweep, the smallest value first.

    Args:
        sweep: What grows.
        settings: Of the real-time integrator.
        session: Takes each scene in turn.
        values: To measure; those that need too much memory or time are left out and named.
        size: Of the picture [px] where the sweep does not set it.
        seconds: For all of it.
        tell: Called with a line for each point.
    """
    result = SweepResult(sweep.name, sweep.label)
    end = time.perf_counter() + seconds
    cuda = wp.get_device(session.device).is_cuda
    for index, value in enumerate(values):
        begin = time.perf_counter()
        reason = too_large(sweep.recipe(value), session.device)
        if not reason and result.points and end - begin < max(LEAST_SECONDS[cuda], expected(result.points[-1], value)):
            reason = "no time left"
        if reason:
            result.left_out[f"{value:g}"] = reason
            tell(f"{sweep.name} {value:g}: left out, {reason}")
            continue
        try:
            share = max((end - begin) / (len(values) - index), 0.1)
            point = measure_point(sweep, value, settings, session, size, share)
        except BurnishError as error:
            result.left_out[f"{value:g}"] = str(error)
            tell(f"{sweep.name} {value:g}: left out, {error}")
            continue
        result.points.append(point)
        tell(f"{sweep.name} {value:g}: {point['frame']:.3g} ms a frame, build {point['build_seconds']:.3g} s")
    conclude(result)
    return result


def measure_point(
    sweep: Sweep, value: float, settings: RenderSettings, session: Session, size: tuple[int, int], seconds: float,
) -> dict[str, Any]:
    """Return one point: the frame's times, the build's, and what the scene was."""
    size = sweep.size(value) if sweep.size else size
    begin = time.perf_counter()
    delta = generate_scene(sweep.recipe(value))
    made = time.perf_counter()
    session.update(delta)
    wp.synchronize_device(session.device)
    built = time.perf_counter()
    stages = {name: each for name, each in session.stats.times.items() if name not in ("sampling", "read")}
    left = max(SPARED * seconds - (built - begin), 0.3 * seconds)
    frames = FRAMES[wp.get_device(session.device).is_cuda]
    times = measure_frames(session, settings, scene_flight(FLIGHT, size), size, frames=frames, seconds=left)
    x = size[0] * size[1] if sweep.size else value
    return {"value": x, "swept": value, "size": list(size), **times.as_dict(), "generate_seconds": made - begin,
            "build_seconds": built - made, "build_stages": stages, "measure_seconds": time.perf_counter() - built,
            "triangles": session.stats.triangles,
            "structure": session.stats.structure, "device_bytes": session.stats.device_bytes,
            "texture_bytes": session.stats.texture_bytes}


def expected(before: dict[str, Any], value: float) -> float:
    """Return about how many seconds a larger scene takes: frames as the one before, building in proportion."""
    growth = value / before["swept"] if before["swept"] > 0.0 else 1.0
    return before["measure_seconds"] + growth * (before["generate_seconds"] + before["build_seconds"])


def too_large(recipe: SceneRecipe, device: str) -> str:
    """Return why a scene can't be made here, empty where it can: memory of the host and of the device."""
    # Positions, triangles, normals, UVs and their copies; rows of instances and their Python objects; texels and mips.
    need = 700 * recipe.triangles + 3000 * recipe.instances + 4 * recipe.texture_bytes
    host = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 1 << 62
    place = wp.get_device(device)
    free = min(host, place.free_memory) if place.is_cuda else host
    if need > MEMORY_SHARE * free:
        return f"about {need / 2**30:.1f} GiB are needed and {free / 2**30:.1f} GiB are free"
    return ""


# Fits -----------------------------------------------------------------------------------------------------------------


def conclude(result: SweepResult) -> None:
    """Fit what was measured and judge it."""
    if len(result.points) < 2:
        return
    x = [point["value"] for point in result.points]
    result.fit = fit_growth(x, [point["frame"] for point in result.points])
    sections = dict.fromkeys(name for point in result.points for name in point["sections"])
    for name in sections:
        values = [point["sections"].get(name, 0.0) for point in result.points]
        result.section_fits[name] = fit_growth(x, values).exponent if min(values) > 0.0 else None
    result.build_exponent = fit_growth(x, [point["build_seconds"] for point in result.points]).exponent
    result.goal = goal_of(result)


def fit_growth(x: Sequence[float], y: Sequence[float]) -> Fit:
    """Fit y against x: as a power, against the logarithm, as a straight line."""
    a, b = np.asarray(x, float), np.asarray(y, float)
    fit = Fit(slope=line(a, b)[0], ratio=float(b[-1] / b[0]) if b[0] > 0.0 else 1.0)
    if (a > 0).all() and (b > 0).all():
        fit.exponent, fit.exponent_error, _ = line(np.log(a), np.log(b))
        fit.log_slope, _, fit.log_share = line(np.log2(a), b)
    return fit


def line(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Return slope, its standard error and R^2 of the least-squares line."""
    across = x - x.mean()
    spread = float((across**2).sum())
    slope = float((across * y).sum() / spread) if spread > 0.0 else 0.0
    rest = y - y.mean() - slope * across
    total = float(((y - y.mean()) ** 2).sum())
    error = float(np.sqrt((rest**2).sum() / max(len(x) - 2, 1) / spread)) if spread > 0.0 else 0.0
    return slope, error, 1.0 - float((rest**2).sum()) / total if total > 0.0 else 1.0


def goal_of(result: SweepResult) -> str:
    """Return the sweep's goal and whether it is met; empty where there is none."""
    points = result.points
    if result.name in ("triangles", "lamps") and points[-1]["value"] < LEAST_RANGE * points[0]["value"]:
        return f"not judged: only up to {points[-1]['value']:g} {result.label} were measured"
    if result.name == "triangles":
        ratio = points[-1]["frame"] / points[0]["frame"]
        allowed = LOG_SLACK * np.log(points[-1]["value"]) / np.log(points[0]["value"])
        return (f"{'met' if ratio <= allowed else 'missed'}: grows with the logarithm of triangles "
                f"(factor {ratio:.2f} from the fewest to the most; {allowed:.2f} allowed)")
    if result.name == "lamps":
        many = [point for point in points if point["value"] >= FLAT_FROM]
        if len(many) < 2:
            return ""
        exponent = fit_growth([p["value"] for p in many], [p["frame"] for p in many]).exponent or 0.0
        return (f"{'met' if exponent <= FLAT_EXPONENT else 'missed'}: flat in lamps from {FLAT_FROM} on "
                f"(exponent {exponent:.3f}; {FLAT_EXPONENT} allowed)")
    return ""
