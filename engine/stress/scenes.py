# SPDX-License-Identifier: GPL-3.0-or-later
"""Small scenes of the stress test and of the other tests, made from plain data. Lengths in metres, lamps in watts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..materials import PRINCIPLED_DEFAULTS
from ..program import ProgramBuilder
from ..scene import (
    CameraData,
    CameraKind,
    ImageData,
    InstanceTable,
    Key,
    LightData,
    LightKind,
    MaterialData,
    MeshData,
    SceneDelta,
    Visibility,
    WorldData,
)

__all__ = [
    "EYE", "Placed", "StressScene", "balls_in_sky", "box", "changed", "emitter", "lamp", "look_at", "make_delta",
    "make_mesh", "make_scene", "make_table", "material", "place", "principled", "quad", "room", "scaled_and_moved",
    "sphere", "world",
]

EYE = np.eye(4)

BAKED_STEP = 1.0 / 1024.0
"""Metres: float32 holds its multiples up to 16 km"""


@dataclass
class StressScene:
    """A scene with its camera."""

    delta: SceneDelta
    camera: CameraData


@dataclass(frozen=True)
class Placed:
    """An object: names of its mesh and material, and where it is."""

    mesh: Key
    material: Key
    transform: np.ndarray
    visibility: int = int(Visibility.ALL)


# Meshes.


def make_mesh(positions: Any, triangles: Any, normals: Any = None, uvs: np.ndarray | None = None) -> MeshData:
    """Return a mesh: flat, or with `normals` by vertex; UVs [T, 3, 2]."""
    positions, triangles = np.asarray(positions, np.float32), np.asarray(triangles, np.int32).reshape(-1, 3)
    if normals is None:
        corners = positions[triangles].astype(np.float64)
        with np.errstate(all="ignore"):
            faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            faces /= np.maximum(np.linalg.norm(faces, axis=1, keepdims=True), 1e-300)
        corner_normals = np.repeat(faces[:, None], 3, 1)
    else:
        corner_normals = np.asarray(normals, np.float32)[triangles]
    return MeshData(
        name="mesh", positions=positions, triangles=triangles, material_slots=np.zeros(len(triangles), np.int32),
        corner_normals=np.ascontiguousarray(corner_normals, np.float32),
        uv_maps={} if uvs is None else {"UVMap": np.ascontiguousarray(uvs, np.float32)})


def quad(half: float = 1.0, steps: int = 1) -> MeshData:
    """Return a square facing +z of half a side `half`, cut into steps x steps, with UVs 0..1 and an attribute."""
    line = np.linspace(-half, half, steps + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(steps), np.arange(steps), indexing="ij")
    a = (i * (steps + 1) + j).ravel()
    b, c, d = a + steps + 1, a + steps + 2, a + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    made = make_mesh(points, triangles, uvs=(points[triangles, :2] / (2.0 * half) + 0.5))
    made.attributes["Col"] = np.ones((len(triangles), 3, 4), np.float32)
    return made


def sphere(radius: float = 1.0, rings: int = 24, smooth: bool = True) -> MeshData:
    """Return a ball with UVs, smooth or flat."""
    theta, phi = np.linspace(0.0, np.pi, rings + 1), np.linspace(0.0, 2.0 * np.pi, 2 * rings + 1)
    t, f = np.meshgrid(theta, phi, indexing="ij")
    points = np.stack([np.sin(t) * np.cos(f), np.sin(t) * np.sin(f), np.cos(t)], -1).reshape(-1, 3)
    points[np.abs(points) < 1e-12] = 0.0
    columns = 2 * rings + 1
    i, j = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    a = (i * columns + j).ravel()
    b = a + columns
    upper, lower = np.stack([a, b, a + 1], 1), np.stack([a + 1, b, b + 1], 1)
    triangles = np.concatenate([upper[2 * rings:], upper[:2 * rings], lower[:-2 * rings]])
    uv = np.stack([f / (2.0 * np.pi), t / np.pi], -1).reshape(-1, 2)
    corners = points[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    triangles = triangles[area > 1e-9]
    return make_mesh(points * radius, triangles, normals=points if smooth else None, uvs=uv[triangles])


def box(low: Sequence[float], high: Sequence[float], *, inward: bool = False) -> MeshData:
    """Return a flat box by its corners."""
    unit = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    points = np.asarray(low, float) + unit * (np.asarray(high, float) - np.asarray(low, float))
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))], np.int32)
    return make_mesh(points, triangles[:, ::-1] if inward else triangles)


# Materials, lights, cameras.


def material(kind: str = "DIFFUSE", weight: Any = 1.0, emission: Any = 0.0, **arguments: Any) -> MaterialData:
    """Return a material of one closure with emission; an argument may be a function of the ProgramBuilder.

    A Principled BSDF scatters several times between its facets, unless `multiscatter` says otherwise.
    """
    builder = ProgramBuilder()
    values = {name: value(builder) if callable(value) else value for name, value in arguments.items()}
    if not (np.isscalar(emission) and emission == 0.0):
        builder.emit((emission,) * 3 if np.isscalar(emission) else emission, 1.0, 1.0)
    builder.closure(kind, weight, **{"multiscatter": kind == "PRINCIPLED", **values})
    return MaterialData(name=kind.lower(), program=builder.finish(), has_emission=builder.has_emission(),
                        constant_emission=builder.constant_emission() if builder.has_emission() else None)


def principled(weight: Any = 1.0, emission: Any = 0.0, **arguments: Any) -> MaterialData:
    """Return a Principled material; arguments that are not given are Blender's."""
    return material("PRINCIPLED", weight, emission, **{**PRINCIPLED_DEFAULTS, **arguments})


def emitter(radiance: Any, reflectance: float = 0.0) -> MaterialData:
    """Return a material that emits a radiance, the same everywhere; it is black unless it reflects too."""
    return material(weight=float(reflectance > 0.0), emission=radiance, color=reflectance)


def world(radiance: float | Sequence[float] = 0.0, build: Callable[[ProgramBuilder], None] | None = None) -> WorldData:
    """Return a world of constant radiance, or the one that `build` adds to a ProgramBuilder."""
    builder = ProgramBuilder()
    if build is not None:
        build(builder)
        return WorldData(name="world", program=builder.finish(), importance_resolution=256)
    color = (radiance,) * 3 if np.isscalar(radiance) else tuple(radiance)
    builder.emit(color, 1.0, 1.0)
    return WorldData(name="world", program=builder.finish(), constant=color)


def lamp(kind: LightKind | str, power: float, transform: np.ndarray | None = None, **fields: Any) -> LightData:
    """Return a white lamp."""
    return LightData(name=str(kind), kind=LightKind(kind), color=(power,) * 3,
                     transform=EYE.copy() if transform is None else transform, **fields)


def place(x: float = 0.0, y: float = 0.0, z: float = 0.0, scale: float = 1.0) -> np.ndarray:
    """Return a transform of a place and a scale."""
    matrix = np.eye(4)
    matrix[:3, :3] *= scale
    matrix[:3, 3] = x, y, z
    return matrix


def look_at(eye: Sequence[float], target: Sequence[float], size: tuple[int, int], width: float = 1.0,
            **fields: Any) -> CameraData:
    """Return a perspective camera without roll; `width` is the picture's at distance 1."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross((0.0, 0.0, 1.0) if abs(back[2]) < 0.999 else (0.0, 1.0, 0.0), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = right, np.cross(back, right), back, eye
    height = width * size[1] / size[0]
    fields.setdefault("clip_start", 1e-3)
    return CameraData(transform=tuple(matrix.ravel().tolist()),
                      window=(-width / 2, width / 2, -height / 2, height / 2), **fields)


# Scenes.


def make_table(objects: Sequence[Placed]) -> InstanceTable:
    """Return the table of objects."""
    meshes = list(dict.fromkeys(o.mesh for o in objects))
    sets = list(dict.fromkeys((o.material,) for o in objects)) or [(None,)]
    count = len(objects)
    return InstanceTable(
        mesh_keys=meshes, mesh_index=np.array([meshes.index(o.mesh) for o in objects], np.int32),
        transforms=np.array([o.transform for o in objects], np.float64).reshape(-1, 4, 4),
        object_keys=list(range(count)), object_names=[f"object {i}" for i in range(count)],
        object_name_index=np.arange(count, dtype=np.int32), material_sets=sets,
        material_set_index=np.array([sets.index((o.material,)) for o in objects], np.int32),
        visibility=np.array([o.visibility for o in objects], np.int32), pass_index=np.arange(count, dtype=np.int32),
        random_id=np.zeros(count, np.uint32), color=np.ones((count, 4), np.float32))


def make_delta(
    meshes: dict[Key, MeshData], objects: Sequence[Placed], materials: dict[Key, MaterialData],
    lights: Iterable[LightData] = (), background: WorldData | float = 0.0, images: dict[Key, ImageData] | None = None,
) -> SceneDelta:
    """Return all of a scene's parts."""
    return SceneDelta(
        full=True, meshes=meshes, instances=make_table(objects), materials=materials, lights=list(lights),
        world=background if isinstance(background, WorldData) else world(background), images=images or {})


def make_scene(
    meshes: dict[Key, MeshData], objects: Sequence[Placed], materials: dict[Key, MaterialData], camera: CameraData,
    *others: Any, **named: Any,
) -> StressScene:
    """Return a scene of its parts; further arguments as of `make_delta`."""
    return StressScene(make_delta(meshes, objects, materials, *others, **named), camera)


def changed(scene: StressScene, **fields: Any) -> StressScene:
    """Return the scene with other fields of its delta, or another `camera`."""
    camera = fields.pop("camera", scene.camera)
    return StressScene(replace(scene.delta, **fields), camera)


def balls_in_sky(materials: Sequence[MaterialData], size: tuple[int, int], radiance: float = 1.0) -> StressScene:
    """Return a row of balls under a constant sky, each of one material, seen along the horizon, filling the width."""
    count = len(materials)
    objects = [Placed("ball", i, place(i - 0.5 * (count - 1))) for i in range(count)]
    camera = CameraData(
        kind=CameraKind.ORTHOGRAPHIC, clip_start=1e-3, window=(
            -count / 2, count / 2, -count / 2 * size[1] / size[0], count / 2 * size[1] / size[0]),
        transform=look_at((0.0, -20.0, 0.0), (0.0, 0.0, 0.0), size).transform)
    return make_scene({"ball": sphere(0.45)}, objects, dict(enumerate(materials)), camera, background=radiance)


def checker(size: float = 0.5) -> MaterialData:
    """Return a matte checker board of squares of a side [m] in UVs of a plane 8 m wide: it scales with the plane."""
    builder = ProgramBuilder()
    coordinate = builder.vector("MULTIPLY", builder.uv(""), (8.0 / size, 8.0 / size, 0.0))
    shifted = builder.vector("ADD", coordinate, (0.13, 0.17, 0.19))
    pattern = builder.procedural("CHECKER", shifted)
    builder.closure("DIFFUSE", 1.0, color=builder.mix("MIX", pattern, (0.7, 0.65, 0.6), (0.25, 0.3, 0.35)))
    return MaterialData(name="checker", program=builder.finish())


def room(size: tuple[int, int], *, power: float = 60.0) -> StressScene:
    """Return the scene that most cases change: an open room with a metal, a glass and a matte thing and lamps."""
    meshes = {
        "floor": quad(4.0), "back": box((-2, 2, 0), (2, 2.25, 2.5)), "left": box((-2.25, -2, 0), (-2, 2, 2.5)),
        "block": box((-0.4375, -0.4375, 0), (0.4375, 0.4375, 1.0)), "ball": sphere(0.5), "panel": box(
            (1.875, -0.5, 0.5), (2, 0.5, 1.25))}
    materials = {
        "floor": checker(), "grey": material(color=0.7), "red": material(color=(0.65, 0.12, 0.1)),
        "metal": principled(color=(0.9, 0.8, 0.6), metallic=1.0, roughness=0.25),
        "glass": principled(color=1.0, transmission=1.0, roughness=0.0),
        "plastic": principled(color=(0.1, 0.3, 0.6), roughness=0.4), "panel": emitter((1.5, 2.0, 3.0))}
    objects = [
        Placed("floor", "floor", EYE), Placed("back", "grey", EYE), Placed("left", "red", EYE),
        Placed("block", "plastic", place(-0.75, 0.75)), Placed("ball", "metal", place(0.75, 0.75, 0.5)),
        Placed("ball", "glass", place(0.125, -0.25, 0.375, 0.75)), Placed("panel", "panel", EYE)]
    lamps = [
        lamp("AREA", power, place(0.0, 0.0, 2.5), shape="RECTANGLE", size_x=1.0, size_y=0.5),
        lamp("POINT", 0.25 * power, place(-1.5, -1.0, 1.75), radius=0.125),
        lamp("SPOT", power, place(1.0, -1.0, 3.0), radius=0.0625, spot_size=1.0, spot_blend=0.2)]
    camera = look_at((0.5, -3.5, 1.5), (0.0, 0.5, 0.625), size, 1.0)
    return make_scene(meshes, objects, materials, camera, lamps, 0.25)


def scaled_and_moved(
    scene: StressScene, scale: float = 1.0, offset: Sequence[float] = (0.0, 0.0, 0.0), *, baked: bool = False,
) -> StressScene:
    """Return a scene scaled about the world's origin, then moved; it looks the same from its camera.

    Args:
        scene: The scene.
        scale: Lamps' powers go with its square, so that radiance stays; suns and the world stay as they are.
        offset: Of everything [m].
        baked: Move vertices, in float32, instead of transforms, after bringing them to multiples of BAKED_STEP.
    """
    shift = np.asarray(offset, np.float64)
    delta = scene.delta
    table, meshes = delta.instances, dict(delta.meshes)
    transforms = table.transforms.copy()
    transforms[:, :3, :] *= scale
    if baked:
        meshes, keys = {}, []
        for row, matrix in enumerate(transforms):
            mesh = delta.meshes[table.mesh_keys[table.mesh_index[row]]]
            points = mesh.positions.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
            points = np.round(points / BAKED_STEP) * BAKED_STEP + shift
            meshes[row] = replace(mesh, positions=points.astype(np.float32))
            keys.append(row)
            transforms[row] = np.eye(4)
        table = replace(table, mesh_keys=keys, mesh_index=np.arange(len(keys), dtype=np.int32))
    else:
        transforms[:, :3, 3] += shift
    lights = [_scaled_lamp(light, scale, shift) for light in delta.lights]
    camera = scene.camera
    matrix = np.array(camera.transform, np.float64).reshape(4, 4)
    matrix[:3, 3] = matrix[:3, 3] * scale + shift
    window = camera.window
    if camera.kind == CameraKind.ORTHOGRAPHIC:
        window = tuple(edge * scale for edge in window)
    camera = replace(
        camera, transform=tuple(matrix.ravel().tolist()), window=window, clip_start=camera.clip_start * scale,
        clip_end=camera.clip_end * scale, aperture_radius=camera.aperture_radius * scale,
        focus_distance=camera.focus_distance * scale)
    return StressScene(
        replace(delta, meshes=meshes, instances=replace(table, transforms=transforms), lights=lights), camera)


def _scaled_lamp(light: LightData, scale: float, shift: np.ndarray) -> LightData:
    matrix = light.transform.copy()
    matrix[:3, 3] = matrix[:3, 3] * scale + shift
    factor = 1.0 if light.kind == LightKind.SUN else scale * scale
    return replace(light, transform=matrix, color=tuple(factor * c for c in light.color),
                   radius=light.radius * scale, size_x=light.size_x * scale, size_y=light.size_y * scale)
