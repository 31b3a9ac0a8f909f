# SPDX-License-Identifier: GPL-3.0-or-later
"""Translates nodes that need rays while a material is evaluated: Ambient Occlusion and Bevel.

Only exact programs (engine/scene.py, MaterialData.exact) send them; elsewhere nothing is occluded and edges stay sharp,
as in Cycles for shadows, lights and volumes.
"""

from __future__ import annotations

from ...engine.program import Value
from ...engine.report import ReportKind
from .node_graph import Graph, translates

__all__: list[str] = []

SHOWN = "in what the camera sees and path tracing; real-time reflections and light from other surfaces show"
WORLD_DISTANCE = 10.0
"""How far rays of a node without a distance go [m]: what a new world says"""


def sends_rays(graph: Graph, node, otherwise: str) -> bool:
    """Return whether the graph's program sends rays, and say where it does not."""
    if graph.world or graph.lamp:
        return False
    graph.wants_exact = True
    graph.tell(node, f"sends rays {SHOWN} {otherwise}", ReportKind.INFO)
    return graph.exact


@translates("ShaderNodeBevel")
def bevel_node(graph: Graph, node, output: str) -> Value:
    """Bevel; its own normal input where no rays are sent."""
    build = graph.builder
    normal = graph.linked_or(node, "Normal", lambda: build.constant(0.0))
    if sends_rays(graph, node, "sharp edges") and node.samples > 0:
        return build.bevel(graph.value(node, "Radius"), normal, node.samples)
    return graph.linked_or(node, "Normal", lambda: build.input("NORMAL"))


@translates("ShaderNodeAmbientOcclusion")
def ambient_occlusion_node(graph: Graph, node, output: str) -> Value:
    """Ambient Occlusion; nothing is occluded where no rays are sent."""
    build = graph.builder
    share = build.constant(1.0)
    if sends_rays(graph, node, "nothing occluded") and node.samples > 0:
        distance = graph.value(node, "Distance")
        if distance.constant is not None and distance.constant[0] == 0.0 and not graph.is_linked(node, "Distance"):
            graph.tell(node, f"has no distance of its own; {WORLD_DISTANCE:g} m stands in for the world's")
            distance = build.constant(WORLD_DISTANCE)
        share = build.occlusion(
            distance, graph.linked_or(node, "Normal", lambda: build.constant(0.0)), node.samples,
            inside=node.inside, local=node.only_local)
    if output == "AO":
        return share
    return build.vector("MULTIPLY", build.rgb(graph.value(node, "Color")), share)
