# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that is scattered in hair by the Principled Hair BSDF, path-traced, against Cycles' round curves."""

from __future__ import annotations

import numpy as np
import pytest

SCENES = r'''
MELANIN = dict(blond=0.25, brown=0.6, black=0.95)
def look(color, **values):
    material = bpy.data.materials.new(color); tree = material.node_tree; tree.nodes.clear()
    node = tree.nodes.new("ShaderNodeBsdfHairPrincipled")
    node.parametrization = 'ABSORPTION' if color == "white" else 'MELANIN'
    if color == "white":
        node.inputs["Absorption Coefficient"].default_value = (0, 0, 0)
    else:
        node.inputs["Melanin"].default_value = MELANIN[color]
    for name, value in values.items():
        if name == "model":
            node.model = value
        else:
            node.inputs[name.replace("_", " ")].default_value = value
    tree.links.new(node.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
    return material
def new_light(light):
    scene = new_scene(); look_down(scene, (0, 0, 9), 2.8); scene.render.film_transparent = True
    settings = scene.cycles; scene.cycles_curves.shape = 'THICK'
    settings.max_bounces = settings.glossy_bounces = settings.transmission_bounces = settings.diffuse_bounces = 1024
    settings.sample_clamp_indirect = settings.blur_glossy = settings.light_sampling_threshold = 0
    scene.world = bpy.data.worlds.new("World")
    color = dict(sun=(0, 0, 0), sky=(0.5, 0.6, 0.8), white=(1, 1, 1))[light]
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (*color, 1)
    if light == "sun":
        sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN')); sun.data.energy = 3
        sun.rotation_euler = (0.6, -0.5, 0); scene.collection.objects.link(sun)
    return scene
def add_ball(scene, material, strands=900, radius=0.014):
    random = np.random.default_rng(1)
    roots = random.normal(size=(strands, 1, 3)); roots /= np.linalg.norm(roots, axis=2, keepdims=True)
    t = np.linspace(0, 1, 5)[:, None]
    points = roots * (0.6 + 0.5 * t) + np.array([0.3, -0.2, 0]) * t ** 2
    hair = bpy.data.hair_curves.new("Hair"); hair.add_curves([5] * strands)
    hair.attributes["position"].data.foreach_set("vector", points.astype(np.float32).ravel())
    width = hair.attributes.get("radius") or hair.attributes.new("radius", 'FLOAT', 'POINT')
    width.data.foreach_set("value", np.tile(radius * (1 - t[:, 0]), strands).astype(np.float32))
    hair.materials.append(material); scene.collection.objects.link(bpy.data.objects.new("Hair", hair))
def add_fur(scene, material):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, radius=0.6); ball = bpy.context.object
    skin = bpy.data.materials.new("Skin"); ball.data.materials.append(skin)
    skin.node_tree.nodes["Principled BSDF"].inputs[0].default_value = (0.1, 0.1, 0.1, 1)
    ball.data.materials.append(material)
    ball.modifiers.new("Hair", 'PARTICLE_SYSTEM'); settings = ball.particle_systems[0].settings
    for name, value in dict(type='HAIR', material=2, brownian_factor=0.05, count=150, hair_length=0.5, root_radius=1,
                            child_type='INTERPOLATED', rendered_child_count=8, radius_scale=0.012).items():
        setattr(settings, name, value)
results = []
def compare(scene, samples, size=(48, 48)):
    results.append([picture(scene, engine, size, samples)[0].mean((0, 1)).tolist() for engine in ('BURNISH', 'CYCLES')])
'''

FURNACE = SCENES + r'''
for coat, index in ((0, 1.55), (0.7, 1.3)):
    scene = new_light("white"); add_ball(scene, look("white", Coat=coat, IOR=index, Random_Roughness=0.5))
    compare(scene, 32)
finish(results)
'''


@pytest.mark.slow
def test_white_hair_in_a_white_world(run_pictures):
    """Hair without absorption can't be seen in a world of one colour: no light is lost or made."""
    for ours, cycles in run_pictures(FURNACE):
        assert ours[3] == pytest.approx(cycles[3], rel=0.01) and ours[3] > 0.2
        np.testing.assert_allclose(ours[:3], ours[3], rtol=0.004)


SKY = SCENES + r'''
for color in ("white", "blond", "brown", "black"):
    for along, around in ((0.1, 0.2), (0.3, 0.3), (0.6, 0.6)):
        scene = new_light("sky"); add_ball(scene, look(color, Roughness=along, Radial_Roughness=around))
        compare(scene, 32)
for values in (dict(Offset=0.3), dict(Random_Color=0.6, Random_Roughness=0.6), dict(IOR=1.2)):
    scene = new_light("sky"); add_ball(scene, look("brown", **values))
    compare(scene, 32)
for color in ("blond", "black"):
    scene = new_light("sky"); add_fur(scene, look(color))
    compare(scene, 32)
finish(results)
'''


def check(results, most):
    """Compare brightness by what hair covers, by channel."""
    for ours, cycles in results:
        assert ours[3] == pytest.approx(cycles[3], rel=0.015)
        np.testing.assert_allclose(np.divide(ours[:3], ours[3]), np.divide(cycles[:3], cycles[3]), rtol=most)


@pytest.mark.slow
def test_hair_under_a_sky(run_pictures):
    """Furry balls of curves and of particles are as bright and as coloured as in Cycles."""
    results = run_pictures(SKY)
    assert len(results) == 17
    check(results, 0.03)


SUN = SCENES + r'''
for color, along, around in (("white", 0.3, 0.3), ("blond", 0.3, 0.4), ("blond", 0.6, 0.6), ("brown", 0.2, 0.3),
                             ("black", 0.3, 0.3), ("black", 0.5, 0.5)):
    scene = new_light("sun"); add_ball(scene, look(color, Roughness=along, Radial_Roughness=around))
    compare(scene, 768)
scene = new_light("sun"); add_ball(scene, look("black", Coat=0.7, Roughness=0.5))
# Of coats direct light alone: what Cycles samples of R is as wide as without one, unlike the density that it states.
scene.cycles.max_bounces, scene.burnish.light_paths.max_bounces = 0, 1
compare(scene, 256)
scene = new_light("sun"); add_fur(scene, look("brown", Roughness=0.4, Radial_Roughness=0.5))
compare(scene, 512)
finish(results)
'''


@pytest.mark.slow
def test_hair_in_the_sun(run_pictures):
    """The same in the sun, where single samples are noisy in both."""
    results = run_pictures(SUN)
    assert len(results) == 8
    check(results, 0.04)
