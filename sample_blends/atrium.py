# SPDX-License-Identifier: GPL-3.0-or-later
"""Atrium: a sunlit colonnade with more than 500 instances, mirrors that show what the camera can't see, leaves."""

from __future__ import annotations

import math

import bpy
import numpy as np
import parts
import textures

COLUMN_X, WALL_X, HEIGHT = 3.3, 6.6, 5.4
COLUMN_YS = [3.0 * i for i in range(9)]
END = 26.0
LEAF_CLUSTERS = 520


def build() -> None:
    """Build the scene into the current file."""
    parts.start_scene(exposure=0.65)
    parts.color_world((0.30, 0.52, 0.95), 0.9)
    stone = parts.material("Limestone", base_color=(0.62, 0.55, 0.45), roughness=0.7, specular_ior_level=0.3)
    add_shell(stone)
    add_columns(stone)
    add_pool()
    add_mirrors()
    add_hidden_objects()
    add_planters()
    parts.lamp("Sun", "SUN", (-8.0, 2.0, 12.0), 6.0, (-0.5, 5.5, 0.0), (1.0, 0.86, 0.68), angle=math.radians(1.2))
    parts.camera((-1.75, -5.2, 1.65), (0.75, 9.0, 2.35), lens=23.0)


def add_shell(stone: bpy.types.Material) -> None:
    """Add floor, side walls, end walls, and roofs over the aisles; the middle is open to the sky."""
    shades = ((0.60, 0.56, 0.50), (0.66, 0.62, 0.56), (0.52, 0.44, 0.37))
    marble = parts.image("Marble tiles", textures.tiles(256, 4, shades, (0.33, 0.30, 0.27), 0.025, seed=5))
    floor = parts.material("Marble", roughness=0.18)
    parts.textured(floor, marble)
    plaster = parts.material("Terracotta plaster", base_color=(0.55, 0.27, 0.16), roughness=0.9, specular_ior_level=0.2)
    length, middle = END + 12.0, (END - 12.0) / 2
    parts.place("Floor", parts.plane("Floor", 2 * WALL_X, length, uv_scale=0.25), (0, middle, 0), material=floor)
    wall = parts.box("Wall", (0.3, length, HEIGHT + 1.0))
    roof = parts.box("Roof", (WALL_X - COLUMN_X + 0.5, length, 0.35))
    for side in (-1, 1):
        parts.place("Wall", wall, (side * (WALL_X + 0.15), middle, HEIGHT / 2 + 0.5), material=plaster)
        parts.place("Roof", roof, (side * (COLUMN_X + WALL_X - 0.5) / 2, middle, HEIGHT + 0.55), material=stone)
    end = parts.box("End wall", (2 * WALL_X, 0.3, HEIGHT + 1.4))
    for y in (END, -12.0):
        parts.place("End wall", end, (0, y, HEIGHT / 2 + 0.7), material=plaster)


def add_columns(stone: bpy.types.Material) -> None:
    """Add a column as a collection and instance it along both sides, under beams."""
    column = bpy.data.collections.new("Column")
    profile = [(0.36, 0.0), (0.36, 0.10), (0.30, 0.16), (0.34, 0.24), (0.27, 0.32)]
    profile += [(0.27 - 0.05 * (t / 10) ** 2, 0.32 + 4.08 * t / 10) for t in range(1, 11)]
    profile += [(0.25, 4.44), (0.22, 4.50), (0.30, 4.72), (0.42, 4.84)]
    parts.place("Shaft", parts.lathe("Shaft", profile, 48), (0, 0, 0.2), material=stone, collection=column)
    parts.place("Base", parts.box("Base", (0.86, 0.86, 0.2)), (0, 0, 0.1), material=stone, collection=column,
                bevel=0.02)
    parts.place("Capital", parts.box("Capital", (0.96, 0.96, 0.2)), (0, 0, 5.12), material=stone, collection=column,
                bevel=0.02)
    for side in (-1, 1):
        for y in COLUMN_YS:
            thing = parts.place(f"Column {side} {y:g}", None, (side * COLUMN_X, y, 0))
            thing.instance_type, thing.instance_collection = "COLLECTION", column
        beam = parts.box("Beam", (0.62, END + 12.0, 0.36))
        parts.place("Beam", beam, (side * COLUMN_X, (END - 12.0) / 2, HEIGHT), material=stone)


def add_pool() -> None:
    """Add a long dark pool, still as glass, with a stone rim."""
    water = parts.material("Still water", base_color=(0.01, 0.045, 0.05), roughness=0.015, ior=1.33)
    rim = parts.material("Wet rim", base_color=(0.30, 0.27, 0.24), roughness=0.22)
    parts.place("Pool", parts.plane("Pool", 2.6, 16.0), (0, 11.5, 0.12), material=water)
    long, short = parts.box("Rim long", (0.3, 16.6, 0.24)), parts.box("Rim short", (2.6, 0.3, 0.24))
    for side in (-1, 1):
        parts.place("Rim", long, (side * 1.45, 11.5, 0.12), material=rim, bevel=0.02)
        parts.place("Rim", short, (0, 11.5 + side * 8.15, 0.12), material=rim, bevel=0.02)


def add_mirrors() -> None:
    """Add a tall mirror on the end wall, which faces the camera, and mirrors on the right wall, which face the left."""
    glass = parts.material("Mirror", base_color=(0.95, 0.95, 0.95), metallic=1.0, roughness=0.0)
    bronze = parts.material("Bronze", base_color=(0.62, 0.42, 0.18), metallic=1.0, roughness=0.3)
    parts.place("End mirror", parts.plane("End mirror", 3.6, 4.2), (0, END - 0.23, 2.4), (90, 0, 0), material=glass)
    parts.place("End frame", parts.box("End frame", (4.0, 0.08, 4.6)), (0, END - 0.18, 2.4), material=bronze)
    side = parts.plane("Side mirror", 1.8, 3.4)
    frame = parts.box("Side frame", (0.08, 2.1, 3.7))
    for y in COLUMN_YS[:-1]:
        parts.place("Side mirror", side, (WALL_X - 0.08, y + 1.5, 2.3), (90, 0, -90), material=glass)
        parts.place("Side frame", frame, (WALL_X - 0.02, y + 1.5, 2.3), material=bronze)


def add_hidden_objects() -> None:
    """Add what only the mirrors show: a glowing ring and coloured spheres behind the camera, banners at the left."""
    glow = parts.material("Neon", base_color=(0, 0, 0), emission_color=(1.0, 0.25, 0.06), emission_strength=9.0)
    parts.place("Neon ring", parts.torus("Neon ring", 1.25, 0.09), (0, -11.4, 2.7), (90, 0, 0), material=glow)
    ball = parts.sphere("Ball", 0.7, 48)
    for i, color in enumerate(((0.75, 0.05, 0.04), (0.85, 0.55, 0.04), (0.04, 0.12, 0.60))):
        enamel = parts.material(f"Enamel {i}", base_color=color, roughness=0.15, coat_weight=0.5)
        parts.place(f"Ball {i}", ball, (-2.4 + 2.4 * i, -9.5, 0.7), material=enamel)
    colors = ((0.70, 0.06, 0.05), (0.06, 0.16, 0.50), (0.80, 0.52, 0.06), (0.08, 0.34, 0.18))
    banner = parts.box("Banner", (0.03, 1.3, 3.2))
    for i, y in enumerate(COLUMN_YS[:-1]):
        cloth = parts.material(f"Banner {i}", base_color=colors[i % 4], roughness=0.85, sheen_weight=0.4)
        parts.place(f"Banner {i}", banner, (-WALL_X + 0.08, y + 1.5, 2.7), material=cloth)


def add_planters() -> None:
    """Add planters between the columns, whose leaves geometry nodes instance on points."""
    clay = parts.material("Clay", base_color=(0.44, 0.17, 0.08), roughness=0.75)
    pot = parts.lathe("Pot", [(0.0, 0.02), (0.30, 0.0), (0.44, 0.62), (0.48, 0.64), (0.48, 0.74), (0.42, 0.74),
                              (0.40, 0.64), (0.0, 0.64)], 40, smooth=False)
    spots = [(side * COLUMN_X, y + 1.5) for side in (-1, 1) for y in COLUMN_YS[:-1]]
    for x, y in spots:
        parts.place("Pot", pot, (x, y, 0.0), material=clay)
    random = np.random.default_rng(11)
    count = LEAF_CLUSTERS
    pot_of = np.array(spots)[np.arange(count) % len(spots)]
    height = random.random(count)
    angle, radius = random.random(count) * 2 * np.pi, 0.34 * np.sqrt(random.random(count)) * (1.15 - 0.6 * height)
    points = np.stack([pot_of[:, 0] + radius * np.cos(angle), pot_of[:, 1] + radius * np.sin(angle),
                       0.70 + 0.75 * height], -1)
    tilt = 0.25 + 0.95 * (1.0 - height) * radius / 0.34
    turn = np.stack([tilt, np.zeros(count), angle + np.pi / 2], -1)
    size = 0.75 + 0.5 * random.random(count)
    scatter("Leaves", points, turn, size, leaf_cluster())


def leaf_cluster() -> bpy.types.Collection:
    """Return a collection of one mesh: five bent leaf cards with an alpha texture."""
    vertices, faces, uvs = [], [], []
    for i in range(5):
        a = 2 * math.pi * i / 5
        for row in range(4):
            t = row / 3
            reach, lift = 0.42 * math.sin(1.25 * t), 0.42 * (1.0 - math.cos(1.9 * t)) * 0.35 + 0.1 * t
            for side in (-0.11, 0.11):
                x, y = reach * math.cos(a) - side * math.sin(a), reach * math.sin(a) + side * math.cos(a)
                vertices.append((x, y, lift))
        for row in range(3):
            k = 8 * i + 2 * row
            faces.append((k, k + 1, k + 3, k + 2))
            uvs += [(0, row / 3), (1, row / 3), (1, (row + 1) / 3), (0, (row + 1) / 3)]
    mesh = parts.mesh_from("Leaf cluster", vertices, faces, uvs, smooth=True)
    green = parts.material("Leaf", roughness=0.42)
    texture = parts.textured(green, parts.image("Leaf", textures.leaf(128)))
    green.node_tree.links.new(texture.outputs["Alpha"], parts.shader_of(green).inputs["Alpha"])
    collection = bpy.data.collections.new("Leaf cluster")
    parts.place("Leaf cluster", mesh, material=green, collection=collection)
    return collection


def scatter(name: str, points: np.ndarray, turn: np.ndarray, size: np.ndarray, collection) -> None:
    """Add an object whose geometry nodes instance a collection on points; turn in Euler radians."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([tuple(p) for p in points], [], [])
    mesh.attributes.new("turn", "FLOAT_VECTOR", "POINT").data.foreach_set("vector", turn.ravel().astype(np.float32))
    mesh.attributes.new("size", "FLOAT", "POINT").data.foreach_set("value", size.astype(np.float32))
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes = {kind: tree.nodes.new(kind) for kind in (
        "NodeGroupInput", "NodeGroupOutput", "GeometryNodeInstanceOnPoints", "GeometryNodeCollectionInfo",
        "FunctionNodeEulerToRotation")}
    turn_node, size_node = (tree.nodes.new("GeometryNodeInputNamedAttribute") for _ in range(2))
    turn_node.data_type, size_node.data_type = "FLOAT_VECTOR", "FLOAT"
    turn_node.inputs["Name"].default_value, size_node.inputs["Name"].default_value = "turn", "size"
    nodes["GeometryNodeCollectionInfo"].inputs["Collection"].default_value = collection
    instance = nodes["GeometryNodeInstanceOnPoints"]
    for output, target in (
            (nodes["NodeGroupInput"].outputs["Geometry"], instance.inputs["Points"]),
            (nodes["GeometryNodeCollectionInfo"].outputs["Instances"], instance.inputs["Instance"]),
            (turn_node.outputs["Attribute"], nodes["FunctionNodeEulerToRotation"].inputs["Euler"]),
            (nodes["FunctionNodeEulerToRotation"].outputs["Rotation"], instance.inputs["Rotation"]),
            (size_node.outputs["Attribute"], instance.inputs["Scale"]),
            (instance.outputs["Instances"], nodes["NodeGroupOutput"].inputs["Geometry"])):
        tree.links.new(output, target)
    parts.place(name, mesh).modifiers.new(name, "NODES").node_group = tree
