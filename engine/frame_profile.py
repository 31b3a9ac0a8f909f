# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a real-time frame's time goes, pass by pass, beside the least that the device could need for it.

The floor of a pass is the time to touch each byte of its buffers once at the device's measured copy rate, plus the time
for its rays at the rate that thin traversal kernels reach. It is an estimate to aim at, not a proof: buffers that stay
in the device's caches can be faster, and most passes touch some of their buffers more than once.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import warp as wp

from .device import device_info, thread_count
from .history import History, arrays_of
from .measure import wait
from .measure_moving import FrameTimes
from .pipeline import Pipeline
from .session import Session

__all__ = ["FrameProfile", "PassProfile", "buffer_bytes", "copy_rate", "pass_of", "profile_frame", "ray_rates"]

PASSES: dict[str, tuple[tuple[str, ...], str, tuple[tuple[str, str], ...]]] = {
    "G-buffer": (("Primary rays", "Materials", "Reprojection"), "gbuffer", (("primary rays", "primary"),)),
    "Radiance cache": (("Cache",), "cache", (
        ("cache rays", "spread"), ("cache bounce rays", "spread"), ("cache shadow rays", "shadow"))),
    "Screen probes": (("Probe", "Contact"), "probes", ()),
    "Direct light, filter": (("Direct denoising",), "direct_denoise", ()),
    "Direct light": (("Direct",), "direct", (("direct shadow rays", "shadow"),)),
    "Diffuse light, filter": (("Diffuse denoising",), "diffuse_denoise", ()),
    "Reflections, filter": (("Reflection denoising",), "reflection_denoise", ()),
    "Reflections": (("Reflection",), "reflections", (
        ("reflection rays", "rough"), ("reflection shadow rays", "shadow"))),
    "Refraction, filter": (("Refraction denoising",), "refraction_denoise", ()),
    "Refraction": (("Refraction",), "refraction", (
        ("refraction rays", "rough"), ("refraction shadow rays", "shadow"))),
    "Hair": (("Hair",), "hair", (("hair rays", "rough"), ("hair shadow rays", "shadow"))),
    "Final gather, filter": (("Final gather denoising",), "rest_gather", ()),
    "Final gather": (("Final gather",), "gather", (
        ("final gather rays", "spread"), ("final gather shadow rays", "shadow"))),
    "Composite": (("Composite", "Debug view"), "composite", ()),
}
"""By title: how the names of its sections begin (the longest match counts), its attribute of Pipeline, and its rays:
their names in Pipeline.counts() and their kind in RAY_RATES"""

NOT_OWN = ("_views", "_world", "_gbuffer", "_grid", "views")
"""Attributes of passes that hold what belongs to others"""

RAY_RATES = {"primary": 2.2e9, "rough": 0.82e9, "spread": 0.88e9, "shadow": 1.06e9}
"""Rays per second of `wp.Mesh` queries in thin kernels on one H100: a hall of 284,000 triangles, cuBQL, leaf size 1"""
HOPPER = ("H100", "H200", "GH200")
"""Devices with the same processor"""
PROCESSOR_RATE = 0.9e6
"""The same on one core of a processor, rays of all kinds"""

REST_WARM_UP = 12
"""Steps at rest before any is timed: launches are recorded, path tracing begins"""
COPY_BYTES = {True: 1 << 29, False: 1 << 26}
"""Bytes copied to measure the copy rate, on CUDA and elsewhere"""


@dataclass(frozen=True)
class PassProfile:
    """What one pass of a frame took and what it could not do without."""

    name: str
    milliseconds: float
    launches: int
    buffer_bytes: int
    rays: int
    floor_bytes: float
    """Milliseconds to touch its buffers once"""
    floor_rays: float | None
    """Milliseconds for its rays; None where the device's rate is not known"""

    @property
    def floor(self) -> float:
        """Return both floors together [ms]."""
        return self.floor_bytes + (self.floor_rays or 0.0)


@dataclass(frozen=True)
class FrameProfile:
    """A frame, pass by pass."""

    device: str
    copy_rate: float
    """Bytes per second, read and written bytes both counted"""
    times: FrameTimes
    passes: list[PassProfile]
    launches: dict[str, int]
    """By kernel"""
    skipped: dict[str, str]
    at_rest: float
    """Mean milliseconds of the same number of steps in a row at rest, path-traced samples among them"""
    triangles: int

    def as_dict(self) -> dict[str, Any]:
        """Return all figures by name."""
        return asdict(self)


def profile_frame(session: Session, times: FrameTimes) -> FrameProfile:
    """Return the profile of a session's last frame.

    Args:
        session: Has rendered frames; goes on at rest.
        times: Of these frames, as from measure_frames.
    """
    pipeline = session.pipeline
    device = pipeline.device
    rate, rates = copy_rate(device), ray_rates(device)
    launches: dict[str, int] = {}
    by_pass = dict.fromkeys(PASSES, 0)
    for section, kernel in pipeline.launches():
        launches[kernel] = launches.get(kernel, 0) + 1
        by_pass[pass_of(section)] += 1
    milliseconds = dict.fromkeys(PASSES, 0.0)
    for section, value in times.sections.items():
        milliseconds[pass_of(section)] += value
    held = buffer_bytes(pipeline)
    passes = []
    for name, (_, _, kinds) in PASSES.items():
        if by_pass[name] == 0:
            continue
        counts = [(times.counts.get(key, 0), kind) for key, kind in kinds]
        passes.append(PassProfile(
            name=name, milliseconds=milliseconds[name], launches=by_pass[name], buffer_bytes=held[name],
            rays=sum(count for count, _ in counts), floor_bytes=held[name] / rate * 1e3,
            floor_rays=None if rates is None else sum(count / rates[kind] for count, kind in counts) * 1e3))
    skipped = dict(pipeline.skipped)
    session.step(REST_WARM_UP)
    wait(session)
    start = time.perf_counter()
    session.step(times.frames)
    wait(session)
    at_rest = (time.perf_counter() - start) * 1e3 / times.frames
    return FrameProfile(device=device_info(device).name, copy_rate=rate, times=times, passes=passes, launches=launches,
                        skipped=skipped, at_rest=at_rest, triangles=session.stats.triangles)


def pass_of(section: str) -> str:
    """Return the title of the pass that a section belongs to; what has no section counts as the G-buffer's."""
    found = [(len(begin), name) for name, (begins, _, _) in PASSES.items() for begin in begins
             if section.startswith(begin)]
    return max(found)[1] if found else "G-buffer"


def buffer_bytes(pipeline: Pipeline) -> dict[str, int]:
    """Return the bytes of each pass's own buffers, by the pass's title; views of the same memory count once."""
    seen: set[int] = set()
    result = {}
    for name, (_, attribute, _) in PASSES.items():
        total = 0
        for key, value in vars(getattr(pipeline, attribute)).items():
            if key in NOT_OWN:
                continue
            for array in arrays_in(value):
                if array.ptr and array.ptr not in seen:
                    seen.add(array.ptr)
                    total += array.size * wp.types.type_size_in_bytes(array.dtype)
        result[name] = total
    return result


def arrays_in(value: Any) -> Iterator[wp.array]:
    """Yield the arrays that an attribute holds: in structs, histories, lists and work lists."""
    if isinstance(value, wp.array):
        yield value
    elif isinstance(value, History):
        for each in value.buffers:
            yield from arrays_of(each)
    elif isinstance(value, (list, tuple)):
        for each in value:
            yield from arrays_in(each)
    elif isinstance(value, dict):
        yield from arrays_in(list(value.values()))
    elif hasattr(value, "_cls"):
        yield from arrays_of(value)
    elif hasattr(value, "queue") and hasattr(value, "count"):
        yield from arrays_in([value.queue, value.count])


def copy_rate(device: str) -> float:
    """Return the bytes per second that a device copies, read and written bytes both counted: the best of six runs."""
    count = COPY_BYTES[wp.get_device(device).is_cuda]
    source, target = (wp.zeros(count // 4, dtype=float, device=device) for _ in range(2))
    best = float("inf")
    for _ in range(6):
        wp.synchronize_device(device)
        start = time.perf_counter()
        wp.copy(target, source)
        wp.synchronize_device(device)
        best = min(best, time.perf_counter() - start)
    return 2.0 * count / best


def ray_rates(device: str) -> dict[str, float] | None:
    """Return the rays per second that a device traces at best, by kind; None where it is not known."""
    if not wp.get_device(device).is_cuda:
        return dict.fromkeys(RAY_RATES, PROCESSOR_RATE * thread_count())
    return RAY_RATES if any(name in device_info(device).name for name in HOPPER) else None
