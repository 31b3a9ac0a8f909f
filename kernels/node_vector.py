# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine's vector operations: Vector Math, rotations, components, weights of box projection.

Behaviour at the edges of the domains follows Cycles 5.2, kernel/svm/math_util.h, mapping_util.h and image.h.
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .geometry_math import normalize_or
from .node_math import floored_modulo, safe_divide3, safe_power, signum, truncated_modulo


@wp.func
def euler_matrix(angles: wp.vec3) -> wp.mat33:
    """Return the rotation by XYZ Euler angles: about x first, about z last."""
    cx = wp.cos(angles[0])
    cy = wp.cos(angles[1])
    cz = wp.cos(angles[2])
    sx = wp.sin(angles[0])
    sy = wp.sin(angles[1])
    sz = wp.sin(angles[2])
    return wp.mat33(
        cy * cz, sy * sx * cz - cx * sz, sy * cx * cz + sx * sz,
        cy * sz, sy * sx * sz + cx * cz, sy * cx * sz - sx * cz,
        -sy, cy * sx, cy * cx,
    )


@wp.func
def rotate_about(v: wp.vec3, axis: wp.vec3, angle: float) -> wp.vec3:
    """Return v rotated about `axis` by `angle` (Rodrigues); unchanged for an axis of length 0."""
    length = wp.length(axis)
    if length == 0.0:
        return v
    k = axis / length
    c = wp.cos(angle)
    return v * c + wp.cross(k, v) * wp.sin(angle) + k * (wp.dot(k, v) * (1.0 - c))


@wp.func
def refract_vector(incident: wp.vec3, normal: wp.vec3, eta: float) -> wp.vec3:
    """Return GLSL's refract: 0 on total internal reflection."""
    d = wp.dot(normal, incident)
    k = 1.0 - eta * eta * (1.0 - d * d)
    if k < 0.0:
        return wp.vec3(0.0)
    return incident * eta - normal * (eta * d + wp.sqrt(k))


@wp.func
def floor3(a: wp.vec3) -> wp.vec3:
    """Return the floor of each component."""
    return wp.vec3(wp.floor(a[0]), wp.floor(a[1]), wp.floor(a[2]))


@wp.func
def box_weights(normal: wp.vec3, blend: float) -> wp.vec3:
    """Return how much each side's texture counts in box projection.

    The absolute components of the normal, divided by their sum, are barycentric coordinates in a triangle whose
    corners show one side each; `blend` widens the zones where two or three sides mix.
    """
    n = wp.vec3(wp.abs(normal[0]), wp.abs(normal[1]), wp.abs(normal[2]))
    n = n / wp.max(n[0] + n[1] + n[2], 1.0e-30)
    limit = 0.5 * (1.0 + blend)
    xy = n[0] + n[1]
    xz = n[0] + n[2]
    yz = n[1] + n[2]
    if n[0] > limit * xy and n[0] > limit * xz:
        return wp.vec3(1.0, 0.0, 0.0)
    if n[1] > limit * xy and n[1] > limit * yz:
        return wp.vec3(0.0, 1.0, 0.0)
    if n[2] > limit * xz and n[2] > limit * yz:
        return wp.vec3(0.0, 0.0, 1.0)
    if blend <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    low = 0.5 * (1.0 - blend)
    if n[2] < (1.0 - limit) * xy:
        t = wp.clamp((n[0] / xy - low) / blend, 0.0, 1.0)
        return wp.vec3(t, 1.0 - t, 0.0)
    if n[0] < (1.0 - limit) * yz:
        t = wp.clamp((n[1] / yz - low) / blend, 0.0, 1.0)
        return wp.vec3(0.0, t, 1.0 - t)
    if n[1] < (1.0 - limit) * xz:
        t = wp.clamp((n[0] / xz - low) / blend, 0.0, 1.0)
        return wp.vec3(t, 0.0, 1.0 - t)
    return (n * (2.0 - limit) + wp.vec3(limit - 1.0)) / (2.0 * limit - 1.0)


@wp.func
def box_coordinate(p: wp.vec3, normal: wp.vec3, side: int) -> wp.vec3:
    """Return the coordinate on one side of the box, such that no side is mirrored."""
    if side == 0:
        return wp.vec3(wp.where(normal[0] < 0.0, 1.0 - p[1], p[1]), p[2], 0.0)
    if side == 1:
        return wp.vec3(wp.where(normal[1] > 0.0, 1.0 - p[0], p[0]), p[2], 0.0)
    return wp.vec3(wp.where(normal[2] > 0.0, 1.0 - p[1], p[1]), p[0], 0.0)


@wp.func
def vector_scalar(sub: int, a: wp.vec3, b: wp.vec3) -> float:
    """Evaluate the operations that yield a number."""
    if sub == codes.VECTOR_DOT_PRODUCT:
        return wp.dot(a, b)
    if sub == codes.VECTOR_DISTANCE:
        return wp.length(a - b)
    if sub == codes.VECTOR_LENGTH:
        return wp.length(a)
    if sub == codes.VECTOR_NORMAL_DOT:
        return wp.dot(a, wp.normalize(b))
    return (a[0] + a[1] + a[2]) / 3.0


@wp.func
def vector_geometry(sub: int, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Evaluate the geometric group."""
    if sub == codes.VECTOR_CROSS_PRODUCT:
        return wp.cross(a, b)
    if sub == codes.VECTOR_PROJECT:
        square = wp.dot(b, b)
        return wp.where(square != 0.0, b * (wp.dot(a, b) / square), wp.vec3(0.0))
    if sub == codes.VECTOR_REFLECT:
        n = normalize_or(b, b)
        return a - n * (2.0 * wp.dot(a, n))
    if sub == codes.VECTOR_REFRACT:
        return refract_vector(a, normalize_or(b, b), c[0])
    if sub == codes.VECTOR_FACEFORWARD:
        return wp.where(wp.dot(c, b) < 0.0, a, -a)
    if sub == codes.VECTOR_NORMALIZE:
        return normalize_or(a, a)
    if sub == codes.VECTOR_ROTATE:
        return euler_matrix(b) * a
    if sub == codes.VECTOR_ROTATE_INVERSE:
        return wp.transpose(euler_matrix(b)) * a
    if sub == codes.VECTOR_ROTATE_AXIS:
        return rotate_about(a, b, c[0])
    if sub == codes.VECTOR_BOX_WEIGHTS:
        return box_weights(a, b[0])
    return box_coordinate(a, b, int(c[0]))


@wp.func
def vector_componentwise(sub: int, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Evaluate the rarer operations that treat each component alike."""
    if sub == codes.VECTOR_ABSOLUTE:
        return wp.vec3(wp.abs(a[0]), wp.abs(a[1]), wp.abs(a[2]))
    if sub == codes.VECTOR_MINIMUM:
        return wp.min(a, b)
    if sub == codes.VECTOR_MAXIMUM:
        return wp.max(a, b)
    if sub == codes.VECTOR_FLOOR:
        return floor3(a)
    if sub == codes.VECTOR_CEIL:
        return -floor3(-a)
    if sub == codes.VECTOR_FRACTION:
        return a - floor3(a)
    if sub == codes.VECTOR_MODULO:
        return wp.vec3(truncated_modulo(a[0], b[0]), truncated_modulo(a[1], b[1]), truncated_modulo(a[2], b[2]))
    if sub == codes.VECTOR_WRAP:
        d = a - c
        s = b - c
        return wp.vec3(floored_modulo(d[0], s[0]), floored_modulo(d[1], s[1]), floored_modulo(d[2], s[2])) + c
    if sub == codes.VECTOR_SNAP:
        return wp.cw_mul(floor3(safe_divide3(a, b)), b)
    if sub == codes.VECTOR_SINE:
        return wp.vec3(wp.sin(a[0]), wp.sin(a[1]), wp.sin(a[2]))
    if sub == codes.VECTOR_COSINE:
        return wp.vec3(wp.cos(a[0]), wp.cos(a[1]), wp.cos(a[2]))
    if sub == codes.VECTOR_TANGENT:
        return wp.vec3(wp.tan(a[0]), wp.tan(a[1]), wp.tan(a[2]))
    if sub == codes.VECTOR_ROUND:
        return floor3(a + wp.vec3(0.5))
    if sub == codes.VECTOR_POWER:
        return wp.vec3(safe_power(a[0], b[0]), safe_power(a[1], b[1]), safe_power(a[2], b[2]))
    return wp.vec3(signum(a[0]), signum(a[1]), signum(a[2]))


@wp.func
def mean_magnitude(v: wp.vec3) -> float:
    """Return the mean absolute component."""
    return (wp.abs(v[0]) + wp.abs(v[1]) + wp.abs(v[2])) / 3.0


@wp.func
def vector_math(sub: int, a4: wp.vec4, b4: wp.vec4, c4: wp.vec4) -> wp.vec4:
    """Evaluate one vector operation (codes.VECTOR_*); w carries the filter width through sums and products."""
    a = wp.vec3(a4[0], a4[1], a4[2])
    b = wp.vec3(b4[0], b4[1], b4[2])
    c = wp.vec3(c4[0], c4[1], c4[2])
    if sub == codes.VECTOR_COMBINE:
        return wp.vec4(a[0], b[0], c[0], wp.max(a4[3], wp.max(b4[3], c4[3])))
    if sub >= codes.VECTOR_X and sub <= codes.VECTOR_Z:
        i = sub - codes.VECTOR_X
        return wp.vec4(a[i], a[i], a[i], a4[3])
    if sub == codes.VECTOR_W:
        return wp.vec4(a4[3], a4[3], a4[3], 0.0)
    if sub == codes.VECTOR_XYZ:
        return wp.vec4(a[0], a[1], a[2], 0.0)
    if sub == codes.VECTOR_WITH_W:
        return wp.vec4(a[0], a[1], a[2], b[0])
    v = wp.vec3(0.0)
    width = float(0.0)
    if sub == codes.VECTOR_ADD:
        v = a + b
        width = a4[3] + b4[3]
    elif sub == codes.VECTOR_SUBTRACT:
        v = a - b
        width = a4[3] + b4[3]
    elif sub == codes.VECTOR_MULTIPLY:
        v = wp.cw_mul(a, b)
        width = a4[3] * mean_magnitude(b) + b4[3] * mean_magnitude(a)
    elif sub == codes.VECTOR_SCALE:
        v = a * c[0]
        width = a4[3] * wp.abs(c[0])
    elif sub == codes.VECTOR_DIVIDE:
        v = safe_divide3(a, b)
        width = a4[3] * mean_magnitude(safe_divide3(wp.vec3(1.0), b))
    elif sub == codes.VECTOR_MULTIPLY_ADD:
        v = wp.cw_mul(a, b) + c
        width = a4[3] * mean_magnitude(b) + b4[3] * mean_magnitude(a) + c4[3]
    elif ((sub >= codes.VECTOR_DOT_PRODUCT and sub <= codes.VECTOR_LENGTH) or sub == codes.VECTOR_AVERAGE
          or sub == codes.VECTOR_NORMAL_DOT):
        v = wp.vec3(vector_scalar(sub, a, b))
    elif (sub <= codes.VECTOR_FACEFORWARD or sub == codes.VECTOR_NORMALIZE or sub >= codes.VECTOR_ROTATE):
        v = vector_geometry(sub, a, b, c)
        if sub >= codes.VECTOR_ROTATE:
            width = a4[3]
    else:
        v = vector_componentwise(sub, a, b, c)
        if sub == codes.VECTOR_FRACTION or sub == codes.VECTOR_MODULO or sub == codes.VECTOR_WRAP:
            width = a4[3]
    return wp.vec4(v[0], v[1], v[2], width)
