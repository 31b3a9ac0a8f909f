# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of hair curves and particle hair against Cycles' round curves."""

from __future__ import annotations

import numpy as np
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


FUR = r'''
def diffuse(name, color):
    result = bpy.data.materials.new(name); tree = result.node_tree; tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse"); shader.inputs[0].default_value = (*color, 1)
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
    return result
def furry(item, **options):
    for material in (diffuse("Skin", (0.2, 0.12, 0.06)), diffuse("Fur", (0.7, 0.4, 0.2))):
        item.data.materials.append(material)
    item.modifiers.new("Hair", 'PARTICLE_SYSTEM'); settings = item.particle_systems[0].settings
    settings.type, settings.material, settings.brownian_factor = 'HAIR', 2, 0.05
    for name, value in options.items():
        setattr(settings, name, value)
def new_field(place, target):
    scene = new_scene(); add_camera(scene, place, target); scene.view_settings.view_transform = 'Raw'
    scene.world = bpy.data.worlds.new("World")
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.3, 0.4, 0.6, 1)
    scene.render.film_transparent = True; scene.cycles_curves.shape = 'THICK'
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN')); sun.data.energy = 2
    sun.rotation_euler = (0.6, -0.5, 0); scene.collection.objects.link(sun)
    return scene
means = []
def compare(scene):
    pictures = [picture(scene, engine, (96, 72), 8)[0] for engine in ('BURNISH', 'CYCLES')]
    means.append([each.mean((0, 1)).tolist() for each in pictures])
scene = new_field((0, -6, 2), (0, 0, 0))
bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16); ball = bpy.context.object
furry(ball, count=500, hair_length=0.5, child_type='SIMPLE', rendered_child_count=5, root_radius=1.5, radius_scale=0.02)
compare(scene)
ball.show_instancer_for_render = False
compare(scene)
tree = ball.data.materials[1].node_tree
for kind in ("ShaderNodeBsdfTransparent", "ShaderNodeBsdfTranslucent"):
    mix, through = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new(kind)
    for index, shader in enumerate((tree.nodes["Diffuse BSDF"], through)):
        tree.links.new(shader.outputs[0], mix.inputs[1 + index])
    tree.links.new(mix.outputs[0], tree.nodes["Material Output"].inputs[0])
    compare(scene)
for kind in ('SIMPLE', 'INTERPOLATED'):
    scene = new_field((0, -5, 2.5), (0, 0, 0.1))
    bpy.ops.mesh.primitive_plane_add(size=4)
    furry(bpy.context.object, count=200, hair_length=0.4, child_type=kind, rendered_child_count=10, root_radius=2,
          radius_scale=0.01, roughness_1=0.05, shape=0.3)
    bpy.context.object.particle_systems[0].settings.brownian_factor = 0.1
    compare(scene)
finish(means)
'''


CLOSE = (0.015, 0.04)
"""How far cover and brightness may be off, relative"""


@pytest.mark.slow
def test_particle_hair(run_pictures):
    """Furry balls, with and without their skin, and grass cover what they do in Cycles and are about as bright.

    Light passes through half of two of them: rays must meet a strand once, and not its far side again.
    """
    results = run_pictures(FUR)
    assert len(results) == 6
    for (ours, cycles), (cover, bright) in zip(
            results, [CLOSE, (0.015, 0.06), (0.04, 0.07), (0.025, 0.06), CLOSE, CLOSE], strict=True):
        assert cycles[3] > 0.15
        assert ours[3] == pytest.approx(cycles[3], rel=cover)
        assert ours[:3] == pytest.approx(cycles[:3], rel=bright)


INFO = r'''
scene = new_scene()
look_down(scene, (0, 0, 9), 2.8)
scene.render.film_transparent = True; scene.cycles_curves.shape = 'THICK'
material = bpy.data.materials.new("Info"); tree = material.node_tree
def show(links, scales, offset):
    tree.nodes.clear()
    info, join = tree.nodes.new("ShaderNodeHairInfo"), tree.nodes.new("ShaderNodeCombineXYZ")
    for index, output in enumerate(links):
        tree.links.new(info.outputs[output], join.inputs[index])
    place = tree.nodes.new("ShaderNodeVectorMath"); place.operation = 'MULTIPLY_ADD'
    place.inputs[1].default_value, place.inputs[2].default_value = scales, [offset] * 3
    tree.links.new(join.outputs[0] if links else info.outputs["Tangent Normal"], place.inputs[0])
    emission = tree.nodes.new("ShaderNodeEmission"); tree.links.new(place.outputs[0], emission.inputs[0])
    tree.links.new(emission.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
hair = bpy.data.hair_curves.new("Hair"); hair.add_curves([4] * 4)
t = np.linspace(0, 1, 4)[:, None]
points = [np.concatenate([-1.2 + 0.3 * i + 0.1 * t, -1 + 1.5 * t ** 1.5 * (1 + 0.1 * i), 0.3 * t * t], 1)
          for i in range(4)]
hair.attributes["position"].data.foreach_set("vector", np.array(points, np.float32).ravel())
radius = hair.attributes.get("radius") or hair.attributes.new("radius", 'FLOAT', 'POINT')
radius.data.foreach_set("value", [0.1, 0.08, 0.1, 0.04] * 4)
hair.materials.append(material); scene.collection.objects.link(bpy.data.objects.new("Hair", hair))
def square(name, place):
    mesh = bpy.data.meshes.new(name); mesh.materials.append(material)
    mesh.from_pydata([(0, 0, 0), (0.8, 0, 0), (0.8, 0.8, 0), (0, 0.8, 0)], [], [(0, 1, 2, 3)])
    item = bpy.data.objects.new(name, mesh); scene.collection.objects.link(item); item.location = place
    return item
square("Bare", (0, 0.7, 0))
item = square("Furry", (0.1, -0.9, 0)); item.rotation_euler.x = -0.6
item.modifiers.new("Hair", 'PARTICLE_SYSTEM'); settings = item.particle_systems[0].settings
settings.type, settings.count, settings.hair_length, settings.shape = 'HAIR', 6, 1.0, -0.3
settings.root_radius, settings.tip_radius, settings.radius_scale, settings.use_close_tip = 1.0, 0.3, 0.15, False
settings.brownian_factor, settings.render_step = 0.2, 4
results = []
for links, scales, offset in ((("Intercept", "Length", "Thickness"), (1, 0.5, 3), 0.1),
                              (("Is Strand", "Random"), (0.5, 1, 0), 0.1), ((), (0.5, 0.5, 0.5), 0.5)):
    show(links, scales, offset)
    results.append([picture(scene, engine, (48, 48), 8)[0].tolist() for engine in ('BURNISH', 'CYCLES')])
item.data.uv_layers.new(name="Map")
for kind, output in (("TexCoord", "Generated"), ("TexCoord", "UV"), ("NewGeometry", "Tangent"), ("TexNoise", "Color")):
    tree.nodes.clear()
    node, emission = tree.nodes.new("ShaderNode" + kind), tree.nodes.new("ShaderNodeEmission")
    place = tree.nodes.new("ShaderNodeVectorMath"); place.operation = 'MULTIPLY_ADD'
    place.inputs[1].default_value, place.inputs[2].default_value = (0.3, 0.3, 0.3), (0.5, 0.5, 0.5)
    tree.links.new(node.outputs[output], place.inputs[0]); tree.links.new(place.outputs[0], emission.inputs[0])
    tree.links.new(emission.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
    results.append([picture(scene, engine, (48, 48), 8)[0].tolist() for engine in ('BURNISH', 'CYCLES')])
finish(results)
'''


@pytest.mark.slow
def test_hair_info(run_pictures):
    """Hair Info, coordinates and tangents of hair curves, particle hair and meshes are Cycles', but at edges."""
    for ours, cycles in np.array(run_pictures(INFO)):
        inside = (ours[..., 3] == 1) & (cycles[..., 3] == 1)
        assert inside.mean() > 0.15
        difference = np.abs(ours - cycles)[inside][:, :3]
        assert np.median(difference) < 0.004 and difference.mean() < 0.015
        np.testing.assert_allclose(ours[inside].mean(0), cycles[inside].mean(0), rtol=0.02, atol=0.005)
