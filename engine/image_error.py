# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of a picture against a reference: FLIP, relative MSE, luminance ratios, block percentiles, bad pixels.

Pictures are scene-linear RGB float arrays [h, w, 3], both with the same row first. Pure NumPy; FLIP itself is NVIDIA's
flip-evaluator, imported only when asked for. Knows nothing of files, engines or Blender.
"""

from __future__ import annotations

import importlib
from dataclasses import asdict, dataclass
from types import ModuleType

import numpy as np

from .errors import BurnishError

__all__ = [
    "LUMINANCE_WEIGHTS", "ImageError", "box_filter", "compare", "encode_srgb", "flip", "flip_map", "noise_rmse",
    "relative_mse", "signed_difference",
]

LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Of Rec. 709 primaries"""
CLIPPED_SHARE = 0.5
"""Share of the worst pixels [%] whose squared error is clipped, so that single fireflies don't decide a mean"""
BLOCK = 16
"""Side of the blocks whose luminance ratios give the percentiles [px]"""
BRIGHT = 1.0
"""Luminance above which a pixel counts as lamp or window, not as global illumination"""


@dataclass(frozen=True, kw_only=True)
class ImageError:
    """How far a picture is from its reference."""

    flip: float
    """Mean LDR-FLIP of the sRGB-encoded pictures clipped to 0..1"""
    flip_box: float
    """The same after a 4x4 box filter: what remains when most noise is averaged out"""
    relative_mse: float
    """Mean of squared error over (squared reference + 0.01), the worst 0.5 % of pixels clipped"""
    luminance: float
    """Ratio of mean luminances, all pixels: bright windows and lamps dominate it"""
    dark_luminance: float
    """The ratio over pixels whose 4x4-boxed reference luminance is below 1: global illumination"""
    block_p5: float
    block_p95: float
    """5th and 95th percentile of that ratio over 16x16 blocks"""
    bad_pixels: int
    """Pixels that are not finite or negative"""

    def as_dict(self) -> dict[str, float]:
        """Return the figures by name."""
        return asdict(self)


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Return sRGB values 0..1 (IEC 61966-2-1) of linear ones, clipped."""
    x = np.clip(linear, 0.0, 1.0)
    # The floor keeps the power away from 0; below 0.0031308 the other branch is taken.
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-8) ** (1.0 / 2.4) - 0.055).astype(np.float32)


def box_filter(image: np.ndarray, size: int) -> np.ndarray:
    """Return means over `size` x `size` blocks, [h // size, w // size, c]; rows and columns left over are dropped."""
    height, width, channels = image.shape
    trimmed = image[:height // size * size, :width // size * size]
    return trimmed.reshape(height // size, size, width // size, size, channels).mean((1, 3))


def flip_evaluator() -> ModuleType:
    """Return NVIDIA's flip-evaluator; raises BurnishError without it."""
    try:
        return importlib.import_module("flip_evaluator")
    except ImportError as error:
        raise BurnishError("FLIP needs the module 'flip_evaluator'; install it with `pip install flip-evaluator`"
                           ) from error


def flip(reference: np.ndarray, test: np.ndarray) -> float:
    """Return the mean LDR-FLIP (Andersson et al. 2020) of two scene-linear pictures; raises BurnishError without it."""
    return float(flip_evaluator().evaluate(encode_srgb(reference), encode_srgb(test), "LDR", inputsRGB=True)[1])


def flip_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Return LDR-FLIP of each pixel, 0..1 [h, w]; pixels of `test` that are not finite count as black."""
    test = np.nan_to_num(test, nan=0.0, posinf=0.0, neginf=0.0)
    errors = flip_evaluator().evaluate(encode_srgb(reference), encode_srgb(test), "LDR", inputsRGB=True,
                                       applyMagma=False)[0]
    return np.asarray(errors, np.float32).reshape(reference.shape[:2])


def relative_mse(reference: np.ndarray, test: np.ndarray) -> float:
    """Return the mean squared error relative to the squared reference plus 0.01, the worst 0.5 % of pixels clipped."""
    relative = np.mean((test - reference) ** 2, -1) / (np.mean(reference ** 2, -1) + 1e-2)
    return float(np.mean(np.minimum(relative, np.percentile(relative, 100.0 - CLIPPED_SHARE))))


def dark_ratios(reference: np.ndarray, test: np.ndarray) -> tuple[float, float, float]:
    """Return the luminance ratio where the reference is below BRIGHT, and its 5th and 95th percentile over blocks."""
    cell = 4
    reference_y, test_y = (box_filter(image, cell) @ LUMINANCE_WEIGHTS for image in (reference, test))
    dark = reference_y < BRIGHT
    if not dark.any() or reference_y[dark].sum() <= 0.0:
        return 1.0, 1.0, 1.0
    reference_block, test_block = (
        box_filter((values * dark)[..., None], BLOCK // cell)[..., 0] for values in (reference_y, test_y))
    # Nearly black blocks have no meaningful ratio.
    lit = reference_block > 1e-3 * max(float(reference_y[dark].mean()), 1e-9)
    low, high = np.percentile(test_block[lit] / reference_block[lit], (5, 95)) if lit.any() else (1.0, 1.0)
    return float(test_y[dark].sum() / reference_y[dark].sum()), float(low), float(high)


def compare(reference: np.ndarray, test: np.ndarray) -> ImageError:
    """Return all errors of `test` against `reference`; pixels that are not finite count as bad and as black.

    Raises:
        BurnishError: The sizes differ, or FLIP is not installed.
    """
    if reference.shape != test.shape:
        raise BurnishError(f"A picture of {test.shape[1]} x {test.shape[0]} pixels can't be compared with a reference "
                           f"of {reference.shape[1]} x {reference.shape[0]}; render it at that size")
    bad = ~np.isfinite(test).all(-1) | (test < 0.0).any(-1)
    reference = reference.astype(np.float32, copy=False)
    test = np.nan_to_num(test.astype(np.float32, copy=False), nan=0.0, posinf=0.0, neginf=0.0)
    dark, low, high = dark_ratios(reference, test)
    mean = float((reference @ LUMINANCE_WEIGHTS).mean())
    small = [box_filter(image, 4) for image in (reference, test)]
    return ImageError(
        flip=flip(reference, test), flip_box=flip(*small), relative_mse=relative_mse(reference, test),
        luminance=float((test @ LUMINANCE_WEIGHTS).mean()) / mean if mean > 0.0 else 1.0, dark_luminance=dark,
        block_p5=low, block_p95=high, bad_pixels=int(bad.sum()))


def noise_rmse(first: np.ndarray, second: np.ndarray) -> float:
    """Return the RMSE that noise gives one of two independent pictures of the same scene.

    The difference of the two has twice the variance of either. The worst 0.5 % of pixels are left out: a
    quantile scales with the noise, so the figure still falls as 1/sqrt(samples), without jumping at each firefly.
    """
    squared = np.nan_to_num(np.mean((first - second) ** 2, -1).ravel(), nan=0.0, posinf=0.0)
    kept = np.sort(squared)[:max(1, int(squared.size * (1.0 - CLIPPED_SHARE / 100.0)))]
    return float(np.sqrt(0.5 * kept.mean()))


def signed_difference(reference: np.ndarray, test: np.ndarray, full_scale: float = 0.25) -> np.ndarray:
    """Return a picture of relative luminance differences, sRGB values 0..1 [h, w, 3].

    Grey: equal; red: `test` is brighter, blue: darker, fully so where it differs by `full_scale` of the mean of both
    plus 0.01; magenta: not finite.
    """
    reference_y, test_y = reference @ LUMINANCE_WEIGHTS, test @ LUMINANCE_WEIGHTS
    finite = np.isfinite(test_y)
    test_y = np.where(finite, test_y, 0.0)
    share = (test_y - reference_y) / (0.5 * (np.abs(test_y) + reference_y) + 1e-2) / full_scale
    more, less = np.clip(share, 0.0, 1.0)[..., None], np.clip(-share, 0.0, 1.0)[..., None]
    gray, red, blue = (np.array(c, np.float32) for c in ((0.5, 0.5, 0.5), (1.0, 0.15, 0.05), (0.05, 0.25, 1.0)))
    picture = gray + more * (red - gray) + less * (blue - gray)
    return np.where(finite[..., None], picture, np.array([1.0, 0.0, 1.0], np.float32)).astype(np.float32)
