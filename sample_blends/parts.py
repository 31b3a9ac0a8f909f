# SPDX-License-Identifier: GPL-3.0-or-later
"""Building blocks of the sample scenes: meshes, materials, images, lamps, camera, saving.

Everything is made from numbers, so that a scene is the same each time it is built and needs no other file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

Point = Sequence[float]


def start_scene(exposure: float = 0.0, look: str = "AgX") -> bpy.types.Scene:
    """Empty the file and return its scene with the settings that all samples share."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module="cycles")
    scene = bpy.context.scene
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 1280, 720, 100
    render.use_compositing = render.use_sequencer = False
    scene.view_settings.view_transform = look
    scene.view_settings.exposure = exposure
    cycles = scene.cycles
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = 256, False, False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
    for kind in ("max", "diffuse", "glossy", "transmission", "transparent_max"):
        setattr(cycles, f"{kind}_bounces", 32)
    return scene


def save_scene(path: Path) -> None:
    """Save the file compressed, with BURNISH as engine where that is registered (else Cycles)."""
    engines = {cls.bl_idname for cls in bpy.types.RenderEngine.__subclasses__() if hasattr(cls, "bl_idname")}
    bpy.context.scene.render.engine = "BURNISH" if "BURNISH" in engines else "CYCLES"
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True, relative_remap=False)


# Meshes


def mesh_from(name: str, vertices: Iterable[Point], faces: Sequence[Sequence[int]],
              corner_uvs: Iterable[Point], smooth: bool = False) -> bpy.types.Mesh:
    """Return a mesh with one UV map; `corner_uvs` run over the faces' corners in order."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([tuple(v) for v in vertices], [], faces)
    layer = mesh.uv_layers.new(name="UVMap")
    layer.uv.foreach_set("vector", np.asarray(list(corner_uvs), np.float32).ravel())
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(mesh.polygons))
    return mesh


def lathe(name: str, profile: Sequence[tuple[float, float]], segments: int = 64, smooth: bool = True) -> bpy.types.Mesh:
    """Return the surface that a profile of (radius, z), from bottom to top, sweeps about z; poles become triangles."""
    vertices, rings = [], []
    for radius, z in profile:
        count = 1 if radius == 0.0 else segments
        rings.append((len(vertices), count))
        angles = [2.0 * math.pi * i / segments for i in range(count)]
        vertices += [(radius * math.cos(a), radius * math.sin(a), z) for a in angles]
    faces, uvs = [], []
    for row in range(len(profile) - 1):
        (low, low_count), (high, high_count) = rings[row], rings[row + 1]
        v0, v1 = row / (len(profile) - 1), (row + 1) / (len(profile) - 1)
        for i in range(segments):
            j, u0, u1 = (i + 1) % segments, i / segments, (i + 1) / segments
            corners = [(low + i % low_count, u0, v0), (low + j % low_count, u1, v0),
                       (high + j % high_count, u1, v1), (high + i % high_count, u0, v1)]
            if low_count == 1:
                del corners[1]
            elif high_count == 1:
                del corners[2]
            faces.append([c[0] for c in corners])
            uvs += [c[1:] for c in corners]
    return mesh_from(name, vertices, faces, uvs, smooth)


def sphere(name: str, radius: float = 1.0, segments: int = 64) -> bpy.types.Mesh:
    """Return a UV sphere about the origin."""
    rows = segments // 2
    angles = [math.pi * (i / rows - 0.5) for i in range(1, rows)]
    profile = [(radius * math.cos(a), radius * math.sin(a)) for a in angles]
    return lathe(name, [(0.0, -radius), *profile, (0.0, radius)], segments)


def torus(name: str, major: float, minor: float, segments: int = 64, rows: int = 24) -> bpy.types.Mesh:
    """Return a torus about z."""
    angles = [2.0 * math.pi * i / rows for i in range(rows + 1)]
    return lathe(name, [(major + minor * math.cos(a), minor * math.sin(a)) for a in angles], segments)


def box(name: str, size: Point) -> bpy.types.Mesh:
    """Return a box about the origin; each face spans the UV square."""
    x, y, z = (0.5 * s for s in size)
    vertices = [(sx * x, sy * y, sz * z) for sz in (-1, 1) for sy in (-1, 1) for sx in (-1, 1)]
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return mesh_from(name, vertices, faces, [(0, 0), (1, 0), (1, 1), (0, 1)] * 6)


def plane(name: str, width: float, depth: float, uv_scale: float = 1.0) -> bpy.types.Mesh:
    """Return a rectangle in xy facing +z; its UVs run to `uv_scale` per metre, or over 0..1 if that is 0."""
    x, y = 0.5 * width, 0.5 * depth
    u, v = (width * uv_scale, depth * uv_scale) if uv_scale else (1.0, 1.0)
    return mesh_from(name, [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)], [(0, 1, 2, 3)],
                     [(0, 0), (u, 0), (u, v), (0, v)])


# Objects


def place(name: str, data, location: Point = (0, 0, 0), rotation: Point = (0, 0, 0), scale: Point | float = 1.0,
          material: bpy.types.Material | None = None, collection: bpy.types.Collection | None = None,
          bevel: float = 0.0) -> bpy.types.Object:
    """Link an object; its material sits on the object, so that meshes can be shared. Rotation in degrees."""
    thing = bpy.data.objects.new(name, data)
    (collection or bpy.context.scene.collection).objects.link(thing)
    thing.location = location
    thing.rotation_euler = [math.radians(a) for a in rotation]
    thing.scale = (scale,) * 3 if isinstance(scale, int | float) else scale
    if material is not None:
        if not data.materials:
            data.materials.append(None)
        thing.material_slots[0].link = "OBJECT"
        thing.material_slots[0].material = material
    if bevel > 0.0:
        modifier = thing.modifiers.new("Rounded edges", "BEVEL")
        modifier.width, modifier.segments, modifier.harden_normals = bevel, 3, True
        data.polygons.foreach_set("use_smooth", [True] * len(data.polygons))
    return thing


def aim(thing: bpy.types.Object, target: Point) -> bpy.types.Object:
    """Turn an object so that its -z axis looks at `target`."""
    thing.rotation_euler = (Vector(target) - thing.location).to_track_quat("-Z", "Y").to_euler()
    return thing


def camera(location: Point, target: Point, lens: float, f_stop: float | None = None,
           focus: Point | None = None) -> bpy.types.Object:
    """Add the scene's camera; with an f-stop it has depth of field, focused at `focus` or the target."""
    data = bpy.data.cameras.new("Camera")
    data.lens, data.clip_start, data.clip_end = lens, 0.02, 1000.0
    thing = aim(place("Camera", data, location), target)
    if f_stop is not None:
        bpy.context.view_layer.update()
        data.dof.use_dof, data.dof.aperture_fstop = True, f_stop
        data.dof.focus_distance = -(thing.matrix_world.inverted() @ Vector(focus or target)).z
    bpy.context.scene.camera = thing
    return thing


def lamp(name: str, kind: str, location: Point, power: float, target: Point = (0, 0, 0),
         color: Point = (1, 1, 1), **attributes) -> bpy.types.Object:
    """Add a lamp that shines towards `target`."""
    data = bpy.data.lights.new(name, kind)
    data.energy, data.color = power, color
    for attribute, value in attributes.items():
        setattr(data, attribute, value)
    return aim(place(name, data, location), target)


def shear(thing: bpy.types.Object, amount: float) -> None:
    """Shear an object along x by its height, through its parent-inverse matrix (a location, rotation, scale can't)."""
    parent = bpy.data.objects.new(thing.name + " shear", None)
    bpy.context.scene.collection.objects.link(parent)
    matrix = Matrix.Identity(4)
    matrix[0][2] = amount
    base = Matrix.Translation(thing.location)
    thing.parent, thing.matrix_parent_inverse = parent, base @ matrix @ base.inverted()


# Materials


def material(name: str, **inputs) -> bpy.types.Material:
    """Return a Principled material; inputs by socket name with `_` for blanks, e.g. `base_color=(r, g, b)`."""
    result = bpy.data.materials.new(name)
    shader = result.node_tree.nodes["Principled BSDF"]
    sockets = {socket.name.lower().replace(" ", "_"): socket for socket in shader.inputs}
    for key, value in inputs.items():
        rgb = sockets[key].type == "RGBA" and len(value) == 3
        sockets[key].default_value = (*value, 1.0) if rgb else value
    return result


def shader_of(result: bpy.types.Material) -> bpy.types.ShaderNode:
    """Return the Principled node of a material made by `material`."""
    return result.node_tree.nodes["Principled BSDF"]


def add_node(result, kind: str, inputs: dict | None = None, **attributes) -> bpy.types.ShaderNode:
    """Add a node; `inputs` maps a socket's name or index to a value or to an output socket to link."""
    tree = result.node_tree
    node = tree.nodes.new("ShaderNode" + kind)
    for attribute, value in attributes.items():
        setattr(node, attribute, value)
    for key, value in (inputs or {}).items():
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, node.inputs[key])
        else:
            rgb = node.inputs[key].type == "RGBA" and len(value) == 3
            node.inputs[key].default_value = (*value, 1.0) if rgb else value
    return node


def node_material(name: str, build: Callable[[bpy.types.Material], bpy.types.ShaderNode]) -> bpy.types.Material:
    """Return a material whose surface is the node that `build` makes (its first output)."""
    result = bpy.data.materials.new(name)
    result.node_tree.nodes.remove(shader_of(result))
    node = build(result)
    result.node_tree.links.new(node.outputs[0], result.node_tree.nodes["Material Output"].inputs["Surface"])
    return result


def textured(result: bpy.types.Material, image: bpy.types.Image, socket: str | None = "Base Color",
             scale: float = 1.0, output: str = "Color", **attributes) -> bpy.types.ShaderNode:
    """Feed an image through UV and Mapping nodes into a Principled socket (or into none); return the image node."""
    uv = add_node(result, "UVMap", uv_map="UVMap")
    mapping = add_node(result, "Mapping", {"Vector": uv.outputs[0], "Scale": (scale,) * 3})
    node = add_node(result, "TexImage", {"Vector": mapping.outputs[0]}, image=image, **attributes)
    if socket is not None:
        result.node_tree.links.new(node.outputs[output], shader_of(result).inputs[socket])
    return node


def image(name: str, pixels: np.ndarray, data: bool = False) -> bpy.types.Image:
    """Return a packed image from [h, w, 3 or 4] float values, bottom row first; above 1 only if it is a float image.

    `data` marks values that are no colours (normals, heights, masks). Floating-point images (dtype float32) are
    linear; any other dtype is stored in 8 bits as sRGB values.
    """
    height, width, channels = pixels.shape
    is_float = pixels.dtype == np.float32
    result = bpy.data.images.new(name, width, height, alpha=channels == 4, float_buffer=is_float, is_data=data)
    rgba = np.ones((height, width, 4), np.float32)
    # Half precision is plenty and lets the file shrink: the low mantissa bits are zero.
    rgba[..., :channels] = pixels.astype(np.float16) if is_float else pixels
    result.pixels.foreach_set(rgba.ravel())
    result.pack()
    return result


def image_world(picture: bpy.types.Image, strength: float = 1.0, rotation: float = 0.0) -> bpy.types.World:
    """Make the scene's world from an equirectangular image; rotation about z in degrees."""
    world = bpy.data.worlds.new("World")
    coordinate = add_node(world, "TexCoord")
    mapping = add_node(world, "Mapping", {"Vector": coordinate.outputs["Generated"]})
    mapping.inputs["Rotation"].default_value = (0.0, 0.0, math.radians(rotation))
    texture = add_node(world, "TexEnvironment", {"Vector": mapping.outputs[0]}, image=picture)
    background = world.node_tree.nodes["Background"]
    background.inputs["Strength"].default_value = strength
    world.node_tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    bpy.context.scene.world = world
    return world


def color_world(color: Point, strength: float = 1.0) -> bpy.types.World:
    """Make the scene's world one colour."""
    world = bpy.data.worlds.new("World")
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (*color, 1.0)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = strength
    bpy.context.scene.world = world
    return world
