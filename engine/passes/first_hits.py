# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of the first surfaces, gathered by launches of their own: Mist, Vector, Cryptomatte, AOVs, occlusion, shadow.

That happens when they are read, for both integrators alike: their kernels know nothing of it. Without these passes
nothing is allocated.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from ...kernels import first_hits
from ...kernels.motion import Motion
from ...kernels.paths import Options
from ...kernels.types import FrameData
from ..cryptomatte import DEFAULT_MATERIAL, manifest, matte_ids
from ..device import launch, run_bands
from ..device_scene import DeviceScene
from ..frame_data import frame_row
from ..history import arrays_of
from ..pass_names import FIRST_HIT_PASSES, MATTE_KINDS, OCCLUSION, SHADOW, first_hit_channels
from ..program import Program
from ..scene import CameraData, FrameMotion, WorldData
from .first_rays import LampShadow, Occlusion
from .reference import ReferencePass

__all__ = ["FirstHits"]

SAMPLES = 16, 64
"""Fewest and most rays a pixel: else as many as the picture has samples"""
BATCH_SAMPLES = 16
CPU_BAND = 4096
"""Pixels"""
WITHOUT_WORLD = WorldData(name="", program=Program())
"""Its settings count where a scene has no world"""


class FirstHits:
    """What a session has of these passes."""

    def __init__(self, device: str):
        self.device = device
        self.occlusion, self.shadow = Occlusion(device), LampShadow(device)
        self.launches = 0
        """Since the passes were chosen"""
        self.alpha_threshold = 0.5
        """Alpha from which on a surface hides the shader AOVs of those behind it, 0: any"""
        self.motion: tuple[FrameMotion, FrameMotion] | None = None
        """The frames before and after, for the Vector pass; None: nothing moves"""
        self.manifests: dict[str, str] = {}
        """Names and hashes of everything that can be in a Cryptomatte pass, as JSON, by kind"""
        self._names: tuple[str, ...] = ()
        self._pixels = self._samples = self._slots = 0
        self._hits: first_hits.FirstHits | None = None
        self._kept: dict[str, np.ndarray] = {}

    @property
    def arrays(self) -> list[wp.array]:
        """Return what is allocated."""
        found = [] if self._hits is None else arrays_of(self._hits)
        return found + [rays.sums for rays in (self.occlusion, self.shadow) if rays.sums is not None]

    def configure(self, names: tuple[str, ...], pixels: int) -> None:
        """Choose the passes that will be read, and the number of pixels; allocates nothing."""
        names = tuple(name for name in names if first_hit_channels(name))
        if (names, pixels) != (self._names, self._pixels):
            self._names, self._pixels, self.launches = names, pixels, 0
            self.reset()

    def reset(self) -> None:
        """Forget everything: what is seen has changed."""
        self._hits, self._samples, self._kept, self.manifests = None, 0, {}, {}
        self.occlusion.reset()
        self.shadow.reset()

    def read(self, name: str, scene: DeviceScene, frame: np.ndarray, table: wp.array, samples: int,
             tracer: ReferencePass, options: Options) -> np.ndarray:
        """Return a pass: float32 [h * w, channels].

        Args:
            name: One of those chosen.
            scene: What is seen.
            frame: One FrameData row.
            table: Inverse distribution of the pixel filter.
            samples: How many the picture has.
            tracer: Traces occlusion and shadow; its bands are the picture's.
            options: The tracer's.

        Raises:
            KeyError: It was not chosen.
        """
        if name not in self._names:
            raise KeyError(name)
        if name == OCCLUSION:
            distance = (scene.world or WITHOUT_WORLD).occlusion_distance
            return self.occlusion.read(tracer, scene.scene, frame, options, table, samples, distance)
        if name == SHADOW:
            return self.shadow.read(tracer, scene.scene, frame, options, table, samples)
        fewest, most = SAMPLES
        wanted = min(max(samples, fewest), most)
        if self._samples < wanted:
            self._gather(scene, frame, table, wanted)
        if name == "Mist":
            return np.clip(1.0 - self._hits.mist.numpy() / self._samples, 0.0, 1.0)[:, None]
        if name == "Vector":
            return self._hits.motion.numpy() / np.maximum(self._hits.moving.numpy(), 1e-20)[:, None]
        if name not in FIRST_HIT_PASSES:
            number = self._values.index(name)
            found = self._hits.values.numpy()[number * self._pixels:(number + 1) * self._pixels]
            return (found / self._samples)[:, :first_hit_channels(name)]
        kind, number = name[:-2], int(name[-2:])
        return np.ascontiguousarray(self._ranked(kind)[:, 2 * number:2 * number + 2]).reshape(-1, 4)

    def _ranked(self, kind: str) -> np.ndarray:
        """Return ids and coverage of what is in each pixel, most covered first: float32 [h * w, slots, 2]."""
        if kind not in self._kept:
            found = getattr(self._hits, ARRAYS[kind]).numpy().reshape(self._pixels, self._slots, 2)
            # Not in place: on the processor these are the sums themselves.
            found = found * np.array([1.0, 1.0 / self._samples], np.float32)
            order = np.argsort(-found[..., 1], axis=1, kind="stable")
            self._kept[kind] = np.take_along_axis(found, order[..., None], 1)
        return self._kept[kind]

    def _gather(self, scene: DeviceScene, frame: np.ndarray, table: wp.array, wanted: int) -> None:
        if self._hits is None:
            self._allocate()
        self._kept = {}
        options, ids, values = self._options(scene), self._ids(scene), self._shader_values(scene)
        others = self._other_frames(scene, frame)
        frames = wp.array(frame, dtype=FrameData, device=self.device)
        band = self._pixels if wp.get_device(self.device).is_cuda else CPU_BAND

        def job(first: int, count: int, start: int) -> Callable[[], None]:
            return lambda: launch(
                first_hits.gather_first_hits, min(band, self._pixels - first),
                [first, scene.scene, frames, table, options, ids, values, others, start,
                 count], [self._hits], self.device)

        while self._samples < wanted:
            count = min(BATCH_SAMPLES, wanted - self._samples)
            jobs = [job(first, count, self._samples) for first in range(0, self._pixels, band)]
            run_bands(jobs)
            self.launches += len(jobs)
            self._samples += count

    def _allocate(self) -> None:
        """Make room for what is asked for."""
        mattes = [name for name in self._names if name.startswith(MATTE_KINDS)]
        self._slots = 2 * (1 + max((int(name[-2:]) for name in mattes), default=-1))
        hits = first_hits.FirstHits()
        hits.mist = wp.zeros(self._pixels if "Mist" in self._names else 0, dtype=float, device=self.device)
        for kind, name in ARRAYS.items():
            count = self._pixels * self._slots if self._wants(kind) else 0
            setattr(hits, name, wp.zeros(count, dtype=wp.vec2, device=self.device))
        moving = self._pixels if "Vector" in self._names else 0
        hits.motion = wp.zeros(moving, dtype=wp.vec4, device=self.device)
        hits.moving = wp.zeros(moving, dtype=float, device=self.device)
        hits.values = wp.zeros(self._pixels * len(self._values), dtype=wp.vec4, device=self.device)
        self._hits = hits

    @property
    def _values(self) -> list[str]:
        """Return the shader AOVs among the passes."""
        return [name for name in self._names if name not in FIRST_HIT_PASSES]

    def _wants(self, kind: str) -> bool:
        return any(name.startswith(kind) for name in self._names)

    def _options(self, scene: DeviceScene) -> first_hits.FirstHitOptions:
        mist = (scene.world or WITHOUT_WORLD).mist
        options = first_hits.FirstHitOptions()
        options.filtered = int(scene.structures.has_filtered)
        options.mist, options.motion = int("Mist" in self._names), int("Vector" in self._names)
        options.mist_start, options.mist_falloff = mist.start, mist.falloff
        options.mist_inverse = 1.0 / mist.depth if mist.depth > 0.0 else 0.0
        for kind, name in ARRAYS.items():
            setattr(options, name, int(self._wants(kind)))
        options.slots, options.pixels = self._slots, self._pixels
        return options

    def _shader_values(self, scene: DeviceScene) -> first_hits.ShaderValues:
        """Return where the programs of the shader AOVs begin."""
        values, table = first_hits.ShaderValues(), scene.material_table
        values.count, values.materials = len(self._values), len(table.indices) + 1
        none = np.full(values.materials, -1, np.int32)
        starts = [table.aov_starts.get(name, none) for name in self._values]
        values.starts = wp.array(np.concatenate([none[:0], *starts]), dtype=int, device=self.device)
        values.threshold = self.alpha_threshold
        return values

    def _other_frames(self, scene: DeviceScene, frame: np.ndarray) -> first_hits.OtherFrames:
        """Return cameras, transforms and positions of the frames before and after."""
        others, rows = first_hits.OtherFrames(), []
        for name, motion in zip(("before", "after"), self.motion or (None, None), strict=True):
            wanted = motion is not None and "Vector" in self._names
            setattr(others, name, other_frame(scene, motion if wanted else None, self.device))
            rows.append(camera_row(motion.camera, frame, scene.origin) if wanted else frame)
        others.cameras = wp.array(np.concatenate(rows), dtype=FrameData, device=self.device)
        return others

    def _ids(self, scene: DeviceScene) -> first_hits.MatteIds:
        """Return the ids of what is in the scene, and note the manifests."""
        ids, table = first_hits.MatteIds(), scene.table
        row_names = table.object_name_index
        for kind, names, rows in (
            ("CryptoObject", table.object_names, row_names),
            ("CryptoAsset", table.asset_names or table.object_names, row_names),
            ("CryptoMaterial", material_names(scene), None),
        ):
            values = np.zeros(0, np.float32)
            if self._wants(kind):
                self.manifests[kind] = manifest(names)
                values = matte_ids(names) if rows is None else matte_ids(names)[rows]
            setattr(ids, ARRAYS[kind], wp.array(values, dtype=float, device=self.device))
        return ids


ARRAYS = {"CryptoObject": "objects", "CryptoMaterial": "materials", "CryptoAsset": "assets"}
"""Where the kernels have each kind"""


def material_names(scene: DeviceScene) -> list[str]:
    """Return the names of the materials as the kernels number them."""
    return [DEFAULT_MATERIAL if key is None else scene.materials[key].name for key in scene.material_table.indices]


def camera_row(camera: CameraData, frame: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Return the row of another camera for the picture of `frame`."""
    width, height, *crop = (int(frame[name][0]) for name in (
        "width", "height", "crop_x", "crop_y", "crop_width", "crop_height"))
    return frame_row(camera, width, height, tuple(crop), 0, origin)


def other_frame(scene: DeviceScene, motion: FrameMotion | None, device: str) -> Motion:
    """Return where the scene's instances and vertices are in another frame; None: where they are now."""
    other = Motion()
    other.moved = wp.array([int(motion is not None)], dtype=int, device=device)
    if motion is None:
        other.previous_to_world = wp.zeros(0, dtype=wp.mat44, device=device)
        other.previous_positions = wp.zeros(0, dtype=wp.vec3, device=device)
        return other
    matrices, places = scene.rows["to_world"].copy(), {key: at for at, key in enumerate(motion.object_keys)}
    for row, key in enumerate(scene.table.object_keys):
        if key in places:
            matrix = motion.transforms[places[key]].copy()
            matrix[:3, 3] -= scene.origin
            matrices[row] = matrix
    other.previous_to_world = wp.array(matrices, dtype=wp.mat44, device=device)
    store = scene.store
    other.previous_positions = positions = store.positions.array
    for key, values in motion.positions.items():
        place = store.ranges.get(key)
        if place is not None and place.vertex_count == len(values):
            if other.previous_positions is positions:
                other.previous_positions = wp.clone(positions)
            wp.copy(other.previous_positions, wp.array(values, dtype=wp.vec3, device=device), place.vertex_start)
    return other
