# SPDX-License-Identifier: GPL-3.0-or-later
"""Test how the means of the cache's cells forget: cells that feed each other must leave old errors behind."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.frame_data import frame_row
from burnish.engine.passes.cache_buffers import CELL_ARRAYS
from burnish.engine.view_data import ViewTracker
from burnish.kernels.cache_cells import FIXED_ONE, REBALANCE_FRAMES, CacheControl, update_cells
from burnish.kernels.hash_grid import BUCKET, HashGrid

from tests import scenes

SAMPLE_CAP = 64.0


class Cells:
    """A bucket of cells in use, long after the light was edited."""

    def __init__(self, device, light, samples):
        self.device, self.age = device, int(REBALANCE_FRAMES)
        self.grid, self.control = HashGrid(), CacheControl()
        for name, (dtype, entries) in CELL_ARRAYS.items():
            setattr(self.grid, name, wp.zeros(int(BUCKET) * entries, dtype=dtype, device=device))
        self.grid.keys.fill_(1)
        self.grid.indirect.fill_(wp.vec4(light, light, light, samples))
        self.control.age = wp.zeros(1, dtype=int, device=device)
        self.control.live = wp.zeros(1, dtype=int, device=device)
        self.grid.live = wp.ones(1, dtype=int, device=device)
        self.control.factors = wp.ones(2, dtype=wp.vec3, device=device)
        self.views = ViewTracker(device)
        camera = frame_row(scenes.camera_above(), 64, 64, (0, 0, 64, 64), 0, np.zeros(3))
        self.views.advance(
            camera, moved=False, lit=False, exposure=1.0, transparent=False, filter_quantiles=None)

    def update(self, light=0.0, samples=0):
        """Let a frame pass that brings every cell so many samples of indirect light, all alike."""
        self.age += 1
        self.control.age.fill_(self.age)
        sums, counts = np.zeros((int(BUCKET), 6), np.int64), np.zeros((int(BUCKET), 2), np.int32)
        sums[:, 3:], counts[:, 1] = round(samples * light * float(FIXED_ONE)), samples
        self.grid.sums.assign(sums.ravel())
        self.grid.counts.assign(counts.ravel())
        wp.launch(update_cells, int(BUCKET), [0, self.views.array, SAMPLE_CAP], [self.grid, self.control],
                  device=self.device)

    @property
    def mean(self):
        """Return light and samples of a cell."""
        held = self.grid.indirect.numpy()[3]
        return float(held[0]), float(held[3])


@pytest.mark.parametrize(("every", "samples"), [(20, 1), (1, 4)], ids=["seldom", "every frame"])
def test_cells_that_light_each_other_forget_errors(device, every, samples):
    """Lose most of an error of 6 % at albedo 0.95, however seldom a cell gets a sample: a plain mean keeps 80 %."""
    albedo, cells = 0.95, Cells(device, 1.06, 7.0)
    for frame in range(6000):
        if frame % every:
            cells.update()
        else:
            # What a furnace of radiance 1 brings, where all cells are as wrong as this one.
            cells.update(1.0 - albedo + albedo * cells.mean[0], samples)
    assert 1.0 <= cells.mean[0] < 1.015


def test_cells_without_samples_keep_some(device):
    """Hold the light, and no fewer than a few samples of it, in a cell that gets none: one sample must not make it."""
    cells = Cells(device, 0.5, 1000.0)
    for _ in range(300):
        cells.update()
    light, samples = cells.mean
    assert light == 0.5 and 4.0 <= samples < 30.0
    cells.update(1.0, 1)
    assert 0.5 < cells.mean[0] < 0.65


def test_few_samples_are_not_forgotten(device):
    """Leave a cell alone that has few samples."""
    cells = Cells(device, 0.5, 3.0)
    for _ in range(100):
        cells.update()
    assert cells.mean == (0.5, 3.0)


@pytest.mark.parametrize("bounced", [0, 1, 3], ids=["never", "at once", "in the third frame"])
def test_light_from_before_an_edit_is_known_for_some_frames(device, bounced):
    """Keep it with hardly any weight, and from the fourth frame on as unknown unless a bounce ray has come by then."""
    cells = Cells(device, 1.0, 64.0)
    cells.age = -1
    for frame in range(6):
        cells.update(2.0, int(frame == bounced and bounced > 0))
        light, known = cells.mean
        if frame == 0:
            assert light == 1.0 and 0.0 < known < 1.0
    if bounced == 0:
        assert (light, known) == (1.0, 0.0)
    else:
        assert light > 1.75 and known >= 0.99
