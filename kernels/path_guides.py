# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo and normal of what a path shows, for the final denoiser, noted where the path tracer shades it.

That is the first surface that is no mirror: a mirror's own colour would tell the denoiser nothing about what is seen in
it (Open Image Denoise's documentation asks for the same). Functions only, no kernels.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import mean_component
from .packing import rgb
from .paths import Paths, shows_what_it_meets
from .reflectance import BsdfAlbedo, bsdf_albedo, whole_albedo
from .types import Bsdf, BsdfSample, Scene, ShadingPoint

# Mirrors and panes of glass that guides look through, one behind the other.
GUIDE_MIRRORS = wp.constant(4)

# Perceptual roughness below which a lobe counts as a mirror.
SHARP = wp.constant(0.15)

# Share of a surface's albedo that sharp lobes must have for paths to go on.
SHARP_SHARE = wp.constant(0.5)


@wp.func
def tells_little(bsdf: Bsdf, parts: BsdfAlbedo) -> bool:
    """Tell whether a surface mostly shows what it reflects or refracts."""
    sharp = float(0.0)
    if parts.roughness < SHARP:
        sharp += mean_component(parts.reflected)
    if wp.sqrt(bsdf.glass_alpha) < SHARP:
        sharp += mean_component(parts.transmitted)
    return sharp > SHARP_SHARE * mean_component(whole_albedo(parts))


@wp.func
def is_sharp(sample: BsdfSample) -> bool:
    """Tell whether a ray leaves a surface as from a mirror."""
    return sample.delta == 1 or sample.roughness < SHARP


@wp.func
def show_surface(
    scene: Scene, exposure: float, point: ShadingPoint, bsdf: Bsdf, paths: Paths, path: int,
):
    """Note a surface that a path has met; a mirror's own colour counts until the path meets what is seen in it."""
    bounce = point.ray_depth
    if not shows_what_it_meets(paths, path, bounce):
        return
    parts = bsdf_albedo(scene.tables, bsdf, point.wo)
    further = float(-1.0)
    if bounce < GUIDE_MIRRORS and tells_little(bsdf, parts):
        further = float(bounce + 1)
    shown = wp.cw_mul(paths.throughput[path], whole_albedo(parts) + bsdf.emission * exposure)
    paths.guide_albedo[path] = wp.vec4(shown[0], shown[1], shown[2], further)
    paths.guide_normal[path] = bsdf.normal


@wp.func
def light_before(paths: Paths, path: int) -> wp.vec3:
    """Return the light that a path has gathered, for show_light; 0 where no guides are collected."""
    if paths.guide_albedo.shape[0] > 0:
        return rgb(paths.radiance[path])
    return wp.vec3(0.0, 0.0, 0.0)


@wp.func
def show_light(exposure: float, paths: Paths, path: int, bounce: int, before: wp.vec3):
    """Note what a path that leaves the scene has met since `before`: light is the albedo, and there is no normal."""
    if shows_what_it_meets(paths, path, bounce):
        light = (rgb(paths.radiance[path]) - before) * exposure
        paths.guide_albedo[path] = wp.vec4(light[0], light[1], light[2], -1.0)
        paths.guide_normal[path] = wp.vec3(0.0, 0.0, 0.0)


@wp.func
def leave_surface(paths: Paths, path: int, bounce: int, sample: BsdfSample):
    """Let a path show nothing further that leaves a surface, after so many bounces, not as from a mirror."""
    if shows_what_it_meets(paths, path, bounce + 1) and not is_sharp(sample):
        albedo = paths.guide_albedo[path]
        paths.guide_albedo[path] = wp.vec4(albedo[0], albedo[1], albedo[2], -1.0)
