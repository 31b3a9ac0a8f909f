# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps whose node trees vary: a table of the tree's colour, looked up wherever such a lamp is sampled or met.

A table is a picture over one of three things, whichever the tree depends on: the direction that light takes, the normal
of a spherical lamp where it leaves, the place on an area lamp. Directions and normals lie on it in stereographic
projection along the lamp's axis: the cone of a spot in one square, a sphere in two, front and back. Where the tree
depends on the distance too, a second table holds the factor's logarithm over that of the distance: what falls off by
powers is exact. The mean is a part of the lamp's radiance, so that tables are about 1.

All tables are one array. Light.flags from LAMP_TABLE_SHIFT on holds the number of a lamp's header plus 1. A header has
HEADER_ROWS rows: three of the lamp's axes, their w the width and height of a picture and the scale of its projection;
then the first texel's row, that of the distances' table (0: none), both in TABLE_PAGES, the TABLE_* kind, and the
number of pictures.
"""

from __future__ import annotations

import warp as wp

from .lamp_hit import LampHit, lamp_hit
from .lamp_sample import LightSample, sample_lamp
from .packing import rgb
from .types import Light, Lights
from .wide_loads import load_vec4

LAMP_TABLE_SHIFT = wp.constant(8)
"""Of Light.flags"""

HEADER_ROWS = wp.constant(4)

TABLE_PAGES = wp.constant(1024)
"""Rows: tables begin at multiples, whose numbers a float holds"""

TABLE_DIRECTION = wp.constant(0)
TABLE_NORMAL = wp.constant(1)
TABLE_PLACE = wp.constant(2)

# The table of distances: steps to an octave, the first one's exponent, and how many there are.
DISTANCE_STEPS = wp.constant(8.0)
DISTANCE_FIRST = wp.constant(-8.0)
DISTANCE_COUNT = wp.constant(193)


@wp.func
def table_picture(tables: wp.array[wp.vec4], first: int, width: int, height: int, x: float, y: float) -> wp.vec3:
    """Return the bilinear mix of the four texels about a place in [0, 1]^2, rows bottom first."""
    u = wp.clamp(x * float(width) - 0.5, 0.0, float(width - 1))
    v = wp.clamp(y * float(height) - 0.5, 0.0, float(height - 1))
    i = int(u)
    j = int(v)
    row = first + j * width
    above = row + wp.where(j + 1 < height, width, 0)
    step = wp.where(i + 1 < width, 1, 0)
    a = load_vec4(tables, row + i)
    b = load_vec4(tables, row + i + step)
    c = load_vec4(tables, above + i)
    d = load_vec4(tables, above + i + step)
    fu = u - float(i)
    fv = v - float(j)
    return rgb((a * (1.0 - fu) + b * fu) * (1.0 - fv) + (c * (1.0 - fu) + d * fu) * fv)


@wp.func
def table_distance(tables: wp.array[wp.vec4], first: int, distance: float) -> wp.vec3:
    """Return the factor of a distance [m]; beyond the table its ends go on as powers."""
    at = (wp.log2(wp.max(distance, 1.0e-20)) - DISTANCE_FIRST) * DISTANCE_STEPS
    i = int(wp.clamp(at, 0.0, float(DISTANCE_COUNT - 2)))
    f = at - float(i)
    a = load_vec4(tables, first + i)
    b = load_vec4(tables, first + i + 1)
    return wp.vec3(
        wp.pow(2.0, wp.min(a[0] + (b[0] - a[0]) * f, 120.0)), wp.pow(2.0, wp.min(a[1] + (b[1] - a[1]) * f, 120.0)),
        wp.pow(2.0, wp.min(a[2] + (b[2] - a[2]) * f, 120.0)))


@wp.func
def lamp_factor(
    tables: wp.array[wp.vec4], light: Light, position: wp.vec3, direction: wp.vec3, distance: float,
) -> wp.vec3:
    """Return the factor on the radiance of a lamp that has a table.

    Args:
        tables: Of all lamps.
        light: The lamp.
        position: Where its light arrives.
        direction: From there to the lamp, unit length.
        distance: To the point on the lamp [m].
    """
    header = HEADER_ROWS * ((light.flags >> LAMP_TABLE_SHIFT) - 1)
    h0 = load_vec4(tables, header)
    h1 = load_vec4(tables, header + 1)
    h2 = load_vec4(tables, header + 2)
    h3 = load_vec4(tables, header + 3)
    kind = int(h3[2])
    width = int(h0[3])
    height = int(h1[3])
    first = int(h3[0]) * TABLE_PAGES
    leaving = -direction
    if kind != TABLE_DIRECTION:
        leaving = position + direction * distance - light.position
    local = wp.vec3(wp.dot(rgb(h0), leaving), wp.dot(rgb(h1), leaving), wp.dot(rgb(h2), leaving))
    scale = float(1.0)
    if kind != TABLE_PLACE:
        local = wp.normalize(local)
        scale = h2[3] / (1.0 + wp.abs(local[2]))
        if local[2] < 0.0 and h3[3] > 1.0:
            first = first + width * height
    factor = table_picture(tables, first, width, height, 0.5 + 0.5 * scale * local[0], 0.5 + 0.5 * scale * local[1])
    if h3[1] > 0.0:
        factor = wp.cw_mul(factor, table_distance(tables, int(h3[1]) * TABLE_PAGES, distance))
    return factor


@wp.func
def draw_lamp(lights: Lights, lamp: int, position: wp.vec3, u: wp.vec2) -> LightSample:
    """Draw a direction from `position` to a lamp."""
    s = sample_lamp(lights.lamps[lamp], position, u)
    if lights.lamps[lamp].flags >= (1 << LAMP_TABLE_SHIFT) and s.kind >= 0:
        factor = lamp_factor(lights.tables, lights.lamps[lamp], position, s.wi, s.distance)
        s.radiance = wp.cw_mul(s.radiance, factor)
    return s


@wp.func
def meet_lamp(lights: Lights, lamp: int, origin: wp.vec3, direction: wp.vec3, t_max: float) -> LampHit:
    """Intersect a ray with a lamp of finite size."""
    hit = lamp_hit(lights.lamps[lamp], origin, direction, t_max)
    if lights.lamps[lamp].flags >= (1 << LAMP_TABLE_SHIFT) and hit.t > 0.0:
        factor = lamp_factor(lights.tables, lights.lamps[lamp], origin, direction, hit.t)
        hit.radiance = wp.cw_mul(hit.radiance, factor)
    return hit
