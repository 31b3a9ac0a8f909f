# SPDX-License-Identifier: GPL-3.0-or-later
"""Gallery: ramps of roughness and of metallic on three steps over a polished floor, under a packed sky and lamps."""

from __future__ import annotations

import parts
import textures

COUNT = 7
RADIUS = 0.42
SPACING = 1.12
ROWS = (
    # material, step depth position, step height, base colour, what varies
    ("Gold roughness", 0.0, 0.18, (1.0, 0.70, 0.32), {"metallic": 1.0}, "roughness"),
    ("Ceramic roughness", 1.35, 0.62, (0.02, 0.22, 0.26), {"metallic": 0.0}, "roughness"),
    ("Rose metallic", 2.7, 1.06, (0.80, 0.28, 0.24), {"roughness": 0.22}, "metallic"),
)


def build() -> None:
    """Build the scene into the current file."""
    parts.start_scene(exposure=0.35)
    add_world()
    add_floor()
    add_rows()
    add_lamps()
    parts.camera((-4.6, -9.6, 2.9), (0.05, 1.1, 0.85), lens=48.0, f_stop=4.0, focus=(0.0, 0.3, 0.9))


def add_world() -> None:
    """Light the scene by a dusk sky with a low sun and two windows, in a packed floating-point image."""
    pixels = textures.sky(
        512, 256, zenith=(0.05, 0.085, 0.18), horizon=(0.34, 0.31, 0.36), ground=(0.16, 0.15, 0.17),
        sun_direction=(-0.86, -0.30, 0.42), sun_degrees=5.0, sun_radiance=(900.0, 640.0, 400.0), glow=(1.3, 0.75, 0.4),
        softboxes=((18.0, 34.0, 34.0, 40.0, (2.6, 3.0, 3.6)),))
    parts.image_world(parts.image("Dusk", pixels), strength=0.8)


def add_floor() -> None:
    """Add polished tiles whose joints are rough, and a step under each row."""
    shades = ((0.16, 0.165, 0.18), (0.19, 0.195, 0.21), (0.135, 0.14, 0.155))
    tiles = parts.image("Tiles", textures.tiles(256, 4, shades, (0.07, 0.07, 0.07), 0.02))
    floor = parts.material("Polished tiles", roughness=0.12, specular_ior_level=0.6)
    parts.textured(floor, tiles, scale=1.0)
    parts.place("Floor", parts.plane("Floor", 600.0, 600.0, uv_scale=0.22), material=floor)
    stone = parts.material("Pale stone", base_color=(0.52, 0.49, 0.46), roughness=0.45, coat_weight=0.25,
                           coat_roughness=0.15)
    width = COUNT * SPACING + 0.25
    for name, y, height, *_ in ROWS:
        mesh = parts.box(name + " step", (width, 1.3, height))
        parts.place(name + " step", mesh, (0.0, y, height / 2), material=stone, bevel=0.025)


def add_rows() -> None:
    """Add the spheres; all share one mesh, each has its own material."""
    mesh = parts.sphere("Sphere", RADIUS, 96)
    for name, y, height, color, fixed, varied in ROWS:
        for i in range(COUNT):
            value = i / (COUNT - 1)
            material = parts.material(f"{name} {value:.2f}", base_color=color, **fixed, **{varied: value})
            parts.place(f"{name} {value:.2f}", mesh, ((i - (COUNT - 1) / 2) * SPACING, y, height + RADIUS),
                        material=material)


def add_lamps() -> None:
    """Add a large cool softbox from the right, a warm strip from behind and a small round fill."""
    parts.lamp("Key softbox", "AREA", (5.5, -3.5, 5.5), 420.0, (0.0, 1.0, 0.5), (0.82, 0.91, 1.0), shape="RECTANGLE",
               size=3.0, size_y=2.0)
    parts.lamp("Rim strip", "AREA", (-1.0, 6.0, 7.4), 620.0, (0.0, 1.5, 0.9), (1.0, 0.78, 0.58), shape="RECTANGLE",
               size=7.0, size_y=0.5)
    parts.lamp("Fill disk", "AREA", (-6.5, 0.5, 3.4), 60.0, (-1.0, 0.5, 0.6), (1.0, 0.9, 0.8), shape="DISK", size=1.2)
