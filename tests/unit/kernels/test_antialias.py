# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of temporal anti-aliasing: exact at rest, sharp in motion, without trails."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp
from burnish.engine.pixel_filter import filter_table, sharpness_of
from burnish.engine.settings import PixelFilter
from burnish.kernels import antialias
from burnish.kernels.antialias import Accumulation
from burnish.kernels.view import View

from tests.device import DEVICE

W, H = 48, 32
TABLE = filter_table(PixelFilter.BLACKMAN_HARRIS, 1.5)
SHARPNESS = sharpness_of(TABLE)
ALL_TAPS = 15


def jitter_of(frame: int) -> np.ndarray:
    """Return an even sequence of offsets [px] distributed as the pixel filter."""
    u = (0.5 + np.array([0.7548776662466927, 0.5698402909980532]) * frame) % 1.0
    return np.interp(u, np.linspace(0.0, 1.0, len(TABLE)), TABLE)


def centers() -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels' centres: x and y, [H, W] each."""
    y, x = np.mgrid[0:H, 0:W] + 0.5
    return x, y


class Frames:
    """Runs frames of W x H pixels through the kernel, `settled` frames after the integrator's start."""

    def __init__(self, device: str, settled: int = 1 << 20):
        self.device = device
        self.settled = settled
        self.frame = -1
        self.buffers = [self._make(), self._make()]

    def _make(self) -> Accumulation:
        a = Accumulation()
        a.color = wp.zeros(W * H, dtype=wp.vec4, device=self.device)
        a.samples = wp.zeros(W * H, dtype=wp.uint16, device=self.device)
        return a

    def add(self, color: np.ndarray, *, rest: int, motion: np.ndarray | tuple = (0.0, 0.0), light_age: int = 1 << 20,
            depth: np.ndarray | float = 1.0, taps: np.ndarray | int = ALL_TAPS, jitter: tuple = (0.0, 0.0),
            restart: int = 0, enabled: int = 1, moved_age: int = 0,
            mirrors: antialias.Mirrors | None = None) -> np.ndarray:
        """Average one more frame [H, W, 4] and return the picture."""
        self.frame += 1
        row = np.zeros(1, View.numpy_dtype())
        row["rest"], row["light_age"], row["restart"], row["jitter"] = rest, light_age, restart, jitter
        row["frame"], row["moved_age"] = self.frame + self.settled, moved_age
        x, y = centers()
        position = (np.stack([x, y], -1) - np.broadcast_to(np.asarray(motion), (H, W, 2))).astype(np.float32)
        old, new = self.buffers[1 - self.frame % 2], self.buffers[self.frame % 2]
        inputs = [
            wp.array(row, dtype=View, device=self.device),
            wp.array(color.reshape(-1, 4).astype(np.float16), dtype=wp.vec4h, device=self.device).view(wp.uint64),
            wp.array(np.broadcast_to(depth, (H, W)).astype(np.float32).ravel(), dtype=float, device=self.device),
            wp.array(position.reshape(-1, 2), dtype=wp.vec2, device=self.device),
            wp.array(np.broadcast_to(taps, (H, W)).astype(np.uint8).ravel(), dtype=wp.uint8, device=self.device),
        ]
        inputs += [mirrors or antialias.Mirrors(), old, W, H, enabled, SHARPNESS]
        wp.launch(antialias.antialias, W * H, [0, *inputs], [new], device=self.device)
        return new.color.numpy().reshape(H, W, 4)

    @property
    def samples(self) -> np.ndarray:
        """Return how many frames each pixel counts as, [H, W]."""
        return self.buffers[self.frame % 2].samples.numpy().reshape(H, W)


def opaque(gray: np.ndarray) -> np.ndarray:
    """Return gray values [H, W] as opaque colours."""
    return np.stack([gray, gray, gray, np.ones_like(gray)], -1)


def checker(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a pattern of squares of 2 x 2 pixels, 0.1 and 0.9."""
    return np.where((np.floor(x / 2) + np.floor(y / 2)) % 2 == 0, 0.1, 0.9)


def filtered(pattern: Callable, shift: float, samples: int = 48) -> np.ndarray:
    """Return the pattern under the exact pixel filter, [H, W]: a grid of its quantiles."""
    x, y = centers()
    quantiles = np.interp((np.arange(samples) + 0.5) / samples, np.linspace(0.0, 1.0, len(TABLE)), TABLE)
    return np.mean([pattern(x + dx - shift, y + dy) for dx in quantiles for dy in quantiles], 0)


def test_rest_is_the_exact_pixel_filter(device):
    """Give the plain mean of frames at rest: that is the pixel filter, sharper than anything rectified."""
    frames, total = Frames(device), np.zeros((H, W))
    x, y = centers()
    for k in range(256):
        j = jitter_of(k)
        color = checker(x + j[0], y + j[1])
        total += color.astype(np.float16)
        picture = frames.add(opaque(color), rest=k, restart=int(k == 0), jitter=tuple(j))
    np.testing.assert_allclose(picture[..., 0], total / 256, atol=2e-6)
    # Discrepancy of 256 points of the sequence, and of the grid.
    np.testing.assert_allclose(picture[..., 0], filtered(checker, 0.0), atol=0.02)
    assert (frames.samples == 256).all()


@pytest.mark.parametrize(("step", "limit"), [(0.06, 0.016), (0.37, 0.016)])
def test_edges_lie_in_their_place_in_motion(device, step, limit):
    """Show leaning edges as the pixel filter does, though a frame's samples all lie to one side of the centres.

    The bare sample of each frame would be 0.025 off in slow motion, 0.023 in fast.
    """
    def bars(x, y):
        return np.where((x + 3.3 * y) % 12.0 < 6.0, 0.8, 0.2)

    frames, errors = Frames(device), []
    x, y = centers()
    for k in range(60):
        j, shift = jitter_of(k), step * k
        picture = frames.add(opaque(bars(x + j[0] - shift, y + j[1])), rest=0, motion=(step, 0.0), jitter=tuple(j),
                             restart=int(k == 0), moved_age=1 << 20)
        if k >= 40 and k % 4 == 0:
            errors.append(np.abs(picture[..., 0] - filtered(bars, shift, 24))[4:-4, 20:-4].mean())
    assert np.mean(errors) < limit


@pytest.mark.parametrize("step", [0.37, 0.5, 1.0])
def test_pan_keeps_fine_texture(device, step):
    """Keep at least 80 % of the exact filter's contrast of a checker that pans by parts of a pixel."""
    frames = Frames(device)
    x, y = centers()
    for k in range(30):
        j = jitter_of(k)
        picture = frames.add(
            opaque(checker(x + j[0] - step * k, y + j[1])), rest=0, motion=(step, 0.0), restart=int(k == 0),
            jitter=tuple(j))
    # Pixels whose history has come in over the edge of the picture are left out.
    inner = (slice(4, -4), slice(int(30 * step) + 4 if step < 1.0 else 34, -4))
    exact = filtered(checker, step * 29)[inner]
    got = picture[..., 0][inner]
    exact, got = exact - exact.mean(), got - got.mean()
    contrast = (got * exact).sum() / (exact * exact).sum()
    print(f"step {step}: contrast {contrast:.3f}, residual {(got - contrast * exact).std() / exact.std():.3f}")
    assert 0.8 <= contrast <= 1.1


def test_coming_to_rest_fades_what_motion_left(device):
    """Count the picture of motion as four frames: its error fades as 1 / n and the first frames do not jump."""
    frames = Frames(device)
    rng = np.random.default_rng(1)
    for k in range(40):
        noise = opaque(0.5 + 0.1 * rng.standard_normal((H, W)))
        moving = frames.add(noise, rest=0, restart=int(k == 0))
    for k in range(1, 65):
        noise = opaque(0.5 + 0.1 * rng.standard_normal((H, W)))
        resting = frames.add(noise, rest=k)
        if k <= 4:
            # Noise grows by a quarter at most when the weights change (see FIRST_REST_SAMPLES).
            assert resting[..., 0].std() < 1.35 * moving[..., 0].std()
    assert (frames.samples == 68).all()
    assert resting[..., 0].std() < 0.1 / np.sqrt(64) * 1.1


def test_light_edit_is_seen_at_once(device):
    """Leave at most 2 % of a lamp's light 8 frames after it went off, with everything else at rest."""
    frames = Frames(device)
    for k in range(60):
        frames.add(opaque(np.full((H, W), 0.8)), rest=k, restart=int(k == 0))
    for age in range(8):
        picture = frames.add(opaque(np.zeros((H, W))), rest=age, light_age=age)
    assert picture[..., :3].max() < 0.02 * 0.8


def test_first_frames_are_forgotten(device):
    """Leave behind the dark first frames of light that spreads, and count every frame once light has settled."""
    frames = Frames(device, settled=0)
    for k in range(64):
        picture = frames.add(opaque(np.full((H, W), 1.0 - 0.8 ** (k + 1))), rest=k, restart=int(k == 0))
        if k == 31:
            assert picture[..., 0].min() > 0.97
    assert picture[..., 0].min() > 0.995
    for k in range(64, 192):
        picture = frames.add(opaque(np.ones((H, W))), rest=k)
    assert picture[..., 0].min() > 0.9999
    assert (np.abs(frames.samples.astype(int) - (192 - 64)) <= 1).all()


@pytest.mark.parametrize("moved_age", [0, 1000])
def test_nothing_trails_behind_a_mover(device, moved_age):
    """Show the background within 1 % as soon as a bright square has left it, and the square undimmed.

    Whether it moves itself or, as something near, before a camera that does.
    """
    frames = Frames(device)
    x, _ = centers()
    for k in range(16):
        j = jitter_of(k)
        front = (x + j[0] >= k) & (x + j[0] < k + 12)
        was_front = (x + j[0] >= k - 1) & (x + j[0] < k + 11)
        picture = frames.add(
            opaque(np.where(front, 2.0, 0.1)), rest=0, restart=int(k == 0), jitter=tuple(j),
            motion=np.stack([np.where(front, 1.0, 0.0), np.zeros((H, W))], -1), depth=np.where(front, 1.0, 5.0),
            taps=np.where(front | ~was_front, ALL_TAPS, 0), moved_age=moved_age)
    row = picture[H // 2, :, 0]
    np.testing.assert_allclose(row[:13], 0.1, rtol=0.01)
    np.testing.assert_allclose(row[18:25], 2.0, rtol=0.01)


def test_mirrors_that_show_something_new_take_no_history(device):
    """Forget what a mirror's pixel showed where the mean of its reflection began anew, unless the camera moves."""
    mirrors = antialias.Mirrors()
    roughness, length = np.zeros((H, W), np.uint32), np.full((H, W), 2.0, np.float16)
    roughness[:, W // 2:] = 30000
    length[: H // 2] = 0.5
    state = np.zeros((H, W, 4), np.float16)
    state[..., 0] = -length
    mirrors.material = wp.array(roughness.ravel(), dtype=wp.uint32, device=device)
    mirrors.state = wp.array(state.reshape(-1, 4), dtype=wp.vec4h, device=device).view(wp.uint64)
    mirrors.known = 1.9
    x, y = centers()
    for motion, moved, new in ((0.0, 0, True), (0.3, 0, False), (0.3, 1 << 4, True)):
        frames = Frames(device)
        for _ in range(12):
            frames.add(opaque(checker(x, y)), rest=0, mirrors=None)
        frames.add(opaque(checker(x, y)), rest=0, motion=(motion, 0.0), taps=ALL_TAPS | moved, mirrors=mirrors)
        samples = frames.samples
        full = float(antialias.MOTION_SAMPLES) + 1.0
        assert (samples[:, W // 2:] == full).all() and (samples[H // 2:] == full).all()
        assert (samples[: H // 2, : W // 2] == (1.0 if new else full)).all()


@pytest.mark.parametrize("moved_age", [0, 1000])
def test_disocclusion_shows_nothing_of_before(device, moved_age):
    """Show where no tap has the same surface what this frame does, from its samples alone where things move."""
    frames = Frames(device)
    for k in range(4):
        frames.add(opaque(np.full((H, W), 5.0)), rest=0, restart=int(k == 0))
    picture = frames.add(opaque(np.full((H, W), 0.25)), rest=0, taps=0, moved_age=moved_age)
    np.testing.assert_allclose(picture[..., 0], 0.25, rtol=0.002 if moved_age else 1e-6)
    assert (frames.samples == (5 if moved_age else 1)).all()


def test_what_the_camera_turns_to_takes_no_history(device):
    """Start anew where the frame before did not look, also while the camera alone moves."""
    frames = Frames(device)
    for k in range(4):
        picture = frames.add(opaque(np.full((H, W), 0.5)), rest=0, restart=int(k == 0), moved_age=1000, taps=0,
                             motion=(-0.6 * W, 0.0))
    np.testing.assert_allclose(picture[..., 0], 0.5, rtol=1e-3)
    assert (frames.samples[:, int(0.4 * W) + 1:] == 1).all() and (frames.samples[:, : int(0.4 * W) - 1] > 1).all()


def test_thin_lines_are_no_dashes(device):
    """Draw a line a third of a pixel wide faintly, but in one piece, while the camera moves and most frames miss it."""
    x, y = centers()
    darkness = {}
    for moved_age in (0, 1000):
        frames = Frames(device)
        for k in range(32):
            j = jitter_of(k)
            line = np.abs(y + j[1] - 16.0 - 0.04 * (x + j[0] - 0.4 * k)) < 0.17
            picture = frames.add(
                opaque(np.where(line, 0.0, 1.0)), rest=0, restart=int(k == 0), motion=(0.4, 0.0), jitter=tuple(j),
                depth=np.where(line, 0.5, 1.0), taps=np.where(line, 0, ALL_TAPS), moved_age=moved_age)
        darkness[moved_age] = (1.0 - picture[4:28, 16:44, 0]).sum(0)
    error = {age: np.sqrt(((values - 0.34) ** 2).mean()) for age, values in darkness.items()}
    assert darkness[0].max() > 0.9 and darkness[1000].max() < 0.34
    assert error[1000] < 0.75 * error[0]


@pytest.mark.parametrize("step", [0.2, 0.37])
def test_edges_before_the_sky_are_not_black(device, step):
    """Keep the light of a wall and of a bar of two pixels before a sky that is seventy times as bright, in a pan."""
    def pattern(x, y):
        slanted = x + 0.07 * y
        return np.where((slanted < 18.0) | (np.abs(slanted - 30.0) < 1.0), 0.3, 20.0)

    frames = Frames(device)
    x, y = centers()
    for k in range(40):
        j = jitter_of(k)
        picture = frames.add(
            opaque(pattern(x + j[0] - step * k, y + j[1])), rest=0, motion=(step, 0.0), restart=int(k == 0),
            jitter=tuple(j), moved_age=1000)
    exact = filtered(pattern, step * 39)
    dark = exact < 0.35
    assert dark.sum() > 300
    assert picture[..., 0][dark].min() > 0.2


def test_switched_off_and_restart_show_this_frame_alone(device):
    """Copy the frame where anti-aliasing is off or nothing before is valid."""
    frames = Frames(device)
    color = opaque(np.random.default_rng(2).random((H, W)))
    frames.add(opaque(np.ones((H, W))), rest=0, restart=1)
    for options in ({"enabled": 0, "rest": 5}, {"restart": 1, "rest": 0}):
        picture = frames.add(color, **options)
        assert (picture == color.astype(np.float16).astype(np.float32)).all()


@pytest.mark.parametrize("green", [0.0, 0.37])
def test_pure_colors_stay_pure_in_motion(device, green):
    """Leave no channel below 0 where light has none of it: averages go over luma and chroma, and are rounded."""
    random = np.random.default_rng(5)
    frames = Frames(device)
    for _ in range(12):
        color = np.zeros((H, W, 4), np.float32)
        color[..., 0], color[..., 3] = random.uniform(0.0, 0.3, (H, W)), 1.0
        color[..., 1] = green * color[..., 0]
        picture = frames.add(color, rest=0, motion=(0.3, 0.2), jitter=tuple(random.uniform(-0.5, 0.5, 2)))
        assert picture.min() >= 0.0
        assert picture[..., 2].max() < 1e-6 and picture[..., 0].max() > 0.1


def test_alpha_is_averaged_too(device):
    """Average the alpha of a jittered edge at rest, and keep it in 0..1 in motion."""
    frames = Frames(device)
    for k in range(8):
        cover = np.full((H, W), float(k % 2))
        picture = frames.add(np.stack([cover, cover, cover, cover], -1), rest=k, restart=int(k == 0))
    np.testing.assert_allclose(picture, 0.5, atol=1e-6)
    for k in range(8):
        x, _ = centers()
        cover = (np.floor(x - 0.37 * k) % 3 == 0).astype(float)
        picture = frames.add(np.stack([cover, cover, cover, cover], -1), rest=0, motion=(0.37, 0.0))
        assert picture.min() >= 0.0 and picture[..., 3].max() <= 1.0


def test_motion_averages_noise_without_bias(device):
    """Keep the mean of noise below display white within 1 %, with a fifth of its deviation or less, in motion."""
    frames, means = Frames(device), []
    rng = np.random.default_rng(4)
    for k in range(60):
        picture = frames.add(
            opaque(rng.uniform(0.2, 0.8, (H, W))), rest=0, motion=(0.37, -0.21), restart=int(k == 0))
        means.append(picture[..., 0].mean())
    assert abs(np.mean(means[10:]) - 0.5) < 0.005
    assert picture[..., 0].std() < 0.35 * 0.6 / np.sqrt(12)


def test_light_behind_a_veil_is_kept_and_sparks_are_not(device):
    """In motion keep what shines through a random half of samples, and little of what one pixel in a hundred shows."""
    rng = np.random.default_rng(4)
    kept = {}
    for share in (0.5, 0.01):
        frames, found = Frames(device), []
        for frame in range(40):
            shines = rng.random((H, W)) < share
            picture = frames.add(opaque(np.where(shines, 20.0, 0.2)), rest=0, restart=int(frame == 0))
            if frame >= 20:
                found.append(picture[4:-4, 4:-4, 0].mean())
        kept[share] = (np.mean(found) - 0.2) / (19.8 * share)
    assert 0.75 < kept[0.5] < 1.1
    assert kept[0.01] < 0.35


def test_a_wrong_position_stays_outside(device):
    """Take no history from positions that are not finite, and edge pixels for those outside of the picture."""
    frames = Frames(device)
    frames.add(opaque(np.ones((H, W))), rest=0, restart=1)
    for motion in (np.nan, np.inf, 1e6, -1e6):
        picture = frames.add(opaque(np.full((H, W), 0.5)), rest=0, motion=(motion, 0.0))
        assert np.isfinite(picture).all() and picture.max() <= 1.0


@wp.kernel
def resampling_weights(places: wp.array[float], weights_out: wp.array2d[float]):
    """Write the six weights at places between taps."""
    i = wp.tid()
    weights = antialias.kernel_weights(places[i])
    for k in range(6):
        weights_out[i, k] = weights[k]


def test_weights_of_the_resampling_kernel():
    """0.8 Lanczos-3 + 0.2 Catmull-Rom, to the rounding of a few operations; at the taps' own places too."""
    places = np.concatenate([np.linspace(0.0, 1.0, 1001), [1e-6, 0.029, 0.031, 1.0 - 1e-6]]).astype(np.float32)
    found = wp.zeros((len(places), 6), dtype=float, device=DEVICE)
    wp.launch(resampling_weights, len(places), [wp.array(places, dtype=float, device=DEVICE)], [found], device=DEVICE)
    d = np.abs(np.arange(-2, 4)[None] - places[:, None].astype(float))
    cubic = np.where(d < 1.0, (1.5 * d - 2.5) * d * d + 1.0, ((-0.5 * d + 2.5) * d - 4.0) * d + 2.0) * (d < 2.0)
    expected = 0.2 * cubic + 0.8 * np.sinc(d) * np.sinc(d / 3.0) * (d < 3.0)
    expected /= expected.sum(1, keepdims=True)
    assert np.abs(found.numpy() - expected).max() < 2e-6
