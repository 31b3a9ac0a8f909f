# SPDX-License-Identifier: GPL-3.0-or-later
"""One scene made in code in two sessions: the integrator measured and Reference, whose pictures are kept in files."""

from __future__ import annotations

import argparse
import hashlib
import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.image_error import LUMINANCE_WEIGHTS, box_filter  # noqa: E402
from burnish.engine.scene import MaterialData, SceneDelta  # noqa: E402

from tests.performance.measured_session import Measured, positions_of, settings_for, truth_of  # noqa: E402
from tests.performance.settings_text import FILTERED, merged, parse_settings  # noqa: E402

BRIGHT = 1.0
"""Luminance from which a pixel counts as lamp or window"""


def add_options(parser: argparse.ArgumentParser, output: str, size: tuple[int, int], frames: str, truth: int) -> None:
    """Add the options that all scripts with scenes made in code share."""
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=size)
    parser.add_argument("--integrator", default="realtime")
    parser.add_argument("--frames", default=frames, help="frames at rest, with commas between them")
    parser.add_argument("--truth", type=int, default=truth, help="samples of Reference")
    parser.add_argument("--truth-seconds", type=float, default=120.0, help="take the truth as it is after this time")
    parser.add_argument("--only", default="", help="names with commas between them")
    parser.add_argument("--set", action="append", default=[], metavar="GROUP.FIELD=VALUE")
    parser.add_argument("--output", type=Path, default=Path(output))


def filtered_settings(options: argparse.Namespace, **groups: dict[str, Any]) -> Any:
    """Return the settings of the options; at rest the filtered picture stays, path tracing does not take over."""
    changed = merged(FILTERED, groups, parse_settings(options.set))
    return settings_for(options.integrator, options.device, **changed)


class ScenePair:
    """A scene that is measured and its truth, both changed alike."""

    def __init__(self, scene: Any, options: argparse.Namespace, name: str, **groups: dict[str, Any]):
        self.scene, self.options, self.name = scene, options, name
        self.size = tuple(options.size)
        self.state = ""
        """What a truth's file is named by, besides the scene's name"""
        self._early: np.ndarray | None = None
        self.measured = Measured(filtered_settings(options, **groups))
        self.reference = Measured(settings_for("reference", options.device, seed=4711))
        for each in (self.measured, self.reference):
            each.load(scene.delta)
        self.positions = positions_of(self.reference, scene.camera, self.size)
        self.measured.look(scene.camera, self.size)

    def change(self, delta: SceneDelta, state: str) -> None:
        """Change both."""
        self.state = state
        for each in (self.measured, self.reference):
            each.load(delta)

    def start_with(self, key: str, material: MaterialData, state: str) -> None:
        """Change a material and forget all that was rendered."""
        self.change(SceneDelta(materials={key: material}), state)
        self.measured.session.reset()

    def frames(self, count: int) -> np.ndarray:
        """Return the picture after so many more frames."""
        self.measured.frames(count)
        return self.measured.picture()

    def truth(self) -> np.ndarray:
        """Return Reference's picture of the present state."""
        o = self.options
        code = Path(__file__).resolve().parents[1] / "glossy_scenes.py"
        mark = hashlib.md5(code.read_bytes() + repr((self.size, o.truth)).encode()).hexdigest()[:8]
        file = o.output / "truth" / f"{self.name}_{self.state}_{mark}.npy"
        truth = truth_of(None, self.scene.camera, self.size, o.device, o.truth, file, o.truth_seconds, self.reference)
        done = self.reference.session.samples_done
        self._early = None
        if done >= 16:  # not from a file
            self.reference.session.reset()
            self.reference.frames(done // 8)
            self._early = self.reference.picture()
        return truth

    def noise(self, truth: np.ndarray, mask: np.ndarray) -> float:
        """Return how much the last truth's mean over a mask may be off by, from its first eighth; 0: not known."""
        # An eighth of the samples differs from all of them by 7 times the variance of all.
        return 0.0 if self._early is None else abs(ratio(truth, self._early, mask) - 1.0) / 7.0**0.5

    def close(self) -> None:
        """Give the device's memory back."""
        for each in (self.measured, self.reference):
            each.close()


def inside(mask: np.ndarray, pixels: int = 2) -> np.ndarray:
    """Return a mask without what is within so many pixels of its border, which the pixels' filter mixes."""
    for _ in range(pixels):
        padded = np.pad(mask, 1)
        mask = mask & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask


def luminance(picture: np.ndarray) -> np.ndarray:
    """Return luminances [h, w]."""
    return np.nan_to_num(picture[..., :3]).astype(np.float64) @ LUMINANCE_WEIGHTS.astype(np.float64)


def dark(truth: np.ndarray) -> np.ndarray:
    """Return the pixels whose 4x4-boxed luminance is below 1 in the truth."""
    low = box_filter(truth[..., :3], 4) @ LUMINANCE_WEIGHTS < BRIGHT
    full = np.kron(low, np.ones((4, 4), bool))
    height, width = truth.shape[:2]
    return np.pad(full, ((0, height - full.shape[0]), (0, width - full.shape[1])), constant_values=False)


def ratio(truth: np.ndarray, picture: np.ndarray, mask: np.ndarray) -> float:
    """Return the ratio of mean luminances over a mask; 1 where there is nothing to see."""
    whole = luminance(truth)[mask].sum()
    return float(luminance(picture)[mask].sum() / whole) if whole > 0.0 else 1.0


def bad_pixels(picture: np.ndarray) -> int:
    """Return how many pixels are not finite or negative."""
    return int((~np.isfinite(picture).all(-1) | (picture < 0.0).any(-1)).sum())


__all__ = ["ScenePair", "add_options", "bad_pixels", "dark", "filtered_settings", "inside", "luminance", "ratio"]
