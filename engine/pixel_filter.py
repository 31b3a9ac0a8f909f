# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixel filters as inverse distribution tables: samples are placed by the filter and all weigh the same."""

from __future__ import annotations

import functools

import numpy as np

from .settings import PixelFilter

__all__ = ["filter_table", "motion_reach", "sharpness_of"]

ENTRIES = 1025

LEAST_VARIANCE = 1e-6
"""[px^2]; of a filter that is next to a point"""


@functools.lru_cache(maxsize=16)
def filter_table(kind: PixelFilter, width: float) -> np.ndarray:
    """Return float32 [1025]: offset [px] from the pixel's centre by quantile; kept, and not to be changed.

    The shapes are Cycles' (scene/film.cpp): a Gaussian of exp(-2 (2 x / width)^2) cut off at 1.5 widths, and the
    four-term Blackman-Harris window, which spans two widths; a box of one pixel ignores the width.
    """
    if kind == PixelFilter.BOX:
        return np.linspace(-0.5, 0.5, ENTRIES).astype(np.float32)
    span = (3.0 if kind == PixelFilter.GAUSSIAN else 2.0) * width
    x = np.linspace(-0.5 * span, 0.5 * span, 16384)
    if kind == PixelFilter.GAUSSIAN:
        value = np.exp(-2.0 * (6.0 * x / span) ** 2)
    else:
        phase = 2.0 * np.pi * (x / span + 0.5)
        value = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2 * phase) - 0.01168 * np.cos(3 * phase)
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (value[1:] + value[:-1]))])
    quantiles = np.linspace(0.0, cumulative[-1], ENTRIES)
    return np.interp(quantiles, cumulative, x).astype(np.float32)


def sharpness_of(table: np.ndarray) -> float:
    """Return 1 / (2 variance) [1/px^2] of a filter_table: a Gaussian exp(-sharpness d^2) is as wide."""
    return 0.5 / max(float(np.var(table)), LEAST_VARIANCE)


def motion_reach(table: np.ndarray) -> float:
    """Return the half width [px] over which frames in motion spread their samples: the pixel, or a narrower filter."""
    return min(0.5, float(np.std(table)) * 3.0 ** 0.5)
