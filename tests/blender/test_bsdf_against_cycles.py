# SPDX-License-Identifier: GPL-3.0-or-later
"""The BSDFs against Cycles itself: the light that single tilted planes return under three known skies.

Cycles renders one small plane per case, seen from straight above and invisible to all rays but the camera's; a pixel
is then the lobe's integral over the sky. The skies are 1, (1 + d) / 2 and d^2 per component of the direction d, so
equal pixels mean equal albedo, mean direction and spread. The sky is met by BSDF samples alone: Cycles' evaluation
of rough refraction accepts half vectors that no facet can have (its source notes so), which its own sampling, and
ours, do not.
"""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from burnish.kernels import types

from tests.bsdf_cases import closure, moments, point, view

pytestmark = pytest.mark.slow

TOLERANCE = 0.01
"""Of the brighter channel: Cycles' own noise at 144 x 64 samples a plane is about 0.003."""
SHEEN_TOLERANCE = 0.02
"""Absolute: the sheen is a closed-form fit to the tables that Cycles interpolates."""

THIN_WALLS = not importlib.metadata.version("bpy").startswith(("5.0.", "5.1."))
"""Whether Blender's Principled BSDF has them: since 5.2."""

FIELDS = {
    "Base Color": "color", "Color": "color", "Metallic": "metallic", "Roughness": "roughness", "IOR": "ior",
    "Specular IOR Level": "specular_level", "Specular Tint": "specular_tint", "Transmission Weight": "transmission",
    "Coat Weight": "coat", "Coat Roughness": "coat_roughness", "Coat IOR": "coat_ior", "Coat Tint": "coat_tint",
    "Sheen Weight": "sheen", "Sheen Roughness": "sheen_roughness", "Sheen Tint": "sheen_tint",
    "Diffuse Roughness": "diffuse_roughness", "Thin Wall": "thin_wall", "Subsurface Weight": "subsurface",
    "Subsurface Anisotropy": "subsurface_anisotropy", "Thin Film Thickness": "film_thickness",
    "Thin Film IOR": "film_ior", "Size": "roughness", "Smooth": "anisotropic",
}
"""Sockets of the nodes and fields of the closure"""

NODES = {
    "ShaderNodeBsdfPrincipled": types.CLOSURE_PRINCIPLED, "ShaderNodeBsdfDiffuse": types.CLOSURE_DIFFUSE,
    "ShaderNodeBsdfAnisotropic": types.CLOSURE_GLOSSY, "ShaderNodeBsdfGlass": types.CLOSURE_GLASS,
    "ShaderNodeBsdfRefraction": types.CLOSURE_REFRACTION, "ShaderNodeBsdfTranslucent": types.CLOSURE_TRANSLUCENT,
    "ShaderNodeBsdfSheen": types.CLOSURE_SHEEN, "ShaderNodeBsdfToonDIFFUSE": types.CLOSURE_TOON_DIFFUSE,
    "ShaderNodeBsdfToonGLOSSY": types.CLOSURE_TOON_GLOSSY,
}

SCRIPT = r"""
import json, math
import bpy
import numpy as np
import OpenImageIO as oiio

cases, folder, samples = json.loads(sys.argv[1]), sys.argv[2], 64
PIXELS = 16
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.engine = 'CYCLES'
settings = scene.cycles
settings.samples, settings.use_adaptive_sampling, settings.use_denoising = samples, False, False
settings.sample_clamp_indirect, settings.blur_glossy, settings.pixel_filter_type = 0, 0, 'BOX'
columns = math.ceil(math.sqrt(len(cases)))
rows = -(-len(cases) // columns)
scene.render.resolution_x, scene.render.resolution_y = columns * PIXELS, rows * PIXELS
camera = bpy.data.cameras.new("camera")
camera.type, camera.ortho_scale, camera.clip_end = 'ORTHO', max(columns, rows), 1e4
scene.camera = bpy.data.objects.new("camera", camera)
scene.camera.location = (columns / 2, rows / 2, 1000)
scene.collection.objects.link(scene.camera)

def link_vector(tree, socket, vector):
    node = tree.nodes.new("ShaderNodeCombineXYZ")
    for i in range(3):
        node.inputs[i].default_value = vector[i]
    tree.links.new(node.outputs[0], socket)

for i, case in enumerate(cases):
    material = bpy.data.materials.new("material")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    node = tree.nodes.new(case["node"])
    tree.links.new(node.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
    if case["distribution"]:
        setattr(node, "component" if "Toon" in case["node"] else "distribution", case["distribution"])
    for name, value in case["inputs"].items():
        if isinstance(value, list):
            value = [*value, 1.0][:len(node.inputs[name].default_value)]
        node.inputs[name].default_value = value
    if case["normal"]:
        link_vector(tree, node.inputs["Normal"], case["normal"])
    slope = math.sqrt(1 - case["cosine"] ** 2) / case["cosine"]
    corners = [(x, y, -x * slope) for x, y in ((-.5, -.5), (.5, -.5), (.5, .5), (-.5, .5))]
    mesh = bpy.data.meshes.new("plane")
    mesh.from_pydata(corners, [], [(3, 2, 1, 0) if case["backfacing"] else (0, 1, 2, 3)])
    mesh.materials.append(material)
    plane = bpy.data.objects.new("plane", mesh)
    plane.location = (i % columns + .5, i // columns + .5, 0)
    plane.visible_diffuse = plane.visible_glossy = plane.visible_transmission = plane.visible_shadow = False
    scene.collection.objects.link(plane)

world = bpy.data.worlds.new("world")
scene.world = world
world.use_nodes = True
world.cycles.sampling_method = 'NONE'
tree = world.node_tree
tree.nodes.clear()
background = tree.nodes.new("ShaderNodeBackground")
tree.links.new(background.outputs[0], tree.nodes.new("ShaderNodeOutputWorld").inputs[0])
direction = tree.nodes.new("ShaderNodeTexCoord").outputs['Generated']
ramp = tree.nodes.new("ShaderNodeVectorMath")
ramp.operation = 'MULTIPLY_ADD'
ramp.inputs[1].default_value = ramp.inputs[2].default_value = (.5, .5, .5)
square = tree.nodes.new("ShaderNodeVectorMath")
square.operation = 'MULTIPLY'
for socket in (ramp.inputs[0], square.inputs[0], square.inputs[1]):
    tree.links.new(direction, socket)
scene.render.image_settings.file_format = 'OPEN_EXR'
scene.render.image_settings.color_depth = '32'
result = []
for sky in (None, ramp, square):
    for link in list(background.inputs[0].links):
        tree.links.remove(link)
    background.inputs[0].default_value = (1, 1, 1, 1)
    if sky:
        tree.links.new(sky.outputs[0], background.inputs[0])
    scene.render.filepath = folder + "/sky.exr"
    bpy.ops.render.render(write_still=True)
    pixels = oiio.ImageInput.open(scene.render.filepath).read_image()[::-1, :, :3].astype(float)
    tiles = pixels.reshape(rows, PIXELS, columns, PIXELS, 3)[:, 2:-2, :, 2:-2].mean((1, 3))
    result.append(tiles.reshape(-1, 3)[:len(cases)])
np.save(folder + "/moments.npy", np.stack(result, 1))
"""


def case(node: str, inputs: dict, cosine: float, *, backfacing: bool = False, distribution: str | None = None,
         tilt: float | None = None) -> dict:
    """Return one case: a node with inputs on a plane seen at a cosine; `tilt` [rad] bends its normal."""
    normal = None
    if tilt is not None:
        x, _, z = view(cosine)
        normal = np.array([x * np.cos(tilt) + z * np.sin(tilt), 0.2, z * np.cos(tilt) - x * np.sin(tilt)])
        normal = (normal / np.linalg.norm(normal)).tolist()
    return {"node": node, "inputs": inputs, "cosine": cosine, "backfacing": backfacing, "distribution": distribution,
            "normal": normal}


def opaque_cases() -> list[dict]:
    """Return metals, dielectrics, coats and mixtures."""
    principled = [dict(Metallic=1.0, Roughness=r, **{"Base Color": [.9, .6, .2], "Specular Tint": [.8, .9, 1]})
                  for r in (0.0, 0.3, 1.0)]
    principled += [dict(Roughness=r, IOR=i, **{"Base Color": [.8, .5, .2]})
                   for r in (0.0, 0.4, 1.0) for i in (0.8, 1.5, 3.0)]
    principled += [{"Base Color": [.2, .5, .8], "Coat Weight": 1.0, "Coat Roughness": r, "Coat Tint": [.9, .6, 1]}
                   for r in (0.0, 0.5)]
    principled += [
        {"Base Color": [.8, .5, .2], "Roughness": .2, "Specular IOR Level": .9, "Specular Tint": [1, .5, .2]},
        {"Base Color": [.8, .5, .2], "Roughness": .2, "Specular IOR Level": 0.0, "Diffuse Roughness": .7},
        {"Base Color": [.9, .7, .3], "Roughness": .4, "Thin Wall": True, "Subsurface Weight": .8,
         "Subsurface Anisotropy": .3, "Diffuse Roughness": .5},
    ]
    # Not the cosine 0.6: there IOR 0.8 has its critical angle, and rounding decides.
    result = [case("ShaderNodeBsdfPrincipled", inputs, c, distribution='MULTI_GGX')
              for inputs in principled for c in (.2, .65, .95)]
    for roughness in (0.0, 0.6):
        for c in (.2, .8):
            inputs = {"Color": [.8, .5, .2], "Roughness": roughness}
            result.append(case("ShaderNodeBsdfDiffuse", inputs, c))
            result += [case("ShaderNodeBsdfAnisotropic", inputs, c, distribution=d) for d in ('GGX', 'MULTI_GGX')]
    return result


def transmissive_cases() -> list[dict]:
    """Return glass in all forms, from both sides."""
    result = []
    for roughness in (0.0, 0.4, 0.9):
        for back in (False, True):
            for c in (.2, .6, .95):
                solid = {"Base Color": [.8, .5, .2], "Roughness": roughness, "Transmission Weight": 1.0, "IOR": 1.5}
                simple = {"Color": [.8, .5, .2], "Roughness": roughness, "IOR": 1.4}
                options = {"backfacing": back, "distribution": 'MULTI_GGX'}
                result.append(case("ShaderNodeBsdfPrincipled", solid, c, **options))
                result.append(case("ShaderNodeBsdfPrincipled", solid | {"Thin Wall": True}, c, **options))
                result.append(case("ShaderNodeBsdfGlass", simple, c, **options))
                result.append(case("ShaderNodeBsdfRefraction", simple, c, backfacing=back, distribution='GGX'))
    return result


def bumped_cases() -> list[dict]:
    """Return lobes whose normal differs from the plane's."""
    nodes = [("ShaderNodeBsdfDiffuse", {"Roughness": 0.5}, None), ("ShaderNodeBsdfTranslucent", {}, None),
             ("ShaderNodeBsdfAnisotropic", {"Roughness": 0.3}, 'MULTI_GGX'),
             ("ShaderNodeBsdfGlass", {"Roughness": 0.4, "IOR": 1.5}, 'MULTI_GGX')]
    return [case(node, inputs | {"Color": [.9, .6, .3]}, c, distribution=distribution, tilt=np.radians(tilt))
            for node, inputs, distribution in nodes for c in (.3, .9) for tilt in (-70, -30, 15, 40)]


def film_cases() -> list[dict]:
    """Return thin films on metals, dielectrics and glass, from both sides of that."""
    films = [{"Thin Film Thickness": t, "Thin Film IOR": i, "Roughness": r, "Base Color": [.9, .6, .3]}
             for t, i, r in ((120.0, 1.33, 0.1), (400.0, 1.8, 0.4), (700.0, 1.2, 0.6), (0.5, 1.5, 0.2))]
    bases = [{}, {"Specular IOR Level": .9, "Specular Tint": [1, .5, .2]}, {"IOR": 1.0},
             {"Metallic": 1.0, "Specular Tint": [.8, .9, 1]}, {"Metallic": .5, "Coat Weight": .5}]
    glass = {"Transmission Weight": 1.0}
    result = [case("ShaderNodeBsdfPrincipled", film | base, c, distribution='MULTI_GGX')
              for film in films for base in bases for c in (.3, .9)]
    result += [case("ShaderNodeBsdfPrincipled", film | base, c, backfacing=back, distribution='MULTI_GGX')
               for film in films for base in (glass, glass | {"Thin Wall": True}) for back in (False, True)
               for c in (.3, .9)]
    simple = {"Color": [.8, .5, .2], "Roughness": 0.3, "Thin Film Thickness": 300.0, "Thin Film IOR": 1.6, "IOR": 1.4}
    return result + [case("ShaderNodeBsdfGlass", simple, c, backfacing=back, distribution='MULTI_GGX')
                     for back in (False, True) for c in (.3, .9)]


def sheen_cases() -> list[dict]:
    """Return sheen over a range of roughness."""
    return [case("ShaderNodeBsdfSheen", {"Color": [1, 1, 1], "Roughness": r}, c)
            for r in (.1, .3, .5, .7, 1.0) for c in (.1, .3, .6, .95)]


def toon_cases() -> list[dict]:
    """Return cones of several widths and edges, also of bumped surfaces."""
    return [case("ShaderNodeBsdfToon", {"Color": [.8, .5, .2], "Size": size, "Smooth": smooth}, c, distribution=kind,
                 tilt=tilt)
            for kind in ('DIFFUSE', 'GLOSSY') for size, smooth in ((.5, 0.0), (.3, .3), (1.0, .5), (.1, 1.0), (0.0, .4))
            for c, tilt in ((.9, None), (.4, None), (.7, .4))]


def integrate(cases: list[dict]) -> np.ndarray:
    """Return our integrals of the cases under the three skies."""
    closures, points = [], []
    for entry in cases:
        fields = {}
        for name, value in entry["inputs"].items():
            fields[FIELDS[name]] = int(value) if isinstance(value, bool) else value
        plane = view(entry["cosine"])
        normal = entry["normal"] or plane
        kind = NODES[entry["node"] + (entry["distribution"] if "Toon" in entry["node"] else "")]
        closures.append(closure(kind=int(kind), normal=normal, coat_normal=normal,
                                multiscatter=int(entry["distribution"] != 'GGX'), **fields))
        points.append(point((0, 0, 1), backfacing=int(entry["backfacing"]), normal=plane))
    return moments(closures, points, 1 << 14)


@pytest.mark.parametrize("group", [
    opaque_cases, transmissive_cases, film_cases, bumped_cases, sheen_cases, toon_cases])
def test_lobes_agree_with_cycles(
    group: Callable[[], list[dict]], tmp_path: Path, run_python: Callable[..., subprocess.CompletedProcess]
) -> None:
    """Return the same light as Cycles for every case under every sky."""
    cases = [entry for entry in group() if THIN_WALLS or "Thin Wall" not in entry["inputs"]]
    process = run_python(SCRIPT, json.dumps(cases), tmp_path)
    assert process.returncode == 0, process.stderr
    theirs, ours = np.load(tmp_path / "moments.npy"), integrate(cases)
    if group is sheen_cases:
        error, limit = np.abs(ours - theirs), SHEEN_TOLERANCE
    else:
        error, limit = np.abs(ours - theirs) / np.maximum(theirs.max((1, 2), keepdims=True), 1e-3), TOLERANCE
    wrong = [f"{cases[i]}: Cycles {theirs[i].round(4).tolist()}, ours {ours[i].round(4).tolist()}"
             for i in np.flatnonzero(error.max((1, 2)) > limit)]
    assert not wrong, "\n".join(wrong)
