# SPDX-License-Identifier: GPL-3.0-or-later
"""Participating media: what extraction says of them, and all of a scene's as the path tracer's kernels read them."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ..kernels.media import Media, Medium, Phase
from ..kernels.types import LIGHT_SUN
from ..kernels.volume_grids import Volumes
from .fog import Bodies, FogData, fog_data
from .history import copy_struct
from .program import Program
from .volume_program import VaryingData

if TYPE_CHECKING:
    from .device_scene import DeviceScene

__all__ = ["MediumData", "PhaseData", "SceneMedia", "scene_media"]

Color = tuple[float, float, float]

COEFFICIENT_MAX = 1e20
"""[1/m]; what is denser is opaque at any scale, and sums of such still fit a float"""

REACH_SHARE = 0.25
"""Of the scene's radius, how far from its lights a place is near them at least"""

ANISOTROPY_MAX = 0.999
"""As Cycles has it: beyond it nothing is scattered but straight on or back"""


@dataclass(frozen=True)
class PhaseData:
    """One way in which a medium scatters, after Henyey and Greenstein."""

    scattering: Color
    """[1/m]"""
    anisotropy: float = 0.0


@dataclass(frozen=True)
class MediumData:
    """A medium, in world space; what follows is all of it where it is homogeneous, else an estimate of its mean."""

    extinction: Color = (0.0, 0.0, 0.0)
    """What absorption and scattering take away [1/m]"""
    emission: Color = (0.0, 0.0, 0.0)
    """Radiance per metre"""
    phases: tuple[PhaseData, ...] = ()
    varying: VaryingData | None = None
    """Its coefficients where they vary in space"""
    in_grids: VaryingData | None = None
    """The same in volume objects, whose grids they read"""

    def __bool__(self) -> bool:
        return any((*self.extinction, *self.emission)) or self.varying is not None

    @property
    def varies(self) -> bool:
        """Return whether it does in space."""
        return self.varying is not None or self.in_grids is not None

    @property
    def thickness(self) -> tuple[float, float]:
        """Return how often light is scattered over a metre, and how often as it were to any direction: about."""
        # What goes straight on is hardly scattered.
        return (max((max(phase.scattering) for phase in self.phases), default=0.0),
                max((max(phase.scattering) * (1.0 - max(phase.anisotropy, 0.0)) for phase in self.phases), default=0.0))

    def thickness_of(self, extinction: float) -> tuple[float, float]:
        """Return the same where it varies and has a largest extinction [1/m]."""
        mean = sum(self.extinction) / 3.0
        return tuple(x * extinction / mean if mean > 0.0 else extinction for x in self.thickness)

    @property
    def programs(self) -> list[Program]:
        """Return all programs of its coefficients."""
        return [part.program for each in (self.varying, self.in_grids) if each is not None
                for part in each.fields if part.program is not None]


@dataclass(frozen=True)
class SceneMedia:
    """All media of a scene on the device."""

    struct: Media
    frames: Media | None
    """As real-time frames have those within surfaces; None where no object has any"""
    fog: FogData | None
    """What is seen by itself: the world's, and those within boundaries without a surface; None without any"""
    made_for: tuple
    volumes: Volumes | None = None
    """What varies in space; None: nothing does"""


def scene_media(source: DeviceScene, images_changed: bool = False) -> SceneMedia | None:
    """Return the media of a scene's world and of what is drawn in it, the same as before if they are; None without."""
    table, world = source.table, source.world.medium if source.world is not None else None
    keys = {key for keys in table.material_sets for key in keys}
    found = {key: data.medium for key in keys if (data := source.materials.get(key)) is not None and data.medium}
    if not found and not world:
        return None
    filled = np.array([any(key in found for key in keys) for keys in table.material_sets], bool)
    drawn = source.drawn & filled[table.material_set_index] if len(source.drawn) else np.zeros(0, bool)
    if not drawn.any() and not world:
        return None
    bare = np.array([any(key in found and source.materials[key].bare for key in keys)
                     for keys in table.material_sets], bool)
    walls = drawn & bare[table.material_set_index] if len(drawn) else drawn
    low, high = (bounds[drawn] for bounds in (source.low, source.high))
    # Nothing is between bounds the wrong way round.
    bounds = (tuple(low.min(0)), tuple(high.max(0))) if len(low) else ((1.0,) * 3, (-1.0,) * 3)
    places = {source.material_table.index(key): medium for key, medium in found.items()}
    alone = sorted(place for key, place in ((key, source.material_table.index(key)) for key in found)
                   if source.materials[key].bare)
    made_for = places, world, len(source.material_table.indices), alone
    before = source.media
    if before is not None and before.made_for == made_for:
        media, frames, fog = copy_struct(before.struct), before.frames, before.fog
    else:
        media = _upload(places, world or None, len(source.material_table.indices), source.device)
        frames = fog = None
    media.low, media.high = (wp.vec3(*bound) for bound in bounds)
    middle, media.reach = light_reach(source, [*found.values(), world])
    media.middle = wp.vec3(*middle)
    kept = len(low) > int(walls.sum())
    if kept and frames is None:
        frames = copy_struct(media)
        frames.world, frames.low, frames.high = -1, wp.vec3(), wp.vec3()
        if alone:
            frames.of_material = without(media.of_material, alone)
    rows = {place: (row, medium) for row, (place, medium) in enumerate(places.items())}
    volumes = source.volumes.update(source, rows, world or None, images_changed)
    fogged = bool(world) or bool(walls.any())
    if fogged:
        lit = (middle, media.reach) if media.reach > 0.0 else ((0.0, 0.0, 0.0), source.radius)
        bodies = Bodies(source.low[walls], source.high[walls], _thickness(source, found)[
            table.material_set_index[walls]] if walls.any() else np.zeros((0, 2)))
        fog = fog_data(
            media, alone, world or None, bodies, lit, source.radius,
            source.volumes.thickness.get(None, world.thickness if world else (0.0, 0.0)), fog, volumes)
    return SceneMedia(media, frames if kept else None, fog if fogged else None, made_for, volumes)


def _thickness(source: DeviceScene, found: Mapping[Hashable, MediumData]) -> np.ndarray:
    """Return the thickness of what has no surface, as `MediumData` has it, by set of materials: float64 [n, 2]."""
    rows = np.zeros((len(source.table.material_sets), 2))
    for row, keys in zip(rows, source.table.material_sets, strict=True):
        for key in keys:
            if key in found and source.materials[key].bare:
                here = source.volumes.thickness.get(source.material_table.index(key), found[key].thickness)
                row[:] = np.maximum(row, np.nan_to_num(np.array(here)))
    return rows


def without(of_material: wp.array, places: list[int]) -> wp.array:
    """Return media by material with none for some of the materials."""
    rows = of_material.numpy().copy()  # a processor's is no copy
    rows[places] = -1
    return wp.array(rows, dtype=int, device=of_material.device)


def light_reach(source: DeviceScene, media: list[MediumData | None]) -> tuple[tuple[float, ...], float]:
    """Return middle and radius [m] of a sphere about all lights with a place; radius 0 where media shine everywhere.

    At least a part of the scene's own size: surfaces about lights give light back.
    """
    if any(medium and any(medium.emission) for medium in media):
        return (0.0, 0.0, 0.0), 0.0
    places = source.lamps["position"][source.lamps["kind"] != int(LIGHT_SUN)].reshape(-1, 3)
    points = np.concatenate([places, source.emitters.low, source.emitters.high]).astype(np.float64)
    if not len(points) or not np.isfinite(points).all():
        return (0.0, 0.0, 0.0), 0.0
    low, high = points.min(0), points.max(0)
    radius = max(float(0.5 * np.linalg.norm(high - low)), REACH_SHARE * source.radius)
    return tuple(0.5 * (low + high)), radius


def _upload(places: dict[int, MediumData], world: MediumData | None, materials: int, device: str) -> Media:
    """Return media by material and that of the world, on the device; without bounds."""
    rows = np.full(materials, -1, np.int32)
    records, phases = [], []
    for place, medium in [*places.items(), *([(None, world)] if world else [])]:
        if place is not None:
            rows[place] = len(records)
        records.append((medium.extinction, medium.emission, len(phases), len(medium.phases)))
        phases.extend(medium.phases)
    media = Media()
    media.world = len(records) - 1 if world else -1
    media.of_material = wp.array(rows, dtype=int, device=device)
    media.media = _rows(Medium, records, device)
    media.phases = _rows(Phase, [(each.scattering, each.anisotropy) for each in phases], device)
    return media


def _rows(kind: type, values: list[tuple], device: str) -> wp.array:
    """Return structs with these fields on the device, at least one."""
    rows = np.zeros(max(len(values), 1), kind.numpy_dtype())
    for row, fields in zip(rows, values, strict=False):
        for name, value in zip(rows.dtype.names, fields, strict=True):
            limit = ANISOTROPY_MAX if name == "anisotropy" else COEFFICIENT_MAX
            row[name] = np.clip(np.nan_to_num(np.asarray(value, np.float64)), -limit, limit)
    return wp.array(rows, dtype=kind, device=device)
