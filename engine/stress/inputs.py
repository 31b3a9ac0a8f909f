# SPDX-License-Identifier: GPL-3.0-or-later
"""Denormal, zero, huge, negative and non-finite values in every field that extraction fills.

All values of a field come in one scene, each in a thing of its own; where that scene fails, each value is tried
alone, so that the failure names it. What is sound in the scene must still be drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np

from ..closure_arguments import ARGUMENTS
from ..errors import BurnishError
from ..media import MediumData
from ..program import ProgramBuilder
from ..scene import (
    CameraData,
    ColorEncoding,
    ImageData,
    InstanceTable,
    LightData,
    MaterialData,
    MeshData,
    WorldData,
)
from ..settings import Integrator
from ..volume_data import VolumeData
from ..volume_program import FieldData, VaryingData, VolumeBuilder
from .cases import BOTH, Case, Trial, luminance
from .scenes import (
    EYE,
    Placed,
    StressScene,
    changed,
    lamp,
    look_at,
    make_scene,
    make_table,
    material,
    place,
    principled,
    quad,
    sphere,
    world,
)

__all__ = ["CASES", "VALUES"]

VALUES = {
    "NaN": np.nan, "inf": np.inf, "-inf": -np.inf, "zero": 0.0, "denormal": 1e-42, "tiny": 1e-30, "huge": 1e30,
    "largest": 3.4e38, "negative": -1.0,
}
WHOLE_VALUES = {"zero": 0, "negative": -1, "largest": 2**31 - 1, "lowest": -(2**31)}
SIZE = (32, 16)
AMOUNT = 3
FEW = ("NaN", "inf", "zero", "largest")
"""Values of the quick subset where each has a scene of its own"""
PANEL = 3
"""Columns of pixels at the left edge that show a sound floor alone"""

Make = Callable[[Any], StressScene]


def gallery(edit: Callable[[int, StressScene], None] | None = None, count: int = len(VALUES)) -> StressScene:
    """Return a floor with a row of balls, each with its own mesh and material, and let `edit` break them."""
    names = [f"thing {i}" for i in range(count)]
    meshes = {"floor": quad(8.0), **{name: textured(sphere(0.3, 6)) for name in names}}
    materials = {"grey": material(color=0.5), **{name: shown() for name in names}}
    objects = [Placed("floor", "grey", EYE)]
    objects += [Placed(name, name, place(0.7 * (i - 0.5 * (count - 1)), 0.0, 0.3)) for i, name in enumerate(names)]
    lights = [lamp("AREA", 100.0, place(0.0, 0.0, 4.0), size_x=2.0, size_y=2.0)]
    scene = make_scene(meshes, objects, materials, look_at((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), SIZE, 1.6), lights, 0.5)
    for i in range(count if edit is not None else 0):
        edit(i, scene)
    return scene


def textured(mesh: MeshData) -> MeshData:
    """Return a mesh with an attribute and texture space."""
    mesh.attributes["Col"] = np.full((len(mesh.triangles), 3, 4), 0.5, np.float32)
    mesh.generated = (np.full(3, -0.3, np.float32), np.full(3, 0.6, np.float32))
    return mesh


def shown() -> Any:
    """Return a material that reads UVs, an attribute, texture space, the object's own numbers, and is glossy."""
    builder = ProgramBuilder()
    color = builder.vector("ADD", builder.uv(""), builder.input("GENERATED"))
    color = builder.vector("ADD", color, builder.attribute("Col"))
    color = builder.vector("ADD", color, builder.input("OBJECT_COLOR"))
    color = builder.vector("MULTIPLY", color, (0.25, 0.25, 0.25))
    return replace(principled(color=0.5, roughness=0.4), program=finish(builder, color))


def finish(builder: ProgramBuilder, color: Any) -> Any:
    """Return the program of a glossy surface of a colour."""
    builder.closure("PRINCIPLED", 1.0, multiscatter=True, color=color, roughness=0.4, ior=1.5, specular_level=0.5,
                    specular_tint=(1.0, 1.0, 1.0))
    return builder.finish()


# Each returns, for a field, a function from a list of values to a scene that has all of them.


def break_mesh(name: str, values: list[Any]) -> StressScene:
    """Put values into the middle of an array of a mesh, each into one ball's."""
    def edit(i: int, scene: StressScene) -> None:
        mesh = scene.delta.meshes[f"thing {i}"]
        if name == "generated":
            mesh.generated = (np.full(3, values[i], np.float32), np.full(3, values[i], np.float32))
            return
        if name == "volume":
            scene.delta.materials[f"thing {i}"] = cloud_of_grids()
            mesh.volume = broken_grids(values[i])
            return
        array = {"uv_maps": mesh.uv_maps.get("UVMap"), "attributes": mesh.attributes["Col"]}.get(
            name, getattr(mesh, name))
        flat = array.reshape(-1)
        with np.errstate(over="ignore"):
            flat[len(flat) // 3:len(flat) // 2] = values[i]

    return gallery(edit, len(values))


def cloud_of_grids() -> MaterialData:
    """Return a material without a surface whose volume shines and scatters as the grid density says."""
    builder = VolumeBuilder(optional=True)
    density = builder.compiled(builder.optional_grid("density"))
    part = FieldData((1.0, 0.5, 0.2), density)
    medium = MediumData(extinction=(1.0, 1.0, 1.0), in_grids=VaryingData(part, part, ((part, FieldData()),)))
    clear = ProgramBuilder()
    clear.transparent((1.0, 1.0, 1.0), 1.0)
    return MaterialData(name="cloud", program=clear.finish(), has_transparency=True, bare=True, medium=medium)


def broken_grids(value: float) -> VolumeData:
    """Return the grids of a box of side 2 with a value in some of their cells."""
    grid = np.ones((4, 4, 4, 4), np.float32)
    with np.errstate(over="ignore"):
        grid[1, 1:3] = value
    to_object = np.diag([0.5, 0.5, 0.5, 1.0])
    to_object[:3, 3] = -1.0
    return VolumeData(grids={"density": grid}, to_object=to_object, cells=(4, 4, 4), scaled=True)


def break_instance(name: str, values: list[Any]) -> StressScene:
    """Put values into a column of the table of instances, each into one ball's row."""
    def edit(i: int, scene: StressScene) -> None:
        column = getattr(scene.delta.instances, name)
        row = column[i + 1:i + 2].reshape(-1)
        with np.errstate(all="ignore"):
            row[:12] = np.array(values[i]).astype(column.dtype)

    return gallery(edit, len(values))


def break_scale(axes: int, values: list[Any]) -> StressScene:
    """Scale balls along one, two or all three axes."""
    def edit(i: int, scene: StressScene) -> None:
        with np.errstate(all="ignore"):
            scene.delta.instances.transforms[i + 1, :3, :axes] *= values[i]

    return gallery(edit, len(values))


def break_lamp(kind: str, name: str, values: list[Any]) -> StressScene:
    """Put values into a field of lamps, each into one lamp's."""
    scene = gallery()
    base = lamp(kind, 5.0, place(0.0, -1.0, 2.0), radius=0.1, angle=0.1, size_x=0.5, size_y=0.25,
                shape="RECTANGLE", spread=2.0)
    for value in values:
        broken: Any = value
        if name == "color":
            broken = (value, 1.0, 1.0)
        elif name == "transform":
            broken = base.transform.copy()
            broken[:3, 0] = value
        scene.delta.lights.append(replace(base, **{name: broken}))
    return scene


def break_material(kind: str, name: str, values: list[Any]) -> StressScene:
    """Put values into an argument of closures, as a constant and, odd ones, through a node that isn't folded."""
    def edit(i: int, scene: StressScene) -> None:
        def through_node(builder: ProgramBuilder) -> Any:
            return builder.vector("MULTIPLY", (values[i],) * 3, builder.attribute("Col"))

        arguments = {"color": 0.5, "roughness": 0.3}
        if name.startswith("subsurface_"):
            arguments |= {"subsurface": 1.0, "subsurface_method": "WALK", "subsurface_radius": 0.1}
        if name == "film_ior":
            arguments["film_thickness"] = 400.0
        base = principled if kind == "PRINCIPLED" else partial(material, kind)
        if name == "emission_strength":
            scene.delta.materials[f"thing {i}"] = base(emission=values[i], **arguments)
        elif name == "weight":
            scene.delta.materials[f"thing {i}"] = base(weight=values[i], **arguments)
        else:
            arguments[name] = through_node if i % 2 else values[i]
            scene.delta.materials[f"thing {i}"] = base(**arguments)

    # Each value both ways.
    return gallery(edit, len(values))


def break_image(values: list[Any]) -> StressScene:
    """Show images that hold values, each on one ball."""
    def edit(i: int, scene: StressScene) -> None:
        builder = ProgramBuilder()
        finish(builder, builder.image(f"image {i}", builder.uv("")))
        pixels = np.full((8, 8, 4), 0.5, np.float32)
        pixels[2:4, 2:6, i % 4] = values[i]
        scene.delta.images[f"image {i}"] = ImageData(name="image", pixels=pixels, encoding=ColorEncoding.LINEAR)
        scene.delta.materials[f"thing {i}"] = replace(principled(color=0.5), program=builder.finish())

    return gallery(edit, len(values))


def break_world(name: str, values: list[Any]) -> StressScene:
    """Put one value into the world."""
    value, scene = values[0], gallery()
    if name == "constant":
        made = world((value, 0.5, 0.5))
    else:
        def build(builder: ProgramBuilder) -> None:
            direction = builder.input("POSITION")
            up = builder.math("MULTIPLY", builder.component(direction, 2), value if name == "program" else 1.0)
            builder.emit((1.0, 1.0, 1.0), builder.math("ADD", up, 0.5), 1.0)

        made = world(build=build)
        if name == "importance_resolution":
            # Extraction hands over whole numbers; the largest would be a matter of memory.
            made.importance_resolution = int(np.clip(np.nan_to_num(value), -512, 512))
    scene.delta.world = made
    return scene


def break_luminance(values: list[Any]) -> StressScene:
    """Put one value into the weights of the luminance."""
    return changed(gallery(), luminance_weights=(values[0], 0.7, 0.1))


def break_camera(name: str, values: list[Any]) -> StressScene:
    """Put one value into a field of the camera."""
    value, scene = values[0], gallery()
    if name == "transform":
        broken: Any = tuple(value if i == 3 else x for i, x in enumerate(scene.camera.transform))
    elif name == "window":
        broken = (scene.camera.window[0], value, *scene.camera.window[2:])
    elif name == "aperture_blades":
        broken = int(np.clip(np.nan_to_num(value), -100, 2**31 - 1))
    else:
        broken = value
    fields_set = {"aperture_radius": 0.1} if name.startswith(("aperture", "focus")) else {}
    return changed(scene, camera=replace(scene.camera, **{**fields_set, name: broken}))


# Running them.


def run_field(trial: Trial, integrator: Integrator, make: Callable[[list[Any]], StressScene], values: dict[str, Any],
              alone: bool) -> None:
    """Render a scene with all values of a field, or with each `alone`; find the sound floor drawn."""
    names = list(values)
    tries = [[name] for name in names] if alone else [names]
    for chosen in tries:
        before = (trial.result.non_finite, trial.result.negative)
        try:
            # A refusal in a sentence is an answer too, where a thing can't be rendered without the field.
            picture = trial.render(make([values[name] for name in chosen]), integrator, AMOUNT, SIZE)
        except BurnishError as error:
            trial.note(f"refused: {error}")
            continue
        if (trial.result.non_finite, trial.result.negative) != before and len(chosen) > 1:
            trial.note("bad pixels; each value alone:")
            run_field(trial, integrator, make, values, alone=True)
        elif not alone:
            trial.check("light on sound things", luminance(picture)[:2, :PANEL].mean(), 1e-3, np.inf)


def mesh_fields() -> dict[str, tuple[Callable, dict[str, Any]]]:
    """Return the fields of meshes with what makes a scene and the values."""
    found = {}
    for field in fields(MeshData):
        if field.name == "name":
            continue
        whole = field.name in ("triangles", "material_slots")
        found[f"mesh {field.name}"] = (partial(break_mesh, field.name), WHOLE_VALUES if whole else VALUES)
    return found


def instance_fields() -> dict[str, tuple[Callable, dict[str, Any]]]:
    """Return the numeric columns of the table of instances, and scales."""
    table = make_table([Placed("a", "a", EYE)])
    found = {}
    for name in ("transforms", "visibility", "pass_index", "random_id", "color"):
        whole = getattr(table, name).dtype.kind in "iu"
        found[f"instance {name}"] = (partial(break_instance, name), WHOLE_VALUES if whole else VALUES)
    for axes in (1, 2, 3):
        found[f"instance scale of {axes} axes"] = (partial(break_scale, axes), VALUES)
    assert {name for name in vars(table)} >= {field.name for field in fields(InstanceTable)}
    return found


LAMP_FIELDS = {
    "POINT": ("color", "transform", "radius"), "SUN": ("color", "transform", "angle"),
    "SPOT": ("radius", "transform", "spot_size", "spot_blend"),
    "AREA": ("color", "transform", "size_x", "size_y", "spread"),
}
CLOSURES = ("DIFFUSE", "GLOSSY", "REFRACTION", "GLASS", "TRANSLUCENT", "SHEEN")
CLOSURE_FIELDS = ("color", "roughness", "ior", "normal", "anisotropic", "tangent", "weight")


def material_fields(quick: bool) -> dict[str, tuple[Callable, dict[str, Any]]]:
    """Return the arguments of closures."""
    found = {f"material {name}": (partial(break_material, "PRINCIPLED", name), VALUES)
             for name in (*ARGUMENTS, "emission_strength") if name != "emission"}
    from ...kernels import types as kernel_types

    for kind in CLOSURES:
        if hasattr(kernel_types, "CLOSURE_" + kind):
            for name in CLOSURE_FIELDS:
                found[f"{kind.lower()} {name}"] = (partial(break_material, kind, name), VALUES)
    return {name: value for i, (name, value) in enumerate(found.items()) if not quick or i % 4 == 1}


def camera_fields() -> dict[str, tuple[Callable, dict[str, Any]]]:
    """Return the fields of cameras."""
    return {f"camera {field.name}": (partial(break_camera, field.name), VALUES)
            for field in fields(CameraData) if field.name != "kind"}


def world_fields() -> dict[str, tuple[Callable, dict[str, Any]]]:
    """Return the fields of worlds, and the luminance's weights."""
    assert {"constant", "importance_resolution", "program"} <= {field.name for field in fields(WorldData)}
    found = {f"world {name}": (partial(break_world, name), VALUES)
             for name in ("constant", "program", "importance_resolution")}
    return {**found, "luminance weights": (break_luminance, VALUES)}


def lamp_fields() -> dict[str, tuple[Callable, dict[str, Any]]]:
    """Return the fields of lamps."""
    known = {field.name for field in fields(LightData)}
    assert all(name in known for names in LAMP_FIELDS.values() for name in names)
    return {f"{kind.lower()} {name}": (partial(break_lamp, kind, name), VALUES)
            for kind, names in LAMP_FIELDS.items() for name in names}


def run_group(trial: Trial, integrator: Integrator, group: str) -> None:
    """Break each field of a group."""
    groups = {
        "meshes": mesh_fields, "instances": instance_fields, "lamps": lamp_fields,
        "materials": partial(material_fields, trial.quick), "worlds": world_fields, "cameras": camera_fields,
        "images": lambda: {"image pixels": (break_image, VALUES)}}
    for name, (make, values) in groups[group]().items():
        alone = group in ("worlds", "cameras")
        values = {key: values[key] for key in FEW} if trial.quick and alone else values
        failure = trial.result.non_finite, trial.result.negative, len(trial.result.missed)
        try:
            run_field(trial, integrator, make, values, alone)
        except Exception as error:
            raise RuntimeError(f"{name}: {type(error).__name__}: {error}") from error
        if failure != (trial.result.non_finite, trial.result.negative, len(trial.result.missed)):
            trial.note(f"{name} did it")


CASES = tuple(
    Case(f"inputs: {group}, {integrator}", "no bad pixel, sound things drawn or a sentence",
         partial(run_group, integrator=integrator, group=group))
    for group in ("meshes", "instances", "lamps", "materials", "worlds", "cameras", "images") for integrator in BOTH)
