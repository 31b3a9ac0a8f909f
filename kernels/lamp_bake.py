# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that runs a lamp's program all over its table (lamp_tables.py).

What a lamp's program is told is what Cycles 5.2 tells its shaders (kernel/light/point.h, spot.h, sun.h, area.h). The
normal is the direction that light takes, of spherical lamps that of the sphere, of area lamps their own. The position
of a lamp that isn't a sphere is its centre, a sun's the direction. The UV map, which Parametric is too, is a panorama
of the normals of points, the square about a spot's or a sun's cone, and an area lamp's own square.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import PI, TWO_PI, is_finite3, safe_sqrt, transform_direction
from .lamp_tables import TABLE_DIRECTION, TABLE_PLACE
from .nodes import run
from .sampling import STEP_X, STEP_Y, fraction
from .types import LIGHT_AREA, LIGHT_ELLIPSE, LIGHT_POINT, LIGHT_SPHERE, LIGHT_SUN, Light, Scene, ShadingPoint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.struct
class LampTable:
    """What is tabled; positions are relative to the lamp's."""

    kind: int
    """TABLE_*"""
    width: int
    height: int
    pictures: int
    scale: float
    """Of the stereographic projection"""
    x: wp.vec3
    y: wp.vec3
    z: wp.vec3
    """Unit axes, z the direction in which the lamp shines"""
    across: float
    """Spots: half the cotangent of half the cone's angle. Suns: half of 1 / sin of a quarter of theirs"""
    points: int
    """Evaluated in each texel, a square number"""
    start: int
    """The program's first instruction"""


@wp.func
def lamp_uv(scene: Scene, light: Light, table: LampTable, point: ShadingPoint, place: wp.vec2) -> wp.vec2:
    """Return the UV coordinate of a point on a lamp that shines towards point.wo; `place`: on an area lamp."""
    to_lamp = scene.geometry.instances[0].to_object
    if light.kind == LIGHT_AREA:
        return place
    if light.kind == LIGHT_POINT:
        local = wp.normalize(transform_direction(to_lamp, point.normal))
        around = float(0.0)
        if local[0] != 0.0 or local[1] != 0.0:
            around = 0.5 - wp.atan2(local[0], local[1]) / TWO_PI
        return wp.vec2(around, 1.0 - wp.acos(wp.clamp(local[2], -1.0, 1.0)) / PI)
    local = transform_direction(to_lamp, point.wo)
    factor = -table.across / wp.min(local[2], -1.0e-6 * wp.length(local))
    if light.kind == LIGHT_SUN:
        factor = -table.across / wp.length(point.wo + table.z)
    return wp.vec2(0.5 + factor * local[0], 0.5 + factor * local[1])


@wp.func
def lamp_point(
    scene: Scene, light: Light, table: LampTable, x: float, y: float, picture: int, other: wp.vec2,
) -> ShadingPoint:
    """Return the point of a lamp that stands for a place on its table.

    Args:
        scene: Its only instance is the lamp.
        light: The lamp.
        table: What is tabled.
        x: In [0, 1].
        y: In [0, 1], from the bottom.
        picture: 1: the back.
        other: In [0, 1)^2, chooses what the table isn't over.
    """
    point = ShadingPoint()
    out = table.z
    place = wp.vec2(x, y)
    if table.kind == TABLE_PLACE:
        # Spread as light that leaves a diffuse surface is.
        r = safe_sqrt(other[0])
        out = (table.x * wp.cos(TWO_PI * other[1]) + table.y * wp.sin(TWO_PI * other[1])) * r
        out = out + table.z * safe_sqrt(1.0 - other[0])
    else:
        p = wp.vec2(2.0 * x - 1.0, 2.0 * y - 1.0) / table.scale
        r2 = wp.dot(p, p)
        z = (1.0 - r2) / (1.0 + r2)
        out = (table.x * p[0] + table.y * p[1]) * (2.0 / (1.0 + r2)) + table.z * wp.where(picture == 1, -z, z)
        place = other
    point.wo = out
    point.normal = out
    if light.kind == LIGHT_AREA:
        point.normal = table.z
        if (light.flags & LIGHT_ELLIPSE) != 0 and table.kind == TABLE_DIRECTION:
            r = 0.5 * safe_sqrt(other[0])
            place = wp.vec2(0.5 + r * wp.cos(TWO_PI * other[1]), 0.5 + r * wp.sin(TWO_PI * other[1]))
        point.position = light.axis_u * (place[0] - 0.5) + light.axis_v * (place[1] - 0.5)
    elif light.kind == LIGHT_SUN:
        point.position = out - light.position
    elif (light.flags & LIGHT_SPHERE) != 0:
        point.position = out * light.radius
    point.geometric_normal = point.normal
    uv = lamp_uv(scene, light, table, point, place)
    point.u = uv[1]
    point.v = 1.0 - uv[0] - uv[1]
    point.ray_depth = 1
    return point


@wp.kernel
def bake_lamp(
    # In:
    first: int,
    scene: Scene,
    light: Light,
    table: LampTable,
    distances: wp.array[float],
    # Out:
    colors_out: wp.array[wp.vec3],
):
    """Fill a table's texels, once for each distance [m], with the means of what the program emits.

    Args:
        first: Element of the first thread.
        scene: Its only instance is the lamp, its programs are the lamp's.
        light: The lamp, at its place in the world.
        table: What is tabled.
        distances: From the lamp to where its light arrives.
        colors_out: By distance, picture, row from the bottom, column.
    """
    index = first + wp.tid()
    i = index % table.width
    j = (index // table.width) % table.height
    picture = (index // (table.width * table.height)) % table.pictures
    side = int(wp.sqrt(float(table.points)) + 0.5)
    total = wp.vec3(0.0, 0.0, 0.0)
    # Not a literal: Warp would unroll the loop and build the node machine several times.
    for k in range(table.points):
        x = (float(i) + (float(k % side) + 0.5) / float(side)) / float(table.width)
        y = (float(j) + (float(k // side) + 0.5) / float(side)) / float(table.height)
        other = wp.vec2(fraction(0.5 + float(k) * STEP_X), fraction(0.5 + float(k) * STEP_Y))
        point = lamp_point(scene, light, table, x, y, picture, other)
        point.ray_length = distances[index // (table.width * table.height * table.pictures)]
        color = run(scene, point, table.start, 0.0).emission
        if is_finite3(color):
            total = total + wp.max(color, wp.vec3(0.0, 0.0, 0.0))
    colors_out[index] = total / float(table.points)
