# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the open Blender scene matte: roughness 0.8, no transmission, no coat, so that diffuse light is measured alone.

Changes the loaded data only; nothing is saved. Run by hand, to look at the copies with Cycles:

    python tests/performance/matte_copy.py SCENE.blend... [--size 320 180] [--samples 32] [--output out/matte]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

ROUGHNESS = 0.8
PRINCIPLED = {
    "Roughness": ROUGHNESS, "Transmission Weight": 0.0, "Coat Weight": 0.0, "Subsurface Weight": 0.0,
    "Anisotropic": 0.0, "Thin Film Thickness": 0.0,
}
"""Subsurface scattering is walked at random by Cycles and diffuse here: the two would not show the same."""
ROUGH = {"ShaderNodeBsdfAnisotropic", "ShaderNodeBsdfGlossy", "ShaderNodeBsdfMetallic"}
GLASS = {"ShaderNodeBsdfGlass", "ShaderNodeBsdfRefraction"}


def shader_trees() -> Iterator[Any]:
    """Yield the node trees of all materials, and all groups of shader nodes."""
    for material in bpy.data.materials:
        if material.node_tree is not None:
            yield material.node_tree
    yield from (group for group in bpy.data.node_groups if group.type == 'SHADER')


def fix(tree: Any, node: Any, name: str, value: float) -> bool:
    """Unlink an input and set it; returns whether the node has it."""
    socket = node.inputs.get(name)
    if socket is None:
        return False
    for link in list(socket.links):
        tree.links.remove(link)
    socket.default_value = value
    return True


def take_over(tree: Any, source: Any, target: Any) -> None:
    """Give an input what another one has: its link, or else its value."""
    if source.is_linked:
        tree.links.new(source.links[0].from_socket, target)
    else:
        target.default_value = source.default_value


def replace_glass(tree: Any, glass: Any) -> None:
    """Put a rough dielectric of the same colour in the place of a Glass or Refraction BSDF."""
    new = tree.nodes.new("ShaderNodeBsdfPrincipled")
    for old_name, new_name in (("Color", "Base Color"), ("Normal", "Normal")):
        take_over(tree, glass.inputs[old_name], new.inputs[new_name])
    new.inputs["Roughness"].default_value = ROUGHNESS
    for link in list(glass.outputs[0].links):
        tree.links.new(new.outputs[0], link.to_socket)
    tree.nodes.remove(glass)


def make_matte(scene: Any) -> int:
    """Make every material rough and opaque to refraction, and put depth of field off; returns the nodes changed.

    Diffuse, translucent and transparent surfaces and emission stay as they are.
    """
    changed = 0
    for tree in shader_trees():
        for node in list(tree.nodes):
            if node.bl_idname == "ShaderNodeBsdfPrincipled":
                changed += any([fix(tree, node, name, value) for name, value in PRINCIPLED.items()])
            elif node.bl_idname in ROUGH:
                fix(tree, node, "Anisotropy", 0.0)
                changed += fix(tree, node, "Roughness", ROUGHNESS)
            elif node.bl_idname in GLASS:
                replace_glass(tree, node)
                changed += 1
    if scene.camera is not None and scene.camera.type == 'CAMERA':
        scene.camera.data.dof.use_dof = False
    return changed


def main() -> None:
    """Render matte copies with Cycles and save them as PNG files."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    from tests.performance.blend_scene import BlendScene
    from tests.performance.sheets import save_sheet, tone

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--size", type=int, nargs=2, default=(320, 180))
    parser.add_argument("--samples", type=int, default=32)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--output", type=Path, default=Path("out/matte"))
    options = parser.parse_args()
    for path in options.scenes:
        panels = []
        for matte in (False, True):
            scene = BlendScene(path, options.size, options.device, matte=matte)
            panels.append((tone(scene.cycles(options.samples, denoise=True)[0]), "matte copy" if matte else path.stem))
        save_sheet(options.output / f"{path.stem}.png", [panels])


if __name__ == "__main__":
    main()
