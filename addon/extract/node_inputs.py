# SPDX-License-Identifier: GPL-3.0-or-later
"""Translates nodes that tell about the surface, the object, the ray and the camera, and nodes that bend normals."""

from __future__ import annotations

from ...engine.mesh_features import HAIR, ISLAND, POINTINESS, ROOT, STRAND
from ...engine.object_properties import particle_name, property_name
from ...engine.program import Value, tangent_attribute
from ...engine.report import ReportKind
from ...engine.scene import Visibility
from ...engine.volume_program import VolumeBuilder
from .node_graph import Graph, translates

__all__: list[str] = []

RAY_KINDS = {
    "Is Camera Ray": Visibility.CAMERA,
    "Is Shadow Ray": Visibility.SHADOW,
    "Is Diffuse Ray": Visibility.DIFFUSE,
    "Is Glossy Ray": Visibility.GLOSSY,
    "Is Transmission Ray": Visibility.TRANSMISSION,
    "Is Volume Scatter Ray": Visibility.VOLUME,
    "Is Reflection Ray": Visibility.DIFFUSE | Visibility.GLOSSY,
}

DEPTHS = {
    "Diffuse Depth": Visibility.DIFFUSE,
    "Glossy Depth": Visibility.GLOSSY,
    "Transmission Depth": Visibility.TRANSMISSION,
}


def inverse_rows(matrix) -> list[tuple[float, ...]]:
    """Return the rows of an object matrix's inverse, of its nearest invertible neighbour where it is singular."""
    return [tuple(row) for row in matrix.inverted_safe()]


def uv_coordinate(graph: Graph, name: str) -> Value:
    """Return a UV map's coordinate; lamps have one map, which Parametric is too, and worlds none."""
    build = graph.builder
    if graph.world or (graph.lamp and name):
        return build.constant(0.0)
    return build.input("PARAMETRIC") if graph.lamp else build.uv(name)


def generated_coordinate(graph: Graph) -> Value:
    """Return the place within the texture space; of particle hair that of each strand's root."""
    build = graph.builder
    here = build.input("GENERATED")
    if not graph.hair:
        return here
    root = build.attribute(ROOT)
    return build.mix("MIX", build.component(root, 3), build.rgb(here), build.rgb(root))


@translates("ShaderNodeTexCoord")
def texture_coordinate_node(graph: Graph, node, output: str) -> Value:
    """Texture Coordinate."""
    build = graph.builder
    if node.from_instancer and output in ("Generated", "UV"):
        graph.tell(node, "takes coordinates from the instancer; those of the object are used")
    if output == "UV":
        return uv_coordinate(graph, "")
    if output == "Object" and node.object is not None:
        return build.transform(inverse_rows(node.object.matrix_world), build.input("POSITION"))
    if output == "Camera":
        return build.camera_space(direction=graph.world)
    if output == "Generated":
        return generated_coordinate(graph)
    names = {"Normal": "OBJECT_NORMAL", "Object": "OBJECT", "Window": "WINDOW",
             "Reflection": "REFLECTION"}
    return build.input(names[output])


@translates("ShaderNodeUVMap")
def uv_map_node(graph: Graph, node, output: str) -> Value:
    """UV Map."""
    if node.from_instancer:
        graph.tell(node, "takes coordinates from the instancer; those of the object are used")
    return uv_coordinate(graph, node.uv_map)


def attribute(graph: Graph, name: str, output: str) -> Value:
    """Return one output of an attribute."""
    build = graph.builder
    if graph.lamp:
        return build.constant(0.0)
    return part_of(graph, build.attribute(name), output)


def part_of(graph: Graph, value: Value, output: str) -> Value:
    """Return the part of an attribute that an output gives."""
    if output == "Alpha":
        return graph.builder.component(value, 3)
    return graph.builder.vector("AVERAGE", value) if output == "Fac" else graph.builder.rgb(value)


@translates("ShaderNodeAttribute")
def attribute_node(graph: Graph, node, output: str) -> Value:
    """Attribute of the mesh, or property of the object, its instancer or the view layer."""
    kind, name = node.attribute_type, node.attribute_name
    if kind == 'VIEW_LAYER':
        return part_of(graph, graph.builder.constant(graph.layer(name)), output)
    if kind == 'GEOMETRY' and not graph.world:
        return attribute(graph, name, output)
    if graph.world or graph.lamp:
        if graph.lamp:
            graph.tell(node, f"reads the property '{name}' of a lamp's object; it counts as 0")
        return graph.builder.constant(0.0)
    return part_of(graph, graph.builder.object_property(property_name(name, instancer=kind == 'INSTANCER')), output)


@translates("ShaderNodeVertexColor")
def color_attribute_node(graph: Graph, node, output: str) -> Value:
    """Color Attribute."""
    return attribute(graph, node.layer_name, output)


def strand_direction(graph: Graph) -> tuple[Value, Value]:
    """Return the direction along a strand in the world, and 1 on hair, 0 elsewhere."""
    build = graph.builder
    strand = build.attribute(STRAND)
    along = build.vector("NORMALIZE", build.space("DIRECTION_TO_WORLD", build.rgb(strand)))
    return along, build.component(strand, 3)


def surface_tangent(graph: Graph) -> Value:
    """Return the tangent around the texture space's z axis, along the strand on hair."""
    build = graph.builder
    around = build.input("TANGENT_Z")
    if not graph.hair:
        return around
    along, is_strand = strand_direction(graph)
    return build.mix("MIX", is_strand, around, along)


@translates("ShaderNodeNewGeometry")
def geometry_node(graph: Graph, node, output: str) -> Value:
    """Geometry."""
    build = graph.builder
    if output in ("Pointiness", "Random Per Island"):
        if graph.world or graph.lamp:
            return build.constant(0.0)
        return build.rgb(build.attribute(POINTINESS if output == "Pointiness" else ISLAND))
    if output == "Tangent":
        return surface_tangent(graph)
    names = {"Position": "POSITION", "Normal": "NORMAL", "True Normal": "TRUE_NORMAL",
             "Incoming": "INCOMING", "Parametric": "PARAMETRIC", "Backfacing": "BACKFACING"}
    return build.input(names[output])


@translates("ShaderNodeObjectInfo")
def object_info_node(graph: Graph, node, output: str) -> Value:
    """Object Info."""
    build = graph.builder
    names = {"Location": "OBJECT_LOCATION", "Color": "OBJECT_COLOR", "Alpha": "OBJECT_COLOR",
             "Object Index": "OBJECT_INDEX", "Material Index": "MATERIAL_INDEX", "Random": "OBJECT_RANDOM"}
    value = build.input(names[output])
    return build.component(value, 3) if output == "Alpha" else build.rgb(value)


@translates("ShaderNodeLightPath")
def light_path_node(graph: Graph, node, output: str) -> Value:
    """Light Path."""
    build = graph.builder
    if output in RAY_KINDS:
        return build.input("RAY_KIND", int(RAY_KINDS[output]))
    if output == "Ray Length":
        return build.input("RAY_LENGTH")
    if output == "Ray Depth":
        return build.input("RAY_DEPTH")
    if output in DEPTHS:
        graph.tell(node, f"gives {output}, which real-time frames take to be the ray's depth", ReportKind.INFO)
        return build.input("KIND_DEPTH", int(DEPTHS[output]))
    graph.tell(node, f"gives {output}, which is not known; 0 stands in for it")
    return build.constant(0.0)


@translates("ShaderNodeCameraData")
def camera_data_node(graph: Graph, node, output: str) -> Value:
    """Camera Data."""
    build = graph.builder
    position = build.camera_space(direction=graph.world)
    if output == "View Z Depth":
        return build.component(position, 2)
    return build.vector("LENGTH" if output == "View Distance" else "NORMALIZE", position)


@translates("ShaderNodeParticleInfo")
def particle_info_node(graph: Graph, node, output: str) -> Value:
    """Particle Info, of the particle that made the instance."""
    if graph.world or graph.lamp:
        return graph.builder.constant(0.0)
    return graph.builder.rgb(graph.builder.object_property(particle_name(output)))


@translates("ShaderNodeHairInfo")
def hair_info_node(graph: Graph, node, output: str) -> Value:
    """Hair Info: 0 on all that isn't hair (engine/hair_info.py)."""
    build = graph.builder
    if graph.world or graph.lamp or isinstance(build, VolumeBuilder):
        return build.constant(0.0)
    facts = ("Intercept", "Length", "Thickness", "Random")
    if output in facts:
        return build.component(build.attribute(HAIR), facts.index(output))
    along, is_strand = strand_direction(graph)
    if output == "Is Strand":
        return is_strand
    # Towards the eye, but across the strand (kernel/geom/curve.h, curve_tangent_normal).
    incoming = build.input("INCOMING")
    part = build.vector("MULTIPLY", along, build.vector("DOT_PRODUCT", along, incoming))
    across = build.vector("SUBTRACT", incoming, part)
    return build.vector("NORMALIZE", build.vector("MULTIPLY", across, is_strand))


@translates("ShaderNodePointInfo", "ShaderNodeVolumeInfo")
def particle_node(graph: Graph, node, output: str) -> Value:
    """Facts about points and volumes: 0 on meshes."""
    if isinstance(graph.builder, VolumeBuilder) and node.bl_idname == "ShaderNodeVolumeInfo":
        value = graph.builder.attribute(output.lower())
        return graph.builder.rgb(value) if output == "Color" else graph.builder.vector("AVERAGE", value)
    graph.tell(node, f"gives {output}, which meshes don't have; 0 stands in for it")
    return graph.builder.constant(0.0)


@translates("ShaderNodeTangent")
def tangent_node(graph: Graph, node, output: str) -> Value:
    """Tangent."""
    if node.direction_type == 'RADIAL':
        return graph.builder.input("TANGENT_" + node.axis)
    if graph.lamp:
        return graph.builder.constant(0.0)
    return graph.builder.uv_tangent(node.uv_map, tangent_attribute(node.uv_map))


@translates("ShaderNodeNormal")
def normal_node(graph: Graph, node, output: str) -> Value:
    """Normal: a fixed direction, and its dot product with the input."""
    build = graph.builder
    direction = build.vector("NORMALIZE", tuple(node.outputs["Normal"].default_value))
    return direction if output == "Normal" else build.vector("NORMAL_DOT", direction, graph.value(node, "Normal"))


def perturbed_normal(graph: Graph, node, identifier: str = "Normal") -> Value:
    """Return a Normal input, or the normal of shaders without one."""
    return graph.linked_or(node, identifier, lambda: graph.normal)


@translates("ShaderNodeNormalMap")
def normal_map_node(graph: Graph, node, output: str) -> Value:
    """Normal Map."""
    space = node.space.removeprefix("BLENDER_")
    if graph.lamp and space == "TANGENT":
        return graph.builder.input("NORMAL")
    return graph.builder.normal_map(
        space, graph.value(node, "Color"), graph.value(node, "Strength"), uv_map=node.uv_map,
        tangent_attribute=tangent_attribute(node.uv_map),
        invert_green=getattr(node, "convention", 'OPENGL') == 'DIRECTX', blender_axes=node.space.startswith("BLENDER_"))


@translates("ShaderNodeBump")
def bump_node(graph: Graph, node, output: str) -> Value:
    """Bump."""
    build = graph.builder
    normal = perturbed_normal(graph, node)
    if graph.lamp or not graph.is_linked(node, "Height"):
        return normal
    distance = graph.value(node, "Distance")
    if node.invert:
        distance = build.math("MULTIPLY", distance, -1.0)
    return build.bump(
        graph.value(node, "Height"), graph.value(node, "Strength"), distance, graph.value(node, "Filter Width", 0.1),
        normal)


@translates("ShaderNodeFresnel")
def fresnel_node(graph: Graph, node, output: str) -> Value:
    """Fresnel."""
    return graph.builder.fresnel("IOR", graph.value(node, "IOR"), perturbed_normal(graph, node))


@translates("ShaderNodeLayerWeight")
def layer_weight_node(graph: Graph, node, output: str) -> Value:
    """Layer Weight."""
    kind = "BLEND" if output == "Fresnel" else "FACING"
    return graph.builder.fresnel(kind, graph.value(node, "Blend"), perturbed_normal(graph, node))


@translates("ShaderNodeWireframe")
def wireframe_node(graph: Graph, node, output: str) -> Value:
    """Wireframe: lines of a width in the world."""
    if node.use_pixel_size:
        graph.tell(node, "measures its lines in pixels, which is not drawn: no edges appear")
    if node.use_pixel_size or graph.world or graph.lamp:
        return graph.builder.constant(0.0)
    return graph.builder.wireframe(graph.value(node, "Size"))


@translates("ShaderNodeLightFalloff")
def light_falloff_node(graph: Graph, node, output: str) -> Value:
    """Light Falloff; of meshes quadratic, as light falls off by itself."""
    build = graph.builder
    strength, smooth = graph.value(node, "Strength"), graph.value(node, "Smooth")
    if not graph.lamp:
        if output != "Quadratic":
            graph.tell(node, f"asks for {output.lower()} falloff; light falls off with the square of the distance")
        return strength
    length = build.input("RAY_LENGTH")
    square = build.math("MULTIPLY", length, length)
    if output != "Quadratic":
        strength = build.math("MULTIPLY", strength, length if output == "Linear" else square)
    if smooth.constant is not None and smooth.constant[0] <= 0.0:
        return strength
    softened = build.math("DIVIDE", square, build.math("ADD", square, build.math("MAXIMUM", smooth, 0.0)))
    return build.math("MULTIPLY", strength, softened)


@translates("ShaderNodeMapping")
def mapping_node(graph: Graph, node, output: str) -> Value:
    """Mapping: one matrix where location, rotation and scale are constant, else step by step."""
    build = graph.builder
    kind = node.vector_type
    vector = graph.value(node, "Vector")
    location, rotation, scale = (graph.value(node, name) for name in ("Location", "Rotation", "Scale"))
    constants = [value.constant for value in (location, rotation, scale)]
    if None not in constants and (kind == 'POINT' or kind == 'VECTOR' or 0.0 not in constants[2][:3]):
        rows = mapping_rows(kind, *constants)
        result = vector if is_identity(rows) else build.transform(rows, vector)
        return build.vector("NORMALIZE", result) if kind == 'NORMAL' else result
    if kind == 'TEXTURE':
        moved = build.vector("SUBTRACT", build.rgb(vector), location)
        return build.vector("DIVIDE", build.vector("ROTATE_INVERSE", moved, rotation), scale)
    if kind == 'NORMAL':
        return build.vector(
            "NORMALIZE", build.vector("ROTATE", build.vector("DIVIDE", build.rgb(vector), scale), rotation))
    result = build.vector("ROTATE", build.vector("MULTIPLY", build.rgb(vector), scale), rotation)
    return build.vector("ADD", result, location) if kind == 'POINT' else result


def mapping_rows(kind: str, location, rotation, scale) -> list[tuple[float, ...]]:
    """Return three rows of the matrix of a Mapping node, before normalisation for normals."""
    from mathutils import Euler, Matrix

    turn = Euler(rotation[:3], 'XYZ').to_matrix().to_4x4()
    place = Matrix.Translation(location[:3])
    stretch = Matrix.Diagonal((*scale[:3], 1.0))
    matrix = turn @ stretch
    if kind == 'POINT':
        matrix = place @ matrix
    elif kind == 'TEXTURE':
        matrix = stretch.inverted() @ turn.transposed() @ place.inverted()
    elif kind == 'NORMAL':
        matrix = turn @ stretch.inverted()
    return [tuple(row) for row in matrix][:3]


def is_identity(rows) -> bool:
    """Return whether three rows of a matrix leave everything as it is."""
    return all(value == (1.0 if i == j else 0.0) for i, row in enumerate(rows) for j, value in enumerate(row))


@translates("ShaderNodeVectorRotate")
def vector_rotate_node(graph: Graph, node, output: str) -> Value:
    """Vector Rotate."""
    build = graph.builder
    center = graph.value(node, "Center")
    vector = build.vector("SUBTRACT", build.rgb(graph.value(node, "Vector")), center)
    if node.rotation_type == 'EULER_XYZ':
        turned = build.vector("ROTATE_INVERSE" if node.invert else "ROTATE", vector, graph.value(node, "Rotation"))
    else:
        axes = {'X_AXIS': (1, 0, 0), 'Y_AXIS': (0, 1, 0), 'Z_AXIS': (0, 0, 1)}
        axis = axes.get(node.rotation_type) or graph.value(node, "Axis")
        angle = graph.value(node, "Angle")
        turned = build.vector("ROTATE_AXIS", vector, axis, build.math("MULTIPLY", angle, -1.0 if node.invert else 1.0))
    return build.vector("ADD", turned, center)


@translates("ShaderNodeVectorTransform")
def vector_transform_node(graph: Graph, node, output: str) -> Value:
    """Vector Transform between world and object; camera space is not followed."""
    build = graph.builder
    vector = graph.value(node, "Vector")
    spaces = (node.convert_from, node.convert_to)
    if 'CAMERA' in spaces and spaces[0] != spaces[1]:
        graph.tell(node, "transforms to or from camera space; the vector is left as it is")
        return vector
    if spaces[0] == spaces[1]:
        return vector
    kind = {'POINT': "POINT", 'VECTOR': "DIRECTION", 'NORMAL': "NORMAL"}[node.vector_type]
    return build.space(f"{kind}_TO_{spaces[1]}", vector)


@translates("ShaderNodeScript", "ShaderNodeRaycast", "ShaderNodeShaderToRGB")
def unknown_node(graph: Graph, node, output: str) -> Value:
    """Nodes that Cycles draws and this engine doesn't."""
    graph.tell(node, "is not supported and counts as 0", ReportKind.SKIPPED)
    return graph.builder.constant(0.0)
