# SPDX-License-Identifier: GPL-3.0-or-later
"""The materials of socket_survey.py: values of every socket of the Principled BSDF and of the other surface shaders.

A case is one shader node with some sockets and options other than Blender's. The names of groups are those by which
--only picks them. Values go to the ends of what a slider has, and to what artists use in between.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

RED, BLUE, GOLD = (0.8, 0.2, 0.1), (0.1, 0.25, 0.8), (0.95, 0.7, 0.3)


@dataclass(frozen=True)
class SocketCase:
    """One material."""

    group: str
    label: str
    node: str
    """What its node's type is called after `ShaderNode`"""
    inputs: dict[str, Any] = field(default_factory=dict)
    """Values by sockets' identifiers; a string is the name of a vector that a node computes (VECTORS)"""
    options: dict[str, Any] = field(default_factory=dict)
    """Properties of the node"""
    mix: str = ""
    """Node that it is mixed (Mix Shader) or added (+) with, by halves"""


def principled(group: str, socket: str, values: tuple, base: dict | None = None, **options: Any) -> list[SocketCase]:
    """Return cases of one socket of the Principled BSDF."""
    inputs = {"Base Color": RED} | (base or {})
    kinds = (("Metallic", "metal"), ("Transmission Weight", "glass"), ("Thin Wall", "thin"), ("Coat Weight", "coat"))
    of = "".join(f"{name}: " for key, name in kinds if inputs.get(key) and key != socket)
    text = "".join(f" {value}".lower() for value in options.values())
    return [SocketCase(group, f"{of}{socket} {named(value)}{text}", "BsdfPrincipled", inputs | {socket: value}, options)
            for value in values]


def named(value: Any) -> str:
    """Return a value as the table shows it."""
    if isinstance(value, tuple):
        return " ".join(f"{v:g}" for v in value)
    return value if isinstance(value, str) else f"{value:g}"


def principled_cases() -> list[SocketCase]:
    """Return the cases of the Principled BSDF."""
    rough = {"Roughness": 0.4}
    metal = {"Base Color": GOLD, "Metallic": 1.0, "Roughness": 0.35}
    glass = {"Base Color": (0.9, 0.95, 1.0), "Transmission Weight": 1.0, "Roughness": 0.15}
    coat = {"Coat Weight": 1.0, "Base Color": BLUE, "Roughness": 0.6}
    sheen = {"Sheen Weight": 1.0, "Base Color": (0.2, 0.05, 0.05), "Roughness": 0.8}
    skin = {"Subsurface Weight": 1.0, "Subsurface Radius": (1.0, 0.4, 0.2), "Subsurface Scale": 0.2,
            "Base Color": (0.8, 0.5, 0.4)}
    film = {"Thin Film Thickness": 400.0, "Base Color": (0.05, 0.05, 0.05), "Roughness": 0.2}
    thin = glass | {"Thin Wall": True}
    return [
        *principled("base", "Base Color", ((0.0, 0.0, 0.0), RED, (1.0, 1.0, 1.0))),
        *principled("base", "Roughness", (0.0, 0.1, 0.3, 0.5, 0.7, 1.0)),
        *principled("base", "Diffuse Roughness", (0.5, 1.0)),
        *principled("base", "IOR", (1.0, 1.2, 2.5, 0.7), rough),
        *principled("base", "Metallic", (0.5, 1.0), {"Base Color": GOLD} | rough),
        *principled("base", "Specular IOR Level", (0.0, 0.2, 1.0), rough),
        *principled("base", "Specular Tint", ((1.0, 0.3, 0.1), (0.0, 0.0, 0.0)), rough | {"IOR": 2.0}),
        *principled("base", "Specular Tint", ((1.0, 0.3, 0.1),), metal),
        *principled("base", "Roughness", (0.0, 0.5, 1.0), metal, distribution='GGX'),
        *principled("base", "Roughness", (0.0, 0.2, 0.7, 1.0), metal),
        *principled("base", "Alpha", (0.0, 0.3, 0.7)),
        *principled("base", "Normal", ("bent", "bumped"), rough),
        *principled("anisotropic", "Anisotropic", (0.3, 0.8, 1.0), metal),
        *principled("anisotropic", "Anisotropic Rotation", (0.125, 0.25), metal | {"Anisotropic": 0.8}),
        *principled("anisotropic", "Tangent", ("uv tangent", "x tangent"), metal | {"Anisotropic": 0.8}),
        *principled("anisotropic", "Anisotropic", (0.8,), {"Base Color": (0.05, 0.05, 0.05), "Roughness": 0.3}),
        *principled("anisotropic", "Anisotropic", (0.8,), metal | {"Roughness": 0.15}),
        *principled("glass", "Transmission Weight", (0.5, 1.0), {"Base Color": GOLD, "Roughness": 0.1}),
        *principled("glass", "Roughness", (0.0, 0.3, 0.6, 1.0), glass),
        *principled("glass", "IOR", (1.0, 1.1, 2.4, 0.7), glass),
        *principled("glass", "Specular Tint", ((1.0, 0.3, 0.1),), glass),
        *principled("glass", "Thin Wall", (True,), glass),
        *principled("glass", "Roughness", (0.0, 0.5), thin),
        *principled("glass", "Base Color", (GOLD,), thin),
        *principled("glass", "Subsurface Weight", (1.0,), {"Thin Wall": True}),
        *principled("glass", "Subsurface Anisotropy", (-0.5, 0.7), {"Thin Wall": True, "Subsurface Weight": 1.0}),
        *principled("coat", "Coat Weight", (0.3, 1.0), coat),
        *principled("coat", "Coat Roughness", (0.0, 0.3, 1.0), coat),
        *principled("coat", "Coat IOR", (1.0, 1.2, 2.5), coat),
        *principled("coat", "Coat Tint", ((1.0, 0.4, 0.1),), coat),
        *principled("coat", "Coat Tint", ((1.0, 0.4, 0.1),), coat | metal),
        *principled("coat", "Coat Normal", ("bent", "bumped"), coat),
        *principled("coat", "Emission Strength", (0.5,), coat | {"Emission Color": (0.2, 0.9, 0.3)}),
        *principled("coat", "Transmission Weight", (1.0,), coat | {"Roughness": 0.2}),
        *principled("sheen", "Sheen Weight", (0.3, 1.0), sheen),
        *principled("sheen", "Sheen Roughness", (0.0, 0.1, 0.3, 0.7, 1.0), sheen),
        *principled("sheen", "Sheen Tint", ((0.2, 0.4, 1.0), (0.0, 0.0, 0.0)), sheen),
        *principled("sheen", "Sheen Weight", (1.0,), sheen | metal),
        *principled("emission", "Emission Strength", (0.0, 0.3, 2.0), {"Emission Color": (0.2, 0.9, 0.3)}),
        *principled("emission", "Emission Color", ((1.0, 0.1, 0.0), (0.0, 0.0, 0.0)), {"Emission Strength": 1.0}),
        *principled("emission", "Alpha", (0.3,), {"Emission Strength": 1.0, "Emission Color": (0.2, 0.9, 0.3)}),
        *principled("subsurface", "Subsurface Weight", (0.3, 1.0), skin),
        *principled("subsurface", "Subsurface Scale", (0.0, 0.05, 1.0), skin),
        *principled("subsurface", "Subsurface Radius", ((0.1, 0.1, 0.1), (1.0, 0.0, 0.0)), skin),
        *principled("subsurface", "Subsurface Anisotropy", (0.5, 0.9), skin),
        *principled("subsurface", "Subsurface IOR", (1.1, 1.8), skin, subsurface_method='RANDOM_WALK_SKIN'),
        *principled("subsurface", "Subsurface Weight", (1.0,), skin, subsurface_method='BURLEY'),
        *principled("film", "Thin Film Thickness", (100.0, 400.0, 900.0), film),
        *principled("film", "Thin Film IOR", (1.1, 1.8), film),
        *principled("film", "Thin Film Thickness", (400.0,), metal),
        *principled("film", "Thin Film Thickness", (400.0,), glass),
    ]


def nodes(group: str, node: str, socket: str, values: tuple, base: dict | None = None, **options: Any,
          ) -> list[SocketCase]:
    """Return cases of one socket of another node."""
    name = f"{socket} " if socket else ""
    text = "".join(f" {value}".lower() for value in options.values())
    return [SocketCase(group, f"{name}{named(value)}{text}", node, (base or {}) | ({socket: value} if socket else {}),
                       options) for value in values]


def other_cases() -> list[SocketCase]:
    """Return the cases of all other surface shaders."""
    copper_n, copper_k = (0.20, 0.92, 1.10), (3.91, 2.45, 2.14)
    metal = {"Base Color": GOLD, "Edge Tint": (1.0, 0.8, 0.6)}
    found = [
        *nodes("diffuse", "BsdfDiffuse", "Roughness", (0.0, 0.5, 1.0), {"Color": RED}),
        *nodes("diffuse", "BsdfTranslucent", "Color", (RED,)),
        *nodes("diffuse", "BsdfTranslucent", "Normal", ("bent",), {"Color": RED}),
        *nodes("diffuse", "BsdfTransparent", "Color", ((0.9, 0.5, 0.2),)),
        *nodes("diffuse", "Emission", "Strength", (0.0, 1.0), {"Color": GOLD}),
        *nodes("diffuse", "Holdout", "", (0.0,)),
        *nodes("diffuse", "Background", "Strength", (1.0,)),
        *nodes("diffuse", "BsdfRayPortal", "Color", ((0.9, 0.5, 0.2),)),
        *nodes("toon", "BsdfToon", "Size", (0.0, 0.5, 1.0), {"Color": RED, "Smooth": 0.2}, component='DIFFUSE'),
        *nodes("toon", "BsdfToon", "Smooth", (0.0, 1.0), {"Color": RED, "Size": 0.4}, component='DIFFUSE'),
        *nodes("toon", "BsdfToon", "Size", (0.0, 0.1, 0.5, 1.0), {"Color": RED, "Smooth": 0.2}, component='GLOSSY'),
        *nodes("toon", "BsdfToon", "Smooth", (0.0, 1.0), {"Color": RED, "Size": 0.3}, component='GLOSSY'),
        *nodes("subsurface", "SubsurfaceScattering", "Scale", (0.05, 0.5), {"Color": RED}),
        *nodes("hair", "BsdfHair", "RoughnessU", (0.1, 0.5), {"Color": RED, "RoughnessV": 0.5},
               component='Reflection'),
        *nodes("hair", "BsdfHair", "RoughnessU", (0.1, 0.5), {"Color": RED, "RoughnessV": 0.5},
               component='Transmission'),
        *nodes("hair", "BsdfHairPrincipled", "Color", (RED,), parametrization='COLOR'),
        SocketCase("mix", "mix of diffuse and glossy", "BsdfDiffuse", {"Color": RED}, mix="BsdfAnisotropic"),
        SocketCase("mix", "sum of diffuse and glossy", "BsdfDiffuse", {"Color": RED}, mix="+BsdfAnisotropic"),
        SocketCase("mix", "mix of glass and diffuse", "BsdfGlass", {"Roughness": 0.1}, mix="BsdfDiffuse"),
        SocketCase("mix", "mix of diffuse and transparent", "BsdfDiffuse", {"Color": RED}, mix="BsdfTransparent"),
        SocketCase("mix", "sum of diffuse and emission", "BsdfDiffuse", {"Color": RED}, mix="+Emission"),
        SocketCase("mix", "mix of diffuse and holdout", "BsdfDiffuse", {"Color": RED}, mix="Holdout"),
        SocketCase("mix", "sum of translucent and diffuse", "BsdfTranslucent", {"Color": RED}, mix="+BsdfDiffuse"),
    ]
    for shape in ('MULTI_GGX', 'GGX', 'BECKMANN', 'ASHIKHMIN_SHIRLEY'):
        found += nodes("glossy", "BsdfAnisotropic", "Roughness", (0.05, 0.3, 0.8), {"Color": GOLD}, distribution=shape)
        found += nodes("glossy", "BsdfAnisotropic", "Anisotropy", (-0.7, 0.7), {"Color": GOLD, "Roughness": 0.3},
                       distribution=shape)
    for shape in ('MULTI_GGX', 'GGX', 'BECKMANN'):
        found += nodes("metallic", "BsdfMetallic", "Roughness", (0.0, 0.4, 0.9), metal, fresnel_type='F82',
                       distribution=shape)
        found += nodes("panes", "BsdfGlass", "Roughness", (0.0, 0.2, 0.7), distribution=shape)
    found += nodes("metallic", "BsdfMetallic", "Roughness", (0.1, 0.5), {"IOR": copper_n, "Extinction": copper_k},
                   fresnel_type='PHYSICAL_CONDUCTOR')
    found += nodes("metallic", "BsdfMetallic", "IOR", ((0.5, 1.0, 2.0),), {"Extinction": (1.0, 0.5, 0.2)},
                   fresnel_type='PHYSICAL_CONDUCTOR')
    for shape in ('GGX', 'BECKMANN'):
        found += nodes("panes", "BsdfRefraction", "Roughness", (0.0, 0.2, 0.7), {"IOR": 1.45}, distribution=shape)
    found += nodes("panes", "BsdfGlass", "IOR", (1.0, 2.4), {"Color": (0.9, 0.95, 1.0)})
    found += nodes("panes", "BsdfGlass", "Color", (GOLD,))
    for shape in ('MICROFIBER', 'ASHIKHMIN'):
        found += nodes("sheens", "BsdfSheen", "Roughness", (0.0, 0.1, 0.3, 0.5, 0.8, 1.0), {"Color": GOLD},
                       distribution=shape)
    return found


def all_cases() -> list[SocketCase]:
    """Return all cases."""
    return principled_cases() + other_cases()
