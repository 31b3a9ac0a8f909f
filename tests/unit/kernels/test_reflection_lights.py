# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the partition of lights between reflection rays and light samples: shares, energy, bounds."""

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine.device_scene import DeviceScene
from burnish.engine.environment_split import split_environment
from burnish.kernels.direct_emitters import EMITTER_WORDS, bake_emitters
from burnish.kernels.direct_reservoir import DirectOptions
from burnish.kernels.direct_terms import LitSurface, light_terms
from burnish.kernels.environment_split import EnvironmentSplit
from burnish.kernels.gbuffer import Surface, SurfaceMaterial
from burnish.kernels.intersect import MISS, closest_hit
from burnish.kernels.lamp_hit import FAR
from burnish.kernels.light_candidate import choose, light_classes, replay
from burnish.kernels.reflection_lights import (
    emitter_ray_share,
    lamps_along,
    light_side_share,
    shown_zone,
    world_ray_share,
)
from burnish.kernels.reflection_types import sampled_material
from burnish.kernels.specular_lobes import lobes_pdf, lobes_value, sample_lobes, specular_lobes
from burnish.kernels.types import LIGHT_ENVIRONMENT, LIGHT_TRIANGLE, VISIBLE_GLOSSY, Scene

from tests import scenes
from tests.direct_frames import local_power, sunny_world
from tests.light_scenes import slab

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

PATCH = (0.3, 0.2, 0.9)
COSINE = 0.995


@wp.struct
class Receiver:
    """A surface at the origin that faces z, and how its reflections are found."""

    wo: wp.vec3
    material: SurfaceMaterial
    options: DirectOptions
    patch: wp.vec4
    """Direction and cosine of the world's bright patch"""
    excess: wp.vec3
    """Its radiance above the threshold"""


@wp.func
def make_surface() -> Surface:
    """Return the surface."""
    s = Surface()
    s.position = wp.vec3(0.0, 0.0, 0.0)
    s.normal = wp.vec3(0.0, 0.0, 1.0)
    s.geometric_normal = s.normal
    s.depth = 1.0
    return s


@wp.func
def ray_light(scene: Scene, split: EnvironmentSplit, r: Receiver, density: float, wi: wp.vec3) -> wp.vec3:
    """Return what a reflection ray brings of everything that is sampled as a light."""
    origin = wp.vec3(0.0, 0.0, 0.0)
    hit = closest_hit(scene.geometry, origin, wi, FAR)
    t = hit.t
    light = wp.vec3(0.0, 0.0, 0.0)
    if hit.instance == MISS:
        t = FAR
        if wp.dot(wp.vec3(r.patch[0], r.patch[1], r.patch[2]), wi) > r.patch[3]:
            light = r.excess * world_ray_share(split, density, wi)
    else:
        material = scene.materials.instance_materials[scene.geometry.instances[hit.instance].material_offset]
        share = emitter_ray_share(scene, density, hit.instance, hit.triangle, origin, wi, hit.t)
        light = scene.materials.materials[material].emission * share
    return light + lamps_along(scene.lights, VISIBLE_GLOSSY, -1, density, 0.0, origin, wi, t)


@wp.func
def ray_estimate(
    scene: Scene, split: EnvironmentSplit, r: Receiver, material: SurfaceMaterial, surface: Surface, shared: int,
    random: wp.array2d[float], i: int,
) -> float:
    """Return what a ray brings of the light that a material's lobes reflect: all, or its share of it."""
    lobes = specular_lobes(material, surface, r.wo)
    wi = sample_lobes(lobes, wp.vec2(random[i, 4], random[i, 5]), random[i, 6])
    density = lobes_pdf(lobes, wi)
    if density <= 0.0:
        return 0.0
    light = ray_light(scene, split, r, wp.where(shared == 1, density, 0.0), wi)
    return light[1] * lobes_value(material, lobes, wi)[1] / density


@wp.kernel
def find_both(
    # In:
    scene: Scene,
    split: EnvironmentSplit,
    emitters: wp.array[wp.uint64],
    r: Receiver,
    random: wp.array2d[float],
    # Out:
    light_out: wp.array[wp.vec2],
    ray_out: wp.array[wp.vec2],
):
    """Estimate the reflected light by light samples and by rays: x all of it, y the share of each (unit albedo)."""
    i = wp.tid()
    p = LitSurface()
    p.surface = make_surface()
    p.material = r.material
    p.smooth = p.surface.normal
    p.wo = r.wo
    lobes = specular_lobes(p.material, p.surface, p.wo)
    light_out[i] = wp.vec2(0.0, 0.0)
    choice = choose(
        scene, split, light_classes(scene.lights, split), p.surface.position, wp.vec2(random[i, 0], random[i, 1]),
        wp.vec2(random[i, 2], random[i, 3]))
    if choice.chance > 0.0:
        s = replay(scene, split, emitters, p.surface.position, choice.candidate)
        hit = closest_hit(scene.geometry, p.surface.position, s.wi, s.distance * 0.999)
        if s.kind >= 0 and hit.instance == MISS:
            f = lobes_value(p.material, lobes, s.wi)
            terms = light_terms(scene, split, r.options, p, choice.candidate, s)
            light_out[i] = wp.vec2(f[1] * s.radiance[1] / s.pdf, terms.specular[1]) / choice.chance
    # All of it is by rays of both lobes, the share by those that are traced: of a coat alone on a rough base.
    drawn = sampled_material(r.options.reflection, p.material)
    ray_out[i] = wp.vec2(
        ray_estimate(scene, split, r, p.material, p.surface, 0, random, i),
        ray_estimate(scene, split, r, drawn, p.surface, 1, random, i))


@wp.kernel
def compare_shares(
    # In:
    scene: Scene,
    split: EnvironmentSplit,
    emitters: wp.array[wp.uint64],
    r: Receiver,
    random: wp.array2d[float],
    # Out:
    shares_out: wp.array[wp.vec3],
):
    """Find a light sample's share, that of a ray in its direction times the zone, and whether the ray met it (z)."""
    i = wp.tid()
    surface = make_surface()
    shares_out[i] = wp.vec3(0.0, 0.0, 0.0)
    choice = choose(
        scene, split, light_classes(scene.lights, split), surface.position, wp.vec2(random[i, 0], random[i, 1]),
        wp.vec2(random[i, 2], random[i, 3]))
    s = replay(scene, split, emitters, surface.position, choice.candidate)
    if choice.chance > 0.0 and s.kind >= 0:
        wo = wp.normalize(wp.vec3(random[i, 4] - 0.5, random[i, 5] - 0.5, random[i, 6]))
        material = r.material
        material.roughness = 0.4 * random[i, 7]
        lobes = specular_lobes(material, surface, wo)
        density = lobes_pdf(lobes, s.wi)
        zone = shown_zone(r.options.reflection, material)
        light = light_side_share(scene, split, choice.candidate, s, surface.position, density, zone)
        ray = float(0.0)
        met = float(0.0)
        if s.kind == LIGHT_ENVIRONMENT:
            ray = world_ray_share(split, density, s.wi)
            met = 1.0
        elif s.kind == LIGHT_TRIANGLE:
            hit = closest_hit(scene.geometry, surface.position, s.wi, FAR)
            if hit.instance != MISS and wp.abs(hit.t - s.distance) < 1.0e-3 * s.distance:
                ray = emitter_ray_share(
                    scene, density, hit.instance, hit.triangle, surface.position, s.wi, hit.t)
                met = 1.0
        else:
            whole = lamps_along(scene.lights, VISIBLE_GLOSSY, -1, 0.0, 0.0, surface.position, s.wi, FAR)
            if whole[1] > 0.0 and wp.abs(whole[1] - s.radiance[1]) < 1.0e-3 * whole[1]:
                ray = lamps_along(
                    scene.lights, VISIBLE_GLOSSY, -1, density, 0.0, surface.position, s.wi, FAR)[1] / whole[1]
                met = 1.0
            if s.delta == 1 and whole[1] == 0.0:
                met = 1.0
        if density > 0.0:
            shares_out[i] = wp.vec3(light, ray * zone, met)


class Lit:
    """A scene of lights on the device."""

    def __init__(self, delta, device):
        self.device = device
        self.scene = DeviceScene(device)
        self.scene.apply(delta, scenes.SETTINGS.performance)
        self.split = split_environment(self.scene.scene, device)
        count = len(self.scene.emitters.power)
        self.emitters = wp.zeros(max(count, 1) * int(EMITTER_WORDS), dtype=wp.uint64, device=device)
        if count:
            wp.launch(bake_emitters, count, [0, self.scene.scene, local_power(self.scene)], [self.emitters],
                      device=device)

    def receiver(self, roughness, wo=(0.0, 0.0, 1.0), coat=0.0, coat_roughness=0.0):
        """Return a receiver of unit albedo."""
        r = Receiver()
        r.wo = wp.normalize(wp.vec3(*wo))
        r.material.f0 = r.material.specular = wp.vec3(1.0 - coat) + wp.vec3(coat)
        r.material.f0 = wp.vec3(1.0 - coat)
        r.material.f90, r.material.roughness = 1.0 - coat, roughness
        r.material.coat, r.material.coat_roughness = coat, coat_roughness
        r.options.rays = 1
        r.options.reflection.traced = r.options.reflection.weak = 0.2
        r.options.reflection.diffuse, r.options.reflection.blend = 0.6, 0.1
        unit = np.array(PATCH) / np.linalg.norm(PATCH)
        r.patch = wp.vec4(*unit, COSINE)
        if self.split.share > 0.0:
            patch = np.array([1.0, 0.8, 0.5]) * 200.0
            kept = 1.0 - self.split.threshold / (patch @ np.array(self.scene.scene.luminance))
            r.excess = wp.vec3(*(patch * kept))
        return r

    def run(self, kernel, receiver, count, outputs):
        """Launch a kernel and return its outputs, float64."""
        random = np.random.default_rng(3).random((count, 8), np.float32)
        arrays = [wp.zeros(count, dtype=dtype, device=self.device) for dtype in outputs]
        wp.launch(kernel, count, [self.scene.scene, self.split, self.emitters, receiver,
                                  wp.array2d(random, device=self.device)], arrays, device=self.device)
        return [array.numpy().astype(np.float64) for array in arrays]

    def both(self, receiver, count=1 << 16):
        """Return estimates [N, 2] of light samples and rays."""
        return self.run(find_both, receiver, count, [wp.vec2, wp.vec2])


def lit(name, device):
    """Make one of the scenes, by the light in it."""
    above = scenes.place(x=0.3, y=0.2, z=2.0)
    lamps = {
        "sphere": [scenes.lamp("POINT", 100.0, above, radius=0.2, soft_falloff=False)],
        "disk": [scenes.lamp("POINT", 100.0, above, radius=0.1)],
        "spot": [scenes.lamp("SPOT", 100.0, above, spot_size=1.2, spot_blend=0.5, radius=0.05)],
        "area": [scenes.lamp("AREA", 50.0, above, size_x=1.0)],
        "ellipse": [scenes.lamp("AREA", 50.0, above, shape="ELLIPSE", size_x=1.0, size_y=0.4, spread=2.0)],
        "sun": [scenes.lamp("SUN", 3.0, angle=0.05)],
        "two": [scenes.lamp("SUN", 3.0, angle=0.05), scenes.lamp("SUN", 3.0, scenes.place(), angle=0.2)],
        "tiny": [scenes.lamp("POINT", 100.0, above, radius=0.001)],
        "delta": [scenes.lamp("POINT", 100.0, above, radius=0.0)],
    }
    if name in lamps:
        return Lit(scenes.delta({}, [], {}, lamps[name]), device)
    if name == "many":
        rng = np.random.default_rng(1)
        places = rng.uniform([-3, -3, 1.2], [3, 3, 3], (60, 3))
        many = [scenes.lamp("POINT", float(10.0 ** rng.uniform(-1, 1.5)), scenes.place(*p), radius=0.05)
                for p in places]
        return Lit(scenes.delta({}, [], {}, many), device)
    if name == "world":
        return Lit(scenes.delta({}, [], {}, (), sunny_world(PATCH, COSINE)), device)
    if name == "bar":
        # Longer than it is far off: sampled by solid angle.
        bar = slab((-3.0, -0.02, 0.0), (3.0, 0.02, 0.02))
        place = scenes.place(x=0.3, y=0.2, z=0.3)
        return Lit(scenes.delta({"bar": bar}, [("bar", place, "bar")], {"bar": scenes.emitter(5.0)}), device)
    mesh = scenes.quad(0.6) if name == "panel" else scenes.sphere(0.3, 16)
    return Lit(scenes.delta({"light": mesh}, [("light", above, "light")], {"light": scenes.emitter(5.0)}), device)


LIGHTS = ("sphere", "disk", "spot", "area", "ellipse", "sun", "many", "panel", "ball", "world")


@pytest.mark.parametrize("name", (*LIGHTS, "bar", "delta"))
def test_shares_add_up_to_one(device, name):
    """Give each light sample and a ray in its direction shares that add up to 1, at any roughness."""
    scene = lit(name, device)
    shares, = scene.run(compare_shares, scene.receiver(0.1), 1 << 14, [wp.vec3])
    met = shares[shares[:, 2] > 0]
    # Rays of a ball's far side meet its near side, so do those of a bar's, and those of many lamps several.
    assert len(met) > (0.3 if name in ("ball", "bar", "many") else 0.85) * len(shares)
    error = np.abs(met[:, 0] + met[:, 1] - 1.0)
    assert np.quantile(error, 0.99) < 1e-3 and error.mean() < 1e-3
    if name != "delta":
        assert met[:, 1].max() > 0.4 and met[:, 0].max() > 0.999


def best(light, ray):
    """Return the better of the two plain estimates and its standard error."""
    means = [(a[:, 0].std() / np.sqrt(len(a)), a[:, 0].mean()) for a in (light, ray)]
    error, mean = min((e, m) for e, m in means if m > 0.0)
    return mean, error


def check_sum(scene, receiver, zone, tolerance=0.01):
    """Compare the sum of both sides with all light; return both sides' estimates."""
    light, ray = scene.both(receiver)
    expected, error = best(light, ray)
    total = light[:, 1].mean() + zone * ray[:, 1].mean()
    spread = np.hypot(light[:, 1].std(), zone * ray[:, 1].std()) / np.sqrt(len(light))
    print(f"{expected:10.5g} sum {total / expected:.4f} light {light[:, 1].mean() / expected:.4f}"
          f" +- {np.hypot(spread, error) / expected:.2%} max {light[:, 1].max():.4g} {ray[:, 1].max():.4g}")
    np.testing.assert_allclose(total, expected, rtol=tolerance, atol=4.0 * np.hypot(error, spread))
    return light, ray


def aimed(name, aside):
    """Return a view whose mirror direction meets the scene's light, or passes by it a little."""
    centers = {"sun": (0, 0, 1), "two": (0, 0, 1), "world": PATCH, "bar": (0.3, 0.2, 0.3)}
    center = np.array(centers.get(name, (0.3, 0.2, 2.0)), float)
    mirrored = center / np.linalg.norm(center) + (aside, 0.0, 0.0)
    return -mirrored[0], -mirrored[1], mirrored[2]


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=() if name in ("sphere", "area", "sun", "panel", "world") else pytest.mark.slow)
    for name in (*LIGHTS, "bar", "two", "tiny")])
def test_both_sides_hold_all_light(device, name):
    """Give the whole reflected light in the sum of both sides, where the mirrored view sees the light and beside it."""
    scene = lit(name, device)
    for roughness in (0.02, 0.1, 0.2, 0.25, 0.4):
        zone = 1.0 if roughness <= 0.2 else 0.5 if roughness == 0.25 else 0.0
        for aside in (0.02, 0.2):
            light, ray = check_sum(scene, scene.receiver(roughness, aimed(name, aside)), zone)
            if roughness <= 0.2 and name in ("sphere", "area", "ellipse", "sun", "panel", "ball", "world"):
                # No sparks: nothing brighter than the light in a mirror; half of that where there are two to choose.
                assert light[:, 1].max() <= 1.02 * max(ray[:, 0].max(), light[:, 0].max() * (aside > 0.1))
                assert ray[:, 1].max() <= 1.02 * ray[:, 0].max()
            if roughness <= 0.02 and aside < 0.1 and name in ("sphere", "area", "panel", "ball", "world"):
                assert ray[:, 1].mean() > 0.95 * ray[:, 0].mean()
            if roughness == 0.2 and name in ("disk", "spot", "sun", "many", "tiny"):
                assert light[:, 1].mean() > 0.9 * light[:, 0].mean()


@pytest.mark.parametrize("name", ["area", "disk", "panel", "sun"])
def test_coat_on_a_rough_base(device, name):
    """Give the whole light of both lobes of a coated surface: all its samples are rays, for the coat is sharp."""
    scene = lit(name, device)
    for aside in (0.02, 0.2):
        check_sum(scene, scene.receiver(0.5, aimed(name, aside), coat=0.1, coat_roughness=0.05), 1.0)


def test_mirrors_show_no_light_without_size(device):
    """Leave out lamps of radius 0 in perfect mirrors, as the path tracer does, and show them in rougher ones."""
    scene = lit("delta", device)
    for roughness, seen in ((0.0, False), (0.02, True)):
        light, _ = scene.both(scene.receiver(roughness, aimed("delta", 0.02)), 1024)
        assert (light[:, 1].max() > 0.0) == seen
        assert np.isfinite(light).all()


def test_lights_that_are_not_sampled_belong_to_rays(device):
    """Let rays bring all light of triangles that are left out of light sampling."""
    material = dataclasses.replace(scenes.emitter(5.0), emission_sampling=False)
    delta = scenes.delta({"light": scenes.quad(0.6)}, [("light", scenes.place(z=2.0), "light")], {"light": material})
    scene = Lit(delta, device)
    light, ray = scene.both(scene.receiver(0.1), 4096)
    assert light.max() == 0.0
    np.testing.assert_array_equal(ray[:, 1], ray[:, 0])
    assert ray[:, 1].mean() > 1.0
