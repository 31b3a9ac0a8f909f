# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair of particle systems, drawn as paths, to MeshData: which strands there are, and tubes around them, as in Cycles.

By Cycles' scene export (intern/cycles/blender/curves.cpp): children stand in for their parents, a viewport may show
fewer of them, and a strand has the UV and colours of the emitter where its root is. Main thread only; keeps nothing of
bpy.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import bpy
import numpy as np

from ...engine.hair import Strands, Tubes, make_tubes, needed_steps, spared_points, tapered
from ...engine.hair_info import along_strands, hair_attributes
from ...engine.report import Report
from ...engine.scene import MeshData
from ...engine.texels import srgb_to_linear
from .hair import thinned, tube_mesh

__all__ = ["extract_particle_hair", "has_particle_hair"]


@dataclass(eq=False)
class _System:
    """A particle system's strands."""

    modifier: bpy.types.ParticleSystemModifier
    system: bpy.types.ParticleSystem
    settings: bpy.types.ParticleSettings
    numbers: range
    """Of the strands among parents and, after these, children"""
    keys: int
    """Points of each strand"""


def has_particle_hair(owner: bpy.types.Object, mode: str) -> bool:
    """Tell whether an evaluated object has hair to draw; `mode` is its dependency graph's."""
    return len(owner.particle_systems) > 0 and next(_systems(owner, mode), None) is not None


def extract_particle_hair(owner: bpy.types.Object, mesh: bpy.types.Mesh, mode: str, name: str, slot_count: int,
                          report: Report, derived: frozenset[str] = frozenset()) -> MeshData:
    """Return tubes around all hair of an object, which may be none.

    Args:
        owner: Evaluated object.
        mesh: Its evaluated mesh.
        mode: The dependency graph's.
        name: For messages, such as `object 'Cat'`.
        slot_count: Material slots of the object.
        report: Takes what was left out or repaired.
        derived: Attributes of engine/hair_info.py that it shall have.
    """
    systems = list(_systems(owner, mode))
    counts = np.concatenate([np.full(len(each.numbers), each.keys, np.int64) for each in systems] or
                            [np.zeros(0, np.int64)])
    steps, every = thinned(counts, name, report)
    numbers = np.arange(len(counts))[::every]
    first = 0
    for each in systems:
        count = len(each.numbers)
        each.numbers = each.numbers[-first % every::every]
        first += count
    strands, along = _read_strands(systems, owner)
    tubes = make_tubes(strands, needed_steps(strands, steps))
    slots = np.concatenate([np.full(len(each.numbers), min(max(each.settings.material, 1), max(slot_count, 1)) - 1,
                                    np.int32) for each in systems] or [np.zeros(0, np.int32)])
    uv_maps, attributes = _of_emitter(systems, mesh, tubes)
    roots = np.zeros((len(strands.counts), 3))
    drawn = strands.counts > 0
    roots[drawn] = strands.points[(np.cumsum(strands.counts) - strands.counts)[drawn]]
    roots = 0.5 + 0.5 * (roots - np.array(mesh.texspace_location)) / np.array(mesh.texspace_size)
    attributes |= hair_attributes(derived, strands, tubes, numbers, along, roots)
    return tube_mesh(mesh.name, tubes, slots, uv_maps, attributes)


def _systems(owner: bpy.types.Object, mode: str) -> Iterator[_System]:
    """Yield what an evaluated object shows of its hair: none while it is edited."""
    if owner.mode in ('EDIT', 'PARTICLE_EDIT'):
        return
    final = mode == 'RENDER'
    for modifier in owner.modifiers:
        if modifier.type != 'PARTICLE_SYSTEM' or not (modifier.show_render if final else modifier.show_viewport):
            continue
        system = modifier.particle_system
        settings = system.settings
        if settings.type != 'HAIR' or settings.render_type != 'PATH':
            continue
        parents, children = len(system.particles), len(system.child_particles)
        if not final:
            children = int(np.float32(children) * np.float32(settings.display_percentage) / np.float32(100))
        first = parents if settings.child_type != 'NONE' and children else 0
        keys = 2 ** (settings.render_step if final else settings.display_step) + 1
        if settings.kink == 'SPIRAL':
            keys += settings.kink_extra_steps
        if parents + children > first:
            yield _System(modifier, system, settings, range(first, parents + children), keys)


def _read_strands(systems: list[_System], owner: bpy.types.Object) -> tuple[Strands, tuple[np.ndarray, np.ndarray]]:
    """Return all strands in object space, those without length empty, and what `along_strands` says of them."""
    points, radii, counts = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0, np.int64)]
    shares, lengths = [np.zeros(0)], [np.zeros(0)]
    for each in systems:
        settings = each.settings
        places = _read_points(each, owner)
        share, length = along_strands(places.reshape(-1, 3), np.full(len(places), each.keys))
        drawn = length > 0
        places, share = places[drawn], share.reshape(-1, each.keys)[drawn]
        scale = 0.5 * settings.radius_scale
        radius = tapered(settings.shape, scale * settings.root_radius, scale * settings.tip_radius, share)
        if settings.use_close_tip:
            radius[:, -1] = 0
        every = spared_points(places, radius) if len(places) else 1
        points.append(places[:, ::every].reshape(-1, 3))
        radii.append(radius[:, ::every].reshape(-1))
        counts.append(np.where(drawn, (each.keys - 1) // every + 1, 0))
        shares.append(share[:, ::every].reshape(-1))
        lengths.append(length)
    strands = Strands(np.concatenate(points).astype(np.float32), np.concatenate(radii).astype(np.float32),
                      np.concatenate(counts))
    return strands, (np.concatenate(shares), np.concatenate(lengths))


def _read_points(each: _System, owner: bpy.types.Object) -> np.ndarray:
    """Return float64 [C, keys, 3] in object space: a microsecond a point."""
    place, steps = each.system.co_hair, range(each.keys)
    numbers = chain.from_iterable(place(object=owner, particle_no=number, step=step)
                                  for number in each.numbers for step in steps)
    shape = (len(each.numbers), each.keys, 3)
    world = np.fromiter(numbers, np.float32, int(np.prod(shape))).reshape(shape)
    # Shorter strands end before the last step; Blender gives the world's origin for the rest.
    ended = ~world.any(2)
    ended[:, 0] = False
    if ended.any():
        last = np.maximum.accumulate(np.where(ended, 0, np.arange(each.keys)), axis=1)
        world = np.take_along_axis(world, last[..., None], axis=1)
    inverse = np.array(owner.matrix_world.inverted_safe(), np.float64)
    return world.astype(np.float64) @ inverse[:3, :3].T + inverse[:3, 3]


def _of_emitter(systems: list[_System], mesh: bpy.types.Mesh, tubes: Tubes,
                ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the emitter's UV maps (the one active for rendering first) and byte colours at the strands' roots."""
    if not len(tubes.triangles):
        return {}, {}
    strand = tubes.strand[tubes.triangles]
    layers = sorted(enumerate(mesh.uv_layers), key=lambda item: not item[1].active_render)
    uv_maps = {layer.name: _at_roots(systems, "uv_on_emitter", "uv_no", number, 2)[strand] for number, layer in layers}
    colors = [attribute.name for attribute in mesh.attributes
              if attribute.data_type == 'BYTE_COLOR' and attribute.domain == 'CORNER']
    attributes = {}
    for number, color in enumerate(colors):
        encoded = _at_roots(systems, "mcol_on_emitter", "vcol_no", number, 3)
        values = np.ones((len(encoded), 4), np.float32)
        values[:, :3] = srgb_to_linear(encoded)
        attributes[color] = values[strand]
    return uv_maps, attributes


def _at_roots(systems: list[_System], function: str, keyword: str, layer: int, components: int) -> np.ndarray:
    """Return float32 [C, components] of a layer of the emitter where each strand begins."""
    found = []
    for each in systems:
        read, particles = getattr(each.system, function), each.system.particles
        last = len(particles) - 1
        options = {"modifier": each.modifier, keyword: layer}
        try:
            numbers = chain.from_iterable(
                tuple(read(particle=particles[min(number, last)], particle_no=number, **options))[:components]
                for number in each.numbers)
            count = len(each.numbers) * components
            found.append(np.fromiter(numbers, np.float32, count).reshape(-1, components))
        except RuntimeError:
            # The mesh as it was when the modifier's turn came lacks the layer.
            found.append(np.zeros((len(each.numbers), components), np.float32))
    return np.concatenate(found)
