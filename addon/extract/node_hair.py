# SPDX-License-Identifier: GPL-3.0-or-later
"""Principled Hair BSDF: on hair its surface reflects, and what enters is diffuse, of the hair's colour.

The colour is the albedo of many scatterings by Chiang, Bitterli, Tappan and Burley 2016 (A practical and controllable
hair and fur model for production path tracing, sec. 4.2); absorption is Cycles' (kernel/closure/bsdf_util.h and
kernel/svm). That light passes through strands is left out.
"""

from __future__ import annotations

from ...engine.mesh_features import HAIR
from ...engine.program import Value
from .node_graph import Graph
from .node_inputs import perturbed_normal

__all__ = ["hair_color", "principled_hair"]

EUMELANIN = (0.506, 0.841, 1.653)
PHEOMELANIN = (0.343, 0.733, 1.924)
"""Absorption of a concentration of 1"""

ROUGHNESS_TERMS = (0.245, 5.574, -10.73, 2.532, -0.215, 5.969)
"""Of the polynomial of the azimuthal roughness, highest power first"""

E = 2.718281828459045


def principled_hair(graph: Graph, node, weight: Value) -> None:
    """Translate the node: on what isn't hair as a Diffuse BSDF."""
    color, normal = hair_color(graph, node), perturbed_normal(graph, node)
    if not graph.hair:
        graph.tell(node, "is a hair shader, which is drawn as a Diffuse BSDF")
        graph.builder.closure("DIFFUSE", weight, color=color, normal=normal)
        return
    graph.tell(node, "is a hair shader, which is drawn as a Principled BSDF: light doesn't pass through")
    graph.builder.closure(
        "PRINCIPLED", weight, color=color, normal=normal, roughness=graph.value(node, "Roughness", 0.3),
        ior=graph.value(node, "IOR", 1.55), specular_level=0.5, specular_tint=1.0, coat_ior=1.5, coat_tint=1.0,
        sheen_tint=1.0)


def hair_color(graph: Graph, node) -> Value:
    """Return the colour that the node describes."""
    if node.parametrization == 'COLOR':
        return graph.value(node, "Color")
    build = graph.builder
    scale = build.constant(ROUGHNESS_TERMS[0])
    # Huang's model has one roughness.
    roughness = graph.value(node, "Roughness" if node.model == 'HUANG' else "Radial Roughness", 0.3)
    for term in ROUGHNESS_TERMS[1:]:
        scale = build.math("ADD", build.math("MULTIPLY", scale, roughness), term)
    if node.parametrization == 'ABSORPTION':
        sigma = graph.value(node, "Absorption Coefficient")
        channels = [build.component(sigma, channel) for channel in range(3)]
    else:
        channels = melanin_absorption(graph, node, scale)
    depths = [build.math("MULTIPLY", build.math("SQRT", build.math("MAXIMUM", channel, 0.0)), scale)
              for channel in channels]
    return build.combine(*(build.math("EXPONENT", build.math("MULTIPLY", depth, -1.0)) for depth in depths))


def melanin_absorption(graph: Graph, node, scale: Value) -> list[Value]:
    """Return the absorption of melanin, in which strands differ, and of the tint, by channel."""
    build = graph.builder

    def logarithm(value: Value, least: float) -> Value:
        return build.math("LOGARITHM", build.math("MAXIMUM", value, least), E)

    melanin = build.math("CLAMP", graph.value(node, "Melanin", 0.8), 0.0, 1.0)
    spread = build.math("MULTIPLY", build.math("CLAMP", graph.value(node, "Random Color"), 0.0, 1.0), 2.0)
    if spread.constant is None or spread.constant[0] > 0.0:
        random = graph.linked_or(node, "Random", lambda: build.component(build.attribute(HAIR), 3))
        factor = build.math("ADD", build.math("MULTIPLY", build.math("SUBTRACT", random, 0.5), spread), 1.0)
        melanin = build.math("MULTIPLY", melanin, factor)
    amount = build.math("MULTIPLY", logarithm(build.math("SUBTRACT", 1.0, melanin), 1e-4), -1.0)
    red = build.math("MULTIPLY", amount, build.math("CLAMP", graph.value(node, "Melanin Redness", 1.0), 0.0, 1.0))
    brown = build.math("SUBTRACT", amount, red)
    tint = graph.value(node, "Tint", (1.0, 1.0, 1.0))
    channels = []
    for channel in range(3):
        dye = build.math("DIVIDE", logarithm(build.component(tint, channel), 1e-5), scale)
        pigment = build.math("ADD", build.math("MULTIPLY", brown, EUMELANIN[channel]),
                             build.math("MULTIPLY", red, PHEOMELANIN[channel]))
        channels.append(build.math("ADD", pigment, build.math("MULTIPLY", dye, dye)))
    return channels
