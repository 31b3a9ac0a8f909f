# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth of field of real-time frames: light and shape of blur, what stays sharp, and frames beside path tracing."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from burnish.engine.frame_data import frame_row
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.image_error import flip
from burnish.engine.passes.composite import LIGHT_PASSES
from burnish.engine.passes.depth_of_field import DepthOfFieldPass, has_blur
from burnish.engine.scene import CameraKind
from burnish.engine.session import Session
from burnish.engine.settings import DenoiserSettings, Integrator
from burnish.engine.view_data import ViewTracker
from burnish.kernels.antialias import Accumulation
from burnish.kernels.defocus import LENS_AREA, LENS_NEAR
from burnish.kernels.view import SKY_DEPTH

from tests import defocus_scenes, scenes
from tests.device import DEVICE

SIZE = (96, 64)
SKY = float(SKY_DEPTH)


class Lens:
    """The pass alone: pictures with depths in, pictures out."""

    def __init__(self, size=SIZE, **fields):
        """Make a camera that sees 0.8 m at 1 m with a lens of 0.1 m, 12 pixels, in focus at 1 m."""
        fields = {"focus": 1.0, "radius": 0.1, **fields}
        camera = defocus_scenes.camera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), size=size, **fields)
        self.size, device = size, DEVICE
        self.row = frame_row(camera, *size, (0, 0, *size), 0, np.zeros(3))
        self.views, self.blur = ViewTracker(device), DepthOfFieldPass(device)
        self.blur.resize(*size)
        count = size[0] * size[1]
        self._mean = Accumulation()
        self._mean.color = wp.zeros(count, dtype=wp.vec4, device=device)
        self._mean.samples = wp.zeros(count, dtype=wp.uint16, device=device)
        self._current = wp.zeros(count, dtype=wp.vec4h, device=device)
        self._depth = wp.zeros(count, dtype=float, device=device)
        self._graph = FrameGraph(device)
        self.blur.record(self._graph, self.views.array, self._depth, self._current, self._mean)

    def show(self, color, depth, moved=True):
        """Return the picture [h, w, 4] of a frame of a color, [h, w, 4] or less, at depths [h, w] or less."""
        width, height = self.size
        color = np.broadcast_to(np.asarray(color, np.float32), (height, width, 4)).reshape(-1, 4)
        self.views.advance(self.row, moved=moved, lit=False, exposure=1.0, transparent=True, filter_quantiles=None)
        self._mean.color.assign(color)
        self._current.assign(color.astype(np.float16))
        self._mean.samples.fill_(self.views.rest + 1)
        self._depth.assign(np.broadcast_to(np.asarray(depth, np.float32), (height, width)).ravel())
        self._graph.replay()
        return self.blur.picture.numpy().reshape(height, width, 4)


def spot(size=SIZE, brightness=1000.0):
    """Return a black picture with one bright pixel, and where that is."""
    color = np.zeros((size[1], size[0], 4), np.float32)
    color[..., 3] = 1.0
    y, x = size[1] // 2, size[0] // 2
    color[y, x, :3] = brightness, 0.5 * brightness, 0.25 * brightness
    return color, (x, y)


def spread(picture, center):
    """Return the light of a picture's first channel, its mean square ways right and up, and its third moment up."""
    light = picture[..., 0].astype(np.float64)
    y, x = np.mgrid[:light.shape[0], :light.shape[1]]
    dx, dy = x - center[0], y - center[1]
    total = light.sum()
    return total, (light * dx ** 2).sum() / total, (light * dy ** 2).sum() / total, (light * dy ** 3).sum() / total


@pytest.mark.parametrize("kind", ["behind", "before", "both", "steps"])
def test_even_light_stays_even(kind):
    """Leave a plane that is bright everywhere as it is, whatever its depths: no light is lost or made."""
    width, height = SIZE
    ramp = np.linspace(0.0, 1.0, width)
    depth = {"behind": 1.0 + 9.0 * ramp, "before": 1.0 - 0.7 * ramp, "both": 0.4 + 3.0 * ramp,
             "steps": np.random.default_rng(5).choice([0.4, 0.8, 1.0, 1.2, 5.0, SKY], (height // 8, width // 8)
                                                      ).repeat(8, 0).repeat(8, 1)}[kind]
    picture = Lens().show((7.0, 2.0, 0.5, 1.0), depth)
    np.testing.assert_allclose(picture, np.broadcast_to((7.0, 2.0, 0.5, 1.0), picture.shape), rtol=1e-3)


@pytest.mark.parametrize(("depth", "tolerance"), [(1.2, 0.03), (1.5, 0.03), (3.0, 0.03), (SKY, 0.03), (0.8, 0.03),
                                                  (0.6, 0.04), (0.45, 0.04)])
def test_points_of_light_become_disks(depth, tolerance):
    """Keep a point's light and give it the radius of its circle of confusion, 2 to 15 pixels; no pixel is clamped."""
    color, center = spot()
    light, right, up, _ = spread(Lens().show(color, depth), center)
    radius = 12.0 * abs(1.0 - 1.0 / depth)
    assert light == pytest.approx(1000.0, rel=tolerance)
    # A disk's mean square way along an axis is r^2 / 4; the picture at half resolution shifts it by half a pixel.
    assert 2.0 * np.sqrt(0.5 * (right + up) - 0.25) == pytest.approx(radius, rel=0.04, abs=0.45)


@pytest.mark.parametrize(("lens", "radius"), [(0.1, 6.0), (0.1, 12.0), (0.3, 6.0), (0.3, 20.0), (0.15, 24.0)])
def test_bulbs_before_what_is_much_further_away(lens, radius):
    """Keep a bulb's light and its disk's radius where what is behind it is blurred many times as widely."""
    size = (192, 128)
    for side in (1, 2, 3):
        color = np.zeros((128, 192, 4), np.float32)
        color[64:64 + side, 96:96 + side] = 1000.0 / side ** 2
        depth = np.where(color[..., 0] > 0.0, 1.0 / (1.0 - radius / (240.0 * lens)), SKY)
        light, right, up, _ = spread(Lens(size, radius=lens).show(color, depth), (95.5 + side / 2, 63.5 + side / 2))
        assert light == pytest.approx(1000.0, rel=0.08)
        assert 2.0 * np.sqrt(0.5 * (right + up) - 0.25) == pytest.approx(radius, rel=0.12)


def test_disks_have_the_shape_of_the_lens():
    """Draw polygons as the path tracer's lens has them, turned in front of the focus, and squeeze them."""
    color, center = spot()
    third = {}
    for depth in (3.0, 0.6):
        blades = {"aperture_blades": 3, "aperture_rotation": -0.5 * np.pi}
        light, right, up, third[depth] = spread(Lens(**blades).show(color, depth), center)
        # A triangle's mean square way is r^2 / 8, half of a disk's.
        assert 0.5 * (right + up) == pytest.approx((12.0 * (1.0 - 1.0 / depth)) ** 2 / 8.0, rel=0.2)
        assert light == pytest.approx(1000.0, rel=0.05)
    # With a corner on top most of it is below the middle; in front of the focus it is the other way round.
    assert third[3.0] > 3.0 and third[0.6] < -3.0
    light, right, up, _ = spread(Lens(aperture_ratio=2.0).show(color, 3.0), center)
    assert light == pytest.approx(1000.0, rel=0.05) and np.sqrt(up / right) == pytest.approx(2.0, rel=0.1)
    light, right, up, _ = spread(Lens(aperture_ratio=0.5, radius=0.05).show(color, 3.0), center)
    assert light == pytest.approx(1000.0, rel=0.05) and np.sqrt(right / up) == pytest.approx(2.0, rel=0.1)


def test_what_is_in_focus_stays_as_it_is():
    """Leave pixels in focus alone, and those within half a pixel of it; blur from further behind does not reach them.

    In front of a blurred background of another color the object's own pixels keep theirs.
    """
    lens, random = Lens(), np.random.default_rng(3)
    color = random.random((SIZE[1], SIZE[0], 4), np.float32)
    for depth in (1.0, 1.04, 0.96):
        np.testing.assert_allclose(lens.show(color, depth), color, rtol=1e-5)
    depth = np.full((SIZE[1], SIZE[0]), SKY)
    depth[20:44, 30:60] = 1.0
    picture = lens.show(color, depth)
    np.testing.assert_allclose(picture[20:44, 30:60], color[20:44, 30:60], rtol=1e-5)
    assert np.abs(picture[:, 5:20] - color[:, 5:20]).mean() > 0.1


def test_sharp_things_do_not_bleed_and_blurred_ones_do():
    """Keep what is in focus out of a background's blur, and let what is in front blur over what is in focus."""
    inside = np.zeros((SIZE[1], SIZE[0]), bool)
    inside[16:48, 32:64] = True
    red, blue = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)
    color = np.where(inside[..., None], red, blue)
    picture = Lens().show(color, np.where(inside, 1.0, SKY))
    np.testing.assert_allclose(picture[~inside], np.broadcast_to(blue, picture[~inside].shape), atol=1e-3)
    picture = Lens().show(color, np.where(inside, 0.5, 1.0))
    row = picture[32, :, 0]
    # The middle of the edge is half covered; the disk's radius is 12 pixels.
    assert row[32] == pytest.approx(0.5, abs=0.1) and row[48] > 0.98
    assert row[26] > 0.15 and row[18] < 0.02 and np.all(np.diff(row[16:48]) > -0.02)
    np.testing.assert_allclose(picture[..., 0] + picture[..., 2], 1.0, atol=2e-3)


def disk_contrast(radius, wave):
    """Return what a disk leaves of the contrast of a wave of a length [px]."""
    y = np.linspace(-1.0, 1.0, 401)
    half = np.sqrt(1.0 - y ** 2)
    return float((half * np.cos(2.0 * np.pi * radius * y / wave)).sum() / half.sum())


def test_slight_blur_has_no_step():
    """Leave of a wave's contrast what a disk leaves of it, for every radius: where resolutions change too."""
    color = np.zeros((64, 192, 4), np.float32)
    color[:] = (0.5 + 0.5 * np.sin(2.0 * np.pi * np.arange(192) / 24.0))[None, :, None]
    for radius in np.arange(0.0, 11.0, 0.5):
        for sign in (1.0, -1.0):
            picture = Lens((192, 64)).show(color, 1.0 / (1.0 - sign * radius / 24.0))
            contrast = picture[20:44, 48:144, 0].std() / color[20:44, 48:144, 0].std()
            assert contrast == pytest.approx(disk_contrast(radius, 24.0), abs=0.025), sign * radius


def test_alpha_is_blurred_as_color():
    """Keep the color of what is transparent around, and the sum of its alpha."""
    color = np.zeros((SIZE[1], SIZE[0], 4), np.float32)
    color[24:40, 40:56] = 0.8, 0.4, 0.2, 1.0
    for depth in (3.0, 0.6):
        picture = Lens().show(color, np.where(color[..., 3] > 0.0, depth, SKY))
        assert picture[..., 3].sum() == pytest.approx(256.0, rel=0.03) and picture[..., 3].max() <= 1.001
        np.testing.assert_allclose(picture[..., 0], 0.8 * picture[..., 3], atol=2e-3)


def test_frames_at_rest_are_averaged():
    """Show the mean of frames at rest, each blurred by itself; forget them when something moves."""
    lens, random = Lens(), np.random.default_rng(9)
    frames = random.random((4, SIZE[1], SIZE[0], 4), np.float32)
    alone = []
    for color in frames:
        alone.append(Lens().show(color.astype(np.float16), 3.0))
    for number, color in enumerate(frames):
        picture = lens.show(color.astype(np.float16), 3.0, moved=number == 0)
        np.testing.assert_allclose(picture, np.mean(alone[:number + 1], 0), atol=1e-3)
    np.testing.assert_allclose(lens.show(frames[0].astype(np.float16), 3.0), alone[0], atol=1e-6)


@pytest.mark.parametrize("size", [(1, 1), (2, 1), (1, 7), (3, 5), (17, 16), (33, 31)])
def test_odd_sizes(size):
    """Blur pictures of any size, of one pixel too, at their borders as inside."""
    picture = Lens(size).show((3.0, 2.0, 1.0, 1.0), 0.5)
    np.testing.assert_allclose(picture, np.broadcast_to((3.0, 2.0, 1.0, 1.0), picture.shape), rtol=2e-3)
    picture = Lens(size).show((3.0, 2.0, 1.0, 1.0), SKY)
    np.testing.assert_allclose(picture, np.broadcast_to((3.0, 2.0, 1.0, 1.0), picture.shape), rtol=2e-3)


@pytest.mark.parametrize("fields", [
    {}, {"radius": 1e30}, {"radius": 1e-30}, {"focus": 0.0}, {"focus": np.inf}, {"focus": np.nan},
    {"radius": 1e10, "focus": 0.0}, {"aperture_ratio": 0.0}, {"aperture_ratio": np.inf, "aperture_blades": 5},
    {"aperture_blades": 16, "aperture_rotation": 1e9}, {"kind": CameraKind.ORTHOGRAPHIC}])
def test_extreme_values(fields):
    """Show finite colors whatever the lens and the depths are, and colors that are not finite as black."""
    random = np.random.default_rng(1)
    color = random.random((SIZE[1], SIZE[0], 4), np.float32)
    color[5, 5] = np.nan
    color[9, 30] = np.inf
    color[40, 40, :3] = 65000.0
    depth = random.choice([0.0, -1.0, np.nan, np.inf, -np.inf, 1e-30, 1.0, 3e38, SKY], (SIZE[1], SIZE[0]))
    picture = Lens(**fields).show(color, depth)
    assert np.isfinite(picture).all() and picture.min() > -1e-3 and picture.max() < 66000.0


def test_orthographic_cameras():
    """Blur by the distance from the plane in focus, which of an orthographic camera grows with the depth."""
    color, center = spot()
    made = Lens(kind=CameraKind.ORTHOGRAPHIC, focus=4.0)
    for depth, radius in ((6.0, 6.0), (7.0, 9.0), (1.0, 9.0)):
        light, right, up, _ = spread(made.show(color, depth), center)
        assert light == pytest.approx(1000.0, rel=0.04)
        assert 2.0 * np.sqrt(0.5 * (right + up) - 0.25) == pytest.approx(radius, rel=0.06)


def kernels(session):
    """Return the kernels of a session's last frame."""
    return [kernel for _, kernel in session.pipeline.launches()]


@pytest.mark.slow
def test_scenes_without_depth_of_field_have_no_part_of_it():
    """Launch nothing for a pinhole, or with the setting off, and give the same bits."""
    delta, view = defocus_scenes.floor((48, 27))
    pinhole = replace(view, aperture_radius=0.0)
    made = [defocus_scenes.frames(delta, each, 2, (48, 27), depth_of_field=on)
            for each, on in ((pinhole, True), (pinhole, False), (view, False), (view, True))]
    assert kernels(made[0]) == kernels(made[1]) == kernels(made[2])
    assert set(kernels(made[3])) - set(kernels(made[0])) == {
        "describe_lens", "split_layers", "coarsen_layers", "find_reach", "gather_behind", "gather_near", "blur_frame"}
    pictures = [each.read().tobytes() for each in made]
    assert pictures[0] == pictures[1] == pictures[2] != pictures[3]
    assert "depth of field" in made[0].skipped and "depth of field" not in made[3].skipped
    assert made[0].pipeline.depth_of_field.width == 0
    sharp = made[3].pipeline.composite.accumulated.current(1).color.numpy()
    assert sharp.tobytes() == made[2].pipeline.composite.accumulated.current(1).color.numpy().tobytes()


def test_lenses_that_change_are_replayed():
    """Replay what is recorded while aperture and focus change, and record anew where a lens comes or goes."""
    delta, view = defocus_scenes.floor((48, 27))
    session = defocus_scenes.frames(delta, view, 2, (48, 27), rest_gather=False)
    settings, records, pictures, found = session.settings, session.pipeline.records, [], []
    for change in ({"focus_distance": 2.0}, {"aperture_radius": 0.1}, {"aperture_blades": 5}, {}):
        session.configure(settings, replace(view, **change), 48, 27)
        session.step(2)
        pictures.append(session.read())
        found.append(session.pipeline.depth_of_field._lens.numpy().copy())
    assert session.pipeline.records == records
    assert all(np.abs(pictures[0] - other).max() > 0.05 for other in pictures[1:])
    # A lens of 0.05 m is 3 pixels at 1 m, in focus at 4 m.
    near = [each[int(LENS_NEAR)] for each in found]
    assert near == pytest.approx([1.5, 1.5, 0.75, 0.75])
    assert found[2][int(LENS_AREA)] == pytest.approx(0.757, abs=1e-3)
    session.configure(settings, replace(view, aperture_radius=0.0), 48, 27)
    session.step(2)
    assert session.pipeline.records == records + 2 and "blur_frame" not in kernels(session)


def test_all_that_is_in_focus_is_told():
    """Tell lenses that blur nothing by half a pixel from those that may."""
    def row(**fields):
        fields = {"focus": 5.0, "radius": 0.01, "clip_start": 0.1, **fields}
        view = defocus_scenes.camera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), size=SIZE, **fields)
        return frame_row(view, *SIZE, (0, 0, *SIZE), 0, np.zeros(3))

    assert has_blur(row()) and not has_blur(row(radius=0.0)) and not has_blur(row(radius=1e-5))
    assert has_blur(row(radius=1e-3)) and not has_blur(row(radius=1e-3, clip_start=4.0))


def test_the_debug_view_shows_circles():
    """Draw what is in front of the focus red, what is behind it blue, and what is in focus white."""
    settings = replace(scenes.SETTINGS, debug=replace(scenes.SETTINGS.debug, view="depth_of_field.radius"))
    delta, view = defocus_scenes.floor((48, 27))
    picture = defocus_scenes.frames(delta, view, 2, (48, 27), settings=settings).read()
    front, back = picture[0].mean(0), picture[-1].mean(0)
    assert front[0] > 2.0 * front[2] and back[2] > 2.0 * back[0]
    assert picture[..., :3].min(-1).max() > 0.8


@pytest.mark.parametrize("resting", [False, True])
def test_light_passes_make_up_the_blurred_picture(resting):
    """Let (direct + indirect) * color of all lobes be Combined within noise, of frames and with path-traced samples."""
    size = (48, 27)
    delta, view = defocus_scenes.behind_a_ball(size)
    settings = replace(scenes.SETTINGS, sampling=replace(scenes.SETTINGS.sampling, integrator=Integrator.REALTIME),
                       denoiser=DenoiserSettings(path_traced_rest=resting))
    session = Session(settings)
    session.update(delta)
    session.configure(settings, replace(view, aperture_radius=0.2), *size, passes=("Combined", *LIGHT_PASSES))
    session.step(24)
    light = sum((session.read(f"{lobe} Direct") + session.read(f"{lobe} Indirect")) * session.read(f"{lobe} Color")
                for lobe in ("Diffuse", "Glossy", "Transmission"))
    shown = session.read()[..., :3]
    sharp = session.pipeline.composite.accumulated.current(1).color.numpy().reshape(*shown.shape[:2], 4)[..., :3]
    blur = np.abs(sharp - shown).mean()
    assert blur > 0.03 and np.abs(light - shown).mean() < 0.2 * blur and np.median(np.abs(light - shown)) < 2e-3


@pytest.mark.parametrize(
    "name", ["floor", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ball", "bulbs"))])
def test_frames_beside_path_tracing(name):
    """Be much nearer to the path-traced picture than frames without blur, at rest and while the camera moves."""
    size = (96, 54)
    delta, view = defocus_scenes.SCENES[name](size)
    truth = defocus_scenes.truth(delta, view, 64, size)[..., :3]
    start = np.reshape(view.transform, (4, 4))
    moves = [replace(view, transform=tuple((start + 0.01 * (k - 8) * np.eye(4)[:, [1, 2, 3, 0]] * (
        np.arange(4) == 3)).ravel())) for k in range(8)]
    for path, count in (((), 8), (moves, 1)):
        with_it, without = (flip(truth, defocus_scenes.frames(
            delta, view, count, size, path, depth_of_field=on).read()[..., :3]) for on in (True, False))
        assert with_it < 0.8 * without, (count, with_it, without)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(defocus_scenes.SCENES))
def test_the_way_to_path_tracing_is_no_longer(name):
    """Come to the path-traced picture at rest, at each step nearer to it than from frames without blur."""
    size = (96, 54)
    delta, view = defocus_scenes.SCENES[name](size)
    truth = defocus_scenes.truth(delta, view, 512, size)[..., :3]
    found = []
    for on in (True, False):
        session = defocus_scenes.frames(delta, view, 8, size, path_traced_rest=True, depth_of_field=on)
        errors = [flip(truth, session.read()[..., :3])]
        for frames in (8, 48, 192):
            session.step(frames)
            errors.append(flip(truth, session.read()[..., :3]))
        found.append(errors)
    assert np.all(np.array(found[0]) < np.array(found[1])), found
    assert found[0][-1] < 0.65 * found[0][0]
