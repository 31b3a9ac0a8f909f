# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky Textures in worlds and materials for test_sky.py: what Cycles draws, and what is made of them. Child process."""

from __future__ import annotations

import math
from collections.abc import Callable

import bpy
import numpy as np
from burnish.engine.scene import Visibility
from burnish.engine.sky.image import SkyKind
from burnish.kernels import node_codes
from material_graphs import world_of
from mathutils import Euler, Vector
from node_graphs import node_graph, vector
from node_scenes import SIZE, Harness, extract_world, new_material

__all__ = ["compare_material", "compare_skies", "find_suns", "light_of_suns"]

IN_VIEW = {"sun_rotation": 0.5 * math.pi - 1.3744, "sun_elevation": 0.4909, "sun_size": 0.3}
"""A large sun over one of the 16 x 16 pixels of a panorama"""

TURN = Euler((0.1, 0.2, 0.7))


def sky(**properties) -> Callable:
    """Return the graph of a Sky Texture."""
    return node_graph("TexSky", **properties)


def turned(**properties) -> Callable:
    """Return a sky that a Mapping node turns about all axes."""
    mapping = node_graph("Mapping", values={"Rotation": TURN}, links_to={
        "Vector": node_graph("TexCoord", "Generated")})
    return node_graph("TexSky", links_to={"Vector": mapping}, **properties)


def turned_sun(nodes, links):
    """Return a sky with its sun, whose vector Blender doesn't let be linked, turned by the node's own mapping."""
    socket = sky()(nodes, links)
    socket.node.texture_mapping.rotation = TURN
    return socket


def compare_skies(harness: Harness) -> dict[str, float]:
    """Return the largest error over the radiance of a pixel, and how bright Cycles' brightest pixel is, by world."""
    scatterings = (str(SkyKind.SINGLE_SCATTERING), str(SkyKind.MULTIPLE_SCATTERING))
    worlds = {
        **{f"{kind} default": sky(sky_type=str(kind)) for kind in SkyKind},
        **{f"{kind} sun": sky(sky_type=kind, sun_intensity=0.5, **IN_VIEW) for kind in scatterings},
        **{f"{kind} turned": turned(sky_type=kind, sun_disc=False, **IN_VIEW) for kind in scatterings},
        **{f"{kind} low": sky(sky_type=kind, sun_elevation=0.02, sun_rotation=4.0) for kind in scatterings},
        **{f"{kind} past the zenith": sky(sky_type=kind, sun_elevation=2.5, sun_disc=False) for kind in scatterings},
        **{f"{kind} high and thin": sky(sky_type=kind, altitude=9000.0, air_density=0.4, ozone_density=6.0)
           for kind in scatterings},
        **{f"{kind} dusty": sky(sky_type=kind, aerosol_density=7.0, sun_rotation=2.0) for kind in scatterings},
        **{f"{kind} hazy": sky(sky_type=kind, turbidity=6.3, ground_albedo=0.8, sun_direction=(0.8, -0.5, 0.2))
           for kind in ('PREETHAM', 'HOSEK_WILKIE')},
    }
    results = {}
    for name, graph in worlds.items():
        expected, found, _ = harness.world(world_of(graph))
        error = np.abs(expected - found) / np.maximum(expected, 0.01 * np.median(expected))
        results[name] = float(error.max()), float(expected.max())
    return results


def compare_material(harness: Harness) -> float:
    """Return the largest relative error of a sky on a surface, whose vectors are of any length."""
    material = new_material(node_graph("TexSky", links_to={"Vector": vector}, sun_rotation=2.5, sun_disc=False))
    harness.plane.data.materials.append(material)
    expected = harness.cycles()[:, :3]
    found = harness.machine(material)["emission"]
    return float((np.abs(expected - found) / np.maximum(expected, 1e-2)).max())


def mixed_by_ray(nodes, links):
    """Return a world that shows its sky to all rays but the camera's."""
    mix = nodes.new("ShaderNodeMixShader")
    links.new(node_graph("LightPath", "Is Camera Ray")(nodes, links), mix.inputs[0])
    links.new(node_graph("Background", links_to={"Color": sky()})(nodes, links), mix.inputs[1])
    links.new(node_graph("Background")(nodes, links), mix.inputs[2])
    return mix.outputs[0]


def dimmed(nodes, links):
    """Return a sky made dark and grey, on its way through two nodes."""
    gray = node_graph("HueSaturation", links_to={"Color": sky()}, values={"Saturation": 0.0, "Value": 0.5})
    return node_graph("Background", links_to={"Color": gray}, values={"Strength": 0.25})(nodes, links)


def fading(nodes, links):
    """Return a sky multiplied by what varies over it."""
    return node_graph("MixRGB", links_to={"Color1": sky(), "Color2": node_graph("TexCoord", "Generated")},
                      values={"Fac": 1.0}, blend_type='MULTIPLY')(nodes, links)


def find_suns(harness: Harness) -> dict[str, dict]:
    """Return the lamp of each world's sun, and whether the world's program shows the disc to the camera alone."""
    worlds = {
        "plain": sky(), "turned": turned_sun, "off": sky(sun_disc=False), "none": sky(sky_type='PREETHAM'),
        "by ray": mixed_by_ray, "dimmed": dimmed, "fading": fading, "huge": sky(sun_size=0.5),
        "strong": sky(sun_intensity=3.0), "set": sky(sun_elevation=-0.1),
    }
    results = {}
    for name, graph in worlds.items():
        world = world_of(graph)
        world.cycles_visibility.glossy = name != "strong"
        data = extract_world(world, harness.images, harness.report)
        lamp = data.sun and {
            "color": data.sun.color, "angle": data.sun.angle, "towards": data.sun.transform[:3, 2].tolist(),
            "visibility": data.sun.visibility}
        masks = [word[2] for word in data.program.surface if word[0] & 255 == node_codes.OP_INPUT]
        if name == "turned":
            lamp["expected"] = list(TURN.to_matrix().transposed() @ Vector(results["plain"]["lamp"]["towards"]))
        results[name] = {"lamp": lamp, "width": data.importance_resolution,
                         "camera": sum(mask == Visibility.CAMERA for mask in masks)}
    return results


def light_of_suns(harness: Harness) -> dict[str, list]:
    """Return what Cycles and the path tracer draw of a white plane that faces the sun, by who shows the sun."""
    import burnish
    from burnish.addon import final

    burnish.register()
    scene = bpy.context.scene
    harness.plane.data.materials.append(new_material(
        node_graph("BsdfDiffuse", values={"Color": (0.8, 0.8, 0.8, 1.0)})))
    scene.cycles.max_bounces = 1
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.burnish.device, scene.burnish.sampling.integrator = 'CPU', 'REFERENCE'
    found = []
    final.on_finished.append(lambda layer, view, pixels, information: found.append(pixels["Combined"]))
    results = {}
    for name, graph in {"lamp": sky(sun_elevation=1.0), "picture": sky(sun_elevation=1.0, sun_size=0.15)}.items():
        scene.world = world_of(graph)
        scene.render.engine = 'CYCLES'
        expected = harness.cycles(samples=256).reshape(SIZE, SIZE, 4)[4:-4, 4:-4, :3].mean((0, 1))
        scene.render.engine = 'BURNISH'
        scene.burnish.sampling.samples = 256
        bpy.ops.render.render()
        results[name] = [expected.tolist(), found[-1][4:-4, 4:-4, :3].mean((0, 1)).tolist()]
    return results
