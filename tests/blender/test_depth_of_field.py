# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth of field of real-time frames against Cycles: bulbs before and behind the focus, lenses of some shapes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow

CODE = r'''
def build(kind):
    scene = new_scene()
    camera = add_camera(scene, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    dof = camera.data.dof
    dof.use_dof, dof.focus_distance, dof.aperture_fstop = True, 2.0, 0.25
    if kind == "orthographic":
        camera.data.type, camera.data.ortho_scale, dof.aperture_fstop = 'ORTHO', 4.0, 2.5
    if kind == "blades":
        dof.aperture_blades, dof.aperture_rotation = 5, 0.5
    if kind == "squeezed":
        dof.aperture_blades, dof.aperture_rotation, dof.aperture_ratio = 3, 0.3, 1.5
    material = bpy.data.materials.new("bulb")
    nodes = material.node_tree.nodes
    nodes.remove(nodes["Principled BSDF"])
    emission = nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value, emission.inputs["Strength"].default_value = (1.0, 0.7, 0.4, 1.0), 40.0
    material.node_tree.links.new(emission.outputs[0], nodes["Material Output"].inputs[0])
    # In front of the focus on the left, behind it on the right.
    for x, y in ((-0.17, 0.8), (0.17, 5.0)):
        place, radius = (x * y, y, 0.0), 0.02 * y
        if kind == "orthographic":
            place, radius = (6.0 * x, 0.6 if x < 0.0 else y, 0.0), 0.1
        bpy.ops.mesh.primitive_uv_sphere_add(segments=16, ring_count=8, radius=radius, location=place)
        bpy.context.object.data.materials.append(material)
    return scene

results = {}
for kind in ("round", "blades", "squeezed", "orthographic"):
    scene = build(kind)
    ours = picture(scene, 'BURNISH', (96, 48), 8, 'REALTIME')[0]
    traced = picture(scene, 'BURNISH', (96, 48), 256)[0]
    cycles = picture(scene, 'CYCLES', (96, 48), 256)[0]
    np.savez(f"{FOLDER}/{kind}.npz", ours=ours, traced=traced, cycles=cycles)
    results[kind] = f"{FOLDER}/{kind}.npz"
finish(results)
'''


@pytest.fixture(scope="module")
def found(run_pictures: Callable[..., Any]) -> dict[str, Any]:
    """Return pictures [h, w, 3 or 4] by lens and engine."""
    return {kind: dict(np.load(path)) for kind, path in run_pictures(CODE).items()}


def shape(picture: np.ndarray) -> list[float]:
    """Return a disk's light, its place and its width to the right and upwards."""
    light = picture[..., 0].astype(np.float64)
    y, x = np.mgrid[:light.shape[0], :light.shape[1]]
    total = light.sum()
    place = [(light * x).sum() / total, (light * y).sum() / total]
    return [total, *place, np.sqrt((light * (x - place[0]) ** 2).sum() / total),
            np.sqrt((light * (y - place[1]) ** 2).sum() / total)]


@pytest.mark.parametrize("kind", ["round", "blades", "squeezed", "orthographic"])
def test_bulbs_are_as_in_cycles(found: dict[str, Any], kind: str) -> None:
    """Show disks of the light, the place and the shape that Cycles gives them, on both sides of the focus."""
    pictures = found[kind]
    for side in (slice(0, 48), slice(48, 96)):
        ours, traced, cycles = (shape(pictures[name][:, side]) for name in ("ours", "traced", "cycles"))
        assert ours[0] == pytest.approx(cycles[0], rel=0.12) and traced[0] == pytest.approx(cycles[0], rel=0.08)
        assert ours[1:3] == pytest.approx(cycles[1:3], abs=0.8) and traced[1:3] == pytest.approx(cycles[1:3], abs=0.4)
        assert ours[3:] == pytest.approx(cycles[3:], rel=0.12, abs=0.2)
        assert cycles[3] > 1.5
        lit = [np.asarray(pictures[name][:, side, 0]) > 0.5 * cycles[0] / (
            4.0 * np.pi * cycles[3] * cycles[4]) for name in ("ours", "cycles")]
        assert (lit[0] & lit[1]).sum() > 0.75 * (lit[0] | lit[1]).sum()
