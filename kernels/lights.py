# SPDX-License-Identifier: GPL-3.0-or-later
"""Light sampling: choose a lamp, an emissive triangle or the world, draw a direction; and the pdf of hits.

Mesh emitters shine from both sides. Lamps: lamp_sample.py.
"""

from __future__ import annotations

import warp as wp

from .environment_table import sample_environment
from .geometry_math import TWO_PI, transform_point
from .intersect import hit_error, instance_shift
from .lamp_hit import FAR
from .lamp_sample import LightSample, no_light
from .lamp_tables import draw_lamp
from .light_tree import chance_by_tree, choose_by_tree
from .sampling import BELOW_ONE, sample_triangle
from .solid_angle import is_close, sample_seen_triangle, sampled_angle, solid_angle, spherical_triangle
from .types import LIGHT_ENVIRONMENT, LIGHT_TRIANGLE, Light, Lights, Scene
from .wide_loads import load_corner, load_instance


@wp.func
def aim_at_triangle(sample: LightSample, target: wp.vec3, double_area_normal: wp.vec3) -> LightSample:
    """Set direction, distance, pdf and the normal towards the receiver of a point on a triangle; kind -1: edge-on.

    Args:
        sample: What to fill.
        target: From the receiver to the point [m].
        double_area_normal: Cross product of two of the triangle's edges.
    """
    s = sample
    s.distance = wp.length(target)
    double_area = wp.length(double_area_normal)
    if s.distance <= 0.0 or double_area <= 0.0:
        s.kind = -1
        return s
    s.wi = target / s.distance
    s.normal = double_area_normal / double_area
    cosine = -wp.dot(s.wi, s.normal)
    if cosine < 0.0:
        s.normal = -s.normal
        cosine = -cosine
    if cosine <= 1.0e-7:
        s.kind = -1
        return s
    s.pdf = s.distance * s.distance / (cosine * 0.5 * double_area)
    return s


@wp.func
def mean_emission(lights: Lights, emitter: int, area: float) -> float:
    """Return an emissive triangle's mean radiance, as its power tells: both sides shine."""
    return lights.emitter_power[emitter] / wp.max(TWO_PI * area, 1.0e-20)


@wp.func
def sample_emitter(scene: Scene, emitter: int, position: wp.vec3, u: wp.vec2) -> LightSample:
    """Draw a direction to an emissive triangle; the radiance is left to its material.

    Uniform by solid angle where it is close, else by area.
    """
    geometry = scene.geometry
    s = LightSample()
    s.kind = LIGHT_TRIANGLE
    s.shadow = 1
    s.delta = 0
    face = scene.lights.triangles[emitter]
    s.instance = face[0]
    s.triangle = face[1]
    instance = load_instance(geometry.instances, s.instance)
    s.visibility = instance.visibility
    p0 = transform_point(instance.to_world, load_corner(geometry, s.triangle, 0))
    p1 = transform_point(instance.to_world, load_corner(geometry, s.triangle, 1))
    p2 = transform_point(instance.to_world, load_corner(geometry, s.triangle, 2))
    b = sample_triangle(u)
    angle = float(0.0)
    if is_close(p0 - position, p1 - p0, p2 - p0):
        seen = spherical_triangle(p0 - position, p1 - position, p2 - position)
        angle = sampled_angle(solid_angle(seen))
        if angle > 0.0:
            b = sample_seen_triangle(p0 - position, p1 - position, p2 - position, seen, angle, u)
    s.u = b[0]
    s.v = b[1]
    target = p0 * (1.0 - b[0] - b[1]) + p1 * b[0] + p2 * b[1] - position
    s = aim_at_triangle(s, target, wp.cross(p1 - p0, p2 - p0))
    if s.kind < 0:
        return s
    if angle > 0.0:
        s.pdf = 1.0 / angle
    s.radiance = wp.vec3(1.0, 1.0, 1.0)
    s.brightness = mean_emission(scene.lights, emitter, 0.5 * wp.length(wp.cross(p1 - p0, p2 - p0)))
    s.error = hit_error(p0, p1, p2, b[0], b[1], s.normal, instance_shift(geometry, s.instance))
    return s


@wp.func
def cell_side(normal: wp.vec3, behind: float, weighed: int) -> wp.vec3:
    """Return the normal to give sample_light for a hit whose light goes into a cell.

    Zero where light from behind counts (`behind`: its share), and where rays weigh emission against light sampling
    (`weighed` 1): they don't know the normal of where they began.
    """
    if weighed == 0 and behind == 0.0:
        return normal
    return wp.vec3(0.0, 0.0, 0.0)


@wp.func
def sun_counts(light: Light, normal: wp.vec3) -> float:
    """Return 1 where any of a sun's light may arrive at the front of a surface; a zero normal has no back."""
    omc = light.one_minus_cos
    if wp.dot(normal, light.direction) > wp.sqrt(omc * wp.max(2.0 - omc, 0.0)):
        return 0.0
    return 1.0


@wp.func
def class_weight(lights: Lights, index: int, normal: wp.vec3) -> float:
    """Return the weight of a class of lights for a receiver: its probability but for suns below the horizon."""
    weight = lights.weight[index]
    if index > 0 and index != lights.environment_class and weight > 0.0:
        weight = weight * sun_counts(lights.lamps[lights.local_lamp_count + index - 1], normal)
    return weight


@wp.func
def class_total(lights: Lights, normal: wp.vec3) -> float:
    """Return the sum of the classes' weights for a receiver."""
    total = float(0.0)
    for index in range(lights.class_count):
        total = total + class_weight(lights, index, normal)
    return total


@wp.struct
class ClassChoice:
    """One of the classes of lights."""

    index: int
    weight: float
    """As class_weight has it"""
    left: float
    """What is left of the number that chose it, in [0, 1)"""


@wp.func
def choose_class(lights: Lights, total: float, normal: wp.vec3, u: float) -> ClassChoice:
    """Choose a class by a number in [0, 1); `total` is what class_total returns for `normal`, above 0."""
    choice = ClassChoice()
    choice.index = int(0)
    choice.left = u * total
    choice.weight = class_weight(lights, 0, normal)
    while choice.left >= choice.weight and choice.index < lights.class_count - 1:
        choice.left = choice.left - choice.weight
        choice.index = choice.index + 1
        choice.weight = class_weight(lights, choice.index, normal)
    choice.left = wp.min(choice.left / wp.max(choice.weight, 1.0e-30), BELOW_ONE)
    return choice


@wp.func
def sample_world(scene: Scene, u: wp.vec2) -> LightSample:
    """Draw a direction to the world; the radiance is left to its program."""
    drawn = sample_environment(scene.environment, u)
    s = LightSample()
    s.kind = LIGHT_ENVIRONMENT
    s.wi = drawn.direction
    s.pdf = drawn.pdf
    s.brightness = drawn.pdf * scene.lights.environment_power
    s.distance = FAR
    s.radiance = wp.vec3(1.0, 1.0, 1.0)
    s.shadow = 1
    s.visibility = scene.environment.visibility
    s.normal = -drawn.direction
    return s


@wp.func
def chosen_with(sample: LightSample, chance: float) -> LightSample:
    """Return the sample of a light that is chosen with such a probability."""
    s = sample
    s.pdf = sample.pdf * chance
    if not (s.pdf > 0.0):
        s.kind = -1
    return s


@wp.func
def sample_light(scene: Scene, position: wp.vec3, normal: wp.vec3, u: wp.vec2, refill: float) -> LightSample:
    """Choose one light and draw a direction to it, see sample_light_of."""
    return sample_light_of(scene, class_total(scene.lights, normal), position, normal, u, refill)


@wp.func
def sample_light_of(
    scene: Scene, total: float, position: wp.vec3, normal: wp.vec3, u: wp.vec2, refill: float,
) -> LightSample:
    """Choose one light and draw a direction to it; pdf includes the choice.

    The first number picks the class, what is left of it the light, and what is then left places the direction with
    the second: stratified pairs are stratified over all lights together and over each of them.

    Args:
        scene: The scene.
        total: What class_total returns for `normal`.
        position: Where light arrives.
        normal: Of the surface there if light from behind it is lost, else zero.
        u: In [0, 1)^2.
        refill: Another number, since a deep tree uses up a float's bits.
    """
    lights = scene.lights
    if total <= 0.0:
        return no_light()
    choice = choose_class(lights, total, normal, u[0])
    left = choice.left
    chance = choice.weight / total
    # Each kind returns its own: a sample is large, and where branches meet all of it is copied.
    if choice.index == lights.environment_class:
        return chosen_with(sample_world(scene, wp.vec2(left, u[1])), chance)
    lamp = lights.local_lamp_count + choice.index - 1
    if choice.index == 0:
        local = choose_by_tree(lights.tree, position, normal, wp.vec2(left, refill))
        lamp = local.entry
        left = local.left
        chance = chance * local.chance
    if lamp < 0:
        return no_light()
    if lamp < lights.lamp_count and (choice.index > 0 or lamp < lights.local_lamp_count):
        return chosen_with(draw_lamp(lights, lamp, position, wp.vec2(left, u[1])), chance)
    emitter = lamp - lights.local_lamp_count
    return chosen_with(sample_emitter(scene, emitter, position, wp.vec2(left, u[1])), chance)


@wp.func
def environment_chance(scene: Scene, normal: wp.vec3) -> float:
    """Return the probability with which sample_light chooses the world."""
    return scene.lights.weight[scene.lights.environment_class] / class_total(scene.lights, normal)


@wp.func
def lamp_chance(lights: Lights, lamp: int, position: wp.vec3, normal: wp.vec3) -> float:
    """Return the probability with which sample_light chooses a lamp."""
    total = wp.max(class_total(lights, normal), 1.0e-30)
    if lamp < lights.local_lamp_count:
        return lights.weight[0] / total * chance_by_tree(lights.tree, lamp, position, normal)
    return class_weight(lights, 1 + lamp - lights.local_lamp_count, normal) / total


@wp.func
def emitter_pdf(
    scene: Scene, instance: int, triangle: int, origin: wp.vec3, normal: wp.vec3, direction: wp.vec3, t: float,
) -> float:
    """Return the pdf of light sampling for a ray that met a triangle at distance t; 0 if it is not sampled.

    `origin` and `normal` are those of the receiver, as given to sample_light.
    """
    lights = scene.lights
    geometry = scene.geometry
    if lights.class_count == 0:
        return 0.0
    first = lights.emitter_offset[instance]
    if first < 0:
        return 0.0
    row = load_instance(geometry.instances, instance)
    emitter = lights.emitter_index[first + triangle - row.triangle_offset]
    if emitter < 0:
        return 0.0
    p0 = transform_point(row.to_world, load_corner(geometry, triangle, 0))
    p1 = transform_point(row.to_world, load_corner(geometry, triangle, 1))
    p2 = transform_point(row.to_world, load_corner(geometry, triangle, 2))
    double_area_normal = wp.cross(p1 - p0, p2 - p0)
    projected = 0.5 * wp.abs(wp.dot(double_area_normal, direction))
    if projected <= 0.0:
        return 0.0
    chance = lights.weight[0] / wp.max(class_total(lights, normal), 1.0e-30) * chance_by_tree(
        lights.tree, lights.local_lamp_count + emitter, origin, normal)
    if is_close(p0 - origin, p1 - p0, p2 - p0):
        angle = sampled_angle(solid_angle(spherical_triangle(p0 - origin, p1 - origin, p2 - origin)))
        if angle > 0.0:
            return chance / angle
    return chance * t * t / projected
