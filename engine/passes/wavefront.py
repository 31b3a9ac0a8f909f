# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounds of the path tracer's kernels over a batch of paths, until none lives.

A round is a list of steps, each a kernel over one of the lists of kernels/path_lists.py. On CUDA two rounds are the
body of a loop in a graph that runs without the host: the number of living paths stays on the device, every launch has
the same size, and threads take further elements of their list. Small batches would wait for launches and counts
otherwise: a path in a white room lives for dozens of rounds. Steps that share nothing run at the same time there: the
last rounds have so few paths that each kernel takes as long as the slowest of them. On the processor one thread of a
launch, the calling one, takes its whole list, and empty lists have no launch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np
import warp as wp

from ...kernels import path_lists, tracing
from ...kernels.paths import Paths
from ...kernels.types import Closure, FrameData, Scene
from ..device import launch, record
from ..lean import LeanPrograms
from ..work_list import FEW_THREADS, LISTED_THREADS, make_queue

__all__ = ["HIT_LISTS", "Step", "Wavefront", "add_guides", "make_paths"]

LISTS = {"plain_hits": path_lists.PLAIN_HITS, "full_hits": path_lists.FULL_HITS, "layered": path_lists.LAYERED,
         "layered_shadows": path_lists.LAYERED_SHADOWS, "first_hits": path_lists.FIRST_HITS,
         "below": path_lists.BELOW, "exits": path_lists.EXITS, "layered_exits": path_lists.LAYERED_EXITS,
         "scattered": path_lists.SCATTERED, "other_hits": path_lists.OTHER_HITS}
"""Beside "living", the list of each round"""

HIT_LISTS = "plain_hits", "full_hits"
"""What kernels that play roulette fill: hits by what shades them, but for those on lean materials"""

LATE_LANE = 2
"""Lane of late steps"""

FEW_SAMPLES = 2
"""Samples that are few: such a picture waits for their longest paths alone, which end sooner (Paths.few)"""

PROCESSOR_THREADS = 1
"""Of a launch on the processor: each would read the array descriptors of the scene anew"""


@dataclass
class Step:
    """One kernel of a round; its last inputs are the number of threads, the list's length and the list."""

    kernel: wp.Kernel
    inputs: list
    over: str = "living"
    """List of the paths it works on"""
    fills: tuple[str, ...] = ()
    """Lists that it adds to; "next": the paths of the next round"""
    changes: bool = True
    """Whether it changes the paths: they come before the list then, among its outputs"""
    outputs: list = field(default_factory=list)
    """What else it writes: between the two"""
    lane: int = 0
    """Those of a group of neighbouring steps with the same number, from 1 on, run one after the other, on CUDA beside
    those with others; 0: after all before it, and before all behind it"""
    late: bool = False
    """Whether it comes in the next round, in a lane beside the steps of lane 1 at its beginning; it tells how many
    surfaces its paths have met by Wavefront.late_rounds"""


@dataclass(frozen=True)
class _Command:
    """A step's launch, recorded."""

    place: int
    """Number of the list that it works on"""
    launch: wp.Launch
    lane: int = 0
    late: bool = False


def late_among(commands: list[_Command]) -> list[_Command]:
    """Return those of a round's launches that are of the round before, which come once more after the last."""
    return [command for command in commands if command.late]


def launch_filled(commands: list[_Command], counts: np.ndarray) -> None:
    """Launch in turn what works on lists that are not empty by then."""
    for command in commands:
        if counts[command.place]:
            command.launch.launch()


def make_paths(count: int, passes: bool, device: str) -> Paths:
    """Allocate the states of `count` paths."""
    paths = Paths()
    extra = count if passes else 1
    for name, dtype in (
        ("state", int), ("seed", wp.uint32), ("index", wp.uint32), ("origin", wp.vec3), ("direction", wp.vec3),
        ("t", float), ("hit", wp.vec2i), ("barycentrics", wp.vec2), ("throughput", wp.vec3), ("radiance", wp.vec4),
        ("pdf", float), ("side", wp.vec3), ("kind", int), ("receiver", int), ("overruns", int), ("cone", wp.vec2),
        ("shadow_origin", wp.vec3), ("shadow_direction", wp.vec3), ("shadow_distance", float),
        ("shadow_light", wp.vec3), ("shadow_pending", int), ("shadow_emitter", wp.vec2i),
        ("shadow_barycentrics", wp.vec2), ("layer_t", float), ("layer", wp.vec2i), ("layer_barycentrics", wp.vec2),
        ("closure", Closure),
    ):
        setattr(paths, name, wp.zeros(count, dtype=dtype, device=device))
    for name in ("surface_normal", "surface_position", "surface_uv"):
        setattr(paths, name, wp.zeros(extra, dtype=wp.vec4, device=device))
    paths.clear_way = wp.zeros(1, dtype=wp.vec4, device=device)
    paths.few = wp.zeros(1, dtype=int, device=device)
    for name in ("surface_emission", "environment"):
        setattr(paths, name, wp.zeros(extra, dtype=wp.vec3, device=device))
    add_guides(paths, 0, device)
    return paths


def add_guides(paths: Paths, count: int, device: str) -> None:
    """Allocate what `count` paths show."""
    paths.guide_albedo = wp.zeros(count, dtype=wp.vec4, device=device)
    paths.guide_normal = wp.zeros(count, dtype=wp.vec3, device=device)


class Wavefront:
    """States of a batch of paths and the loops that move them on; one thread at a time may use it."""

    def __init__(self, capacity: int, passes: bool, device: str):
        self.device = device
        self.cuda = wp.get_device(device).is_cuda
        self.capacity = capacity
        self.paths = make_paths(capacity, passes, device)
        self.light: Any = None
        """What is kept of the paths for the passes of light (path_light.py)"""
        self.media: Any = None
        """What is kept of the media that they are in (media.py); None in scenes without any"""
        self.programs = LeanPrograms()
        """Of the scene's materials"""
        self.catching: Any = None
        """The same for shadow catchers (shadow_catcher.py)"""
        self.frame = wp.zeros(1, dtype=FrameData, device=device)
        self.rounds = wp.zeros(1, dtype=int, device=device)
        """Surfaces that the paths have met before this round's"""
        self.late_rounds = wp.zeros(1, dtype=int, device=device)
        """The same of late steps"""
        self._few = False
        self._rays = wp.zeros(1, dtype=wp.int64, device=device)
        self._all = make_queue(capacity, device)
        self._counts = wp.zeros(int(path_lists.LIST_COUNT), dtype=int, device=device)
        self._queues: dict[int, wp.array] = {}
        self._records: dict[str, tuple[tuple, tuple[list[_Command], ...]]] = {}
        self._graphs: dict[str, wp.Graph] = {}
        self._streams: dict[int, wp.Stream] = {}

    @property
    def rays(self) -> int:
        """Return how many rays the loops have begun with, shadow rays not counted. Waits for the device."""
        return int(self._rays.numpy()[0])

    def expect(self, samples: int) -> None:
        """Take in how many samples the picture is going to have, as far as is known."""
        few = samples <= FEW_SAMPLES
        if few != self._few:
            self._few = few
            self.paths.few.fill_(int(few))

    def forget_rays(self) -> None:
        """Count rays anew."""
        self._rays.zero_()

    def keep_for(self, scene: Scene, *names: str) -> None:
        """Drop those of the named loops that were recorded for another scene: they would keep its arrays."""
        for name in names:
            kept = self._records.get(name)
            if kept is not None and kept[0][0] is not scene:
                del self._records[name]
                self._graphs.pop(name, None)

    def trace(
        self, name: str, made_for: tuple, steps: Callable[[], list[Step]], frame: np.ndarray, table: wp.array,
        pixels: tuple[int, int], samples: tuple[int, int], limit: int, should_stop: Callable[[], bool],
        begin: Callable[[int], None] | None = None,
    ) -> bool:
        """Start the paths of a band's pixels at the camera and run rounds over them; return as loop() does.

        Args:
            name: As of loop(), with `made_for`, `steps`, `limit` and `should_stop`.
            made_for: See loop().
            steps: See loop().
            frame: One FrameData row; its `sample` is set here.
            table: Inverse distribution of the pixel filter.
            pixels: The band's first pixel, and how many it has.
            samples: The first of the pixels' samples, and how many they get.
            limit: See loop().
            should_stop: See loop().
            begin: What else is done with the paths that have been started; told how many they are.
        """
        (first_pixel, pixel_count), (first_sample, sample_count) = pixels, samples
        row = frame.copy()
        row["sample"] = first_sample
        self.frame.assign(row)
        total = pixel_count * sample_count
        launch(tracing.generate_paths, total, [self.frame, table, first_pixel, pixel_count], [self.paths], self.device)
        if begin is not None:
            begin(total)
        return self.loop(
            name, made_for, steps, total, limit, should_stop, (row["crop_width"].item(), pixel_count))

    def loop(
        self, name: str, made_for: tuple, steps: Callable[[], list[Step]], total: int, limit: int,
        should_stop: Callable[[], bool], pixels: tuple[int, int] = (0, 0),
    ) -> bool:
        """Run rounds over the first `total` paths until none lives; return whether it came to the end.

        Args:
            name: Of the loop: its launches are kept under it.
            made_for: What they depend on, by identity.
            steps: Returns a round's; one of them fills "next".
            total: How many paths there are.
            limit: Rounds at most.
            should_stop: Asked between rounds on the processor; a loop on CUDA takes milliseconds and is not stopped.
            pixels: Width of a row and number of pixels, each of which has a path, then one of a further sample, ...
                Where they are whole rows, threads of a warp take pixels that lie close together.
        """
        kept = self._records.get(name)
        if kept is None or len(kept[0]) != len(made_for) or any(
                a is not b for a, b in zip(kept[0], made_for, strict=True)):
            kept = self._records[name] = made_for, tuple(self._record(steps(), half, limit) for half in (0, 1))
            self._graphs.pop(name, None)
        width, count = pixels
        if self.cuda and width and count % width == 0:
            launch(path_lists.list_all, total, [width, count], [self._queue(0)], self.device)
        else:
            wp.copy(self._queue(0), self._all, count=total)
        self.rounds.fill_(-1)
        self._counts.zero_()
        self._counts[0:1].fill_(total)
        if self.cuda:
            self._run_graph(name, kept[1])
            return True
        half, counts = 0, self._counts.numpy()
        while counts[half]:
            launch_filled(kept[1][half], counts)
            if should_stop():
                return False
            half = 1 - half
        launch_filled(late_among(kept[1][half]), counts)
        return True

    def _run_graph(self, name: str, halves: tuple[list[_Command], ...]) -> None:
        """Run the loop, captured when it is first asked for; where drivers know no loops, round by round."""
        living = self._counts[0:1]

        def finish() -> None:
            # The last round was the second half's.
            for command in late_among(halves[0]):
                command.launch.launch()

        def body() -> None:
            for commands in halves:
                for grouped, group in groupby(commands, lambda command: command.lane > 0):
                    if grouped:
                        self._issue_beside(list(group))
                    else:
                        for command in group:
                            command.launch.launch()

        graph, looped = self._graphs.get(name), wp.is_conditional_graph_supported()
        if graph is None:
            with wp.ScopedCapture(self.device, force_module_load=False) as capture:
                if looped:
                    wp.capture_while(living, body)
                    finish()
                else:
                    body()
            graph = self._graphs[name] = capture.graph
        if looped:
            wp.capture_launch(graph)
        else:
            wp.capture_while(living, graph)
            finish()

    def _issue_beside(self, group: list[_Command]) -> None:
        """Issue the launches of a group of lanes: the first's to the stream that is captured, others' beside it."""
        trunk, first = wp.get_stream(self.device), min(command.lane for command in group)
        streams = {command.lane: self._side_stream(command.lane) for command in group if command.lane != first}
        for stream in streams.values():
            stream.wait_stream(trunk)
        for command in group:
            command.launch.launch(streams.get(command.lane, trunk))
        for stream in streams.values():
            trunk.wait_stream(stream)

    def _side_stream(self, lane: int) -> wp.Stream:
        if lane not in self._streams:
            self._streams[lane] = wp.Stream(self.device)
        return self._streams[lane]

    def _queue(self, place: int) -> wp.array:
        """Return the paths of a list; room for them is made when a step first names the list."""
        if place not in self._queues:
            self._queues[place] = wp.zeros(self.capacity, dtype=int, device=self.device)
        return self._queues[place]

    def _record(self, steps: list[Step], half: int, limit: int) -> list[_Command]:
        """Record a round whose living paths are in list `half`; those that go on come into the other."""
        living, previous = int(path_lists.LIVING) + half, int(path_lists.LIVING) + 1 - half
        late = [step for step in steps if step.late]
        begin = record(
            path_lists.start_round, [half, previous if late else living, limit],
            [self._counts, self.rounds, self._rays], self.device)
        commands = [_Command(living, begin)]
        if late:
            commands += [self._record_step(step, LISTS | {"living": previous}, LATE_LANE) for step in late]
            finish = record(
                path_lists.finish_round, [self.rounds, previous], [self._counts, self.late_rounds], self.device)
            commands.append(_Command(living, finish, LATE_LANE))
        places = LISTS | {"living": living, "next": previous}
        return commands + [self._record_step(step, places, step.lane) for step in steps if not step.late]

    def _record_step(self, step: Step, places: dict[str, int], lane: int) -> _Command:
        work, threads = int(places[step.over]), PROCESSOR_THREADS
        if self.cuda:
            threads = min(self.capacity, LISTED_THREADS if step.over == "living" else FEW_THREADS)
        outputs = [*([self.paths] if step.changes else []), *step.outputs]
        for name in step.fills:
            filled = int(places[name])
            outputs += [self._queue(filled), self._counts[filled : filled + 1]]
        inputs = [*step.inputs, threads, self._counts[work : work + 1], self._queue(work)]
        return _Command(work, record(step.kernel, inputs, outputs, self.device, threads), lane, step.late)
