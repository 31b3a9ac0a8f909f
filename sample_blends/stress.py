# SPDX-License-Identifier: GPL-3.0-or-later
"""Stress: a display case of materials at their extremes, lit by every kind of lamp, with tiny and huge objects."""

from __future__ import annotations

import math

import parts
import stress_materials
import textures

COLUMNS, ROWS, CELL = 8, 4, 1.0
BALL = 0.34


def build() -> None:
    """Build the scene into the current file."""
    parts.start_scene(exposure=1.15)
    pixels = textures.sky(
        256, 128, zenith=(0.10, 0.16, 0.30), horizon=(0.42, 0.45, 0.52), ground=(0.20, 0.19, 0.18),
        sun_direction=(-0.7, -0.6, 0.5), sun_degrees=8.0, sun_radiance=(40.0, 34.0, 26.0),
        softboxes=((-60.0, 40.0, 40.0, 30.0, (3.0, 3.0, 3.0)),))
    parts.image_world(parts.image("Studio", pixels), strength=0.5, rotation=20.0)
    add_case()
    add_specimens()
    add_sizes()
    add_lamps()
    parts.camera((-1.5, -11.4, 2.5), (0.12, 0.0, 1.98), lens=43.0).data.clip_end = 20000.0


def cell_center(index: int) -> tuple[float, float, float]:
    """Return the middle of the floor of a compartment, counted from the top left."""
    column, row = index % COLUMNS, index // COLUMNS
    return (column - (COLUMNS - 1) / 2) * CELL, 0.0, (ROWS - 1 - row) * CELL + 0.12


def add_case() -> None:
    """Add the case: shelves, uprights and a checkered back, so that refraction and transparency show."""
    wood = parts.material("Dark case", base_color=(0.045, 0.040, 0.038), roughness=0.38, coat_weight=0.3)
    back = parts.material("Back", roughness=0.8, specular_ior_level=0.2)
    board = textures.checker(128, 8, (0.78, 0.76, 0.72), (0.50, 0.51, 0.53))
    parts.textured(back, parts.image("Checker", board), interpolation="Closest")
    width, height = COLUMNS * CELL + 0.06, ROWS * CELL + 0.06
    parts.place("Back", parts.plane("Back", width, height, uv_scale=0.5), (0, 0.55, height / 2 + 0.03), (90, 0, 0),
                material=back)
    shelf, upright = parts.box("Shelf", (width, 1.1, 0.06)), parts.box("Upright", (0.06, 1.1, height))
    for row in range(ROWS + 1):
        parts.place("Shelf", shelf, (0, 0, row * CELL + 0.09), material=wood, bevel=0.008)
    for column in range(COLUMNS + 1):
        x = (column - COLUMNS / 2) * CELL
        parts.place("Upright", upright, (x, 0, height / 2 + 0.06), material=wood, bevel=0.008)


def add_specimens() -> None:
    """Put one object of each material into each compartment."""
    ball = parts.sphere("Ball", BALL, 64)
    ring = parts.torus("Ring", 0.24, 0.10, 64, 24)
    vase = parts.lathe("Vase", [(0.0, -0.34), (0.20, -0.34), (0.31, -0.12), (0.27, 0.08), (0.13, 0.22), (0.12, 0.28),
                                (0.18, 0.34)], 56)
    cube = parts.box("Cube", (0.5, 0.5, 0.5))
    pane = parts.plane("Pane", 0.62, 0.62)
    shapes = {"ball": ball, "ring": ring, "vase": vase, "cube": cube, "pane": pane}
    lift = {"ball": BALL, "ring": 0.325, "vase": 0.34, "cube": 0.25, "pane": 0.33}
    turn = {"ring": (78, 0, 25), "cube": (0, 0, 28), "pane": (80, 0, 0)}
    specimens = stress_materials.specimens()
    assert len(specimens) == COLUMNS * ROWS, f"{len(specimens)} specimens for {COLUMNS * ROWS} compartments"
    for index, (shape, material, special) in enumerate(specimens):
        x, y, z = cell_center(index)
        thing = parts.place(material.name, shapes[shape], (x, y, z + lift[shape]), turn.get(shape, (0, 0, 0)),
                            material=material)
        if special == "mirrored":
            thing.scale = (-1.0, 1.0, 1.0)
        elif special == "sheared":
            parts.shear(thing, 0.45)
        elif special == "speck":
            thing.scale = (0.06,) * 3


def add_sizes() -> None:
    """Add the extremes of size: a plain of 20 km, a moon of 300 m radius far away, a line of balls down to 1 mm."""
    plain = parts.material("Plain", base_color=(0.20, 0.20, 0.21), roughness=0.25)
    parts.place("Plain", parts.plane("Plain", 20000.0, 20000.0), material=plain)
    chalk = parts.material("Moon chalk", base_color=(0.7, 0.62, 0.52), roughness=1.0, diffuse_roughness=1.0)
    parts.place("Moon", parts.sphere("Moon", 300.0, 96), (1750.0, 4200.0, 480.0), material=chalk)
    pearl = parts.material("Pearl", base_color=(0.85, 0.80, 0.74), roughness=0.12)
    bead = parts.sphere("Bead", 1.0, 32)
    x = -3.6
    for i in range(8):
        radius = 0.256 * 0.45 ** i
        x += radius
        parts.place(f"Bead {i}", bead, (x, -1.5, radius), scale=radius, material=pearl)
        x += radius + 0.12 * 0.8 ** i


def add_lamps() -> None:
    """Add a lamp of every kind and shape; sizes differ, one point lamp has none."""
    parts.lamp("Sun", "SUN", (6, -8, 9), 1.1, (0, 0, 1), (1.0, 0.93, 0.82), angle=math.radians(0.53))
    parts.lamp("Spot soft", "SPOT", (-5.5, -6.0, 6.2), 900.0, (-1.5, 0.2, 2.2), (1.0, 0.80, 0.62),
               shadow_soft_size=0.25, spot_size=math.radians(42), spot_blend=0.6)
    parts.lamp("Spot sharp", "SPOT", (4.2, -4.5, 0.5), 260.0, (3.0, 0.2, 2.6), (0.55, 0.75, 1.0), shadow_soft_size=0.0,
               spot_size=math.radians(34), spot_blend=0.05)
    parts.lamp("Point sphere", "POINT", (1.6, -3.0, 5.4), 110.0, color=(1.0, 0.9, 0.8), shadow_soft_size=0.18,
               use_soft_falloff=False)
    parts.lamp("Point bare", "POINT", (-4.6, -1.6, 0.6), 14.0, color=(1.0, 0.45, 0.25), shadow_soft_size=0.0)
    parts.lamp("Disk", "AREA", (0.0, -6.0, 6.5), 260.0, (0.0, 0.0, 2.0), (0.92, 0.96, 1.0), shape="DISK", size=1.8)
    parts.lamp("Ellipse", "AREA", (6.0, -4.0, 3.0), 120.0, (2.0, 0.0, 2.0), (0.75, 0.85, 1.0), shape="ELLIPSE",
               size=0.6, size_y=2.6, spread=math.radians(110))
    parts.lamp("Square", "AREA", (-7.0, -3.5, 2.5), 90.0, (-2.0, 0.0, 2.0), (1.0, 0.85, 0.75), shape="SQUARE",
               size=1.2)
