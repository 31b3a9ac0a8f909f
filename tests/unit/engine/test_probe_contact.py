# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the detail that nearby pixels add to the light between screen probes."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.scene import CameraData
from burnish.engine.settings import ProbeSettings

from tests import scenes
from tests.probe_bench import ProbeBench


def block(radiance, contact, sky=1.0, size=(96, 96)):
    """Make a bench over a low block, 8 pixels wide, on a floor under the sky."""
    p = [[x, y, z] for x in (-0.042, 0.042) for y in (-0.6, 0.6) for z in (0.0, 0.06)]
    block = scenes.mesh(p, [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (1, 5, 7), (1, 7, 3)])
    matrix = np.eye(4)
    back = np.array([0.7, 0.0, 1.0]) / np.hypot(0.7, 1.0)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = np.cross([0.0, 1.0, 0.0], back), (0.0, 1.0, 0.0), back
    matrix[:3, 3] = 3.0 * back
    view = CameraData(kind="perspective", transform=tuple(matrix.ravel()), window=(-0.17, 0.17, -0.17, 0.17))
    return ProbeBench({"floor": scenes.quad(50.0), "block": block}, [0.5 * sky, radiance], view, size, sky=sky,
                      settings=ProbeSettings(contact_detail=contact))


def test_contact_is_neutral_in_a_furnace():
    """Change nothing where everything is equally bright."""
    b = block(1.0, True)
    b.lighting.objects = wp.array([1.0, 1.0], dtype=float, device=b.device)
    b.record()
    for _ in range(12):
        b.frame()
    light, _ = b.irradiance()
    np.testing.assert_allclose(light[b.hits() >= 0], 1.0, atol=0.01)


def test_contact_is_neutral_in_the_open():
    """Add nothing on a plane."""
    b = ProbeBench({"floor": scenes.quad(50.0)}, [0.0], scenes.camera_above(height=3.0, half=0.5, orthographic=False),
                   (64, 48), sky=1.0, settings=ProbeSettings(contact_detail=True))
    for _ in range(8):
        b.frame()
    assert np.abs(b.probes.contact.numpy().astype(np.float32)[:, :3]).max() == 0.0


@pytest.mark.slow
def test_contact_brings_detail():
    """Come closer to the truth beside a low dark block than the probes alone."""
    errors = []
    for contact in (False, True):
        b = block(0.0, contact)
        for _ in range(100):
            b.frame()
        total = 0.0
        for _ in range(16):
            b.frame()
            total = total + b.irradiance()[0] / 16
        depth = b.gbuffer.depth.numpy().reshape(96, 96)
        row = np.frombuffer(b.tracker.row["camera"].tobytes(), b.tracker.row["camera"].dtype)[0]
        c = ((np.arange(96) + 0.5) / 96 * 2 - 1) * 0.17
        local = np.stack([c[None, :] * depth, c[:, None] * depth, -depth, np.ones_like(depth)], -1)
        x = (local @ np.array(row["camera_to_world"]).T)[..., 0] - 0.042
        near = (b.hits() == 0) & (x > 0.003) & (x < 0.06)
        near[:10] = near[-10:] = False
        # The block hides the part of the sky below the angle of its edge.
        due = 1 - 0.5 * (1 - x / np.hypot(x, 0.06))
        errors.append(np.abs(total - due)[near].mean())
    assert errors[1] < 0.8 * errors[0]
