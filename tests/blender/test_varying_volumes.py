# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes that vary in space against Cycles: noise, fire, grids of OpenVDB files and of geometry nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow

CODE = r'''
import types
from burnish.addon.extract.volume_object import openvdb, read_domain

SIDE = 32

def shader(tree, kind, inputs):
    node = tree.nodes.new("ShaderNode" + kind)
    for name, value in inputs.items():
        if hasattr(value, "is_output"):
            tree.links.new(value, node.inputs[name])
        else:
            node.inputs[name].default_value = value
    return node

def filling():
    material = bpy.data.materials.new("filling")
    material.node_tree.nodes.clear()
    return material, material.node_tree

def finish_material(tree, node, surface=None):
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(node.outputs[0], output.inputs["Volume"])
    if surface:
        glass = shader(tree, surface, {"Roughness": 0.0, "IOR": 1.2})
        tree.links.new(glass.outputs[0], output.inputs["Surface"])

def noise(tree, density):
    place = tree.nodes.new("ShaderNodeTexCoord").outputs["Object"]
    texture = shader(tree, "TexNoise", {"Vector": place, "Scale": 2.0, "Detail": 3.0})
    return shader(tree, "MapRange", {"Value": texture.outputs[0], "From Min": 0.45, "From Max": 0.6,
                                     "To Max": density}).outputs[0]

def write_grids(path):
    vdb = openvdb()
    place = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, SIDE)] * 3, indexing="ij"), -1)
    away = np.linalg.norm(place, axis=-1)
    waves = 0.5 + 0.5 * np.sin(6.0 * place[..., 0]) * np.cos(4.0 * place[..., 2])
    values = {"density": np.clip(3.0 - 3.0 * away, 0.0, 1.0) * waves,
              "temperature": np.clip(2.0 - 2.0 * away, 0.0, 2.0),
              "color": np.clip(0.5 + 0.5 * place, 0.0, 1.0)}
    grids = []
    for name, value in values.items():
        grid = vdb.Vec3SGrid() if name == "color" else vdb.FloatGrid()
        grid.copyFromArray(value.astype(np.float32), ijk=(-16, -16, -5))
        grid.name, grid.transform = name, vdb.createLinearTransform(voxelSize=2.0 / SIDE)
        grids.append(grid)
    vdb.write(path, grids=grids)

def add_volume(scene, material, scale):
    data = bpy.data.volumes.new("volume")
    data.filepath = f"{FOLDER}/grids.vdb"
    made = bpy.data.objects.new("volume", data)
    data.materials.append(material)
    made.location, made.rotation_euler, made.scale = (0.0, 0.0, -0.7), (0.2, 0.3, 0.4), scale
    scene.collection.objects.link(made)

def build(kind):
    scene = new_scene()
    scene.world = bpy.data.worlds.new("World")
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.3, 0.3, 0.3, 1.0)
    look_down(scene, (0.0, 0.0, 20.0), 3.5)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    # Seen through glass it makes sparks.
    sun.data.energy, sun.rotation_euler = 0.0 if kind == "glass" else 3.0, (0.6, -0.7, 0.0)
    scene.collection.objects.link(sun)
    scene.cycles.sample_clamp_indirect, scene.cycles.blur_glossy = 0.0, 0.0
    for name in ("max", "diffuse", "transmission", "transparent_max", "volume"):
        setattr(scene.cycles, f"{name}_bounces", 64)
    material, tree = filling()
    if kind in ("cloud", "forward", "glass"):
        density, anisotropy = {"cloud": (5.0, 0.0), "forward": (20.0, 0.6), "glass": (3.0, 0.0)}[kind]
        finish_material(tree, shader(tree, "VolumePrincipled", {
            "Color": (0.9, 0.7, 0.5, 1.0), "Density": noise(tree, density), "Anisotropy": anisotropy}),
            "BsdfGlass" if kind == "glass" else None)
    elif kind == "absorbing":
        place = tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"]
        colors = shader(tree, "TexVoronoi", {"Vector": place, "Scale": 3.0})
        finish_material(tree, shader(tree, "VolumeAbsorption", {"Color": colors.outputs["Color"], "Density": 1.5}))
    elif kind == "fire":
        place = tree.nodes.new("ShaderNodeTexCoord").outputs["Object"]
        ball = shader(tree, "TexGradient", {"Vector": place})
        ball.gradient_type = 'SPHERICAL'
        heat = shader(tree, "MapRange", {"Value": ball.outputs["Fac"], "To Max": 2200.0})
        finish_material(tree, shader(tree, "VolumePrincipled", {
            "Density": noise(tree, 1.0), "Blackbody Intensity": 1.0, "Temperature": heat.outputs[0]}))
    elif kind == "nodes":
        grid = tree.nodes.new("ShaderNodeAttribute")
        grid.attribute_name = "density"
        density = shader(tree, "MapRange", {"Value": grid.outputs["Fac"], "From Min": 0.2, "To Max": 8.0})
        place = tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"]
        finish_material(tree, shader(tree, "VolumeScatter", {"Color": place, "Density": density.outputs[0]}))
    else:
        node = shader(tree, "VolumePrincipled", {"Color": (0.9, 0.6, 0.4, 1.0), "Density": 5.0})
        if kind == "flames":
            node.inputs["Blackbody Intensity"].default_value, node.inputs["Temperature"].default_value = 1.0, 900.0
            node.inputs["Color Attribute"].default_value = "color"
        finish_material(tree, node)
    if kind in ("nodes", "grids", "flames", "scaled"):
        add_volume(scene, material, (1.5, 1.0, 0.8) if kind == "scaled" else (1.0, 1.0, 1.0))
        return scene
    bpy.ops.mesh.primitive_cube_add(rotation=(0.2, 0.3, 0.4))
    made = bpy.context.object
    made.data.materials.append(material)
    if kind == "geometry nodes":
        group = bpy.data.node_groups.new("group", 'GeometryNodeTree')
        made.modifiers.new("group", 'NODES').node_group = group
        group.interface.new_socket("Geometry", in_out='OUTPUT', socket_type='NodeSocketGeometry')
        cube, painted = group.nodes.new("GeometryNodeVolumeCube"), group.nodes.new("GeometryNodeSetMaterial")
        painted.inputs["Material"].default_value = material
        group.links.new(cube.outputs[0], painted.inputs[0])
        group.links.new(painted.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    return scene

class Values(list):
    """As RNA has arrays of floats."""

    def foreach_get(self, out):
        out[:] = self

def domain():
    """Return the lattice and some values of a domain of 2 x 3 x 4 cells, all but heat twice as fine."""
    count = 4 * 6 * 8
    settings = types.SimpleNamespace(
        domain_resolution=(2, 3, 4), use_noise=True, noise_scale=2, density_grid=Values(range(count)),
        color_grid=Values([0.2, 0.1, 0.4, 0.5] * count), flame_grid=Values(), temperature_grid=Values(),
        heat_grid=Values(range(24)))
    mesh = types.SimpleNamespace(texspace_location=(1.0, 0.0, 0.0), texspace_size=(2.0, 3.0, 4.0))
    volume, _ = read_domain(settings, mesh)
    return {"first": (volume.to_object @ (0.5, 0.5, 0.5, 1.0))[:3].tolist(), "names": sorted(volume.grids),
            "density": float(volume.grids["density"][1, 2, 3, 0]), "heat": float(volume.grids["heat"][7, 5, 3, 0]),
            "color": volume.grids["color"][0, 0, 0, :3].tolist(), "cells": volume.cells}

write_grids(f"{FOLDER}/grids.vdb")
results = {"domain": domain()}
for kind in sys.argv[3].split(","):
    scene = build(kind)
    mine, said = picture(scene, 'BURNISH', (24, 24), 128)
    theirs, _ = picture(scene, 'CYCLES', (24, 24), 128)
    means = [pixels[..., :3].mean((0, 1), dtype=np.float64).tolist() for pixels in (mine, theirs)]
    results[kind] = *means, said, float(mine.std())
finish(results)
'''

KINDS = ("cloud", "forward", "glass", "absorbing", "fire", "nodes", "grids", "flames", "scaled", "geometry nodes")


@pytest.fixture(scope="module")
def found(run_pictures: Callable[..., Any]) -> dict[str, list]:
    """Return, by kind, the means of Burnish and of Cycles, what is reported, and how much Burnish's picture varies."""
    return run_pictures(CODE, ",".join(KINDS))


@pytest.mark.parametrize("kind", KINDS)
def test_volumes_that_vary_are_those_of_cycles(found: dict[str, list], kind: str) -> None:
    """Match each channel's mean, with nothing to report; something is seen."""
    mine, cycles, said, spread = found[kind]
    np.testing.assert_allclose(mine, cycles, rtol=0.01)
    assert not "".join(said) and spread > 0.01


def test_smoke_domains_have_their_cells_over_the_texture_space(found: dict[str, Any]) -> None:
    """Read x first; divide colours by how much smoke there is; spread what has fewer cells over the others."""
    domain = found["domain"]
    assert domain["first"] == pytest.approx([-0.5, -2.5, -3.5]) and domain["cells"] == [4, 6, 8]
    assert domain["names"] == ["color", "density", "heat"]
    assert domain["density"] == 3 + 4 * (2 + 6 * 1) and domain["heat"] == 23.0
    assert domain["color"] == pytest.approx([0.4, 0.2, 0.8])
