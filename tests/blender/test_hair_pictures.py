# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of hair curves against Cycles' round curves."""

from __future__ import annotations

import pytest

BALL = r'''
scene = new_scene()
look_down(scene, (0, 0, 9), 2.8)
scene.render.film_transparent = True
random = np.random.default_rng(1)
roots = random.normal(size=(300, 1, 3))
roots /= np.linalg.norm(roots, axis=2, keepdims=True)
t = np.linspace(0, 1, 5)[:, None]
points = roots * (0.6 + 0.5 * t) + np.array([0.3, -0.2, 0]) * t ** 2
hair = bpy.data.hair_curves.new("Hair"); hair.add_curves([5] * 300)
hair.attributes["position"].data.foreach_set("vector", points.astype(np.float32).ravel())
radius = hair.attributes.get("radius") or hair.attributes.new("radius", 'FLOAT', 'POINT')
radius.data.foreach_set("value", np.tile(0.02 * (1 - 0.7 * t[:, 0]), 300).astype(np.float32))
hair.materials.append(bpy.data.materials.new("Diffuse")); tree = hair.materials[0].node_tree; tree.nodes.clear()
diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse"); diffuse.inputs[0].default_value = (0.7, 0.4, 0.2, 1)
tree.links.new(diffuse.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
scene.collection.objects.link(bpy.data.objects.new("Hair", hair))
sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN')); sun.data.energy = 2
sun.rotation_euler = (0.6, -0.5, 0); scene.collection.objects.link(sun)
scene.cycles_curves.shape = 'THICK'
finish([picture(scene, engine, (64, 64), 32)[0].mean((0, 1)).tolist() for engine in ('BURNISH', 'CYCLES')])
'''


@pytest.mark.slow
def test_ball_of_hair(run_pictures):
    """Hair covers as much as Cycles' round curves within 1.5 %, and is as bright within 5 %."""
    ours, cycles = run_pictures(BALL)
    assert cycles[3] > 0.2
    assert ours[3] == pytest.approx(cycles[3], rel=0.015)
    assert ours[:3] == pytest.approx(cycles[:3], rel=0.05)
