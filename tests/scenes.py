# SPDX-License-Identifier: GPL-3.0-or-later
"""Small scenes for tests, built from plain data without Blender."""

import functools
import os
from dataclasses import replace

import numpy as np
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import (
    CameraData,
    InstanceTable,
    LightData,
    MaterialData,
    MeshData,
    SceneDelta,
    Visibility,
    WorldData,
)
from burnish.engine.session import Session
from burnish.engine.settings import (
    Device,
    FilmSettings,
    Integrator,
    LightPathSettings,
    PixelFilter,
    RenderSettings,
    SamplingSettings,
)

SETTINGS = RenderSettings(
    device=Device(os.environ.get("BURNISH_TEST_DEVICE", "cpu")), film=FilmSettings(pixel_filter=PixelFilter.BOX),
    sampling=SamplingSettings(integrator=Integrator.REFERENCE))
"""The reference integrator on the device that `pytest --device` names"""


def mesh(positions, triangles, normals=None, uvs=None):
    """Make a MeshData; without normals it is flat."""
    positions = np.asarray(positions, np.float32)
    triangles = np.asarray(triangles, np.int32)
    if normals is None:
        p = positions[triangles]
        n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-30)
        corner = np.repeat(n[:, None], 3, 1)
    else:
        corner = np.asarray(normals, np.float32)[triangles]
    return MeshData(
        name="mesh", positions=positions, triangles=triangles, material_slots=np.zeros(len(triangles), np.int32),
        corner_normals=np.ascontiguousarray(corner, np.float32), uv_maps={} if uvs is None else {"UVMap": uvs})


def quad(size=2.0, z=0.0):
    """Make a square of half side `size` facing +z, with UVs 0..1."""
    p = [[-size, -size, z], [size, -size, z], [size, size, z], [-size, size, z]]
    uv = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32)
    return mesh(p, [[0, 1, 2], [0, 2, 3]], uvs=uv)


def sphere(radius=1.0, rings=48, smooth=True):
    """Make a latitude-longitude sphere."""
    theta = np.linspace(0, np.pi, rings + 1)
    phi = np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False)
    t, f = np.meshgrid(theta, phi, indexing="ij")
    p = np.stack([np.sin(t) * np.cos(f), np.sin(t) * np.sin(f), np.cos(t)], -1).reshape(-1, 3)
    columns = 2 * rings
    i, j = np.meshgrid(np.arange(rings), np.arange(columns), indexing="ij")
    a, b = i * columns + j, i * columns + (j + 1) % columns
    faces = np.stack([np.stack([a, a + columns, b], -1), np.stack([b, a + columns, b + columns], -1)], 2).reshape(-1, 3)
    area = np.linalg.norm(np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]), axis=1)
    return mesh(p * radius, faces[area > 1e-9], normals=p if smooth else None)


def box(size=1.0, inward=False):
    """Make a cube of half side `size`."""
    p = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32) * size
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    return mesh(p, faces[:, ::-1] if inward else faces)


def material(kind="DIFFUSE", **arguments):
    """Make a material of one closure, its kind and inputs named as ProgramBuilder.closure names them."""
    builder = ProgramBuilder()
    builder.closure(kind, 1.0, **arguments)
    return MaterialData(name=kind, program=builder.finish())


def emitter(radiance, reflectance=0.0):
    """Make a material that emits the same radiance everywhere."""
    builder = ProgramBuilder()
    builder.emit((radiance,) * 3, 1.0, 1.0)
    if reflectance:
        builder.closure("DIFFUSE", 1.0, color=reflectance)
    return MaterialData(
        name="emitter", program=builder.finish(), has_emission=True, constant_emission=(radiance,) * 3)


def transparent(weight, kind="DIFFUSE", **arguments):
    """Make a material that lets `weight` of the light through."""
    builder = ProgramBuilder()
    builder.transparent((1.0, 1.0, 1.0), weight)
    builder.closure(kind, 1.0 - weight, **arguments)
    return MaterialData(name="transparent", program=builder.finish(), has_transparency=True)


@functools.cache
def world(radiance=0.0):
    """Make a world of constant radiance."""
    builder = ProgramBuilder()
    builder.emit((radiance,) * 3, 1.0, 1.0)
    return WorldData(name="world", program=builder.finish(), constant=(radiance,) * 3)


def place(x=0.0, y=0.0, z=0.0, scale=1.0):
    """Make a transform."""
    matrix = np.eye(4)
    matrix[:3, :3] *= scale
    matrix[:3, 3] = x, y, z
    return matrix


def instances(objects):
    """Make a table of (mesh key, transform, material key[, visibility])."""
    keys = list(dict.fromkeys(o[0] for o in objects))
    sets = list(dict.fromkeys((o[2],) for o in objects)) or [(None,)]
    count = len(objects)
    return InstanceTable(
        mesh_keys=keys, mesh_index=np.array([keys.index(o[0]) for o in objects], np.int32),
        transforms=np.array([o[1] for o in objects], np.float64).reshape(-1, 4, 4), object_keys=list(range(count)),
        object_names=[f"object {i}" for i in range(count)], object_name_index=np.arange(count, dtype=np.int32),
        material_sets=sets, material_set_index=np.array([sets.index((o[2],)) for o in objects], np.int32),
        visibility=np.array([o[3] if len(o) > 3 else int(Visibility.ALL) for o in objects], np.int32),
        pass_index=np.arange(count, dtype=np.int32), random_id=np.zeros(count, np.uint32),
        color=np.ones((count, 4), np.float32))


def delta(meshes, objects, materials, lights=(), background=0.0):
    """Make a full SceneDelta."""
    return SceneDelta(
        full=True, meshes=meshes, instances=instances(objects), materials=materials, lights=list(lights),
        world=background if isinstance(background, WorldData) else world(background))


def lamp(kind, strength, matrix=None, **fields):
    """Make a white lamp."""
    return LightData(name=kind, kind=kind, color=(strength,) * 3,
                     transform=np.eye(4) if matrix is None else matrix, **fields)


def camera_above(height=3.0, half=0.5, orthographic=True, **fields):
    """Make a camera that looks down from z = height, seeing [-half, half]^2 of the plane z = 0."""
    window = (-half, half, -half, half) if orthographic else tuple(w / height for w in (-half, half, -half, half))
    fields.setdefault("clip_start", 1e-3)
    return CameraData(
        kind="orthographic" if orthographic else "perspective",
        transform=tuple(place(z=height).ravel()), window=window, **fields)


def render(scene_delta, camera=None, size=(8, 8), samples=64, settings=SETTINGS, passes=("Combined",), **paths):
    """Render a delta and return the Combined picture [h, w, 4] (and the session where passes are asked for)."""
    if paths:
        settings = replace(settings, light_paths=LightPathSettings(**paths))
    session = Session(settings)
    session.update(scene_delta)
    session.configure(settings, camera or camera_above(), *size, passes=passes)
    session.step(samples)
    return (session.read(), session) if passes != ("Combined",) else session.read()
