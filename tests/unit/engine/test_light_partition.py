# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the direct light pass where reflection rays take their share of lights: with theirs it is all light."""

import functools

import numpy as np
import pytest
import warp as wp
from burnish.engine.passes.ray_scene import reflection_options
from burnish.engine.settings import ReflectionSettings
from burnish.kernels.gbuffer import GBuffer, load_material, load_surface, view_direction
from burnish.kernels.intersect import MISS, closest_hit
from burnish.kernels.lamp_hit import FAR
from burnish.kernels.reflection_lights import emitter_ray_share, lamps_along, shown_zone
from burnish.kernels.reflection_types import ReflectionOptions
from burnish.kernels.sampling import hashed_unit, pixel_seed_of
from burnish.kernels.specular_lobes import lobes_pdf, lobes_value, sample_lobes, specular_lobes
from burnish.kernels.types import VISIBLE_GLOSSY, Scene
from burnish.kernels.view import View

from tests import scenes
from tests.direct_frames import Frames, reference

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

CAMERA = scenes.camera_above(height=1.0, half=0.5, orthographic=False)
SAMPLES = 16
SETTINGS = {"plain": {"temporal_reuse": 0, "half_rate": False}, "both": {"temporal_reuse": 2, "candidates": 4}}


@wp.kernel
def trace_share(
    # In:
    views: wp.array[View],
    scene: Scene,
    gbuffer: GBuffer,
    options: ReflectionOptions,
    samples: int,
    # Out:
    light_out: wp.array[wp.vec3],
):
    """Give each pixel the mean of what its reflection rays bring of the lights, with the surface's colour."""
    pixel = wp.tid()
    view = views[0]
    surface = load_surface(view, gbuffer, options.width, pixel)
    material = load_material(gbuffer, pixel)
    lobes = specular_lobes(material, surface, view_direction(view, surface))
    origin = surface.position + surface.geometric_normal * 1.0e-4
    seed = pixel_seed_of(pixel, view.frame, 1)
    total = wp.vec3(0.0, 0.0, 0.0)
    i = int(0)
    while i < samples:
        k = wp.uint32(3 * i)
        u = wp.vec2(hashed_unit(seed, k), hashed_unit(seed, k + wp.uint32(1)))
        wi = sample_lobes(lobes, u, hashed_unit(seed, k + wp.uint32(2)))
        density = lobes_pdf(lobes, wi)
        if density > 0.0 and wp.dot(wi, surface.geometric_normal) > 0.0:
            hit = closest_hit(scene.geometry, origin, wi, FAR)
            light = wp.vec3(0.0, 0.0, 0.0)
            if hit.instance != MISS:
                face = scene.materials.instance_materials[scene.geometry.instances[hit.instance].material_offset]
                share = emitter_ray_share(scene, density, hit.instance, hit.triangle, surface.position, wi, hit.t)
                light = scene.materials.materials[face].emission * share
            light += lamps_along(
                scene.lights, VISIBLE_GLOSSY, -1, density, 0.0, surface.position, wi,
                wp.where(hit.instance == MISS, FAR, hit.t))
            total += wp.cw_mul(lobes_value(material, lobes, wi), light) / density
        i = i + 1
    light_out[pixel] = total * (shown_zone(options, material) / float(samples))


def ray_share_of(frames, settings):
    """Return what reflection rays bring of the lights, float64 [h, w, 3]."""
    options = reflection_options(settings, frames.size, frames.size)
    light = wp.zeros(frames.size**2, dtype=wp.vec3, device=frames.device)
    wp.launch(trace_share, frames.size**2,
              [frames.views.array, frames.scene.scene, frames.gbuffer.current(frames.views.parity), options, SAMPLES],
              [light], device=frames.device)
    return light.numpy().astype(np.float64).reshape(frames.size, frames.size, 3)


def glossy(light, roughness):
    """Make a glossy plane under a light."""
    above = scenes.place(x=0.3, y=0.2, z=1.5)
    grey = {"grey": scenes.material("GLOSSY", color=0.8, roughness=roughness)}
    meshes, objects, lamps = {"plane": scenes.quad(20.0)}, [("plane", np.eye(4), "grey")], []
    if light == "area":
        lamps = [scenes.lamp("AREA", 50.0, above, size_x=1.0)]
    elif light == "lamps":
        lamps = [scenes.lamp("POINT", 50.0, above, radius=0.2), scenes.lamp("SUN", 3.0, angle=0.1),
                 scenes.lamp("POINT", 20.0, scenes.place(x=-0.3, z=1.3), radius=0.05, soft_falloff=False)]
    else:
        grey["light"] = scenes.emitter(5.0)
        meshes["panel"] = scenes.quad(0.25)
        objects += [("panel", scenes.place(x=0.4, z=1.3), "light"), ("panel", scenes.place(x=-0.5, z=1.2), "light")]
    return scenes.delta(meshes, objects, grey, lamps)


@functools.cache
def truth(light, roughness):
    """Return the path tracer's mean."""
    return reference(glossy(light, roughness), CAMERA, samples=4096).mean()


@pytest.mark.parametrize(("roughness", "light", "name"), [
    pytest.param(roughness, light, name, marks=() if light == fast else pytest.mark.slow)
    for roughness, fast in ((0.1, "panels"), (0.25, "lamps")) for light in ("area", "lamps", "panels")
    for name in SETTINGS])
def test_both_sides_add_up_to_the_path_tracer(roughness, light, name):
    """Give the path tracer's light in direct light and in the rays' share together, where both have a part of it."""
    settings, expected = ReflectionSettings(), truth(light, roughness)
    frames = Frames(glossy(light, roughness), CAMERA, reflections=settings, **SETTINGS[name])
    direct, rays = 0.0, 0.0
    for _ in range(512):
        frames.frame()
        direct += frames.light_with_colors() / 512
        rays += ray_share_of(frames, settings) / 512
    assert rays.mean() > 0.01 * expected and direct.mean() > 0.02 * expected
    # Half rate limits what pixels of another lobe than the sampled one may borrow, as it does without rays.
    np.testing.assert_allclose((direct + rays).mean(), expected, rtol=0.02 if name == "plain" else 0.035)


def test_rough_surfaces_are_left_alone():
    """Give the same numbers with and without reflection rays above the roughness that they are traced for."""
    delta = glossy("area", 0.4)
    without, with_rays = (Frames(delta, CAMERA, reflections=each) for each in (
        None, ReflectionSettings(roughness_traced=0.2)))
    np.testing.assert_allclose(with_rays.mean(16), without.mean(16), rtol=1e-5)


@pytest.mark.parametrize("roughness", [0.0, 0.02, 0.15])
def test_no_sparks(roughness):
    """Stay finite and below the brightness of the lights in a mirror, for lamps of any size and none."""
    delta = glossy("lamps", roughness)
    delta.lights.extend([scenes.lamp("POINT", 5.0, scenes.place(z=1.2), radius=r, use_mis=False) for r in (0.0, 0.01)])
    frames = Frames(delta, CAMERA, 16, reflections=ReflectionSettings())
    for _ in range(20):
        frames.frame()
        specular = frames.light.specular.numpy().astype(np.float32)
        assert np.isfinite(specular).all()
        # The sun's radiance is 382; lamps without size shine into lobes of roughness 0.1 at least, and more brightly.
        assert specular.max() < 600.0
