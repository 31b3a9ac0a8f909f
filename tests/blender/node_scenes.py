# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs node graphs in Cycles and in the node machine, on the same plane, for comparison. Imported in child processes.

The plane lies askew in space, an orthographic camera looks straight at it, and Cycles samples pixel centres, so that
pixel (x, y) of its picture is one known point of the plane.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import warp as wp
from burnish.addon.extract.material import extract_light_shader, extract_material, extract_world
from burnish.engine.materials import MaterialTable, attribute_names
from burnish.engine.program import Program
from burnish.engine.report import Report
from burnish.engine.scene import CameraData, CameraKind
from burnish.kernels.nodes import evaluate_emission, evaluate_surface, evaluate_transparency, evaluate_world
from burnish.kernels.types import Closure, Instance, Scene, ShadingPoint, TextureInfo
from mathutils import Euler, Matrix

__all__ = [
    "Harness", "extract_light_shader", "extract_material", "extract_world", "finish", "math", "new_material", "np",
    "Report", "Program", "bpy",
]

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SIZE = 16
"""Pixels on a side"""

TRANSFORM = Matrix.LocRotScale((0.3, -0.2, 0.5), Euler((0.3, 0.2, 0.4)), (1.5, 1.5, 1.5))


@wp.kernel
def evaluate_points(
    scene: Scene, points: wp.array[ShadingPoint], u: float, closures_out: wp.array[Closure],
    emission_out: wp.array[wp.vec3], transparency_out: wp.array[wp.vec3],
):
    """Run all three programs at each point."""
    i = wp.tid()
    closures_out[i] = evaluate_surface(scene, points[i], u)
    emission_out[i] = evaluate_emission(scene, points[i])
    transparency_out[i] = evaluate_transparency(scene, points[i])


@wp.kernel
def evaluate_directions(scene: Scene, directions: wp.array[wp.vec3], radiance_out: wp.array[wp.vec3]):
    """Evaluate the world as camera rays see it."""
    i = wp.tid()
    radiance_out[i] = evaluate_world(scene, directions[i], 1, 0, 0.0)


class Images:
    """Stands in for the image collector and the texture store: float texels of Blender's own images, straight."""

    def __init__(self) -> None:
        self.keys: list[int] = []
        self.pixels: dict[object, np.ndarray] = {}

    def key(self, image, image_user=None) -> int:
        """Return the image's key."""
        if image.session_uid not in self.keys:
            self.keys.append(image.session_uid)
        return image.session_uid

    def computed(self, key, name, signature, make):
        """Return the key of a picture that a node computes."""
        if key not in self.keys:
            self.keys.append(key)
        self.pixels[key] = make()
        return key


def finish(result: object) -> None:
    """Hand the result over to the test."""
    print("RESULT " + json.dumps(result))


def new_material(build: Callable, name: str = "Graph") -> bpy.types.Material:
    """Return a material; `build(nodes, links)` returns the colour socket that is to be emitted, or a shader's."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    socket = build(nodes, links)
    if socket is not None and socket.type != 'SHADER':
        emission = nodes.new("ShaderNodeEmission")
        links.new(socket, emission.inputs["Color"])
        socket = emission.outputs[0]
    if socket is not None:
        links.new(socket, output.inputs["Surface"])
    return material


class Harness:
    """A plane, a camera over it, and both renderers."""

    def __init__(self) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        mesh = bpy.data.meshes.new("Plane")
        mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0.0), (-1, 1, 0.0)], [], [(0, 1, 2, 3)])
        uv = mesh.uv_layers.new(name="UVMap")
        uv.uv.foreach_set("vector", np.array([0.1, 0.0, 1.0, 0.1, 0.9, 1.0, 0.0, 0.9], np.float32))
        color = mesh.color_attributes.new("Col", 'FLOAT_COLOR', 'CORNER')
        color.data.foreach_set("color", np.linspace(0.0, 1.0, 16, dtype=np.float32))
        self.plane = bpy.data.objects.new("Plane", mesh)
        self.plane.matrix_world = TRANSFORM
        self.plane.color = (0.2, 0.4, 0.6, 0.8)
        self.plane.pass_index = 3
        camera = bpy.data.cameras.new("Camera")
        camera.type = 'ORTHO'
        camera.ortho_scale = 3.0
        self.camera = bpy.data.objects.new("Camera", camera)
        self.camera.matrix_world = TRANSFORM.normalized() @ Matrix.Translation((0.0, 0.0, 4.0))
        scene = self.scene = bpy.context.scene
        scene.collection.objects.link(self.plane)
        scene.collection.objects.link(self.camera)
        scene.camera = self.camera
        scene.render.engine = 'CYCLES'
        scene.cycles.device = 'CPU'
        scene.cycles.samples = 1
        scene.cycles.use_denoising = False
        scene.cycles.use_adaptive_sampling = False
        scene.cycles.pixel_filter_type = 'BOX'
        scene.render.filter_size = 0.01
        scene.cycles.filter_width = 0.01
        scene.render.resolution_x = scene.render.resolution_y = SIZE
        scene.render.image_settings.file_format = 'OPEN_EXR'
        scene.render.image_settings.color_depth = '32'
        scene.render.threads_mode = 'FIXED'
        scene.render.threads = 1
        self.images = Images()
        self.report = Report()

    def cycles(self, samples: int = 1) -> np.ndarray:
        """Return Cycles' picture [SIZE * SIZE, 4], bottom row first."""
        self.scene.cycles.samples = samples
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder, "picture.exr"))
            self.scene.render.filepath = path
            bpy.ops.render.render(write_still=True)
            image = bpy.data.images.load(path)
            image.colorspace_settings.name = 'Non-Color'
            pixels = np.array(image.pixels[:], np.float32).reshape(-1, 4)
            bpy.data.images.remove(image)
        return pixels

    def machine(self, material: bpy.types.Material, u: float = 0.5) -> dict[str, np.ndarray]:
        """Return what the node machine says about each pixel's point: closures, emission, transparency."""
        return self.run(extract_material(material, self.images, self.report), u)

    def run(self, data: object, u: float = 0.5) -> dict[str, np.ndarray]:
        """Return the same of a material's data."""
        scene = self._scene({"m": data}, None)
        points = self._points(1)
        count = len(points)
        closures = wp.zeros(count, dtype=Closure, device="cpu")
        emission = wp.zeros(count, dtype=wp.vec3, device="cpu")
        transparency = wp.zeros(count, dtype=wp.vec3, device="cpu")
        wp.launch(evaluate_points, count, device="cpu",
                  inputs=[scene, wp.array(points, dtype=ShadingPoint, device="cpu"), u],
                  outputs=[closures, emission, transparency])
        return {"data": data, "closures": closures.numpy(), "emission": emission.numpy(),
                "transparency": transparency.numpy()}

    def compare(self, build: Callable, **options) -> float:
        """Return the largest difference between Cycles' and the machine's emission of a graph."""
        material = new_material(build)
        self.plane.data.materials.clear()
        self.plane.data.materials.append(material)
        expected = self.cycles(**options)[:, :3]
        found = self.machine(material)["emission"]
        self.last = expected, found
        return float(np.abs(expected - found).max())

    def world(self, world: bpy.types.World) -> tuple[np.ndarray, np.ndarray, object]:
        """Return a world as Cycles and as the machine see it, and its data."""
        self.scene.world = world
        self.plane.hide_render = True
        self.camera.data.type = 'PANO'
        settings = self.camera.data if hasattr(self.camera.data, "panorama_type") else self.camera.data.cycles
        settings.panorama_type = 'EQUIRECTANGULAR'
        self.camera.matrix_world = Euler((math.pi / 2.0, 0.0, -math.pi / 2.0)).to_matrix().to_4x4()
        expected = self.cycles()[:, :3]
        data = extract_world(world, self.images, self.report)
        scene = self._scene({}, data.program)
        x, y = np.meshgrid((np.arange(SIZE) + 0.5) / SIZE, (np.arange(SIZE) + 0.5) / SIZE)
        phi, theta = (0.5 - x.ravel()) * 2.0 * np.pi, (1.0 - y.ravel()) * np.pi
        directions = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)
        found = wp.zeros(len(directions), dtype=wp.vec3, device="cpu")
        wp.launch(evaluate_directions, len(directions), device="cpu",
                  inputs=[scene, wp.array(directions, dtype=wp.vec3, device="cpu")], outputs=[found])
        return expected, found.numpy(), data

    def _scene(self, materials: dict, world: Program | None) -> Scene:
        """Return the scene of the plane with its materials."""
        programs = [data.program for data in materials.values()] + ([world] if world else [])
        uv_maps = sorted({"", "UVMap", *(name for program in programs for name in program.uv_maps)})
        attributes = [name for name in attribute_names(programs) if name in ("", "Col")]
        table = MaterialTable("cpu")
        table.build(materials, world, lambda key: self.images.keys.index(key), index_in(uv_maps), index_in(attributes))
        table.set_camera(CameraData(
            kind=CameraKind.ORTHOGRAPHIC, transform=tuple(np.array(self.camera.matrix_world).ravel()),
            window=(-1.5, 1.5, -1.5, 1.5)))
        scene = Scene()
        scene.materials = table.struct()
        scene.luminance = wp.vec3(0.2126729, 0.7151522, 0.0721750)
        self._fill_geometry(scene, len(uv_maps), len(attributes))
        self._fill_textures(scene)
        return scene

    def _fill_geometry(self, scene: Scene, uv_count: int, attribute_count: int) -> None:
        """Put the plane's two triangles into the scene; every UV map name means its only one, and so attributes."""
        mesh = self.plane.data
        mesh.calc_loop_triangles()
        corners = np.array([triangle.loops for triangle in mesh.loop_triangles])
        geometry = scene.geometry
        instance = np.zeros(1, dtype=Instance.numpy_dtype())
        matrix = np.array(TRANSFORM)
        instance["to_world"], instance["to_object"] = matrix, np.linalg.inv(matrix)
        instance["color"], instance["pass_index"] = self.plane.color, self.plane.pass_index
        instance["generated_location"] = mesh.texspace_location
        instance["generated_size"] = mesh.texspace_size
        geometry.instances = wp.array(instance, dtype=Instance, device="cpu")
        geometry.triangles = wp.array(corners, dtype=wp.vec3i, device="cpu")
        geometry.positions = wp.array([v.co[:] for v in mesh.vertices], dtype=wp.vec3, device="cpu")
        rows = np.zeros((len(corners), 6, 4), np.float32)
        rows[:, :3, :3] = np.array([v.co[:] for v in mesh.vertices])[corners]
        rows[:, 3:, 2] = 1.0
        geometry.corners = wp.array(rows.reshape(-1, 4), dtype=wp.vec4, device="cpu")
        uvs = np.zeros(8, np.float32)
        mesh.uv_layers[0].uv.foreach_get("vector", uvs)
        geometry.uvs = wp.array(uvs.reshape(4, 2)[corners].reshape(6, 2), dtype=wp.vec2, device="cpu")
        geometry.uv_offsets = wp.array([[0] * uv_count], dtype=int, device="cpu")
        colors = np.zeros(16, np.float32)
        mesh.color_attributes["Col"].data.foreach_get("color", colors)
        geometry.attributes = wp.array(colors.reshape(4, 4)[corners].reshape(6, 4), dtype=wp.vec4, device="cpu")
        geometry.attribute_offsets = wp.array([[0] * max(attribute_count, 1)], dtype=int, device="cpu")

    def _fill_textures(self, scene: Scene) -> None:
        """Put Blender's images into the scene as float texels, colour multiplied by alpha."""
        infos, texels = [], [np.zeros((1, 4), np.float32)]
        for key in self.images.keys:
            if key in self.images.pixels:
                pixels = self.images.pixels[key]
                info = np.zeros((), dtype=TextureInfo.numpy_dtype())
                info["height"], info["width"], info["levels"] = *pixels.shape[:2], 1
                info["offset"], info["format"] = sum(map(len, texels)), 3
                infos.append(info)
                texels.append(np.insert(pixels.reshape(-1, 3), 3, 1.0, 1).astype(np.float32))
                continue
            image = next(image for image in bpy.data.images if image.session_uid == key)
            width, height = image.size
            pixels = np.array(image.pixels[:], np.float32).reshape(height, width, 4)
            info = np.zeros((), dtype=TextureInfo.numpy_dtype())
            info["width"], info["height"], info["levels"] = width, height, 1
            info["offset"], info["format"], info["alpha"] = sum(map(len, texels)), 3, 1
            if image.alpha_mode == 'CHANNEL_PACKED' or image.colorspace_settings.is_data:
                info["alpha"] = 0
            info["srgb"] = image.colorspace_settings.name == 'sRGB' and not image.is_float
            infos.append(info)
            texels.append(pixels[::-1].reshape(-1, 4))
        if infos:
            scene.textures.infos = wp.array(np.array(infos), dtype=TextureInfo, device="cpu")
        scene.textures.floats4 = wp.array(np.concatenate(texels), dtype=wp.vec4, device="cpu")

    def _points(self, material: int) -> np.ndarray:
        """Return the plane's points behind the pixel centres."""
        x, y = np.meshgrid((np.arange(SIZE) + 0.5) / SIZE * 2.0 - 1.0, (np.arange(SIZE) + 0.5) / SIZE * 2.0 - 1.0)
        points = np.zeros(SIZE * SIZE, dtype=ShadingPoint.numpy_dtype())
        local = np.stack([x.ravel(), y.ravel(), np.zeros(SIZE * SIZE), np.ones(SIZE * SIZE)], 1)
        matrix = np.array(TRANSFORM)
        points["position"] = (local @ matrix.T)[:, :3]
        normal = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
        points["normal"] = points["geometric_normal"] = points["wo"] = normal
        self.plane.data.calc_loop_triangles()
        vertices = np.array([v.co[:] for v in self.plane.data.vertices])
        for number, triangle in enumerate(self.plane.data.loop_triangles):
            a, b, c = vertices[list(triangle.vertices)]
            weights = np.linalg.solve(np.stack([b - a, c - a], 1)[:2], (local[:, :2] - a[:2]).T)
            inside = (weights.min(0) >= -1e-6) & (weights.sum(0) <= 1.0 + 1e-6)
            points["triangle"][inside] = number
            points["u"][inside], points["v"][inside] = weights[0][inside], weights[1][inside]
        points["material"] = material
        points["ray_visibility"] = 1
        points["ray_length"] = 4.0 - self.camera.data.clip_start
        points["footprint"] = 3.0 / SIZE
        return points


def index_in(names: list[str]) -> Callable[[str], int]:
    """Return a resolver of names."""
    return lambda name: names.index(name) if name in names else -1
