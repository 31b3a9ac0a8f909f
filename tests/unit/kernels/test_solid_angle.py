# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of light sampling by solid angle, against closed forms: the solid angle, its moment, and a lamp's pdf."""

import numpy as np
import pytest
import warp as wp
from burnish.kernels import lamp_hit, lamp_sample, solid_angle, types

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False})

GRID = 128

TRIANGLES = {
    "octant": [(1, 0, 0), (0, 1, 0), (0, 0, 1)],
    "near": [(-1, -1, 0.05), (2, -0.5, 0.1), (0.3, 2, 0.02)],
    "edge-on": [(1, 0, 0.02), (3, 0.5, 0.01), (2, 2, 0.03)],
    "thin": [(1, 0, 1), (1, 0.02, 1), (-4, 0, 1)],
    "far": [(10, 0, 10), (11, 0, 10), (10, 1, 10)],
    "huge": [(-1e9, -1e9, 1e8), (2e9, -1e9, 1e8), (0, 3e9, 1e8)],
    "mirrored": [(0, 1, 0), (1, 0, 0), (0, 0, 1)],
}


@wp.kernel
def draw(a: wp.vec3, b: wp.vec3, c: wp.vec3, u: wp.array[wp.vec2], angle: wp.array[float],
         direction: wp.array[wp.vec3], weights: wp.array[wp.vec2]):
    i = wp.tid()
    seen = solid_angle.spherical_triangle(a, b, c)
    whole = solid_angle.solid_angle(seen)
    angle[i] = whole
    direction[i] = solid_angle.sample_spherical_triangle(seen, whole, u[i])
    weights[i] = solid_angle.sample_seen_triangle(a, b, c, seen, whole, u[i])


@wp.kernel
def draw_lamp(lamps: wp.array[types.Light], position: wp.vec3, u: wp.array[wp.vec2], kind: wp.array[int],
              direction: wp.array[wp.vec3], pdf: wp.array[float], met: wp.array[float], along: wp.array[wp.vec2]):
    i = wp.tid()
    s = lamp_sample.sample_lamp(lamps[0], position, u[i])
    hit = lamp_hit.lamp_hit(lamps[0], position, s.wi, lamp_hit.FAR)
    kind[i] = s.kind
    direction[i] = s.wi
    pdf[i] = s.pdf
    met[i] = hit.pdf
    along[i] = wp.vec2(s.distance, hit.t)


def grid():
    """Return points in the middle of the cells of a square grid."""
    x = (np.arange(GRID) + 0.5) / GRID
    return np.stack(np.meshgrid(x, x), -1).reshape(-1, 2).astype(np.float32)


def drawn(corners, u):
    """Return solid angle, directions [n, 3] and points [n, 3] of samples of a triangle."""
    count = len(u)
    points = wp.array(u, dtype=wp.vec2, device=DEVICE)
    angle = wp.zeros(count, dtype=float, device=DEVICE)
    direction, weights = (wp.zeros(count, dtype=kind, device=DEVICE) for kind in (wp.vec3, wp.vec2))
    wp.launch(draw, count, [*(wp.vec3(*map(float, corner)) for corner in corners), points, angle, direction, weights],
              device=DEVICE)
    w = weights.numpy().astype(np.float64)
    a, b, c = np.asarray(corners, np.float64)
    return angle.numpy()[0], direction.numpy(), a + w[:, :1] * (b - a) + w[:, 1:] * (c - a)


def exact_angle(corners):
    """Return a triangle's solid angle by its angles (Girard), in double precision."""
    v = np.asarray(corners, np.float64)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    angles = []
    for i in range(3):
        p, q = (v[j] - v[i] * (v[j] @ v[i]) for j in ((i + 1) % 3, (i + 2) % 3))
        angles.append(np.arctan2(np.linalg.norm(np.cross(p, q)), p @ q))
    return sum(angles) - np.pi


def exact_moment(corners):
    """Return the integral of the direction over a polygon's solid angle (Lambert 1760: half angles times normals)."""
    v = np.asarray(corners, np.float64)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    total = np.zeros(3)
    for p, q in zip(v, np.roll(v, -1, 0), strict=True):
        normal = np.cross(p, q)
        total += 0.5 * np.arctan2(np.linalg.norm(normal), p @ q) * normal / np.linalg.norm(normal)
    return total * np.sign(total @ v.mean(0))


@pytest.mark.parametrize("name", TRIANGLES)
def test_directions_are_uniform_over_a_triangle(name):
    """Find the solid angle, and by samples its moment, that of the half towards each corner too."""
    corners = TRIANGLES[name]
    angle, direction, points = drawn(corners, grid())
    np.testing.assert_allclose(angle, exact_angle(corners), rtol=2e-4)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=1e-4)
    moment = exact_moment(corners)
    np.testing.assert_allclose(direction.mean(0, dtype=np.float64) * angle, moment, atol=1e-3 * np.linalg.norm(moment))
    # The points lie where the directions go.
    towards = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert np.abs(towards - direction).max() < 1e-3
    # As many samples in a part of the triangle as its share of the solid angle.
    a, b, c = np.asarray(corners, np.float64)
    for part in ([a, b, (a + c) / 2], [a, (a + b) / 2, c]):
        x, y, z = np.linalg.solve(np.array(part).T, direction.T.astype(np.float64))
        inside = ((x >= 0) & (y >= 0) & (z >= 0)).mean()
        assert inside == pytest.approx(exact_angle(part) / exact_angle(corners), abs=0.01)


@pytest.mark.parametrize("corners", [
    [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(1, 0, 0), (2, 0, 0), (3, 0, 0)], [(1, 1, 0), (1, 1, 0), (1, 1, 0)],
    [(-1, -1, 0), (2, -1, 0), (0, 2, 0)], [(1e-30, 0, 1e-30), (0, 1e-30, 1e-30), (1e-30, 1e-30, 0)],
], ids=["corner", "line", "point", "inside", "tiny"])
def test_hopeless_triangles_stay_finite(corners):
    """Draw a point of a triangle that the receiver lies on, or that is none."""
    angle, direction, points = drawn(corners, np.array([(0, 0), (0.5, 0.5), (0.999, 0.999)], np.float32))
    assert np.isfinite(angle) and np.isfinite(direction).all() and np.isfinite(points).all()


def area_lamp(ellipse=False):
    """Return a lamp of 2 m by 1 m that shines down."""
    light = types.Light()
    light.kind = types.LIGHT_AREA
    light.flags = types.LIGHT_HITTABLE | (types.LIGHT_ELLIPSE if ellipse else 0)
    light.direction, light.axis_u, light.axis_v = (
        wp.vec3(0.0, 0.0, -1.0), wp.vec3(2.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0))
    light.radiance = wp.vec3(1.0, 1.0, 1.0)
    light.area = 2.0 if not ellipse else np.pi / 2
    light.visibility = -1
    return light


@pytest.mark.parametrize("ellipse", [False, True])
@pytest.mark.parametrize("position", [(0, 0, -0.05), (0.9, -0.4, -0.3), (1.5, 0.2, -0.1), (0.3, 3.0, -2.0)])
def test_lamps_are_drawn_as_they_are_met(position, ellipse):
    """Give a lamp's sample the pdf of a ray that meets it, which is uniform for a rectangle that is close."""
    u = grid()
    lamps = wp.array([area_lamp(ellipse)], dtype=types.Light, device=DEVICE)
    points = wp.array(u, dtype=wp.vec2, device=DEVICE)
    kind = wp.zeros(len(u), dtype=int, device=DEVICE)
    direction = wp.zeros(len(u), dtype=wp.vec3, device=DEVICE)
    pdf, met = (wp.zeros(len(u), dtype=float, device=DEVICE) for _ in range(2))
    along = wp.zeros(len(u), dtype=wp.vec2, device=DEVICE)
    wp.launch(draw_lamp, len(u), [lamps, wp.vec3(*map(float, position)), points, kind, direction, pdf, met, along],
              device=DEVICE)
    found = (kind.numpy() >= 0) & (met.numpy() > 0)
    assert found.mean() > 0.98
    np.testing.assert_allclose(pdf.numpy()[found], met.numpy()[found], rtol=2e-3)
    np.testing.assert_allclose(*along.numpy()[found].T, rtol=1e-3)
    corners = np.array([(-1, -0.5, 0), (1, -0.5, 0), (1, 0.5, 0), (-1, 0.5, 0)]) - position
    if not ellipse:
        moment = exact_moment(corners)
        each = direction.numpy()[found].astype(np.float64) / pdf.numpy()[found, None]
        np.testing.assert_allclose(each.sum(0) / len(u), moment, atol=5e-3 * np.linalg.norm(moment))
        close = position[2] > -0.5
        assert (np.ptp(pdf.numpy()[found]) < 1e-4 * pdf.numpy()[found].max()) == close


def test_lamps_behind_are_not_drawn():
    """Draw nothing from behind a lamp that is close."""
    lamps = wp.array([area_lamp()], dtype=types.Light, device=DEVICE)
    u = grid()
    kind = wp.zeros(len(u), dtype=int, device=DEVICE)
    direction = wp.zeros(len(u), dtype=wp.vec3, device=DEVICE)
    pdf, met = (wp.zeros(len(u), dtype=float, device=DEVICE) for _ in range(2))
    along = wp.zeros(len(u), dtype=wp.vec2, device=DEVICE)
    wp.launch(draw_lamp, len(u), [lamps, wp.vec3(0.1, 0.1, 0.1), wp.array(u, dtype=wp.vec2, device=DEVICE), kind,
                                  direction, pdf, met, along], device=DEVICE)
    assert (kind.numpy() < 0).all()
