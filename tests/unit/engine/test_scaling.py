# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the generated scenes, the fits of growth, the variants and the profile that `burnish bench` measures with."""

import dataclasses

import numpy as np
import pytest
from burnish.addon import bench_modes
from burnish.engine import scaling
from burnish.engine.frame_profile import PASSES, buffer_bytes, pass_of, profile_frame
from burnish.engine.generated_scenes import SceneRecipe, generate_scene, scene_flight
from burnish.engine.measure_moving import FrameTimes, fly, measure_frames, there_and_back
from burnish.engine.presets import GOVERNED, KEPT
from burnish.engine.scene import CameraData
from burnish.engine.session import Session
from burnish.engine.settings import CacheSettings, Integrator, RenderSettings, SamplingSettings, setting_info
from burnish.engine.variants import DEFAULT, VARIANTS, variant_settings

from tests import scenes

SIZE = (32, 18)
SETTINGS = dataclasses.replace(
    scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=12))


@pytest.mark.parametrize("recipe", [
    SceneRecipe(triangles=20_000), SceneRecipe(triangles=0, instances=500), SceneRecipe(lamps=37, materials=11),
    SceneRecipe(texture_bytes=8 << 20), SceneRecipe(glossy=0.5)], ids=str)
def test_recipes_are_followed(recipe):
    """Make as many triangles, instances, lamps, materials and textures as the recipe says."""
    delta = generate_scene(recipe)
    table = delta.instances
    counts = np.array([len(delta.meshes[key].triangles) for key in table.mesh_keys])
    stones = counts[table.mesh_index[:-1]].sum()
    assert len(table.mesh_index) == recipe.instances + 1
    if recipe.triangles:
        assert stones == pytest.approx(recipe.triangles, rel=0.1)
        assert len(delta.meshes) == recipe.instances + 1
    else:
        assert len(delta.meshes) == 2
    assert len(delta.lights) == recipe.lamps
    assert sum(light.color[0] for light in delta.lights) == pytest.approx(4000.0)
    assert sum(image.pixels.nbytes for image in delta.images.values()) == recipe.texture_bytes
    assert len({keys for keys in table.material_sets}) == max(recipe.materials, len(delta.images)) + 1
    mirrors = delta.meshes["yard"].material_slots[:128].mean()
    assert mirrors == recipe.glossy
    again = generate_scene(recipe)
    assert np.array_equal(again.instances.transforms, table.transforms)


def test_stones_are_closed_and_look_outwards():
    """Give stones faces whose normals point away from their middle, and normals of unit length."""
    mesh = generate_scene(SceneRecipe(triangles=6400)).meshes["stone 0"]
    p = mesh.positions[mesh.triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert ((normal * p.mean(1)).sum(-1) > 0).mean() > 0.99
    np.testing.assert_allclose(np.linalg.norm(mesh.corner_normals, axis=-1), 1.0, rtol=1e-5)


@pytest.fixture(scope="module")
def measured():
    """Return a session with a small generated scene, and its times."""
    session = Session(SETTINGS)
    session.update(generate_scene(SceneRecipe(triangles=4000, glossy=0.5)))
    return session, measure_frames(session, SETTINGS, scene_flight(8, SIZE), SIZE, frames=3)


def test_measured_frames_show_the_scene(measured):
    """Light the scene, trace reflections in its glossy share, time every section and kernel."""
    session, times = measured
    picture = session.read()[..., :3]
    assert np.isfinite(picture).all() and picture.mean() > 0.05 and picture.std() > 0.02
    assert 0 < times.counts["reflection rays"] < SIZE[0] * SIZE[1] // 4
    assert times.frames == 3 and times.frame > 0.0 and times.slowest >= times.frame >= times.python > 0.0
    assert {"Primary rays", "Composite", "Reflection rays"} <= set(times.sections)
    assert sum(times.kernels.values()) == pytest.approx(sum(times.sections.values()), rel=0.5)


def test_profile_tells_of_every_pass(measured):
    """Count all launches and all bytes of the passes recorded, once, and put every section under a pass."""
    session, times = measured
    profile = profile_frame(session, times)
    by_name = {each.name: each for each in profile.passes}
    assert sum(profile.launches.values()) == sum(each.launches for each in profile.passes) > 60
    assert sum(each.milliseconds for each in profile.passes) == pytest.approx(sum(times.sections.values()))
    assert by_name["G-buffer"].rays == SIZE[0] * SIZE[1] and by_name["Direct light"].rays > 0
    assert "Refraction" not in by_name and profile.skipped["refraction"]
    pixels = SIZE[0] * SIZE[1]
    gbuffer = session.pipeline.gbuffer.history.buffers
    held = sum(array.size * 4 for buffers in gbuffer for array in (buffers.depth, buffers.normal))
    assert held == 16 * pixels < by_name["G-buffer"].buffer_bytes < 400 * pixels
    cells = session.pipeline.cache.capacity
    # Key, direct, indirect, touched, sums, counts.
    assert buffer_bytes(session.pipeline)["Radiance cache"] > cells * (8 + 16 + 16 + 4 + 48 + 8)
    assert all(each.floor_bytes > 0.0 and each.floor > 0.0 for each in profile.passes)
    assert profile.at_rest > 0.0 and profile.triangles == session.stats.triangles > 3000


def test_sections_belong_to_passes():
    """Put sections under the pass whose title is the most exact."""
    assert pass_of("Reflection denoising") == "Reflections, filter" and pass_of("Reflection hits") == "Reflections"
    assert pass_of("Direct denoising") == "Direct light, filter" and pass_of("Probe rays") == "Screen probes"
    assert pass_of("") == next(iter(PASSES))


def test_powers_and_logarithms_are_fitted():
    """Find the power of a power law, the slope of a logarithm, and tell them apart."""
    x = np.array([1e4, 1e5, 1e6, 1e7])
    power = scaling.fit_growth(x, 2.0 * x**0.3)
    assert power.exponent == pytest.approx(0.3) and power.exponent_error < 1e-9 and power.log_share < 0.99
    logarithm = scaling.fit_growth(x, 1.0 + 0.2 * np.log2(x))
    assert logarithm.log_slope == pytest.approx(0.2) and logarithm.log_share == pytest.approx(1.0)
    assert logarithm.ratio == pytest.approx((1.0 + 0.2 * np.log2(1e7)) / (1.0 + 0.2 * np.log2(1e4)))
    straight = scaling.fit_growth([0.0, 0.5, 1.0], [1.0, 2.0, 3.0])
    assert straight.exponent is None and straight.slope == pytest.approx(2.0)
    flat = scaling.fit_growth([1.0, 10.0], [2.0, 2.0])
    assert flat.exponent == 0.0 and flat.ratio == 1.0


@pytest.mark.parametrize(("name", "x", "y", "verdict"), [
    ("triangles", (1e4, 1e5, 1e6, 1e7), (4.0, 5.0, 6.0, 7.0), "met"),
    ("triangles", (1e4, 1e5, 1e6, 1e7), (4.0, 6.0, 9.0, 13.0), "missed"),
    ("lamps", (1, 10, 100, 1000), (3.0, 4.0, 4.1, 4.2), "met"),
    ("lamps", (1, 10, 100, 1000), (3.0, 4.0, 5.0, 6.0), "missed"),
    ("lamps", (1, 10), (3.0, 3.0), "not judged"),
    ("instances", (1, 1000), (3.0, 3.0), ""),
])
def test_goals_are_judged(name, x, y, verdict):
    """Say whether a goal is met, and nothing where too little was measured or nothing is asked."""
    result = scaling.SweepResult(name, name, [{"value": a, "frame": b} for a, b in zip(x, y, strict=True)])
    assert scaling.goal_of(result).partition(":")[0] == verdict


def test_sweeps_leave_out_what_does_not_fit(monkeypatch):
    """Measure smaller scenes first; name what needs too much memory and what time is not left for."""
    told = []
    monkeypatch.setattr(scaling, "measure_point", lambda sweep, value, *rest: {
        "value": value, "swept": value, "frame": value, "measure_seconds": 1.0, "generate_seconds": 0.0,
        "build_seconds": 1.0, "sections": {"A": value, "B": 0.0}})
    monkeypatch.setattr(scaling, "too_large", lambda recipe, device: "huge" if recipe.lamps > 100 else "")
    session = Session(SETTINGS)
    run = (scaling.SWEEPS["lamps"], SETTINGS, session, (1, 10, 100, 1000), SIZE)
    result = scaling.run_sweep(*run, 1e3, told.append)
    assert [point["value"] for point in result.points] == [1, 10, 100] and result.left_out == {"1000": "huge"}
    assert result.fit.exponent == pytest.approx(1.0) and result.section_fits == {"A": pytest.approx(1.0), "B": None}
    assert result.goal.startswith("missed") and len(told) == 4
    result = scaling.run_sweep(*run, 0.0, told.append)
    assert len(result.points) == 1 and result.left_out["10"] == "no time left" and result.goal == ""


def test_names_of_sweeps_are_the_options():
    """Offer the sweeps that there are, with the values of the smallest goal's range."""
    assert tuple(scaling.SWEEPS) == bench_modes.SWEEPS
    assert (min(scaling.SWEEPS["triangles"].values), max(scaling.SWEEPS["triangles"].values)) == (1e4, 1e7)
    assert (min(scaling.SWEEPS["lamps"].values), max(scaling.SWEEPS["lamps"].values)) == (1, 1e4)
    assert (min(scaling.SWEEPS["instances"].values), max(scaling.SWEEPS["instances"].values)) == (1, 1e6)


def test_every_switch_has_a_variant():
    """Measure each on-off setting of the real-time integrator with its default reversed, and each preset."""
    defaults, changed = RenderSettings(), set()
    for name, changes in VARIANTS.items():
        settings = variant_settings(defaults, name)
        assert (settings == defaults) == (name == DEFAULT)
        changed |= set(changes) if not isinstance(changes, str) else set()
    switches = {f"{group}.{name}" for group in GOVERNED
                for name, field in setting_info(type(getattr(defaults, group))).items()
                if isinstance(field.default, bool)}
    # Frames up to the rest regime never see these.
    switches -= KEPT | {"denoiser.path_traced_rest"}
    assert switches <= changed, switches - changed


def test_flights_go_there_and_back():
    """Fly forwards without a jump, as far as what is near allows, and back again."""
    cameras = fly(CameraData(), near=1.0, middle=10.0, count=5)
    places = np.array([camera.transform for camera in cameras]).reshape(-1, 4, 4)[:, :3, 3]
    assert cameras[0] == CameraData()
    np.testing.assert_allclose(places[-1], (0.2, 0.0, -0.4))
    camera = there_and_back(cameras)
    assert [cameras.index(camera(number)) for number in range(10)] == [0, 1, 2, 3, 4, 3, 2, 1, 0, 1]
    assert there_and_back(cameras[:1])(7) == cameras[0]
    assert FrameTimes(frame=1.0).as_dict()["frame"] == 1.0
