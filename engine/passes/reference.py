# SPDX-License-Identifier: GPL-3.0-or-later
"""Host side of the reference path tracer: bands of pixels, bounces until no path lives, sums on the film.

The frame's pixels are cut into bands. On CUDA a band is as many paths as fit the buffers (several samples a pixel
where the picture is small); on the CPU bands are small, one thread each, so that all cores work and a cancel is
answered within a tenth of a second. A band interrupted between samples goes on where it stopped.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ...kernels import (
    film,
    flat_paths,
    layers,
    layers_lean,
    light_split,
    misses,
    path_lists,
    reference,
    reference_film,
    reference_lean,
    reference_plain,
    tracing,
)
from ...kernels.media import Media
from ...kernels.paths import Options
from ...kernels.types import Scene
from ...kernels.volume_grids import Volumes
from ..clear_glass import path_scene
from ..device import launch, run_bands, thread_count
from ..lean import LeanPrograms
from ..structures import is_flat
from .film_buffers import FilmBuffers
from .material_steps import evaluate_step, full_steps
from .media import MEDIA_BYTES, fit_media
from .path_light import LightFilm
from .shadow_catcher import ShadowCatchers
from .shadow_steps import shadow_steps, shadows_may_wait
from .subsurface import below_step, exit_steps
from .wavefront import HIT_LISTS, Step, Wavefront, add_guides

if TYPE_CHECKING:
    from ..device_scene import DeviceScene

__all__ = ["Band", "ReferencePass", "hit_steps"]

CPU_BAND_PATHS = 4096, 16384
"""Fewest and most of a band on the processor: a round has its launches whatever its size, and a cancel waits for it"""
CPU_BANDS = 4
"""Bands for each thread, where the picture has enough pixels: threads wait for the last ones"""
CUDA_BATCH_PATHS = 1 << 23
"""Paths that keep a large GPU busy: small pictures take several samples at once up to this"""

PATH_BYTES = 544
"""Of one path's states and places in lists, its closure the largest of them"""

GUIDE_BYTES = 28
"""Of what it shows, where the picture is going to be denoised"""

MEMORY_SHARE = 0.25
"""Of the device's free memory that path states may take"""

WHOLE_PATHS, ENDING_PATHS = "paths", "ending paths"
"""Loops of a band"""

# Not a limit of the integrator: roulette ends every path long before, unless a scene keeps all light for ever.
BOUNCE_STOP = 4096


@dataclass
class Band:
    """A range of pixels with its own progress."""

    first: int
    count: int
    samples: int = 0


class ReferencePass:
    """Traces samples for a film."""

    name = "reference"

    def __init__(self, device: str):
        self.device = device
        self.cuda = wp.get_device(device).is_cuda
        self.catchers: ShadowCatchers | None = None
        """Where the scene has any; to be set before resize()"""
        self.bands: list[Band] = []
        self.slots: list[Wavefront] = []
        self.lock = threading.Lock()
        self.media: Media | None = None
        """Those of the scene that render() is given; None without any"""
        self.programs = LeanPrograms()
        """Of that scene's materials"""
        self.volumes: Volumes | None = None
        """What of them varies in space"""

    def resize(
        self, pixel_count: int, passes: bool, light: LightFilm | None = None, denoised: bool = False,
    ) -> None:
        """Cut the picture into bands and allocate path states for them, with what the passes of light need.

        `denoised`: whether films will have guides.
        """
        fewest, most = CPU_BAND_PATHS
        limit = min(max(pixel_count // (CPU_BANDS * thread_count()), fewest), most)
        if self.cuda:
            room = int(wp.get_device(self.device).free_memory * MEMORY_SHARE)
            state = (PATH_BYTES + MEDIA_BYTES + (GUIDE_BYTES if denoised else 0)) * (1 if self.catchers is None else 2)
            room //= state + (light.path_bytes if light else 0)
            limit = max(min(CUDA_BATCH_PATHS, room), 1 << 16)
        count = max(1, -(-pixel_count // limit))
        edges = np.linspace(0, pixel_count, count + 1).astype(int)
        self.bands = [Band(int(a), int(b - a)) for a, b in zip(edges[:-1], edges[1:], strict=True) if b > a]
        largest = max(band.count for band in self.bands)
        capacity = max(largest, min(limit, largest * 64)) if self.cuda else largest
        self.slots = []
        self.passes = passes
        self.light = light
        self.denoised = denoised
        self.capacity = capacity

    def reset(self) -> None:
        """Start counting samples anew."""
        for band in self.bands:
            band.samples = 0
        for slot in self.slots:
            slot.forget_rays()
        if self.catchers is not None:
            self.catchers.clear()

    def prepare(self, source: DeviceScene, pixels: int, options: Options) -> None:
        """Take in a scene's media and shadow catchers, for a picture of so many pixels; comes before render()."""
        self.take_scene(source)
        if self.catchers is not None:
            self.catchers.prepare(source, pixels, options)

    def take_scene(self, source: DeviceScene) -> None:
        """Take in what paths keep beside their states, or meet beside surfaces."""
        media = source.media
        self.media, self.volumes = (media.struct, media.volumes) if media is not None else (None, None)
        self.programs = source.material_table.lean

    def note_scene(self) -> None:
        """Take in that the scene has changed."""
        if self.catchers is not None:
            self.catchers.note_scene()

    @property
    def rays(self) -> int:
        """Return how many rays were traced since the last reset, shadow rays not counted. Waits for the device."""
        with self.lock:
            return sum(slot.rays for slot in self.slots)

    @property
    def samples_done(self) -> int:
        """Return how many samples every pixel has."""
        return min((band.samples for band in self.bands), default=0)

    def take_slot(self) -> Wavefront:
        """Return states for a band's paths that no other thread uses until they are given back."""
        with self.lock:
            slot = self.slots.pop() if self.slots else None
        if slot is None:
            slot = Wavefront(self.capacity, self.passes, self.device)
            if self.denoised:
                add_guides(slot.paths, self.capacity, self.device)
            if self.light:
                slot.light = self.light.make_paths(slot.paths, self.capacity)
            if self.catchers is not None:
                slot.catching = self.catchers.make_paths(self.capacity)
        fit_media(slot, self.media, self.volumes)
        slot.programs = self.programs
        return slot

    def give_slot(self, slot: Wavefront) -> None:
        """Give back what take_slot() returned."""
        with self.lock:
            self.slots.append(slot)

    def each_band(self, bands: list[Band], work: Callable[[Band], None]) -> None:
        """Do some work for each of these bands: one after the other on CUDA, on all cores on the processor."""
        if self.cuda:
            for band in bands:
                work(band)
        else:
            run_bands(partial(work, band) for band in bands)

    def in_batches(self, band: Band, first: int, last: int, trace: Callable[[Wavefront, int, int], None]) -> None:
        """Trace a band's samples `first` to `last` - 1, as many at a time as there are path states for.

        `trace` is called with states, the first sample and the number of samples of each batch.
        """
        slot = self.take_slot()
        try:
            while first < last:
                count = max(1, min(slot.capacity // band.count, last - first))
                trace(slot, first, count)
                first += count
        finally:
            self.give_slot(slot)

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
        scene = path_scene(scene, plain=not (self.light or self.media) and self.catchers is None)
        while (low := self.samples_done) < target and not should_stop():
            buffers.empty = False
            most = min(target - low, 64) if self.cuda else 1
            self.each_band(
                [band for band in self.bands if band.samples == low],
                lambda band, most=most: self._trace_band(
                    band, max(1, min(self.capacity // band.count, most)), scene, frame, options, filter_table, buffers,
                    target, should_stop))

    def resolve(self, buffers: FilmBuffers, transparent: bool, exposure: float) -> wp.array:
        """Make the picture of a film: vec4 [pixels]."""
        if self.catchers is not None:
            self.catchers.resolve(buffers.film, transparent, exposure, buffers.picture)
        else:
            launch(film.resolve_color, buffers.pixel_count, [buffers.film, int(transparent)], [buffers.picture],
                   self.device)
        return buffers.picture

    def _trace_band(
        self, band: Band, count: int, scene: Scene, frame: np.ndarray, options: Options,
        filter_table: wp.array, buffers: FilmBuffers, target: int, should_stop: Callable[[], bool],
    ) -> None:
        """Trace `count` of `target` samples of a band into the film; an interrupted batch leaves no trace."""
        if should_stop():
            return
        slot = self.take_slot()
        try:
            slot.expect(target)
            guides = buffers.guides if buffers.guides is not None and buffers.guides.wants(band.samples) else None
            if guides is not None:
                guides.begin(slot, band.count * count)
            if options.passes == 1:
                launch(film.clear_surfaces, band.count * count, [], [slot.paths], self.device)
            batch = frame, filter_table, (band.first, band.count), (band.samples, count), BOUNCE_STOP, should_stop
            # Pictures begin with whole paths and go on with those that end in the cache: both loops are kept.
            slot.keep_for(scene, WHOLE_PATHS, ENDING_PATHS)
            ended = slot.trace(
                WHOLE_PATHS if options.known.samples == 0 else ENDING_PATHS,
                (scene, options, slot.light and slot.light.film.scene_groups, self.media),
                lambda: path_steps(slot, scene, options), *batch,
                slot.media and (lambda total: slot.media.start(slot, scene, total)))
            if ended and self.catchers is not None:
                ended = self.catchers.trace(slot.catching, slot, path_steps, *batch)
            if ended:
                launch(
                    film.accumulate_samples, band.count,
                    [slot.paths, options, band.first, band.count, count, band.samples], [buffers.film], self.device)
                if guides is not None:
                    guides.add(slot, band.first, band.count, count)
                if buffers.light:
                    if slot.media:
                        slot.media.finish_light(slot.light, options.exposure, band.first, band.count, count)
                    buffers.light.add(slot.light, options.exposure, band.first, band.count, count)
                band.samples += count
            if self.cuda:
                # Callers time samples, and stop between them.
                wp.synchronize_stream(self.device)
        finally:
            self.give_slot(slot)


def hit_steps(slot: Wavefront, scene: Scene, options: Options) -> list[Step]:
    """Return what finds the paths' hits, adds the world, plays roulette and lists hits by what shades them."""
    if is_flat(scene):
        steps = [Step(flat_paths.trace_flat_paths, [scene, options.filtered], fills=("layered",))]
    else:
        steps = [Step(tracing.trace_paths, [scene])]
        if options.filtered == 1:
            steps += [Step(tracing.trace_layers, [scene]),
                      Step(path_lists.list_layered, [slot.paths], fills=("layered",), changes=False)]
    if options.filtered == 1:
        steps.append(Step(layers_lean.filter_paths_lean if options.lean_layers else layers.filter_paths, [scene],
                          over="layered"))
    return [*steps, Step(misses.shade_misses, [scene, options], fills=HIT_LISTS)]


def shading_steps(slot: Wavefront, scene: Scene, options: Options) -> list[Step]:
    """Return what shades the living paths' hits: lean ones, and beside them the others, which misses have listed."""
    shading = [slot.frame, scene, options]
    steps = [Step(reference_lean.shade_lean_paths, shading, fills=("next",), lane=1)]
    if not options.all_lean:
        steps.append(Step(reference_plain.shade_plain_paths, shading, over="plain_hits", fills=("next",), lane=2))
    if not options.all_plain:
        others, over = full_steps(slot, scene, shading)
        if options.subsurface == 1:
            others.append(below_step(shading, over))
        else:
            shade = reference_film.shade_film_paths if options.films else reference.shade_paths
            others.append(Step(shade, shading, over, fills=("next",)))
        steps += [replace(step, lane=3) for step in others]
    return steps


def path_steps(slot: Wavefront, scene: Scene, options: Options) -> list[Step]:
    """Return one segment of every path: the path tracer's table of contents."""
    shading, media, light = [slot.frame, scene, options], slot.media, slot.light
    if media:
        steps = [*media.hit_steps(scene, options, light), media.miss_step(scene, options)]
    else:
        steps = hit_steps(slot, scene, options)
    late = shadows_may_wait(slot, scene, options)
    if late:
        steps[:-1] = [replace(step, lane=1) for step in steps[:-1]]
    if light:
        steps[-1:-1] = [] if media else light.steps_before_misses(scene, options)
        steps += light.steps_before_shading(slot.rounds, evaluate_step(slot, scene, "first_hits"))
    if slot.catching:
        steps.append(slot.catching.step(scene, slot))
    steps += shading_steps(slot, scene, options)
    if media:
        steps.append(media.scatter_step(shading, slot.rounds))
    if options.passes == 1:
        steps.append(Step(light_split.weigh_seen_light, [options, slot.rounds]))
    if light:
        steps += light.steps_after_shading(scene, slot.rounds)
    steps += media.shadow_steps(slot, scene, options) if media else shadow_steps(slot, scene, options, late=late)
    if light:
        steps += light.steps_after_shadows(slot.rounds)
    return steps + exit_steps(slot, scene, options) if options.subsurface == 1 else steps
