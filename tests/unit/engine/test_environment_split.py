# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the world's split: which worlds have an excess, how large it is, and that its table finds all of it."""

import numpy as np
import pytest
import warp as wp
from burnish.engine.device_scene import DeviceScene
from burnish.engine.environment_split import split_environment
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import WorldData
from burnish.kernels.environment_split import NO_THRESHOLD, excess_radiance, soft_radiance

from tests import scenes
from tests.device import DEVICE
from tests.direct_frames import sunny_world

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def cut(
    # In:
    radiance: wp.array[wp.vec3],
    threshold: float,
    weights: wp.vec3,
    # Out:
    soft_out: wp.array[wp.vec3],
    excess_out: wp.array[wp.vec3],
):
    """Split radiance values."""
    i = wp.tid()
    soft_out[i] = soft_radiance(radiance[i], threshold, weights)
    excess_out[i] = excess_radiance(radiance[i], threshold, weights)


def split_of(world):
    """Return a world's split and the scene's luminance weights."""
    scene = DeviceScene(DEVICE)
    scene.apply(scenes.delta({}, [], {}, background=world), scenes.SETTINGS.performance)
    return split_environment(scene.scene, DEVICE), np.array(scene.luminance)


def gradient():
    """Make a sky that goes from 0 at the horizon to 1 above."""
    builder = ProgramBuilder()
    up = builder.component(builder.input("POSITION"), 2)
    builder.emit((1.0, 1.0, 1.0), builder.math("MAXIMUM", up, 0.0), 1.0)
    return WorldData(name="gradient", program=builder.finish(), importance_resolution=256)


def test_parts_add_up(device):
    """Split random radiance into parts that sum to it, the soft one limited in luminance, colours kept."""
    rng = np.random.default_rng(0)
    radiance = np.exp(rng.normal(0, 3, (1000, 3))).astype(np.float32)
    radiance[0] = 0.0
    weights = np.array([0.2126729, 0.7151522, 0.072175], np.float32)
    parts = [wp.zeros(1000, dtype=wp.vec3, device=device) for _ in range(2)]
    wp.launch(cut, 1000, [wp.array(radiance, dtype=wp.vec3, device=device), 2.0, wp.vec3(*weights)], parts,
              device=device)
    soft, excess = (part.numpy() for part in parts)
    np.testing.assert_allclose(soft + excess, radiance, rtol=1e-5)
    assert (soft @ weights).max() <= 2.0 * (1 + 1e-5) and (excess >= 0).all()
    assert (excess[radiance @ weights > 2.0].min(1) > 0).all()
    assert not excess[radiance @ weights < 2.0].any()


@pytest.mark.parametrize("world", [scenes.world(3.0), scenes.world(0.0), gradient(),
                                   sunny_world(sun=1.0, sky=1.0, cosine=0.9)],
                         ids=["constant", "black", "gradient", "faint patch"])
def test_smooth_worlds_are_left_to_probes(world):
    """Find no excess in worlds without contrast."""
    split, _ = split_of(world)
    assert split.share == 0.0 and split.threshold == pytest.approx(float(NO_THRESHOLD))


@pytest.mark.slow
@pytest.mark.parametrize("cosine", [0.9999, 0.9999905, 0.95], ids=["moon", "sun", "window"])
@pytest.mark.parametrize("sky", [0.0, 0.5])
def test_power_of_the_excess(cosine, sky):
    """Integrate the excess of a round patch of known size, from a sun of a few texels to a window."""
    strength = 2.0 / (1.0 - cosine)
    split, weights = split_of(sunny_world(cosine=cosine, sun=strength, sky=sky, resolution=512))
    patch = np.array([1.0, 0.8, 0.5]) @ weights * strength + sky
    expected = (patch - split.threshold) * 2 * np.pi * (1 - cosine)
    # A sun of half a degree is smaller than a texel: few of the points looked at meet it.
    np.testing.assert_allclose(split.power, expected, rtol=0.03 if cosine < 0.99999 else 0.1)
    whole = expected + (split.threshold * 2 * np.pi * (1 - cosine)) + sky * 4 * np.pi
    assert split.share == pytest.approx(split.power / whole, rel=0.3)
    # The soft part is what probes can average: no brighter than some times its mean.
    assert split.threshold <= 8.0 * max(sky, 1e-3 * whole)


def test_table_covers_all_the_excess():
    """Give every texel that the patch touches a chance, and none far from it."""
    split, _ = split_of(sunny_world(cosine=0.999, sky=0.3))
    width, height = split.table.width, split.table.height
    weight = split.table.weight.numpy().reshape(height, width)
    np.testing.assert_allclose(weight.sum(dtype=np.float64), 1.0, rtol=1e-5)
    x, y = np.meshgrid((np.arange(width * 8) + 0.5) / 8 / width, (np.arange(height * 8) + 0.5) / 8 / height)
    phi, theta = 2 * np.pi * x, np.pi * y
    sun = np.array([0.3, 0.2, 0.9])
    along = (np.sin(theta) * np.cos(phi) * sun[0] + np.sin(theta) * np.sin(phi) * sun[1] + np.cos(theta) * sun[2]) / (
        np.linalg.norm(sun))
    inside = (along > 0.999).reshape(height, 8, width, 8).any((1, 3))
    assert inside.sum() > 5 and (weight[inside] > 0).all()
    near = (along > 0.99).reshape(height, 8, width, 8).any((1, 3))
    assert not weight[~near].any()


def test_a_sun_smaller_than_a_texel_keeps_its_size_and_color():
    """Bake a disk of 1.6 degrees into texels of 2.8: its boxes span the sun alone and hold its colour and power."""
    split, weights = split_of(sunny_world(cosine=0.9999, sun=1e5, resolution=128))
    texels = np.flatnonzero(split.table.weight.numpy())
    box = split.box.numpy()[texels].astype(np.int64)
    left, across, top, down = ((box >> shift & 255) / split.points for shift in (0, 8, 16, 24))
    assert (left + across <= 1.0).all() and (top + down <= 1.0).all()
    width, height = split.table.width, split.table.height
    sin_theta = np.sin(np.pi * (texels // width + 0.5) / height)
    part = 2.0 * np.pi**2 / (width * height) * sin_theta * across * down
    light = (split.excess.numpy()[texels].astype(np.float64) * part[:, None]).sum(0)
    np.testing.assert_allclose(light @ weights, split.power, rtol=1e-3)
    np.testing.assert_allclose(light / light[0], [1.0, 0.8, 0.5], rtol=1e-4)
    # A disk fills pi / 4 of the box around it, less where texels cut it.
    assert 1.0 < part.sum() / (2.0 * np.pi * 1e-4) < 2.0
