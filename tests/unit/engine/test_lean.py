# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the lean node machine: which programs it takes, and that it says of them what the full machine does."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from burnish.engine.lean import LeanPrograms, is_lean, is_lean_transparency
from burnish.engine.passes.reference import path_steps
from burnish.engine.passes.wavefront import Wavefront
from burnish.engine.path_options import path_options
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import ImageData, MaterialData
from burnish.engine.settings import RenderSettings
from burnish.kernels import node_codes as codes
from burnish.kernels import reference, reference_film, types

from tests import scenes
from tests.gbuffer_frames import GBufferFrames
from tests.unit.engine.test_radiance_cache import Rig

PLAIN = {"roughness": 0.4, "ior": 1.45, "specular_level": 0.5, "specular_tint": 1.0, "multiscatter": True}
LEAN_BITS = int(
    types.MATERIAL_LEAN | types.MATERIAL_LEAN_FLAT | types.MATERIAL_LEAN_TRANSPARENCY | types.MATERIAL_PLAIN)


def textured(transparent: bool = False) -> MaterialData:
    """Make a material that uses most of what the lean machine knows: images, arithmetic, a normal map, emission."""
    b = ProgramBuilder()
    uv = b.transform([[2.0, 0.5, 0.0, 0.1], [-0.5, 2.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.0]], b.uv("UVMap"))
    color, data = b.image("color", uv, associate=True), b.image("data", uv)
    tinted = b.mix("MULTIPLY", 0.7, color, b.mix("MIX", b.vector("X", data), (0.9, 0.5, 0.2), (0.2, 0.6, 0.9)))
    roughness = b.math("MULTIPLY_ADD", b.vector("Y", data), 0.5, 0.2)
    metallic = b.math("GREATER_THAN", b.vector("Z", data), 0.5)
    normal = b.normal_map("TANGENT", b.vector("XYZ", data), 0.6, uv_map="UVMap")
    alpha = 1.0
    if transparent:
        alpha = b.math("CLAMP", b.vector("X", data), 0.1, 0.8)
        b.transparent((1.0, 0.9, 0.8), b.math("SUBTRACT", 1.0, alpha))
    b.closure("PRINCIPLED", alpha, color=tinted, metallic=metallic, normal=normal,
              emission=b.vector("SCALE", color, 0.0, 0.3), **PLAIN | {"roughness": roughness})
    b.emit(tinted, 0.25, alpha)
    return MaterialData(name="textured", program=b.finish(), has_emission=True, has_transparency=transparent)


def lean_materials() -> dict[str, MaterialData]:
    """Make materials that the lean machine must take."""
    return {
        "diffuse": scenes.material(color=(0.2, 0.5, 0.8)),
        "plastic": scenes.material("PRINCIPLED", color=(0.7, 0.3, 0.1), subsurface=0.4, **PLAIN),
        "metal": scenes.material("PRINCIPLED", color=(1.0, 0.7, 0.3), metallic=1.0, **PLAIN | {"specular_tint": 0.6}),
        "half": scenes.material("PRINCIPLED", color=0.6, metallic=0.5, **PLAIN | {
            "specular_level": 0.8, "multiscatter": False}),
        "textured": textured(),
        "leaf": textured(transparent=True),
    }


def coated() -> MaterialData:
    """Make a material that needs the full machine."""
    return scenes.material("PRINCIPLED", color=0.4, coat=0.5, coat_ior=1.5, coat_tint=1.0, **PLAIN)


def filmed() -> MaterialData:
    """Make a material with a thin film."""
    return scenes.material("PRINCIPLED", color=0.4, film_thickness=300.0, film_ior=1.5, **PLAIN)


def images() -> dict[str, ImageData]:
    """Make two pictures of noise."""
    rng = np.random.default_rng(3)
    return {name: ImageData(name=name, pixels=rng.integers(0, 256, (16, 16, 4), np.uint8))
            for name in ("color", "data")}


def row_of_balls(materials: dict[str, MaterialData]):
    """Make a scene of a smooth ball and a square of each material, side by side."""
    meshes = {"ball": scenes.sphere(0.5, 16), "square": scenes.quad(0.5)}
    rng = np.random.default_rng(5)
    meshes = {
        name: dataclasses.replace(mesh, uv_maps={"UVMap": rng.random((len(mesh.triangles), 3, 2), np.float32)})
        for name, mesh in meshes.items()}
    objects = []
    for i, name in enumerate(materials):
        x = i - 0.5 * len(materials) + 0.5
        objects += [("ball", scenes.place(x, 0.55, 0.5), name), ("square", scenes.place(x, -0.55), name)]
    delta = scenes.delta(meshes, objects, materials, background=0.3)
    return dataclasses.replace(delta, images=images())


def use_full_machine(scene) -> None:
    """Take all materials off the lean machine."""
    records = scene.material_table._materials.numpy().copy()
    records["flags"] &= ~LEAN_BITS
    scene.material_table._materials.assign(records)


def test_lean_programs_are_recognised():
    """Take plain materials and nothing that has a lobe, an instruction or a register more."""
    for name, data in lean_materials().items():
        assert is_lean(data.program.surface, data.program) and is_lean_transparency(data.program), name
    b = ProgramBuilder()
    b.closure("DIFFUSE", 0.5, color=0.5)
    b.closure("DIFFUSE", 0.5, color=(0.1, 0.2, 0.3))
    mix = b.finish()
    b = ProgramBuilder()
    b.closure("DIFFUSE", 1.0, color=b.procedural("NOISE", b.input("POSITION")))
    noise = b.finish()
    b = ProgramBuilder()
    leaves = [b.vector("X", b.transform([[0.1, 0.2, 0.3, float(i)]] * 3, b.uv("UVMap"))) for i in range(512)]
    while len(leaves) > 1:
        leaves = [b.math("MULTIPLY", one, other) for one, other in zip(leaves[::2], leaves[1::2], strict=True)]
    b.closure("DIFFUSE", 1.0, color=leaves[0])
    deep = b.finish()
    rejected = [mix, noise, deep, coated().program, scenes.material("GLASS", color=1.0, ior=1.5).program]
    rejected += [scenes.material("PRINCIPLED", color=1.0, **{name: 0.5}, **PLAIN).program
                 for name in ("transmission", "sheen", "thin_wall", "diffuse_roughness")]
    rejected += [filmed().program]
    for program in rejected:
        assert not is_lean(program.surface, program)


def test_flat_programs_have_no_normal_maps():
    """Leave out what only a closure's normal needs."""
    program = textured().program
    assert codes.OP_NORMAL_MAP in [word[0] & 255 for word in program.surface]
    assert codes.OP_NORMAL_MAP not in [word[0] & 255 for word in program.flat]
    assert 0 < len(program.flat) < len(program.surface)
    plain = scenes.material(color=0.5).program
    assert plain.flat == plain.surface


@pytest.mark.parametrize("layers", [False, True])
def test_gbuffers_agree(layers):
    """Fill the G-buffer alike with both machines, and each pixel by one of them."""
    materials = lean_materials() | {"coated": coated()}
    if not layers:
        materials.pop("leaf")
    frames = [GBufferFrames(row_of_balls(materials), (56, 20)) for _ in range(2)]
    assert frames[0].scene.material_table.lean == LeanPrograms(False, False, True, False)
    use_full_machine(frames[1].scene)
    lean = frames[0].gbuffer_pass
    lean.record = functools.partial(lean.record, lean_layers=True)
    camera = scenes.camera_above(half=3.6)
    shots = [frame.shot(camera, jitter=np.array([0.2, -0.3])) for frame in frames]
    assert (shots[0]["hit"] == shots[1]["hit"]).all()
    assert len(np.unique(shots[0]["hit"][..., 0])) > 2 * len(materials)
    for name in ("position", "normal", "geometric_normal", "diffuse", "specular", "f0", "roughness", "emission"):
        np.testing.assert_allclose(
            shots[0][name].astype(np.float32), shots[1][name].astype(np.float32), rtol=6e-3, atol=6e-3, err_msg=name)
    assert (shots[0]["flags"] == shots[1]["flags"]).mean() > 0.98


def test_cache_vertices_agree(device):
    """Find the same reflectance, emission and misses at hits of rays with both machines."""
    found = []
    for full in (False, True):
        rig = Rig(row_of_balls(lean_materials() | {"coated": coated()}), device, count=1024)
        if full:
            use_full_machine(rig.scene)
        rng = np.random.default_rng(1)
        origin = np.stack([rng.uniform(-3.5, 3.5, 1024), rng.uniform(-1, 1, 1024), np.full(1024, 3.0)], -1)
        rig.frame(origin, np.tile([0.0, 0.0, -1.0], (1024, 1)))
        vertices = rig.cache.rays.vertices
        names = ("reflectance", "emission", "normal")
        found.append({name: getattr(vertices, name).numpy()[:1024].copy() for name in names})
    lean, full = found
    hit = lean["reflectance"][:, :3].max(1) > 0
    assert 0.5 < hit.mean() < 1.0 and (lean["emission"][:, 3] > 0).all()
    np.testing.assert_allclose(lean["reflectance"], full["reflectance"], rtol=2e-3, atol=1e-4)
    np.testing.assert_allclose(lean["emission"], full["emission"], rtol=2e-3, atol=1e-4)
    assert (lean["normal"] == full["normal"])[hit].mean() > 0.99


def test_films_have_a_kernel_of_their_own(device):
    """Launch what knows films where a drawn material has one, and the same kernels as ever elsewhere."""
    for materials, kernel in (({"a": coated()}, reference.shade_paths),
                              ({"a": coated(), "b": filmed()}, reference_film.shade_film_paths)):
        scene = GBufferFrames(row_of_balls(materials), (8, 8)).scene
        options = path_options(RenderSettings(), scene, False)
        steps = path_steps(Wavefront(64, False, device), scene.scene, options)
        kernels = [step.kernel for step in steps]
        assert kernel in kernels
        assert len({reference.shade_paths, reference_film.shade_film_paths} & set(kernels)) == 1
    # What says nothing of films is as long as it was: no argument more is read.
    plain, film = coated().program.surface, filmed().program.surface
    assert len(film) == len(plain) + 2
    assert not any(word[0] >> 16 & int(codes.CLOSURE_FILM) for word in plain)


def test_scenes_of_lean_materials_skip_the_full_machine():
    """Give the same picture when the full machine is left out because nothing needs it."""
    frames = [GBufferFrames(row_of_balls(lean_materials()), (28, 10)) for _ in range(2)]
    assert frames[0].scene.material_table.lean == LeanPrograms()
    record = frames[0].gbuffer_pass.record
    frames[0].gbuffer_pass.record = functools.partial(record, all_lean=True)
    lean, both = (frame.shot(scenes.camera_above(half=3.6)) for frame in frames)
    for name in lean:
        np.testing.assert_array_equal(lean[name], both[name], err_msg=name)
