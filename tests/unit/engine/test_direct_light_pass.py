# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the direct light pass: its mean against the path tracer, for every light, with and without each saving."""

import functools

import numpy as np
import pytest
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import MaterialData, Visibility

from tests import scenes
from tests.direct_frames import Frames, reference, sunny_world

CAMERA = scenes.camera_above(height=1.0, half=0.5)
"""Sees the plane from below the lamps"""

GREY = {"grey": scenes.material(color=0.6)}
GLOSSY = {"grey": scenes.material("GLOSSY", color=0.8, roughness=0.3)}
SETTINGS = {
    "plain": {"half_rate": False, "candidates": 4}, "reuse": {"temporal_reuse": 2, "half_rate": False, "candidates": 4},
    "half rate": {"temporal_reuse": 0}, "both": {"temporal_reuse": 2, "candidates": 4},
    "one candidate": {"temporal_reuse": 2, "candidates": 1},
}


def plane(lights=(), background=0.0, materials=GREY, objects=(), meshes=None):
    """Make a plane under lights."""
    return scenes.delta({"plane": scenes.quad(20.0), **(meshes or {})}, [("plane", np.eye(4), "grey"), *objects],
                        dict(materials), lights, background)


def textured_emitter():
    """Make an emitter whose light varies over its surface, in colour too."""
    builder = ProgramBuilder()
    u = builder.component(builder.uv("UVMap"), 0)
    builder.emit(builder.combine(u, 0.5, builder.math("SUBTRACT", 1.0, u)), builder.math("MULTIPLY", u, 20.0), 1.0)
    return MaterialData(name="textured", program=builder.finish(), has_emission=True)


def many_lamps(count=300):
    """Make point lamps of very different strength, spread above the plane."""
    rng = np.random.default_rng(1)
    places = rng.uniform([-3, -3, 1.2], [3, 3, 3], (count, 3))
    return [scenes.lamp("POINT", float(10.0 ** rng.uniform(-1, 1.5)), scenes.place(*p), radius=0.02, use_mis=False)
            for p in places]


def lit(name):
    """Make one of the scenes, by the light in it."""
    above = scenes.place(x=0.3, y=0.2, z=1.5)
    if name == "point":
        return plane([scenes.lamp("POINT", 100.0, above, radius=0.2)])
    if name == "spot":
        return plane([scenes.lamp("SPOT", 100.0, scenes.place(z=1.5), spot_size=0.6, spot_blend=0.5, radius=0.05)])
    if name == "area":
        return plane([scenes.lamp("AREA", 50.0, above, size_x=1.0)])
    if name == "sun":
        return plane([scenes.lamp("SUN", 3.0, angle=0.3)])
    if name == "sun and point":
        return plane([scenes.lamp("SUN", 3.0), scenes.lamp("SUN", 1.0, angle=0.2), scenes.lamp("POINT", 40.0, above)])
    panel = [("panel", scenes.place(x=0.4, z=1.3), "light")]
    meshes = {"panel": scenes.quad(0.5)}
    if name == "emitter":
        return plane(materials={**GREY, "light": scenes.emitter(5.0)}, objects=panel, meshes=meshes)
    if name == "textured emitter and lamp":
        lamp = scenes.lamp("POINT", 20.0, scenes.place(x=-1.0, z=1.2), radius=0.1)
        return plane([lamp], materials={**GREY, "light": textured_emitter()}, objects=panel, meshes=meshes)
    if name == "world":
        return plane(background=sunny_world())
    return plane(many_lamps())


LIGHTS = ("point", "spot", "area", "sun", "sun and point", "emitter", "textured emitter and lamp", "world", "many")




def savings(lights, fast):
    """Return all pairs of a light and a name of SETTINGS; `fast` are the names, by light, that aren't slow."""
    return [pytest.param(light, name, marks=() if name in fast.get(light, ()) else pytest.mark.slow)
            for light in lights for name in SETTINGS]


@functools.cache
def plane_truth(light):
    """Return the path tracer's mean of a scene, [3]."""
    return reference(lit(light), CAMERA, samples=2048).mean((0, 1))


@pytest.mark.parametrize(("light", "name"), savings(LIGHTS, {
    "many": SETTINGS,
    **dict.fromkeys(("spot", "area", "sun and point", "textured emitter and lamp", "world"), ("both",))}))
def test_mean_is_that_of_the_path_tracer(light, name):
    """Give the path tracer's direct light on average, whether or not samples and shadow rays are shared."""
    mean = Frames(lit(light), CAMERA, **SETTINGS[name]).mean(1024)
    # The standard error is 0.5 % where lamps are textured, elsewhere half of it.
    np.testing.assert_allclose(mean.mean((0, 1)), plane_truth(light), rtol=0.02 if "textured" in light else 0.01)


def glossy(light):
    """Make a glossy plane under a light, and its camera."""
    delta = lit(light)
    delta.materials["grey"] = GLOSSY["grey"]
    return delta, scenes.camera_above(height=1.0, half=0.5, orthographic=False)


@functools.cache
def glossy_truth(light):
    """Return the path tracer's mean of a glossy plane."""
    return reference(*glossy(light), samples=4096).mean()


@pytest.mark.parametrize(("light", "name"), savings(("area", "emitter", "many"), {
    "area": ("plain", "both"), "emitter": ("plain", "both")}))
def test_glossy_surface(light, name):
    """Give the path tracer's highlight on average at roughness 0.3."""
    mean = Frames(*glossy(light), **SETTINGS[name]).mean(1024)
    # Three standard errors; a single candidate and samples taken over from frame to frame have more noise.
    np.testing.assert_allclose(
        mean.mean(), glossy_truth(light), rtol=0.015 if name in ("plain", "half rate") else 0.03)


@pytest.fixture(scope="module")
def blocked():
    """Return a scene of two lamps behind a square, and the path tracer's picture."""
    lamps = [scenes.lamp("POINT", 60.0, scenes.place(x=-0.8, z=2.0), radius=0.2),
             scenes.lamp("POINT", 30.0, scenes.place(x=0.9, z=1.8), radius=0.1)]
    delta = plane(lamps, meshes={"blocker": scenes.quad(0.3)}, objects=[("blocker", scenes.place(z=1.05), "grey")])
    return delta, reference(delta, CAMERA, 16, 4096)


@pytest.mark.parametrize("name", SETTINGS)
def test_shadows(blocked, name):
    """Keep shadow and penumbra of two lamps behind a square in place and in strength."""
    delta, expected = blocked
    mean = Frames(delta, CAMERA, 16, **SETTINGS[name]).mean(1024)
    np.testing.assert_allclose(mean.mean(), expected.mean(), rtol=0.01)
    # Means of 4x4 pixels: single ones keep some noise.
    blocks = [picture.reshape(4, 4, 4, 4, 3).mean((1, 3)) for picture in (mean, expected)]
    np.testing.assert_allclose(*blocks, atol=0.03 * expected.max())


@pytest.mark.slow
def test_curved_surface():
    """Give the path tracer's light on a sphere, its terminator included, at half rate and full."""
    delta = scenes.delta({"ball": scenes.sphere(0.45, 24)}, [("ball", np.eye(4), "grey")], GREY,
                         [scenes.lamp("POINT", 60.0, scenes.place(x=1.5, z=0.8), radius=0.2)])
    expected = reference(delta, CAMERA, 24, 2048)
    for name, settings in SETTINGS.items():
        mean = Frames(delta, CAMERA, 24, **settings).mean(256)
        inside = np.s_[4:20, 4:20]
        np.testing.assert_allclose(mean[inside].mean(), expected[inside].mean(), rtol=0.012, err_msg=name)


@pytest.mark.slow
def test_coarse_surface():
    """Give the path tracer's light on a coarse smooth ball where it grazes, at half rate too: no triangle cuts it."""
    turn, sun = np.eye(4), np.eye(4)
    turn[:2, :2] = [[np.cos(0.2), -np.sin(0.2)], [np.sin(0.2), np.cos(0.2)]]
    sun[:3, 2], sun[:3, 0] = (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)
    delta = scenes.delta({"ball": scenes.sphere(0.45, 6)}, [("ball", turn, "grey")], GREY,
                         [scenes.lamp("SUN", 3.0, sun, angle=0.01)])
    expected = reference(delta, CAMERA, 24, 1024)
    grazed = np.s_[6:18, 12:15]
    assert 0.02 < expected[grazed].mean() < 0.3 * expected.max()
    for name, settings in SETTINGS.items():
        mean = Frames(delta, CAMERA, 24, **settings).mean(256)
        np.testing.assert_allclose(mean[grazed].mean(), expected[grazed].mean(), rtol=0.02, err_msg=name)


def test_transparent_layers():
    """Weaken light by the transparent squares that it passes, the world's excess included."""
    veil = {**GREY, "veil": scenes.transparent(0.5, color=0.0)}
    above = [("plane", scenes.place(z=1.1), "veil")]
    for lights, background in (([scenes.lamp("SUN", 3.0)], 0.0), ([], sunny_world())):
        clear = Frames(plane(lights, background), CAMERA).mean(256)
        veiled = Frames(plane(lights, background, veil, above), CAMERA).mean(256)
        assert clear.mean() > 0.1
        np.testing.assert_allclose(veiled.mean((0, 1)), 0.5 * clear.mean((0, 1)), rtol=0.01)


def test_world_is_split_without_loss():
    """Leave to the probes exactly what the excess of a sun in a sky does not hold."""
    both = Frames(plane(background=sunny_world(sky=0.5)), CAMERA)
    alone = Frames(plane(background=sunny_world()), CAMERA)
    assert 1e-3 < both.split.threshold < 50 and both.split.share > 0.3
    patch = np.array([1.0, 0.8, 0.5]) * 200.0
    luminance = np.array(both.scene.luminance)
    kept = 1.0 - both.split.threshold / ((patch + 0.5) @ luminance)
    expected = alone.mean(256).mean((0, 1)) / (patch * (1 - alone.split.threshold / (patch @ luminance)))
    np.testing.assert_allclose(both.mean(256).mean((0, 1)), expected * (patch + 0.5) * kept, rtol=0.01)


def test_lights_switched_off_for_lobes_or_shadows():
    """Leave out a lamp's light for the lobes that it is hidden from, and shadows where it casts none."""
    above = scenes.place(z=1.5)
    hidden = int(Visibility.ALL & ~Visibility.DIFFUSE)
    assert Frames(plane([scenes.lamp("POINT", 50.0, above, visibility=hidden)]), CAMERA).mean(8).max() == 0.0
    blocker = {"objects": [("blocker", scenes.place(z=1.1), "grey")], "meshes": {"blocker": scenes.quad(5.0)}}
    for shadow, bright in ((True, False), (False, True)):
        delta = plane([scenes.lamp("POINT", 50.0, above, cast_shadow=shadow)], **blocker)
        assert (Frames(delta, CAMERA).mean(16).min() > 0.1) == bright


def test_translucent_surface_is_lit_from_behind():
    """Give light through a translucent surface as the path tracer does."""
    delta = plane([scenes.lamp("POINT", 50.0, scenes.place(z=-1.0), radius=0.1)],
                  materials={"grey": scenes.material("TRANSLUCENT", color=0.7)})
    expected = reference(delta, CAMERA, samples=1024)
    assert expected.mean() > 0.1
    np.testing.assert_allclose(Frames(delta, CAMERA).mean(256).mean(), expected.mean(), rtol=0.01)


def test_nothing_lights_an_empty_scene():
    """Skip the pass, and give black samples instead of what it gave before, where there is no light."""
    frames = Frames(plane(background=0.5), CAMERA)
    assert "Direct light" in frames.graphs[0].skipped
    frames.frame()
    assert (frames.light.diffuse.numpy() == (0.0, 0.0, 0.0, 1.0)).all()


@pytest.mark.parametrize("lamp", [
    scenes.lamp("POINT", 0.0), scenes.lamp("POINT", 1e30, scenes.place(z=1.2)), scenes.lamp("AREA", 5.0, size_x=0.0),
    scenes.lamp("POINT", 5.0, scenes.place(z=0.0)), scenes.lamp("SPOT", 5.0, scenes.place(z=1.2), spot_size=0.0),
    scenes.lamp("AREA", 50.0, scenes.place(z=1.2), size_x=1e-6), scenes.lamp("SUN", 1e-30),
], ids=["black", "huge", "no size", "on the surface", "no cone", "tiny", "faint"])
def test_odd_lamps_give_finite_light(lamp):
    """Write finite numbers only, into light and reservoirs, for lamps without power, size or sense."""
    good = scenes.lamp("POINT", 10.0, scenes.place(x=0.5, z=1.3))
    frames = Frames(plane([lamp, good]), CAMERA)
    for _ in range(20):
        frames.frame()
        for array in (frames.light.diffuse, frames.light.specular):
            assert np.isfinite(array.numpy().astype(np.float32)).all()
        assert np.isfinite(frames.direct.reservoirs.current(frames.views.parity).weight.numpy()).all()
    assert frames.light.diffuse.numpy().astype(np.float32)[:, :3].max() > 0.0


def test_reuse_lowers_noise_in_motion_and_ends_at_rest():
    """Have less noise a frame with temporal reuse, and none of it carried over at rest."""
    delta = lit("many")
    spread = {}
    for name in ("plain", "reuse"):
        frames = Frames(delta, CAMERA, 16, **SETTINGS[name])
        frames.mean(16)
        pictures = []
        for _ in range(32):
            frames.frame()
            pictures.append(frames.light_with_colors())
        spread[name] = np.std(pictures, 0).mean()
    assert spread["reuse"] < 0.75 * spread["plain"], spread
    for _ in range(20):
        frames.frame(moving=False)
    counts = frames.direct.reservoirs.current(frames.views.parity).weight.numpy()[:, 1]
    np.testing.assert_array_equal(counts, 4.0)


def test_rest_converges_faster_than_independent_samples():
    """Draw one stratified set over all frames at rest: 256 frames err far less than 16 times below one frame."""
    delta = lit("area")
    frames = Frames(delta, CAMERA, candidates=1)
    one = [frames.mean(1, moving=False) for _ in range(64)][32:]
    truth = reference(delta, CAMERA, samples=4096)
    single = np.sqrt(np.mean((np.array(one) - truth) ** 2))
    many = np.sqrt(np.mean((frames.mean(256, moving=False) - truth) ** 2))
    assert many < 0.5 * single / 16


def own_samples(frames):
    """Return which pixels of the last frame have a shadow ray of their own at half rate."""
    y, x = np.mgrid[:frames.size, :frames.size]
    return (x + y + frames.views.array.numpy()[0]["frame"]) % 2 == 0


def test_pixels_alone_have_no_sample_in_motion():
    """Say that there is no sample (w = 0) where every other pixel has none and no neighbour shows the same surface."""
    # One tile for each pixel, each at another height than its neighbours.
    tiles = [("tile", scenes.place(x=0.125 * (i - 3.5), y=0.125 * (j - 3.5), z=0.3 * ((3 * i + 5 * j) % 8)), "grey")
             for i in range(8) for j in range(8)]
    delta = scenes.delta({"tile": scenes.quad(0.0625)}, tiles, GREY, [scenes.lamp("SUN", 3.0)])
    frames = Frames(delta, scenes.camera_above(height=4.0, half=0.5), temporal_reuse=0)
    frames.frame()
    w = frames.light.diffuse.numpy()[:, 3].reshape(8, 8)
    np.testing.assert_array_equal(w, own_samples(frames))
    frames.frame(moving=False)
    assert (frames.light.diffuse.numpy()[:, 3] == 1.0).all()


def test_neighbours_lend_nothing_to_known_pixels():
    """Leave pixels without a sample to the mean of frames before where there is one, and to neighbours elsewhere."""
    frames = Frames(lit("sun"), CAMERA, quarter_rate=False)
    for _ in range(8):
        frames.frame()
    assert (frames.light.diffuse.numpy()[:, 3] == 1.0).all()
    lengths = np.zeros((frames.size, frames.size))
    lengths[:, :4] = 8.0
    lengths[:, 4] = -8.0
    frames.history.length.assign(lengths.reshape(-1).astype(np.float16))
    for _ in range(12):  # until nothing has moved for long enough
        frames.frame(turning=True)
    w = frames.light.diffuse.numpy()[:, 3].reshape(lengths.shape)
    # In the last row taps lie off the picture.
    np.testing.assert_array_equal((w == 1.0)[1:-1], (own_samples(frames) | (lengths <= 0.0))[1:-1])


@pytest.mark.parametrize("kind", ["known", "short", "bright highlights", "reuse", "moving", "full"])
def test_known_pixels_wait(kind):
    """Leave every other turn out, tile by tile, where light is known and highlights weak, while the camera moves alone.

    Those that wait have no shadow ray, and pixels without a mean borrow from others than these.
    """
    size = 24
    delta = plane([scenes.lamp("SUN", 3.0)], materials=GLOSSY if kind == "bright highlights" else GREY)
    frames = Frames(lit("many") if kind == "reuse" else delta, CAMERA, size,
                    temporal_reuse=2 if kind == "reuse" else 0, quarter_rate=kind != "full")
    lengths = np.full((size, size), 3.0 if kind == "short" else 4.0)
    lengths[:, 4] = 0.0
    frames.history.length.assign(lengths.reshape(-1).astype(np.float16))
    moments = np.zeros((size**2, 4), np.float16)
    moments[:, 2:] = 1.0
    frames.history.moments.assign(moments.view(np.uint64).reshape(-1))
    for _ in range(20):  # until nothing has moved for long enough
        frames.frame(turning=True)
    tiles = np.add.outer(np.arange(size) // 8, np.arange(size) // 8)
    sampled, waited = np.zeros((size, size)), kind in ("known", "reuse")
    for _ in range(4):
        frames.frame(turning=kind != "moving")
        waits = ((tiles + frames.views.array.numpy()[0]["frame"] // 2) % 2 == 0) & (lengths >= 4.0) & waited
        own = own_samples(frames) & ~waits
        w = frames.light.diffuse.numpy()[:, 3].reshape(size, size) == 1.0
        # Beside pixels without a mean one has a sample in any frame, in this tile or the next.
        borrows = (lengths < 4.0) | (kind == "moving")
        np.testing.assert_array_equal(w[1:-1, 1:-1] | own[1:-1, 1:-1], w[1:-1, 1:-1])
        np.testing.assert_array_equal((w & ~borrows)[1:-1, 1:-1], (own & ~borrows)[1:-1, 1:-1])
        assert (w | ~borrows)[1:-1, 1:-1].mean() > 0.97
        rays = (frames.direct.rays.shadow_distance.numpy() != 0.0).sum()
        # Of pixels at the border taps lie off the picture: their means are not known.
        assert rays < own.sum() + 2 * size and (kind == "reuse" or rays >= own.sum())
        sampled += own
    np.testing.assert_array_equal(sampled[1:-1, 1:4], 1.0 if waited else 2.0)


def test_small_pictures_have_all_samples():
    """Trace a shadow ray for every pixel of a picture below the limit, in motion too."""
    frames = Frames(lit("sun and point"), CAMERA)
    frames.direct.half_rate_pixels = frames.size**2
    frames.record()
    frames.history.length.fill_(8.0)
    for _ in range(12):
        frames.frame(turning=True)
    assert (frames.light.diffuse.numpy()[:, 3] == 1.0).all()


def test_candidates_and_reuse_follow_the_number_of_lights():
    """Draw no more candidates than there are lights, and look at frames before only where those are too few."""
    for light, count, reuses in (("sun", 1, False), ("sun and point", 3, False), ("emitter", 2, False),
                                 ("world", 2, False), ("many", 4, True)):
        frames = Frames(lit(light), CAMERA, candidates=4, temporal_reuse=1)
        for _ in range(3):
            frames.frame(moving=False)
        counts = frames.direct.reservoirs.current(frames.views.parity).weight.numpy()[:, 1]
        assert (counts.min() > count) if reuses else (counts == count).all(), light


def test_same_frames_twice_and_debug_views():
    """Give the same numbers in a second run, and a finite picture for every debug view."""
    delta = lit("sun and point")
    first, second = (Frames(delta, CAMERA, exposure=3.0) for _ in range(2))
    np.testing.assert_array_equal(first.mean(8), second.mean(8))
    for name in first.direct.debug_views:
        first.record(name)
        first.frame()
        picture = first.picture.numpy()
        assert np.isfinite(picture).all()
        assert picture[:, :3].any() == (name != "direct.specular"), name
