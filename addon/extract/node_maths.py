# SPDX-License-Identifier: GPL-3.0-or-later
"""Translates nodes that compute: maths, vectors, mixing, colours, ramps and curves."""

from __future__ import annotations

import numpy as np

from ...engine.program import Value
from .node_graph import Graph, translates

__all__: list[str] = []

TABLE_SIZE = 256
"""Entries of ramps and curves, as many as Cycles takes"""


@translates("ShaderNodeValue")
def value_node(graph: Graph, node, output: str) -> Value:
    """A number."""
    return graph.builder.constant(node.outputs[0].default_value)


@translates("ShaderNodeRGB")
def rgb_node(graph: Graph, node, output: str) -> Value:
    """A colour."""
    return graph.builder.constant(tuple(node.outputs[0].default_value)[:3])


@translates("ShaderNodeMath")
def math_node(graph: Graph, node, output: str) -> Value:
    """Math."""
    build = graph.builder
    operands = [graph.value(node, name) for name in ("Value", "Value_001", "Value_002")]
    result = build.math(node.operation, *operands)
    return build.math("CLAMP", result, 0.0, 1.0) if node.use_clamp else result


@translates("ShaderNodeVectorMath")
def vector_math_node(graph: Graph, node, output: str) -> Value:
    """Vector Math; the factor of Scale and the index of Refract share a socket."""
    a, b, c = (graph.value(node, name) for name in ("Vector", "Vector_001", "Vector_002"))
    if node.operation in ("SCALE", "REFRACT"):
        c = graph.value(node, "Scale")
    return graph.builder.vector(node.operation, a, b, c)


@translates("ShaderNodeClamp")
def clamp_node(graph: Graph, node, output: str) -> Value:
    """Clamp; RANGE accepts the limits in either order."""
    build = graph.builder
    low, high = graph.value(node, "Min"), graph.value(node, "Max")
    if node.clamp_type == "RANGE":
        low, high = build.math("MINIMUM", low, high), build.math("MAXIMUM", low, high)
    return build.math("CLAMP", graph.value(node, "Value"), low, high)


def steps_factor(graph: Graph, factor: Value, steps: Value) -> Value:
    """Return a factor in steps, 0 for no steps."""
    build = graph.builder
    more = build.vector("ADD", steps, 1.0)
    return build.vector("DIVIDE", build.vector("FLOOR", build.vector("MULTIPLY", factor, more)), steps)


@translates("ShaderNodeMapRange")
def map_range_node(graph: Graph, node, output: str) -> Value:
    """Map Range of numbers and vectors."""
    build = graph.builder
    vector = node.data_type == "FLOAT_VECTOR"
    names = ("Vector", "From_Min_FLOAT3", "From_Max_FLOAT3", "To_Min_FLOAT3", "To_Max_FLOAT3", "Steps_FLOAT3")
    if not vector:
        names = ("Value", "From Min", "From Max", "To Min", "To Max", "Steps")
    value, low, high, to_low, to_high, steps = (graph.value(node, name) for name in names)
    kind = node.interpolation_type
    if kind in ("SMOOTHSTEP", "SMOOTHERSTEP"):
        parts = [
            build.math("MAP_" + kind, *(build.component(v, i) for v in (value, low, high)))
            for i in range(3 if vector else 1)
        ]
        factor = build.combine(*parts) if vector else parts[0]
    else:
        factor = build.vector("DIVIDE", build.vector("SUBTRACT", value, low), build.vector("SUBTRACT", high, low))
        if kind == "STEPPED":
            factor = steps_factor(graph, factor, steps)
    result = build.vector("MULTIPLY_ADD", factor, build.vector("SUBTRACT", to_high, to_low), to_low)
    if not vector:
        # An empty range maps to 0, not to its lower end.
        result = build.math("MULTIPLY", result, build.math("UNEQUAL", low, high))
    if node.clamp and kind not in ("SMOOTHSTEP", "SMOOTHERSTEP"):
        bottom, top = build.vector("MINIMUM", to_low, to_high), build.vector("MAXIMUM", to_low, to_high)
        result = build.vector("MINIMUM", build.vector("MAXIMUM", result, bottom), top)
    return result


@translates("ShaderNodeMix")
def mix_node(graph: Graph, node, output: str) -> Value:
    """Mix of numbers, vectors, colours."""
    build = graph.builder
    kind = {"FLOAT": "Float", "VECTOR": "Vector", "RGBA": "Color", "ROTATION": "Rotation"}[node.data_type]
    a, b = graph.value(node, f"A_{kind}"), graph.value(node, f"B_{kind}")
    uniform = node.data_type != "VECTOR" or node.factor_mode == "UNIFORM"
    factor = graph.value(node, "Factor_Float" if uniform else "Factor_Vector")
    if node.clamp_factor:
        factor = build.color("CLAMP", factor)
    if not uniform:
        rest = build.vector("SUBTRACT", 1.0, factor)
        return build.vector("MULTIPLY_ADD", a, rest, build.vector("MULTIPLY", b, factor))
    if node.data_type != "RGBA":
        return build.mix("MIX", factor, a, b)
    result = build.mix(node.blend_type, factor, a, b)
    return build.color("CLAMP", result) if node.clamp_result else result


@translates("ShaderNodeMixRGB")
def mix_rgb_node(graph: Graph, node, output: str) -> Value:
    """The older Mix of colours, whose factor is always clamped."""
    build = graph.builder
    factor = build.math("CLAMP", graph.value(node, "Fac"), 0.0, 1.0)
    result = build.mix(node.blend_type, factor, graph.value(node, "Color1"), graph.value(node, "Color2"))
    return build.color("CLAMP", result) if node.use_clamp else result


@translates("ShaderNodeCombineXYZ")
def combine_node(graph: Graph, node, output: str) -> Value:
    """Combine XYZ."""
    return graph.builder.combine(*(graph.value(node, name) for name in "XYZ"))


@translates("ShaderNodeSeparateXYZ")
def separate_node(graph: Graph, node, output: str) -> Value:
    """Separate XYZ."""
    return graph.builder.component(graph.value(node, "Vector"), "XYZ".index(output))


@translates("ShaderNodeCombineColor")
def combine_color_node(graph: Graph, node, output: str) -> Value:
    """Combine Color in RGB, HSV or HSL."""
    color = graph.builder.combine(*(graph.value(node, name) for name in ("Red", "Green", "Blue")))
    return color if node.mode == "RGB" else graph.builder.color("FROM_" + node.mode, color)


@translates("ShaderNodeSeparateColor")
def separate_color_node(graph: Graph, node, output: str) -> Value:
    """Separate Color in RGB, HSV or HSL."""
    color = graph.value(node, "Color")
    if node.mode != "RGB":
        color = graph.builder.color("TO_" + node.mode, color)
    return graph.builder.component(graph.builder.rgb(color), ("Red", "Green", "Blue").index(output))


@translates("ShaderNodeInvert")
def invert_node(graph: Graph, node, output: str) -> Value:
    """Invert."""
    return graph.builder.color("INVERT", graph.value(node, "Color"), graph.value(node, "Fac"))


@translates("ShaderNodeGamma")
def gamma_node(graph: Graph, node, output: str) -> Value:
    """Gamma; an exponent of 0 makes white."""
    gamma = graph.value(node, "Gamma")
    if gamma.constant is not None and gamma.constant[0] == 0.0:
        return graph.builder.constant(1.0)
    return graph.builder.color("GAMMA", graph.value(node, "Color"), gamma)


@translates("ShaderNodeBrightContrast")
def bright_contrast_node(graph: Graph, node, output: str) -> Value:
    """Brightness and contrast."""
    return graph.builder.color(
        "BRIGHT_CONTRAST", graph.value(node, "Color"), graph.value(node, "Bright"), graph.value(node, "Contrast"))


@translates("ShaderNodeHueSaturation")
def hue_saturation_node(graph: Graph, node, output: str) -> Value:
    """Hue, Saturation, Value."""
    shift = graph.builder.combine(*(graph.value(node, name) for name in ("Hue", "Saturation", "Value")))
    return graph.builder.color("HUE_SATURATION", graph.value(node, "Color"), shift, graph.value(node, "Fac"))


@translates("ShaderNodeRGBToBW")
def rgb_to_bw_node(graph: Graph, node, output: str) -> Value:
    """Luminance."""
    return graph.builder.luminance(graph.value(node, "Color"))


@translates("ShaderNodeBlackbody")
def blackbody_node(graph: Graph, node, output: str) -> Value:
    """Colour of a black body; the fit is for Rec.709 primaries."""
    color = graph.builder.color("BLACKBODY", graph.value(node, "Temperature"))
    if graph.from_rec709 is not None:
        color = graph.builder.transform([(*row, 0.0) for row in graph.from_rec709], color, direction=True)
    return graph.builder.vector("MAXIMUM", color, 0.0)


@translates("ShaderNodeValToRGB")
def color_ramp_node(graph: Graph, node, output: str) -> Value:
    """Color Ramp as a table of 256 entries."""
    ramp = node.color_ramp
    table = np.array([ramp.evaluate(i / (TABLE_SIZE - 1)) for i in range(TABLE_SIZE)], dtype=np.float32)
    mode = "CONSTANT" if ramp.interpolation == "CONSTANT" else "LINEAR"
    result = graph.builder.ramp(mode, table.tobytes(), graph.value(node, "Fac"))
    return graph.builder.component(result, 3) if output == "Alpha" else graph.builder.rgb(result)


def curve_table(mapping, count: int) -> tuple[np.ndarray, float, float]:
    """Return (float32 [256, 4], lowest x, highest x) of the first `count` curves, the combined one applied first."""
    mapping.initialize()
    curves = [mapping.curves[i] for i in range(count)]
    combined = mapping.curves[3] if len(mapping.curves) > 3 else None
    points = [point.location[0] for curve in mapping.curves for point in curve.points]
    low, high = min([0.0, *points]), max([1.0, *points])
    table = np.zeros((TABLE_SIZE, 4), dtype=np.float32)
    for i in range(TABLE_SIZE):
        x = low + (high - low) * i / (TABLE_SIZE - 1)
        if combined is not None:
            x = mapping.evaluate(combined, x)
        for channel in range(3):
            table[i, channel] = mapping.evaluate(curves[min(channel, count - 1)], x)
    return table, low, high


def curves(graph: Graph, node, value: Value, factor: Value, count: int) -> Value:
    """Return curves applied to `value`, mixed in by `factor`."""
    build = graph.builder
    table, low, high = curve_table(node.mapping, count)
    position = build.vector("DIVIDE", build.vector("SUBTRACT", build.rgb(value), low), high - low)
    mode = "CURVES_EXTRAPOLATED" if node.mapping.extend == "EXTRAPOLATED" else "CURVES"
    return build.mix("MIX", factor, value, build.ramp(mode, table.tobytes(), position))


@translates("ShaderNodeRGBCurve")
def rgb_curve_node(graph: Graph, node, output: str) -> Value:
    """RGB Curves."""
    return curves(graph, node, graph.value(node, "Color"), graph.value(node, "Fac"), 3)


@translates("ShaderNodeVectorCurve")
def vector_curve_node(graph: Graph, node, output: str) -> Value:
    """Vector Curves."""
    return curves(graph, node, graph.value(node, "Vector"), graph.value(node, "Fac"), 3)


@translates("ShaderNodeFloatCurve")
def float_curve_node(graph: Graph, node, output: str) -> Value:
    """Float Curve."""
    return curves(graph, node, graph.value(node, "Value"), graph.value(node, "Factor"), 1)
