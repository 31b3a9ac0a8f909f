# SPDX-License-Identifier: GPL-3.0-or-later
"""The 32 materials of the stress scene, each at an extreme, with the shape that shows it."""

from __future__ import annotations

import bpy
import parts
import textures

Specimen = tuple[str, bpy.types.Material, str]
"""Shape, material, and what is special about the object (mirrored, sheared, speck, or nothing)"""


def specimens() -> list[Specimen]:
    """Return all specimens, row by row from the top left."""
    return [*opaque(), *transmitting(), *layered(), *graphs()]


def opaque() -> list[Specimen]:
    """Return the extremes of roughness, metallic, IOR and specular tint."""
    make = parts.material
    red = (0.62, 0.05, 0.04)
    return [
        ("ball", make("Dielectric roughness 0", base_color=(0.80, 0.80, 0.78), roughness=0.0), ""),
        ("ball", make("Dielectric roughness 1", base_color=(0.80, 0.80, 0.78), roughness=1.0), ""),
        ("ball", make("Metal roughness 0", base_color=(0.95, 0.93, 0.88), metallic=1.0, roughness=0.0), ""),
        ("ball", make("Metal roughness 1", base_color=(0.95, 0.64, 0.54), metallic=1.0, roughness=1.0), ""),
        ("vase", make("IOR 1", base_color=red, ior=1.0, roughness=0.15), ""),
        ("vase", make("IOR 1.45", base_color=red, ior=1.45, roughness=0.15), ""),
        ("vase", make("IOR 2.5", base_color=red, ior=2.5, roughness=0.15), ""),
        ("ball", make("F82 tint", base_color=(0.25, 0.30, 0.75), metallic=1.0, roughness=0.25,
                      specular_tint=(0.1, 0.9, 0.3)), ""),
    ]


def transmitting() -> list[Specimen]:
    """Return what lets light through: smooth, rough, coloured, matched and strong IOR, alpha, translucency."""
    make = parts.material
    alpha = make("Alpha 0, 0.5, 1", base_color=(0.85, 0.45, 0.08), roughness=0.3)
    bands = parts.image("Alpha bands", textures.alpha_stripes(128))
    texture = parts.textured(alpha, bands, socket="Alpha", output="Alpha")
    texture.interpolation = "Closest"
    return [
        ("ball", glass("Glass smooth", (1, 1, 1), roughness=0.0, ior=1.45), ""),
        ("ball", glass("Glass rough", (0.75, 0.93, 1.0), roughness=0.35, ior=1.45), ""),
        ("ball", glass("Glass IOR 2.5", (1, 1, 1), roughness=0.0, ior=2.5), ""),
        ("ball", glass("Glass IOR 1", (0.80, 0.93, 0.70), roughness=0.0, ior=1.0), ""),
        ("ball", alpha, ""),
        ("ball", parts.node_material("Glass BSDF", lambda m: parts.add_node(
            m, "BsdfGlass", {"Color": (1.0, 0.62, 0.55), "Roughness": 0.1, "IOR": 1.5})), ""),
        ("pane", parts.node_material("Translucent BSDF", lambda m: parts.add_node(
            m, "BsdfTranslucent", {"Color": (0.85, 0.55, 0.25)})), ""),
        ("ring", parts.node_material("Transparent BSDF", lambda m: parts.add_node(
            m, "BsdfTransparent", {"Color": (0.35, 0.75, 0.50)})), ""),
    ]


def glass(name: str, color: tuple[float, float, float], **inputs) -> bpy.types.Material:
    """Return a Principled material that transmits everything."""
    return parts.material(name, base_color=color, transmission_weight=1.0, **inputs)


def layered() -> list[Specimen]:
    """Return coat, sheen, half transmission, emission huge and tiny, and transformed objects."""
    make = parts.material
    weave = textures.checker(64, 16, (0.75, 0.60, 0.12), (0.12, 0.32, 0.46))
    checked = make("Negative scale", roughness=0.35)
    parts.textured(checked, parts.image("Weave", weave))
    normals = textures.normals_from_height(textures.height_field(128, frequency=5), 0.09)
    add_normal_map(checked, parts.image("Waves normal", normals, data=True), 1.0)
    return [
        ("ball", make("Coat over rough metal", base_color=(0.55, 0.09, 0.05), metallic=1.0, roughness=0.55,
                      coat_weight=1.0, coat_roughness=0.0), ""),
        ("ball", make("Tinted rough coat", base_color=(0.75, 0.75, 0.75), roughness=0.6, coat_weight=1.0,
                      coat_roughness=0.35, coat_ior=1.9, coat_tint=(0.95, 0.50, 0.10)), ""),
        ("ball", make("Sheen on black", base_color=(0.01, 0.01, 0.015), roughness=0.9, sheen_weight=1.0,
                      sheen_roughness=0.3, sheen_tint=(0.7, 0.8, 1.0)), ""),
        ("ball", make("Half of everything", base_color=(0.35, 0.60, 0.25), metallic=0.5, roughness=0.5,
                      transmission_weight=0.5, coat_weight=0.5, sheen_weight=0.5, alpha=0.8), ""),
        ("ball", make("Emission huge", base_color=(0, 0, 0), emission_color=(1.0, 0.55, 0.18),
                      emission_strength=3000.0), "speck"),
        ("ball", make("Emission tiny", base_color=(0.02, 0.02, 0.02), roughness=0.5, emission_color=(0.1, 0.4, 1.0),
                      emission_strength=0.02), ""),
        ("cube", checked, "mirrored"),
        ("ring", make("Sheared ring", base_color=(0.90, 0.76, 0.40), metallic=1.0, roughness=0.12), "sheared"),
    ]


def add_normal_map(material: bpy.types.Material, image: bpy.types.Image, strength: float) -> None:
    """Feed a tangent-space normal map into a Principled material."""
    texture = parts.textured(material, image, socket=None)
    node = parts.add_node(material, "NormalMap", {"Strength": strength, "Color": texture.outputs["Color"]})
    material.node_tree.links.new(node.outputs[0], parts.shader_of(material).inputs["Normal"])


def graphs() -> list[Specimen]:
    """Return node graphs: normal map, bump, Mix and Add Shader, ramps and maths, Light Path."""
    strong = parts.material("Normal map strong", base_color=(0.65, 0.62, 0.60), roughness=0.2)
    normals = textures.normals_from_height(textures.height_field(128, seed=9), 0.12)
    add_normal_map(strong, parts.image("Strong normal", normals, data=True), 2.0)
    bumped = parts.material("Bump", base_color=(0.12, 0.30, 0.34), metallic=0.0, roughness=0.25)
    height = parts.textured(bumped, parts.image("Studs", textures.gray(textures.studs(128, 8)), data=True), socket=None)
    bump = parts.add_node(bumped, "Bump", {"Strength": 1.0, "Distance": 0.04, "Height": height.outputs["Color"]})
    bumped.node_tree.links.new(bump.outputs[0], parts.shader_of(bumped).inputs["Normal"])
    plain = parts.node_material
    return [
        ("ball", strong, ""), ("ball", bumped, ""),
        ("ball", plain("Mix Shader", mix_shader), ""),
        ("ball", plain("Add Shader", add_shader), ""),
        ("ball", ramp_and_maths(), ""),
        ("cube", plain("Light Path", light_path), ""),
        ("vase", plain("Diffuse BSDF roughness 1", lambda m: parts.add_node(
            m, "BsdfDiffuse", {"Color": (0.72, 0.52, 0.36), "Roughness": 1.0})), ""),
        ("vase", plain("Glossy BSDF", lambda m: parts.add_node(
            m, "BsdfAnisotropic", {"Color": (0.55, 0.75, 0.90), "Roughness": 0.28})), ""),
    ]


def mix_shader(material: bpy.types.Material) -> bpy.types.ShaderNode:
    """Mix a diffuse and a glossy shader by the red channel of an image."""
    uv = parts.add_node(material, "UVMap", uv_map="UVMap")
    mapping = parts.add_node(material, "Mapping", {"Vector": uv.outputs[0], "Scale": (2.0, 1.0, 1.0)})
    mapping.inputs["Rotation"].default_value = (0.0, 0.0, 0.6)
    board = parts.image("Mix mask", textures.checker(64, 4, (1, 1, 1), (0, 0, 0)), data=True)
    mask = parts.add_node(material, "TexImage", {"Vector": mapping.outputs[0]}, image=board)
    channels = parts.add_node(material, "SeparateColor", {"Color": mask.outputs["Color"]})
    diffuse = parts.add_node(material, "BsdfDiffuse", {"Color": (0.60, 0.10, 0.30)})
    glossy = parts.add_node(material, "BsdfAnisotropic", {"Color": (0.95, 0.85, 0.60), "Roughness": 0.1})
    return parts.add_node(
        material, "MixShader", {0: channels.outputs["Red"], 1: diffuse.outputs[0], 2: glossy.outputs[0]})


def add_shader(material: bpy.types.Material) -> bpy.types.ShaderNode:
    """Add a diffuse, a glossy and a faint emission shader."""
    diffuse = parts.add_node(material, "BsdfDiffuse", {"Color": (0.05, 0.30, 0.12)})
    glossy = parts.add_node(material, "BsdfAnisotropic", {"Color": (0.35, 0.35, 0.35), "Roughness": 0.05})
    emission = parts.add_node(material, "Emission", {"Color": (0.0, 0.12, 0.03), "Strength": 0.4})
    both = parts.add_node(material, "AddShader", {0: diffuse.outputs[0], 1: glossy.outputs[0]})
    return parts.add_node(material, "AddShader", {0: both.outputs[0], 1: emission.outputs[0]})


def ramp_and_maths() -> bpy.types.Material:
    """Return a material whose colour and roughness come from a ramp, Math, Mix and Combine Color nodes."""
    material = parts.material("Ramp and maths", metallic=1.0)
    tree, shader = material.node_tree, parts.shader_of(material)
    uv = parts.add_node(material, "UVMap", uv_map="UVMap")
    axes = parts.add_node(material, "SeparateXYZ", {0: uv.outputs[0]})
    wave = parts.add_node(material, "Math", {0: axes.outputs[1], 1: 5.0}, operation="MULTIPLY")
    stairs = parts.add_node(material, "Math", {0: wave.outputs[0]}, operation="FRACT")
    ramp = parts.add_node(material, "ValToRGB", {"Fac": stairs.outputs[0]})
    ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = (0.9, 0.2, 0.05, 1), (0.1, 0.3, 0.9, 1)
    ramp.color_ramp.elements.new(0.5).color = (0.9, 0.8, 0.3, 1.0)
    combined = parts.add_node(material, "CombineColor", {0: axes.outputs[0], 1: 0.5, 2: 0.8}, mode="HSV")
    mix = parts.add_node(material, "Mix", data_type="RGBA", blend_type="MULTIPLY")
    colors = [socket for socket in mix.inputs if socket.type == "RGBA"]
    mix.inputs[0].default_value = 0.5
    tree.links.new(ramp.outputs["Color"], colors[0])
    tree.links.new(combined.outputs["Color"], colors[1])
    tree.links.new(next(s for s in mix.outputs if s.type == "RGBA"), shader.inputs["Base Color"])
    rough = parts.add_node(material, "Math", {0: stairs.outputs[0], 1: 0.5, 2: 0.05}, operation="MULTIPLY_ADD")
    tree.links.new(rough.outputs[0], shader.inputs["Roughness"])
    return material


def light_path(material: bpy.types.Material) -> bpy.types.ShaderNode:
    """Show white to the camera and magenta to every other ray, so that its bounce light betrays it."""
    path = parts.add_node(material, "LightPath")
    seen = parts.add_node(material, "BsdfDiffuse", {"Color": (0.75, 0.75, 0.75)})
    other = parts.add_node(material, "BsdfDiffuse", {"Color": (0.85, 0.05, 0.60)})
    return parts.add_node(
        material, "MixShader", {0: path.outputs["Is Camera Ray"], 1: other.outputs[0], 2: seen.outputs[0]})
