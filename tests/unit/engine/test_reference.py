# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the path tracer and the device scene: energy, structures, transparency, updates, determinism."""

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine.environment import no_environment, running_sums, texel_chances
from burnish.engine.passes import reference
from burnish.engine.scene import SceneDelta, Visibility
from burnish.engine.session import Session
from burnish.engine.settings import DenoiserSettings, FilmSettings, Integrator, SamplingSettings

from tests import scenes
from tests.device import DEVICE


def room(albedo):
    """Make a closed box that emits 1 and reflects `albedo`."""
    return scenes.delta({"box": scenes.box(1.0, inward=True)}, [("box", np.eye(4), "wall")],
                        {"wall": scenes.emitter(1.0, albedo)})


@pytest.mark.parametrize("albedo", [pytest.param(0.5, marks=pytest.mark.slow), 0.9])
def test_closed_furnace(albedo):
    """Find radiance e / (1 - albedo) everywhere in a closed emitting box: every bounce counts."""
    image = scenes.render(room(albedo), scenes.camera_above(height=0.5, half=0.3, orthographic=False), samples=1024)
    np.testing.assert_allclose(image[..., :3].mean(dtype=np.float64), 1 / (1 - albedo), rtol=0.01)


def test_bounce_limit():
    """Stop after max_bounces reflections."""
    image = scenes.render(room(0.5), scenes.camera_above(height=0.5, half=0.3, orthographic=False), max_bounces=1)
    np.testing.assert_allclose(image[..., :3].mean(dtype=np.float64), 1.5, rtol=0.01)


def field(count=9):
    """Make many spheres over a plane, as (meshes, objects, materials)."""
    meshes = {"ball": scenes.sphere(0.3, rings=12), "plane": scenes.quad(3.0)}
    objects = [("plane", np.eye(4), "grey")]
    for i in range(count):
        matrix = scenes.place(x=-1.5 + 0.4 * i, y=0.3 * (i % 3 - 1), z=0.4)
        matrix[0, 1] = 0.3  # sheared
        matrix[1, 1] = -1.0 if i % 2 else 1.0  # mirrored
        objects.append(("ball", matrix, "red" if i % 2 else "clear"))
    materials = {"grey": scenes.material(color=0.6), "red": scenes.material(color=(0.8, 0.2, 0.1)),
                 "clear": scenes.transparent(0.4, color=0.7)}
    return meshes, objects, materials


def render_field(threshold, always, monkeypatch):
    """Render the field flattened or in two levels."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", always)
    meshes, objects, materials = field()
    lamp = scenes.lamp("AREA", 30.0, scenes.place(z=2.5), shape="SQUARE", size_x=1.0,
                       visibility=int(Visibility.ALL & ~Visibility.CAMERA))
    settings = dataclasses.replace(
        scenes.SETTINGS, performance=dataclasses.replace(scenes.SETTINGS.performance, instancing_threshold=threshold))
    return scenes.render(scenes.delta(meshes, objects, materials, [lamp], 0.2), scenes.camera_above(half=1.8),
                         (32, 32), 16, settings, passes=("Combined", "Depth", "Normal"))


def test_two_levels_match_one(monkeypatch):
    """Render the same picture from instances under a Bvh as from one flattened mesh."""
    flat, flat_session = render_field(1e6, 1 << 20, monkeypatch)
    levels, levels_session = render_field(1.0, 0, monkeypatch)
    assert "two levels" in levels_session.stats.structure and "two levels" not in flat_session.stats.structure
    np.testing.assert_allclose(levels_session.read("Depth"), flat_session.read("Depth"), rtol=1e-4)
    np.testing.assert_allclose(levels_session.read("Normal"), flat_session.read("Normal"), atol=1e-3)
    close = np.isclose(levels, flat, rtol=1e-3, atol=1e-4).all(-1)
    assert close.mean() > 0.97, "paths differ only where rounding changes a hit"
    np.testing.assert_allclose(levels.mean(), flat.mean(), rtol=2e-3)


def test_moving_an_object_matches_a_full_build():
    """Move an object out of the flattened structure and get the picture of a fresh build, without its mesh again."""
    meshes, objects, materials = field()
    moved = list(objects)
    moved[4] = ("ball", scenes.place(x=0.5, y=-1.2, z=0.5), "red")
    camera = scenes.camera_above(half=1.8)
    session = Session(scenes.SETTINGS)
    session.update(scenes.delta(meshes, objects, materials, background=1.0))
    session.configure(scenes.SETTINGS, camera, 32, 32)
    session.step(4)
    before = session.read()
    session.update(SceneDelta(instances=scenes.instances(moved)))
    assert "moving" in session.stats.structure and session.samples_done == 0
    session.step(4)
    fresh = scenes.render(scenes.delta(meshes, moved, materials, background=1.0), camera, (32, 32), 4)
    assert np.isclose(session.read(), fresh, rtol=1e-3, atol=1e-4).all(-1).mean() > 0.98
    assert not np.allclose(before, fresh, atol=1e-2)


@pytest.mark.parametrize("levels", [False, True], ids=["moved", "instanced"])
def test_editing_a_material_keeps_instances(levels, monkeypatch):
    """Keep objects under the upper level in the picture when nothing but a material changes."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 0 if levels else 1 << 20)
    settings = dataclasses.replace(
        scenes.SETTINGS, performance=dataclasses.replace(scenes.SETTINGS.performance, instancing_threshold=1.0))
    objects = [("ball", scenes.place(x=-0.5), "grey"), ("ball", scenes.place(x=0.5), "grey")]
    session = Session(settings)
    session.update(scenes.delta({"ball": scenes.sphere(0.4, 12)}, objects, {"grey": scenes.material(color=0.5)},
                                background=1.0))
    session.configure(settings, scenes.camera_above(half=1.0), 16, 16, passes=("Combined", "Depth"))
    if not levels:
        objects[1] = ("ball", scenes.place(x=0.5, y=0.1), "grey")
        session.update(SceneDelta(instances=scenes.instances(objects)))
    assert "two levels" in session.stats.structure
    session.step(1)
    before = session.read("Depth")
    session.update(SceneDelta(materials={"grey": scenes.material(color=0.2)}))
    session.step(1)
    assert (before < 1e9).sum() > 20
    np.testing.assert_array_equal(session.read("Depth"), before)


def test_editing_a_mesh_and_a_material():
    """Take over a changed mesh and a changed material without sending the rest again."""
    session = Session(scenes.SETTINGS)
    session.update(scenes.delta({"plane": scenes.quad(2.0)}, [("plane", np.eye(4), "grey")],
                                {"grey": scenes.material(color=0.6)}, background=1.0))
    session.configure(scenes.SETTINGS, scenes.camera_above(half=1.0), 8, 8, passes=("Combined", "Depth"))
    session.step(64)
    np.testing.assert_allclose(session.read()[..., 0].mean(), 0.6, rtol=0.02)
    session.update(SceneDelta(materials={"grey": scenes.material(color=0.3)}))
    session.step(64)
    np.testing.assert_allclose(session.read()[..., 0].mean(), 0.3, rtol=0.02)
    session.update(SceneDelta(meshes={"plane": scenes.quad(2.0, z=1.0)}))
    session.step(1)
    np.testing.assert_allclose(session.read("Depth"), 2.0, rtol=1e-4)


@pytest.mark.parametrize("weight", [0.25, 0.75])
def test_transparency_in_camera_bounce_and_shadow_rays(weight):
    """See through and light through a stack of transparent squares by the product of their transparencies."""
    meshes = {"plane": scenes.quad(20.0)}
    objects = [("plane", np.eye(4), "grey"), ("plane", scenes.place(z=1.0), "veil"),
               ("plane", scenes.place(z=1.5), "veil")]
    materials = {"grey": scenes.material(color=0.5), "veil": scenes.transparent(weight, color=0.0)}
    sun = scenes.lamp("SUN", np.pi)
    camera = scenes.camera_above(half=0.1, height=3.0)
    image = scenes.render(scenes.delta(meshes, objects, materials, [sun]), camera, samples=1024)
    np.testing.assert_allclose(image[..., 0].mean(dtype=np.float64), 0.5 * weight**4, rtol=0.03)


def test_too_many_layers_are_counted():
    """Stop behind 32 transparent layers, camera and shadow rays alike, and tell so in the report.

    Opacity maps know that these are clear, so that rays pass them all.
    """
    meshes = {"plane": scenes.quad(20.0)}
    materials = {"grey": scenes.material(color=0.5), "veil": scenes.transparent(1.0)}
    camera = scenes.camera_above(half=0.1, height=50.0)

    def shot(layers, maps=False):
        objects = [("plane", np.eye(4), "grey")]
        objects += [("plane", scenes.place(z=1.0 + 0.5 * i), "veil") for i in range(layers)]
        scene = scenes.delta(meshes, objects, materials, [scenes.lamp("SUN", np.pi)])
        settings = dataclasses.replace(
            scenes.SETTINGS, performance=dataclasses.replace(scenes.SETTINGS.performance, opacity_maps=maps))
        image, session = scenes.render(
            scene, camera, samples=4, passes=("Combined", "Depth"), settings=settings)
        return image[..., 0].mean(), session.report.text()

    radiance, report = shot(31)
    np.testing.assert_allclose(radiance, 0.5, rtol=1e-3)
    assert "layers" not in report
    radiance, report = shot(40)
    assert radiance == 0.0 and "more than 32 transparent layers" in report
    radiance, report = shot(40, maps=True)
    np.testing.assert_allclose(radiance, 0.5, rtol=1e-3)
    assert "layers" not in report


def test_ray_visibility():
    """Hide an object from the camera yet keep its shadow, and the reverse."""
    meshes = {"plane": scenes.quad(20.0), "lid": scenes.quad(5.0)}
    materials = {"grey": scenes.material(color=0.5), "black": scenes.material(color=0.0)}
    sun = scenes.lamp("SUN", np.pi)
    camera = scenes.camera_above(half=0.1)

    def shot(visibility):
        objects = [("plane", np.eye(4), "grey"), ("lid", scenes.place(z=1.0), "black", int(visibility))]
        return scenes.render(scenes.delta(meshes, objects, materials, [sun]), camera, samples=8)[..., 0].mean()

    assert shot(Visibility.ALL & ~Visibility.CAMERA) == 0.0
    np.testing.assert_allclose(shot(Visibility.ALL & ~Visibility.CAMERA & ~Visibility.SHADOW), 0.5, rtol=1e-3)
    assert shot(Visibility.ALL & ~Visibility.SHADOW) == 0.0


def test_film_transparent_and_holdout():
    """Leave alpha 0 where the world or a holdout shows, 1 on objects."""
    settings = dataclasses.replace(scenes.SETTINGS, film=FilmSettings(transparent=True))
    objects = [("plane", scenes.place(x=-2.0), "grey"), ("plane", scenes.place(x=2.0), "grey",
                                                         int(Visibility.ALL | Visibility.HOLDOUT))]
    image = scenes.render(
        scenes.delta({"plane": scenes.quad(1.0)}, objects, {"grey": scenes.material(color=0.5)}, background=1.0),
        scenes.camera_above(half=3.0), (30, 30), 4, settings)
    alpha = image[15, :, 3]
    assert alpha[5] == 1.0 and alpha[15] == 0.0 and alpha[25] == 0.0
    assert (image[15, 15, :3] == 0).all() and image[15, 5, 0] > 0.4


def test_same_seed_same_bits(monkeypatch):
    """Render the same bits for any number of threads and bands, and others for another seed."""
    camera = scenes.camera_above(height=0.5, half=0.3, orthographic=False)
    pictures = []
    for threads, paths in ((1, reference.CPU_BAND_PATHS), (2, reference.CPU_BAND_PATHS), (2, (500, 700))):
        monkeypatch.setattr("burnish.engine.device.thread_count", lambda count=threads: count)
        monkeypatch.setattr(reference, "CPU_BAND_PATHS", paths)
        pictures.append(scenes.render(room(0.7), camera, (96, 96), 3))
    assert (pictures[0] == pictures[1]).all() and (pictures[0] == pictures[2]).all()
    sampling = dataclasses.replace(scenes.SETTINGS.sampling, seed=1)
    other = dataclasses.replace(scenes.SETTINGS, sampling=sampling)
    assert (scenes.render(room(0.7), camera, (96, 96), 3, other) != pictures[0]).any()


def test_pictures_stay_as_they_were_read():
    """Keep pictures while further samples come in, and get the newest each time."""
    session = Session(scenes.SETTINGS)
    session.update(room(0.5))
    session.configure(scenes.SETTINGS, scenes.camera_above(height=0.5, half=0.3, orthographic=False), 24, 16)
    held, copies = [], []
    for _ in range(4):
        session.step(1)
        held.append(session.read())
        copies.append(held[-1].copy())
    assert all((a == b).all() for a, b in zip(held, copies, strict=True))
    assert all((a != b).any() for a, b in zip(copies, copies[1:], strict=False))
    assert (session.read() == held[-1]).all()


def test_cancelled_step_keeps_a_valid_picture():
    """Stop in the middle of a sample, read a sound picture, go on, and end with the same bits as without a stop."""
    session = Session(scenes.SETTINGS)
    session.update(room(0.5))
    camera = scenes.camera_above(height=0.5, half=0.3, orthographic=False)
    session.configure(scenes.SETTINGS, camera, 256, 128)
    calls = []
    # On CUDA a small picture's samples are one batch, which is over before it is asked for again.
    patience = 20 if scenes.SETTINGS.device == "cpu" else 0
    session.step(4, lambda: len(calls) > patience or calls.append(0))
    assert session.samples_done < 4
    assert np.isfinite(session.read()).all()
    while session.samples_done < 4:
        session.step(1)
    assert (session.read() == scenes.render(room(0.5), camera, (256, 128), 4)).all()


@pytest.mark.slow
def test_noise_falls_with_samples():
    """Halve the error with four times the samples (better for a low-discrepancy sequence, never worse)."""
    lamp = scenes.lamp("AREA", 30.0, scenes.place(z=2.0, x=1.0), shape="SQUARE", size_x=1.0)
    scene = scenes.delta({"plane": scenes.quad(20.0), "ball": scenes.sphere(0.3, 16)},
                         [("plane", np.eye(4), "grey"), ("ball", scenes.place(z=0.6), "grey")],
                         {"grey": scenes.material(color=0.6)}, [lamp], 0.3)
    camera = scenes.camera_above(half=1.0)
    truth = scenes.render(scene, camera, (16, 16), 4096)[..., 0]
    errors = [np.sqrt(((scenes.render(scene, camera, (16, 16), n)[..., 0] - truth) ** 2).mean()) for n in (16, 64, 256)]
    assert errors[1] < 0.62 * errors[0] and errors[2] < 0.62 * errors[1]


def test_scale_and_distance_do_not_matter():
    """Render the same picture of a scene scaled by 1e-3 to 1e3, and moved 8 km away."""
    def shot(scale=1.0, shift=0.0):
        objects = [("plane", scenes.place(x=shift, scale=scale), "grey"),
                   ("ball", scenes.place(x=shift, z=0.6 * scale, scale=scale), "grey")]
        lamp = scenes.lamp("AREA", 30.0 * scale**2, scenes.place(x=shift + scale, z=2 * scale, scale=scale),
                           shape="SQUARE", size_x=1.0)
        camera = dataclasses.replace(
            scenes.camera_above(height=3.0 * scale, half=scale, clip_start=1e-3 * scale, clip_end=1e3 * scale),
            transform=tuple(scenes.place(x=shift, z=3.0 * scale).ravel()))
        return scenes.render(
            scenes.delta({"plane": scenes.quad(2.0), "ball": scenes.sphere(0.3, 16)}, objects,
                         {"grey": scenes.material(color=0.6)}, [lamp], 0.3), camera, (32, 32), 16)

    usual = shot()
    for other in (shot(1e-3), shot(1e3), shot(shift=8192.0)):
        assert np.isclose(other, usual, rtol=2e-3, atol=1e-4).all(-1).mean() > 0.98
        np.testing.assert_allclose(other.mean(), usual.mean(), rtol=2e-3)


@pytest.mark.parametrize("levels", [False, True], ids=["flattened", "instanced"])
@pytest.mark.parametrize("scale, shift", [(1.0, 0.0), (1e-3, 0.0), (50.0, 20.0), (0.1, 30.0), (1.0, -700.0)])
def test_rays_do_not_meet_their_own_surface(scale, shift, levels, monkeypatch):
    """Find radiance 0.5 all over convex objects of albedo 0.5 in a white world; meeting its own start darkens."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 0 if levels else 1 << 20)
    angle = 0.7
    objects = []
    for i in range(2):
        matrix = scenes.place(x=shift, y=0.3 * shift, z=-5.0 * scale * i, scale=scale)
        matrix[:3, :3] = scale * np.array(
            [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        objects.append(("ball", matrix, "grey"))
    settings = dataclasses.replace(
        scenes.SETTINGS, performance=dataclasses.replace(scenes.SETTINGS.performance, instancing_threshold=1.0))
    camera = dataclasses.replace(
        scenes.camera_above(half=0.6 * scale), clip_start=1e-3 * scale, clip_end=1e3 * scale,
        transform=tuple(scenes.place(x=shift, y=0.3 * shift, z=3.0 * scale).ravel()))
    image, session = scenes.render(
        scenes.delta({"ball": scenes.sphere(1.0, 24, smooth=False)}, objects, {"grey": scenes.material(color=0.5)},
                     background=1.0), camera, (24, 24), 64, settings, passes=("Combined", "Depth"))
    assert ("two levels" in session.stats.structure) == levels
    np.testing.assert_allclose(image[..., :3].mean(dtype=np.float64), 0.5, rtol=2e-3)
    assert image[..., :3].min() > 0.44


def test_empty_scene():
    """Render the world where there is nothing else, and alpha 1."""
    image = scenes.render(scenes.delta({}, [], {}, background=0.25), samples=1)
    np.testing.assert_allclose(image, np.broadcast_to([0.25, 0.25, 0.25, 1.0], image.shape), rtol=1e-6)


def test_layers_are_stratified():
    """Look through a half clear sheet at an emitter: a power of two of samples passes it nearly equally often."""
    meshes = {"sheet": scenes.quad(2.0, 0.5), "light": scenes.quad(2.0, 0.0)}
    objects = [("sheet", np.eye(4), "half"), ("light", np.eye(4), "light")]
    materials = {"half": scenes.transparent(0.46, color=0.0), "light": scenes.emitter(1.0, 0.0)}
    image = scenes.render(scenes.delta(meshes, objects, materials), scenes.camera_above(), (16, 16), 16)[..., 0]
    np.testing.assert_allclose(image.mean(), 0.46, atol=0.01)
    # By white noise 0.125.
    assert image.std() < 0.05


def test_sun_and_sky_share_shadow_rays_by_what_they_bring():
    """Send few rays to a sky that is far darker than the sun, and none to a sun that has set: little noise in both."""
    def spread(height):
        sun = scenes.lamp("SUN", 10.0, scenes.place() @ np.diag([1.0, height, height, 1.0]), angle=0.01)
        image = scenes.render(
            scenes.delta({"floor": scenes.quad(2.0)}, [("floor", np.eye(4), "grey")],
                         {"grey": scenes.material(color=0.5)}, [sun], 0.05), scenes.camera_above(), (16, 16), 4)
        return image[..., 0].mean(), image[..., 0].std() / image[..., 0].mean()

    lit, lit_noise = spread(1.0)
    dark, dark_noise = spread(-1.0)
    np.testing.assert_allclose(dark, 0.025, rtol=0.02)
    assert lit > 20.0 * dark and dark_noise < 0.08
    # With equal chances for both and one sample each, half of the samples bring next to nothing.
    assert lit_noise < 0.005


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["reference", "realtime"])
def test_grazing_light_arrives_on_coarse_meshes(integrator):
    """Find the cosine of smooth normals along a sun's terminator, also where triangles face away from the sun."""
    settings = dataclasses.replace(
        scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator(integrator)),
        denoiser=DenoiserSettings(path_traced_rest=False, direct_iterations=0))
    # No edge lies along the terminator.
    delta = scenes.delta({"ball": scenes.sphere(0.45, 6)}, [("ball", turned(10.0), "grey")],
                         {"grey": scenes.material(color=0.5)}, [sunset(2.0)])
    session = Session(settings)
    session.update(delta)
    session.configure(settings, scenes.camera_above(), 48, 48, passes=("Combined", "Normal"))
    session.step(64)
    light, normal = session.read()[..., 0], session.read("Normal")
    cosine, inside = normal[..., 0], np.linalg.norm(normal, axis=-1) > 0.98
    for low, high in ((0.02, 0.1), (0.1, 0.2), (0.2, 0.6)):
        band = inside & (cosine > low) & (cosine < high)
        np.testing.assert_allclose(light[band].sum() / cosine[band].sum(), 2.0 * 0.5 / np.pi, rtol=0.01)
    assert light[inside & (cosine < -0.02)].max() < 1e-4


def turned(degrees):
    """Return a rotation about z."""
    angle, matrix = np.radians(degrees), np.eye(4)
    matrix[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return matrix


def sunset(power):
    """Return a small sun that shines along -x."""
    matrix = np.eye(4)
    matrix[:3, 2], matrix[:3, 0] = (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)
    return scenes.lamp("SUN", power, matrix, angle=0.001)


def test_running_sums_are_the_probabilities():
    """Draw a world's texels by rounded sums exactly as often as the table says."""
    weights = np.random.default_rng(3).exponential(size=(16, 32)) ** 4
    rows, columns = running_sums(weights)
    assert rows[-1] == 1.0 and (columns[:, -1] == 1.0).all()
    environment = no_environment(DEVICE)
    environment.width, environment.height = 32, 16
    environment.rows = wp.array(rows, dtype=float, device=DEVICE)
    environment.columns = wp.array(columns.ravel(), dtype=float, device=DEVICE)
    chance = texel_chances(environment)
    np.testing.assert_allclose(chance.sum(), 1.0, rtol=1e-12)
    np.testing.assert_allclose(chance, weights / weights.sum(), atol=2e-7)
