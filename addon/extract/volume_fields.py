# SPDX-License-Identifier: GPL-3.0-or-later
"""What is linked to a Volume socket and varies in space, as programs of its coefficients; for constants see volume.py.

Coefficients are those of Cycles (kernel/svm/closure.h, svm_node_closure_volume and svm_node_principled_volume).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ...engine.program import Value
from ...engine.volume_program import FieldData, FieldSum, VaryingData, VolumeBuilder
from .node_graph import UNEXPECTED, Graph

__all__ = ["Unfollowed", "read_fields"]

NODES_MAX = 512
"""As of volume.py"""


class Unfollowed(Exception):
    """Something varies that has no program."""


@dataclass(eq=False)
class _Sums:
    """What has been added up of a tree's shaders."""

    build: VolumeBuilder
    stefan_boltzmann: float
    phases_of: Callable[[Graph, object, Callable[[str], None]], list[tuple[float, float]]]
    extinction: FieldSum = field(init=False)
    emission: FieldSum = field(init=False)
    phases: dict[int, tuple[Value, FieldSum]] = field(default_factory=dict)
    """By anisotropy"""

    def __post_init__(self) -> None:
        self.extinction, self.emission = FieldSum(self.build), FieldSum(self.build)

    def scatter(self, color: Value, density: Value, phases: list[tuple[float, Value]]) -> None:
        """Add scattering by phase functions: (share, anisotropy) each. It takes away what it scatters."""
        build = self.build
        self.extinction.add(color, density)
        for share, anisotropy in phases:
            _, held = self.phases.setdefault(anisotropy.index, (anisotropy, FieldSum(build)))
            held.add(color, build.math("MULTIPLY", density, share))

    def finish(self) -> VaryingData:
        """Return the medium. Raises RegisterOverflow."""
        phases = []
        for anisotropy, held in self.phases.values():
            scattering = held.finish()
            if scattering:
                phases.append((scattering, self._number(anisotropy)))
        return VaryingData(self.extinction.finish(), self.emission.finish(), tuple(phases))

    def _number(self, value: Value) -> FieldData:
        if value.constant is not None:
            return FieldData((value.constant[0],) * 3)
        return FieldData((1.0, 1.0, 1.0), self.build.compiled(value))


def read_fields(graph: Graph, source: tuple, stefan_boltzmann: float, phases_of: Callable) -> VaryingData:
    """Return the medium of a tree, from the shader or colour that is linked to the output; the builder: VolumeBuilder.

    Raises:
        Unfollowed: Something varies that must be constant.
        RegisterOverflow: The tree is too large.
    """
    sums = _Sums(graph.builder, stefan_boltzmann, phases_of)
    build = graph.builder
    if source[1].type != 'SHADER':
        sums.emission.add(graph.convert(graph.output(*source), source[1].type, 'RGBA'), build.constant(1.0))
        return sums.finish()
    pending = [(source[0], build.constant(1.0))]
    for _ in range(NODES_MAX):
        if not pending:
            break
        node, weight = pending.pop(0)
        if node.bl_idname in ("ShaderNodeMixShader", "ShaderNodeAddShader"):
            pending += branches(graph, node, weight)
        elif node.bl_idname in SHADERS and not is_zero(weight):
            try:
                SHADERS[node.bl_idname](graph, node, weight, sums)
            except UNEXPECTED:
                # volume.py has said so.
                continue
    return sums.finish()


def is_zero(value: Value) -> bool:
    """Return whether a number is the constant 0, or below."""
    return value.constant is not None and value.constant[0] <= 0.0


def branches(graph: Graph, node, weight: Value) -> list[tuple]:
    """Return the (node, weight) pairs that a Mix or Add Shader combines."""
    build, weights = graph.builder, [weight, weight]
    if node.bl_idname == "ShaderNodeMixShader":
        factor = build.math("CLAMP", graph.value(node, "Fac"), 0.0, 1.0)
        weights = [build.math("MULTIPLY", weight, build.math("SUBTRACT", 1.0, factor)),
                   build.math("MULTIPLY", weight, factor)]
    sources = [graph.source(node, name) for name in ("Shader", "Shader_001")]
    return [(source[0], share) for source, share in zip(sources, weights, strict=True) if source is not None]


def positive(graph: Graph, value: Value) -> Value:
    """Return a number or colour without what is below 0."""
    return graph.builder.vector("MAXIMUM", value, 0.0)


def density_of(graph: Graph, node, weight: Value, fallback: float = 0.0) -> Value:
    """Return a node's density times its weight."""
    build = graph.builder
    return build.math("MULTIPLY", weight, build.math("MAXIMUM", graph.value(node, "Density", fallback), 0.0))


def color_of(graph: Graph, node, name: str, fallback: float = 0.0) -> Value:
    """Return a colour input without alpha."""
    return graph.builder.rgb(graph.value(node, name, fallback))


def absorption(graph: Graph, node, weight: Value, sums: _Sums) -> None:
    """Volume Absorption."""
    absorbed = graph.builder.vector("SUBTRACT", 1.0, color_of(graph, node, "Color"))
    sums.extinction.add(absorbed, density_of(graph, node, weight))


def scatter(graph: Graph, node, weight: Value, sums: _Sums) -> None:
    """Volume Scatter: what is not scattered in a channel passes."""
    sums.scatter(positive(graph, color_of(graph, node, "Color")), density_of(graph, node, weight),
                 phases_of(graph, node, sums))


def coefficients(graph: Graph, node, weight: Value, sums: _Sums) -> None:
    """Volume Coefficients."""
    sums.scatter(positive(graph, color_of(graph, node, "Scatter Coefficients")), weight, phases_of(graph, node, sums))
    sums.extinction.add(positive(graph, color_of(graph, node, "Absorption Coefficients")), weight)
    sums.emission.add(color_of(graph, node, "Emission Coefficients"), weight)


def principled(graph: Graph, node, weight: Value, sums: _Sums) -> None:
    """Principled Volume, with the grids that it names."""
    build = graph.builder

    def grid(name: str) -> Value:
        return build.optional_grid(grid_name(node, name))

    density = build.math("MULTIPLY", density_of(graph, node, weight, 1.0), build.math(
        "MAXIMUM", grid("Density Attribute"), 0.0))
    tint = color_of(graph, node, "Color", 0.5)
    named = grid("Color Attribute")
    if named.constant is None:
        tint = build.vector("MULTIPLY", tint, build.rgb(named))
    tint = positive(graph, tint)
    sums.scatter(tint, density, [(1.0, graph.value(node, "Anisotropy"))])
    absorbed = build.vector("POWER", positive(graph, color_of(graph, node, "Absorption Color")), 0.5)
    sums.extinction.add(build.vector(
        "MULTIPLY", positive(graph, build.vector("SUBTRACT", 1.0, tint)),
        positive(graph, build.vector("SUBTRACT", 1.0, absorbed))), density)
    # The weight of mixing is not in the light, in Cycles too.
    strength = build.math("MAXIMUM", graph.value(node, "Emission Strength"), 0.0)
    if not is_zero(strength):
        sums.emission.add(color_of(graph, node, "Emission Color", 1.0), strength)
    heat = graph.value(node, "Blackbody Intensity")
    if is_zero(heat):
        return
    temperature = build.math("MULTIPLY", graph.value(node, "Temperature", 1000.0), build.math(
        "MAXIMUM", grid("Temperature Attribute"), 0.0))
    temperature = build.math("MAXIMUM", temperature, 0.0)
    square = build.math("MULTIPLY", temperature, temperature)
    fourth = build.math("MULTIPLY", square, square)
    # Nothing shines where the intensity is 0.
    shine = build.math("MULTIPLY", sums.stefan_boltzmann, build.math(
        "ADD", 1.0, build.math("MULTIPLY", heat, build.math("SUBTRACT", fourth, 1.0))))
    shine = build.math("MULTIPLY", shine, build.math("GREATER_THAN", heat, 0.0))
    sums.emission.add(build.vector(
        "MULTIPLY", blackbody(graph, temperature), color_of(graph, node, "Blackbody Tint", 1.0)), shine)


def grid_name(node, name: str) -> str:
    """Return the grid that a text socket names, empty for none."""
    found = next((socket for socket in node.inputs if socket.identifier == name), None)
    return "" if found is None else str(found.default_value)


def blackbody(graph: Graph, temperature: Value) -> Value:
    """Return the colour of a black body; the fit is for Rec.709 primaries."""
    found = graph.builder.color("BLACKBODY", temperature)
    if graph.from_rec709 is not None:
        found = graph.builder.transform([(*row[:3], 0.0) for row in graph.from_rec709], found, direction=True)
    return positive(graph, found)


def emission(graph: Graph, node, weight: Value, sums: _Sums) -> None:
    """Emission: radiance per metre."""
    sums.emission.add(color_of(graph, node, "Color"), graph.builder.math(
        "MULTIPLY", graph.value(node, "Strength"), weight))


def phases_of(graph: Graph, node, sums: _Sums) -> list[tuple[float, Value]]:
    """Return (share, anisotropy) of the phase functions of a node."""
    if getattr(node, "phase", 'HENYEY_GREENSTEIN') == 'HENYEY_GREENSTEIN':
        return [(1.0, graph.value(node, "Anisotropy"))]
    for name in ("Anisotropy", "Alpha", "Backscatter", "Diameter", "IOR"):
        if graph.is_linked(node, name) and graph.value(node, name).constant is None:
            raise Unfollowed(name)
    return [(share, graph.builder.constant(g)) for share, g in sums.phases_of(graph, node, lambda message: None)]


SHADERS: dict[str, Callable[[Graph, object, Value, _Sums], None]] = {
    "ShaderNodeVolumeAbsorption": absorption,
    "ShaderNodeVolumeScatter": scatter,
    "ShaderNodeVolumePrincipled": principled,
    "ShaderNodeVolumeCoefficients": coefficients,
    "ShaderNodeEmission": emission,
}
