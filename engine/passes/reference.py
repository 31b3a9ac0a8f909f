# SPDX-License-Identifier: GPL-3.0-or-later
"""Host side of the reference path tracer: bands of pixels, bounces until no path lives, sums on the film.

The frame's pixels are cut into bands. On CUDA a band is as many paths as fit the buffers (several samples a pixel
where the picture is small); on the CPU bands are small, one thread each, so that all cores work and a cancel is
answered within a tenth of a second. A band interrupted between samples goes on where it stopped.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from ...kernels import (
    compaction,
    film,
    flat_paths,
    layers,
    materials,
    misses,
    reference,
    shadow_layers,
    shadow_lights,
    tracing,
)
from ...kernels.paths import ENDED, Options, Paths
from ...kernels.types import Closure, FrameData, Scene
from ..device import launch, record, run_bands
from ..structures import is_flat

__all__ = ["ANY_RAYS", "FLAT_RAYS", "Band", "FilmBuffers", "ReferencePass"]

ANY_RAYS = tracing.trace_paths, tracing.trace_layers, tracing.trace_shadows, tracing.trace_shadow_layers
FLAT_RAYS = (flat_paths.trace_flat_paths, flat_paths.trace_flat_path_layers, flat_paths.trace_flat_path_shadows,
             flat_paths.trace_flat_path_shadow_layers)
"""The same where there are no instances"""

CPU_BAND_PATHS = 4096
CUDA_BATCH_PATHS = 1 << 22
"""Paths that keep a large GPU busy: small pictures take several samples at once up to this"""

PATH_BYTES = 640
"""Of one path's states, its closure the largest of them"""

MEMORY_SHARE = 0.25
"""Of the device's free memory that path states may take"""


# Not a limit of the integrator: roulette ends every path long before, unless a scene keeps all light for ever.
BOUNCE_STOP = 4096


def _vectors(count: int, dtype: type, device: str) -> wp.array:
    return wp.zeros(count, dtype=dtype, device=device)


def make_paths(count: int, passes: bool, device: str) -> Paths:
    """Allocate the states of `count` paths."""
    paths = Paths()
    extra = count if passes else 1
    for name, dtype in (
        ("state", int), ("seed", wp.uint32), ("index", wp.uint32), ("origin", wp.vec3), ("direction", wp.vec3),
        ("t", float), ("hit", wp.vec2i), ("barycentrics", wp.vec2), ("throughput", wp.vec3), ("radiance", wp.vec4),
        ("pdf", float), ("side", wp.vec3), ("kind", int), ("overruns", int), ("cone", wp.vec2),
        ("shadow_origin", wp.vec3), ("shadow_direction", wp.vec3), ("shadow_distance", float),
        ("shadow_light", wp.vec3), ("shadow_pending", int), ("shadow_emitter", wp.vec2i),
        ("shadow_barycentrics", wp.vec2), ("layer_t", float), ("layer", wp.vec2i), ("layer_barycentrics", wp.vec2),
        ("closure", Closure),
    ):
        setattr(paths, name, _vectors(count, dtype, device))
    for name in ("surface_normal", "surface_position", "surface_uv"):
        setattr(paths, name, _vectors(extra, wp.vec4, device))
    for name in ("surface_emission", "environment"):
        setattr(paths, name, _vectors(extra, wp.vec3, device))
    return paths


@dataclass
class FilmBuffers:
    """The film on the device and how many samples each band has."""

    film: film.Film
    picture: wp.array
    pixel_count: int
    passes: bool

    @staticmethod
    def make(pixel_count: int, passes: bool, device: str) -> FilmBuffers:
        """Allocate a cleared film."""
        buffers = film.Film()
        extra = pixel_count if passes else 1
        buffers.color = _vectors(pixel_count, wp.vec4, device)
        buffers.color_rest = _vectors(pixel_count, wp.vec4, device)
        buffers.squares = _vectors(pixel_count, float, device)
        buffers.samples = _vectors(pixel_count, int, device)
        # Counted as floats: Warp's sum of an array takes no integers.
        buffers.rejected = _vectors(pixel_count, float, device)
        buffers.overruns = _vectors(pixel_count, float, device)
        for name, dtype in (
            ("normal", wp.vec4), ("position", wp.vec4), ("uv", wp.vec4), ("depth", float), ("emission", wp.vec3),
            ("environment", wp.vec3),
        ):
            setattr(buffers, name, _vectors(extra, dtype, device))
        return FilmBuffers(buffers, _vectors(pixel_count, wp.vec4, device), pixel_count, passes)

    def clear(self) -> None:
        """Forget all samples."""
        for name in (
            "color", "color_rest", "squares", "samples", "rejected", "overruns", "normal", "position", "uv", "depth",
            "emission", "environment",
        ):
            getattr(self.film, name).zero_()


@dataclass
class Band:
    """A range of pixels with its own progress."""

    first: int
    count: int
    samples: int = 0


@dataclass
class _Slot:
    """What one worker needs to trace paths."""

    paths: Paths
    identity: wp.array
    queues: tuple[wp.array, wp.array]
    counter: wp.array
    frame: wp.array
    capacity: int
    commands: dict[int, list[tuple[wp.Launch, int]]] = field(default_factory=dict)
    """Recorded launches of one bounce by queue (its address), each with the index of its bounce number or -1"""
    recorded_for: tuple[Scene, Options] | None = None
    """What the launches were recorded with; kept, so that no other object takes its identity"""


class ReferencePass:
    """Traces samples for a film."""

    name = "reference"

    def __init__(self, device: str):
        self.device = device
        self.cuda = wp.get_device(device).is_cuda
        self.bands: list[Band] = []
        self.slots: list[_Slot] = []
        self.lock = threading.Lock()
        self.rays = 0
        """Rays traced since the last reset (paths entering a trace, shadow rays not counted), CUDA only"""

    def resize(self, pixel_count: int, passes: bool) -> None:
        """Cut the picture into bands and allocate path states for them."""
        limit = CPU_BAND_PATHS
        if self.cuda:
            room = int(wp.get_device(self.device).free_memory * MEMORY_SHARE) // PATH_BYTES
            limit = max(min(CUDA_BATCH_PATHS, room), 1 << 16)
        count = max(1, -(-pixel_count // limit))
        edges = np.linspace(0, pixel_count, count + 1).astype(int)
        self.bands = [Band(int(a), int(b - a)) for a, b in zip(edges[:-1], edges[1:], strict=True) if b > a]
        largest = max(band.count for band in self.bands)
        capacity = max(largest, min(limit, largest * 64)) if self.cuda else largest
        self.slots = []
        self.passes = passes
        self.capacity = capacity

    def reset(self) -> None:
        """Start counting samples anew."""
        for band in self.bands:
            band.samples = 0
        self.rays = 0

    @property
    def samples_done(self) -> int:
        """Return how many samples every pixel has."""
        return min((band.samples for band in self.bands), default=0)

    def take_slot(self) -> _Slot:
        """Return states for a band's paths that no other thread uses until they are given back."""
        with self.lock:
            if self.slots:
                return self.slots.pop()
        identity = wp.array(np.arange(self.capacity, dtype=np.int32), dtype=int, device=self.device)
        queues = (wp.zeros(self.capacity, dtype=int, device=self.device),
                  wp.zeros(self.capacity, dtype=int, device=self.device))
        counter = wp.zeros(1, dtype=int, device=self.device)
        frame = wp.zeros(1, dtype=FrameData, device=self.device)
        return _Slot(make_paths(self.capacity, self.passes, self.device), identity, queues, counter, frame,
                     self.capacity)

    def give_slot(self, slot: _Slot) -> None:
        """Give back what take_slot() returned."""
        with self.lock:
            self.slots.append(slot)

    def render(
        self, scene: Scene, frame: np.ndarray, options: Options, filter_table: wp.array, buffers: FilmBuffers,
        target: int, should_stop: Callable[[], bool],
    ) -> None:
        """Bring every band to `target` samples, or stop as soon as `should_stop` says so.

        Args:
            scene: The device scene.
            frame: One FrameData row as NumPy (its `sample` is set per batch).
            options: Settings for the kernels.
            filter_table: Inverse distribution of the pixel filter.
            buffers: The film.
            target: Samples per pixel that every band shall have.
            should_stop: Polled between launches.
        """
        while True:
            low = self.samples_done
            if low >= target or should_stop():
                return
            behind = [band for band in self.bands if band.samples == low]
            if self.cuda:
                for band in behind:
                    count = max(1, min(self.capacity // band.count, target - low, 64))
                    self._trace_band(band, count, scene, frame, options, filter_table, buffers, should_stop)
            else:
                def job(band: Band) -> Callable[[], None]:
                    return lambda: self._trace_band(
                        band, 1, scene, frame, options, filter_table, buffers, should_stop)

                run_bands(job(band) for band in behind)

    def _trace_band(
        self, band: Band, count: int, scene: Scene, frame: np.ndarray, options: Options,
        filter_table: wp.array, buffers: FilmBuffers, should_stop: Callable[[], bool],
    ) -> None:
        """Trace `count` samples of a band and add them to the film; an interrupted batch leaves no trace."""
        if should_stop():
            return
        slot = self.take_slot()
        try:
            row = frame.copy()
            row["sample"] = band.samples
            slot.frame.assign(row)
            if self._trace(slot, band, count, scene, options, filter_table, should_stop):
                launch(
                    film.accumulate_samples, band.count,
                    [slot.paths, options, band.first, band.count, count, band.samples], [buffers.film], self.device)
                band.samples += count
        finally:
            self.give_slot(slot)

    def _trace(
        self, slot: _Slot, band: Band, count: int, scene: Scene, options: Options, filter_table: wp.array,
        should_stop: Callable[[], bool],
    ) -> bool:
        paths, total = slot.paths, band.count * count
        if options.passes == 1:
            launch(film.clear_surfaces, total, [], [paths], self.device)
        launch(tracing.generate_paths, total, [slot.frame, filter_table, band.first, band.count], [paths], self.device)
        queue, living = slot.identity, total
        for bounce in range(BOUNCE_STOP):
            self.rays += living
            self._bounce(slot, scene, options, queue, living, bounce)
            if should_stop():
                return False
            queue, living = self.compact(slot, queue, living, bounce)
            if living == 0:
                break
        return True

    def _bounce(
        self, slot: _Slot, scene: Scene, options: Options, queue: wp.array, living: int, bounce: int,
    ) -> None:
        """Trace and shade one segment of every path in the queue.

        Launches are recorded once: packing the scene's struct anew for each would take longer than small kernels do.
        """
        if slot.recorded_for is None or slot.recorded_for[0] is not scene or slot.recorded_for[1] is not options:
            slot.commands, slot.recorded_for = {}, (scene, options)
        commands = slot.commands.get(queue.ptr)
        if commands is None:
            commands = slot.commands[queue.ptr] = self._record(slot, scene, options, queue)
        for command, bounce_index in commands:
            command.set_dim(living)
            if bounce_index >= 0:
                command.set_param_at_index(bounce_index, bounce)
            command.launch()

    def _record(
        self, slot: _Slot, scene: Scene, options: Options, queue: wp.array,
    ) -> list[tuple[wp.Launch, int]]:
        """Record the launches of one bounce: the path tracer's table of contents."""
        rays = [scene, queue]
        misses_of = [scene, options, queue]
        shadows = [scene, options, 0, queue]
        trace, trace_layers, trace_shadows, trace_shadow_layers = FLAT_RAYS if is_flat(scene) else ANY_RAYS
        steps = [(trace, rays)]
        if options.filtered == 1:
            steps += [(trace_layers, rays), (layers.filter_paths, rays)]
        steps += [
            (misses.shade_misses, misses_of), (materials.evaluate_materials, rays),
            (reference.shade_paths, [slot.frame, scene, options, queue]), (trace_shadows, shadows)]
        if options.filtered == 1:
            steps += [(trace_shadow_layers, shadows), (shadow_layers.weaken_shadow_rays, shadows)]
        if options.programs == 1:
            steps += [(shadow_lights.shade_lights, shadows)]
        return [
            (record(kernel, inputs, [slot.paths], self.device), 2 if inputs is shadows else -1)
            for kernel, inputs in steps]

    def compact(self, slot: _Slot, queue: wp.array, living: int, bounce: int) -> tuple[wp.array, int]:
        """Return the queue of the paths that go on, and their number."""
        following = slot.queues[bounce % 2]
        if not self.cuda:
            # Device arrays on the CPU are NumPy views of the same memory.
            going_on = queue.numpy()[:living]
            going_on = going_on[slot.paths.state.numpy()[going_on] != int(ENDED)]
            following.numpy()[: len(going_on)] = going_on
            return following, len(going_on)
        slot.counter.zero_()
        launch(compaction.append_living, living, [slot.paths.state, queue], [following, slot.counter], self.device)
        return following, int(slot.counter.numpy()[0])
