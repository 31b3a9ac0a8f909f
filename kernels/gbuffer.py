# SPDX-License-Identifier: GPL-3.0-or-later
"""The G-buffer: what is known about the surface in each pixel, and how passes read it.

60 bytes a pixel, and 4 more each where glass or a coat is seen. `hit` and `barycentrics` give the exact point for
ray origins (`surface_point` in intersect.py); `depth` gives a point good enough for weights, from one load.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import max_component
from .packing import pack_color, pack_unorm16, unpack_color, unpack_normal, unpack_unorm16
from .view import SKY_DEPTH, View, direction_to_eye, film_position, previous_film_position, unproject

# GBuffer.material: bits above roughness (bits 0..15) and the reflectance at grazing angles (bits 16..23)
SURFACE_EMITS = wp.constant(wp.uint32(1 << 24))
SURFACE_TRANSLUCENT = wp.constant(wp.uint32(1 << 25))
"""`translucent` holds a colour"""
SURFACE_VEILED = wp.constant(wp.uint32(1 << 26))
"""There are transparent layers: chance decides in each frame which of several surfaces the pixel shows"""
SURFACE_BACKFACING = wp.constant(wp.uint32(1 << 27))
SURFACE_BRIGHT = wp.constant(wp.uint32(1 << 28))
"""`f0` is stored as a quarter and the reflectance at grazing angles as half: energy compensation lifts rough metals
to 3.3. With SURFACE_TRANSLUCENT `diffuse`, `specular` and `translucent` are quarters too: where shaders are summed up,
one that is drawn stands for all"""
BRIGHT_SCALE = wp.constant(4.0)
BRIGHT_MIN = wp.constant(1.02)
"""Albedo from which it is no rounding of 1"""
SURFACE_TRANSMITS = wp.constant(wp.uint32(1 << 29))
"""`transmitted` holds a colour"""
SURFACE_COATED = wp.constant(wp.uint32(1 << 30))
"""`coat` holds a second lobe"""
SURFACE_SHAPED = wp.constant(wp.uint32(1 << 31))
"""Diffuse light isn't Lambert's, or highlights are stretched: direct_shapes.py asks the material itself"""
SURFACE_FLAGS = wp.constant(wp.uint32(0xFF000000))

# Grazing reflectance up to this fits its 8 bits, up to twice of it those of SURFACE_BRIGHT.
GRAZING_MAX = wp.constant(2.0)


@wp.struct
class GBuffer:
    """One entry a pixel of the rendered region, row by row from the bottom left."""

    hit: wp.array[wp.vec2i]
    """(instance, triangle); instance -1 (intersect.MISS) where only the world is seen"""
    barycentrics: wp.array[wp.uint32]
    """pack_unorm16 of the weights of the second and third vertex"""
    depth: wp.array[float]
    """Along the view axis [m]; SKY_DEPTH without a surface"""
    geometric_normal: wp.array[wp.uint32]
    """pack_normal, on the camera's side"""
    normal: wp.array[wp.uint32]
    """pack_normal of the shading normal (normal map and bump included)"""
    diffuse: wp.array[wp.uint32]
    """pack_color: diffuse albedo under all layers (reflected; of translucent surfaces see `translucent`)"""
    specular: wp.array[wp.uint32]
    """pack_color: directional albedo of everything else that reflects, for this view, coat included"""
    f0: wp.array[wp.uint32]
    """pack_color: reflectance along the normal of the specular lobe, energy compensation included; see load_material"""
    material: wp.array[wp.uint32]
    """Perceptual roughness (unorm16) | grazing reflectance / GRAZING_MAX (unorm8) << 16 | SURFACE_* bits"""
    translucent: wp.array[wp.uint32]
    """pack_color: albedo of diffuse transmission; valid where SURFACE_TRANSLUCENT is set"""
    transmitted: wp.array[wp.uint32]
    """pack_color: directional albedo of specular transmission; valid where SURFACE_TRANSMITS is set"""
    coat: wp.array[wp.uint32]
    """Coat's directional albedo (unorm16) | its perceptual roughness (unorm16) << 16; where SURFACE_COATED is set"""
    emission: wp.array[wp.vec4h]
    """Emitted radiance * exposure (of the world where nothing is hit); w = alpha of the pixel"""
    below: wp.array[wp.uint32]
    """pack_color: share of `diffuse` that is scattered below the surface; empty in scenes without"""


@wp.struct
class Surface:
    """Where a pixel's surface lies, for weights of filters and interpolations."""

    position: wp.vec3
    normal: wp.vec3
    """Shading normal"""
    geometric_normal: wp.vec3
    depth: float
    """Along the view axis [m]; SKY_DEPTH: there is none and nothing else here is valid"""


@wp.struct
class SurfaceMaterial:
    """What a pixel's surface does with light: diffuse, translucent, a GGX lobe, a coat's, what glass lets through."""

    diffuse: wp.vec3
    """Albedo"""
    scattered: wp.vec3
    """Part of `diffuse` whose light has gone in elsewhere"""
    translucent: wp.vec3
    specular: wp.vec3
    """Directional albedo of all reflection for this view: the lobe of f0, f90 and roughness, and the coat"""
    transmitted: wp.vec3
    """Directional albedo of specular transmission"""
    f0: wp.vec3
    f90: float
    roughness: float
    """Perceptual; alpha is its square"""
    coat: float
    """Directional albedo of the coat, which is colourless"""
    coat_roughness: float
    flags: wp.uint32


@wp.func
def load_surface(view: View, gbuffer: GBuffer, width: int, pixel: int) -> Surface:
    """Return the surface of a pixel of this frame."""
    s = Surface()
    s.depth = gbuffer.depth[pixel]
    s.position = unproject(view.camera, film_position(view, pixel % width, pixel // width), wp.min(s.depth, 1.0e15))
    s.normal = unpack_normal(gbuffer.normal[pixel])
    s.geometric_normal = unpack_normal(gbuffer.geometric_normal[pixel])
    return s


@wp.func
def load_previous_surface(view: View, gbuffer: GBuffer, width: int, pixel: int) -> Surface:
    """Return the surface of a pixel in the G-buffer of the frame before."""
    s = Surface()
    s.depth = gbuffer.depth[pixel]
    s.position = unproject(
        view.previous, previous_film_position(view, pixel % width, pixel // width), wp.min(s.depth, 1.0e15))
    s.normal = unpack_normal(gbuffer.normal[pixel])
    s.geometric_normal = unpack_normal(gbuffer.geometric_normal[pixel])
    return s


@wp.func
def has_surface(s: Surface) -> bool:
    """Return whether there is a surface at all."""
    return s.depth < SKY_DEPTH


@wp.func
def unpack_roughness(packed: wp.uint32) -> float:
    """Return the base lobe's roughness of one entry of GBuffer.material."""
    return float(packed & wp.uint32(65535)) * 1.5259022e-5


@wp.func
def load_material(gbuffer: GBuffer, pixel: int) -> SurfaceMaterial:
    """Return what the surface of a pixel does with light."""
    m = SurfaceMaterial()
    packed = gbuffer.material[pixel]
    m.flags = packed
    m.roughness = unpack_roughness(packed)
    m.f90 = float((packed >> wp.uint32(16)) & wp.uint32(255)) * (GRAZING_MAX / 255.0)
    m.diffuse = unpack_color(gbuffer.diffuse[pixel])
    m.specular = unpack_color(gbuffer.specular[pixel])
    m.f0 = unpack_color(gbuffer.f0[pixel])
    m.translucent = wp.vec3(0.0, 0.0, 0.0)
    if (packed & SURFACE_TRANSLUCENT) != wp.uint32(0):
        m.translucent = unpack_color(gbuffer.translucent[pixel])
    if (packed & SURFACE_BRIGHT) != wp.uint32(0):
        m.f0 = m.f0 * BRIGHT_SCALE
        m.f90 = m.f90 * 2.0
        if (packed & SURFACE_TRANSLUCENT) != wp.uint32(0):
            m.diffuse = m.diffuse * BRIGHT_SCALE
            m.specular = m.specular * BRIGHT_SCALE
            m.translucent = m.translucent * BRIGHT_SCALE
    m.transmitted = wp.vec3(0.0, 0.0, 0.0)
    if (packed & SURFACE_TRANSMITS) != wp.uint32(0):
        m.transmitted = unpack_color(gbuffer.transmitted[pixel])
    m.coat = 0.0
    m.coat_roughness = 1.0
    if (packed & SURFACE_COATED) != wp.uint32(0):
        coat = unpack_unorm16(gbuffer.coat[pixel])
        m.coat = coat[0]
        m.coat_roughness = coat[1]
    m.scattered = wp.vec3(0.0, 0.0, 0.0)
    if gbuffer.below.shape[0] > 0:
        m.scattered = wp.cw_mul(m.diffuse, unpack_color(gbuffer.below[pixel]))
    return m


@wp.func
def store_material(gbuffer: GBuffer, pixel: int, m: SurfaceMaterial):
    """Pack what the surface of a pixel does with light; of `flags` those that tell of colours are set here."""
    flags = m.flags & ~(SURFACE_BRIGHT | SURFACE_TRANSLUCENT | SURFACE_TRANSMITS | SURFACE_COATED)
    f0 = m.f0
    f90 = m.f90
    diffuse = m.diffuse
    specular = m.specular
    translucent = m.translucent
    beyond = max_component(wp.max(wp.max(diffuse, translucent), specular)) > BRIGHT_MIN
    if max_component(f0) > 1.0 or f90 > GRAZING_MAX or beyond:
        flags = flags | SURFACE_BRIGHT
        f0 = f0 / BRIGHT_SCALE
        f90 = f90 * 0.5
    gbuffer.translucent[pixel] = wp.uint32(0)
    if max_component(translucent) > 0.0 or beyond:
        flags = flags | SURFACE_TRANSLUCENT
        if (flags & SURFACE_BRIGHT) != wp.uint32(0):
            diffuse = diffuse / BRIGHT_SCALE
            specular = specular / BRIGHT_SCALE
            translucent = translucent / BRIGHT_SCALE
        gbuffer.translucent[pixel] = pack_color(translucent)
    if max_component(m.transmitted) > 0.0:
        flags = flags | SURFACE_TRANSMITS
        gbuffer.transmitted[pixel] = pack_color(m.transmitted)
    if m.coat > 0.0:
        flags = flags | SURFACE_COATED
        gbuffer.coat[pixel] = pack_unorm16(m.coat, m.coat_roughness)
    roughness = wp.uint32(wp.clamp(m.roughness, 0.0, 1.0) * 65535.0 + 0.5)
    grazing = wp.uint32(wp.clamp(f90 / GRAZING_MAX, 0.0, 1.0) * 255.0 + 0.5)
    gbuffer.material[pixel] = roughness | (grazing << wp.uint32(16)) | (flags & SURFACE_FLAGS)
    gbuffer.diffuse[pixel] = pack_color(diffuse)
    gbuffer.specular[pixel] = pack_color(specular)
    gbuffer.f0[pixel] = pack_color(f0)


@wp.func
def view_direction(view: View, s: Surface) -> wp.vec3:
    """Return the unit vector from a surface towards the camera."""
    return direction_to_eye(view.camera, s.position)


@wp.func
def barycentrics_of(gbuffer: GBuffer, pixel: int) -> wp.vec2:
    """Return the weights of the second and third vertex."""
    return unpack_unorm16(gbuffer.barycentrics[pixel])


@wp.func
def plane_distance(s: Surface, point: wp.vec3) -> float:
    """Return how far a point lies off the plane of a surface [m]."""
    return wp.abs(wp.dot(s.geometric_normal, point - s.position))
