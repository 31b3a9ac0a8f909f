# SPDX-License-Identifier: GPL-3.0-or-later
"""How noisy a sample of the path tracer is, next to one of Cycles: variance between runs with different seeds.

`python tests/performance/sample_noise.py SCENE.blend... [--samples 16] [--runs 10] [--size 160 90] [--device cpu]`
needs no truth: each engine renders the scene several times, and the variance of a pixel over its runs is divided by
the square of both engines' mean there. Pixels that differ between the engines would show in the ratio of the means.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.measured_session import Measured, settings_for  # noqa: E402

CLIPPED = 0.995
"""Share of pixels, the least noisy ones, that the second figure takes: without fireflies"""


def own_runs(scene: BlendScene, device: str, samples: int, runs: int) -> np.ndarray:
    """Return Burnish's pictures [runs, h, w, 3] with seeds from 1 on."""
    measured = Measured(settings_for("reference", device))
    measured.load(scene.extract())
    pictures = []
    for seed in range(1, runs + 1):
        measured.look(scene.camera, scene.size, settings_for("reference", device, seed=seed))
        measured.frames(samples)
        pictures.append(measured.picture().astype(np.float64))
    measured.close()
    return np.stack(pictures)


def rival_runs(scene: BlendScene, samples: int, runs: int) -> np.ndarray:
    """Return Cycles' pictures [runs, h, w, 3]."""
    return np.stack([
        scene.cycles(samples, denoise=False, seed=seed)[0].astype(np.float64) for seed in range(1, runs + 1)])


def relative_variance(pictures: np.ndarray, mean: np.ndarray) -> tuple[float, float]:
    """Return the mean over all pixels of variance over squared brightness + 0.01, and that over most of them."""
    each = np.sort((pictures.var(0, ddof=1) / (mean**2 + 0.01)).mean(-1).ravel())
    return float(each.mean()), float(each[: int(CLIPPED * each.size)].mean())


def main() -> None:
    """Print a row a scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--size", type=int, nargs=2, default=(160, 90))
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    print("| scene | Burnish: all (99.5 %) | Cycles: all (99.5 %) | Burnish / Cycles | ratio of means |")
    print("|---|---|---|---|---|")
    for path in options.scenes:
        scene = BlendScene(path, tuple(options.size), options.device, matte=False)
        own = own_runs(scene, options.device, options.samples, options.runs)
        rival = rival_runs(scene, options.samples, options.runs)
        mean = 0.5 * (own.mean(0) + rival.mean(0))
        ours, theirs = relative_variance(own, mean), relative_variance(rival, mean)
        print(f"| {scene.name} | {ours[0]:.3f} ({ours[1]:.3f}) | {theirs[0]:.3f} ({theirs[1]:.3f}) | "
              f"{ours[0] / theirs[0]:.2f} ({ours[1] / theirs[1]:.2f}) | {own.mean() / rival.mean():.3f} |", flush=True)


if __name__ == "__main__":
    main()
