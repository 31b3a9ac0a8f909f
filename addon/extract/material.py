# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials, worlds and lamps' node trees to programs of the node machine.

Trees are read through bpy.types.InlineShaderNodes, which resolves groups, reroutes, muted nodes and zones. Never
raises for what a tree contains: what isn't drawn is named in the report. Main thread only; keeps nothing of bpy.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import bpy
import numpy as np

from ...engine.one_sided import hide_back_of_hair
from ...engine.pass_names import COLOR_AOV, VALUE_AOV
from ...engine.program import Program, ProgramBuilder, RegisterOverflow, Value
from ...engine.report import Report, ReportKind
from ...engine.scene import MaterialData, MistData, SceneDelta, Visibility, WorldData
from ...engine.sky.image import TO_REC709
from . import (  # noqa: F401  (they register their translators)
    node_ies,
    node_inputs,
    node_maths,
    node_rays,
    node_sky,
    node_textures,
)
from .node_graph import Graph, no_property
from .node_shaders import add_shader
from .volume import read_medium

__all__ = ["extract_light_shader", "extract_material", "extract_world", "from_xyz", "luminance_weights"]

Layer = Callable[[str], tuple[float, ...]]

MIST_FALLOFF = {'QUADRATIC': 2.0, 'LINEAR': 1.0, 'INVERSE_QUADRATIC': 0.5}
RESOLUTION_SMOOTH = 256
RESOLUTION_MIN = 512
RESOLUTION_MAX = 4096
WHITE = (1.0, 1.0, 1.0)

# Linear Rec.709 to other working spaces (ITU-R BT.2087; ACES AP1 with Bradford adaptation).
FROM_REC709 = {
    "Linear Rec.2020": ((0.627404, 0.329283, 0.043313), (0.069097, 0.919540, 0.011362), (0.016391, 0.088013, 0.895595)),
    "ACEScg": ((0.613097, 0.339523, 0.047380), (0.070194, 0.916354, 0.013452), (0.020616, 0.109570, 0.869815)),
}

LUMINANCE_WEIGHTS = {
    "Linear Rec.2020": (0.2627002, 0.6779981, 0.0593017),
    "ACEScg": (0.2722287, 0.6740818, 0.0536895),
}


@functools.cache
def from_xyz(space: str) -> tuple[tuple[float, float, float], ...]:
    """Return the matrix from CIE XYZ to a working space."""
    rows = np.asarray(FROM_REC709.get(space, np.eye(3))) @ np.asarray(TO_REC709)
    return tuple(tuple(float(x) for x in row) for row in rows)


def luminance_weights(space: str) -> tuple[float, float, float]:
    """Return the luminance of a working space's primaries: the Y row of RGB to XYZ."""
    return LUMINANCE_WEIGHTS.get(space, SceneDelta.luminance_weights)


def make_graph(tree, images, report: Report, owner: str, *, builder: ProgramBuilder | None = None,
               **options) -> Graph:
    """Return a graph over an inlined tree, ready to compile in the file's working space; options are a Graph's."""
    graph = Graph(tree, builder or ProgramBuilder(), images, report, owner, **options)
    space = getattr(getattr(bpy.data, "colorspace", None), "working_space", "Linear Rec.709")
    graph.from_rec709 = FROM_REC709.get(space)
    return graph


def output_node(tree):
    """Return the output that Cycles would use, or None."""
    return tree.get_output_node('CYCLES')


def extract_aovs(tree, aovs: tuple[str, ...], images, report: Report, owner: str, **options) -> dict[str, Program]:
    """Compile what the AOV Output nodes of an inlined tree say, by the engine's names of the passes."""
    programs = {}
    for source in aovs:
        name = source.removeprefix(COLOR_AOV).removeprefix(VALUE_AOV)
        nodes = [node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputAOV" and node.aov_name == name]
        if not nodes:
            continue
        said = Report()
        graph = make_graph(tree, images, said, owner, **options)
        try:
            for node in nodes:
                graph.builder.emit(graph.value(node, "Color" if source.startswith(COLOR_AOV) else "Value"), 1.0, 1.0)
            programs[source] = graph.builder.finish()
        except (RegisterOverflow, RecursionError) as error:
            said.add(ReportKind.SKIPPED, owner, f"has too many nodes for its AOV '{name}' ({error}), which is left out")
        for entry, count in said.counts.items():
            # What the surface has said of the same nodes is not said again.
            report.counts.setdefault(entry, count)
    return programs


def extract_material(material: bpy.types.Material, images, report: Report, aovs: tuple[str, ...] = (),
                     layer: Layer = no_property, hair: bool = False) -> MaterialData:
    """Compile a material.

    Args:
        material: Evaluated material.
        images: ImageCollector: `key(image, image_user)` names an image and records its data.
        report: Receives what is approximated or left out.
        aovs: Passes of shader AOVs, from passes.aov_source.
        layer: Returns a property of the view layer.
        hair: Whether hair has the material.
    """
    owner = f"material '{material.name}'"
    data = MaterialData(name=material.name, program=Program(), pass_index=material.pass_index)
    settings = getattr(material, "cycles", None)
    data.emission_sampling = getattr(settings, "emission_sampling", 'AUTO') != 'NONE'
    if material.node_tree is None:
        builder = ProgramBuilder()
        builder.closure("DIFFUSE", 1.0, color=tuple(material.diffuse_color)[:3])
        data.program = builder.finish()
        return data
    # The tree dies with its wrapper: the variable keeps it alive.
    inlined = bpy.types.InlineShaderNodes.from_material(material)
    graph = make_graph(inlined.node_tree, images, report, owner, layer=layer, hair=hair)
    try:
        output = output_node(inlined.node_tree)
        compile_surface(graph, material, output)
        data.medium = read_medium(
            functools.partial(make_graph, layer=layer), inlined.node_tree, output, images, report, owner)
        data.bare = bool(data.medium) and graph.source(output, "Surface") is None
        data.program = graph.builder.finish()
        twin = functools.partial(
            extract_twin, material, inlined.node_tree, output, images, report, owner, layer=layer, hair=hair)
        data.exact = twin() if graph.wants_exact else None
        data.hair = twin(scatters=True) if graph.wants_hair else None
    except (RegisterOverflow, RecursionError) as error:
        report.add(ReportKind.ERROR, owner, f"has a node tree that is too large ({error}); drawn in its viewport color")
        graph.builder = ProgramBuilder()
        graph.builder.closure("DIFFUSE", 1.0, color=tuple(material.diffuse_color)[:3])
        data.program = graph.builder.finish()
    data.aovs = extract_aovs(inlined.node_tree, aovs, images, report, owner, layer=layer, hair=hair)
    data.has_transparency = graph.builder.has_transparency()
    data.has_emission = graph.builder.has_emission()
    data.constant_emission = graph.builder.constant_emission() if data.has_emission else None
    return data


def extract_twin(material: bpy.types.Material, tree, output, images, report: Report, owner: str,
                 **options) -> Program | None:
    """Compile a surface with all that its nodes can do, by options of a Graph; None where that is too large."""
    said = Report()
    graph = make_graph(tree, images, said, owner, exact=True, **options)
    try:
        compile_surface(graph, material, output)
        program = graph.builder.finish()
    except (RegisterOverflow, RecursionError) as error:
        report.add(ReportKind.APPROXIMATED, owner, f"has too many nodes to be drawn exactly ({error})")
        return None
    for entry, count in said.counts.items():
        # What the other program has said is not said again.
        report.counts.setdefault(entry, count)
    return program


def compile_surface(graph: Graph, material: bpy.types.Material, output) -> None:
    """Add everything that the Surface socket of an output leads to."""
    if output is None:
        return
    if graph.is_linked(output, "Displacement"):
        graph.normal = displacement_normal(graph, material, output)
    source = graph.source(output, "Surface")
    if source is None:
        if graph.is_linked(output, "Volume"):
            # What has no surface is the boundary of a medium, which nobody sees.
            graph.builder.transparent(1.0, 1.0)
        return
    if source[1].type == 'SHADER':
        add_shader(graph, source[0], graph.builder.constant(1.0))
    else:
        # A colour plugged into a shader socket emits, as in Blender.
        graph.builder.emit(graph.convert(graph.output(*source), source[1].type, 'RGBA'), 1.0, 1.0)
    if graph.hair:
        hide_back_of_hair(graph.builder)


def displacement_normal(graph: Graph, material: bpy.types.Material, output) -> Value:
    """Return the normal bent by the displacement's height; the surface itself stays where it is."""
    method = material.displacement_method
    node, _ = graph.source(output, "Displacement")
    if method != 'BUMP':
        graph.report.add(
            ReportKind.APPROXIMATED, graph.owner, "has true displacement, which is drawn as bump mapping alone")
    if node.bl_idname != "ShaderNodeDisplacement":
        graph.tell(node, "drives the displacement and is not followed", ReportKind.SKIPPED)
        return graph.normal
    build = graph.builder
    height = build.math("SUBTRACT", graph.value(node, "Height"), graph.value(node, "Midlevel"))
    return build.bump(build.math("MULTIPLY", height, graph.value(node, "Scale")), 1.0, 1.0, 0.1)


def extract_world(world: bpy.types.World | None, images, report: Report, aovs: tuple[str, ...] = (),
                  layer: Layer = no_property) -> WorldData:
    """Compile a world; None is black. Arguments as for `extract_material`."""
    if world is None:
        return WorldData(name="", program=Program(), constant=(0.0, 0.0, 0.0), importance_resolution=RESOLUTION_SMOOTH)
    data = WorldData(name=world.name, program=Program(), importance_resolution=RESOLUTION_SMOOTH,
                     light_group=world.lightgroup)
    mist = world.mist_settings
    data.mist = MistData(start=mist.start, depth=mist.depth, falloff=MIST_FALLOFF.get(mist.falloff, 1.0))
    data.occlusion_distance = world.light_settings.distance
    owner = f"world '{world.name}'"
    if world.node_tree is None:
        data.constant = tuple(world.color)
        builder = ProgramBuilder()
        builder.emit(data.constant, 1.0, 1.0)
        data.program = builder.finish()
        return data
    inlined = bpy.types.InlineShaderNodes.from_world(world)
    graph = make_graph(inlined.node_tree, images, report, owner, world=True, layer=layer)
    output = output_node(inlined.node_tree)
    apply_ray_visibility(data, world)
    try:
        source = graph.source(output, "Surface") if output is not None else None
        if source is not None:
            data.sun = node_sky.world_sun(graph, source[0], owner, data.visibility, data.light_group)
            graph.disc_rays = None if data.sun is None else int(Visibility.CAMERA)
            add_shader(graph, source[0], graph.builder.constant(1.0))
        data.program = graph.builder.finish()
    except (RegisterOverflow, RecursionError) as error:
        report.add(ReportKind.ERROR, owner, f"has a node tree that is too large ({error}); drawn in its viewport color")
        graph.builder, data.sun = ProgramBuilder(), None
        graph.builder.emit(tuple(world.color), 1.0, 1.0)
        data.program = graph.builder.finish()
    data.medium = read_medium(
        functools.partial(make_graph, layer=layer), inlined.node_tree, output, images, report, owner, world=True)
    data.aovs = extract_aovs(inlined.node_tree, aovs, images, report, owner, world=True, layer=layer)
    data.constant = graph.builder.constant_emission()
    if graph.widths:
        data.importance_resolution = min(max(max(graph.widths), RESOLUTION_MIN), RESOLUTION_MAX)
    apply_world_sampling(data, world)
    return data


def apply_world_sampling(data: WorldData, world: bpy.types.World) -> None:
    """Copy Cycles' settings of how the world is sampled."""
    settings = getattr(world, "cycles", None)
    if getattr(settings, "sampling_method", 'AUTOMATIC') == 'MANUAL':
        data.importance_resolution = min(max(settings.sample_map_resolution, 64), RESOLUTION_MAX)
    data.sampling = getattr(settings, "sampling_method", 'AUTOMATIC') != 'NONE'


def apply_ray_visibility(data: WorldData, world: bpy.types.World) -> None:
    """Copy Cycles' settings of which rays see the world."""
    visibility = getattr(world, "cycles_visibility", None)
    if visibility is None:
        return
    for name, bit in (("camera", Visibility.CAMERA), ("diffuse", Visibility.DIFFUSE), ("glossy", Visibility.GLOSSY),
                      ("transmission", Visibility.TRANSMISSION), ("scatter", Visibility.VOLUME)):
        if not getattr(visibility, name, True):
            data.visibility &= ~int(bit)


def extract_light_shader(
    light: bpy.types.Light, images, report: Report, layer: Layer = no_property,
) -> tuple[tuple[float, float, float], Program | None]:
    """Return a lamp's node tree as a constant factor, and a program where it varies; arguments as of extract_material.

    The factor is 1 where there is a program.
    """
    if light.node_tree is None or not getattr(light, "use_nodes", True):
        return WHITE, None
    owner = f"light '{light.name}'"
    inlined = bpy.types.InlineShaderNodes.from_light(light)
    graph = make_graph(inlined.node_tree, images, report, owner, lamp=True, layer=layer)
    output = output_node(inlined.node_tree)
    source = graph.source(output, "Surface") if output is not None else None
    if source is None:
        return (0.0, 0.0, 0.0), None
    try:
        add_shader(graph, source[0], graph.builder.constant(1.0))
        factor = graph.builder.constant_emission()
        return (WHITE, graph.builder.finish()) if factor is None else (factor, None)
    except (RegisterOverflow, RecursionError) as error:
        report.add(
            ReportKind.APPROXIMATED, owner, f"has a node tree that is too large ({error}); it shines with factor 1")
        return WHITE, None
