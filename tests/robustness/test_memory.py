# SPDX-License-Identifier: GPL-3.0-or-later
"""Test that memory stays flat over long sessions: frames in motion, other sizes of the picture, other settings.

On the processor the process's resident memory counts, on CUDA what Warp's memory pool has given out. Both also hold
what is made once, so the first part of each session is no part of the measurement.
"""

from __future__ import annotations

import gc
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import warp as wp
from burnish.engine.scene import SceneDelta
from burnish.engine.session import Session
from burnish.engine.settings import DebugSettings, Integrator, PerformanceSettings, ReflectionResolution

from tests.unit.engine.test_determinism import REALTIME, camera, room

MIB = 1 << 20
SIZE = (96, 64)
ROOM = {"cpu": 16 * MIB, "cuda": MIB // 4}
"""Growth that counts as none: the allocator keeps pages of its own. A frame's buffers of that size take 5 MiB"""

SIZES = [(96, 64), (64, 96), (31, 17), (128, 72), (1, 1)]
MODES = {
    "realtime": REALTIME,
    "reference": replace(REALTIME, sampling=replace(REALTIME.sampling, integrator=Integrator.REFERENCE)),
    "cells": replace(REALTIME, cache=replace(REALTIME.cache, capacity=14)),
    "deterministic": replace(REALTIME, performance=PerformanceSettings(deterministic=True)),
    "reflections": replace(
        REALTIME, reflections=replace(REALTIME.reflections, resolution=ReflectionResolution.FULL)),
    "debug view": replace(REALTIME, debug=DebugSettings(view="cache.light")),
}

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="resident memory is read from /proc")


def memory(device: str) -> int:
    """Return the bytes in use on a device, once all that is not needed is given back."""
    gc.collect()
    if wp.get_device(device).is_cuda:
        wp.synchronize_device(device)
        return int(wp.get_mempool_used_mem_current(device))
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


def frames(made: Session, number: int) -> None:
    """Move camera and box, then rest."""
    made.configure(REALTIME, camera(0.002 * (number % 200)), *SIZE)
    if number % 3:
        made.update(SceneDelta(instances=room(0.003 * (number % 100)).instances))
    made.step(1)


def resizes(made: Session, number: int) -> None:
    """Change the picture's size, and render until every kind of frame is recorded."""
    made.configure(REALTIME, camera(0.0), *SIZES[number % len(SIZES)])
    made.step(4)
    made.read()


def switches(made: Session, number: int) -> None:
    """Change the settings, and render."""
    made.configure(list(MODES.values())[number % len(MODES)], camera(0.0), *SIZE)
    made.step(4)
    made.read()


def level(made: Session) -> int:
    """Return the memory in use, in the state in which sessions here start."""
    made.configure(REALTIME, camera(0.0), *SIZE)
    made.step(4)
    return memory(made.device)


@pytest.mark.slow
@pytest.mark.parametrize(("change", "count"), [(frames, 1000), (resizes, 100), (switches, 100)])
def test_memory_is_flat(device, change, count):
    """Use no more memory at the end of a long session than after a part of it."""
    made = Session(REALTIME)
    made.update(room())
    for number in range(count // 5):
        change(made, number)
    levels = [level(made)]
    for number in range(count):
        change(made, number)
    levels.append(level(made))
    print(f"{change.__name__}: {levels[0] / MIB:.2f} MiB, after {count} more {levels[1] / MIB:.2f} MiB")
    assert levels[1] - levels[0] < ROOM[device.partition(":")[0]]


@pytest.mark.slow
def test_closed_sessions_give_memory_back(device):
    """Open and close sessions without end."""
    levels = []
    for number in range(24):
        made = Session(REALTIME)
        made.update(room())
        made.configure(REALTIME, camera(0.0), *SIZE)
        made.step(2)
        made.close()
        del made
        if number in (7, 23):
            levels.append(memory(device))
    print(f"sessions: {levels[0] / MIB:.2f}, {levels[1] / MIB:.2f} MiB")
    assert levels[1] - levels[0] < ROOM[device.partition(":")[0]]
