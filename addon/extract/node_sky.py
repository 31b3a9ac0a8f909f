# SPDX-License-Identifier: GPL-3.0-or-later
"""Translates Sky Texture nodes: the sky becomes a picture (engine/sky), the sun a disc in it or a lamp.

Where a world shows the sun of one sky, whatever lies between the node and the output, a lamp shines for it, which is
sampled best, and the world shows its disc to the camera alone. Else the disc belongs to the picture for all rays, like
the sun of an HDRI.
"""

from __future__ import annotations

import math
from collections.abc import Hashable

import numpy as np

from ...engine.program import RegisterOverflow, Value
from ...engine.program_probe import SkyProbe
from ...engine.report import Report
from ...engine.scene import LightData, LightKind, Visibility
from ...engine.sky.disc import SunDisc
from ...engine.sky.image import TO_REC709, SkyKind, SkySettings, disc_of, sky_at_sun, sky_pixels
from .node_graph import Graph, translates
from .node_shaders import add_shader
from .node_textures import coordinate

__all__ = ["world_sun"]

FLAT, CLIP, EXTEND = "FLAT", 2, 1

LEAST_TABLE = 512
"""Width of the sampling table of a world with a sky: its glow about the sun is some degrees wide"""

TEXELS_OF_SUN = 3
"""Texels of the sampling table over the diameter of a sun that is part of the world's picture"""

LARGEST_LAMP = math.radians(5.0)
"""Larger suns show their colours' change from top to bottom in what they light, which a lamp does not have"""

LAMP_RAYS = (Visibility.DIFFUSE, Visibility.GLOSSY, Visibility.TRANSMISSION)
"""Kinds of rays for which the world must show one and the same sun for a lamp to stand for it"""


def to_working_space(graph: Graph) -> tuple[tuple[float, ...], ...]:
    """Return the matrix from CIE XYZ to the file's working space."""
    matrix = np.asarray(TO_REC709)
    if graph.from_rec709 is not None:
        matrix = np.asarray(graph.from_rec709) @ matrix
    return tuple(tuple(float(x) for x in row) for row in matrix)


def sun_place(node) -> tuple[float, float]:
    """Return elevation within a quarter turn, and azimuth from +x to +y [rad] of a sky's sun."""
    if node.sky_type in ('PREETHAM', 'HOSEK_WILKIE'):
        x, y, z = node.sun_direction.normalized()
        return math.asin(min(max(z, -1.0), 1.0)), math.atan2(y, x)
    # Beyond the zenith the sun goes down on the other side.
    x, z = math.cos(node.sun_elevation), math.sin(node.sun_elevation)
    return math.asin(z), 0.5 * math.pi - node.sun_rotation + (math.pi if x < 0.0 else 0.0)


def settings_of(node) -> tuple[SkySettings, float]:
    """Return what a Sky Texture shows, and the azimuth [rad] of its sun."""
    elevation, azimuth = sun_place(node)
    # Named dust in older versions.
    aerosols = getattr(node, "aerosol_density", None)
    if node.sky_type in ('PREETHAM', 'HOSEK_WILKIE'):
        settings = SkySettings(SkyKind(node.sky_type), elevation, turbidity=node.turbidity, albedo=node.ground_albedo)
    else:
        settings = SkySettings(
            SkyKind(node.sky_type), elevation, altitude=node.altitude, air=node.air_density,
            aerosols=getattr(node, "dust_density", 1.0) if aerosols is None else aerosols, ozone=node.ozone_density)
    return settings, azimuth


def disc_of_node(node, settings: SkySettings, matrix: tuple[tuple[float, ...], ...]) -> SunDisc | None:
    """Return a node's sun, None where it shows none."""
    if not settings.has_disc or not node.sun_disc or node.sun_intensity <= 0.0:
        return None
    return disc_of(settings, node.sun_size, matrix)


def sun_axes(elevation: float) -> np.ndarray:
    """Return unit vectors across, up and towards a sun whose azimuth is +x, as rows."""
    return np.array([
        [0.0, 1.0, 0.0], [-math.sin(elevation), 0.0, math.cos(elevation)],
        [math.cos(elevation), 0.0, math.sin(elevation)]])


@translates("ShaderNodeTexSky")
def sky_node(graph: Graph, node, output: str) -> Value:
    """Sky Texture: a picture of directions, and the sun's disc over it."""
    build = graph.builder
    settings, azimuth = settings_of(node)
    matrix = to_working_space(graph)
    place = coordinate(graph, node, "GENERATED")
    if isinstance(build, SkyProbe):
        return build.sky_at(place)
    turned = build.transform(
        [(math.cos(azimuth), math.sin(azimuth), 0.0, 0.0), (-math.sin(azimuth), math.cos(azimuth), 0.0, 0.0),
         (0.0, 0.0, 1.0, 0.0)], place, direction=True)
    pixels, scale = sky_pixels(settings, matrix)
    key = picture(graph, "sky", node, (settings, matrix), pixels)
    graph.widths.append(LEAST_TABLE)
    color = build.vector("MULTIPLY", build.rgb(build.image(key, turned, projection="SKY", extension=EXTEND)), scale)
    disc = disc_of_node(node, settings, matrix)
    if disc is None:
        return color
    return build.vector("ADD", color, disc_value(graph, node, disc, turned, (settings, matrix)))


def picture(graph: Graph, kind: str, node, signature: tuple, pixels: np.ndarray) -> Hashable:
    """Hand over a picture and return its key; a world's keeps its key while it changes."""
    key = (kind, graph.owner, node.name) if graph.world else (kind, signature)
    return graph.images.computed(key, f"{kind} of {graph.owner}", signature, pixels.copy)


def disc_value(graph: Graph, node, disc: SunDisc, direction: Value, signature: tuple) -> Value:
    """Return the sun's radiance in a direction whose azimuth is the sun's along +x."""
    build = graph.builder
    key = picture(graph, "sun", node, (*signature, node.sun_size), disc.pixels)
    scale = 0.5 / disc.extent
    # All three rows are as long: from them follows how wide a part of the picture a ray sees.
    rows = [(*(axis * scale), middle) for axis, middle in zip(sun_axes(disc.elevation), (0.5, 0.5, 0.0), strict=True)]
    across = build.transform(rows, direction if graph.world else build.vector("NORMALIZE", direction))
    radiance = tuple(float(x) for x in disc.peak * node.sun_intensity)
    shown = build.vector("MULTIPLY", build.rgb(build.image(key, across, projection=FLAT, extension=CLIP)), radiance)
    in_front = build.math("GREATER_THAN", build.component(across, 2), 0.0)
    if graph.disc_rays is None:
        graph.widths.append(int(math.ceil(2.0 * math.pi * TEXELS_OF_SUN / max(node.sun_size, 1e-3))))
    else:
        in_front = build.math("MULTIPLY", in_front, build.input("RAY_KIND", graph.disc_rays))
    return build.vector("MULTIPLY", shown, in_front)


# A world's sun as a lamp -------------------------------------------------------------------------------------------


class _NoImages:
    """Image collector of probes, which draw nothing."""

    def key(self, image, image_user=None):
        """Return a key that stands for any image."""
        return 0


def _shown(tree, source, kind: Visibility, sky: np.ndarray, space: tuple | None) -> tuple[np.ndarray, SkyProbe] | None:
    """Return what a world shows to rays of a kind where its sky is a constant, None where it isn't constant then."""
    build = SkyProbe(int(kind), sky)
    graph = Graph(tree, build, _NoImages(), Report(), "", world=True)
    graph.from_rec709 = space
    try:
        add_shader(graph, source, build.constant(1.0))
    except (RegisterOverflow, RecursionError):
        return None
    radiance = build.constant_emission()
    return None if radiance is None else (np.asarray(radiance, np.float64), build)


def world_sun(graph: Graph, source, name: str, visibility: int, light_group: str) -> LightData | None:
    """Return the lamp that shines as the sun of a world's sky; None where the world's program must show the sun.

    Args:
        graph: Of the world, before it is compiled.
        source: The node that is linked to the world's output.
        name: Of the world.
        visibility: Of the world.
        light_group: Of the world.
    """
    nodes = [node for node in graph.tree.nodes if node.bl_idname == "ShaderNodeTexSky"]
    if len(nodes) != 1:
        return None
    node, matrix = nodes[0], to_working_space(graph)
    settings, azimuth = settings_of(node)
    disc = disc_of_node(node, settings, matrix)
    if disc is None or disc.lamp_angle > LARGEST_LAMP:
        return None
    sky = sky_at_sun(settings, matrix)
    area = math.pi * math.sin(0.5 * disc.lamp_angle) ** 2
    both = sky + disc.irradiance / area * node.sun_intensity
    found, turn = [], None
    for kind in LAMP_RAYS:
        without, with_sun = (_shown(graph.tree, source, kind, value, graph.from_rec709) for value in (sky, both))
        if without is None or with_sun is None:
            return None
        if with_sun[1].place is None:
            found.append(np.zeros(3))
            continue
        turn = with_sun[1].turn()
        if turn is None:
            return None
        found.append(np.maximum(with_sun[0] - without[0], 0.0))
    if turn is None or not np.allclose(found, found[0], rtol=1e-4) or not np.isfinite(found).all():
        return None
    towards = sun_axes(disc.lamp_elevation)
    around = np.array([[math.cos(azimuth), -math.sin(azimuth), 0.0], [math.sin(azimuth), math.cos(azimuth), 0.0],
                       [0.0, 0.0, 1.0]])
    transform = np.eye(4)
    # A lamp shines along its -z: its axes are the columns.
    transform[:3, :3] = (turn.T @ around) @ towards.T
    return LightData(
        name=f"sun of {name}", kind=LightKind.SUN, transform=transform,
        color=tuple(float(x) for x in found[0] * area), angle=disc.lamp_angle,
        visibility=visibility & ~int(Visibility.CAMERA), light_group=light_group)
