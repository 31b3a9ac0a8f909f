# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine on the device: drawing of BSDFs, sums, inputs, normals, filter widths, patterns."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.materials import MaterialTable, attribute_names
from burnish.engine.program import ProgramBuilder, tangent_attribute
from burnish.engine.program_fold import fold
from burnish.engine.scene import MaterialData
from burnish.kernels import node_codes as codes
from burnish.kernels.nodes import evaluate_emission, evaluate_surface, evaluate_transparency, evaluate_world
from burnish.kernels.types import (
    CLOSURE_DIFFUSE,
    CLOSURE_GLOSSY,
    CLOSURE_PRINCIPLED,
    Closure,
    Instance,
    Scene,
    ShadingPoint,
)

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def evaluate_all(
    scene: Scene, points: wp.array[ShadingPoint], random: wp.array[float], closures_out: wp.array[Closure],
    emission_out: wp.array[wp.vec3], transparency_out: wp.array[wp.vec3],
):
    """Run the three programs of each point's material."""
    i = wp.tid()
    closures_out[i] = evaluate_surface(scene, points[i], random[i])
    emission_out[i] = evaluate_emission(scene, points[i])
    transparency_out[i] = evaluate_transparency(scene, points[i])


@wp.kernel
def evaluate_sky(scene: Scene, directions: wp.array[wp.vec3], visibility: int, radiance_out: wp.array[wp.vec3]):
    """Run the world's program."""
    i = wp.tid()
    radiance_out[i] = evaluate_world(scene, directions[i], visibility, 2, 0.0)


def make_scene(device: str, builder: ProgramBuilder | None = None, world: ProgramBuilder | None = None) -> Scene:
    """Return one triangle (0,0) (2,0) (0,2), twice as large in the world and moved, with one material."""
    data = MaterialData(name="m", program=(builder or ProgramBuilder()).finish(), pass_index=9)
    if builder is not None:
        data.has_transparency, data.has_emission = builder.has_transparency(), builder.has_emission()
    programs = [data.program] + ([world.finish()] if world else [])
    uv_maps = sorted({name for program in programs for name in program.uv_maps})
    attributes = attribute_names(programs)
    table = MaterialTable(device)
    table.build({"m": data}, programs[1] if world else None, lambda key: 0, uv_maps.index,
                lambda name: attributes.index(name) if name in attributes else -1, (10.0, 0.0, 0.0))
    scene = Scene()
    scene.materials = table.struct()
    scene.luminance = wp.vec3(0.2126, 0.7152, 0.0722)
    geometry = scene.geometry
    row = np.zeros(1, dtype=Instance.numpy_dtype())
    matrix = np.diag([2.0, 2.0, 2.0, 1.0])
    matrix[:3, 3] = (1.0, 2.0, 3.0)
    row["to_world"], row["to_object"] = matrix, np.linalg.inv(matrix)
    row["color"], row["random"], row["generated_size"] = (0.1, 0.2, 0.3, 0.4), 0.7, 1.0
    geometry.instances = wp.array(row, dtype=Instance, device=device)
    geometry.triangles = wp.array([[0, 1, 2]], dtype=wp.vec3i, device=device)
    geometry.positions = wp.array([[0, 0, 0], [2, 0, 0], [0, 2, 0]], dtype=wp.vec3, device=device)
    corners = [[0, 0, 0, 0], [2, 0, 0, 0], [0, 2, 0, 0]] + [[0, 0, 1, 0]] * 3
    geometry.corners = wp.array(corners, dtype=wp.vec4, device=device)
    geometry.uvs = wp.array([[0, 0], [4, 0], [0, 4]], dtype=wp.vec2, device=device)
    geometry.uv_offsets = wp.array([[0] * max(len(uv_maps), 1)], dtype=int, device=device)
    geometry.attributes = wp.array([[0, 0, 0, 0], [1, 0, 0, 1], [0, 1, 0, 1]], dtype=wp.vec4, device=device)
    geometry.attribute_offsets = wp.array([[0] * max(len(attributes), 1)], dtype=int, device=device)
    return scene


def make_points(count: int) -> np.ndarray:
    """Return points at the triangle's barycentric (0.25, 0.5), seen from above."""
    points = np.zeros(count, dtype=ShadingPoint.numpy_dtype())
    points["u"], points["v"] = 0.25, 0.5
    points["position"] = (1.0 + 1.0, 2.0 + 2.0, 3.0)
    points["normal"] = points["geometric_normal"] = points["wo"] = (0.0, 0.0, 1.0)
    points["material"], points["ray_visibility"], points["ray_length"], points["ray_depth"] = 1, 1, 5.0, 2
    points["footprint"] = 0.01
    return points


def run(device: str, scene: Scene, points: np.ndarray, random: np.ndarray | None = None) -> tuple:
    """Return closures, emission and transparency at the points."""
    count = len(points)
    random = np.full(count, 0.5, np.float32) if random is None else random.astype(np.float32)
    outputs = [wp.zeros(count, dtype=kind, device=device) for kind in (Closure, wp.vec3, wp.vec3)]
    wp.launch(evaluate_all, count, device=device, outputs=outputs, inputs=[
        scene, wp.array(points, dtype=ShadingPoint, device=device), wp.array(random, dtype=float, device=device)])
    return tuple(output.numpy() for output in outputs)


def value(device: str, build, points: np.ndarray | None = None) -> np.ndarray:
    """Return what a graph yields at one point."""
    builder = ProgramBuilder()
    builder.emit(build(builder), 1.0, 1.0)
    return run(device, make_scene(device, builder), make_points(1) if points is None else points)[1][0]


def test_draw_by_weight(device: str):
    """Draw each BSDF as often as its share, with weights whose expectation is the mix."""
    builder = ProgramBuilder()
    builder.closure("DIFFUSE", 0.5, color=(0.2, 0.2, 0.2))
    builder.closure("GLOSSY", 0.3, color=(1.0, 1.0, 1.0))
    builder.closure("PRINCIPLED", 0.2, color=(0.5, 0.5, 0.5))
    builder.closure("GLASS", 0.9, color=(0.0, 0.0, 0.0))
    count = 20000
    random = (np.arange(count) + 0.5) / count
    closures, _, _ = run(device, make_scene(device, builder), make_points(count), random)
    weights = {CLOSURE_DIFFUSE: 0.5, CLOSURE_GLOSSY: 0.3, CLOSURE_PRINCIPLED: 0.2}
    shares = {CLOSURE_DIFFUSE: 0.1 / 0.6, CLOSURE_GLOSSY: 0.3 / 0.6, CLOSURE_PRINCIPLED: 0.2 / 0.6}
    assert set(closures["kind"]) == set(weights)
    for kind, weight in weights.items():
        chosen = closures["kind"] == kind
        assert chosen.mean() == pytest.approx(shares[kind], abs=2e-3)
        assert (closures["weight"][:, 0] * chosen).mean() == pytest.approx(weight, rel=0.01)


def test_sum_emission_and_transparency(device: str):
    """Sum everything that is not a BSDF exactly, in all three programs."""
    builder = ProgramBuilder()
    half = builder.math("MULTIPLY", builder.input("RAY_DEPTH"), 0.25)
    builder.emit((1.0, 2.0, 3.0), half, 1.0)
    builder.emit((1.0, 0.0, 0.0), 1.0, half)
    builder.transparent((0.5, 0.25, 0.0), half)
    builder.transparent(0.1, 1.0)
    builder.holdout(half)
    builder.closure("DIFFUSE", half, color=0.8)
    closures, emission, transparency = run(device, make_scene(device, builder), make_points(1))
    np.testing.assert_allclose(emission[0], (1.0, 1.0, 1.5), rtol=1e-6)
    np.testing.assert_allclose(closures["emission"][0], emission[0])
    np.testing.assert_allclose(transparency[0], (0.35, 0.225, 0.1), rtol=1e-6)
    np.testing.assert_allclose(closures["transparency"][0], transparency[0])
    assert closures["holdout"][0] == 0.5 and closures["kind"][0] == CLOSURE_DIFFUSE


def test_black_material(device: str):
    """Reflect, emit and let through nothing without a program."""
    closures, emission, transparency = run(device, make_scene(device, ProgramBuilder()), make_points(1))
    assert closures["kind"][0] == 0 and not emission.any() and not transparency.any()


def test_pass_principled_arguments(device: str):
    """Hand every argument of the Principled BSDF over in its place."""
    builder = ProgramBuilder()
    depth = builder.input("RAY_DEPTH")
    scalars = ["roughness", "ior", "anisotropic", "anisotropic_rotation", "diffuse_roughness", "metallic",
               "specular_level", "transmission", "subsurface", "coat", "coat_roughness", "coat_ior", "sheen",
               "sheen_roughness"]
    colors = ["color", "specular_tint", "coat_tint", "sheen_tint"]
    arguments = {name: builder.math("ADD", depth, float(i)) for i, name in enumerate(scalars)}
    arguments |= {name: (0.1 * i, 0.2, 0.3) for i, name in enumerate(colors)}
    builder.closure("PRINCIPLED", 1.0, multiscatter=True, emission=(4.0, 5.0, 6.0), thin_wall=1.0,
                    normal=(0.0, 3.0, 0.0), coat_normal=(2.0, 0.0, 0.0), tangent=(1.0, 0.0, 0.0), **arguments)
    closure = run(device, make_scene(device, builder), make_points(1))[0][0]
    for i, name in enumerate(scalars):
        assert closure[name] == 2.0 + i, name
    for i, name in enumerate(colors):
        np.testing.assert_allclose(closure[name], (0.1 * i, 0.2, 0.3), rtol=1e-6)
    np.testing.assert_allclose(closure["emission_layered"], (4.0, 5.0, 6.0))
    np.testing.assert_allclose(closure["normal"], (0.0, 1.0, 0.0))
    np.testing.assert_allclose(closure["coat_normal"], (1.0, 0.0, 0.0))
    assert closure["thin_wall"] == 1 and closure["multiscatter"] == 1


def test_normals_default_to_shading_normal(device: str):
    """Use the shading normal, and for the coat the base's, where none is linked."""
    builder = ProgramBuilder()
    builder.closure("PRINCIPLED", 1.0, color=0.5)
    closure = run(device, make_scene(device, builder), make_points(1))[0][0]
    np.testing.assert_allclose(closure["normal"], (0.0, 0.0, 1.0))
    np.testing.assert_allclose(closure["coat_normal"], (0.0, 0.0, 1.0))


@pytest.mark.parametrize(("name", "expected"), [
    ("POSITION", (12.0, 4.0, 3.0)), ("SCENE_POSITION", (2.0, 4.0, 3.0)), ("OBJECT", (0.5, 1.0, 0.0)),
    ("GENERATED", (0.75, 1.0, 0.5)), ("OBJECT_LOCATION", (11.0, 2.0, 3.0)), ("PARAMETRIC", (0.25, 0.25, 0.0)),
    ("OBJECT_COLOR", (0.1, 0.2, 0.3)), ("OBJECT_RANDOM", (0.7, 0.7, 0.7)), ("MATERIAL_INDEX", (9.0, 9.0, 9.0)),
    ("RAY_LENGTH", (5.0, 5.0, 5.0)), ("REFLECTION", (0.0, 0.0, 1.0)),
])
def test_inputs(device: str, name: str, expected: tuple):
    """Read the point, the object and the ray; world coordinates contain the scene's origin."""
    np.testing.assert_allclose(value(device, lambda build: build.input(name)), expected, rtol=1e-6, atol=1e-6)


def test_interpolate_uv_and_attributes(device: str):
    """Interpolate over the triangle, alpha included."""
    np.testing.assert_allclose(value(device, lambda build: build.uv("m")), (1.0, 2.0, 0.0), rtol=1e-6)
    np.testing.assert_allclose(value(device, lambda build: build.attribute("a")), (0.25, 0.5, 0.0), rtol=1e-6)
    alpha = value(device, lambda build: build.component(build.attribute("a"), 3))
    np.testing.assert_allclose(alpha, 0.75, rtol=1e-6)


def test_carry_filter_width(device: str):
    """Scale the footprint to UV units, and on through mappings."""
    # The UV triangle has edges of 4 where the world's are 4 m: footprints carry over one to one.
    width = value(device, lambda build: build.component(build.uv("m"), 3))
    np.testing.assert_allclose(width, 0.01, rtol=1e-5)
    rows = [(3.0, 0.0, 0.0, 1.0), (0.0, 3.0, 0.0, 0.0), (0.0, 0.0, 3.0, 0.0)]
    width = value(device, lambda build: build.component(build.transform(rows, build.uv("m")), 3))
    np.testing.assert_allclose(width, 0.03, rtol=1e-5)


def test_bump_on_a_ramp(device: str):
    """Bend the normal by exactly the slope of a linear height."""
    normal = value(device, lambda build: build.bump(
        build.component(build.input("POSITION"), 0), 1.0, 0.5, 0.1))
    np.testing.assert_allclose(normal, np.array([-0.5, 0.0, 1.0]) / np.sqrt(1.25), atol=2e-3)
    flat = value(device, lambda build: build.bump(build.input("RAY_DEPTH"), 1.0, 0.5, 0.1))
    np.testing.assert_allclose(flat, (0.0, 0.0, 1.0), atol=1e-6)


def test_normal_map_on_back_faces(device: str):
    """Keep the normal on the viewer's side and the map's x along u."""
    def build(builder: ProgramBuilder):
        return builder.normal_map(
            "TANGENT", (0.5 + 0.3, 0.5, 0.9), 1.0, uv_map="m", tangent_attribute=tangent_attribute("m"))

    expected = np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(value(device, build), expected, atol=1e-5)
    points = make_points(1)
    points["backfacing"], points["normal"], points["geometric_normal"] = 1, (0, 0, -1), (0, 0, -1)
    np.testing.assert_allclose(value(device, build, points), -expected, atol=1e-5)


def test_machine_agrees_with_folding(device: str):
    """Compute every operation alike in the kernel and while building, where both can."""
    names = [name for name in vars(codes) if name.startswith(("MATH_", "MIX_"))]
    folded, builder = [], ProgramBuilder()
    nearly = builder.math("MULTIPLY", builder.input("RAY_DEPTH"), 0.5)
    for name in names:
        family, operation = name.split("_", 1)
        op = codes.OP_MATH if family == "MATH" else codes.OP_MIX
        operands = tuple((x, x, x, 0.0) for x in (1.0, 0.7, 0.4))
        expected = fold(op, getattr(codes, name), operands)
        if expected is None:
            continue
        method = builder.math if family == "MATH" else builder.mix
        builder.emit(method(operation, nearly, 0.7, 0.4), 1.0, 1.0)
        folded.append(expected[0])
    total = run(device, make_scene(device, builder), make_points(1))[1][0]
    assert len(folded) > 40
    assert total[0] == pytest.approx(sum(folded), rel=1e-5)


def test_noise_range(device: str):
    """Keep normalised noise within 0..1 and centred."""
    builder = ProgramBuilder()
    builder.emit(builder.procedural("NOISE", builder.vector("MULTIPLY", builder.input("SCENE_POSITION"), 7.3),
                                    (2.0, 0.5, 2.0), (0.0, 1.0, 0.0)), 1.0, 1.0)
    points = make_points(4096)
    points["position"] = np.random.default_rng(1).uniform(-50.0, 50.0, (4096, 3))
    noise = run(device, make_scene(device, builder), points)[1][:, 0]
    assert noise.min() > 0.0 and noise.max() < 1.0
    assert noise.mean() == pytest.approx(0.5, abs=0.02) and noise.std() > 0.05


def test_world_depends_on_ray_kind(device: str):
    """Show directions and kinds of rays to the world's program."""
    world = ProgramBuilder()
    world.emit(world.input("GENERATED"), 1.0, world.input("RAY_KIND", 4))
    scene = make_scene(device, world=world)
    directions = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]], np.float32)
    for visibility, factor in ((4, 1.0), (1, 0.0)):
        radiance = wp.zeros(2, dtype=wp.vec3, device=device)
        wp.launch(evaluate_sky, 2, device=device, outputs=[radiance], inputs=[
            scene, wp.array(directions, dtype=wp.vec3, device=device), visibility])
        np.testing.assert_allclose(radiance.numpy(), directions * factor, rtol=1e-6)
