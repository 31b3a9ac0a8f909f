# SPDX-License-Identifier: GPL-3.0-or-later
"""Who shows a light in a reflection: the traced ray that meets it, or the light sample of the direct pass.

Both can find the same light. Each takes a share, and the shares add up to 1 wherever both are evaluated: w_ray =
zone * p_b^2 / (p_b^2 + p_l^2), w_light = 1 - w_ray, the form of the power heuristic (Veach 1997, beta = 2). p_b is the
density of the surface's lobes, p_l about that of light sampling: of the place on the light, times a chance of the
light. Any function of receiver, light and direction would keep the mean; this one keeps each part's values below the
light's radiance. The density of resampled candidates itself has no closed form. Plain densities (the balance
heuristic) leave twice the light to samples on mirrors, and to rays sparks of small lamps on rough surfaces.

The zone is the chance that a pixel's sample is a ray at all. A ray, once drawn, weighs by w_ray / zone: the chance has
been taken. Rays that leave no primary surface, or that went through glass or over a mirror before they meet
a light, count in full: no light sample stands for them. They say so with a density of 0. Rays whose lights are all
sampled say -1.
"""

from __future__ import annotations

import warp as wp

from .environment_split import EnvironmentSplit
from .gbuffer import SurfaceMaterial
from .geometry_math import PI, TWO_PI, max_component, power_heuristic, safe_sqrt, sqr
from .ggx import SPECULAR_ALPHA2
from .intersect import world_vertex
from .lamp_sample import LightSample
from .lamp_tables import meet_lamp
from .light_candidate import CANDIDATE_EMITTER, CANDIDATE_LAMP, Candidate, candidate_index, candidate_kind
from .light_linking import is_lit
from .light_tree import chance_by_tree
from .lights import lamp_chance
from .reflection_types import REFLECTANCE_MIN, ReflectionOptions, fading, ray_share, sampled_share
from .solid_angle import angle_of_triangle
from .specular_lobes import surface_alpha
from .types import LIGHT_HITTABLE, Lights, LightTree, Scene

# So many local lamps are tested one by one; more are found through the tree of lights.
LAMPS_IN_A_ROW = wp.constant(16)

# Roughness that a lobe has at least for light samples of lights far smaller than it is: a ray can't meet those, the
# highlight would be finer than a pixel.
SMALL_LIGHT_ROUGHNESS = wp.constant(0.1)

# Lobe's solid angle over the light's from which it begins to be so, and over which it becomes so in full.
SMALL_LIGHT = wp.constant(10.0)
SMALL_LIGHT_RANGE = wp.constant(90.0)

# Largest ratio of densities that is told apart: its square fits a float.
LARGE_RATIO = wp.constant(1.0e9)

# Resampling looks at several lights for each that it takes: one with this inverse chance is found about surely.
LIGHT_TRIES = wp.constant(2.0)


@wp.func
def ray_zone(options: ReflectionOptions, m: SurfaceMaterial) -> float:
    """Return the chance that a surface's reflection is found by a traced ray; by the sharper of its two lobes.

    The one function for it: whoever chooses between rays and probes draws by this, for all lobes of the pixel.
    """
    if max_component(m.specular) <= REFLECTANCE_MIN:
        return 0.0
    roughness = m.roughness
    if m.coat > REFLECTANCE_MIN:
        roughness = wp.min(roughness, m.coat_roughness)
    return ray_share(options, roughness, max_component(m.specular))


@wp.func
def shown_zone(options: ReflectionOptions, m: SurfaceMaterial) -> float:
    """Return ray_zone times what the composite keeps of samples, where settings let both zones overlap."""
    roughness = m.roughness
    if m.coat > REFLECTANCE_MIN:
        roughness = wp.min(roughness, m.coat_roughness)
    return ray_zone(options, m) * sampled_share(options, roughness)


@wp.func
def ray_part(density: float, light_density: float) -> float:
    """Return a drawn ray's share of a light.

    Args:
        density: Of the lobes in the ray's direction (lobes_pdf) at the primary surface; 0: the ray counts in full.
        light_density: From lamp_density and its like; 0: the light isn't sampled.
    """
    if density <= 0.0 or light_density <= 0.0:
        return 1.0
    odds = sqr(wp.min(density / light_density, LARGE_RATIO))
    return odds / (odds + 1.0)


@wp.func
def light_part(density: float, light_density: float, zone: float) -> float:
    """Return a light sample's share: 1 - zone * ray_part, without cancellation."""
    if density <= 0.0 or zone <= 0.0:
        return 1.0
    odds = sqr(wp.min(light_density / density, LARGE_RATIO))
    return (odds + 1.0 - zone) / (odds + 1.0)


@wp.func
def likely(chance: float) -> float:
    """Return about how surely candidates find a light that one candidate finds by `chance`."""
    return wp.min(LIGHT_TRIES * chance, 1.0)


@wp.func
def local_density(lights: Lights, entry: int, pdf: float, position: wp.vec3) -> float:
    """Return the density that stands for sampling an entry of the light tree; 0 for a tree without power."""
    if lights.tree.high[1][3] <= 0.0:
        return 0.0
    if lights.tree.levels == 0:
        return pdf
    return pdf * likely(chance_by_tree(lights.tree, entry, position, wp.vec3(0.0, 0.0, 0.0)))


@wp.func
def lamp_density(lights: Lights, lamp: int, pdf: float, position: wp.vec3) -> float:
    """Return the density that stands for sampling a lamp.

    Args:
        lights: All lights.
        lamp: Which.
        pdf: Of its place alone: LampHit.pdf or that of a replayed sample.
        position: Of the receiver.
    """
    if lamp >= lights.local_lamp_count:
        return pdf
    return local_density(lights, lamp, pdf, position)


@wp.func
def texel_density(split: EnvironmentSplit, texel: int, pdf: float) -> float:
    """Return the density that stands for sampling a texel of the world's excess; `pdf` of the place in it."""
    return pdf * likely(split.table.weight[texel])


@wp.func
def candidate_density(
    scene: Scene, split: EnvironmentSplit, candidate: Candidate, pdf: float, position: wp.vec3,
) -> float:
    """Return the density that stands for sampling a candidate's light; `pdf` as replayed at `position`."""
    kind = candidate_kind(candidate)
    index = candidate_index(candidate)
    if kind == CANDIDATE_LAMP:
        return lamp_density(scene.lights, index, pdf, position)
    if kind == CANDIDATE_EMITTER:
        return local_density(scene.lights, scene.lights.local_lamp_count + index, pdf, position)
    return texel_density(split, index, pdf)


@wp.func
def light_side_share(
    scene: Scene, split: EnvironmentSplit, candidate: Candidate, s: LightSample, position: wp.vec3, density: float,
    zone: float,
) -> float:
    """Return the factor on the specular part of a light sample.

    Args:
        scene: The scene.
        split: How the world is split.
        candidate: The sample's.
        s: The sample, as replayed at `position`.
        position: Of the receiver.
        density: lobes_pdf of the receiver in the sample's direction.
        zone: From shown_zone.
    """
    if s.delta == 1 or zone <= 0.0:
        return 1.0
    return light_part(density, candidate_density(scene, split, candidate, s.pdf, position), zone)


@wp.func
def is_singular(roughness: float) -> bool:
    """Return whether a lobe is a mirror to the path tracer, too (ggx.SPECULAR_ALPHA2): it samples no lights for it."""
    return sqr(sqr(roughness)) <= SPECULAR_ALPHA2


@wp.func
def sample_roughness(roughness: float, s: LightSample) -> float:
    """Return the roughness with which a lobe shows a light sample, where reflection rays share the light.

    All of the light of a tiny lamp comes by its samples, so that a wider lobe keeps the sum of both.
    """
    if roughness >= SMALL_LIGHT_ROUGHNESS:
        return roughness
    small = float(1.0)
    if s.delta == 0:
        small = 1.0 - fading(4.0 * PI * sqr(surface_alpha(roughness)) * s.pdf, SMALL_LIGHT, SMALL_LIGHT_RANGE)
    return wp.lerp(roughness, SMALL_LIGHT_ROUGHNESS, small)


@wp.func
def meets_node(tree: LightTree, node: int, origin: wp.vec3, inverse: wp.vec3, t_max: float) -> bool:
    """Return whether a ray meets the bounds of a node (slabs; the bounds are widened by the float error)."""
    low = tree.low[node]
    high = tree.high[node]
    near = float(0.0)
    far = float(t_max)
    for axis in range(3):
        slack = 1.0e-6 * wp.max(wp.abs(low[axis]), wp.abs(high[axis])) + 1.0e-20
        a = (low[axis] - slack - origin[axis]) * inverse[axis]
        b = (high[axis] + slack - origin[axis]) * inverse[axis]
        near = wp.max(near, wp.min(a, b))
        far = wp.min(far, wp.max(a, b))
    return near <= far


@wp.func
def lamp_light(
    lights: Lights, lamp: int, visibility: int, receives: int, density: float, shared: float, origin: wp.vec3,
    direction: wp.vec3, t_max: float,
) -> wp.vec3:
    """Return the radiance of a lamp times the ray's share, if the ray meets it before t_max."""
    light = lights.lamps[lamp]
    if (light.flags & LIGHT_HITTABLE) != 0 and (light.visibility & visibility) != 0:
        hit = meet_lamp(lights, lamp, origin, direction, t_max)
        if hit.t > 0.0 and is_lit(light.visibility, receives):
            share = float(1.0)
            if density > 0.0:
                share = ray_part(density, lamp_density(lights, lamp, hit.pdf, origin))
            elif shared > 0.0:
                chance = lamp_chance(lights, lamp, origin, wp.vec3(0.0, 0.0, 0.0))
                share = power_heuristic(shared, hit.pdf * chance)
            return hit.radiance * share
    return wp.vec3(0.0, 0.0, 0.0)


@wp.func
def safe_inverse(x: float) -> float:
    """Return 1 / x, large instead of infinite: a product with it is never NaN."""
    if wp.abs(x) < 1.0e-18:
        return wp.where(x < 0.0, -1.0e18, 1.0e18)
    return 1.0 / x


@wp.func
def tree_light(
    lights: Lights, visibility: int, receives: int, density: float, shared: float, origin: wp.vec3, direction: wp.vec3,
    t_max: float,
) -> wp.vec3:
    """Return the radiance of all local lamps that a ray meets, found through the tree (a heap, so without a stack)."""
    total = wp.vec3(0.0, 0.0, 0.0)
    inverse = wp.vec3(safe_inverse(direction[0]), safe_inverse(direction[1]), safe_inverse(direction[2]))
    leaves = 1 << lights.tree.levels
    node = int(1)
    while node > 0:
        met = meets_node(lights.tree, node, origin, inverse, t_max)
        if met and node < leaves:
            node = 2 * node
        else:
            if met:
                entry = lights.tree.entries[node - leaves]
                if entry >= 0 and entry < lights.local_lamp_count:
                    total = total + lamp_light(
                        lights, entry, visibility, receives, density, shared, origin, direction, t_max)
            # The next subtree: up while this is a second child, then to the sibling.
            while node > 1 and (node & 1) == 1:
                node = node >> 1
            node = wp.where(node == 1, 0, node + 1)
    return total


@wp.func
def lamps_along(
    lights: Lights, visibility: int, receives: int, density: float, shared: float, origin: wp.vec3, direction: wp.vec3,
    t_max: float,
) -> wp.vec3:
    """Return the radiance of all lamps that a ray meets before its hit, each times the ray's share; they hide nothing.

    Args:
        lights: All lights.
        visibility: The kind of ray: VISIBLE_CAMERA, VISIBLE_GLOSSY, VISIBLE_TRANSMISSION.
        receives: Instance.receives of what the ray has left; -1: all lamps count.
        density: lobes_pdf of the primary surface in this direction; 0 where the ray counts in full.
        shared: From shared_with_samples, where `density` is 0.
        origin: Of the ray; where `density` counts, of the primary surface.
        direction: Unit length.
        t_max: Distance to the hit [m], FAR where it met none.
    """
    total = wp.vec3(0.0, 0.0, 0.0)
    start = int(0)
    if lights.local_lamp_count > LAMPS_IN_A_ROW:
        total = tree_light(lights, visibility, receives, density, shared, origin, direction, t_max)
        start = lights.local_lamp_count
    for i in range(start, lights.lamp_count):
        total = total + lamp_light(lights, i, visibility, receives, density, shared, origin, direction, t_max)
    return total


@wp.func
def emitter_of(scene: Scene, instance: int, triangle: int) -> int:
    """Return which emissive triangle a triangle is; -1 where it is not sampled as a light."""
    lights = scene.lights
    if lights.class_count == 0:
        return -1
    first = lights.emitter_offset[instance]
    if first < 0:
        return -1
    return lights.emitter_index[first + triangle - scene.geometry.instances[instance].triangle_offset]


@wp.func
def emitter_ray_share(
    scene: Scene, density: float, instance: int, triangle: int, origin: wp.vec3, direction: wp.vec3, t: float,
) -> float:
    """Return a ray's share of the emission of the triangle that it has met.

    Args:
        scene: The scene.
        density: lobes_pdf of the primary surface in this direction; 0 where the ray counts in full.
        instance: That was met.
        triangle: Of all triangles.
        origin: Of the ray, on the primary surface.
        direction: Unit length.
        t: Distance from `origin` [m], transparent layers between included.
    """
    if density == 0.0:
        return 1.0
    emitter = emitter_of(scene, instance, triangle)
    if emitter < 0:
        return 1.0
    if density < 0.0:
        return 0.0
    geometry = scene.geometry
    to_world = geometry.instances[instance].to_world
    vertices = geometry.triangles[triangle]
    p0 = world_vertex(geometry, to_world, vertices[0])
    a = world_vertex(geometry, to_world, vertices[1]) - p0
    b = world_vertex(geometry, to_world, vertices[2]) - p0
    projected = 0.5 * wp.abs(wp.dot(wp.cross(a, b), direction))
    if projected <= 0.0:
        return 1.0
    # As direct_emitters.sample_baked draws it.
    pdf = t * t / projected
    angle = angle_of_triangle(p0 - origin, a, b)
    if angle > 0.0:
        pdf = 1.0 / angle
    return ray_part(density, local_density(scene.lights, scene.lights.local_lamp_count + emitter, pdf, origin))


@wp.func
def world_ray_share(split: EnvironmentSplit, density: float, direction: wp.vec3) -> float:
    """Return a ray's share of the world's excess (excess_radiance); the soft part belongs to rays in full.

    A miss brings soft_radiance(L, split.threshold) + excess_radiance(L, split.threshold) * share.

    Args:
        split: How the world is split.
        density: lobes_pdf of the primary surface in this direction; 0 where the ray counts in full.
        direction: Unit length.
    """
    if density < 0.0:
        return 0.0
    if density == 0.0 or split.share <= 0.0:
        return 1.0
    width = split.table.width
    height = split.table.height
    around = wp.atan2(direction[1], direction[0]) / TWO_PI
    x = wp.where(around < 0.0, around + 1.0, around)
    y = wp.acos(wp.clamp(direction[2], -1.0, 1.0)) / PI
    i = wp.clamp(int(x * float(width)), 0, width - 1)
    j = wp.clamp(int(y * float(height)), 0, height - 1)
    # All of the texel goes by the density of its box, which light samples look at alone: what little light the box
    # leaves out would be sparks.
    box = split.box[j * width + i]
    across = float((box >> wp.uint32(8)) & wp.uint32(255)) / float(split.points)
    down = float(box >> wp.uint32(24)) / float(split.points)
    sin_theta = wp.max(safe_sqrt(1.0 - direction[2] * direction[2]), 1.0e-6)
    pdf = float(width * height) / (TWO_PI * PI * sin_theta * wp.max(across * down, 1.0e-6))
    return ray_part(density, texel_density(split, j * width + i, pdf))
