# SPDX-License-Identifier: GPL-3.0-or-later
"""The same picture at any scale and far from the origin, at any light level, and with the same seed."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ..device import choose_device, thread_count, use_threads
from ..settings import Integrator
from .cases import BOTH, FLIP_LIMIT, Case, Trial, luminance
from .scenes import StressScene, changed, room, scaled_and_moved

__all__ = ["CASES"]

SIZE = (48, 32)
SCALES = (1e-3, 1e-2, 1e-1, 10.0, 100.0, 1e3)
EXACT_SCALES = (2.0**-10, 2.0**-5, 2.0**5, 2.0**10)
"""Powers of two: the cache's cells, whose sizes are such, then scale as well"""
SMALLEST_CELL = 0.015625
"""A setting in metres, which scales with the scene; below what the scene's size sets"""
OFFSETS = ((1e4, 0.0, 0.0), (-1e4, 1e4, 0.0), (1e4, -1e4, 1e4))
"""Whole metres: float32 holds them exactly"""

REST = 256, 1792
"""Real-time frames and path-traced samples of a picture at rest"""
THREADS = (1, 2, 3, 7)
SAME_SEED = 0.01
"""FLIP of two runs on CUDA, whose atomics may come in any order"""


def amounts(trial: Trial, integrator: Integrator) -> int:
    """Return samples or frames."""
    return trial.choose(8, 512) if integrator == Integrator.REFERENCE else trial.choose(24, 512)


def run_scales(trial: Trial) -> None:
    """Compare path-traced pictures of the room and of scaled ones."""
    amount = amounts(trial, Integrator.REFERENCE)
    expected = trial.render(room(SIZE), Integrator.REFERENCE, amount, SIZE)
    for scale in trial.choose(SCALES[::5], SCALES):
        scene = scaled_and_moved(room(SIZE), scale)
        compare(trial, f"scale {scale:g}", expected, scene, Integrator.REFERENCE, amount)


def run_exact_scales(trial: Trial) -> None:
    """Compare real-time frames of the room and of ones scaled by powers of two."""
    amount = amounts(trial, Integrator.REALTIME)
    expected = trial.render(room(SIZE), Integrator.REALTIME, amount, SIZE, cache={"minimum_cell": SMALLEST_CELL})
    for scale in trial.choose(EXACT_SCALES[::3], EXACT_SCALES):
        scene = scaled_and_moved(room(SIZE), scale)
        compare(trial, f"scale {scale:g}", expected, scene, Integrator.REALTIME, amount,
                cache={"minimum_cell": SMALLEST_CELL * scale})


def run_scales_at_rest(trial: Trial) -> None:
    """Compare what viewports show at rest: real-time frames, then path-traced samples blended in."""
    frames, samples = REST
    rest = {"path_traced_rest": True, "rest_frames": frames}
    expected = trial.render(room(SIZE), Integrator.REALTIME, frames + samples, SIZE, denoiser=rest)
    for scale in SCALES:
        scene = scaled_and_moved(room(SIZE), scale)
        compare(trial, f"scale {scale:g}", expected, scene, Integrator.REALTIME, frames + samples, denoiser=rest)


def run_offsets(trial: Trial, integrator: Integrator, baked: bool) -> None:
    """Compare the room with moved ones; `baked` moves vertices. In real time at rest, after a few frames if quick."""
    amount, groups = amounts(trial, integrator), {}
    if integrator == Integrator.REALTIME and not trial.quick:
        amount, groups = REST[0] + REST[1], {"denoiser": {"path_traced_rest": True, "rest_frames": REST[0]}}
    expected = trial.render(scaled_and_moved(room(SIZE), baked=baked), integrator, amount, SIZE, **groups)
    for offset in trial.choose(OFFSETS[2:], OFFSETS):
        moved = scaled_and_moved(room(SIZE), offset=offset, baked=baked)
        compare(trial, f"moved by {offset}", expected, moved, integrator, amount, **groups)


def compare(trial: Trial, name: str, expected: np.ndarray, scene: StressScene, integrator: Integrator,
            amount: int, limit: float = FLIP_LIMIT, **groups: dict[str, Any]) -> None:
    """Render a scene and compare it with a picture."""
    picture = trial.render(scene, integrator, amount, SIZE, **groups)
    trial.check_energy(name, luminance(picture).mean() / luminance(expected).mean(), 0.02)
    trial.check_same(name, expected, picture, limit)


def run_threads(trial: Trial, integrator: Integrator) -> None:
    """Render with several numbers of threads on the processor, and twice with each: bit for bit the same.

    Elsewhere there is nothing to compare, and the processor's kernels would take minutes to build.
    """
    if choose_device(trial.device) != "cpu":
        trial.note("of the processor alone")
        return
    amount = trial.choose(3, 16)
    pictures = {}
    try:
        for count in THREADS:
            use_threads(count)
            assert thread_count() == count
            pictures[count] = trial.render(room(SIZE), integrator, amount, SIZE, fresh=True)
    finally:
        use_threads(0)
    first = pictures[THREADS[0]]
    for count in THREADS[1:]:
        trial.check(f"pixels that differ between 1 and {count} threads",
                    int((pictures[count] != first).any(-1).sum()), 0, 0)


def run_seed(trial: Trial, integrator: Integrator) -> None:
    """Render twice with the same seed: in a session that has rendered another scene before, and in a new one."""
    amount = trial.choose(8, 64)
    used = trial.session(integrator)
    trial.render(changed(room(SIZE, power=1e4), world=room(SIZE).delta.world), integrator, amount, SIZE)
    again = trial.render(room(SIZE), integrator, amount, SIZE)
    assert used is trial.session(integrator)
    new = trial.render(room(SIZE), integrator, amount, SIZE, fresh=True)
    differing = int((again != new).any(-1).sum())
    if choose_device(trial.device) == "cpu":
        trial.check("pixels that differ", differing, 0, 0)
    else:
        trial.note(f"{differing} of {again[..., 0].size} pixels differ, by {np.abs(again - new).max():.3g} at most")
    trial.check_same("same seed", new, again, SAME_SEED)


def make_cases() -> tuple[Case, ...]:
    """Return all cases."""
    same = "FLIP at most 0.01, energy within 2 %"
    cases = [
        Case("scale: 1e-3 to 1e3, reference", same, run_scales),
        Case("scale: 2^-10 to 2^10, realtime frames", same, run_exact_scales),
        Case("scale: 1e-3 to 1e3, realtime at rest", same, run_scales_at_rest, quick=False),
    ]
    for integrator in BOTH:
        cases += [
            Case(f"offset: objects 1e4 m away, {integrator}", same,
                 partial(run_offsets, integrator=integrator, baked=False)),
            Case(f"offset: vertices 1e4 m away, {integrator}", same,
                 partial(run_offsets, integrator=integrator, baked=True)),
            Case(f"seed: any number of threads, {integrator}", "the same bits on the CPU",
                 partial(run_threads, integrator=integrator)),
            Case(f"seed: after another scene, {integrator}", "the same bits on the CPU, FLIP at most 0.01 on CUDA",
                 partial(run_seed, integrator=integrator)),
        ]
    return tuple(cases)


CASES = make_cases()
