# SPDX-License-Identifier: GPL-3.0-or-later
"""The composite: emission, direct and indirect light with the surfaces' colours; and Blender's diffuse light passes."""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, load_material
from .geometry_math import is_finite3
from .packing import HALF_MAX, from_half, rgb, rgba, to_half, unpack_normal
from .view import SKY_DEPTH, View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.struct
class LightPasses:
    """Sums over frames at rest, one entry a pixel: divided by each other they are Blender's light passes."""

    direct: wp.array[wp.vec3]
    """Sum of diffuse albedo * direct diffuse light, exposed"""
    indirect: wp.array[wp.vec3]
    """Sum of diffuse albedo * indirect diffuse light, exposed"""
    albedo: wp.array[wp.vec4]
    """Sum of the diffuse albedo; w = frames"""


@wp.struct
class LightShares:
    """What a pixel shows, by where the light comes from; exposed."""

    emission: wp.vec4
    """w = alpha"""
    albedo: wp.vec3
    """Of diffuse reflection and transmission together"""
    diffuse_direct: wp.vec3
    diffuse_indirect: wp.vec3
    specular_direct: wp.vec3
    specular_indirect: wp.vec3


@wp.func
def light_or_none(light: wp.vec4h) -> wp.vec3:
    """Return filtered light; none where it is not finite, so that one bad pixel stays one and lasts one frame."""
    c = rgb(from_half(light))
    if not is_finite3(c):
        c = wp.vec3(0.0, 0.0, 0.0)
    return c


# What would be left of a white sky where the shading normal leans away by a right angle.
LEANING_REST = wp.constant(0.11)


@wp.func
def seen_share(gbuffer: GBuffer, pixel: int) -> float:
    """Return the share of a white sky that a surface reflects whose shading normal leans away from its geometric one.

    Light from below the surface does not exist: of the hemisphere about the shading normal (1 + cos) / 2 is left,
    weighed by the cosine, and the shadowing of bumps (normals.bump_shadowing) takes its part. Direct light knows
    that; irradiance from probes is that of the whole hemisphere. The line fits both together within 1 % up to 40
    degrees.
    """
    if gbuffer.normal[pixel] == gbuffer.geometric_normal[pixel]:
        return 1.0
    cosine = wp.dot(unpack_normal(gbuffer.normal[pixel]), unpack_normal(gbuffer.geometric_normal[pixel]))
    return LEANING_REST + (1.0 - LEANING_REST) * wp.clamp(cosine, 0.0, 1.0)


@wp.func
def light_shares(
    gbuffer: GBuffer, direct_diffuse: wp.array[wp.vec4h], direct_specular: wp.array[wp.vec4h],
    irradiance: wp.array[wp.vec4h], specular_ratio: wp.array[wp.float16], pixel: int,
) -> LightShares:
    """Multiply a pixel's demodulated light by the surface's colours; a reflection lobe gets `specular_ratio` of it."""
    s = LightShares()
    none = wp.vec3(0.0, 0.0, 0.0)
    e = from_half(gbuffer.emission[pixel])
    emitted = rgb(e)
    if not is_finite3(emitted):
        emitted = none
    alpha = float(1.0)
    if wp.isfinite(e[3]):
        alpha = wp.clamp(e[3], 0.0, 1.0)
    s.emission = rgba(emitted, alpha)
    s.albedo = none
    s.diffuse_direct = none
    s.diffuse_indirect = none
    s.specular_direct = none
    s.specular_indirect = none
    if gbuffer.depth[pixel] < SKY_DEPTH:
        m = load_material(gbuffer, pixel)
        indirect = light_or_none(irradiance[pixel]) * seen_share(gbuffer, pixel)
        s.albedo = m.diffuse + m.translucent
        s.diffuse_direct = wp.cw_mul(s.albedo, light_or_none(direct_diffuse[pixel]))
        s.diffuse_indirect = wp.cw_mul(s.albedo, indirect)
        s.specular_direct = wp.cw_mul(m.specular, light_or_none(direct_specular[pixel]))
        ratio = float(specular_ratio[pixel])
        if not wp.isfinite(ratio):
            ratio = 1.0
        s.specular_indirect = wp.cw_mul(m.specular, indirect) * ratio
    return s


@wp.kernel
def compose(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    direct_diffuse: wp.array[wp.vec4h],
    direct_specular: wp.array[wp.vec4h],
    irradiance: wp.array[wp.vec4h],
    specular_ratio: wp.array[wp.float16],
    # Out:
    color_out: wp.array[wp.vec4h],
):
    """Add up what each pixel shows; 70 bytes read and 8 written a pixel."""
    pixel = first + wp.tid()
    s = light_shares(gbuffer, direct_diffuse, direct_specular, irradiance, specular_ratio, pixel)
    c = rgb(s.emission) + s.diffuse_direct + s.diffuse_indirect + s.specular_direct + s.specular_indirect
    # Rounding of spherical harmonics may leave light slightly negative.
    c = wp.vec3(wp.clamp(c[0], 0.0, HALF_MAX), wp.clamp(c[1], 0.0, HALF_MAX), wp.clamp(c[2], 0.0, HALF_MAX))
    alpha = wp.where(views[0].transparent == 1, s.emission[3], 1.0)
    color_out[pixel] = to_half(rgba(c, alpha))


@wp.kernel
def accumulate_light_passes(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    direct_diffuse: wp.array[wp.vec4h],
    irradiance: wp.array[wp.vec4h],
    specular_ratio: wp.array[wp.float16],
    # Out:
    passes_out: LightPasses,
):
    """Add this frame's diffuse light to the sums; while something moves they hold this frame alone."""
    pixel = first + wp.tid()
    s = light_shares(gbuffer, direct_diffuse, direct_diffuse, irradiance, specular_ratio, pixel)
    direct = s.diffuse_direct
    indirect = s.diffuse_indirect
    albedo = rgba(s.albedo, 1.0)
    if views[0].rest > 0:
        direct += passes_out.direct[pixel]
        indirect += passes_out.indirect[pixel]
        albedo += passes_out.albedo[pixel]
    passes_out.direct[pixel] = direct
    passes_out.indirect[pixel] = indirect
    passes_out.albedo[pixel] = albedo


@wp.func
def divide_light(light: wp.vec3, albedo: wp.vec3) -> wp.vec3:
    """Return light / albedo for each channel, 0 where nothing is reflected."""
    r = wp.vec3(0.0, 0.0, 0.0)
    for c in range(3):
        if albedo[c] > 0.0:
            r[c] = light[c] / albedo[c]
    return r


@wp.kernel
def resolve_light_passes(
    first: int,
    # In:
    passes: LightPasses,
    # Out:
    direct_out: wp.array[wp.vec3],
    indirect_out: wp.array[wp.vec3],
    color_out: wp.array[wp.vec3],
):
    """Turn sums into Blender's passes: (direct + indirect) * color is the diffuse light of the picture."""
    pixel = first + wp.tid()
    a = passes.albedo[pixel]
    direct_out[pixel] = divide_light(passes.direct[pixel], rgb(a))
    indirect_out[pixel] = divide_light(passes.indirect[pixel], rgb(a))
    color_out[pixel] = rgb(a) / wp.max(a[3], 1.0)
