# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of tiles (UDIM) against Cycles, pixel by pixel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

SCENE = r'''
extension, packed, use = sys.argv[3:]
TILES = {1001: ((255, 40, 40, 255), 8, 8), 1002: ((40, 255, 40, 255), 32, 32), 1011: ((40, 40, 255, 128), 16, 8)}
scene = new_scene()
for number, (color, width, height) in TILES.items():
    y, x = np.mgrid[:height, :width]
    pixels = np.empty((height, width, 4), np.uint8)
    pixels[...] = color
    pixels[(x * 4 // width + y * 4 // height) % 2 == 0, :3] //= 2
    path = f"{FOLDER}/t.{number}.png"
    output = oiio.ImageOutput.create(path)
    spec = oiio.ImageSpec(width, height, 4, "uint8")
    spec.attribute("oiio:UnassociatedAlpha", 1)
    assert output.open(path, spec) and output.write_image(pixels)
    output.close()
image = bpy.data.images.load(f"{FOLDER}/t.1001.png")
image.source, image.filepath = 'TILED', f"{FOLDER}/t.<UDIM>.png"
for number in set(TILES) - {tile.number for tile in image.tiles}:
    image.tiles.new(number)
image.reload()
if packed == "packed":
    image.pack()
# A face in each square: of files Cycles loads the tiles in which faces have corners.
corners = [(x + i, y + j) for x in (-1, 0, 1, 2) for y in (-1, 0, 1, 2) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
mesh = bpy.data.meshes.new("squares")
mesh.from_pydata([(x, y, 0) for x, y in corners], [], [tuple(range(k, k + 4)) for k in range(0, len(corners), 4)])
uv = mesh.uv_layers.new(name="UV")
for k, (x, y) in enumerate(corners):
    i, j = ((0, 0), (1, 0), (1, 1), (0, 1))[k % 4]
    uv.data[k].uv = x + 1e-3 * (1 - 2 * i), y + 1e-3 * (1 - 2 * j)
scene.collection.objects.link(bpy.data.objects.new("squares", mesh))
material = bpy.data.materials.new("m")
mesh.materials.append(material)
tree = material.node_tree
tree.nodes.clear()
add = lambda kind: tree.nodes.new("ShaderNode" + kind)
texture, output, shine = add("TexImage"), add("OutputMaterial"), add("Emission")
texture.image, texture.extension = image, extension
tree.links.new(texture.outputs["Color"], shine.inputs["Color"])
if use == "emission":
    tree.links.new(shine.outputs[0], output.inputs["Surface"])
elif use == "mask":
    clear, mix = add("BsdfTransparent"), add("MixShader")
    for source, target in ((texture.outputs["Alpha"], 0), (clear.outputs[0], 1), (shine.outputs[0], 2)):
        tree.links.new(source, mix.inputs[target])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    scene.world = bpy.data.worlds.new("w")
    scene.world.color = 0.2, 0.6, 1.0
else:
    diffuse, bump = add("BsdfDiffuse"), add("Bump")
    bump.inputs["Distance"].default_value = 0.2
    for source, target in ((texture.outputs["Color"], bump.inputs["Height"]),
                           (bump.outputs[0], diffuse.inputs["Normal"]), (diffuse.outputs[0], output.inputs["Surface"])):
        tree.links.new(source, target)
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", 'SUN'))
    sun.data.energy, sun.rotation_euler = 3, (0.8, 0.3, 0)
    scene.collection.objects.link(sun)
look_down(scene, (1, 1, 5), 4)
expected = picture(scene, 'CYCLES', (96, 96), 32)[0][..., :3]
result = {}
for integrator, samples in (("REFERENCE", 32), ("REALTIME", 12)):
    pixels, reports = picture(scene, 'BURNISH', (96, 96), samples, integrator)
    error = np.abs(pixels[..., :3] - expected)
    squares = (pixels[..., :3] - expected).reshape(4, 24, 4, 24, 3).mean((1, 3))
    result[integrator] = [float(error.mean()), float(np.abs(squares).max()), "".join(reports)]
result["squares"] = expected.reshape(4, 24, 4, 24, 3).mean((1, 3)).tolist()
finish(result)
'''


@pytest.mark.slow
@pytest.mark.parametrize(("extension", "packed", "use"), [
    ("REPEAT", "files", "emission"), ("EXTEND", "packed", "emission"), ("CLIP", "packed", "mask"),
    ("MIRROR", "packed", "mask"), ("REPEAT", "packed", "bump"),
])
def test_tiles_are_those_of_cycles(run_pictures: Callable[..., Any], extension: str, packed: str, use: str) -> None:
    """Draw each tile in its square, squares without one in magenta and borders as Cycles; say nothing of it."""
    found = run_pictures(SCENE, extension, packed, use)
    if use == "emission":
        assert found["squares"][0][2] == pytest.approx([1.0, 0.0, 1.0], abs=1e-3)
        assert found["squares"][2][2][1] > 5.0 * found["squares"][2][2][0]
    for integrator, mean, square in (("REFERENCE", 0.003, 0.006), ("REALTIME", 0.03, 0.015)):
        error, worst, text = found[integrator]
        assert error < mean and worst < square, (integrator, error, worst)
        assert not text
