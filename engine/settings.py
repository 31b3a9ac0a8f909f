# SPDX-License-Identifier: GPL-3.0-or-later
"""All settings, declared once: names, defaults, ranges and help.

Blender properties, panels, the command line, the README's table and the tests are made from these
dataclasses; nothing else in the package repeats a default or a range. Knows nothing of Blender.
"""

from __future__ import annotations

import enum
from dataclasses import Field, dataclass, field, fields
from typing import Any

__all__ = [
    "Change",
    "Device",
    "FilmSettings",
    "Integrator",
    "PixelFilter",
    "RenderSettings",
    "SamplingSettings",
    "LightPathSettings",
    "PerformanceSettings",
    "change_since",
    "setting_info",
]


class Integrator(enum.StrEnum):
    """How the picture is made."""

    REFERENCE = "reference"
    """Unbiased path tracing: slow and right; what every other integrator is measured against."""
    REALTIME = "realtime"
    """Two-level radiance caching (not in this version)."""


class Device(enum.StrEnum):
    """Where the kernels run."""

    AUTO = "auto"
    """The first CUDA device, else the processor."""
    CPU = "cpu"
    """The processor, on all its cores."""
    CUDA = "cuda"
    """The first CUDA device; an error where there is none."""


class PixelFilter(enum.StrEnum):
    """Reconstruction filter over a pixel's samples."""

    BOX = "box"
    """Average over the pixel's square."""
    GAUSSIAN = "gaussian"
    """Truncated Gaussian."""
    BLACKMAN_HARRIS = "blackman_harris"
    """Blackman-Harris window: Cycles' default."""


class Change(enum.IntFlag):
    """What a new RenderSettings asks of a running session."""

    NONE = 0
    RESTART = 1
    """The accumulated samples are no longer valid."""
    RESIZE = 2
    """Frame buffers must be reallocated (implies RESTART)."""
    DEVICE = 4
    """Everything must move to another device."""


def setting(default: Any, help: str, *, low: Any = None, high: Any = None, soft_high: Any = None, unit: str = "",
            label: str = "") -> Any:
    """Declare one setting with its help, hard range, soft upper limit, unit and label."""
    info = {"help": help, "low": low, "high": high, "soft_high": soft_high, "unit": unit, "label": label}
    return field(default=default, metadata=info)


def setting_info(settings_class: type) -> dict[str, Field]:
    """Return the dataclass fields of a settings class by name (each with `metadata` as `setting` made it)."""
    return {f.name: f for f in fields(settings_class)}


@dataclass(frozen=True, kw_only=True)
class SamplingSettings:
    """How many samples, and with which random numbers."""

    integrator: Integrator = setting(Integrator.REFERENCE, "How the picture is made")
    samples: int = setting(128, "Samples per pixel of a final render", low=1, high=1 << 24, soft_high=4096)
    viewport_samples: int = setting(
        1024, "Samples per pixel after which the viewport rests (0: never)", low=0, high=1 << 24, soft_high=4096)
    time_limit: float = setting(0.0, "Stop a final render after this time (0: no limit)", low=0.0, high=1e9,
                                soft_high=3600.0, unit="s")
    seed: int = setting(0, "Seed of the random numbers: the same seed gives the same picture", low=0,
                        high=(1 << 31) - 1)


@dataclass(frozen=True, kw_only=True)
class LightPathSettings:
    """How long light is followed and what is clamped."""

    max_bounces: int = setting(
        0, "Most surfaces that a light path may meet before it ends (0: unlimited, ended by Russian roulette; "
        "Cycles' Max Bounces counts one fewer)", low=0, high=1024, soft_high=64)
    roulette_start: int = setting(
        1, "Bounce from which Russian roulette may end a path; it never biases the picture", low=1, high=1024,
        soft_high=32)
    clamp_direct: float = setting(
        0.0, "Clamp each sample of directly seen or directly reflected light (0: off); darkens, but tames noise",
        low=0.0, high=1e9, soft_high=100.0)
    clamp_indirect: float = setting(
        0.0, "Clamp each sample of indirect light (0: off); darkens, but tames noise", low=0.0, high=1e9,
        soft_high=100.0)


@dataclass(frozen=True, kw_only=True)
class FilmSettings:
    """How samples become pixels."""

    exposure: float = setting(1.0, "Factor on all light reaching the film", low=0.0, high=1e6, soft_high=10.0)
    pixel_filter: PixelFilter = setting(PixelFilter.BLACKMAN_HARRIS, "Reconstruction filter of the pixels")
    filter_width: float = setting(
        1.5, "Width of the pixel filter, as in Cycles: samples come from up to this far to each side", low=0.01,
        high=10.0, unit="px")
    transparent: bool = setting(False, "Make the world transparent, for compositing over another picture")


@dataclass(frozen=True, kw_only=True)
class PerformanceSettings:
    """What the machine may spend."""

    texture_budget: int = setting(
        4096, "Memory for textures; above it the largest are halved and named in the report", low=16, high=1 << 20,
        soft_high=65536, unit="MiB")
    texture_size_limit: int = setting(
        0, "Longest side of a texture (0: as in the file)", low=0, high=65536, soft_high=8192, unit="px")
    viewport_pixel_size: int = setting(
        0, "Screen pixels per rendered pixel while navigating (0: chosen from the measured speed)", low=0, high=16)
    frame_time: float = setting(
        0.05, "Time aimed at for one viewport picture while navigating", low=0.005, high=1.0, unit="s")
    instancing_threshold: float = setting(
        4.0, "Flatten all instances into one structure while that multiplies the unique triangles by less than this",
        low=1.0, high=1e6, soft_high=64.0)


@dataclass(frozen=True, kw_only=True)
class RenderSettings:
    """Everything that decides the picture, besides the scene and the camera."""

    device: Device = setting(Device.AUTO, "Where the kernels run")
    sampling: SamplingSettings = field(default_factory=SamplingSettings)
    light_paths: LightPathSettings = field(default_factory=LightPathSettings)
    film: FilmSettings = field(default_factory=FilmSettings)
    performance: PerformanceSettings = field(default_factory=PerformanceSettings)


def change_since(new: RenderSettings, old: RenderSettings | None) -> Change:
    """Return what `new` asks of a session that ran with `old`; the one place that knows which edits restart."""
    if old is None or new.device != old.device:
        return Change.DEVICE | Change.RESIZE | Change.RESTART
    change = Change.NONE
    if (new.sampling.seed, new.sampling.integrator) != (old.sampling.seed, old.sampling.integrator):
        change |= Change.RESTART
    if new.light_paths != old.light_paths or new.film != old.film:
        change |= Change.RESTART
    textures = ("texture_budget", "texture_size_limit")
    if any(getattr(new.performance, name) != getattr(old.performance, name) for name in textures):
        change |= Change.RESTART
    return change
