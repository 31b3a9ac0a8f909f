# SPDX-License-Identifier: GPL-3.0-or-later
"""What is linked to the Volume socket of a material's or a world's output, as a medium.

Coefficients are those of Cycles (kernel/svm/closure.h, svm_node_closure_volume and svm_node_principled_volume). A tree
that varies in space has programs of them (volume_fields.py), and an estimate of its mean, by which it is drawn where it
can't be followed; that is named in the report.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ...engine.mean_program import LEVELS, MeanBuilder
from ...engine.media import MediumData, PhaseData
from ...engine.program import RegisterOverflow, Value
from ...engine.report import Report, ReportKind
from ...engine.volume_program import VaryingData, VolumeBuilder
from .node_graph import UNEXPECTED, Graph
from .volume_fields import Unfollowed, read_fields

__all__ = ["read_medium"]

NODES_MAX = 512
"""Shader nodes followed: trees that share branches may otherwise grow without bound"""

STEFAN_BOLTZMANN = 5.670373e-8 * 1e-6 / math.pi
"""As Cycles scales it [W / (m^2 K^4)]"""


class Unknown(Exception):
    """A value that comes to no constant."""


class NoImages:
    """Stands in for the image collector: no texel of a volume's textures is read."""

    def key(self, *_args) -> int:
        """Return a key of nothing."""
        return 0

    def computed(self, *_args) -> int:
        """Return a key of nothing."""
        return 0


class Sum:
    """What has been added up of a tree's shaders."""

    def __init__(self) -> None:
        self.extinction, self.emission = np.zeros(3), np.zeros(3)
        self.phases: list[tuple[np.ndarray, float]] = []

    def scatter(self, coefficient: np.ndarray, phases: list[tuple[float, float]]) -> None:
        """Add scattering by phase functions: (share, anisotropy) each. It takes away what it scatters."""
        self.extinction += coefficient
        self.phases += [(coefficient * share, anisotropy) for share, anisotropy in phases]


def read_medium(
    make_graph: Callable[..., Graph], tree, output, images, report: Report, owner: str, *, world: bool = False,
) -> MediumData | None:
    """Return the medium that an output's Volume socket leads to, None for none.

    Args:
        make_graph: material.make_graph.
        tree: Inlined node tree.
        output: Its output, or None.
        images: Image collector.
        report: Receives what is approximated or left out.
        owner: Name of the data-block for messages.
        world: Whether it fills the world: no volume object can have it.
    """
    if output is None:
        return None
    said, sums, varied = Report(), [], False
    for level in LEVELS:
        builder = MeanBuilder(level)
        graph = make_graph(tree, NoImages(), Report(), owner, builder=builder)
        source = graph.source(output, "Volume")
        if source is None:
            return None
        said = Report()
        try:
            sums.append(add_up(graph, source, said))
        except Unknown:
            sums, varied = [], True
            break
        varied = builder.varied
        if not varied:
            break
    report.merge(said)
    medium = mean_of(sums) if sums else MediumData()
    varying = fields_of(make_graph, tree, output, images, report, owner, optional=False) if varied else None
    in_grids = None if world else fields_of(make_graph, tree, output, images, Report(), owner, optional=True)
    return replace(medium, varying=varying, in_grids=in_grids)


def fields_of(
    make_graph: Callable[..., Graph], tree, output, images, report: Report, owner: str, *, optional: bool,
) -> VaryingData | None:
    """Return the programs of a medium's coefficients, None where there are none; says why not.

    `optional`: for volume objects, whose grids are read.
    """
    graph = make_graph(tree, images, Report(), owner, builder=VolumeBuilder(optional))
    why = ""
    try:
        found = read_fields(graph, graph.source(output, "Volume"), STEFAN_BOLTZMANN, phases_of)
    except Unfollowed:
        why = "varies in space in its phase function"
    except (RegisterOverflow, RecursionError):
        why = "varies in space by too many nodes"
    else:
        if found.of_camera:
            why = "depends on the camera"
    if why:
        report.add(ReportKind.APPROXIMATED, owner, f"has a volume that {why}; an estimate of its mean is drawn")
        return None
    if found.of_rays:
        report.add(ReportKind.APPROXIMATED, owner,
                   "has a volume that depends on rays; it is drawn as for rays of no kind")
    return found if found.varies else None


def mean_of(sums: list[Sum]) -> MediumData:
    """Return the mean of what a tree comes to."""
    count = len(sums)
    phases = [(scattering / count, anisotropy) for each in sums for scattering, anisotropy in each.phases]
    merged: dict[float, np.ndarray] = {}
    for scattering, anisotropy in phases:
        merged[anisotropy] = merged.get(anisotropy, 0.0) + scattering
    return MediumData(
        extinction=color(sum(each.extinction for each in sums) / count),
        emission=color(sum(each.emission for each in sums) / count),
        phases=tuple(PhaseData(color(scattering), g) for g, scattering in merged.items() if scattering.max() > 0.0))


def color(value: np.ndarray) -> tuple[float, float, float]:
    """Return coefficients, none of them negative."""
    return tuple(float(x) for x in np.maximum(np.nan_to_num(value), 0.0))


def add_up(graph: Graph, source: tuple, said: Report) -> Sum:
    """Follow a tree from the shader or colour that is linked to the output."""
    total = Sum()
    if source[1].type != 'SHADER':
        # A colour plugged into a shader socket emits, as in Blender.
        total.emission += vector(graph.convert(graph.output(*source), source[1].type, 'RGBA'))
        return total
    pending = [(source[0], 1.0)]
    for _ in range(NODES_MAX):
        if not pending:
            break
        node, weight = pending.pop(0)
        if node.bl_idname in ("ShaderNodeMixShader", "ShaderNodeAddShader"):
            pending += branches(graph, node, weight)
        elif weight > 0.0 and node.bl_idname in SHADERS:
            say = partial(tell, said, graph, node)
            try:
                SHADERS[node.bl_idname](graph, node, weight, total, say)
            except UNEXPECTED as error:
                tell(said, graph, node, f"could not be read ({error}); it counts as nothing")
        elif weight > 0.0:
            tell(said, graph, node, "does not fill a volume; it counts as nothing")
    return total


def tell(said: Report, graph: Graph, node, message: str) -> None:
    """Add an entry about a node."""
    kept, graph.report = graph.report, said
    graph.tell(node, message)
    graph.report = kept


def branches(graph: Graph, node, weight: float) -> list[tuple]:
    """Return the (node, weight) pairs that a Mix or Add Shader combines."""
    weights = [weight, weight]
    if node.bl_idname == "ShaderNodeMixShader":
        factor = min(max(number(graph.value(node, "Fac")), 0.0), 1.0)
        weights = [weight * (1.0 - factor), weight * factor]
    sources = [graph.source(node, name) for name in ("Shader", "Shader_001")]
    return [(source[0], share) for source, share in zip(sources, weights, strict=True) if source is not None]


def vector(value: Value) -> np.ndarray:
    """Return a constant's colour."""
    if value.constant is None:
        raise Unknown
    return np.asarray(value.constant[:3], float)


def number(value: Value) -> float:
    """Return a constant's number."""
    return float(vector(value)[0])


def absorption(graph: Graph, node, weight: float, total: Sum, say: Callable[[str], None]) -> None:
    """Volume Absorption."""
    density = weight * max(number(graph.value(node, "Density")), 0.0)
    total.extinction += (1.0 - vector(graph.value(node, "Color"))) * density


def scatter(graph: Graph, node, weight: float, total: Sum, say: Callable[[str], None]) -> None:
    """Volume Scatter: what is not scattered in a channel passes."""
    density = weight * max(number(graph.value(node, "Density")), 0.0)
    total.scatter(np.maximum(vector(graph.value(node, "Color")), 0.0) * density, phases_of(graph, node, say))


def coefficients(graph: Graph, node, weight: float, total: Sum, say: Callable[[str], None]) -> None:
    """Volume Coefficients."""
    scattering = np.maximum(vector(graph.value(node, "Scatter Coefficients")), 0.0) * weight
    total.scatter(scattering, phases_of(graph, node, say))
    total.extinction += np.maximum(vector(graph.value(node, "Absorption Coefficients")), 0.0) * weight
    total.emission += vector(graph.value(node, "Emission Coefficients")) * weight


def principled(graph: Graph, node, weight: float, total: Sum, say: Callable[[str], None]) -> None:
    """Principled Volume; grids that its attributes name are for volume objects alone."""
    density = weight * max(number(graph.value(node, "Density", 1.0)), 0.0)
    tint = np.maximum(vector(graph.value(node, "Color", 0.5)), 0.0)
    total.scatter(tint * density, [(1.0, number(graph.value(node, "Anisotropy")))])
    absorbed = np.maximum(vector(graph.value(node, "Absorption Color")), 0.0)
    total.extinction += np.maximum(1.0 - tint, 0.0) * np.maximum(1.0 - np.sqrt(absorbed), 0.0) * density
    # The weight of mixing is not in the light, in Cycles too.
    strength = max(number(graph.value(node, "Emission Strength")), 0.0)
    total.emission += vector(graph.value(node, "Emission Color", 1.0)) * strength
    heat = number(graph.value(node, "Blackbody Intensity"))
    if heat > 0.0:
        temperature = max(number(graph.value(node, "Temperature", 1000.0)), 0.0)
        shine = STEFAN_BOLTZMANN * (1.0 + heat * (temperature**4 - 1.0))
        total.emission += blackbody(graph, temperature) * vector(graph.value(node, "Blackbody Tint", 1.0)) * shine


def blackbody(graph: Graph, temperature: float) -> np.ndarray:
    """Return the colour of a black body; the fit is for Rec.709 primaries."""
    found = vector(graph.builder.color("BLACKBODY", temperature))
    if graph.from_rec709 is not None:
        found = np.asarray(graph.from_rec709)[:, :3] @ found
    return np.maximum(found, 0.0)


def emission(graph: Graph, node, weight: float, total: Sum, say: Callable[[str], None]) -> None:
    """Emission: radiance per metre."""
    total.emission += vector(graph.value(node, "Color")) * number(graph.value(node, "Strength")) * weight


def phases_of(graph: Graph, node, say: Callable[[str], None]) -> list[tuple[float, float]]:
    """Return (share, anisotropy) of the phase functions of a node: others are drawn by Henyey and Greenstein's."""
    kind = getattr(node, "phase", 'HENYEY_GREENSTEIN')
    if kind == 'HENYEY_GREENSTEIN':
        return [(1.0, number(graph.value(node, "Anisotropy")))]
    say(f"has the phase function {kind}, which is drawn as HENYEY_GREENSTEIN of the same mean cosine")
    if kind == 'DRAINE':
        return [(1.0, draine_cosine(number(graph.value(node, "Anisotropy")), number(graph.value(node, "Alpha"))))]
    if kind == 'FOURNIER_FORAND':
        return [(1.0, anisotropy_of(number(graph.value(node, "Backscatter"))))]
    if kind == 'MIE':
        return mie(number(graph.value(node, "Diameter")))
    return [(1.0, 0.0)]


def draine_cosine(g: float, alpha: float) -> float:
    """Return the mean cosine of Draine's phase function ("Scattering by Interstellar Dust Grains", 2003, eq. 6)."""
    return g * (1.0 + alpha * (3.0 + 2.0 * g * g) / 5.0) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)


def anisotropy_of(backscatter: float) -> float:
    """Return the anisotropy by which Henyey and Greenstein's function sends this share of light back."""
    def share(g: float) -> float:
        return (1.0 - g) / (2.0 * g) * ((1.0 + g) / math.sqrt(1.0 + g * g) - 1.0)

    low, high = 1e-3, 0.9999
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if share(middle) > backscatter else (low, middle)
    return low


def mie(diameter: float) -> list[tuple[float, float]]:
    """Return the phase function of water droplets of 5 to 50 micrometres.

    Jendersie and d'Eon, "An Approximate Mie Scattering Function for Fog and Cloud Rendering" (SIGGRAPH 2023 Talks),
    eq. 4 to 7; the part that is Draine's by its mean cosine.
    """
    d = min(max(diameter, 5.0), 50.0)
    g_first, g_second = math.exp(-0.0990567 / (d - 1.67154)), math.exp(-2.20679 / (d + 3.91029) - 0.428934)
    alpha = math.exp(3.62489 - 8.29288 / (d + 5.52825))
    share = math.exp(-0.599085 / (d - 0.641583) - 0.665888)
    return [(1.0 - share, g_first), (share, draine_cosine(g_second, alpha))]


SHADERS: dict[str, Callable[[Graph, object, float, Sum, Callable[[str], None]], None]] = {
    "ShaderNodeVolumeAbsorption": absorption,
    "ShaderNodeVolumeScatter": scatter,
    "ShaderNodeVolumePrincipled": principled,
    "ShaderNodeVolumeCoefficients": coefficients,
    "ShaderNodeEmission": emission,
}
