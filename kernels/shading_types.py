# SPDX-License-Identifier: GPL-3.0-or-later
"""Structs of shading: a hit's geometry, what its material says, the BSDF made of that, and its tables. No functions."""

from __future__ import annotations

import warp as wp


@wp.struct
class ShadingPoint:
    """One hit, ready for a material program."""

    position: wp.vec3
    geometric_normal: wp.vec3
    """Unit, on the side of `wo`"""
    normal: wp.vec3
    """Interpolated shading normal, unit, flipped along with geometric_normal"""
    wo: wp.vec3
    backfacing: int
    """1: the ray came from behind the face"""
    instance: int
    triangle: int
    """Index into Geometry.triangles"""
    u: float
    v: float
    """Weights of the second and third vertex"""
    material: int
    footprint: float
    """Width of the ray cone across the ray [m], for texture filtering"""
    error: float
    """Bound of the float error of `position` along geometric_normal [m]"""
    ray_visibility: int
    """Kind of the ray that arrived: one VISIBLE_* bit"""
    ray_length: float
    ray_depth: int


@wp.struct
class Closure:
    """What a material program says about a point: one BSDF with its parameters, plus emission and transparency.

    Where a material mixes several BSDFs one is drawn with the caller's random number and `weight` is divided by its
    probability, so the expectation is the mix.
    """

    kind: int
    weight: wp.vec3
    """Factor on the BSDF and on `emission_layered`"""
    color: wp.vec3
    """Base Color; Color of the simple BSDFs"""
    normal: wp.vec3
    coat_normal: wp.vec3
    tangent: wp.vec3
    metallic: float
    roughness: float
    diffuse_roughness: float
    ior: float
    specular_level: float
    specular_tint: wp.vec3
    anisotropic: float
    anisotropic_rotation: float
    transmission: float
    subsurface: float
    subsurface_anisotropy: float
    """Mean cosine of scattering below the surface; of thin walls: -1 reflects all, 1 transmits all"""
    subsurface_method: int
    """One of node_codes.SUBSURFACE_*; 0: nothing is scattered below the surface"""
    subsurface_radius: wp.vec3
    """How far light goes below the surface [m], as the method has it"""
    subsurface_ior: float
    """With which light enters; 0: as it is reflected"""
    coat: float
    coat_roughness: float
    coat_ior: float
    coat_tint: wp.vec3
    sheen: float
    sheen_roughness: float
    sheen_tint: wp.vec3
    film_thickness: float
    """[nm]; 0 for most"""
    film_ior: float
    thin_wall: int
    multiscatter: int
    """1: Multiscatter GGX (energy preserving), 0: plain GGX"""
    emission_layered: wp.vec3
    """The Principled BSDF's own emission: under its coat and sheen, times `weight`"""
    emission: wp.vec3
    """Radiance of all Emission nodes, weighted"""
    transparency: wp.vec3
    """Weight of all Transparent BSDFs, 1 - alpha of Principled ones included"""
    holdout: float


@wp.struct
class Bsdf:
    """A closure prepared for one `wo`: lobe weights with layering and energy compensation applied, see layering.py."""

    geometric_normal: wp.vec3
    smooth_normal: wp.vec3
    """Interpolated normal, without normal map or bump"""
    normal: wp.vec3
    """Of the diffuse and translucent lobes"""
    specular_normal: wp.vec3
    """The same, turned so that the mirrored view leaves the surface"""
    tangent: wp.vec3
    """Of anisotropic reflection, zero for none"""
    alpha_x: float
    alpha_y: float
    """GGX roughness of the base reflection (metal and dielectric)"""
    metal: wp.vec3
    """Weight of the metallic lobe, energy scale included"""
    metal_f0: wp.vec3
    metal_b: wp.vec3
    """F82 term"""
    metal_constant: int
    """1: no Fresnel (Glossy BSDF)"""
    dielectric: wp.vec3
    """Weight of the dielectric reflection lobe, energy scale included"""
    dielectric_f0: wp.vec3
    dielectric_ior: float
    glass_kind: int
    """One of GLASS_*; see layering.py"""
    glass: wp.vec3
    """Weight of the refractive lobe, energy scale included"""
    glass_f0: wp.vec3
    glass_reflection_tint: wp.vec3
    glass_transmission_tint: wp.vec3
    """Thin walls: these two are the lobes' whole colours"""
    glass_ior: float
    """Relative to the side of `wo`: inverted on back faces"""
    glass_alpha: float
    thin_alpha: float
    """GGX roughness of the light that passes a thin wall"""
    film: wp.array[wp.vec4]
    """See engine/film_colors.py"""
    film_thickness: float
    """Of the thin film on metal, dielectric and glass [nm]; 0 without one"""
    film_ior: float
    glass_film_ior: float
    """Relative to the side of `wo`"""
    coat: wp.vec3
    coat_normal: wp.vec3
    coat_alpha: float
    coat_ior: float
    diffuse: wp.vec3
    """Albedo weight"""
    translucent: wp.vec3
    diffuse_a: float
    diffuse_b: float
    diffuse_multiscatter: wp.vec3
    """Oren-Nayar terms of the diffuse and the translucent lobe (b = 0: Lambert)"""
    sheen: wp.vec3
    """Or of the toon lobe"""
    sheen_normal: wp.vec3
    sheen_a: float
    """This and the next: shape of the lobe; see sheen.py, and toon.py for values below 0"""
    sheen_b: float
    emission: wp.vec3
    """Radiance leaving towards `wo`, all of it"""
    gain: float
    """See layering.largest_gain"""
    pick_diffuse: float
    pick_specular: float
    pick_coat: float
    pick_glass: float
    pick_translucent: float
    pick_sheen: float
    """Probabilities of sampling each lobe; sum 1, or 0 for a black surface"""


@wp.struct
class BsdfValue:
    """f * |cos| and the pdf of sample_bsdf for a given pair of directions; delta lobes are not in it."""

    f: wp.vec3
    pdf: float
    diffuse: wp.vec3
    """Part of f that is diffuse or translucent"""


@wp.struct
class BsdfSample:
    """One sampled direction."""

    wi: wp.vec3
    weight: wp.vec3
    """f * |cos| / pdf over all lobes (delta lobes: their own weight)"""
    pdf: float
    """Solid angle; 0 means absorbed"""
    delta: int
    """1: a mirror or smooth refraction: no MIS"""
    kind: int
    """VISIBLE_DIFFUSE, VISIBLE_GLOSSY or VISIBLE_TRANSMISSION"""
    roughness: float
    """Perceptual roughness of the sampled lobe, for the ray cone"""


@wp.struct
class Tables:
    """Directional albedos of GGX, see albedo_tables.py."""

    ggx_e: wp.array2d[float]
    """[cosine, roughness] single-scattering albedo for Fresnel 1"""
    ggx_e_avg: wp.array[float]
    """[roughness] mean over the cosine"""
    glass_e: wp.array3d[float]
    """[ior, cosine, roughness] dielectric interface, entering (ior > 1)"""
    glass_e_avg: wp.array2d[float]
    """[ior, roughness]"""
    glass_inv_e: wp.array3d[float]
    """Leaving (ior < 1)"""
    glass_inv_e_avg: wp.array2d[float]
    schlick_ior_s: wp.array3d[float]
    """[ior, cosine, roughness] weight between F0 and F90 under the real dielectric Fresnel"""
    schlick_s: wp.array2d[float]
    """[cosine, roughness] weight between F0 and F90 under Schlick's curve, for metals"""
    dielectric_c: wp.array3d[float]
    """[ior, cosine, roughness] cosine at which a smooth dielectric reflects what a rough one does, by its albedo"""
    schlick_c: wp.array2d[float]
    """[cosine, roughness] the same for Schlick's curve"""
    film: wp.array[wp.vec4]
    """Colours of thin films, see engine/film_colors.py"""
