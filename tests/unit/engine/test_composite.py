# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the composite pass: light times colour adds up, bad numbers stay out, light passes make up the picture."""

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
from burnish.kernels.gbuffer import SURFACE_COATED, SURFACE_TRANSLUCENT, SURFACE_TRANSMITS, GBuffer
from burnish.kernels.reflection_types import ReflectionOptions
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


def pack_mean(color: np.ndarray) -> np.ndarray:
    """Pack colours [n, 3] as long_mean.pack_mean does."""
    codes = ((color * 2.0**-79).astype(np.float32).view(np.uint32) + np.uint32(128)) >> np.uint32(8)
    r, g, b = codes.astype(np.uint64).T
    return r | (g << np.uint64(21)) | (b << np.uint64(42))


def smooth_step(x: np.ndarray) -> np.ndarray:
    """Return 0 up to x = 0, rising smoothly to 1 at x = 1."""
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def reflection_options() -> ReflectionOptions:
    """Return the options of the defaults."""
    options = ReflectionOptions()
    options.width, options.height = W, H
    options.traced = options.weak = 0.2
    options.diffuse, options.blend = 0.6, 0.1
    return options


class Setup:
    """A composite pass with random surfaces and light, recorded for both parities."""

    def __init__(self, device: str, light_passes: tuple = (), *, reflection: bool = False, transmission: bool = False):
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
        self.glass, self.coated = (np.arange(COUNT) // 2 % 3 == 0), (np.arange(COUNT) // 6 % 3 == 0)
        self.transmitted = pack(rng.random((COUNT, 3)) * 0.5)
        self.roughness, self.coat_roughness = (rng.integers(0, 65536, COUNT).astype(np.uint32) for _ in range(2))
        self.images = [rng.random((COUNT, 3)).astype(np.float32) for _ in range(2)]
        self.has = (reflection, transmission)
        flags = self.roughness.copy()
        for where, flag in ((self.half, SURFACE_TRANSLUCENT), (self.glass, SURFACE_TRANSMITS),
                            (self.coated, SURFACE_COATED)):
            flags |= np.where(where, np.uint32(flag), np.uint32(0))
        up = np.full(COUNT, 0x80008000, np.uint32)  # packing.pack_normal of +z
        leaning = up.copy()
        leaning[LEANING] = 0xBFFF8000  # y = 0.5, z = 0.5 before it is normalised: by 45 degrees
        for name, values in (("geometric_normal", up), ("normal", leaning), ("diffuse", self.diffuse),
                             ("specular", self.specular), ("f0", self.specular),
                             ("translucent", self.translucent), ("material", flags),
                             ("transmitted", self.transmitted),
                             ("coat", np.uint32(6553) | (self.coat_roughness << np.uint32(16)))):
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
        packed = [wp.array(pack_mean(image), dtype=wp.uint64, device=device) for image in self.images]
        self.reflections = [image if has else None for image, has in zip(packed, self.has, strict=True)]
        self.pictures = [
            self.composite.record(
                graph, parity, self.views, gbuffer, reprojection, direct, self.arrays[2], ratio,
                *self.reflections, reflection_options() if reflection else None)
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
    def mirrored(self) -> np.ndarray:
        """Return the specular albedo, 0 in the sky."""
        mirrored = unpack(self.specular)
        mirrored[SKY] = 0.0
        return mirrored

    @property
    def scattered(self) -> np.ndarray:
        """Return the translucent albedo, 0 in the sky."""
        scattered = np.where(self.half[:, None], unpack(self.translucent), 0.0)
        scattered[SKY] = 0.0
        return scattered

    @property
    def glassy(self) -> np.ndarray:
        """Return the albedo of specular transmission, 0 in the sky."""
        passed = np.where(self.glass[:, None], unpack(self.transmitted), 0.0)
        passed[SKY] = 0.0
        return passed

    @property
    def reflected(self) -> np.ndarray:
        """Return the indirect light that reflections show, without the surfaces' colours."""
        rough = self.indirect * self.ratio[:, None].astype(float)
        if not self.has[0]:
            return rough
        sharpest = np.where(self.coated, np.minimum(self.roughness, self.coat_roughness), self.roughness) / 65535
        share = 1.0 - smooth_step((sharpest - 0.55) / 0.05)[:, None]
        return rough * (1.0 - share) + self.images[0] * share

    @property
    def passed(self) -> np.ndarray:
        """Return the light that comes through the surfaces, without their colours."""
        return self.images[1] if self.has[1] else self.indirect

    @property
    def expected(self) -> np.ndarray:
        """Return the right colours [n, 3]."""
        diffuse, specular = (light[:, :3].astype(float) for light in self.lights[:2])
        reflecting = self.albedo - self.scattered
        return (self.emission[:, :3] + self.albedo * diffuse + reflecting * self.indirect
                + self.mirrored * (specular + self.reflected) + (self.glassy + self.scattered) * self.passed)


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


@pytest.mark.parametrize("transmission", [False, True])
def test_samples_replace_irradiance_where_there_are_some(device, transmission):
    """Show reflections up to the roughness where diffuse light takes over, by the sharper of two lobes, and glass."""
    setup = Setup(device, reflection=True, transmission=transmission)
    np.testing.assert_allclose(setup.run(restart=1)[:, :3], setup.expected, rtol=1.5e-3)
    black = setup.specular.copy()
    black[:] = 0
    setup.gbuffer.specular.assign(black)
    setup.specular = black
    np.testing.assert_allclose(setup.run(restart=1)[:, :3], setup.expected, rtol=1.5e-3)


def test_any_bits_in_the_samples_are_finite(device):
    """Show no more than the brightest light whatever the images of samples hold."""
    setup = Setup(device, reflection=True, transmission=True)
    for image in setup.reflections:
        image.fill_((1 << 63) | ((1 << 63) - 1))
    picture = setup.run(restart=1)
    assert np.isfinite(picture).all() and (picture >= 0.0).all() and picture.max() > 1e4


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


@pytest.mark.parametrize("samples", [False, True])
def test_light_passes_make_up_the_picture(device, samples):
    """Give passes whose (direct + indirect) * color, with the emission, is the mean picture of the frames at rest."""
    setup = Setup(device, LIGHT_PASSES, reflection=samples, transmission=samples)
    setup.run(restart=1)
    images, total = setup.images, np.zeros((COUNT, 3))
    for rest in range(3):
        scale = 1.0 + rest
        for array, light in zip(setup.arrays, setup.lights, strict=True):
            array.assign((light.astype(np.float32) * scale).astype(np.float16))
        for array, image in zip(setup.reflections, images, strict=True):
            if array is not None:
                array.assign(pack_mean(image * np.float32(scale)))
        setup.run(rest=rest)
        total += setup.composite.color.current(setup.frame % 2).numpy()[:, :3] / 3.0
    parts = {}
    for lobe, albedo in (("Diffuse", setup.albedo), ("Glossy", setup.mirrored), ("Transmission", setup.glassy)):
        direct, indirect, color = (
            setup.composite.read_light_pass(f"{lobe} {part}").numpy() for part in ("Direct", "Indirect", "Color"))
        np.testing.assert_allclose(color, albedo, rtol=1e-5, atol=1e-7)
        assert (direct[SKY] == 0.0).all() and (indirect[SKY] == 0.0).all()
        parts[lobe] = (direct + indirect) * color
        assert direct.any() == (lobe != "Transmission")
    np.testing.assert_allclose(sum(parts.values()) + setup.emission[:, :3], total, rtol=2e-3, atol=1e-6)
    reflected, passed = (setup.albedo - setup.scattered) * setup.indirect, setup.scattered * setup.passed
    diffuse = 2.0 * (setup.albedo * setup.lights[0][:, :3].astype(float) + reflected + passed)
    np.testing.assert_allclose(parts["Diffuse"], diffuse, rtol=2e-3, atol=1e-6)
    np.testing.assert_allclose(parts["Transmission"], 2.0 * setup.glassy * setup.passed, rtol=2e-3, atol=1e-6)


def test_light_passes_are_kept_only_where_asked_for(device):
    """Refuse the passes of lobes that were not asked for, and names that there are not."""
    composite = Setup(device, ("Glossy Color",)).composite
    assert composite.lobes == ("Glossy",)
    composite.read_light_pass("Glossy Direct")
    for name in ("Diffuse Color", "Volume Direct", "Glossy"):
        with pytest.raises(KeyError):
            composite.read_light_pass(name)


def test_debug_views_show_this_frame(device):
    """Draw direct and indirect light that add up to the composite, and a history that grows lighter."""
    setup = Setup(device, reflection=True)
    drawn = {}
    for name in setup.composite.debug_views:
        picture = wp.zeros(COUNT, dtype=wp.vec4, device=device)
        setup.composite.record_debug(setup.graphs[0], 0, name, picture)
        drawn[name] = picture
    setup.run(restart=1)
    first = drawn["composite.history"].numpy().copy()
    total = drawn["composite.direct"].numpy() + drawn["composite.indirect"].numpy()
    np.testing.assert_allclose(total[:, :3], setup.expected, rtol=1.5e-3)
    np.testing.assert_allclose(
        drawn["composite.reflection"].numpy()[:, :3], setup.mirrored * setup.reflected, rtol=1.5e-3)
    for rest in range(1, 21):
        setup.run(rest=rest)
    assert (drawn["composite.history"].numpy()[:, :3].sum(1) > first[:, :3].sum(1)).all()


def test_debug_views_are_in_the_table():
    """Explain in engine/debug_views.py exactly the views that these passes draw."""
    for each in (CompositePass, RestBlend):
        assert each.debug_views == {k: v for k, v in DEBUG_VIEWS.items() if k.startswith(each.name + ".")}


def test_reset_forgets_everything(device):
    """Leave nothing of earlier frames in any buffer."""
    setup = Setup(device, LIGHT_PASSES)
    setup.run(restart=1)
    setup.run(rest=1)
    setup.composite.reset()
    assert not setup.pictures[0].numpy().any() and not setup.pictures[1].numpy().any()
    assert not setup.composite.color.current(0).numpy().any()
    assert not setup.composite.read_light_pass("Diffuse Color").numpy().any()
