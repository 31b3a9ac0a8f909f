# SPDX-License-Identifier: GPL-3.0-or-later
"""Principled Hair BSDF: light is scattered in hair; where only surfaces are known there is one of the hair's colour.

The colour is the albedo of many scatterings by Chiang, Bitterli, Tappan and Burley 2016 (A practical and controllable
hair and fur model for production path tracing, sec. 4.2); absorption is Cycles' (kernel/closure/bsdf_util.h and
kernel/svm).
"""

from __future__ import annotations

import math

from ...engine.mesh_features import HAIR
from ...engine.program import Value
from .node_graph import Graph
from .node_inputs import perturbed_normal, strand_direction

__all__ = ["hair_color", "principled_hair"]

EUMELANIN = (0.506, 0.841, 1.653)
PHEOMELANIN = (0.343, 0.733, 1.924)
"""Absorption of a concentration of 1"""

ROUGHNESS_TERMS = (0.245, 5.574, -10.73, 2.532, -0.215, 5.969)
"""Of the polynomial of the azimuthal roughness, highest power first"""

E = 2.718281828459045

DARKEST = 1e-30
"""Colours have a logarithm"""


def principled_hair(graph: Graph, node, weight: Value) -> None:
    """Translate the node: on what isn't hair as a Diffuse BSDF."""
    build = graph.builder
    if not graph.hair:
        graph.tell(node, "is a hair shader, which is drawn as a Diffuse BSDF")
        build.closure("DIFFUSE", weight, color=hair_color(graph, node), normal=perturbed_normal(graph, node))
        return
    graph.wants_hair = True
    if node.model == 'HUANG':
        graph.tell(node, "has the model HUANG, which is drawn as CHIANG")
    roughness, radial = hair_roughness(graph, node)
    if graph.scatters:
        scatter(graph, node, weight, roughness, radial)
        return
    build.closure(
        "PRINCIPLED", weight, color=hair_color(graph, node), normal=perturbed_normal(graph, node),
        roughness=roughness, ior=graph.value(node, "IOR", 1.55), specular_level=0.5, specular_tint=1.0, coat_ior=1.5,
        coat_tint=1.0, sheen_tint=1.0)


def scatter(graph: Graph, node, weight: Value, roughness: Value, radial: Value) -> None:
    """Add the closure of hair that scatters light."""
    build = graph.builder
    factors, coat = build.constant(1.0), build.constant(0.0)
    if node.model == 'HUANG':
        factors = build.combine(*(build.math("MAXIMUM", graph.value(node, name, 1.0), 0.0) for name in (
            "R lobe", "TT lobe", "TRT lobe")))
    else:
        coat = build.math("CLAMP", graph.value(node, "Coat"), 0.0, 1.0)
    build.closure(
        "HAIR", weight, color=factors, strand=strand_direction(graph)[0], roughness=roughness,
        ior=graph.value(node, "IOR", 1.55), radial_roughness=radial,
        absorption=build.combine(*absorption(graph, node, albedo_scale(graph, radial))),
        tilt=graph.value(node, "Offset"), primary_roughness=build.math("SUBTRACT", 1.0, coat))


def hair_roughness(graph: Graph, node) -> tuple[Value, Value]:
    """Return the roughness along strands and around them, in which strands differ; Huang's model has one."""
    build = graph.builder
    spread = build.math("MULTIPLY", graph.value(node, "Random Roughness"), 2.0)
    factor = build.constant(1.0)
    if spread.constant is None or spread.constant[0] != 0.0:
        centred = build.math("SUBTRACT", random_of(graph, node), 0.5)
        factor = build.math("ADD", build.math("MULTIPLY", centred, spread), 1.0)
    names = "Roughness", "Roughness" if node.model == 'HUANG' else "Radial Roughness"
    along, around = (build.math("MULTIPLY", graph.value(node, name, 0.3), factor) for name in names)
    return along, around


def random_of(graph: Graph, node) -> Value:
    """Return the number by which strands differ."""
    return graph.linked_or(node, "Random", lambda: graph.builder.component(graph.builder.attribute(HAIR), 3))


def albedo_scale(graph: Graph, roughness: Value) -> Value:
    """Return what stands before the root of the absorption in the albedo's logarithm, by the roughness around."""
    build = graph.builder
    scale = build.constant(ROUGHNESS_TERMS[0])
    for term in ROUGHNESS_TERMS[1:]:
        scale = build.math("ADD", build.math("MULTIPLY", scale, roughness), term)
    return scale


def absorption(graph: Graph, node, scale: Value) -> list[Value]:
    """Return the absorption over a strand's radius, by channel."""
    build = graph.builder
    if node.parametrization == 'COLOR':
        return dye_absorption(graph, graph.value(node, "Color"), scale)
    if node.parametrization == 'ABSORPTION':
        sigma = graph.value(node, "Absorption Coefficient")
        return [build.component(sigma, channel) for channel in range(3)]
    return melanin_absorption(graph, node, scale)


def hair_color(graph: Graph, node) -> Value:
    """Return the colour that the node describes."""
    if node.parametrization == 'COLOR':
        return graph.value(node, "Color")
    build = graph.builder
    scale = albedo_scale(graph, hair_roughness(graph, node)[1])
    depths = [build.math("MULTIPLY", build.math("SQRT", build.math("MAXIMUM", channel, 0.0)), scale)
              for channel in absorption(graph, node, scale)]
    return build.combine(*(build.math("EXPONENT", build.math("MULTIPLY", depth, -1.0)) for depth in depths))


def dye_absorption(graph: Graph, color: Value, scale: Value) -> list[Value]:
    """Return the absorption that gives a colour, by channel."""
    build = graph.builder
    roots = [build.math("DIVIDE", logarithm(graph, build.component(color, channel), DARKEST), scale)
             for channel in range(3)]
    return [build.math("MULTIPLY", root, root) for root in roots]


def logarithm(graph: Graph, value: Value, least: float) -> Value:
    """Return the natural logarithm of a value that is at least `least`."""
    if value.constant is not None:
        # Programs fold what Python can work out by the kernels' functions, which this is not among.
        return graph.builder.constant(math.log(max(value.constant[0], least)))
    return graph.builder.math("LOGARITHM", graph.builder.math("MAXIMUM", value, least), E)


def melanin_absorption(graph: Graph, node, scale: Value) -> list[Value]:
    """Return the absorption of melanin, in which strands differ, and of the tint, by channel."""
    build = graph.builder
    melanin = build.math("CLAMP", graph.value(node, "Melanin", 0.8), 0.0, 1.0)
    spread = build.math("MULTIPLY", build.math("CLAMP", graph.value(node, "Random Color"), 0.0, 1.0), 2.0)
    if spread.constant is None or spread.constant[0] > 0.0:
        centred = build.math("SUBTRACT", random_of(graph, node), 0.5)
        factor = build.math("ADD", build.math("MULTIPLY", centred, spread), 1.0)
        melanin = build.math("MULTIPLY", melanin, factor)
    amount = build.math("MULTIPLY", logarithm(graph, build.math("SUBTRACT", 1.0, melanin), 1e-4), -1.0)
    red = build.math("MULTIPLY", amount, build.math("CLAMP", graph.value(node, "Melanin Redness", 1.0), 0.0, 1.0))
    brown = build.math("SUBTRACT", amount, red)
    channels = []
    for channel, dye in enumerate(dye_absorption(graph, graph.value(node, "Tint", (1.0, 1.0, 1.0)), scale)):
        pigment = build.math("ADD", build.math("MULTIPLY", brown, EUMELANIN[channel]),
                             build.math("MULTIPLY", red, PHEOMELANIN[channel]))
        channels.append(build.math("ADD", pigment, dye))
    return channels
