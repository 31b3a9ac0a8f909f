# SPDX-License-Identifier: GPL-3.0-or-later
"""The composite: emission, direct and indirect light with the surfaces' colours; and Blender's light passes."""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, SurfaceMaterial, load_material
from .geometry_math import is_finite3, max_component, over_albedo
from .long_mean import pack_mean, unpack_mean
from .packing import HALF_MAX, from_half, rgb, rgba, to_half, unpack_normal
from .reflection_types import REFLECTANCE_MIN, ReflectionOptions, is_sampled, sampled_share, through_albedo
from .view import SKY_DEPTH, View, picture_limit
from .wide_loads import load_vec4h
from .wide_stores import store_vec4h

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


# Which lobe a light pass tells of.
PASS_DIFFUSE = wp.constant(0)
PASS_GLOSSY = wp.constant(1)
PASS_TRANSMISSION = wp.constant(2)


@wp.struct
class Lights:
    """What reaches the surfaces, without their colours; exposed. One entry a pixel, row by row."""

    direct_diffuse: wp.array[wp.vec4h]
    direct_specular: wp.array[wp.vec4h]
    irradiance: wp.array[wp.vec4h]
    """Diffuse indirect light: irradiance / pi"""
    specular_ratio: wp.array[wp.float16]
    """What a rough reflection gets, by `irradiance`"""
    reflection: wp.array[wp.uint64]
    """pack_mean of what reflections show of indirect light: times GBuffer.specular it leaves the surface"""
    transmission: wp.array[wp.uint64]
    """The same of light that comes through the surface or from below it, times through_albedo"""
    has_reflection: int
    """0: `reflection` is not there, and the irradiance stands in for it"""
    has_transmission: int
    indirect: wp.array[wp.uint64]
    """pack_mean of diffuse indirect light as pixels have gathered it at rest, instead of `irradiance`"""
    has_indirect: int
    options: ReflectionOptions
    """Of `reflection`: which surfaces have it"""


@wp.struct
class LightPasses:
    """Sums over frames at rest, one entry a pixel: divided by each other they are Blender's passes of one lobe."""

    direct: wp.array[wp.vec3]
    """Sum of albedo * direct light, exposed"""
    indirect: wp.array[wp.vec3]
    """Sum of albedo * indirect light, exposed"""
    albedo: wp.array[wp.vec4]
    """Sum of the albedo; w = frames"""


@wp.struct
class LightShares:
    """What a pixel shows, by where the light comes from; exposed."""

    emission: wp.vec4
    """w = alpha"""
    diffuse_albedo: wp.vec3
    """Of diffuse reflection and transmission together"""
    specular_albedo: wp.vec3
    transmitted_albedo: wp.vec3
    diffuse_direct: wp.vec3
    diffuse_indirect: wp.vec3
    specular_direct: wp.vec3
    specular_indirect: wp.vec3
    transmitted: wp.vec3
    """All light that arrives through glass"""


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
def indirect_light(gbuffer: GBuffer, lights: Lights, pixel: int) -> wp.vec3:
    """Return a surface's diffuse indirect light: irradiance / pi."""
    if lights.has_indirect == 1:
        return unpack_mean(lights.indirect[pixel])
    return light_or_none(load_vec4h(lights.irradiance, pixel)) * seen_share(gbuffer, pixel)


@wp.func
def reflected_light(lights: Lights, m: SurfaceMaterial, irradiance: wp.vec3, pixel: int) -> wp.vec3:
    """Return the indirect light that a surface reflects, without its colour.

    From the roughness on where the reflection has no samples it is the irradiance, by the share of it that the lobe
    gets. Samples of a sharp coat on a rough base have the light of both (coat_alone).
    """
    ratio = float(lights.specular_ratio[pixel])
    if not wp.isfinite(ratio):
        ratio = 1.0
    light = irradiance * ratio
    if lights.has_reflection == 1:
        if is_sampled(lights.options, m):
            roughness = m.roughness
            if m.coat > REFLECTANCE_MIN:
                roughness = wp.min(roughness, m.coat_roughness)
            # What unpack_mean returns is never negative and always finite.
            light = wp.lerp(
                light, unpack_mean(lights.reflection[pixel]), sampled_share(lights.options, roughness))
    return light


@wp.func
def transmitted_light(lights: Lights, m: SurfaceMaterial, irradiance: wp.vec3, pixel: int) -> wp.vec3:
    """Return the light that comes through a surface, without its colour; the irradiance stands in for it."""
    if lights.has_transmission == 1:
        if max_component(through_albedo(m)) > REFLECTANCE_MIN:
            return unpack_mean(lights.transmission[pixel])
    return irradiance


@wp.func
def light_shares(gbuffer: GBuffer, lights: Lights, pixel: int) -> LightShares:
    """Multiply a pixel's demodulated light by the surface's colours."""
    s = LightShares()
    none = wp.vec3(0.0, 0.0, 0.0)
    e = from_half(load_vec4h(gbuffer.emission, pixel))
    emitted = rgb(e)
    if not is_finite3(emitted):
        emitted = none
    alpha = float(1.0)
    if wp.isfinite(e[3]):
        alpha = wp.clamp(e[3], 0.0, 1.0)
    s.emission = rgba(emitted, alpha)
    s.diffuse_albedo = none
    s.specular_albedo = none
    s.transmitted_albedo = none
    s.diffuse_direct = none
    s.diffuse_indirect = none
    s.specular_direct = none
    s.specular_indirect = none
    s.transmitted = none
    if gbuffer.depth[pixel] < SKY_DEPTH:
        m = load_material(gbuffer, pixel)
        indirect = indirect_light(gbuffer, lights, pixel)
        s.diffuse_albedo = m.diffuse + m.translucent
        s.specular_albedo = m.specular
        direct = light_or_none(load_vec4h(lights.direct_diffuse, pixel))
        s.diffuse_direct = wp.cw_mul(s.diffuse_albedo - m.scattered, direct)
        s.diffuse_indirect = wp.cw_mul(m.diffuse - m.scattered, indirect)
        s.specular_direct = wp.cw_mul(m.specular, light_or_none(load_vec4h(lights.direct_specular, pixel)))
        s.specular_indirect = wp.cw_mul(m.specular, reflected_light(lights, m, indirect, pixel))
        if max_component(through_albedo(m)) > 0.0:
            through = transmitted_light(lights, m, indirect, pixel)
            s.diffuse_indirect += wp.cw_mul(m.translucent + m.scattered, through)
            s.transmitted_albedo = m.transmitted
            s.transmitted = wp.cw_mul(m.transmitted, through)
    return s


@wp.kernel
def compose(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    lights: Lights,
    # Out:
    color_out: wp.array[wp.vec4h],
    matte_out: wp.array[wp.uint64],
):
    """Add up what each pixel shows, and keep in `matte_out`, if it is not empty, what looks the same from everywhere.

    That is diffuse light without the surface's colour (pack_mean), exposed. 70 bytes read and 16 written a pixel, and
    8 read for each image of samples.
    """
    pixel = first + wp.tid()
    s = light_shares(gbuffer, lights, pixel)
    if matte_out.shape[0] > 0:
        matte_out[pixel] = pack_mean(wp.max(
            over_albedo(s.diffuse_direct + s.diffuse_indirect, s.diffuse_albedo), wp.vec3(0.0, 0.0, 0.0)))
    c = rgb(s.emission) + s.diffuse_direct + s.diffuse_indirect + s.specular_direct + s.specular_indirect
    c += s.transmitted
    # Rounding of spherical harmonics may leave light slightly negative.
    c = wp.vec3(wp.clamp(c[0], 0.0, HALF_MAX), wp.clamp(c[1], 0.0, HALF_MAX), wp.clamp(c[2], 0.0, HALF_MAX))
    alpha = wp.where(views[0].transparent == 1, s.emission[3], 1.0)
    store_vec4h(color_out, pixel, to_half(rgba(c, alpha)))


@wp.kernel
def accumulate_light_passes(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    lights: Lights,
    lobe: int,
    # Out:
    passes_out: LightPasses,
):
    """Add this frame's light of one lobe (PASS_*) to the sums; while something moves they hold this frame alone.

    Frames before count as much as in the picture (antialias.antialias), so that the passes make it up.
    """
    pixel = first + wp.tid()
    s = light_shares(gbuffer, lights, pixel)
    direct = s.diffuse_direct
    indirect = s.diffuse_indirect
    albedo = s.diffuse_albedo
    if lobe == PASS_GLOSSY:
        direct = s.specular_direct
        indirect = s.specular_indirect
        albedo = s.specular_albedo
    if lobe == PASS_TRANSMISSION:
        direct = wp.vec3(0.0, 0.0, 0.0)
        indirect = s.transmitted
        albedo = s.transmitted_albedo
    sum = rgba(albedo, 1.0)
    view = views[0]
    if view.rest > 0:
        before = passes_out.albedo[pixel]
        share = wp.min(picture_limit(view) / wp.max(before[3], 1.0), 1.0)
        direct += share * passes_out.direct[pixel]
        indirect += share * passes_out.indirect[pixel]
        sum += share * before
    passes_out.direct[pixel] = direct
    passes_out.indirect[pixel] = indirect
    passes_out.albedo[pixel] = sum


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
    """Turn sums into Blender's passes: (direct + indirect) * color is the lobe's light in the picture."""
    pixel = first + wp.tid()
    a = passes.albedo[pixel]
    direct_out[pixel] = over_albedo(passes.direct[pixel], rgb(a))
    indirect_out[pixel] = over_albedo(passes.indirect[pixel], rgb(a))
    color_out[pixel] = rgb(a) / wp.max(a[3], 1.0)
