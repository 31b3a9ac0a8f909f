# SPDX-License-Identifier: GPL-3.0-or-later
"""Other orders of a frame's threads, on the processor: what a device with many threads does by chance, made certain.

Bands run backwards, one after another; kernels that run in one piece (those with atomics) are built again with their
threads' indices reversed; branches of the graph wait as long as they can.
"""

from __future__ import annotations

import contextlib
import inspect
import linecache
from collections.abc import Iterator
from typing import Any

import pytest
import warp as wp
from burnish.engine import frame_graph
from burnish.engine.frame_graph import TRUNK, FrameGraph

PIECES = 11
"""Bands in which kernels run backwards"""

_copies: dict[tuple[str, int], wp.Kernel] = {}


def reversed_copy(kernel: wp.Kernel, count: int) -> wp.Kernel:
    """Return a copy of a kernel whose threads are reversed within blocks of the largest power of two in `count`."""
    mask = (count & -count) - 1
    name = f"{kernel.key}_{mask}"
    if name not in _copies:
        source = inspect.getsource(kernel.func)
        assert "wp.tid()" in source or count == 1, kernel.key
        source = source.replace("wp.tid()", f"(wp.tid() ^ {mask})")
        path = f"<{name}>"
        linecache.cache[path] = (len(source), None, source.splitlines(keepends=True), path)
        module = f"reversed_{name}"
        space = {**kernel.func.__globals__, "__name__": module}
        wp.get_module(module).options.update(enable_backward=False, default_grid_stride=False)
        exec(compile(source, path, "exec"), space)  # noqa: S102
        _copies[name] = space[kernel.func.__name__]
    return _copies[name]


def late_branches(steps: list) -> list:
    """Return a graph's steps with each branch held back until something waits for it."""
    held: dict[str, list] = {}
    done = []

    def flush(branch: str) -> None:
        for step in held.pop(branch, []):
            if step.after is None:
                done.append(step)
            elif step.after != TRUNK:
                flush(step.after)

    for step in steps:
        if step.branch != TRUNK:
            held.setdefault(step.branch, []).append(step)
        elif step.after is not None:
            flush(step.after)
        else:
            done.append(step)
    for branch in list(held):
        flush(branch)
    assert len(done) == sum(step.after is None for step in steps)
    return done


@contextlib.contextmanager
def backwards() -> Iterator[list[str]]:
    """Record and run frames in another order of threads; gives the names of the kernels that were built for that."""
    used: list[str] = []
    launch, launch_listed = FrameGraph.launch, FrameGraph.launch_listed

    def launch_backwards(
        self: FrameGraph, kernel: wp.Kernel, count: int, inputs: list, outputs: list, *, banded: bool = True,
        start: int = 0,
    ) -> None:
        if not banded and count > 1:
            used.append(kernel.key)
            kernel = reversed_copy(kernel, count)
        launch(self, kernel, count, inputs, outputs, banded=banded, start=start)

    def launch_in_list_order(self: FrameGraph, *arguments: Any, **options: Any) -> None:
        # Their elements' order is that of the list, which was filled backwards.
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(FrameGraph, "launch", launch)
            launch_listed(self, *arguments, **options)

    def bands(_: FrameGraph, count: int) -> list[tuple[int, int]]:
        edges = [count * i // PIECES for i in range(PIECES + 1)]
        pieces = [(low, high) for low, high in zip(edges[:-1], edges[1:], strict=True) if high > low]
        return pieces[::-1]

    def run_in_turn(jobs: list) -> None:
        for job in jobs:
            job()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FrameGraph, "launch", launch_backwards)
        patch.setattr(FrameGraph, "launch_listed", launch_in_list_order)
        patch.setattr(FrameGraph, "_bands", bands)
        patch.setattr(frame_graph, "run_bands", run_in_turn)
        patch.setattr(FrameGraph, "_launches", lambda self: late_branches(self._steps))
        yield used


@contextlib.contextmanager
def lists() -> Iterator[None]:
    """Record and run frames with lists of elements that need work, as on CUDA, on the processor."""
    made = FrameGraph.__init__

    def make(self: FrameGraph, device: str) -> None:
        made(self, device)
        self.cuda = True

    def replay(self: FrameGraph, timed: bool = False) -> None:
        for step in self._launches():
            step.run()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FrameGraph, "__init__", make)
        patch.setattr(FrameGraph, "replay", replay)
        yield
