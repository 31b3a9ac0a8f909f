# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials at the ends of their ranges, and meshes of slivers, duplicates, flat and inverted triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ..scene import MaterialData, MeshData, SceneDelta
from ..settings import Integrator
from .cases import BOTH, Case, Trial, luminance
from .furnaces import ball_masks
from .scenes import (
    EYE,
    Placed,
    StressScene,
    balls_in_sky,
    box,
    lamp,
    look_at,
    make_mesh,
    make_scene,
    material,
    place,
    principled,
    quad,
    room,
    sphere,
)

__all__ = ["CASES"]

SIZE = (72, 12)
ROW = 6
"""Balls in a picture"""
ROOM_SIZE = (48, 32)
SAMPLES = {"quick": 12, "full": 256}


def extremes(roughnesses: Sequence[float]) -> dict[str, MaterialData]:
    """Return materials whose arguments are exactly at the ends of their ranges, or beyond."""
    found = {}
    for roughness in roughnesses:
        for name, arguments in {
            "plastic": {"color": 0.5}, "metal": {"color": 0.9, "metallic": 1.0},
            "glass": {"color": 1.0, "transmission": 1.0}, "coated": {"color": 0.5, "coat": 1.0},
            "sheen": {"color": 0.5, "sheen": 1.0, "sheen_roughness": roughness},
            "brushed": {"color": 0.9, "metallic": 1.0, "anisotropic": 1.0},
            "glass of IOR 1": {"color": 1.0, "transmission": 1.0, "ior": 1.0},
            "glass of IOR 1 + 1e-6": {"color": 1.0, "transmission": 1.0, "ior": 1.000001},
            "plastic with IOR 1": {"color": 0.5, "ior": 1.0}, "glass of IOR 0.5": {"transmission": 1.0, "ior": 0.5},
            "glass of IOR 1e3": {"color": 1.0, "transmission": 1.0, "ior": 1e3},
            "plastic of IOR 1e6": {"color": 0.5, "ior": 1e6}, "thin glass": {
                "color": 1.0, "transmission": 1.0, "thin_wall": 1.0},
        }.items():
            extra = {"coat_roughness": roughness} if name == "coated" else {}
            found[f"{name}, roughness {roughness:g}"] = principled(roughness=roughness, **arguments, **extra)
        for kind in ("GLOSSY", "GLASS", "REFRACTION"):
            found[f"{kind.lower()}, roughness {roughness:g}"] = material(
                kind, color=0.8, roughness=roughness, ior=1.0 if kind != "GLASS" else 1.5)
    return found


def albedos() -> dict[str, MaterialData]:
    """Return materials from black to far more than white."""
    found = {}
    for color in (0.0, 1e-30, 1.0, 1.5, 100.0, 1e20):
        found[f"diffuse of {color:g}"] = material(color=color)
        found[f"metal of {color:g}"] = principled(color=color, metallic=1.0, roughness=0.2)
        found[f"plastic of {color:g}"] = principled(color=color, roughness=0.3)
        found[f"glass of {color:g}"] = principled(color=color, transmission=1.0, roughness=0.1)
    return found


def run_materials(trial: Trial, integrator: Integrator, bright: bool) -> None:
    """Render balls of extreme materials under a white sky: not brighter than it, where they don't make light."""
    made = albedos() if bright else extremes(trial.choose((0.0, 1.0), (0.0, 1e-7, 1e-3, 1.0)))
    names = list(made)
    amount = trial.choose(4, 64) if bright else trial.choose(12, 256)
    for first in range(0, len(names), ROW):
        row = names[first:first + ROW]
        light = luminance(trial.render(balls_in_sky([made[name] for name in row], SIZE), integrator, amount, SIZE))
        for name, inside in zip(row, ball_masks(len(row), SIZE), strict=True):
            if not bright:
                trial.check(f"{name}: mean", light[inside].mean(), 0.97 if "of IOR 1," in name else 0.0, 1.03)


def run_bright_box(trial: Trial, integrator: Integrator) -> None:
    """Render closed boxes whose walls return as much light as they get, or more: paths must end."""
    for albedo in (1.0, 1.5):
        for kind in ({"metallic": 0.0, "roughness": 1.0}, {"metallic": 1.0, "roughness": 0.0}):
            wall = principled(color=albedo, emission=1.0, **kind)
            scene = make_scene({"box": box((-1, -1, -1), (1, 1, 1), inward=True)}, [Placed("box", "wall", EYE)],
                               {"wall": wall}, look_at((0.3, -0.8, 0.2), (-0.2, 1.0, -0.3), (12, 8), 1.4))
            picture = trial.render(scene, integrator, trial.choose(4, 32), (12, 8))
            trial.check(f"albedo {albedo:g} {kind}: mean", luminance(picture).mean(), 1.0, np.inf)


# Meshes.


def on_floor(mesh: MeshData, size: tuple[int, int] = ROOM_SIZE) -> StressScene:
    """Return a mesh in place of the floor, with a ball and two lamps."""
    lights = [lamp("AREA", 60.0, place(0.0, 0.0, 3.0), size_x=1.0),
              lamp("POINT", 20.0, place(-1.0, -1.0, 1.5), radius=0.125)]
    return make_scene(
        {"floor": mesh, "ball": sphere(0.5)},
        [Placed("floor", "grey", EYE), Placed("ball", "metal", place(0.5, 0.25, 0.5))],
        {"grey": material(color=0.6), "metal": principled(color=0.9, metallic=1.0, roughness=0.2)},
        look_at((0.0, -3.0, 2.0), (0.0, 0.0, 0.25), size, 0.9), lights, 0.2)


def slivers(half: float, count: int) -> MeshData:
    """Return a square cut into triangles that are `count` times longer than wide."""
    x = np.linspace(-half, half, count + 1)
    points = np.concatenate([np.stack([x, np.full_like(x, y), np.zeros_like(x)], 1) for y in (-half, half)])
    a = np.arange(count)
    b, c, d = a + 1, a + count + 2, a + count + 1
    return make_mesh(points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def joined(*meshes: MeshData) -> MeshData:
    """Return several meshes as one."""
    starts = np.cumsum([0] + [len(mesh.positions) for mesh in meshes])
    return replace(
        meshes[0], positions=np.concatenate([mesh.positions for mesh in meshes]),
        triangles=np.concatenate([mesh.triangles + np.int32(start) for mesh, start in zip(
            meshes, starts[:-1], strict=True)]),
        material_slots=np.concatenate([mesh.material_slots for mesh in meshes]),
        corner_normals=np.concatenate([mesh.corner_normals for mesh in meshes]), uv_maps={}, attributes={})


def turned_over(mesh: MeshData, normals: float = -1.0) -> MeshData:
    """Return a mesh whose triangles run the other way round; with `normals` 1 these stay, and contradict them."""
    return replace(mesh, triangles=np.ascontiguousarray(mesh.triangles[:, ::-1]), uv_maps={}, attributes={},
                   corner_normals=np.ascontiguousarray(mesh.corner_normals[:, ::-1] * np.float32(normals)))


def degenerate(mesh: MeshData) -> MeshData:
    """Return a mesh with triangles without area, of one point, on a line and with repeated corners, added."""
    flat = make_mesh([[0, 0, 1], [1, 0, 1], [2, 0, 1], [0, 0, 1], [1e-20, 0, 1], [0, 1e-20, 1]],
                     [[0, 1, 2], [0, 0, 0], [0, 3, 1], [1, 1, 2], [0, 4, 5]])
    return joined(mesh, flat)


def broken_normals(mesh: MeshData, value: float) -> MeshData:
    """Return a mesh whose normals are a value."""
    return replace(mesh, corner_normals=np.full_like(mesh.corner_normals, value))


def noisy_normals(mesh: MeshData) -> MeshData:
    """Return a mesh with normals in all directions, half of them into it."""
    rng = np.random.default_rng(1)
    normals = rng.normal(size=mesh.corner_normals.shape)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return replace(mesh, corner_normals=normals.astype(np.float32))


def run_meshes(trial: Trial, integrator: Integrator) -> None:
    """Find the picture of a plain floor with floors of slivers, duplicates and triangles without area."""
    amount = SAMPLES["quick" if trial.quick else "full"]
    plain = quad(2.0)
    expected = trial.render(on_floor(plain), integrator, amount, ROOM_SIZE)
    variants = {
        "slivers": slivers(2.0, 10000), "fine slivers": slivers(2.0, 200000), "doubled": joined(plain, quad(2.0)),
        "doubled, one turned over": joined(plain, turned_over(quad(2.0))), "turned over": turned_over(plain),
        "flat triangles": degenerate(plain), "zero normals": broken_normals(plain, 0.0),
        "NaN normals": broken_normals(plain, np.nan), "tiny normals": broken_normals(plain, 1e-30)}
    chosen = trial.choose(("slivers", "doubled, one turned over", "zero normals"), variants)
    limit = 0.01 if integrator == Integrator.REFERENCE or not trial.quick else 0.02
    for name in chosen:
        picture = trial.render(on_floor(variants[name]), integrator, amount, ROOM_SIZE)
        trial.check_energy(name, luminance(picture).mean() / luminance(expected).mean(), 0.01)
        trial.check_same(name, expected, picture, limit)


def run_odd_meshes(trial: Trial, integrator: Integrator) -> None:
    """Render what has no right picture: normals in all directions, a needle, points, nothing, a tiny thing."""
    needle = make_mesh([[0, 0, 1], [1e-6, 0, 1], [0, 1.0, 1e6]], [[0, 1, 2]])
    specks = make_mesh(np.random.default_rng(2).normal(size=(300, 3)) * 1e-7 + [[0, 0, 0.5]], np.arange(300))
    ball = sphere(0.5)
    things = {
        "normals in all directions": noisy_normals(ball), "normals inside": turned_over(ball, 1.0), "needle": needle,
        "specks": specks, "nothing": replace(ball, positions=np.zeros((0, 3), np.float32),
                                             triangles=np.zeros((0, 3), np.int32),
                                             material_slots=np.zeros(0, np.int32),
                                             corner_normals=np.zeros((0, 3, 3), np.float32), uv_maps={}),
        "giant": replace(ball, positions=ball.positions * np.float32(1e8)),
        "tiny": replace(ball, positions=ball.positions * np.float32(1e-18)),
        "far and large": replace(ball, positions=ball.positions * np.float32(9e8) + np.float32(9e8)),
    }
    for mesh in things.values():
        scene = on_floor(quad(2.0))
        scene.delta.meshes["ball"] = mesh
        trial.render(scene, integrator, 4, ROOM_SIZE)
    trial.render(StressScene(SceneDelta(full=True, lights=[], world=room(ROOM_SIZE).delta.world),
                             room(ROOM_SIZE).camera), integrator, 4, ROOM_SIZE)


def run_overlap(trial: Trial, integrator: Integrator) -> None:
    """Render many objects in exactly the same place: opaque, glass and shining ones."""
    scene = room(ROOM_SIZE)
    table = scene.delta.instances
    ball, copies = table.mesh_keys.index("ball"), 4
    rows = [row for row in range(len(table.mesh_index)) if table.mesh_index[row] == ball]
    objects = [Placed(table.mesh_keys[table.mesh_index[row]], table.material_sets[table.material_set_index[row]][0],
                      table.transforms[row]) for row in [*range(len(table.mesh_index)), *rows * copies]]
    extra = [Placed("panel", "panel", EYE), Placed("ball", "panel", table.transforms[rows[0]]),
             Placed("floor", "glass", EYE)]
    again = make_scene(scene.delta.meshes, objects + extra, scene.delta.materials, scene.camera, scene.delta.lights,
                       0.25)
    trial.render(again, integrator, trial.choose(4, 32), ROOM_SIZE)


def make_cases() -> tuple[Case, ...]:
    """Return all cases."""
    cases = []
    for integrator in BOTH:
        cases += [
            Case(f"materials: ends of the ranges, {integrator}", "not brighter than a white sky", partial(
                run_materials, integrator=integrator, bright=False)),
            Case(f"materials: albedo 0 to 1e20, {integrator}", "no bad pixel", partial(
                run_materials, integrator=integrator, bright=True)),
            Case(f"materials: closed box of albedo 1 and 1.5, {integrator}", "paths end", partial(
                run_bright_box, integrator=integrator)),
            Case(f"meshes: slivers, duplicates, no area, {integrator}",
                 "FLIP to a plain floor at most 0.01 (0.02 after a few frames), energy within 1 %", partial(
                     run_meshes, integrator=integrator)),
            Case(f"meshes: odd shapes and sizes, {integrator}", "no bad pixel", partial(
                run_odd_meshes, integrator=integrator)),
            Case(f"meshes: many things in one place, {integrator}", "no bad pixel", partial(
                run_overlap, integrator=integrator)),
        ]
    return tuple(cases)


CASES = make_cases()
