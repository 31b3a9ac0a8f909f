# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole materials, worlds and lamps for test_material.py: what a child process finds out about each."""

from __future__ import annotations

import bpy
import numpy as np
from burnish.engine.materials import default_material
from burnish.engine.report import Report
from node_graphs import TOLERANCE, Graph, components, make_image, node_graph, vector
from node_scenes import Harness, extract_light_shader, extract_material, new_material


def world_of(graph: Graph, strength: float = 1.5) -> bpy.types.World:
    """Return a world whose background shows a colour socket, or that shows a shader."""
    world = bpy.data.worlds.new("World")
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputWorld")
    socket = graph(nodes, links)
    if socket is not None and socket.type != 'SHADER':
        background = nodes.new("ShaderNodeBackground")
        background.inputs["Strength"].default_value = strength
        links.new(socket, background.inputs["Color"])
        socket = background.outputs[0]
    if socket is not None:
        links.new(socket, output.inputs["Surface"])
    return world


def compare_worlds(harness: Harness) -> dict[str, dict]:
    """Return errors and facts of some worlds."""
    panorama = make_image("panorama", width=32, height=16)
    turned = node_graph("Mapping", values={"Rotation": (0.1, 0.2, 0.7)}, links_to={
        "Vector": node_graph("TexCoord", "Generated")})

    def by_ray(nodes, links):
        mix = nodes.new("ShaderNodeMixShader")
        shown = node_graph("Background", links_to={"Color": node_graph("TexEnvironment", image=panorama)})
        links.new(node_graph("LightPath", "Is Camera Ray")(nodes, links), mix.inputs[0])
        links.new(node_graph("Background")(nodes, links), mix.inputs[1])
        links.new(shown(nodes, links), mix.inputs[2])
        return mix.outputs[0]

    graphs = {
        "direction": node_graph("TexCoord", "Generated"), "normal": node_graph("TexCoord", "Normal"),
        "incoming": node_graph("NewGeometry", "Incoming"), "depth": node_graph("LightPath", "Ray Depth"),
        "panorama": node_graph("TexEnvironment", image=panorama, links_to={"Vector": turned}),
        "by kind of ray": by_ray, "nothing": lambda nodes, links: None,
        "plain color": node_graph("Gamma", values={"Color": (0.1, 0.2, 0.3, 1.0)}),
    }
    results = {}
    for name, graph in graphs.items():
        expected, found, data = harness.world(world_of(graph))
        error = np.abs(expected - found).max(1)
        results[name] = {"outliers": int((error > TOLERANCE).sum()), "constant": data.constant,
                         "resolution": data.importance_resolution}
    return results


def principled_closure(harness: Harness) -> dict:
    """Return the closure of a Principled BSDF with every socket set, and whether this Blender has thin walls."""
    thin_walls = bpy.app.version >= (5, 2, 0)
    values = {
        "Base Color": (0.1, 0.2, 0.3, 1.0), "Metallic": 0.11, "Roughness": 0.12, "IOR": 1.3, "Alpha": 0.7,
        "Diffuse Roughness": 0.14, "Specular IOR Level": 0.15, "Anisotropic": 0.16,
        "Anisotropic Rotation": 0.17, "Transmission Weight": 0.18, "Coat Weight": 0.19, "Coat Roughness": 0.21,
        "Coat IOR": 1.22, "Sheen Weight": 0.23, "Sheen Roughness": 0.24, "Subsurface Weight": 0.25,
        "Subsurface Radius": (1.0, 2.0, 3.0), "Subsurface Scale": 0.26, "Subsurface IOR": 1.27,
        "Subsurface Anisotropy": 0.28,
        "Thin Film Thickness": 260.0, "Thin Film IOR": 1.27,
        "Emission Color": (1.0, 2.0, 3.0, 1.0), "Emission Strength": 2.0, **({"Thin Wall": True} if thin_walls else {}),
    }
    result = harness.machine(new_material(node_graph(
        "BsdfPrincipled", values=values, distribution='GGX', subsurface_method='RANDOM_WALK_SKIN')))
    closure = result["closures"][0]
    found = {name: closure[name].tolist() for name in closure.dtype.names}
    found["nee_emission"] = result["emission"][0].tolist()
    found["thin_walls"] = thin_walls
    return found


def scattering_closures(harness: Harness) -> dict[str, dict]:
    """Return what each method of the Subsurface Scattering node, and of a Principled BSDF without radius, comes to."""
    graphs = {method: node_graph("SubsurfaceScattering", falloff=method, values={
        "Color": (0.1, 0.2, 0.3, 1.0), "Scale": 0.5, "Radius": (1.0, 2.0, 3.0), "IOR": 1.3, "Roughness": 0.16,
        "Anisotropy": 0.4}) for method in ('BURLEY', 'RANDOM_WALK', 'RANDOM_WALK_SKIN')}
    graphs["none"] = node_graph("BsdfPrincipled", values={"Subsurface Weight": 1.0, "Subsurface Scale": 0.0})
    found = {}
    for name, graph in graphs.items():
        closure = harness.machine(new_material(graph))["closures"][0]
        found[name] = {field: closure[field].tolist() for field in closure.dtype.names}
    found["legacy"] = bpy.app.version < (5, 2, 0)
    return found


def default_closures(harness: Harness) -> list[list[float]]:
    """Return the closures of a new material and of slots without one as rows of numbers."""
    material = bpy.data.materials.new("New")
    material.use_nodes = True
    closures = [harness.machine(material)["closures"][0], harness.run(default_material())["closures"][0]]
    return [np.hstack([closure[name].ravel() for name in closure.dtype.names]).tolist() for closure in closures]


def mixed(first: Graph, second: Graph, kind: str = "MixShader", factor: float = 0.5) -> Graph:
    """Return a graph that mixes or adds two shaders."""

    def graph(nodes, links):
        node = nodes.new("ShaderNode" + kind)
        if kind == "MixShader":
            node.inputs[0].default_value = factor
        for graph_part, socket in zip((first, second), node.inputs[-2:], strict=True):
            links.new(graph_part(nodes, links), socket)
        return node.outputs[0]

    return graph


def grouped(nodes, links):
    """Return an emission inside a node group, its strength passed in."""
    tree = bpy.data.node_groups.new("Group", 'ShaderNodeTree')
    tree.interface.new_socket("Strength", in_out='INPUT', socket_type='NodeSocketFloat')
    tree.interface.new_socket("Shader", in_out='OUTPUT', socket_type='NodeSocketShader')
    emission, entry, leave = (tree.nodes.new(name) for name in (
        "ShaderNodeEmission", "NodeGroupInput", "NodeGroupOutput"))
    tree.links.new(entry.outputs[0], emission.inputs["Strength"])
    tree.links.new(emission.outputs[0], leave.inputs[0])
    group = nodes.new("ShaderNodeGroup")
    group.node_tree = tree
    group.inputs[0].default_value = 3.0
    return group.outputs[0]


def material_flags(harness: Harness) -> dict[str, tuple]:
    """Return (transparency, emission, constant emission) by graph."""
    emission = node_graph("Emission")
    transparent, diffuse = node_graph("BsdfTransparent"), node_graph("BsdfDiffuse")

    def muted(nodes, links):
        socket = mixed(diffuse, emission)(nodes, links)
        socket.node.mute = True
        return socket

    graphs = {
        "principled": node_graph("BsdfPrincipled"),
        "alpha": node_graph("BsdfPrincipled", values={"Alpha": 0.9}),
        "alpha_linked": node_graph("BsdfPrincipled", links_to={"Alpha": lambda n, t: components(n, t)[0]}),
        "emission": node_graph("Emission", values={"Color": (1.0, 2.0, 3.0, 1.0), "Strength": 2.0}),
        "background": node_graph("Background", values={"Color": (1.0, 2.0, 3.0, 1.0), "Strength": 0.5}),
        "emission_textured": node_graph("Emission", links_to={"Color": vector}),
        "mix_with_factor_0": mixed(diffuse, mixed(emission, transparent), factor=0.0),
        "mix_half": mixed(transparent, emission),
        "add": mixed(transparent, emission, "AddShader"),
        "no_surface": lambda nodes, links: None,
        "muted": muted,
        "group": grouped,
    }
    results = {}
    for name, graph in graphs.items():
        data = extract_material(new_material(graph, name), harness.images, harness.report)
        results[name] = (data.has_transparency, data.has_emission, data.constant_emission)
    return results


def report_of_everything(harness: Harness) -> str:
    """Return the report of a material that links every node type there is to a shader."""
    material = new_material(node_graph("BsdfPrincipled", values={
        "Subsurface Weight": 0.5, "Thin Film Thickness": 100.0}, subsurface_method='BURLEY'), "Everything")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    output = next(node for node in nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    total = output.inputs["Surface"].links[0].from_socket
    for name in sorted(name for name in dir(bpy.types) if name.startswith("ShaderNode")):
        try:
            node = nodes.new(name)
        except RuntimeError:
            continue
        for socket in (socket for socket in node.outputs if socket.enabled and socket.type != 'CUSTOM'):
            if socket.type != 'SHADER':
                emission = nodes.new("ShaderNodeEmission")
                links.new(socket, emission.inputs["Color"])
                socket = emission.outputs[0]
            elif "Volume" in name:
                links.new(socket, output.inputs["Volume"])
                continue
            add = nodes.new("ShaderNodeAddShader")
            links.new(total, add.inputs[0])
            links.new(socket, add.inputs[1])
            total = add.outputs[0]
    links.new(total, output.inputs["Surface"])
    report = Report()
    extract_material(material, harness.images, report)
    return report.text()


def lamp_shaders(harness: Harness) -> list:
    """Return factor and whether there is a program of a lamp with four node trees, and the report."""
    report = Report()
    light = bpy.data.lights.new("Lamp", 'POINT')
    light.use_nodes = True
    nodes, links = light.node_tree.nodes, light.node_tree.links
    emission = next(node for node in nodes if node.bl_idname == "ShaderNodeEmission")
    found = []

    def note():
        factor, program = extract_light_shader(light, harness.images, report)
        found.append([list(factor), program is not None])

    note()
    emission.inputs["Color"].default_value = (2.0, 1.0, 0.5, 1.0)
    emission.inputs["Strength"].default_value = 3.0
    note()
    falloff = node_graph("LightFalloff", "Linear", values={"Strength": 5.0})(nodes, links)
    links.new(falloff, emission.inputs["Strength"])
    note()
    links.new(node_graph("TexImage", image=make_image("gobo"))(nodes, links), emission.inputs["Color"])
    note()
    profile = nodes.new("ShaderNodeTexIES")
    profile.ies = bpy.data.texts.new("no profile")
    links.new(profile.outputs[0], emission.inputs["Strength"])
    note()
    return [*found, report.text()]


def oversized_material(harness: Harness) -> list:
    """Return (closure kind, colour, report) of a material that keeps too many values alive."""

    def graph(nodes, links):
        chain = [components(nodes, links)[0]]
        for _ in range(60):
            node = nodes.new("ShaderNodeMath")
            node.operation = 'SINE'
            links.new(chain[-1], node.inputs[0])
            chain.append(node.outputs[0])
        total = chain[-1]
        for socket in reversed(chain):
            node = nodes.new("ShaderNodeMath")
            node.operation = 'SUBTRACT'
            links.new(total, node.inputs[0])
            links.new(socket, node.inputs[1])
            total = node.outputs[0]
        return total

    material = new_material(graph)
    material.diffuse_color = (0.2, 0.3, 0.4, 1.0)
    harness.report = Report()
    closure = harness.machine(material)["closures"][0]
    return [int(closure["kind"]), closure["color"].tolist(), harness.report.text()]
