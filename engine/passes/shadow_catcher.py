# SPDX-License-Identifier: GPL-3.0-or-later
"""Host side of shadow catchers: the scene without all else, and the paths that know it (kernels/shadow_catcher.py).

The catchers lie in acceleration structures of their own and are lit by all lamps, the world and what emits of
themselves; meshes, materials and images are the scene's. Scenes without catchers have none of this.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ...kernels import misses, shadow_catcher, types
from ...kernels.film import Film
from ...kernels.paths import Options
from ..device import launch
from ..emitters import find_emitters
from ..history import arrays_of, copy_struct
from ..light_linking import is_linked
from ..light_table import build_lights
from ..scene import Visibility
from ..structures import Structures
from .media import fit_media
from .wavefront import HIT_LISTS, Step, Wavefront

if TYPE_CHECKING:
    from ..device_scene import DeviceScene

__all__ = ["CatcherPaths", "ShadowCatchers", "shadow_pass"]

CATCHER = int(Visibility.SHADOW_CATCHER)


@dataclass
class CatcherPaths:
    """States of the second paths of a batch, and what is known of the first ones."""

    slot: Wavefront
    caught: shadow_catcher.Caught

    def step(self, scene: types.Scene, first: Wavefront) -> Step:
        """Return what notes, of the first paths, which of them have met catchers."""
        return Step(shadow_catcher.note_caught, [scene, first.paths, first.rounds], changes=False,
                    outputs=[self.caught])


class ShadowCatchers:
    """The catchers of one session: their scene, and the sums of one film."""

    def __init__(self, device: str, apart: bool = False) -> None:
        """`apart`: whether the shadow is a pass of its own, which the picture lacks."""
        self.device, self._apart = device, apart
        self._structures = Structures(device)
        self._scenes: tuple[types.Scene, types.Scene, Options] | None = None
        self._film: shadow_catcher.CatcherFilm | None = None
        self._key: tuple = ()

    def prepare(self, source: DeviceScene, pixels: int, options: Options) -> None:
        """Make the scene of the catchers alone, where there is none since the last change, and room for the sums."""
        if self._film is None or len(self._film.lit) != pixels:
            film = shadow_catcher.CatcherFilm()
            film.lit = wp.zeros(pixels, dtype=wp.vec4, device=self.device)
            film.alone = wp.zeros(pixels, dtype=wp.vec3, device=self.device)
            film.backdrop = wp.zeros(pixels, dtype=wp.vec3, device=self.device)
            self._film = film
        key = source.scene, options
        if len(self._key) != 2 or any(a is not b for a, b in zip(key, self._key, strict=True)):
            self._key, self._scenes = key, (*self._make(source), options)

    def note_scene(self) -> None:
        """Take in that the scene has changed, its struct or what lies behind it."""
        self._key = ()

    def clear(self) -> None:
        """Forget all samples."""
        if self._film is not None:
            for array in arrays_of(self._film):
                array.zero_()

    def _make(self, source: DeviceScene) -> tuple[types.Scene, types.Scene]:
        """Return the scene of the catchers alone, and that of the world alone."""
        table, plan = source.table, source.plan
        chosen = (table.visibility & CATCHER) != 0
        plan = replace(plan, mesh_index=np.where(chosen, plan.mesh_index, -1))
        rows = source.rows.copy()
        instances = wp.array(rows, dtype=types.Instance, device=self.device)
        self._structures.clear()
        self._structures.build(plan, source.store, instances, 1e30)
        self._structures.fill(rows, plan, source.store)
        instances.assign(rows)
        scene = copy_struct(source.scene)
        scene.geometry = copy_struct(source.scene.geometry)
        self._structures.write(scene.geometry)
        scene.geometry.instances = instances
        emitters = find_emitters(source.scene, plan, table, source.store, source.materials, self.device)
        power = source.environment_power if source.world is not None and source.world.sampling else 0.0
        scene.lights = build_lights(
            source.lamps, emitters, power, source.radius, self.device, tables=source.lamp_tables.array,
            linked=is_linked(source.lights, table, source.emitting))
        world = copy_struct(scene)
        world.lights = copy_struct(scene.lights)
        world.lights.lamp_count = 0
        return scene, world

    def make_paths(self, capacity: int) -> CatcherPaths:
        """Return what a batch of up to `capacity` paths needs."""
        caught = shadow_catcher.Caught()
        caught.caught = wp.zeros(capacity, dtype=int, device=self.device)
        for name in ("before", "weight", "backdrop"):
            setattr(caught, name, wp.zeros(capacity, dtype=wp.vec3, device=self.device))
        return CatcherPaths(Wavefront(capacity, False, self.device), caught)

    def trace(
        self, kept: CatcherPaths, first: Wavefront, path_steps: Callable[[Wavefront, types.Scene, Options], list[Step]],
        frame: np.ndarray, table: wp.array, pixels: tuple[int, int], samples: tuple[int, int], limit: int,
        should_stop: Callable[[], bool],
    ) -> bool:
        """Trace a batch once more among the catchers and add it to the sums; return whether it came to the end.

        Args:
            kept: Of the batch.
            first: The batch, traced among all things.
            path_steps: Returns a round of the path tracer.
            frame: As of Wavefront.trace(), with all that follow.
            table: Inverse distribution of the pixel filter.
            pixels: First pixel and how many.
            samples: First sample and how many.
            limit: Rounds at most.
            should_stop: Polled between rounds.
        """
        scene, world, options = self._scenes
        slot = kept.slot
        media = first.media and first.media.media
        fit_media(slot, media, first.media and first.media.volumes)
        slot.programs = first.programs
        if not options.transparent:
            slot.trace("backdrop", (world, options), lambda: [
                Step(shadow_catcher.miss_all, []), Step(misses.shade_misses, [world, options], fills=HIT_LISTS),
                Step(shadow_catcher.keep_backdrop, [slot.paths], changes=False, outputs=[kept.caught]),
            ], frame, table, pixels, samples, 1, should_stop)
        ended = slot.trace(
            "catchers", (scene, options, media),
            lambda: [Step(shadow_catcher.end_others, [kept.caught]), *path_steps(slot, scene, options)],
            frame, table, pixels, samples, limit, should_stop,
            slot.media and (lambda total: slot.media.start(slot, scene, total)))
        if ended:
            launch(shadow_catcher.add_caught, pixels[1],
                   [first.paths, slot.paths, kept.caught, *pixels, samples[1]], [self._film], self.device)
        return ended

    def resolve(self, film: Film, transparent: bool, exposure: float, picture: wp.array) -> None:
        """Make the picture: vec4 [pixels]."""
        launch(shadow_catcher.resolve_caught, len(picture),
               [film, self._film, int(transparent), int(self._apart), exposure], [picture], self.device)

    def shadow(self, film: Film) -> wp.array:
        """Return what is left of light on what lies behind the scene: vec3 [pixels], above 1 where there is more."""
        shadow = wp.empty(len(self._film.lit), dtype=wp.vec3, device=self.device)
        launch(shadow_catcher.resolve_shadow, len(shadow), [film, self._film], [shadow], self.device)
        return shadow

    def denoise(self, run: Callable[..., wp.array | None], picture: wp.array) -> wp.array | None:
        """Return a picture without noise, alpha included, where the shadow is; `run`: as FinalDenoise.run()."""
        denoised = run(traced=None, picture=picture)
        if denoised is not None and self._scenes[2].transparent:
            alpha = wp.empty_like(picture)
            launch(shadow_catcher.show_alpha, len(picture), [picture], [alpha], self.device)
            smooth = run(traced=None, picture=alpha)
            if smooth is None:
                return None
            launch(shadow_catcher.take_alpha, len(picture), [smooth], [denoised], self.device)
        return denoised


def shadow_pass(catchers: ShadowCatchers | None, film: Film) -> wp.array:
    """Return the pass Shadow Catcher: vec3 [pixels], 1 where there are no catchers."""
    if catchers is not None:
        return catchers.shadow(film)
    return wp.full(len(film.squares), wp.vec3(1.0), dtype=wp.vec3, device=film.squares.device)
