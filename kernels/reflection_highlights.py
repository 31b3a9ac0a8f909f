# SPDX-License-Identifier: GPL-3.0-or-later
"""The lobe in which a reflection ray's hit shows its lights: highlights of what mirrors and glass show.

What lights a hit knows no direction, so it counts its reflecting lobes for matte. Here the strongest one takes its
direct light for itself: a light sample is worth the lobe's value, and what the matte one has counted of it is taken
off. Functions; reflection_choice_glossy.py and reflection_resolve_glossy.py have the kernels.
"""

from __future__ import annotations

import warp as wp

from .albedo_tables import ggx_albedo
from .fresnel import grazing_share, metal_part
from .geometry_math import INV_PI, PI, mean_component, sqr
from .normals import valid_specular_normal
from .packed_halves import pack_halves, unpack_halves
from .reflectance import BsdfAlbedo, mean_grazing_share
from .specular_lobes import COAT_F0
from .types import ShadingPoint, Tables

# Density [1/sr] of a ray's widest lobe below which what it shows is too blurred for highlights: roughness 0.5.
HIGHLIGHT_DENSITY = wp.constant(1.0)
# Least albedo of a lobe, over the pixel's, that is looked at.
HIGHLIGHT_ALBEDO = wp.constant(0.01)
# Share of light from behind up to which a hit is taken to have a front alone.
BEHIND_MAX = wp.constant(0.05)

# Least alpha with which lobes are evaluated: of sharper ones pixels that are not wide enough would show sparks.
HIGHLIGHT_ALPHA = wp.constant(0.01)
# How many times as dense as light samples a lobe may be: what a sample is worth at most, over light and albedo.
DENSITY_RATIO = wp.constant(1.0)
# Largest ratio of a lobe's reflectance at a half vector to its mean.
FRESNEL_MAX = wp.constant(8.0)

# Steps of the roughness in eight bits and of the share in seven, of which the eighth tells `mirrored`.
STEPS = wp.constant(255.0)
SHARE_STEPS = wp.constant(127.0)
MIRRORED = wp.constant(wp.uint32(1 << 15))


@wp.struct
class HitLobe:
    """The lobe of a hit that shows highlights."""

    albedo: wp.vec3
    """For the view, over the chance of ending in the hit; 0: none"""
    roughness: float
    normal_share: float
    """Its reflectance along the normal, by that and the one at grazing angles"""
    mirrored: int
    """1: it sends rays on, which show lights too (reflection_shared.py); the hit's reflectance is without it"""


@wp.func
def rounded_roughness(roughness: float) -> float:
    """Return a roughness as unpack_lobe gives it."""
    return wp.floor(wp.clamp(roughness, 0.0, 1.0) * STEPS + 0.5) / STEPS


@wp.func
def coat_lobe(albedo: wp.vec3, roughness: float) -> HitLobe:
    """Return the lobe of a coat."""
    lobe = HitLobe()
    lobe.albedo = albedo
    lobe.roughness = roughness
    lobe.normal_share = COAT_F0 / (1.0 + COAT_F0)
    return lobe


@wp.func
def pack_lobe(lobe: HitLobe) -> wp.uint64:
    """Return a lobe in 64 bits, 0 for none."""
    a = pack_halves(wp.vec4(lobe.albedo[0], lobe.albedo[1], lobe.albedo[2], 0.0))
    # The share of dielectrics is small.
    share = wp.uint32(wp.sqrt(wp.clamp(lobe.normal_share, 0.0, 1.0)) * SHARE_STEPS + 0.5)
    code = wp.uint32(wp.clamp(lobe.roughness, 0.0, 1.0) * STEPS + 0.5) | (share << wp.uint32(8))
    if lobe.mirrored == 1:
        code = code | MIRRORED
    return a | (wp.uint64(code) << wp.uint64(48))


@wp.func
def lobe_albedo(word: wp.uint64) -> wp.vec3:
    """Return the albedo of pack_lobe."""
    a = unpack_halves(word)
    return wp.vec3(a[0], a[1], a[2])


@wp.func
def unpack_lobe(word: wp.uint64) -> HitLobe:
    """Return the lobe of pack_lobe."""
    lobe = HitLobe()
    lobe.albedo = lobe_albedo(word)
    code = wp.uint32(word >> wp.uint64(48))
    lobe.roughness = float(code & wp.uint32(255)) / STEPS
    lobe.normal_share = sqr(float((code >> wp.uint32(8)) & wp.uint32(127)) / SHARE_STEPS)
    lobe.mirrored = wp.where((code & MIRRORED) != wp.uint32(0), 1, 0)
    return lobe


@wp.func
def is_mirrored(word: wp.uint64) -> bool:
    """Return whether the lobe of pack_lobe is mirrored."""
    return (wp.uint32(word >> wp.uint64(48)) & MIRRORED) != wp.uint32(0)


@wp.func
def highlight_lobe(albedo: BsdfAlbedo, mirrored: wp.vec3, chance: float) -> HitLobe:
    """Return the lobe of a hit in which a ray ends: the stronger of coat and base, without what is `mirrored`."""
    lobe = HitLobe()
    left = wp.max(albedo.specular - mirrored, wp.vec3(0.0, 0.0, 0.0))
    base = wp.min(albedo.reflected, left)
    lobe.albedo = base / chance
    lobe.roughness = albedo.roughness
    f0 = mean_component(albedo.f0)
    lobe.normal_share = f0 / wp.max(f0 + albedo.f90, 1.0e-6)
    coat = wp.min(wp.vec3(albedo.coat, albedo.coat, albedo.coat), left - base)
    if mean_component(coat) > mean_component(base):
        lobe = coat_lobe(coat / chance, albedo.coat_roughness)
    return lobe


@wp.struct
class Highlight:
    """A hit's lobe, ready for light samples."""

    normal: wp.vec3
    wo: wp.vec3
    cosine: float
    """Of the view"""
    alpha: float
    """With which it is evaluated at least"""
    normal_share: float


@wp.func
def make_highlight(lobe: HitLobe, point: ShadingPoint, normal: wp.vec3, pdf: float) -> Highlight:
    """Return a hit's lobe for its view. `pdf`: least density of the ray, which shows nothing finer than its own lobe.

    As in path regularisation (Kaplanyan and Dachsbacher 2013) that keeps sharp lobes from sparks behind wide ones.
    """
    out = Highlight()
    out.wo = point.wo
    out.normal = valid_specular_normal(point.geometric_normal, point.wo, normal)
    out.cosine = wp.clamp(wp.dot(out.normal, point.wo), 1.0e-3, 1.0)
    # A GGX lobe of this alpha has the density `pdf` along the normal.
    own = wp.sqrt(1.0 / (4.0 * PI * wp.max(pdf, HIGHLIGHT_DENSITY)))
    out.alpha = wp.max(wp.max(sqr(lobe.roughness), own), HIGHLIGHT_ALPHA)
    out.normal_share = lobe.normal_share
    return out


@wp.func
def lobe_density(tables: Tables, h: Highlight, wi: wp.vec3, light_pdf: float, narrow: int) -> float:
    """Return the lobe's value times the cosine over its albedo [1/sr]; 0 below the surface.

    But where it is narrow it is no sharper than light samples can show without sparks: of a sky, which is sampled
    everywhere, any lobe reflects about the same.

    Args:
        tables: Albedos.
        h: From make_highlight.
        wi: Direction of a light sample.
        light_pdf: Its density.
        narrow: 1: the lobe keeps its width, as for lights without extent (LightSample.delta).
    """
    up = wp.dot(h.normal, wi)
    if up <= 0.0:
        return 0.0
    a2 = sqr(h.alpha)
    if narrow == 0:
        a2 = wp.clamp(1.0 / (4.0 * PI * DENSITY_RATIO * wp.max(light_pdf, 1.0e-6)), a2, 1.0)
    half = wp.normalize(h.wo + wi)
    z2 = wp.min(sqr(wp.dot(h.normal, half)), 1.0)
    d = a2 * INV_PI / sqr(a2 * z2 + (1.0 - z2))
    slope_o = wp.sqrt(1.0 + a2 * (1.0 - sqr(h.cosine)) / sqr(h.cosine))
    slope_i = wp.sqrt(1.0 + a2 * wp.max(1.0 - sqr(up), 0.0) / wp.max(sqr(up), 1.0e-12))
    value = d / (2.0 * h.cosine * (slope_o + slope_i))
    # What it gives of a white surrounding, so that wider lobes keep the albedo.
    roughness = wp.sqrt(wp.sqrt(a2))
    share = h.normal_share
    metal = metal_part(share, 1.0 - share)
    around = mean_grazing_share(tables, h.cosine, roughness, metal)
    here = grazing_share(wp.dot(h.wo, half), metal)
    fresnel = wp.lerp(share, 1.0 - share, here) / wp.max(wp.lerp(share, 1.0 - share, around), 1.0e-6)
    return value * wp.min(fresnel, FRESNEL_MAX) / wp.max(ggx_albedo(tables, h.cosine, roughness)[0], 0.05)
