# SPDX-License-Identifier: GPL-3.0-or-later
"""What settings choose between, with what each choice means."""

from __future__ import annotations

import enum

__all__ = ["CacheKey", "Device", "Integrator", "PixelFilter", "Preset", "ReflectionResolution"]


class Integrator(enum.StrEnum):
    """How the picture is made."""

    REFERENCE = "reference"
    """Unbiased path tracing: slow and right; what every other integrator is measured against."""
    REALTIME = "realtime"
    """Screen probes over a hash-grid radiance cache: a picture every frame, path traced at rest."""


class Device(enum.StrEnum):
    """Where the kernels run."""

    AUTO = "auto"
    """The first CUDA device, else the processor."""
    CPU = "cpu"
    """The processor, on all its cores."""
    CUDA = "cuda"
    """The first CUDA device; an error where there is none."""


class CacheKey(enum.StrEnum):
    """What tells the cells of the radiance cache apart, besides place and level of detail."""

    NORMAL = "normal"
    """The face of a cube that the normal points through: one cell for each side of a surface."""
    DIRECTION = "direction"
    """The ray's direction, as published: walls in a corner share cells."""


class ReflectionResolution(enum.StrEnum):
    """How many pixels share one reflection ray a frame."""

    FULL = "full"
    """Each pixel has a ray in every frame."""
    HALF = "half"
    """Four pixels take turns."""
    QUARTER = "quarter"
    """Sixteen pixels take turns."""


class Preset(enum.StrEnum):
    """How much a real-time frame may cost; what each sets is in presets.py."""

    CUSTOM = "custom"
    """The settings as they are."""
    DRAFT = "draft"
    """A quarter of the probes' and reflections' rays: for slow devices and large pictures."""
    BALANCED = "balanced"
    """The defaults."""
    FINE = "fine"
    """Four times the probes and reflection rays, smaller cells: for fast devices and final renders."""
    PAPER = "paper"
    """The constants of Eto et al. 2023 and GI-1.0 with every mend switched off: for study."""


class PixelFilter(enum.StrEnum):
    """Reconstruction filter over a pixel's samples."""

    BOX = "box"
    """Average over the pixel's square."""
    GAUSSIAN = "gaussian"
    """Truncated Gaussian."""
    BLACKMAN_HARRIS = "blackman_harris"
    """Blackman-Harris window: Cycles' default."""
