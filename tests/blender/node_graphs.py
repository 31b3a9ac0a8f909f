# SPDX-License-Identifier: GPL-3.0-or-later
"""Node graphs for test_material.py: each is a function of (nodes, links) that returns the socket to show."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np
from node_scenes import Harness

Graph = Callable
TOLERANCE = 1.0 / 255.0

JITTER = 0.02
"""Cycles' rays meet pixel centres to 1e-2 px: this share of the difference to a neighbour is no error"""


def compare_all(harness: Harness, graphs: dict[str, Graph]) -> dict[str, dict]:
    """Return the largest error and the number of pixels above the tolerance, by graph."""
    results = {}
    for name, graph in graphs.items():
        worst = harness.compare(graph)
        expected, found = harness.last
        allowed = TOLERANCE * np.maximum(1.0, np.abs(expected)) + JITTER * variation(expected)
        results[name] = {"worst": worst, "outliers": int((np.abs(expected - found) > allowed).any(1).sum())}
    return results


def variation(picture: np.ndarray) -> np.ndarray:
    """Return each pixel's largest difference from its neighbours."""
    size = int(len(picture) ** 0.5)
    padded = np.pad(picture.reshape(size, size, 3), ((1, 1), (1, 1), (0, 0)), 'edge')
    center = padded[1:-1, 1:-1]
    neighbours = (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:])
    return np.max([np.abs(center - other) for other in neighbours], axis=0).reshape(-1, 3)


def uv(nodes, links):
    """Return the UV output."""
    return nodes.new("ShaderNodeTexCoord").outputs["UV"]


def vector(nodes, links, scale=(4.0, 3.0, 2.0), offset=(-2.03, -1.04, 0.3)):
    """Return a vector that varies over the plane, about -2..2."""
    node = nodes.new("ShaderNodeVectorMath")
    node.operation = 'MULTIPLY_ADD'
    links.new(uv(nodes, links), node.inputs[0])
    node.inputs[1].default_value, node.inputs[2].default_value = scale, offset
    return node.outputs[0]


def components(nodes, links, **options):
    """Return x, y, z of `vector` as sockets."""
    node = nodes.new("ShaderNodeSeparateXYZ")
    links.new(vector(nodes, links, **options), node.inputs[0])
    return node.outputs


def first_color(nodes, links):
    """Return a colour that leaves 0..1 a little."""
    return vector(nodes, links, scale=(1.2, 1.0, 0.0), offset=(-0.1, 0.0, 0.3))


def second_color(nodes, links):
    """Return another colour."""
    return vector(nodes, links, scale=(-0.8, 0.5, 0.0), offset=(0.9, 0.1, 0.6))


def node_graph(kind: str, output=0, links_to: dict | None = None, values: dict | None = None, **properties) -> Graph:
    """Return a graph of one node, with inputs linked to sockets made by functions, or set."""

    def graph(nodes, links):
        node = nodes.new("ShaderNode" + kind)
        for name, value in properties.items():
            setattr(node, name, value)
        inputs = {socket.identifier: socket for socket in node.inputs}
        for name, value in (values or {}).items():
            inputs[name].default_value = value
        for name, make in (links_to or {}).items():
            links.new(make(nodes, links), inputs[name])
        return next(o for o in node.outputs if o.identifier == output) if isinstance(output, str) \
            else node.outputs[output]

    return graph


def options_of(node: str, name: str) -> list[str]:
    """Return the values of an enumeration of a node type."""
    return [item.identifier for item in getattr(bpy.types, "ShaderNode" + node).bl_rna.properties[name].enum_items]


def coordinate_graphs() -> dict[str, Graph]:
    """Inputs of the surface, the object, the ray and the camera."""
    outputs = {
        "TexCoord": ["Generated", "Normal", "UV", "Object", "Camera", "Window", "Reflection"],
        "NewGeometry": ["Position", "Normal", "Tangent", "True Normal", "Incoming", "Backfacing"],
        "ObjectInfo": ["Location", "Color", "Alpha", "Object Index", "Material Index"],
        "LightPath": ["Is Camera Ray", "Is Shadow Ray", "Ray Length", "Ray Depth"],
        "CameraData": ["View Vector", "View Z Depth", "View Distance"],
    }
    graphs = {f"{kind} {name}": node_graph(kind, name) for kind, names in outputs.items() for name in names}
    graphs["color attribute"] = node_graph("VertexColor", layer_name="Col")
    graphs["attribute factor"] = node_graph("Attribute", "Fac", attribute_name="Col")
    graphs["attribute naming a UV map"] = node_graph("Attribute", "Vector", attribute_name="UVMap")
    graphs["missing attribute"] = node_graph("Attribute", "Color", attribute_name="nowhere")
    graphs["uv map"] = node_graph("UVMap", uv_map="UVMap")
    graphs["tangent uv"] = node_graph("Tangent", direction_type='UV_MAP', uv_map="UVMap")
    graphs["tangent z"] = node_graph("Tangent", direction_type='RADIAL', axis='Z')
    return graphs


def math_graphs() -> dict[str, Graph]:
    """All operations of Math, Clamp and Map Range."""
    x = {"Value": lambda n, t: components(n, t)[0], "Value_001": lambda n, t: components(n, t)[1]}
    graphs = {
        f"math {name}": node_graph("Math", links_to=x, values={"Value_002": 0.7}, operation=name)
        for name in options_of("Math", "operation")}
    for kind in ("MINMAX", "RANGE"):
        graphs[f"clamp {kind}"] = node_graph(
            "Clamp", links_to={"Value": x["Value"]}, values={"Min": 0.8, "Max": 0.2}, clamp_type=kind)
    for kind in options_of("MapRange", "interpolation_type"):
        for clamp in (False, True):
            graphs[f"map range {kind} {clamp}"] = node_graph(
                "MapRange", links_to={"Value": x["Value"]}, interpolation_type=kind, clamp=clamp,
                values={"From Min": 0.8, "From Max": -0.5, "To Min": 0.2, "To Max": 1.7, "Steps": 3.7})
            graphs[f"map range vector {kind} {clamp}"] = node_graph(
                "MapRange", 1, links_to={"Vector": vector}, interpolation_type=kind, clamp=clamp,
                data_type='FLOAT_VECTOR', values={
                    "From_Min_FLOAT3": (-0.5, 0.7, 0.1), "From_Max_FLOAT3": (0.9, -0.4, 0.1),
                    "To_Min_FLOAT3": (1.0, 0.2, 0.3), "To_Max_FLOAT3": (0.0, 0.9, 0.8),
                    "Steps_FLOAT3": (3.03, 2.57, 4.0)})
    return graphs


def vector_graphs() -> dict[str, Graph]:
    """All operations of Vector Math, Vector Rotate and Vector Transform."""
    numbers = {'DOT_PRODUCT', 'DISTANCE', 'LENGTH'}
    graphs = {}
    for name in options_of("VectorMath", "operation"):
        def second(nodes, links):
            return vector(nodes, links, scale=(-1.3, 2.2, 0.0), offset=(0.2, -0.9, 0.4))

        # A second operand that crosses 0 makes quotients and powers as steep as one likes.
        smooth = {'DIVIDE', 'POWER', 'MODULO', 'SNAP'}
        graphs[f"vector {name}"] = node_graph(
            "VectorMath", "Value" if name in numbers else "Vector",
            links_to={"Vector": vector} | ({} if name in smooth else {"Vector_001": second}),
            values={"Vector_001": (0.7, -1.3, 0.4), "Vector_002": (0.7, 0.3, -0.8), "Scale": 0.6}, operation=name)
    for kind in options_of("VectorRotate", "rotation_type"):
        for invert in (False, True):
            graphs[f"rotate {kind} {invert}"] = node_graph(
                "VectorRotate", links_to={"Vector": vector}, rotation_type=kind, invert=invert,
                values={"Center": (0.1, 0.2, 0.3)} | ({"Rotation": (0.3, 0.4, 0.5)} if kind == 'EULER_XYZ' else {}))
    for kind in options_of("VectorTransform", "vector_type"):
        for spaces in (('WORLD', 'OBJECT'), ('OBJECT', 'WORLD')):
            graphs[f"transform {kind} {spaces}"] = node_graph(
                "VectorTransform", links_to={"Vector": vector}, vector_type=kind, convert_from=spaces[0],
                convert_to=spaces[1])
    return graphs


def mix_graphs() -> dict[str, Graph]:
    """All blend types of both Mix nodes, clamped and not; mixes of numbers and vectors."""
    graphs = {}
    for name in options_of("MixRGB", "blend_type"):
        for clamp in (False, True):
            graphs[f"mix {name} {clamp}"] = node_graph(
                "Mix", "Result_Color", data_type='RGBA', blend_type=name, clamp_factor=False, clamp_result=clamp,
                links_to={"A_Color": first_color, "B_Color": second_color},
                values={"Factor_Float": 1.0 if clamp else 0.7})
            graphs[f"old mix {name} {clamp}"] = node_graph(
                "MixRGB", blend_type=name, use_clamp=clamp,
                links_to={"Color1": first_color, "Color2": second_color, "Fac": lambda n, t: components(n, t)[0]})
    for mode in ('UNIFORM', 'NON_UNIFORM'):
        factor = "Factor_Float" if mode == 'UNIFORM' else "Factor_Vector"
        graphs[f"mix vectors {mode}"] = node_graph(
            "Mix", "Result_Vector", data_type='VECTOR', factor_mode=mode,
            links_to={"A_Vector": vector, "B_Vector": second_color, factor: vector})
    graphs["mix numbers"] = node_graph(
        "Mix", "Result_Float", links_to={"A_Float": vector, "B_Float": first_color, "Factor_Float": second_color})
    return graphs


def ramp_graph(interpolation: str, output: int) -> Graph:
    """Return a Color Ramp of three stops."""

    def graph(nodes, links):
        node = nodes.new("ShaderNodeValToRGB")
        node.color_ramp.interpolation = interpolation
        node.color_ramp.elements.new(0.4).color = (0.9, 0.2, 0.1, 0.5)
        node.color_ramp.elements[0].position = 0.1
        links.new(components(nodes, links, scale=(1.2, 1.0, 1.0), offset=(-0.1, 0.0, 0.0))[0], node.inputs[0])
        return node.outputs[output]

    return graph


def curve_graph(kind: str, extend: str) -> Graph:
    """Return a curve node whose input leaves the curves' domain."""

    def graph(nodes, links):
        node = nodes.new("ShaderNode" + kind)
        node.mapping.extend = extend
        node.mapping.curves[0].points.new(0.3, 0.7)
        if kind != "FloatCurve":
            node.mapping.curves[2].points.new(0.5, 0.1)
        if kind == "RGBCurve":
            node.mapping.curves[3].points.new(0.6, 0.4)
        node.mapping.update()
        node.inputs[0].default_value = 0.8
        links.new(vector(nodes, links, scale=(2.0, 2.0, 2.0), offset=(-0.5, -0.5, -0.2)), node.inputs[1])
        return node.outputs[0]

    return graph


def color_graphs() -> dict[str, Graph]:
    """Colour models, corrections, ramps, curves, black bodies."""
    color = {"Color": first_color}
    graphs = {
        "invert": node_graph("Invert", links_to=color, values={"Fac": 0.7}),
        "gamma": node_graph("Gamma", links_to=color, values={"Gamma": 2.2}),
        "contrast": node_graph("BrightContrast", links_to=color, values={"Bright": 0.2, "Contrast": 0.6}),
        "hue": node_graph("HueSaturation", links_to=color,
                          values={"Hue": 0.7, "Saturation": 1.4, "Value": 1.2, "Fac": 0.8}),
        "bw": node_graph("RGBToBW", links_to=color),
        "separate hsv": node_graph("SeparateColor", links_to=color, mode='HSV'),
        "separate hsl": node_graph("SeparateColor", 1, links_to=color, mode='HSL'),
        "color as number": node_graph("Math", links_to={"Value": first_color}, operation='SQRT'),
    }
    graphs["blackbody"] = node_graph("Blackbody", links_to={
        "Temperature": lambda n, t: components(n, t, scale=(13000.0, 1.0, 1.0), offset=(500.0, 0.0, 0.0))[0]})
    for mode in ('RGB', 'HSV', 'HSL'):
        graphs[f"combine {mode}"] = node_graph("CombineColor", mode=mode, values={"Blue": 0.4}, links_to={
            "Red": lambda n, t: components(n, t, scale=(1.0, 1.0, 0.0), offset=(0.0, 0.0, 0.0))[0],
            "Green": lambda n, t: components(n, t, scale=(1.0, 1.0, 0.0), offset=(0.0, 0.0, 0.0))[1]})
    for name in ('LINEAR', 'CONSTANT', 'EASE', 'B_SPLINE', 'CARDINAL'):
        graphs[f"ramp {name}"] = ramp_graph(name, 0)
    graphs["ramp alpha"] = ramp_graph('LINEAR', 1)
    for kind in ("RGBCurve", "VectorCurve", "FloatCurve"):
        for extend in ('EXTRAPOLATED', 'HORIZONTAL'):
            graphs[f"{kind} {extend}"] = curve_graph(kind, extend)
    return graphs


def mapping_graphs() -> dict[str, Graph]:
    """Mapping of every kind, constant and with a linked rotation."""
    graphs = {}
    values = {"Location": (0.1, 0.2, -0.3), "Rotation": (0.5, 0.4, 0.3), "Scale": (1.5, 0.7, -2.0)}
    for kind in ('POINT', 'TEXTURE', 'VECTOR', 'NORMAL'):
        graphs[f"mapping {kind}"] = node_graph("Mapping", links_to={"Vector": vector}, values=values, vector_type=kind)
        graphs[f"mapping {kind} linked"] = node_graph(
            "Mapping", vector_type=kind, values=values,
            links_to={"Vector": vector, "Rotation": lambda n, t: vector(n, t, scale=(0.1, 0.1, 0.1))})
    return graphs


def make_image(name: str, *, width: int = 8, height: int = 6, is_float: bool = True, alpha: bool = False,
               space: str = "") -> bpy.types.Image:
    """Return an image of random texels."""
    image = bpy.data.images.new(name, width, height, alpha=alpha, float_buffer=is_float)
    pixels = np.random.default_rng(3).random((height, width, 4)).astype(np.float32)
    if alpha:
        # Cycles multiplies 8-bit colour by alpha in 8 bits: bright colours and low alphas magnify the rounding.
        pixels[..., :3] *= 0.5
        pixels[..., 3] = 0.7 + 0.3 * pixels[..., 3]
    else:
        pixels[..., 3] = 1.0
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    if space:
        image.colorspace_settings.name = space
    if not is_float:
        image.pack()
    return image


def image_graphs() -> dict[str, Graph]:
    """Images: extension, interpolation, projections, colour spaces, alpha; panoramas."""
    place = {"Vector": lambda n, t: vector(n, t, scale=(2.3, 1.9, 1.0), offset=(-0.61, -0.32, 0.3))}
    texels, alpha = make_image("float"), make_image("alpha", is_float=False, alpha=True)
    graphs = {
        f"image {extension} {interpolation}": node_graph(
            "TexImage", links_to=place, image=texels, extension=extension, interpolation=interpolation)
        for extension in ('REPEAT', 'EXTEND', 'CLIP', 'MIRROR') for interpolation in ('Linear', 'Closest')}
    for projection in ('SPHERE', 'TUBE', 'BOX'):
        graphs[f"image {projection}"] = node_graph(
            "TexImage", links_to=place, image=texels, projection=projection, projection_blend=0.3)
    graphs["active UV map"] = node_graph("TexImage", image=texels)
    graphs["no image"] = node_graph("TexImage")
    graphs["srgb"] = node_graph("TexImage", links_to=place, image=make_image("byte", is_float=False))
    graphs["data"] = node_graph(
        "TexImage", links_to=place, image=make_image("data", is_float=False, space="Non-Color"))
    graphs["alpha unused"] = node_graph("TexImage", links_to=place, image=alpha)
    graphs["alpha"] = node_graph("TexImage", 1, links_to=place, image=alpha)
    panorama = make_image("panorama", width=32, height=16)
    for projection in ('EQUIRECTANGULAR', 'MIRROR_BALL'):
        graphs[f"panorama {projection}"] = node_graph(
            "TexEnvironment", links_to={"Vector": vector}, image=panorama, projection=projection)
    return graphs


def pattern_graphs() -> dict[str, Graph]:
    """Textures without images, and their default coordinates."""
    place = {"Vector": vector}

    def floored(nodes, links):
        return node_graph("VectorMath", links_to=place, operation='FLOOR')(nodes, links)

    colors = {"Color1": (0.9, 0.1, 0.2, 1.0), "Color2": (0.1, 0.3, 0.8, 1.0)}
    graphs = {
        "checker": node_graph("TexChecker", links_to=place, values={**colors, "Scale": 1.7}),
        "checker factor": node_graph("TexChecker", 1, links_to=place, values={"Scale": 1.7}),
        "brick": node_graph(
            "TexBrick", links_to=place, offset=0.4, squash=1.4, squash_frequency=3,
            values={**colors, "Mortar Smooth": 0.5, "Bias": 0.1, "Mortar Size": 0.1, "Scale": 1.3}),
        "magic": node_graph("TexMagic", links_to=place, turbulence_depth=5, values={"Scale": 0.6, "Distortion": 1.3}),
    }
    for kind in options_of("TexGradient", "gradient_type"):
        graphs[f"gradient {kind}"] = node_graph("TexGradient", gradient_type=kind, links_to={
            "Vector": lambda n, t: vector(n, t, scale=(1.5, 1.5, 1.0), offset=(-0.52, -0.63, 0.2))})
    for dimensions in ('1D', '2D', '3D', '4D'):
        linked = {name: floored for name in ("Vector", "W")
                  if not (name == "Vector" and dimensions == '1D' or name == "W" and dimensions in ('2D', '3D'))}
        for output in (0, 1):
            graphs[f"white noise {dimensions} {output}"] = node_graph(
                "TexWhiteNoise", output, links_to=linked, noise_dimensions=dimensions)
    noise = {"Detail": 2.6, "Distortion": 0.7, "Roughness": 0.6, "Lacunarity": 2.1, "Scale": 1.7}
    for output in (0, 1):
        for normalize in (False, True):
            graphs[f"noise {output} {normalize}"] = node_graph(
                "TexNoise", output, links_to=place, values=noise, normalize=normalize)
    wave = {"Scale": 0.4, "Distortion": 1.5, "Phase Offset": 0.4, "Detail": 1.5}
    for profile in ('SIN', 'SAW', 'TRI'):
        graphs[f"bands {profile}"] = node_graph(
            "TexWave", links_to=place, values=wave, wave_profile=profile, bands_direction='DIAGONAL')
        graphs[f"rings {profile}"] = node_graph(
            "TexWave", links_to=place, values=wave, wave_type='RINGS', wave_profile=profile, rings_direction='Z')
    for kind in ("TexNoise", "TexGradient", "TexMagic"):
        graphs[f"default coordinate {kind}"] = node_graph(kind)
    return graphs


def normal_graphs() -> dict[str, Graph]:
    """Normal maps, bump mapping, and weights by viewing angle."""
    def texel(nodes, links):
        return vector(nodes, links, scale=(0.8, 0.7, 0.0), offset=(0.1, 0.1, 0.8))

    graphs = {}
    for space in options_of("NormalMap", "space"):
        for strength in (1.0, 0.4):
            graphs[f"normal map {space} {strength}"] = node_graph(
                "NormalMap", links_to={"Color": texel}, values={"Strength": strength}, space=space)
    if bpy.app.version >= (5, 2, 0):  # which brought the choice
        graphs["normal map of DirectX"] = node_graph(
            "NormalMap", links_to={"Color": texel}, convention='DIRECTX', uv_map="UVMap")
    smooth = make_image("smooth", width=4, height=4)
    heights = {
        "image": node_graph("TexImage", image=smooth),
        "generated noise": node_graph("TexNoise", values={"Scale": 2.0}),
        "world noise": node_graph("TexNoise", values={"Scale": 1.0}, links_to={
            "Vector": node_graph("NewGeometry", "Position")}),
    }
    for name, height in heights.items():
        for invert in (False, True):
            bump = node_graph("Bump", links_to={"Height": height}, invert=invert,
                              values={"Distance": 0.4, "Strength": 0.8})
            graphs[f"bump {name} {invert}"] = bump
    for output in (0, 1):
        graphs[f"layer weight {output}"] = node_graph(
            "LayerWeight", output, values={"Blend": 0.3},
            links_to={"Normal": node_graph("NormalMap", links_to={"Color": texel})})
    graphs["fresnel"] = node_graph("Fresnel", links_to={"Normal": node_graph("NormalMap", links_to={"Color": texel})})
    return graphs
