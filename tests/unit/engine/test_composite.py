# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the composite pass: light times colour adds up, bad numbers stay out, light passes combine as in Blender."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from burnish.engine.debug_views import DEBUG_VIEWS
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.passes.composite import LIGHT_PASSES, CompositePass
from burnish.engine.passes.rest import RestBlend
from burnish.engine.settings import DenoiserSettings
from burnish.kernels.gbuffer import SURFACE_TRANSLUCENT, GBuffer
from burnish.kernels.types import Scene
from burnish.kernels.view import SKY_DEPTH, View

W, H = 40, 16
COUNT = W * H
SKY = slice(0, 4 * W)
"""Rows at the bottom that show the world."""

LEANING = slice(200, 260)
"""Pixels whose shading normal leans away from their geometric one"""


def pack(color: np.ndarray) -> np.ndarray:
    """Pack colours [n, 3] as packing.pack_color does."""
    root = np.sqrt(np.clip(color, 0.0, 1.0))
    r, g, b = (np.uint32(root[:, i] * scale + 0.5) for i, scale in enumerate((2047, 2047, 1023)))
    return r | (g << np.uint32(11)) | (b << np.uint32(22))


def unpack(packed: np.ndarray) -> np.ndarray:
    """Return the colours [n, 3] of pack()."""
    parts = [(packed >> np.uint32(shift)) & np.uint32(mask) for shift, mask in ((0, 2047), (11, 2047), (22, 1023))]
    return np.stack([(p / mask) ** 2 for p, mask in zip(parts, (2047, 2047, 1023), strict=True)], 1)


class Setup:
    """A composite pass with random surfaces and light, recorded for both parities."""

    def __init__(self, device: str, light_passes: bool = False):
        self.device = device
        rng = np.random.default_rng(7)
        self.diffuse, self.specular, self.translucent = (pack(rng.random((COUNT, 3)) * 0.5) for _ in range(3))
        self.emission = np.concatenate([rng.random((COUNT, 3)), np.ones((COUNT, 1))], 1).astype(np.float16)
        self.lights = [rng.random((COUNT, 4)).astype(np.float16) for _ in range(3)]
        self.ratio = (3.0 * rng.random(COUNT)).astype(np.float16)
        self.depth = np.full(COUNT, 3.0, np.float32)
        self.depth[SKY] = SKY_DEPTH
        self.half = np.arange(COUNT) % 2 == 0
        gbuffer = GBuffer()
        gbuffer.depth = wp.array(self.depth, dtype=float, device=device)
        flags = np.where(self.half, np.uint32(SURFACE_TRANSLUCENT), np.uint32(0)).astype(np.uint32)
        up = np.full(COUNT, 0x80008000, np.uint32)  # packing.pack_normal of +z
        leaning = up.copy()
        leaning[LEANING] = 0xBFFF8000  # y = 0.5, z = 0.5 before it is normalised: by 45 degrees
        for name, values in (("geometric_normal", up), ("normal", leaning), ("diffuse", self.diffuse),
                             ("specular", self.specular), ("f0", self.specular),
                             ("translucent", self.translucent), ("material", flags)):
            setattr(gbuffer, name, wp.array(values, dtype=wp.uint32, device=device))
        gbuffer.emission = wp.array(self.emission, dtype=wp.vec4h, device=device)
        self.arrays = [wp.array(light, dtype=wp.vec4h, device=device) for light in self.lights]
        self.views = wp.zeros(1, dtype=View, device=device)
        y, x = np.mgrid[0:H, 0:W] + 0.5
        reprojection = SimpleNamespace(
            position=wp.array(np.stack([x, y], -1).reshape(-1, 2).astype(np.float32), dtype=wp.vec2, device=device),
            taps=wp.full(COUNT, 15, dtype=wp.uint8, device=device))
        self.gbuffer, self.reprojection = gbuffer, reprojection
        self.composite = CompositePass(device, DenoiserSettings(), light_passes)
        self.composite.resize(W, H)
        self.graphs = [FrameGraph(device), FrameGraph(device)]
        direct = SimpleNamespace(diffuse=self.arrays[0], specular=self.arrays[1])
        ratio = wp.array(self.ratio, dtype=wp.float16, device=device)
        self.pictures = [
            self.composite.record(
                graph, parity, Scene(), self.views, gbuffer, reprojection, direct, self.arrays[2], ratio)
            for parity, graph in enumerate(self.graphs)]
        self.frame = -1

    def run(self, rest: int = 0, transparent: int = 0, restart: int = 0) -> np.ndarray:
        """Run one frame and return the picture [n, 4]."""
        self.frame += 1
        row = np.zeros(1, View.numpy_dtype())
        row["rest"], row["transparent"], row["restart"], row["light_age"] = rest, transparent, restart, 1 << 20
        row["frame"] = 1 << 20
        self.views.assign(row)
        self.graphs[self.frame % 2].replay()
        return self.pictures[self.frame % 2].numpy().copy()

    @property
    def albedo(self) -> np.ndarray:
        """Return diffuse and translucent albedo together, 0 in the sky."""
        total = unpack(self.diffuse) + np.where(self.half[:, None], unpack(self.translucent), 0.0)
        total[SKY] = 0.0
        return total

    @property
    def indirect(self) -> np.ndarray:
        """Return the indirect light [n, 3] that reaches the surfaces."""
        irradiance = self.lights[2][:, :3].astype(float)
        irradiance[LEANING] *= 0.11 + 0.89 * np.sqrt(0.5)
        return irradiance

    @property
    def expected(self) -> np.ndarray:
        """Return the right colours [n, 3]."""
        diffuse, specular = (light[:, :3].astype(float) for light in self.lights[:2])
        irradiance = self.indirect
        mirrored = unpack(self.specular)
        mirrored[SKY] = 0.0
        reflected = irradiance * self.ratio[:, None].astype(float)
        return self.emission[:, :3] + self.albedo * (diffuse + irradiance) + mirrored * (specular + reflected)


def test_light_times_colour_adds_up(device):
    """Add emission, diffuse and specular light with their colours; the sky has its emission alone."""
    setup = Setup(device)
    picture = setup.run(restart=1)
    np.testing.assert_allclose(picture[:, :3], setup.expected, rtol=1.5e-3)
    assert (picture[:, 3] == 1.0).all()
    np.testing.assert_allclose(picture[SKY, :3], setup.emission[SKY, :3].astype(np.float32), rtol=1e-6)
    color = setup.composite.color.current(0).numpy()
    assert setup.composite.color.previous(1) is setup.composite.color.current(0)
    np.testing.assert_allclose(color[:, :3], setup.expected, rtol=1.5e-3)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_bad_light_stays_out_of_the_histories(device, bad):
    """Leave out light that is not finite, of any source, and be free of it in the next frame."""
    setup = Setup(device)
    clean = setup.run(restart=1)
    for k, (array, light) in enumerate(zip(setup.arrays, setup.lights, strict=True)):
        broken = light.copy()
        broken[5 * W + k] = bad
        array.assign(broken)
    broken = setup.emission.copy()
    broken[7] = bad
    setup.gbuffer.emission.assign(broken)
    for rest in (0, 1):
        assert np.isfinite(setup.run(rest=rest)).all()
    for array, light in zip(setup.arrays, setup.lights, strict=True):
        array.assign(light)
    setup.gbuffer.emission.assign(setup.emission)
    np.testing.assert_allclose(setup.run(restart=1), clean, rtol=1e-6)


def test_bright_light_is_clamped_not_infinite(device):
    """Keep sums of half-floats at their largest values finite."""
    setup = Setup(device)
    for array, light in zip(setup.arrays, setup.lights, strict=True):
        array.assign(np.full_like(light, 65504.0))
    picture = setup.run(restart=1)
    assert np.isfinite(picture).all() and picture.max() == 65000.0 - 65000.0 % 32


def test_transparent_film_keeps_alpha(device):
    """Give the G-buffer's alpha with a transparent film, and 1 without."""
    setup = Setup(device)
    emission = setup.emission.copy()
    emission[SKY] = 0.0
    setup.gbuffer.emission.assign(emission)
    assert (setup.run(restart=1)[:, 3] == 1.0).all()
    picture = setup.run(restart=1, transparent=1)
    assert (picture[SKY] == 0.0).all() and (picture[4 * W:, 3] == 1.0).all()


def test_light_passes_combine_to_the_diffuse_light(device):
    """Give passes whose (direct + indirect) * color is the mean diffuse light of the frames at rest."""
    setup = Setup(device, light_passes=True)
    setup.run(restart=1)
    total = np.zeros((COUNT, 3))
    for rest in range(3):
        scale = 1.0 + rest
        for array, light in zip(setup.arrays, setup.lights, strict=True):
            array.assign((light.astype(np.float32) * scale).astype(np.float16))
        setup.run(rest=rest)
        total += setup.albedo * scale * (setup.lights[0][:, :3].astype(float) + setup.indirect) / 3
    direct, indirect, color = (setup.composite.read_light_pass(name).numpy() for name in LIGHT_PASSES)
    np.testing.assert_allclose((direct + indirect) * color, total, rtol=2e-3, atol=1e-6)
    np.testing.assert_allclose(color, setup.albedo, rtol=1e-5, atol=1e-7)
    assert (direct[SKY] == 0.0).all()
    with pytest.raises(KeyError):
        setup.composite.read_light_pass("Glossy Direct")
    with pytest.raises(KeyError):
        Setup(device).composite.read_light_pass(LIGHT_PASSES[0])


def test_debug_views_show_this_frame(device):
    """Draw direct and indirect light that add up to the composite, and a history that grows lighter."""
    setup = Setup(device)
    drawn = {}
    for name in setup.composite.debug_views:
        picture = wp.zeros(COUNT, dtype=wp.vec4, device=device)
        setup.composite.record_debug(setup.graphs[0], 0, name, picture)
        drawn[name] = picture
    setup.run(restart=1)
    first = drawn["composite.history"].numpy().copy()
    total = drawn["composite.direct"].numpy() + drawn["composite.indirect"].numpy()
    np.testing.assert_allclose(total[:, :3], setup.expected, rtol=1.5e-3)
    for rest in range(1, 21):
        setup.run(rest=rest)
    assert (drawn["composite.history"].numpy()[:, :3].sum(1) > first[:, :3].sum(1)).all()


def test_debug_views_are_in_the_table():
    """Explain in engine/debug_views.py exactly the views that these passes draw."""
    for each in (CompositePass, RestBlend):
        assert each.debug_views == {k: v for k, v in DEBUG_VIEWS.items() if k.startswith(each.name + ".")}


def test_reset_forgets_everything(device):
    """Leave nothing of earlier frames in any buffer."""
    setup = Setup(device, light_passes=True)
    setup.run(restart=1)
    setup.run(rest=1)
    setup.composite.reset()
    assert not setup.pictures[0].numpy().any() and not setup.pictures[1].numpy().any()
    assert not setup.composite.color.current(0).numpy().any()
    assert not setup.composite.read_light_pass("Diffuse Color").numpy().any()
