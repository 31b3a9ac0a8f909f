# SPDX-License-Identifier: GPL-3.0-or-later
"""Translates shader nodes: BSDFs, emission, transparency, and how they are mixed and added."""

from __future__ import annotations

from collections.abc import Callable

from ...engine.program import Value
from ...engine.report import ReportKind
from .node_graph import UNEXPECTED, Graph
from .node_hair import principled_hair
from .node_inputs import perturbed_normal, surface_tangent

__all__ = ["add_shader"]

SHADERS_MAX = 512
"""Shader nodes followed per material: trees that share branches may otherwise grow without bound"""


def add_shader(graph: Graph, node, weight: Value) -> None:
    """Add a shader node, and what it mixes, with a weight."""
    pending: list[tuple] = [(node, weight)]
    followed = 0
    while pending:
        node, weight = pending.pop(0)
        followed += 1
        if followed > SHADERS_MAX:
            graph.tell(node, f"and others beyond the first {SHADERS_MAX} shader nodes were left out",
                       ReportKind.SKIPPED)
            return
        if weight.constant is not None and weight.constant[0] == 0.0:
            continue
        if node.bl_idname in ("ShaderNodeMixShader", "ShaderNodeAddShader"):
            pending += branches(graph, node, weight)
        elif node.bl_idname in SHADERS:
            try:
                SHADERS[node.bl_idname](graph, node, weight)
            except UNEXPECTED as error:
                graph.tell(node, f"could not be read ({error}); it counts as black", ReportKind.ERROR)
        else:
            graph.tell(node, "is not a shader that can be drawn; it counts as black", ReportKind.SKIPPED)


def branches(graph: Graph, node, weight: Value) -> list[tuple]:
    """Return the (node, weight) pairs that a Mix or Add Shader combines."""
    build = graph.builder
    weights = [weight, weight]
    if node.bl_idname == "ShaderNodeMixShader":
        factor = build.math("CLAMP", graph.value(node, "Fac"), 0.0, 1.0)
        weights = [build.math("MULTIPLY", weight, build.math("SUBTRACT", 1.0, factor)),
                   build.math("MULTIPLY", weight, factor)]
    sources = [graph.source(node, name) for name in ("Shader", "Shader_001")]
    return [(source[0], share) for source, share in zip(sources, weights, strict=True) if source is not None]


def tangent(graph: Graph, node, anisotropic: Value) -> Value:
    """Return the tangent for anisotropy: the input, else the surface's own; 0 where not needed."""
    build = graph.builder
    if anisotropic.constant is not None and anisotropic.constant[0] == 0.0:
        return build.constant(0.0)
    return graph.linked_or(node, "Tangent", lambda: surface_tangent(graph))


def is_zero(value: Value) -> bool:
    """Return whether a value is the constant 0."""
    return value.constant is not None and not any(value.constant[:3])


def film(graph: Graph, node) -> dict[str, Value]:
    """Return the arguments of a thin film [nm]; none where there is none, or the node knows none."""
    thickness = graph.value(node, "Thin Film Thickness")
    if is_zero(thickness):
        return {}
    return {"film_thickness": thickness, "film_ior": graph.value(node, "Thin Film IOR", 1.33)}


def principled(graph: Graph, node, weight: Value) -> None:
    """Principled BSDF: alpha makes transparency, emission stays out of the layers where there are none."""
    build = graph.builder
    alpha = build.math("CLAMP", graph.value(node, "Alpha", 1.0), 0.0, 1.0)
    build.transparent(1.0, build.math("MULTIPLY", weight, build.math("SUBTRACT", 1.0, alpha)))
    weight = build.math("MULTIPLY", weight, alpha)
    color, strength = graph.value(node, "Emission Color"), graph.value(node, "Emission Strength")
    coat, sheen = graph.value(node, "Coat Weight"), graph.value(node, "Sheen Weight")
    layered = not (is_zero(coat) and is_zero(sheen))
    build.emit(color, strength, weight, layered=layered)
    emission = build.vector("MULTIPLY", color, strength) if layered else 0.0
    anisotropic = graph.value(node, "Anisotropic")
    build.closure(
        "PRINCIPLED", weight, multiscatter=node.distribution == 'MULTI_GGX',
        color=graph.value(node, "Base Color", (0.8, 0.8, 0.8)), normal=perturbed_normal(graph, node),
        roughness=graph.value(node, "Roughness", 0.5), ior=graph.value(node, "IOR", 1.5),
        tangent=tangent(graph, node, anisotropic), anisotropic=anisotropic,
        anisotropic_rotation=graph.value(node, "Anisotropic Rotation"),
        diffuse_roughness=graph.value(node, "Diffuse Roughness"), metallic=graph.value(node, "Metallic"),
        specular_level=graph.value(node, "Specular IOR Level", 0.5),
        specular_tint=graph.value(node, "Specular Tint", (1.0, 1.0, 1.0)),
        transmission=graph.value(node, "Transmission Weight"),
        coat=coat, coat_roughness=graph.value(node, "Coat Roughness"), coat_ior=graph.value(node, "Coat IOR", 1.5),
        coat_tint=graph.value(node, "Coat Tint", (1.0, 1.0, 1.0)),
        # A coat that isn't bent itself follows the base.
        coat_normal=graph.linked_or(node, "Coat Normal", lambda: build.constant(0.0)),
        sheen=sheen, sheen_roughness=graph.value(node, "Sheen Roughness", 0.5),
        sheen_tint=graph.value(node, "Sheen Tint", (1.0, 1.0, 1.0)),
        emission=emission, thin_wall=graph.value(node, "Thin Wall"), **subsurface(graph, node), **film(graph, node),
    )


def scattering(graph: Graph, node, method: str, names: str) -> dict[str, object]:
    """Return how a node scatters light below the surface, as arguments of a closure; none without a radius.

    Args:
        graph: The node's.
        node: Principled BSDF or Subsurface Scattering.
        method: The name of the node's enumeration of methods.
        names: What its sockets' names begin with.
    """
    build = graph.builder
    radius = build.vector("SCALE", graph.value(node, names + "Radius"), 0.0, graph.value(node, names + "Scale"))
    chosen = getattr(node, method)
    if is_zero(radius):
        return {}
    if chosen == 'BURLEY':
        graph.tell(node, "has Christensen-Burley subsurface scattering, which is drawn by a random walk")
    # Before 5.2 there was no legacy walk: the walk was that one.
    walks = 'RANDOM_WALK_LEGACY' in node.bl_rna.properties[method].enum_items
    name = "SKIN" if chosen == 'RANDOM_WALK_SKIN' else "WALK" if chosen == 'RANDOM_WALK' and walks else "LEGACY"
    return {"subsurface_method": name, "subsurface_radius": radius,
            "subsurface_anisotropy": graph.value(node, names + "Anisotropy")}


def subsurface(graph: Graph, node) -> dict[str, object]:
    """Return what a Principled BSDF scatters below its surface or, thin, lets through, as arguments of a closure."""
    weight = graph.value(node, "Subsurface Weight")
    if is_zero(weight):
        return {"subsurface": weight}
    found = scattering(graph, node, "subsurface_method", "Subsurface ")
    if found.get("subsurface_method") == "SKIN":
        found["subsurface_ior"] = graph.value(node, "Subsurface IOR", 1.4)
    return {"subsurface": weight, **found}


def subsurface_scattering(graph: Graph, node, weight: Value) -> None:
    """Subsurface Scattering: a Principled BSDF that reflects nothing else."""
    build = graph.builder
    found = scattering(graph, node, "falloff", "")
    if found:
        found["subsurface_ior"] = graph.value(node, "IOR", 1.4)
    # Its roughness is the square of the other's, and only light that enters knows of it.
    roughness = build.math("SQRT", build.math("CLAMP", graph.value(node, "Roughness", 1.0), 0.0, 1.0))
    build.closure(
        "PRINCIPLED", weight, color=graph.value(node, "Color"), normal=perturbed_normal(graph, node),
        roughness=roughness, ior=1.5, specular_tint=1.0, coat_ior=1.5, coat_tint=1.0, sheen_tint=1.0, subsurface=1.0,
        **found)


def diffuse(graph: Graph, node, weight: Value) -> None:
    """Diffuse BSDF."""
    graph.builder.closure("DIFFUSE", weight, color=graph.value(node, "Color"),
                          roughness=graph.value(node, "Roughness"), normal=perturbed_normal(graph, node))


def glossy(graph: Graph, node, weight: Value) -> None:
    """Glossy BSDF."""
    if node.distribution in ('BECKMANN', 'ASHIKHMIN_SHIRLEY'):
        graph.tell(node, f"has the distribution {node.distribution}, which is drawn as GGX")
    anisotropic = graph.value(node, "Anisotropy")
    graph.builder.closure(
        "GLOSSY", weight, multiscatter=node.distribution == 'MULTI_GGX', color=graph.value(node, "Color"),
        roughness=graph.value(node, "Roughness"), normal=perturbed_normal(graph, node), anisotropic=anisotropic,
        anisotropic_rotation=graph.value(node, "Rotation"), tangent=tangent(graph, node, anisotropic))


def glass(graph: Graph, node, weight: Value) -> None:
    """Glass BSDF and Refraction BSDF."""
    if node.distribution == 'BECKMANN':
        graph.tell(node, "has the distribution BECKMANN, which is drawn as GGX")
    kind = "GLASS" if node.bl_idname == "ShaderNodeBsdfGlass" else "REFRACTION"
    graph.builder.closure(
        kind, weight, multiscatter=node.distribution == 'MULTI_GGX', color=graph.value(node, "Color"),
        roughness=graph.value(node, "Roughness"), ior=graph.value(node, "IOR"), normal=perturbed_normal(graph, node),
        **film(graph, node))


def conductor(n: Value, k: Value, cosine: float, graph: Graph) -> Value:
    """Return the unpolarised reflectance of a metal of complex index n + ik at an angle."""
    build = graph.builder

    def over(numerator: Value, denominator: Value) -> Value:
        return build.vector("DIVIDE", numerator, denominator)

    square = build.vector("ADD", build.vector("MULTIPLY", n, n), build.vector("MULTIPLY", k, k))
    middle = build.vector("SCALE", n, 0.0, 2.0 * cosine)
    flat = build.vector("ADD", square, cosine * cosine)
    steep = build.vector("ADD", build.vector("SCALE", square, 0.0, cosine * cosine), 1.0)
    s = over(build.vector("SUBTRACT", flat, middle), build.vector("ADD", flat, middle))
    p = over(build.vector("SUBTRACT", steep, middle), build.vector("ADD", steep, middle))
    return build.vector("SCALE", build.vector("ADD", s, p), 0.0, 0.5)


def metallic(graph: Graph, node, weight: Value) -> None:
    """Metallic BSDF, drawn by the metal of the Principled BSDF (F82 tint)."""
    build = graph.builder
    if node.distribution == 'BECKMANN':
        graph.tell(node, "has the distribution BECKMANN, which is drawn as GGX")
    color, edge = graph.value(node, "Base Color"), graph.value(node, "Edge Tint")
    if node.fresnel_type == 'PHYSICAL_CONDUCTOR':
        graph.tell(node, "has a physical conductor's Fresnel, which is fitted by an F82 tint")
        n, k = graph.value(node, "IOR"), graph.value(node, "Extinction")
        color = conductor(n, k, 1.0, graph)
        rise = (1.0 - 1.0 / 7.0) ** 5
        schlick = build.vector("ADD", build.vector("SCALE", color, 0.0, 1.0 - rise), rise)
        edge = build.color("CLAMP", build.vector("DIVIDE", conductor(n, k, 1.0 / 7.0, graph), schlick))
    anisotropic = graph.value(node, "Anisotropy")
    build.closure(
        "PRINCIPLED", weight, multiscatter=node.distribution == 'MULTI_GGX', color=build.color("CLAMP", color),
        specular_tint=build.color("CLAMP", edge), metallic=1.0, roughness=graph.value(node, "Roughness"), ior=1.5,
        normal=perturbed_normal(graph, node), anisotropic=anisotropic, specular_level=0.5, coat_ior=1.5,
        anisotropic_rotation=graph.value(node, "Rotation"), tangent=tangent(graph, node, anisotropic),
        coat_tint=1.0, sheen_tint=1.0, **film(graph, node))


def simple(kind: str) -> Callable[[Graph, object, Value], None]:
    """Return the translator of a BSDF with a colour, perhaps a roughness, and a normal."""

    def translate(graph: Graph, node, weight: Value) -> None:
        graph.builder.closure(kind, weight, color=graph.value(node, "Color"),
                              roughness=graph.value(node, "Roughness"), normal=perturbed_normal(graph, node))

    return translate


def as_diffuse(what: str) -> Callable[[Graph, object, Value], None]:
    """Return the translator of a BSDF that is drawn as a diffuse one."""

    def translate(graph: Graph, node, weight: Value) -> None:
        graph.tell(node, f"is {what}, which is drawn as a Diffuse BSDF")
        graph.builder.closure(
            "DIFFUSE", weight, color=graph.value(node, "Color"), normal=perturbed_normal(graph, node))

    return translate


def toon(graph: Graph, node, weight: Value) -> None:
    """Toon BSDF."""
    graph.builder.closure(
        "TOON_" + node.component, weight, color=graph.value(node, "Color"), roughness=graph.value(node, "Size"),
        anisotropic=graph.value(node, "Smooth"), normal=perturbed_normal(graph, node))


def sheen(graph: Graph, node, weight: Value) -> None:
    """Sheen BSDF."""
    if node.distribution == 'ASHIKHMIN':
        graph.tell(node, "has the distribution ASHIKHMIN, which is drawn as MICROFIBER")
    simple("SHEEN")(graph, node, weight)


def emission(graph: Graph, node, weight: Value) -> None:
    """Emission, and Background, which is the same on surfaces."""
    graph.builder.emit(graph.value(node, "Color"), graph.value(node, "Strength"), weight)


def transparent(graph: Graph, node, weight: Value) -> None:
    """Transparent BSDF."""
    graph.builder.transparent(graph.value(node, "Color"), weight)


def ray_portal(graph: Graph, node, weight: Value) -> None:
    """Ray Portal BSDF: a hole."""
    graph.tell(node, "is a ray portal, which is drawn as a Transparent BSDF")
    transparent(graph, node, weight)


def holdout(graph: Graph, node, weight: Value) -> None:
    """Holdout."""
    graph.builder.holdout(weight)


SHADERS: dict[str, Callable[[Graph, object, Value], None]] = {
    "ShaderNodeBsdfPrincipled": principled,
    "ShaderNodeBsdfDiffuse": diffuse,
    "ShaderNodeBsdfGlossy": glossy,
    "ShaderNodeBsdfAnisotropic": glossy,
    "ShaderNodeBsdfGlass": glass,
    "ShaderNodeBsdfRefraction": glass,
    "ShaderNodeBsdfMetallic": metallic,
    "ShaderNodeBsdfTranslucent": simple("TRANSLUCENT"),
    "ShaderNodeBsdfSheen": sheen,
    "ShaderNodeBsdfToon": toon,
    "ShaderNodeBsdfHair": as_diffuse("a hair shader"),
    "ShaderNodeBsdfHairPrincipled": principled_hair,
    "ShaderNodeSubsurfaceScattering": subsurface_scattering,
    "ShaderNodeBsdfTransparent": transparent,
    "ShaderNodeBsdfRayPortal": ray_portal,
    "ShaderNodeEmission": emission,
    "ShaderNodeBackground": emission,
    "ShaderNodeHoldout": holdout,
}
