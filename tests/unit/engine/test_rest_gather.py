# SPDX-License-Identifier: GPL-3.0-or-later
"""Test final gather at rest: its energy, dark places below and behind things, motion that it leaves alone, edits."""

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine.scene import SceneDelta
from burnish.kernels.long_mean import unpack_mean

from tests import light_scenes, scenes
from tests.light_checks import Setup, luminance
from tests.light_scenes import LitScene, look_at, slab

SIZE = (48, 36)
# As large a cell in the scene as in a picture of usual size.
CACHE = {"cell_pixels": 8.0, "capacity": 16}


def setup(gather=True, truth_samples=512):
    """Return how to measure, with and without the gather."""
    return Setup(SIZE, truth_samples=truth_samples, groups={"denoiser": {"rest_gather": gather}, "cache": CACHE})


@wp.kernel(module="unique")
def unpack(light: wp.array[wp.uint64], out: wp.array[wp.vec3]):
    i = wp.tid()
    out[i] = unpack_mean(light[i])


class Gathered:
    """A session whose gathered light is looked at."""

    def __init__(self, scene, gather=True):
        self.session = setup(gather).session(scene)
        self.realtime = self.session._realtime
        self.pipeline = self.realtime.pipeline

    def history(self):
        """Return this frame's history."""
        return self.pipeline.rest_gather.history.current(self.realtime.views.parity)

    def light(self):
        """Return the means of the pixels' samples, [h, w, 3]."""
        light = self.history().light
        out = wp.zeros(len(light), dtype=wp.vec3, device=light.device)
        wp.launch(unpack, len(light), inputs=[light], outputs=[out], device=light.device)
        return out.numpy().reshape(SIZE[1], SIZE[0], 3)

    def samples(self):
        """Return the number of samples in them, [h, w]."""
        return self.history().state.numpy().view(np.float16).reshape(SIZE[1], SIZE[0], 4)[..., 0].astype(float)


def leaf():
    """Make a leaf, brighter from behind, in a white sky."""
    builder = scenes.ProgramBuilder()
    builder.closure("DIFFUSE", 0.3, color=0.9)
    builder.closure("TRANSLUCENT", 0.7, color=(0.9, 0.5, 0.2))
    material = scenes.MaterialData(name="leaf", program=builder.finish())
    delta = scenes.delta({"leaf": scenes.quad(50.0)}, [("leaf", np.eye(4), "leaf")], {"leaf": material},
                         background=1.0)
    return LitScene(delta, look_at((0.0, -1.8, 1.0), (0.0, 0.0, 0.0), SIZE, 0.8))


def table():
    """Make a low table and a thin ledge over a floor, and a box beside it, in a white sky."""
    meshes = {"floor": scenes.quad(20.0), "top": slab((-0.6, -0.5, 0.3), (0.6, 0.5, 0.34)),
              "back": slab((-0.6, 0.5, 0.0), (0.6, 0.54, 0.34)), "box": slab((-0.3, -0.1, 0.0), (0.0, 0.2, 0.15)),
              "ledge": slab((0.1, -0.54, 0.15), (0.6, -0.5, 0.16))}
    delta = scenes.delta(meshes, [(name, np.eye(4), "grey") for name in meshes],
                         {"grey": scenes.material(color=0.6)}, background=1.0)
    return LitScene(delta, look_at((0.25, -2.2, 0.5), (0.0, 0.0, 0.12), SIZE, 0.7))


@pytest.mark.parametrize("scene", [
    light_scenes.white_sky(0.8, SIZE), light_scenes.white_sky(0.8, SIZE, "sphere"), leaf()])
def test_white_sky_is_white(scene):
    """Gather exactly the sky's radiance from a white sky, before surfaces and behind leaves."""
    made = Gathered(scene)
    made.session.step(48)
    known = made.samples() > 0.0
    assert known.sum() > 100
    mean = made.light()[known].mean(0)
    np.testing.assert_allclose(mean, 1.0, atol=0.01)


@pytest.mark.slow
def test_dark_places_are_dark():
    """Find the light below a table as Reference does, where probes and cells are far too coarse for it."""
    scene = table()
    truth = luminance(setup().truth(scene))
    errors = []
    for gather in (False, True):
        picture = luminance(setup(gather).picture(scene, 160))
        ratio = [p[:36, :48].reshape(9, 4, 12, 4).mean((1, 3)) for p in (picture, truth)]
        errors.append(np.sqrt(np.mean((ratio[0] / ratio[1] - 1.0) ** 2)))
        print("gather", gather, "error of blocks", errors[-1], "mean", picture.mean() / truth.mean())
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.06


def test_motion_is_left_alone():
    """Render the same bits with and without the gather while the camera moves, and record nothing of it."""
    pictures = []
    for gather in (True, False):
        made = Gathered(table(), gather)
        for frame in range(6):
            camera = look_at((0.25 + 0.02 * frame, -2.2, 0.5), (0.0, 0.0, 0.12), SIZE, 0.7)
            made.session.configure(setup(gather).settings(), camera, *SIZE)
            made.session.step(1)
        assert not any(resting for _, resting, *_ in made.pipeline._graphs)
        assert made.pipeline.gather.stats() == {}
        pictures.append(made.session.read())
    np.testing.assert_array_equal(*pictures)


def test_edits_start_anew():
    """Forget all samples when a light is edited, and those of before a move of the camera."""
    scene = light_scenes.contact(SIZE)
    made = Gathered(scene)
    made.session.step(64)
    assert made.samples().max() > 3.0
    made.session.update(SceneDelta(lights=[dataclasses.replace(lamp, color=(0.0,) * 3) for lamp in scene.lamps]))
    made.session.step(3)
    assert made.samples().max() <= 2.0
    made.session.step(30)
    made.session.configure(setup().settings(), look_at((0.5, -2.4, 1.3), (0.0, 0.0, 0.15), SIZE, 0.6), *SIZE)
    made.session.step(3)
    assert made.samples().max() <= 2.0
