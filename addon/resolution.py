# SPDX-License-Identifier: GPL-3.0-or-later
"""How coarse a viewport picture is while navigating, decided from measured speed; plain arithmetic.

A change of the view starts a short list of levels: a coarse picture that takes about the frame time, one in between,
the full resolution. Each level starts its samples anew; the full one accumulates. Real-time frames live on what the
frames before them found, which another size loses: they keep to one coarse size, if any, until nothing moves.
"""

from __future__ import annotations

import math

__all__ = ["DIVIDER_MAX", "ResolutionControl", "divided_size"]

DIVIDER_MAX = 16
"""Coarsest picture: this many screen pixels per rendered pixel, along a side."""

STEADY_FROM, STEADY_TO = 0.35, 1.5
"""Frame times, as multiples of the one aimed at, within which a divider is kept."""

SMOOTHING = 0.3
"""Weight of the newest measurement; the rest is the running mean, so that one slow frame does not make a flicker."""


def divided_size(size: int, divider: int) -> int:
    """Return how many rendered pixels cover `size` screen pixels (at least one)."""
    return max(1, -(-size // divider))


class ResolutionControl:
    """Keeps the measured time of a pixel's sample and turns it into dividers and sample counts."""

    def __init__(self, first_divider: int = DIVIDER_MAX) -> None:
        self.first_divider = first_divider
        """Divider until something was measured."""
        self.seconds_per_sample: float | None = None
        """Seconds that one sample of one pixel takes."""

    def record(self, pixels: int, samples: int, seconds: float) -> None:
        """Take in that `samples` samples of `pixels` pixels took `seconds`."""
        if pixels <= 0 or samples <= 0 or seconds <= 0.0:
            return
        measured = seconds / (pixels * samples)
        if self.seconds_per_sample is None:
            self.seconds_per_sample = measured
        else:
            # Mean of logarithms: a coarse picture has a larger fixed cost per pixel, by factors rather than by terms.
            self.seconds_per_sample = math.exp((1.0 - SMOOTHING) * math.log(self.seconds_per_sample)
                                               + SMOOTHING * math.log(measured))

    def navigation_divider(self, pixels: int, frame_time: float, fixed: int = 0) -> int:
        """Return the divider with which one sample of `pixels` screen pixels takes about `frame_time` seconds."""
        if fixed > 0:
            return min(fixed, DIVIDER_MAX)
        if self.seconds_per_sample is None:
            return self.first_divider
        full = self.seconds_per_sample * pixels
        return min(DIVIDER_MAX, max(1, math.ceil(math.sqrt(full / frame_time) - 0.1)))

    def steady_divider(self, pixels: int, frame_time: float, fixed: int, current: int) -> int:
        """Return the divider for navigation, the current one (0: none) as long as it does about as well."""
        wanted = self.navigation_divider(pixels, frame_time, fixed)
        if current <= 0 or fixed > 0 or self.seconds_per_sample is None:
            return wanted
        expected = self.seconds_per_sample * pixels / current ** 2
        return current if STEADY_FROM * frame_time <= expected <= STEADY_TO * frame_time else wanted

    def levels(self, pixels: int, frame_time: float, fixed: int = 0) -> tuple[int, ...]:
        """Return the dividers to go through after a change, coarsest first, always ending at 1."""
        first = self.navigation_divider(pixels, frame_time, fixed)
        if first <= 1:
            return (1,)
        middle = round(math.sqrt(first))
        return (first, middle, 1) if 1 < middle < first else (first, 1)

    def samples_within(self, pixels: int, seconds: float) -> int:
        """Return how many samples of `pixels` pixels fit into `seconds`, from 1 to 64."""
        if self.seconds_per_sample is None:
            return 1
        return max(1, min(64, int(seconds / max(self.seconds_per_sample * pixels, 1e-9))))
