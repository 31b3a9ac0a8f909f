# SPDX-License-Identifier: GPL-3.0-or-later
"""Cornell: a closed box with coloured walls and glossy blocks, lit by one glowing panel alone; camera inside."""

from __future__ import annotations

import parts

WIDTH, DEPTH, HEIGHT = 5.6, 8.0, 3.6


def build() -> None:
    """Build the scene into the current file."""
    parts.start_scene(exposure=0.2)
    parts.color_world((0.0, 0.0, 0.0), 0.0)
    add_room()
    add_panel()
    add_blocks()
    parts.camera((0.0, -3.85, 1.72), (0.0, 2.0, 1.52), lens=24.0)


def add_room() -> None:
    """Add six walls facing inwards: white, the left one red, the right one green."""
    white = parts.material("White plaster", base_color=(0.73, 0.72, 0.69), roughness=0.9, specular_ior_level=0.2)
    red = parts.material("Red plaster", base_color=(0.57, 0.045, 0.03), roughness=0.8, specular_ior_level=0.2)
    green = parts.material("Green plaster", base_color=(0.05, 0.36, 0.10), roughness=0.8, specular_ior_level=0.2)
    floor = parts.material("Satin floor", base_color=(0.62, 0.60, 0.56), roughness=0.28)
    x, y, z = WIDTH / 2, DEPTH / 2, HEIGHT / 2
    parts.place("Floor", parts.plane("Floor", WIDTH, DEPTH), material=floor)
    parts.place("Ceiling", parts.plane("Ceiling", WIDTH, DEPTH), (0, 0, HEIGHT), (180, 0, 0), material=white)
    parts.place("Back wall", parts.plane("Back wall", WIDTH, HEIGHT), (0, y, z), (90, 0, 0), material=white)
    parts.place("Front wall", parts.plane("Front wall", WIDTH, HEIGHT), (0, -y, z), (-90, 0, 0), material=white)
    parts.place("Left wall", parts.plane("Left wall", HEIGHT, DEPTH), (-x, 0, z), (0, 90, 0), material=red)
    parts.place("Right wall", parts.plane("Right wall", HEIGHT, DEPTH), (x, 0, z), (0, -90, 0), material=green)


def add_panel() -> None:
    """Add the only light: a glowing mesh just under the ceiling, in a dark frame."""
    glow = parts.material("Panel", base_color=(0.8, 0.8, 0.8), emission_color=(1.0, 0.78, 0.52), emission_strength=14.0)
    parts.place("Panel", parts.plane("Panel", 1.9, 1.5), (0.0, 0.9, HEIGHT - 0.03), (180, 0, 0), material=glow)
    frame = parts.material("Frame", base_color=(0.05, 0.05, 0.05), roughness=0.4, metallic=1.0)
    for name, size, location in (("Frame north", (2.1, 0.1, 0.08), (0.0, 1.7, HEIGHT - 0.04)),
                                 ("Frame south", (2.1, 0.1, 0.08), (0.0, 0.1, HEIGHT - 0.04)),
                                 ("Frame west", (0.1, 1.5, 0.08), (-1.0, 0.9, HEIGHT - 0.04)),
                                 ("Frame east", (0.1, 1.5, 0.08), (1.0, 0.9, HEIGHT - 0.04))):
        parts.place(name, parts.box(name, size), location, material=frame)


def add_blocks() -> None:
    """Add a tall brushed-metal block, a lacquered cube, and a mirror sphere and a glossy ring in front."""
    metal = parts.material("Brushed steel", base_color=(0.78, 0.78, 0.80), metallic=1.0, roughness=0.16)
    lacquer = parts.material("White lacquer", base_color=(0.82, 0.80, 0.76), roughness=0.35, coat_weight=1.0,
                             coat_roughness=0.03)
    mirror = parts.material("Mirror", base_color=(0.93, 0.93, 0.93), metallic=1.0, roughness=0.0)
    blue = parts.material("Blue glaze", base_color=(0.03, 0.10, 0.42), roughness=0.08)
    tall, cube = parts.box("Tall block", (1.25, 1.25, 2.35)), parts.box("Cube", (1.3, 1.3, 1.3))
    parts.place("Tall block", tall, (-1.05, 1.9, 1.175), (0, 0, 20), material=metal, bevel=0.02)
    parts.place("Cube", cube, (1.15, 1.0, 0.65), (0, 0, -18), material=lacquer, bevel=0.04)
    parts.place("Mirror sphere", parts.sphere("Mirror sphere", 0.42, 96), (1.12, 1.0, 1.72), material=mirror)
    parts.place("Ring", parts.torus("Ring", 0.42, 0.15, 96, 32), (-0.35, 0.15, 0.15), material=blue)
