# SPDX-License-Identifier: GPL-3.0-or-later
"""Host side of the reference path tracer: bands of pixels, bounces until no path lives, sums on the film.

The frame's pixels are cut into bands. On CUDA a band is as many paths as fit the buffers (several samples a pixel
where the picture is small); on the CPU bands are small, one thread each, so that all cores work and a cancel is
answered within a tenth of a second. A band interrupted between samples goes on where it stopped.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels import (
    compaction,
    film,
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
from ..device import run_bands

__all__ = ["FilmBuffers", "ReferencePass"]

CPU_BAND_PATHS = 4096
CUDA_BAND_PATHS = 1 << 22
CUDA_BATCH_PATHS = 1 << 21
"""Paths that keep a large GPU busy: small pictures take several samples at once up to this"""

# Bounces after which the counter of living paths is read back once a bounce.
FIRST_COUNT = 1

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
        ("pdf", float), ("kind", int), ("cone", wp.vec2), ("shadow_origin", wp.vec3), ("shadow_direction", wp.vec3),
        ("shadow_distance", float), ("shadow_light", wp.vec3), ("shadow_pending", int),
        ("shadow_emitter", wp.vec2i), ("shadow_barycentrics", wp.vec2), ("layer_t", float), ("layer", wp.vec2i),
        ("layer_barycentrics", wp.vec2), ("closure", Closure),
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
        buffers.rejected = _vectors(pixel_count, int, device)
        for name, dtype in (
            ("normal", wp.vec4), ("position", wp.vec4), ("uv", wp.vec4), ("depth", float), ("emission", wp.vec3),
            ("environment", wp.vec3),
        ):
            setattr(buffers, name, _vectors(extra, dtype, device))
        return FilmBuffers(buffers, _vectors(pixel_count, wp.vec4, device), pixel_count, passes)

    def clear(self) -> None:
        """Forget all samples."""
        for name in ("color", "color_rest", "rejected", "normal", "position", "uv", "depth", "emission", "environment"):
            getattr(self.film, name).zero_()


@dataclass
class _Band:
    """A range of pixels with its own progress."""

    first: int
    count: int
    samples: int = 0


@dataclass
class _Slot:
    """What one worker needs to trace paths."""

    paths: Paths
    identity: wp.array
    queues: tuple[wp.array, wp.array] | None
    counter: wp.array | None
    frame: wp.array
    capacity: int


class ReferencePass:
    """Traces samples for a film."""

    name = "reference"

    def __init__(self, device: str):
        self.device = device
        self.cuda = wp.get_device(device).is_cuda
        self.bands: list[_Band] = []
        self.slots: list[_Slot] = []
        self.lock = threading.Lock()
        self.rays = 0
        """Rays traced since the last reset (paths entering a trace, shadow rays not counted), CUDA only"""

    def resize(self, pixel_count: int, passes: bool) -> None:
        """Cut the picture into bands and allocate path states for them."""
        limit = CUDA_BAND_PATHS if self.cuda else CPU_BAND_PATHS
        count = max(1, -(-pixel_count // limit))
        edges = np.linspace(0, pixel_count, count + 1).astype(int)
        self.bands = [_Band(int(a), int(b - a)) for a, b in zip(edges[:-1], edges[1:], strict=True) if b > a]
        largest = max(band.count for band in self.bands)
        capacity = max(largest, min(CUDA_BATCH_PATHS, largest * 64)) if self.cuda else largest
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

    def _take_slot(self) -> _Slot:
        with self.lock:
            if self.slots:
                return self.slots.pop()
        identity = wp.array(np.arange(self.capacity, dtype=np.int32), dtype=int, device=self.device)
        queues = counter = None
        if self.cuda:
            queues = (wp.zeros(self.capacity, dtype=int, device=self.device),
                      wp.zeros(self.capacity, dtype=int, device=self.device))
            counter = wp.zeros(1, dtype=int, device=self.device)
        frame = wp.zeros(1, dtype=FrameData, device=self.device)
        return _Slot(make_paths(self.capacity, self.passes, self.device), identity, queues, counter, frame,
                     self.capacity)

    def _give_slot(self, slot: _Slot) -> None:
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
                def job(band: _Band) -> Callable[[], None]:
                    return lambda: self._trace_band(
                        band, 1, scene, frame, options, filter_table, buffers, should_stop)

                run_bands(job(band) for band in behind)

    def _trace_band(
        self, band: _Band, count: int, scene: Scene, frame: np.ndarray, options: Options,
        filter_table: wp.array, buffers: FilmBuffers, should_stop: Callable[[], bool],
    ) -> None:
        """Trace `count` samples of a band and add them to the film; an interrupted batch leaves no trace."""
        if should_stop():
            return
        slot = self._take_slot()
        try:
            row = frame.copy()
            row["sample"] = band.samples
            slot.frame.assign(row)
            if self._trace(slot, band, count, scene, options, filter_table, should_stop):
                wp.launch(
                    film.accumulate_samples, band.count,
                    [slot.paths, options, band.first, band.count, count, band.samples], [buffers.film],
                    device=self.device)
                band.samples += count
        finally:
            self._give_slot(slot)

    def _trace(
        self, slot: _Slot, band: _Band, count: int, scene: Scene, options: Options, filter_table: wp.array,
        should_stop: Callable[[], bool],
    ) -> bool:
        device = self.device
        paths, total = slot.paths, band.count * count
        if options.passes == 1:
            wp.launch(film.clear_surfaces, total, [], [paths], device=device)
        wp.launch(tracing.generate_paths, total, [slot.frame, filter_table, band.first, band.count], [paths],
                  device=device)
        queue, living = slot.identity, total
        for bounce in range(BOUNCE_STOP):
            self.rays += living
            wp.launch(tracing.trace_paths, living, [scene, queue], [paths], device=device)
            if options.filtered == 1:
                wp.launch(tracing.trace_layers, living, [scene, queue], [paths], device=device)
                wp.launch(layers.filter_paths, living, [scene, queue], [paths], device=device)
            wp.launch(misses.shade_misses, living, [scene, options, queue], [paths], device=device)
            wp.launch(materials.evaluate_materials, living, [scene, queue], [paths], device=device)
            wp.launch(reference.shade_paths, living, [slot.frame, scene, options, queue], [paths], device=device)
            wp.launch(tracing.trace_shadows, living, [scene, options, bounce, queue], [paths], device=device)
            if options.filtered == 1:
                wp.launch(tracing.trace_shadow_layers, living, [scene, options, bounce, queue], [paths], device=device)
                wp.launch(shadow_layers.weaken_shadow_rays, living, [scene, options, bounce, queue], [paths],
                          device=device)
            if options.programs == 1:
                wp.launch(shadow_lights.shade_lights, living, [scene, options, bounce, queue], [paths], device=device)
            if should_stop():
                return False
            if self.cuda:
                following = slot.queues[bounce % 2]
                slot.counter.zero_()
                wp.launch(compaction.append_living, living, [paths.state, queue], [following, slot.counter],
                          device=device)
                living, queue = int(slot.counter.numpy()[0]), following
            elif not (paths.state.numpy()[:total] != int(ENDED)).any():
                living = 0
            if living == 0:
                return True
        return True
