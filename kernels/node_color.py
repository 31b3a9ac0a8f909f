# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine's colour operations: blend modes, colour models, corrections, black bodies.

Behaviour follows Cycles 5.2, kernel/svm/color_util.h, util/color.h and svm/math_util.h (black body).
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes


@wp.func
def rgb_to_hsv(rgb: wp.vec3) -> wp.vec3:
    """Return hue, saturation, value (Smith 1978); hue in [0, 1)."""
    high = wp.max(rgb[0], wp.max(rgb[1], rgb[2]))
    delta = high - wp.min(rgb[0], wp.min(rgb[1], rgb[2]))
    if high == 0.0 or delta == 0.0:
        return wp.vec3(0.0, 0.0, high)
    c = (wp.vec3(high) - rgb) / delta
    h = float(0.0)
    if rgb[0] == high:
        h = c[2] - c[1]
    elif rgb[1] == high:
        h = 2.0 + c[0] - c[2]
    else:
        h = 4.0 + c[1] - c[0]
    h = h / 6.0
    # No wp.where here and below: it is not there where the builder folds constants.
    if h < 0.0:
        h = h + 1.0
    return wp.vec3(h, delta / high, high)


@wp.func
def hsv_to_rgb(hsv: wp.vec3) -> wp.vec3:
    """Return the colour of a hue, saturation and value; hue 1 is hue 0."""
    s = hsv[1]
    v = hsv[2]
    if s == 0.0:
        return wp.vec3(v)
    h = hsv[0] * 6.0
    if hsv[0] == 1.0:
        h = 0.0
    sector = wp.floor(h)
    f = h - sector
    p = v * (1.0 - s)
    q = v * (1.0 - s * f)
    t = v * (1.0 - s * (1.0 - f))
    if sector == 0.0:
        return wp.vec3(v, t, p)
    if sector == 1.0:
        return wp.vec3(q, v, p)
    if sector == 2.0:
        return wp.vec3(p, v, t)
    if sector == 3.0:
        return wp.vec3(p, q, v)
    if sector == 4.0:
        return wp.vec3(t, p, v)
    return wp.vec3(v, p, q)


@wp.func
def rgb_to_hsl(rgb: wp.vec3) -> wp.vec3:
    """Return hue, saturation, lightness."""
    high = wp.max(rgb[0], wp.max(rgb[1], rgb[2]))
    low = wp.min(rgb[0], wp.min(rgb[1], rgb[2]))
    lightness = wp.min(1.0, (high + low) * 0.5)
    if high == low:
        return wp.vec3(0.0, 0.0, lightness)
    delta = high - low
    s = wp.where(lightness > 0.5, delta / (2.0 - high - low), delta / (high + low))
    return wp.vec3(rgb_to_hsv(rgb)[0], s, lightness)


@wp.func
def hsl_to_rgb(hsl: wp.vec3) -> wp.vec3:
    """Return the colour of a hue, saturation and lightness."""
    h = hsl[0] * 6.0
    r = wp.clamp(wp.abs(h - 3.0) - 1.0, 0.0, 1.0)
    g = wp.clamp(2.0 - wp.abs(h - 2.0), 0.0, 1.0)
    b = wp.clamp(2.0 - wp.abs(h - 4.0), 0.0, 1.0)
    chroma = (1.0 - wp.abs(2.0 * hsl[2] - 1.0)) * hsl[1]
    return (wp.vec3(r, g, b) - wp.vec3(0.5)) * chroma + wp.vec3(hsl[2])


@wp.func
def mix_channel(sub: int, t: float, a: float, b: float) -> float:
    """Blend one channel by the modes that branch on its value."""
    if sub == codes.MIX_OVERLAY:
        if a < 0.5:
            return a * (1.0 - t + 2.0 * t * b)
        return 1.0 - (1.0 - t + 2.0 * t * (1.0 - b)) * (1.0 - a)
    if sub == codes.MIX_DIVIDE:
        if b == 0.0:
            return a
        return (1.0 - t) * a + t * a / b
    if sub == codes.MIX_DODGE:
        if a == 0.0:
            return a
        rest = 1.0 - t * b
        if rest <= 0.0:
            return 1.0
        return wp.min(a / rest, 1.0)
    rest = 1.0 - t + t * b
    if rest <= 0.0:
        return 0.0
    return wp.clamp(1.0 - (1.0 - a) / rest, 0.0, 1.0)


@wp.func
def mix_hsv(sub: int, t: float, a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Blend in terms of hue, saturation and value."""
    ha = rgb_to_hsv(a)
    hb = rgb_to_hsv(b)
    if sub == codes.MIX_VALUE:
        return hsv_to_rgb(wp.vec3(ha[0], ha[1], (1.0 - t) * ha[2] + t * hb[2]))
    if sub == codes.MIX_SATURATION:
        if ha[1] == 0.0:
            return a
        return hsv_to_rgb(wp.vec3(ha[0], (1.0 - t) * ha[1] + t * hb[1], ha[2]))
    if hb[1] == 0.0:
        return a
    s = wp.where(sub == codes.MIX_COLOR, hb[1], ha[1])
    return wp.lerp(a, hsv_to_rgb(wp.vec3(hb[0], s, ha[2])), t)


@wp.func
def mix_color(sub: int, t: float, a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Blend colour b over a with the factor t (codes.MIX_*); nothing is clamped."""
    if sub == codes.MIX_MIX:
        return a * (1.0 - t) + b * t
    if sub == codes.MIX_MULTIPLY:
        return wp.lerp(a, wp.cw_mul(a, b), t)
    if sub == codes.MIX_ADD:
        return a + b * t
    if sub == codes.MIX_SUBTRACT:
        return a - b * t
    if sub == codes.MIX_DIFFERENCE:
        d = a - b
        return wp.lerp(a, wp.vec3(wp.abs(d[0]), wp.abs(d[1]), wp.abs(d[2])), t)
    if sub == codes.MIX_EXCLUSION:
        return wp.max(wp.lerp(a, a + b - wp.cw_mul(a, b) * 2.0, t), wp.vec3(0.0))
    if sub == codes.MIX_DARKEN:
        return wp.lerp(a, wp.min(a, b), t)
    if sub == codes.MIX_LIGHTEN:
        return wp.lerp(a, wp.max(a, b), t)
    if sub == codes.MIX_LINEAR_LIGHT:
        return a + (b * 2.0 - wp.vec3(1.0)) * t
    if sub >= codes.MIX_HUE and sub <= codes.MIX_COLOR:
        return mix_hsv(sub, t, a, b)
    one = wp.vec3(1.0)
    if sub == codes.MIX_SCREEN:
        return one - wp.cw_mul(wp.vec3(1.0 - t) + (one - b) * t, one - a)
    if sub == codes.MIX_SOFT_LIGHT:
        screen = one - wp.cw_mul(one - b, one - a)
        return a * (1.0 - t) + (wp.cw_mul(wp.cw_mul(one - a, b), a) + wp.cw_mul(a, screen)) * t
    return wp.vec3(mix_channel(sub, t, a[0], b[0]), mix_channel(sub, t, a[1], b[1]), mix_channel(sub, t, a[2], b[2]))


@wp.func
def gamma_channel(a: float, exponent: float) -> float:
    """Return a to the power `exponent`; numbers that aren't positive stay as they are."""
    if a > 0.0:
        return wp.pow(a, exponent)
    return a


@wp.func
def hue_saturation(color: wp.vec3, params: wp.vec3, factor: float) -> wp.vec3:
    """Shift hue and scale saturation and value (params), mixed by `factor`."""
    hsv = rgb_to_hsv(color)
    h = hsv[0] + params[0] + 0.5
    changed = hsv_to_rgb(wp.vec3(h - wp.floor(h), wp.clamp(hsv[1] * params[1], 0.0, 1.0), hsv[2] * params[2]))
    return wp.max(changed * factor + color * (1.0 - factor), wp.vec3(0.0))


@wp.func
def blackbody(t: float) -> wp.vec3:
    """Return the colour of a black body of t kelvin, linear Rec.709, luminance 1.

    Piecewise fit a/t + b t + c (r, g) and a cubic (b) of OpenShadingLanguage, as in Cycles' kernel/tables.h.
    """
    if t >= 12000.0:
        return wp.vec3(0.8262954810464208, 0.9945080501520986, 1.566307710274283)
    if t < 800.0:
        return wp.vec3(5.413294490189271, -0.20319390035873933, -0.0822535242887164)
    r = wp.vec3(3.78717450e3, 9.35907826e-6, 3.99075871e-1)
    g = wp.vec3(-5.00799571e2, -4.59832026e-6, 1.09098763)
    b = wp.vec4(6.72650283e-13, -2.73078809e-8, 4.24098264e-4, -7.52335691e-1)
    if t < 965.0:
        r = wp.vec3(1.61919106e3, -2.05010916e-3, 5.02995757)
        g = wp.vec3(-4.88999748e2, 6.04330754e-4, -7.55807526e-2)
        b = wp.vec4(5.96945309e-11, -4.85742887e-8, -9.70622247e-5, -4.07936148e-3)
    elif t < 1167.0:
        r = wp.vec3(2.48845471e3, -1.11330907e-3, 3.22621544)
        g = wp.vec3(-7.55994277e2, 3.16730098e-4, 4.78306139e-1)
        b = wp.vec4(2.40430366e-11, 5.55021075e-8, -1.98503712e-4, 2.89312858e-2)
    elif t < 1449.0:
        r = wp.vec3(3.34143193e3, -4.86551192e-4, 1.76486769)
        g = wp.vec3(-1.02363977e3, 1.20223470e-4, 9.36662319e-1)
        b = wp.vec4(-1.40949732e-11, 1.89878968e-7, -3.56632824e-4, 9.10767778e-2)
    elif t < 1902.0:
        r = wp.vec3(4.09461742e3, -1.27446582e-4, 7.25731635e-1)
        g = wp.vec3(-1.26571316e3, 4.87340896e-6, 1.27054498)
        b = wp.vec4(-3.61460868e-11, 2.84822009e-7, -4.93211319e-4, 1.56723440e-1)
    elif t < 3315.0:
        r = wp.vec3(4.67028036e3, 2.91258199e-5, 1.26703442e-1)
        g = wp.vec3(-1.42529332e3, -4.01150431e-5, 1.43972784)
        b = wp.vec4(-1.97075738e-11, 1.75359352e-7, -2.50542825e-4, -2.22783266e-2)
    elif t < 6365.0:
        r = wp.vec3(4.59509185e3, 2.87495649e-5, 1.50345020e-1)
        g = wp.vec3(-1.17554822e3, -2.16378048e-5, 1.30408023)
        b = wp.vec4(-1.61997957e-13, -1.64216008e-8, 3.86216271e-4, -7.38077418e-1)
    return wp.vec3(
        r[0] / t + r[1] * t + r[2], g[0] / t + g[1] * t + g[2], ((b[0] * t + b[1]) * t + b[2]) * t + b[3])


@wp.func
def adjust_color(sub: int, a: wp.vec3, b: wp.vec3, c: wp.vec3, weights: wp.vec3) -> wp.vec3:
    """Evaluate one colour operation (codes.COLOR_*) on a with the parameters b and c."""
    if sub == codes.COLOR_LUMINANCE:
        return wp.vec3(wp.dot(a, weights))
    if sub == codes.COLOR_CLAMP:
        return wp.min(wp.max(a, wp.vec3(0.0)), wp.vec3(1.0))
    if sub == codes.COLOR_INVERT:
        return (wp.vec3(1.0) - a) * b[0] + a * (1.0 - b[0])
    if sub == codes.COLOR_GAMMA:
        return wp.vec3(gamma_channel(a[0], b[0]), gamma_channel(a[1], b[0]), gamma_channel(a[2], b[0]))
    if sub == codes.COLOR_BRIGHT_CONTRAST:
        return wp.max(a * (1.0 + c[0]) + wp.vec3(b[0] - c[0] * 0.5), wp.vec3(0.0))
    if sub == codes.COLOR_HUE_SATURATION:
        return hue_saturation(a, b, c[0])
    if sub == codes.COLOR_FROM_HSV:
        return hsv_to_rgb(a)
    if sub == codes.COLOR_FROM_HSL:
        return hsl_to_rgb(a)
    if sub == codes.COLOR_TO_HSV:
        return rgb_to_hsv(a)
    if sub == codes.COLOR_TO_HSL:
        return rgb_to_hsl(a)
    return blackbody(a[0])
