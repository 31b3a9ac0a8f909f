# SPDX-License-Identifier: GPL-3.0-or-later
"""Test how much of a pixel's light at rest is what it gathers itself, and how much the probes'."""

import numpy as np
import pytest
import warp as wp
from burnish.kernels.gather_blend import PROBE_MOST, TAPS, blend_gathered
from burnish.kernels.gather_temporal import GatherHistory
from burnish.kernels.long_mean import pack_mean, unpack_mean

from tests.denoise_frames import SIZE, Frames
from tests.device import DEVICE

COUNT = SIZE * SIZE
FRAMES = 16


@wp.kernel(module="unique")
def pack_grey(value: float, out: wp.array[wp.uint64]):
    out[wp.tid()] = pack_mean(wp.vec3(value, value, value))


@wp.kernel(module="unique")
def unpack_red(light: wp.array[wp.uint64], out: wp.array[float]):
    out[wp.tid()] = unpack_mean(light[wp.tid()])[0]


def share_of_gathered(depth):
    """Return how much of each pixel's light is gathered after FRAMES frames at rest, [h, w]; all is near by."""
    frames = Frames(depth=depth)
    frames.row["rest"] = FRAMES
    frames.views.assign(frames.row)
    history = GatherHistory()
    history.light = wp.zeros(COUNT, dtype=wp.uint64, device=DEVICE)
    wp.launch(pack_grey, COUNT, inputs=[1.0], outputs=[history.light], device=DEVICE)
    state = np.tile(np.array([4.0, 0.0, 1.0e-4, 0.0], np.float16), (COUNT, 1)).view(np.uint64)
    history.state = wp.array(state.reshape(-1), dtype=wp.uint64, device=DEVICE)
    irradiance = wp.zeros(COUNT, dtype=wp.vec4h, device=DEVICE)
    packed, out = wp.zeros(COUNT, dtype=wp.uint64, device=DEVICE), wp.zeros(COUNT, dtype=float, device=DEVICE)
    wp.launch(blend_gathered, COUNT, inputs=[0, frames.views, frames.gbuffer, SIZE, SIZE, 1, irradiance, history],
              outputs=[packed], device=DEVICE)
    wp.launch(unpack_red, COUNT, inputs=[packed], outputs=[out], device=DEVICE)
    return out.numpy().reshape(SIZE, SIZE)


def test_lonely_pixels_wait_for_samples():
    """Take less of what a pixel gathers where no neighbour shows its surface: it has no more samples than its own."""
    depth = np.full((SIZE, SIZE), 5.0)
    depth[8:24:4, 8:24:4] = 4.0
    share = share_of_gathered(depth)
    lonely, field = np.median(share[depth == 4.0]), share[12:20, 12:20][depth[12:20, 12:20] == 5.0].mean()
    # Light from far away: the probes' is worth the most samples.
    assert lonely == pytest.approx(FRAMES / (FRAMES + float(PROBE_MOST)), rel=0.01)
    found = field / (1.0 - field) * float(PROBE_MOST)
    assert 0.6 * FRAMES * (TAPS + 1) < found < FRAMES * (TAPS + 1)


@pytest.mark.parametrize("depth", [5.0, np.where(np.arange(SIZE) < 9, 4.0, 5.0)[None, :].repeat(SIZE, 0)])
def test_all_gather_where_light_is_known(depth):
    """Take most of it from neighbours on the same side of an edge."""
    share = share_of_gathered(depth)
    assert share[10:22, 12:20].mean() > 0.4
