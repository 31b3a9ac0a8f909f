# SPDX-License-Identifier: GPL-3.0-or-later
"""A frame as a recorded list of launches that is replayed: a CUDA graph, or bands of rows on the processor's cores.

Passes add launches once; after that a frame costs no Python for each kernel. Launch sizes and by-value arguments are
frozen in the record, so what changes from frame to frame lives in device arrays (kernels/view.py). A kernel that
writes only its own elements is `banded` and takes the index of its first element as its first argument; one with an
atomic or a scattered write is not, and runs in one launch.

On CUDA parts of a frame that need nothing of each other are branches of the graph, which run side by side: kernels
that wait for memory or for their longest rays leave room for others. Elsewhere, and while sections are timed, launches
run one by one in the order in which they were recorded.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import warp as wp

from ..kernels.lane_groups import GROUP
from .device import record, run_bands, thread_count
from .graph_priority import LEVELS, TRUNK, keep_priorities, make_stream
from .work_list import FEW_THREADS, LISTED_THREADS, ONCE, WorkList, one_number

__all__ = ["FrameGraph"]

BANDS_PER_THREAD = 4
"""On the processor: enough for pixels of uneven cost to spread over the cores."""

BAND_MINIMUM = 256
"""Elements below which a further band costs more than it gains."""


LISTS = 64
"""Counters of lists that are set to zero at once"""

@dataclass
class _Step:
    """One launch, or one clearing of an array."""

    section: str
    launches: list[wp.Launch] = field(default_factory=list)
    action: Callable[[], None] | None = None
    kernel: str = "clear"
    reads: tuple = ()
    """Arrays, structs and numbers that recorded launches point to"""
    writes: tuple = ()
    branch: str = TRUNK
    after: str | None = None
    """No launch: the branch waits for all that this one holds so far"""
    slots: tuple[int, int, int] | None = None
    """Of arrays with so many elements (the last) it touches those from the first on, so many (the second)"""

    def run(self) -> None:
        if self.action is not None:
            self.action()
        elif len(self.launches) == 1:
            self.launches[0].launch()
        else:
            run_bands([launch.launch for launch in self.launches])


class FrameGraph:
    """The launches of one frame, by section."""

    def __init__(self, device: str):
        self.device = device
        self.cuda = wp.get_device(device).is_cuda
        self.lanes = GROUP if self.cuda else 1
        """Threads to launch for each element of kernels whose threads share one (kernels/lane_groups.py)"""
        self.times: dict[str, float] = {}
        """Milliseconds of each section in the last timed replay, in the frame's order"""
        self.kernel_times: dict[str, float] = {}
        """The same by kernel"""
        self.skipped: dict[str, str] = {}
        """Sections that this frame does not need, with the reason"""
        self._steps: list[_Step] = []
        self._counts: wp.array | None = None
        self._lists = 0
        self._section = ""
        self._branch = TRUNK
        self._slots: tuple[int, int, int] | None = None
        self._open: list[str] = []
        """Branches"""
        self._graph: wp.Graph | None = None

    @contextmanager
    def section(self, name: str) -> Iterator[None]:
        """Give the launches inside a name under which they are timed."""
        outer, self._section = self._section, name
        try:
            yield
        finally:
            self._section = outer

    @contextmanager
    def slots(self, first: int, count: int, total: int) -> Iterator[None]:
        """Note that the launches inside touch `count` elements, from `first` on, of arrays that have `total`."""
        outer, self._slots = self._slots, (first, count, total)
        try:
            yield
        finally:
            self._slots = outer

    @contextmanager
    def branch(self, name: str) -> Iterator[None]:
        """Put the launches inside on a branch: they come after all before them, and those after them need not wait.

        What reads their results, or writes what they read, comes after `join`. A branch that is entered again goes on
        where it was. Kernels of branches with a higher level begin first (graph_priority.LEVELS).
        """
        outer = self._branch
        self._wait(name, outer)
        self._branch = name
        if name not in self._open:
            self._open.append(name)
        try:
            yield
        finally:
            self._branch = outer

    def join(self, *names: str) -> None:
        """Let what follows wait for branches; those that have nothing in them are no error."""
        for name in names:
            if name in self._open and name != self._branch:
                self._wait(self._branch, name)

    def _wait(self, branch: str, after: str) -> None:
        if branch != after:
            self._steps.append(_Step(self._section, branch=branch, after=after))

    def skip(self, name: str, reason: str) -> None:
        """Note that a section is left out and why, for the timing panel."""
        self.skipped[name] = reason

    def _step(self, kernel: str, reads: list, writes: list) -> _Step:
        return _Step(
            self._section, kernel=kernel, reads=tuple(reads), writes=tuple(writes), branch=self._branch,
            slots=self._slots)

    def launch(
        self, kernel: wp.Kernel, count: int, inputs: list, outputs: list, *, banded: bool = True, start: int = 0,
    ) -> None:
        """Record a launch of `count` threads; a banded kernel's first argument (`first`), from `start` on, is added."""
        step = self._step(kernel.key, inputs, outputs)
        for low, high in self._bands(count if banded else 0) or [(0, count)]:
            step.launches.append(record(
                kernel, [start + low, *inputs] if banded else inputs, outputs, self.device, high - low))
        self._steps.append(step)

    def launch_queued(self, kernel: wp.Kernel, inputs: list, queue: wp.array, outputs: list) -> None:
        """Record a kernel of the path tracer over all of a queue, which is its last input; see launch_listed.

        Such kernels write only their own path, so a band takes a part of the queue.
        """
        self._launch_queue(kernel, [*inputs, ONCE, one_number(len(queue), self.device)], queue, outputs)

    def _launch_queue(self, kernel: wp.Kernel, inputs: list, queue: wp.array, outputs: list) -> None:
        step = self._step(kernel.key, [*inputs, queue], outputs)
        for low, high in self._bands(len(queue)):
            step.launches.append(record(kernel, [*inputs, queue[low:high]], outputs, self.device, high - low))
        self._steps.append(step)

    def fill_list(self, kernel: wp.Kernel, count: int, inputs: list, work: WorkList) -> None:
        """Record a kernel that puts those of `count` elements into an empty list that need work; CUDA only.

        The list gets a counter of its own for this use: one step at the frame's start sets all of them to zero.
        """
        if self.cuda:
            self.empty_list(work)
            self.launch(kernel, count, inputs, [work.queue, work.count], banded=False)

    def empty_list(self, work: WorkList) -> None:
        """Give a list that a kernel is going to fill a counter of its own; CUDA only, see fill_list."""
        if self.cuda:
            place = self._lists % LISTS
            if place == 0:
                self._counts = wp.zeros(LISTS, dtype=int, device=self.device)
                self._steps.insert(0, _Step(self._section, action=self._counts.zero_))
            self._lists += 1
            work.count = self._counts[place : place + 1]

    def launch_listed(
        self, kernel: wp.Kernel, inputs: list, work: WorkList, outputs: list, *, few: bool = False,
    ) -> None:
        """Record a kernel over the elements of a list, whose number only the device knows.

        Its last inputs are the number of threads, the number of elements and the list; thread i takes elements i,
        i + threads, ... It must leave elements alone that need no work: on the processor all are in the list.
        `few`: as of FEW_THREADS.
        """
        if self.cuda:
            threads = min(len(work.queue), FEW_THREADS if few else LISTED_THREADS)
            self.launch(kernel, threads, [*inputs, threads, work.count, work.queue], outputs, banded=False)
        else:
            self._launch_queue(kernel, [*inputs, ONCE, work.count], work.queue, outputs)

    def _bands(self, count: int) -> list[tuple[int, int]]:
        if self.cuda or count < 2 * BAND_MINIMUM:
            return [(0, count)] if count else []
        number = min(thread_count() * BANDS_PER_THREAD, count // BAND_MINIMUM)
        edges = [count * i // number for i in range(number + 1)]
        return list(zip(edges[:-1], edges[1:], strict=True))

    def clear(self, *arrays: wp.array) -> None:
        """Record setting arrays to zero."""
        for array in arrays:
            self._steps.append(_Step(self._section, action=array.zero_, writes=(array,), branch=self._branch))

    def call(self, action: Callable[[], None], name: str = "call") -> None:
        """Record a host call that only issues device work (a scan): it must be fit for capture."""
        self._steps.append(_Step(self._section, action=action, kernel=name, branch=self._branch))

    def launch_list(self) -> list[tuple[str, str]]:
        """Return section and kernel of each step that runs, in the frame's order; clearing an array is one too."""
        return [(step.section, step.kernel) for step in self._launches()]

    def replay(self, timed: bool = False) -> None:
        """Run the frame; `timed` measures every section (and on CUDA waits for each)."""
        if timed:
            self._replay_timed()
            return
        if not self.cuda:
            for step in self._launches():
                step.run()
            return
        if self._graph is None:
            self._graph = self._capture()
        wp.capture_launch(self._graph)

    def _launches(self) -> list[_Step]:
        return [step for step in self._steps if step.after is None]

    def _capture(self) -> wp.Graph:
        """Capture the steps, each branch on a stream of its own: what streams wait for become the graph's edges."""
        streams = {name: make_stream(self.device, LEVELS.get(name, 0)) for name in (TRUNK, *self._open)}
        trunk = streams[TRUNK]
        with wp.ScopedCapture(stream=trunk, force_module_load=False) as capture:
            for step in self._steps:
                if step.after is not None:
                    streams[step.branch].wait_stream(streams[step.after])
                else:
                    with wp.ScopedStream(streams[step.branch], sync_enter=False):
                        self._issue(step)
            for name in self._open:
                trunk.wait_stream(streams[name])
        keep_priorities(capture.graph)
        return capture.graph

    def _issue(self, step: _Step) -> None:
        """Put a step on the stream that is captured."""
        step.run()

    def _replay_timed(self) -> None:
        elapsed, steps = [], self._launches()
        for step in steps:
            start = time.perf_counter()
            if self.cuda:
                before = wp.Event(self.device, enable_timing=True)
                after = wp.Event(self.device, enable_timing=True)
                wp.record_event(before)
                step.run()
                wp.record_event(after)
                elapsed.append((before, after))
            else:
                step.run()
                elapsed.append((time.perf_counter() - start) * 1e3)
        if self.cuda:
            wp.synchronize_device(self.device)
            elapsed = [wp.get_event_elapsed_time(before, after) for before, after in elapsed]
        self.times, self.kernel_times = {}, {}
        for step, milliseconds in zip(steps, elapsed, strict=True):
            self.times[step.section] = self.times.get(step.section, 0.0) + milliseconds
            self.kernel_times[step.kernel] = self.kernel_times.get(step.kernel, 0.0) + milliseconds
