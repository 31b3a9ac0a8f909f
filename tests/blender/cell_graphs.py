# SPDX-License-Identifier: GPL-3.0-or-later
"""Node graphs of cellular patterns and Gabor noise for test_material.py, as those of node_graphs.py."""

from __future__ import annotations

from node_graphs import Graph, components, node_graph, vector

FRACTAL = {"Detail": 2.4, "Roughness": 0.6, "Lacunarity": 2.1, "Randomness": 0.8, "Smoothness": 0.4}


def ramp(axis: int, low: float, high: float):
    """Return a function that makes a socket from `low` to `high` along an axis of the plane."""
    def make(nodes, links):
        span, start = (high - low,) * 3, (low,) * 3
        return components(nodes, links, scale=span, offset=start)[axis]

    return make


def second(nodes, links):
    """Return y of `vector`, as the fourth coordinate."""
    return components(nodes, links)[1]


def voronoi(output: str, dimensions: str, feature: str, metric: str = 'EUCLIDEAN', *, normalize: bool = False,
            links_to: dict | None = None, **values: float) -> Graph:
    """Return a graph of a Voronoi Texture with linked coordinates."""
    linked = {} if dimensions == '1D' else {"Vector": vector}
    if dimensions in ('1D', '4D'):
        linked["W"] = second
    return node_graph(
        "TexVoronoi", output, links_to=linked | (links_to or {}), values={"Scale": 1.7, **values},
        voronoi_dimensions=dimensions, feature=feature, distance=metric, normalize=normalize)


def tinted(nodes, links):
    """Return the color of a Voronoi Texture times its distance."""
    color = voronoi("Color", '3D', 'F1')(nodes, links)
    product = nodes.new("ShaderNodeVectorMath")
    product.operation = 'MULTIPLY'
    links.new(color, product.inputs[0])
    links.new(color.node.outputs["Distance"], product.inputs[1])
    return product.outputs[0]


def voronoi_graphs() -> dict[str, Graph]:
    """All outputs of all features in all dimensions, plain and as normalized fractals; metrics; every input linked."""
    outputs = {
        'F1': ["Distance", "Color", "Position", "W"], 'F2': ["Distance", "Color", "Position"],
        'SMOOTH_F1': ["Distance", "Color", "Position", "W"], 'DISTANCE_TO_EDGE': ["Distance"],
        'N_SPHERE_RADIUS': ["Radius"],
    }
    graphs = {}
    for dimensions in ('1D', '2D', '3D', '4D'):
        has = {"Position": dimensions != '1D', "W": dimensions in ('1D', '4D')}
        for feature, names in outputs.items():
            for name in (name for name in names if has.get(name, True)):
                graphs[f"{dimensions} {feature} {name}"] = voronoi(name, dimensions, feature)
                graphs[f"{dimensions} {feature} {name} fractal"] = voronoi(
                    name, dimensions, feature, normalize=True, **FRACTAL)
    for metric in ('MANHATTAN', 'CHEBYCHEV', 'MINKOWSKI'):
        for dimensions in ('2D', '3D', '4D'):
            for feature in ('F1', 'F2', 'SMOOTH_F1'):
                graphs[f"{dimensions} {feature} {metric}"] = voronoi(
                    "Distance", dimensions, feature, metric, normalize=True, Detail=1.0, Exponent=1.3)
    every = {
        "Scale": ramp(0, 1.0, 2.0), "Detail": ramp(1, -0.5, 3.0), "Roughness": ramp(0, 0.0, 1.2),
        "Lacunarity": ramp(1, 1.5, 2.5), "Smoothness": ramp(1, 0.2, 1.1), "Exponent": ramp(1, 0.6, 1.6),
        "Randomness": ramp(0, -0.1, 1.1)}
    for name in ("Distance", "Color", "Position", "W"):
        graphs[f"every input linked, {name}"] = voronoi(name, '4D', 'SMOOTH_F1', 'MINKOWSKI', links_to=every)
    for exponent in (0.0, -1.0, 32.0):
        graphs[f"exponent {exponent}"] = voronoi("Distance", '3D', 'F1', 'MINKOWSKI', Exponent=exponent)
    graphs["lacunarity 0"] = voronoi("Distance", '3D', 'F1', Detail=2.0, Lacunarity=0.0)
    graphs["color times distance"] = tinted
    graphs["scale 0"] = voronoi("Position", '3D', 'F1', Scale=0.0)
    graphs["default coordinate"] = node_graph("TexVoronoi", "Distance")
    return graphs


def gabor_graphs() -> dict[str, Graph]:
    """All outputs in both dimensions, from one direction to all; every input linked."""
    graphs = {}
    for kind in ('2D', '3D'):
        for output in ("Value", "Phase", "Intensity"):
            for anisotropy in (1.0, 0.4, 0.0):
                graphs[f"{kind} {output} {anisotropy}"] = node_graph(
                    "TexGabor", output, links_to={"Vector": vector}, gabor_type=kind, values={
                        "Scale": 1.3, "Frequency": 1.7, "Anisotropy": anisotropy, "Orientation 2D": 0.9,
                        "Orientation 3D": (0.3, -0.5, 0.7)})
        graphs[f"{kind} every input linked"] = node_graph("TexGabor", "Value", gabor_type=kind, links_to={
            "Vector": vector, "Scale": ramp(0, 0.8, 1.2), "Frequency": ramp(1, -0.5, 2.0),
            "Anisotropy": ramp(1, -0.2, 1.2), "Orientation 2D": ramp(0, -1.0, 1.0), "Orientation 3D": vector})
    graphs["default coordinate"] = node_graph("TexGabor", "Value")
    return graphs
