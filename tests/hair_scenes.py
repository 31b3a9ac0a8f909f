# SPDX-License-Identifier: GPL-3.0-or-later
"""Furry balls as plain data, for tests of real-time frames and of what they leave out."""

import numpy as np
from burnish.engine.hair import SIDES, Strands, make_tubes
from burnish.engine.mesh_features import STRAND
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import MaterialData, MeshData

__all__ = ["fur", "hair"]


def hair(absorption=(0.0, 0.0, 0.0), color=0.8, roughness=0.3, radial_roughness=0.4, emission=None, mixed=False):
    """Make a material that scatters light as hair, a surface of a color where nothing knows of hair.

    With `mixed` half of it is diffuse.
    """
    surface, twin = ProgramBuilder(), ProgramBuilder()
    share = 0.5 if mixed else 1.0
    for builder in (surface, twin):
        if mixed:
            builder.closure("DIFFUSE", 0.5, color=color)
        if emission is not None:
            builder.emit(emission, 1.0, 1.0)
    surface.closure("PRINCIPLED", share, color=color, roughness=roughness, ior=1.55, specular_level=0.5,
                    specular_tint=1.0, coat_ior=1.5, coat_tint=1.0, sheen_tint=1.0)
    strand = twin.vector("NORMALIZE", twin.attribute(STRAND))
    twin.closure("HAIR", share, color=1.0, strand=strand, roughness=roughness, ior=1.55,
                 radial_roughness=radial_roughness, absorption=absorption, tilt=0.035, primary_roughness=1.0)
    return MaterialData(
        name="hair", program=surface.finish(), hair=twin.finish(), has_emission=emission is not None)


def fur(strands=900, radius=0.011, length=0.25, seed=1):
    """Make hair around a ball of a radius of 0.4, without the ball."""
    random = np.random.default_rng(seed)
    roots = random.normal(size=(strands, 1, 3))
    roots /= np.linalg.norm(roots, axis=2, keepdims=True)
    t = np.linspace(0.0, 1.0, 4)[:, None]
    points = roots * (0.4 + length * t) + np.array([0.3, -0.2, 0.0]) * length * t ** 2
    radii = np.tile(radius * (1.0 - 0.7 * t[:, 0]), strands)
    tubes = make_tubes(Strands(
        points.reshape(-1, 3).astype(np.float32), radii.astype(np.float32), np.full(strands, 4)), 1)
    directions = np.ones((len(tubes.directions), 4), np.float32)
    directions[:, :3] = tubes.directions
    return MeshData(
        name="fur", positions=tubes.positions, triangles=tubes.triangles,
        material_slots=np.zeros(len(tubes.triangles), np.int32), corner_normals=tubes.normals[tubes.triangles],
        attributes={STRAND: directions[tubes.triangles // SIDES]})
