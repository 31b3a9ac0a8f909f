# SPDX-License-Identifier: GPL-3.0-or-later
"""Test what guides the final denoiser: found by itself, or collected by path-traced samples."""

import numpy as np
import pytest
from burnish.engine.passes import final_denoise
from burnish.engine.session import DENOISED
from burnish.engine.settings import Integrator

from tests import scenes
from tests.denoised_room import BOTH, SIZE, open_session

GUIDED = {"glass": ("GLASS", {"color": (0.9, 0.7, 0.5), "roughness": 0.0}),
          "satin": ("GLOSSY", {"color": 0.8, "roughness": 0.25}),
          "chrome": ("GLOSSY", {"color": 0.8, "roughness": 0.1}),
          "plastic": ("PRINCIPLED", {"color": (0.6, 0.2, 0.1), "roughness": 0.05})}


def test_guides_look_into_mirrors():
    """Find the albedo and normal of a surface, and in a mirror those of what is seen there, by its colour."""
    meshes = {"half": scenes.quad(1.5), "ceiling": scenes.quad(20.0)}
    down = scenes.place(z=5.0)
    down[1, 1] = down[2, 2] = -1.0
    objects = [("half", scenes.place(-1.5), "diffuse"), ("half", scenes.place(1.5), "mirror"),
               ("ceiling", down, "ceiling")]
    made = open_session(Integrator.REFERENCE, delta=scenes.delta(
        meshes, objects, {"diffuse": scenes.material(color=(0.6, 0.2, 0.1)), "ceiling": scenes.material(color=0.5),
                          "mirror": scenes.material("GLOSSY", color=0.8, roughness=0.0)}))
    albedo, normal = (array.numpy().reshape(*SIZE[::-1], 3) for array in made.guides())
    np.testing.assert_allclose(albedo[:, :20], np.broadcast_to((0.6, 0.2, 0.1), (SIZE[1], 20, 3)), atol=0.01)
    np.testing.assert_allclose(normal[:, :20], np.broadcast_to((0.0, 0.0, 1.0), (SIZE[1], 20, 3)), atol=0.01)
    np.testing.assert_allclose(albedo[:, -20:], 0.4, atol=0.01)
    np.testing.assert_allclose(normal[:, -20:], np.broadcast_to((0.0, 0.0, -1.0), (SIZE[1], 20, 3)), atol=0.01)


def test_guides_follow_every_path_through_mirrors():
    """See the same in all pixels between two endless mirrors: where roulette ended paths, guides would be noisy."""
    down = scenes.place(z=5.0)
    down[1, 1] = down[2, 2] = -1.0
    made = open_session(Integrator.REFERENCE, delta=scenes.delta(
        {"sheet": scenes.quad(50.0)}, [("sheet", np.eye(4), "mirror"), ("sheet", down, "mirror")],
        {"mirror": scenes.material("GLOSSY", color=0.8, roughness=0.0)}))
    albedo = made.guides()[0].numpy()
    np.testing.assert_allclose(albedo, 0.8 ** (final_denoise.MIRRORS + 1), rtol=0.01)
    made.close()


def test_guides_are_kept_until_the_view_changes():
    """Trace guides once for a view, and again only where there are more samples, up to a limit."""
    made = open_session(Integrator.REFERENCE, passes=("Combined",))
    made.step(1)
    few = made.guides()
    assert made.guides() is few
    made.step(63)
    first = made.guides()
    assert first is not few and np.abs(first[0].numpy() - few[0].numpy()).max() > 0.01
    made.step(8)
    assert made.guides() is first
    made.configure(made.settings, scenes.camera_above(2.0, 0.5), *SIZE, passes=("Combined",))
    second = made.guides()
    assert second is not first and np.abs(second[0].numpy() - first[0].numpy()).max() > 0.1


@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n == "satin" else pytest.mark.slow) for n in GUIDED])
def test_samples_collect_the_same_guides(name):
    """Collect in the path tracer's samples what guides that are found by themselves show, but for noise."""
    kind, values = GUIDED[name]
    down = scenes.place(z=5.0)
    down[1, 1] = down[2, 2] = -1.0
    pictured = scenes.delta(
        {"box": scenes.box(0.7), "ceiling": scenes.quad(20.0)},
        [("box", scenes.place(z=0.5), "thing"), ("ceiling", down, "ceiling")],
        {"thing": scenes.material(kind, **values), "ceiling": scenes.material(color=(0.2, 0.5, 0.7))}, background=0.3)
    found, collected = (open_session(Integrator.REFERENCE, passes, pictured) for passes in (
        ("Combined",), ("Combined", DENOISED)))
    for made in (found, collected):
        made.step(256)
    assert collected._film.guides is not None and found._film.guides is None
    for ours, theirs in zip(collected.guides(), found.guides(), strict=True):
        ours, theirs = ours.numpy(), theirs.numpy()
        np.testing.assert_allclose(ours.mean(0), theirs.mean(0), atol=0.005)
        assert np.abs(ours - theirs).mean() < 0.02


def test_collected_guides_end_with_the_view():
    """Forget what samples have collected when something changes, in frames at rest too."""
    for integrator in BOTH:
        made = open_session(integrator)
        made.step(8)
        first = made.guides()[0].numpy()
        made.configure(made.settings, scenes.camera_above(2.0, 0.5), *SIZE, passes=("Combined", DENOISED))
        made.step(8)
        fresh = open_session(integrator, camera=scenes.camera_above(2.0, 0.5))
        fresh.step(8)
        np.testing.assert_allclose(made.guides()[0].numpy(), fresh.guides()[0].numpy(), atol=1e-5)
        assert np.abs(first - fresh.guides()[0].numpy()).max() > 0.1


def test_sky_is_its_own_albedo():
    """Take the world's light for the albedo of what it shows, at most 1, and no normal."""
    nothing = scenes.delta({}, [], {}, background=0.25)
    albedo, normal = open_session(Integrator.REFERENCE, delta=nothing).guides()
    np.testing.assert_allclose(albedo.numpy(), 0.25, atol=1e-5)
    assert not normal.numpy().any()
    bright = scenes.delta({}, [], {}, background=40.0)
    np.testing.assert_allclose(open_session(Integrator.REFERENCE, delta=bright).guides()[0].numpy(), 1.0, atol=1e-5)
