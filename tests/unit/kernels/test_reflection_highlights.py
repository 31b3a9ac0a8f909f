# SPDX-License-Identifier: GPL-3.0-or-later
"""The lobes of reflection rays' hits: little is lost when packed, and a white surrounding gives them their albedo."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.tables import albedo_tables
from burnish.kernels.albedo_tables import plane_point, view_at
from burnish.kernels.geometry_math import TWO_PI
from burnish.kernels.reflection_highlights import HitLobe, lobe_density, make_highlight, pack_lobe, unpack_lobe
from burnish.kernels.types import ShadingPoint, Tables

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SAMPLES = 65536
COSINES = (1.0, 0.7, 0.35)
ROUGHNESSES = (0.3, 0.5, 0.8)


@wp.kernel
def gather(
    # In:
    tables: Tables, cosines: wp.array[float], roughnesses: wp.array[float], share: float, light: float, samples: int,
    # Out:
    albedo_out: wp.array2d[float],
):
    """Integrate packed lobes under light samples of density `light`; endless: of lamps without extent."""
    i, j = wp.tid()
    lobe = HitLobe()
    lobe.albedo = wp.vec3(0.04, 0.5, 1.0)
    lobe.roughness = roughnesses[j]
    lobe.normal_share = share
    point = ShadingPoint()
    point.geometric_normal = wp.vec3(0.0, 0.0, 1.0)
    point.wo = view_at(cosines[i])
    h = make_highlight(unpack_lobe(pack_lobe(lobe)), point, point.geometric_normal, 1.0e9)
    total = float(0.0)
    k = int(0)
    while k < samples:
        u = plane_point(k)
        z = u[0]
        r = wp.sqrt(1.0 - z * z)
        wi = wp.vec3(r * wp.cos(TWO_PI * u[1]), r * wp.sin(TWO_PI * u[1]), z)
        total += lobe_density(tables, h, wi, light, wp.where(light > 1.0e6, 1, 0)) * TWO_PI
        k += 1
    albedo_out[i, j] = total / float(samples)


@pytest.mark.parametrize("light", [0.159, 1.0, 1.0e9], ids=["sky", "wide", "point"])
@pytest.mark.parametrize("share", [0.04, 0.5], ids=["dielectric", "metal"])
def test_lobes_reflect_their_albedo(share, light):
    """Find 1 whatever the roughness, however wide the lobe is made: what it is evaluated for is over its albedo."""
    out = wp.zeros((len(COSINES), len(ROUGHNESSES)), dtype=float, device=DEVICE)
    wp.launch(gather, out.shape, [
        albedo_tables(DEVICE), wp.array(COSINES, dtype=float, device=DEVICE),
        wp.array(ROUGHNESSES, dtype=float, device=DEVICE), share, light, SAMPLES], [out], device=DEVICE)
    np.testing.assert_allclose(out.numpy(), 1.0, atol=0.06)


@wp.kernel
def pack(albedo: wp.vec3, roughness: float, share: float, out: wp.array[float]):
    """Pack a lobe and write what comes back."""
    lobe = HitLobe()
    lobe.albedo = albedo
    lobe.roughness = roughness
    lobe.normal_share = share
    lobe.mirrored = 1
    back = unpack_lobe(pack_lobe(lobe))
    for i in range(3):
        out[i] = back.albedo[i]
    out[3] = back.roughness
    out[4] = back.normal_share
    out[5] = float(back.mirrored)


def test_lobes_fit_eight_bytes():
    """Get a lobe back about as it was, brighter than white too: it may be over a small chance."""
    out = wp.zeros(6, dtype=float, device=DEVICE)
    wp.launch(pack, 1, [wp.vec3(0.04, 0.5, 3.0), 0.35, 0.04], [out], device=DEVICE)
    np.testing.assert_allclose(out.numpy()[:4], (0.04, 0.5, 3.0, 0.35), rtol=0.01)
    assert abs(out.numpy()[4] - 0.04) < 0.002 and out.numpy()[5] == 1.0
