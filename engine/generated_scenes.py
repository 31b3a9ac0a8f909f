# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes made from numbers, to measure how cost grows with one quantity while the rest of the picture stays the same.

A walled yard under an even sky, with bumpy stones in rows and lamps above them. More triangles make the stones finer,
more instances make them smaller and more, so that they cover the same ground; lamps share one total power. Knows
nothing of Blender.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from .measure_moving import fly
from .program import ProgramBuilder
from .scene import (
    AlphaMode,
    CameraData,
    ColorEncoding,
    ImageData,
    InstanceTable,
    LightData,
    LightKind,
    MaterialData,
    MeshData,
    SceneDelta,
    Visibility,
    WorldData,
)

__all__ = ["SceneRecipe", "generate_scene", "scene_flight"]

YARD = 10.0
"""Half side of the yard [m]"""
WALL = 3.0
"""Height of its walls [m]"""
COVER = 0.35
"""Radius of a stone by the distance to the next"""
TEXTURE_SIDE = 1024
"""Of each texture [px]; four bytes a texel"""
LAMP_POWER = 4000.0
"""Of all lamps together [W]"""
LAMP_SIZE = 0.05
"""Radius of all lamps' areas together as one sphere [m]"""
SKY = 0.15
STONE_FACES = 80
"""Triangles of a stone where stones are counted, not triangles"""
STRIPS = 64
"""Of the floor: so fine is its share that reflects"""
GLOSSY_ROUGHNESS = 0.15
SHARED = {"ior": 1.5, "specular_level": 0.0, "specular_tint": (1.0, 1.0, 1.0), "coat_ior": 1.5, "coat_tint": 1.0,
          "sheen_tint": 1.0, "sheen_roughness": 0.5}
"""Arguments of a Principled BSDF without a specular lobe"""


@dataclass(frozen=True, kw_only=True)
class SceneRecipe:
    """What a scene has how many of."""

    triangles: int = 100_000
    """Of all stones together; 0: STONE_FACES each"""
    instances: int = 64
    """Stones"""
    lamps: int = 4
    """Point lamps"""
    materials: int = 8
    """Different materials of the stones"""
    texture_bytes: int = 0
    """Of all textures together, in whole textures of 4 MiB"""
    glossy: float = 0.0
    """Share of the floor and the stones that reflects sharply"""


def generate_scene(recipe: SceneRecipe) -> SceneDelta:
    """Return a full delta of a recipe's scene; the same recipe gives the same scene."""
    textures = round(recipe.texture_bytes / (4 * TEXTURE_SIDE**2))
    count = max(recipe.materials, textures, 1)
    glossy = spread(recipe.glossy, count)
    materials = {f"stone {i}": stone_material(i, count, bool(glossy[i]), i % textures if textures else None)
                 for i in range(count)}
    materials |= {"floor": plain("floor", (0.55, 0.52, 0.5)), "mirror": plain("mirror", (0.8, 0.8, 0.8), glossy=True)}
    images = {f"texture {i}": texture(i) for i in range(textures)}
    meshes, table = place_stones(recipe, count)
    meshes["yard"] = yard_mesh(recipe.glossy)
    return SceneDelta(full=True, meshes=meshes, instances=table, materials=materials, images=images,
                      lights=lamps(recipe.lamps), world=sky())


def scene_flight(frames: int, size: tuple[int, int]) -> list[CameraData]:
    """Return the cameras of a flight through the yard, for a picture of this size [px]."""
    half = 0.5
    aspect = size[1] / size[0]
    pitch = math.radians(63.0)
    matrix = np.eye(4)
    matrix[:3, :3] = [[1.0, 0.0, 0.0], [0.0, math.cos(pitch), -math.sin(pitch)],
                      [0.0, math.sin(pitch), math.cos(pitch)]]
    matrix[:3, 3] = 0.0, -0.92 * YARD, 3.2
    camera = CameraData(transform=tuple(matrix.ravel().tolist()), window=(-half, half, -half * aspect, half * aspect))
    return fly(camera, near=1.5, middle=8.0, count=frames)


# Stones ------------------------------------------------------------------------------------------------------------


def stone_mesh(faces: int, seed: int = 0) -> MeshData:
    """Return a bumpy ball of radius 1 of about so many triangles, with UVs."""
    rings = max(3, round(math.sqrt(max(faces, 8) / 4.0)))
    columns = 2 * rings
    theta, phi = np.meshgrid(
        np.linspace(0.0, np.pi, rings + 1, dtype=np.float32),
        np.linspace(0.0, 2.0 * np.pi, columns + 1, dtype=np.float32), indexing="ij")
    direction = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    waves = np.random.default_rng(seed).normal(0.0, 5.0, (4, 3)).astype(np.float32)
    radius = 1.0 + 0.06 * np.sin(direction @ waves.T).sum(-1)
    points = (direction * radius[..., None]).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings, dtype=np.int32), np.arange(columns, dtype=np.int32), indexing="ij")
    corner = i * (columns + 1) + j
    upper = np.stack([corner, corner + columns + 1, corner + 1], -1)[1:]
    lower = np.stack([corner + 1, corner + columns + 1, corner + columns + 2], -1)[:-1]
    triangles = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)]).astype(np.int32)
    uv = np.stack([phi / (2.0 * np.pi), theta / np.pi], -1).reshape(-1, 2).astype(np.float32)
    normals = direction.reshape(-1, 3)
    return MeshData(
        name="stone", positions=np.ascontiguousarray(points, np.float32), triangles=triangles,
        material_slots=np.zeros(len(triangles), np.int32), corner_normals=normals[triangles],
        uv_maps={"UVMap": uv[triangles]})


def place_stones(recipe: SceneRecipe, materials: int) -> tuple[dict, InstanceTable]:
    """Return the stones' meshes and the table of all instances, the yard last.

    Where triangles are counted each stone has a mesh of its own, so that nothing is shared.
    """
    count = max(recipe.instances, 1)
    side = math.ceil(math.sqrt(count))
    rng = np.random.default_rng(7)
    step = 1.8 * YARD / side
    place = np.stack(np.divmod(np.arange(count), side), -1)[:, ::-1].astype(np.float64)
    center = (place + 0.5 + rng.uniform(-0.1, 0.1, (count, 2))) * step - 0.9 * YARD
    radius = COVER * step
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    transforms = np.tile(np.eye(4), (count + 1, 1, 1))
    cosine, sine = np.cos(angle), np.sin(angle)
    transforms[:-1, 0, 0], transforms[:-1, 0, 1] = radius * cosine, -radius * sine
    transforms[:-1, 1, 0], transforms[:-1, 1, 1] = radius * sine, radius * cosine
    transforms[:-1, 2, 2] = radius
    transforms[:-1, :2, 3], transforms[:-1, 2, 3] = center, 0.9 * radius
    if recipe.triangles > 0:
        mesh = stone_mesh(recipe.triangles // count)
        meshes = {f"stone {i}": mesh for i in range(count)}
        index = np.arange(count + 1, dtype=np.int32)
    else:
        meshes = {"stone": stone_mesh(STONE_FACES)}
        index = np.append(np.zeros(count, np.int32), np.int32(1))
    total = count + 1
    which = np.append(np.arange(count) % materials, materials).astype(np.int32)
    return meshes, InstanceTable(
        mesh_keys=[*meshes, "yard"], mesh_index=index, transforms=transforms, object_keys=list(range(total)),
        object_names=["stones", "yard"], object_name_index=np.append(np.zeros(count, np.int32), np.int32(1)),
        material_sets=[*((f"stone {i}",) for i in range(materials)), ("floor", "mirror")], material_set_index=which,
        visibility=np.full(total, int(Visibility.ALL), np.int32), pass_index=np.zeros(total, np.int32),
        random_id=np.zeros(total, np.uint32), color=np.ones((total, 4), np.float32))


def spread(share: float, count: int) -> np.ndarray:
    """Return int32 [count], 1 for a share of all, spread evenly: where the running share passes a whole number."""
    return np.diff(np.floor(np.arange(count + 1) * share + 1e-9)).astype(np.int32)


def yard_mesh(glossy: float) -> MeshData:
    """Return floor and walls, facing inwards; a share of the floor's strips has material slot 1."""
    edges = np.linspace(-YARD, YARD, STRIPS + 1)
    quads = [[(a, -YARD, 0.0), (b, -YARD, 0.0), (b, YARD, 0.0), (a, YARD, 0.0)]
             for a, b in zip(edges[:-1], edges[1:], strict=True)]
    corners = [(-YARD, -YARD), (YARD, -YARD), (YARD, YARD), (-YARD, YARD)]
    quads += [[(*b, 0.0), (*a, 0.0), (*a, WALL), (*b, WALL)]
              for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    points = np.array(quads, np.float32).reshape(-1, 3)
    first = 4 * np.arange(len(quads), dtype=np.int32)[:, None]
    triangles = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]], 1).reshape(-1, 3).astype(np.int32)
    p = points[triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    slots = np.zeros(len(quads), np.int32)
    slots[:STRIPS] = spread(glossy, STRIPS)
    return MeshData(
        name="yard", positions=points, triangles=triangles, material_slots=np.repeat(slots, 2),
        corner_normals=np.ascontiguousarray(np.repeat(normal[:, None], 3, 1), np.float32))


# Materials, lamps, sky ---------------------------------------------------------------------------------------------


def plain(name: str, color: tuple[float, float, float], *, glossy: bool = False) -> MaterialData:
    """Return a matte or a metallic material."""
    builder = ProgramBuilder()
    close(builder, color, glossy)
    return MaterialData(name=name, program=builder.finish())


def close(builder: ProgramBuilder, color: object, glossy: bool) -> None:
    """End a material with its closure."""
    if glossy:
        builder.closure("PRINCIPLED", 1.0, multiscatter=True, color=color, metallic=1.0, roughness=GLOSSY_ROUGHNESS,
                        **SHARED)
    else:
        builder.closure("DIFFUSE", 1.0, color=color)


def stone_material(index: int, count: int, glossy: bool, texture_index: int | None) -> MaterialData:
    """Return one of `count` materials: a colour of its own in stripes, or a texture."""
    builder = ProgramBuilder()
    hue = 2.0 * math.pi * (np.arange(3) / 3.0 + index / count)
    color = tuple((0.5 + 0.25 * np.cos(hue)).tolist())
    if texture_index is not None:
        color = builder.image(f"texture {texture_index}", builder.uv(""))
    else:
        along = builder.component(builder.uv(""), 0)
        stripe = builder.math("GREATER_THAN", builder.math("MULTIPLY", along, 1.0 + index % 7), 0.5)
        color = builder.mix("MIX", stripe, color, tuple(0.6 * c for c in color))
    close(builder, color, glossy)
    return MaterialData(name=f"stone {index}", program=builder.finish())


def texture(index: int) -> ImageData:
    """Return a texture of noise, different for each index."""
    return ImageData(name=f"texture {index}", pixels=np.roll(noise_texels(), (31 * index, 17 * index), (0, 1)),
                     encoding=ColorEncoding.LINEAR, alpha_mode=AlphaMode.NONE)


@functools.cache
def noise_texels() -> np.ndarray:
    """Return the texels of which each texture has its own shift."""
    return np.random.default_rng(0).integers(96, 224, (TEXTURE_SIDE, TEXTURE_SIDE, 4), np.uint8)


def lamps(count: int) -> list[LightData]:
    """Return point lamps spread evenly above the stones, of one total power and surface."""
    side = max(math.ceil(math.sqrt(count)), 1)
    made = []
    for i in range(count):
        matrix = np.eye(4)
        x, y = i % side, i // side
        matrix[:3, 3] = (x + 0.5) / side * 1.8 * YARD - 0.9 * YARD, (y + 0.5) / side * 1.8 * YARD - 0.9 * YARD, 3.5
        made.append(LightData(name=f"lamp {i}", kind=LightKind.POINT, transform=matrix, soft_falloff=False,
                              color=(LAMP_POWER / count,) * 3, radius=LAMP_SIZE / math.sqrt(count)))
    return made


def sky() -> WorldData:
    """Return an even sky."""
    builder = ProgramBuilder()
    builder.emit((SKY,) * 3, 1.0, 1.0)
    return WorldData(name="sky", program=builder.finish(), constant=(SKY,) * 3)
