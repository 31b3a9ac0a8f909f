# SPDX-License-Identifier: GPL-3.0-or-later
"""Lobes of hair: how much light they scatter, that sampling fits their density, and offsets on tubes."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.kernels.hair_lobes import evaluate_hair, lobes_at, sample_hair, strand_offset
from burnish.kernels.sampling import sample_pair
from burnish.kernels.shading_types import Closure, ShadingPoint

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False})

COLUMNS = wp.constant(128)
UPRIGHT = [1, 3]
"""Those of the cases without a lean"""

CASES = [(0.3, 0.3, 1.55, 0.035, 1.0), (0.05, 0.1, 1.55, 0.0, 1.0), (0.1, 0.6, 1.3, 0.1, 0.4),
         (0.8, 0.9, 1.8, 0.0, 1.0), (1.0, 1.0, 1.55, 0.035, 0.7)]
"""Roughness along and around, index, lean, and the share of R's roughness"""


@wp.func
def hair_closure(case: wp.vec2, index: float, tilt: float, primary: float, absorption: wp.vec3) -> Closure:
    """Return a closure of hair along x."""
    c = Closure()
    c.weight = wp.vec3(1.0, 1.0, 1.0)
    c.color = wp.vec3(1.0, 1.0, 1.0)
    c.normal = wp.vec3(1.0, 0.0, 0.0)
    c.tangent = absorption
    c.roughness = case[0]
    c.anisotropic = case[1]
    c.ior = index
    c.anisotropic_rotation = tilt
    c.film_thickness = primary
    return c


@wp.func
def view_of(sine: float) -> wp.vec3:
    """Return a direction at an angle to the plane across the strand."""
    return wp.vec3(sine, 0.0, wp.sqrt(1.0 - sine * sine))


@wp.kernel
def integrate(
    # In:
    cases: wp.array2d[float],
    sines: wp.array[float],
    offsets: wp.array[float],
    absorption: wp.vec3,
    count: int,
    # Out:
    sampled_out: wp.array2d[wp.vec4],
    even_out: wp.array2d[wp.vec4],
):
    """Estimate what a case's lobes return, by their own samples and over a grid; w: error of the density, density."""
    case, place = wp.tid()
    closure = hair_closure(
        wp.vec2(cases[case, 0], cases[case, 1]), cases[case, 2], cases[case, 3], cases[case, 4], absorption)
    wo = view_of(sines[place])
    lobes = lobes_at(closure, wo, wp.vec3(0.0, 1.0, 0.0), offsets[place])
    sampled = wp.vec4(0.0, 0.0, 0.0, 0.0)
    even = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(count):
        u = sample_pair(wp.uint32(7), wp.uint32(k), 0)
        s = sample_hair(lobes, u, (float(k) + 0.5) / float(count))
        if s.pdf > 0.0:
            sampled = sampled + wp.vec4(s.weight[0], s.weight[1], s.weight[2], wp.abs(
                evaluate_hair(lobes, s.wi).pdf / s.pdf - 1.0))
        z = 2.0 * (float(k // COLUMNS) + 0.5) / float(count // COLUMNS) - 1.0
        r = wp.sqrt(wp.max(1.0 - z * z, 0.0))
        turn = 6.2831853 * (float(k % COLUMNS) + 0.5) / float(COLUMNS)
        value = evaluate_hair(lobes, wp.vec3(z, r * wp.cos(turn), r * wp.sin(turn)))
        even = even + wp.vec4(value.f[0], value.f[1], value.f[2], value.pdf) * 12.566371
    sampled_out[case, place] = sampled / float(count)
    even_out[case, place] = even / float(count)


def estimates(absorption: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return [cases, views, 4] of both kernels' estimates."""
    sines, offsets = (values.ravel().astype(np.float32) for values in np.meshgrid(
        [-0.9, -0.4, 0.0, 0.5], [-0.95, -0.3, 0.0, 0.7]))
    cases = wp.array(np.array(CASES, np.float32), dtype=float, device=DEVICE)
    outputs = [wp.zeros((len(CASES), len(sines)), dtype=wp.vec4, device=DEVICE) for _ in range(2)]
    inputs = [cases, wp.array(sines, dtype=float, device=DEVICE), wp.array(offsets, dtype=float, device=DEVICE)]
    wp.launch(integrate, (len(CASES), len(sines)), [*inputs, wp.vec3(*absorption), 1 << 16], outputs, device=DEVICE)
    sampled, even = (output.numpy() for output in outputs)
    return sampled, even


@pytest.mark.slow
def test_white_hair_keeps_all_light():
    """Without absorption as much light leaves as arrives, by both ways of sampling."""
    sampled, even = estimates((0.0, 0.0, 0.0))
    np.testing.assert_allclose(sampled[..., :3], 1.0, rtol=1e-4)
    # Angles that lean are the model's approximation: what its tilted lobes pass is not 1 quite.
    np.testing.assert_allclose(even[UPRIGHT], 1.0, rtol=0.015)
    np.testing.assert_allclose(even, 1.0, rtol=0.25)


@pytest.mark.slow
def test_density_is_that_of_the_samples():
    """The density that sampling states is that of evaluation, sums to 1, and its weights bring the same light."""
    sampled, even = estimates((0.1, 0.5, 2.0))
    assert sampled[..., 3].max() < 1e-2
    np.testing.assert_allclose(even[UPRIGHT][..., 3], 1.0, rtol=0.015)
    np.testing.assert_allclose(sampled[UPRIGHT][..., :3], even[UPRIGHT][..., :3], atol=0.005)
    assert (sampled[..., 0] > sampled[..., 2] + 0.1).all()


@wp.kernel
def offsets_across(
    # In:
    turns: wp.array[float],
    places: wp.array[float],
    # Out:
    offsets_out: wp.array2d[float],
):
    """Meet a hexagon of a radius of 1 from above at places 0..1 over its width, turned by angles [rad]."""
    i, k = wp.tid()
    width = float(0.0)
    for c in range(6):
        width = wp.max(width, wp.cos(turns[i] + float(c) * 1.0471976))
    y = width * (2.0 * places[k] - 1.0)
    point = ShadingPoint()
    height = float(-2.0)
    for c in range(6):
        a = turns[i] + float(c) * 1.0471976
        b = a + 1.0471976
        ya = wp.cos(a)
        yb = wp.cos(b)
        if wp.abs(yb - ya) > 1.0e-6:
            t = (y - ya) / (yb - ya)
            z = wp.sin(a) + t * (wp.sin(b) - wp.sin(a))
            if t >= 0.0 and t <= 1.0 and z > height:
                height = z
                point.normal = wp.normalize(wp.vec3(0.0, y, z))
                point.geometric_normal = wp.vec3(0.0, wp.cos(a + 0.5235988), wp.sin(a + 0.5235988))
    offsets_out[i, k] = strand_offset(point, wp.vec3(1.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0))


def test_offsets_are_even_over_a_tube():
    """However a tube of six sides is turned, offsets go evenly from one edge of what it shows to the other."""
    turns = np.linspace(0, 1.0, 9).astype(np.float32)
    places = np.linspace(0.02, 0.98, 25).astype(np.float32)
    out = wp.zeros((len(turns), len(places)), dtype=float, device=DEVICE)
    wp.launch(offsets_across, out.shape, [wp.array(turns, device=DEVICE), wp.array(places, device=DEVICE)], [out],
              device=DEVICE)
    np.testing.assert_allclose(out.numpy(), np.broadcast_to(1 - 2 * places, out.shape), atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("absorption", [0.1, 2.0])
def test_darker_hair_passes_less(absorption):
    """More absorption means less light from all sides."""
    pale, dark = (estimates((value,) * 3)[0][..., 0] for value in (absorption, 2 * absorption))
    assert (dark < pale).all()
