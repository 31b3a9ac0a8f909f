# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine's arithmetic: Math and Vector Math, and what else works on numbers alone.

Behaviour at the edges of the domains (division by zero, roots of negatives) follows Cycles 5.2,
kernel/svm/math_util.h and util/math_base.h.
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .geometry_math import PI, safe_sqrt

FLOAT_EPSILON = wp.constant(1.1920929e-7)


@wp.func
def safe_divide(a: float, b: float) -> float:
    """Return a / b, 0 for b = 0."""
    if b == 0.0:
        return 0.0
    return a / b


@wp.func
def safe_divide3(a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Return a / b by component, 0 where b is 0."""
    return wp.vec3(safe_divide(a[0], b[0]), safe_divide(a[1], b[1]), safe_divide(a[2], b[2]))


@wp.func
def safe_power(a: float, b: float) -> float:
    """Return a to the power b, 0 where that is not real."""
    if b == 0.0:
        return 1.0
    if a == 0.0:
        return 0.0
    if a > 0.0:
        return wp.pow(a, b)
    if b != wp.floor(b):
        return 0.0
    magnitude = wp.pow(-a, b)
    half = b * 0.5
    return wp.where(half == wp.floor(half), magnitude, -magnitude)


@wp.func
def signum(a: float) -> float:
    """Return -1, 0 or 1."""
    return wp.where(a == 0.0, 0.0, wp.where(a < 0.0, -1.0, 1.0))


@wp.func
def wrap(value: float, high: float, low: float) -> float:
    """Return value wrapped into [low, high), low for an empty range."""
    span = high - low
    if span == 0.0:
        return low
    return value - span * wp.floor((value - low) / span)


@wp.func
def floored_modulo(a: float, b: float) -> float:
    """Return a - floor(a / b) * b, 0 for b = 0."""
    if b == 0.0:
        return 0.0
    return a - wp.floor(a / b) * b


@wp.func
def truncated_modulo(a: float, b: float) -> float:
    """Return C's fmod, 0 for b = 0."""
    if b == 0.0:
        return 0.0
    return wp.mod(a, b)


@wp.func
def pingpong(a: float, b: float) -> float:
    """Return a triangle wave of a with amplitude b."""
    if b == 0.0:
        return 0.0
    x = (a - b) / (b * 2.0)
    return wp.abs((x - wp.floor(x)) * b * 2.0 - b)


@wp.func
def smooth_minimum(a: float, b: float, k: float) -> float:
    """Return the minimum, rounded over the distance k."""
    if k == 0.0:
        return wp.min(a, b)
    h = wp.max(k - wp.abs(a - b), 0.0) / k
    return wp.min(a, b) - h * h * h * k * (1.0 / 6.0)


@wp.func
def map_factor(sub: int, a: float, low: float, high: float) -> float:
    """Return Map Range's factor of `a` between low and high, clamped for the smooth kinds."""
    t = safe_divide(a - low, high - low)
    if sub == codes.MATH_MAP_LINEAR:
        return t
    t = wp.clamp(t, 0.0, 1.0)
    if sub == codes.MATH_MAP_SMOOTHSTEP:
        return t * t * (3.0 - 2.0 * t)
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0)


@wp.func
def math_round(sub: int, a: float, b: float, c: float) -> float:
    """Evaluate the rounding group of Math."""
    if sub == codes.MATH_ROUND:
        return wp.floor(a + 0.5)
    if sub == codes.MATH_FLOOR:
        return wp.floor(a)
    if sub == codes.MATH_CEIL:
        return wp.ceil(a)
    if sub == codes.MATH_TRUNC:
        return wp.where(a >= 0.0, wp.floor(a), wp.ceil(a))
    if sub == codes.MATH_FRACT:
        return a - wp.floor(a)
    if sub == codes.MATH_MODULO:
        return truncated_modulo(a, b)
    if sub == codes.MATH_FLOORED_MODULO:
        return floored_modulo(a, b)
    if sub == codes.MATH_WRAP:
        return wrap(a, b, c)
    if sub == codes.MATH_SNAP:
        return wp.floor(safe_divide(a, b)) * b
    return pingpong(a, b)


@wp.func
def math_trigonometry(sub: int, a: float, b: float) -> float:
    """Evaluate the trigonometric group of Math."""
    if sub == codes.MATH_SINE:
        return wp.sin(a)
    if sub == codes.MATH_COSINE:
        return wp.cos(a)
    if sub == codes.MATH_TANGENT:
        return wp.tan(a)
    if sub == codes.MATH_ARCSINE:
        return wp.asin(wp.clamp(a, -1.0, 1.0))
    if sub == codes.MATH_ARCCOSINE:
        return wp.acos(wp.clamp(a, -1.0, 1.0))
    if sub == codes.MATH_ARCTANGENT:
        return wp.atan(a)
    if sub == codes.MATH_ARCTAN2:
        return wp.where(a == 0.0 and b == 0.0, 0.0, wp.atan2(a, b))
    if sub == codes.MATH_SINH:
        return wp.sinh(a)
    if sub == codes.MATH_COSH:
        return wp.cosh(a)
    if sub == codes.MATH_TANH:
        return wp.tanh(a)
    if sub == codes.MATH_RADIANS:
        return a * (PI / 180.0)
    return a * (180.0 / PI)


@wp.func
def math_function(sub: int, a: float, b: float, c: float) -> float:
    """Evaluate the functions and comparisons of Math."""
    if sub == codes.MATH_POWER:
        return safe_power(a, b)
    if sub == codes.MATH_LOGARITHM:
        return wp.where(a <= 0.0 or b <= 0.0, 0.0, safe_divide(wp.log(a), wp.log(b)))
    if sub == codes.MATH_SQRT:
        return safe_sqrt(a)
    if sub == codes.MATH_INVERSE_SQRT:
        return wp.where(a > 0.0, 1.0 / wp.sqrt(a), 0.0)
    if sub == codes.MATH_ABSOLUTE:
        return wp.abs(a)
    if sub == codes.MATH_EXPONENT:
        return wp.exp(a)
    if sub == codes.MATH_MINIMUM:
        return wp.min(a, b)
    if sub == codes.MATH_MAXIMUM:
        return wp.max(a, b)
    if sub == codes.MATH_LESS_THAN:
        return wp.where(a < b, 1.0, 0.0)
    if sub == codes.MATH_GREATER_THAN:
        return wp.where(a > b, 1.0, 0.0)
    if sub == codes.MATH_SIGN:
        return signum(a)
    if sub == codes.MATH_COMPARE:
        return wp.where(a == b or wp.abs(a - b) <= wp.max(c, FLOAT_EPSILON), 1.0, 0.0)
    if sub == codes.MATH_SMOOTH_MIN:
        return smooth_minimum(a, b, c)
    return -smooth_minimum(-a, -b, c)


@wp.func
def math(sub: int, a: float, b: float, c: float) -> float:
    """Evaluate one operation of the Math node (codes.MATH_*)."""
    if sub == codes.MATH_ADD:
        return a + b
    if sub == codes.MATH_SUBTRACT:
        return a - b
    if sub == codes.MATH_MULTIPLY:
        return a * b
    if sub == codes.MATH_DIVIDE:
        return safe_divide(a, b)
    if sub == codes.MATH_MULTIPLY_ADD:
        return a * b + c
    if sub == codes.MATH_CLAMP:
        return wp.min(wp.max(a, b), c)
    if sub == codes.MATH_UNEQUAL:
        return wp.where(a != b, 1.0, 0.0)
    if sub >= codes.MATH_MAP_SMOOTHSTEP:
        return map_factor(sub, a, b, c)
    if sub >= codes.MATH_SINE:
        return math_trigonometry(sub, a, b)
    if sub >= codes.MATH_ROUND:
        return math_round(sub, a, b, c)
    return math_function(sub, a, b, c)
