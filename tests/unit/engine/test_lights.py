# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of light sampling against closed forms: a diffuse plane under every kind of lamp."""

import numpy as np
import pytest

from tests import scenes

ALBEDO = 0.6
DISTANCE = 2.0
TINY = scenes.camera_above(height=0.3, half=0.01)
"""Sees practically one point of the plane, from below the lamps"""


def plane_radiance(lights=(), objects=(), materials=None, meshes=None, background=0.0, samples=256, **paths):
    """Return the radiance of a diffuse plane's centre."""
    image = scenes.render(
        scenes.delta({"plane": scenes.quad(20.0), **(meshes or {})}, [("plane", np.eye(4), "grey"), *objects],
                     {"grey": scenes.material(color=ALBEDO), **(materials or {})}, lights, background),
        TINY, samples=samples, **paths)
    return image[..., 0].mean(dtype=np.float64)


def facing_down(z):
    """Return the transform of a lamp at height z above the camera's ray, out of its way, shining down."""
    return scenes.place(z=z)


def disk_form_factor(radius, distance):
    """Return the form factor from a point to a disk that faces it."""
    return radius**2 / (radius**2 + distance**2)


def rectangle_form_factor(half_x, half_y, distance):
    """Return the form factor from a point to a centred rectangle parallel to its plane (Howell's catalogue, B-3)."""
    a, b = half_x / distance, half_y / distance
    corner = (a / np.hypot(1, a) * np.arctan(b / np.hypot(1, a)) + b / np.hypot(1, b) * np.arctan(a / np.hypot(1, b)))
    return 4 * corner / (2 * np.pi)


@pytest.mark.parametrize("radius", [0.0, 1e-3])
@pytest.mark.parametrize("soft", [True, False])
def test_point_lamp(radius, soft):
    """Light a plane by P / 4 pi per steradian from a small point lamp."""
    lamp = scenes.lamp("POINT", 100.0, facing_down(DISTANCE), radius=radius, soft_falloff=soft)
    expected = ALBEDO / np.pi * 100.0 / (4 * np.pi) / DISTANCE**2 / 1.0
    np.testing.assert_allclose(plane_radiance([lamp]), expected, rtol=2e-3)


@pytest.mark.parametrize("radius", [0.5, 1.5])
def test_sphere_lamp(radius):
    """Light a plane like a uniform sphere: E = L pi (r / d)^2, whether met by rays or sampled."""
    lamp = scenes.lamp("POINT", 100.0, facing_down(DISTANCE), radius=radius, soft_falloff=False)
    radiance = 100.0 / (4 * np.pi**2 * radius**2)
    np.testing.assert_allclose(plane_radiance([lamp]), ALBEDO * radiance * (radius / DISTANCE) ** 2, rtol=5e-3)


@pytest.mark.parametrize("angle", [0.0, 0.01, 1.0])
def test_sun(angle):
    """Light a plane by the sun's irradiance at normal incidence, whatever its angle."""
    lamp = scenes.lamp("SUN", 3.0, angle=angle)
    np.testing.assert_allclose(plane_radiance([lamp]), ALBEDO / np.pi * 3.0, rtol=5e-3)


@pytest.mark.parametrize("shape", ["RECTANGLE", "SQUARE", "DISK", "ELLIPSE"])
def test_area_lamp(shape):
    """Light a plane by an area lamp's analytic form factor."""
    lamp = scenes.lamp("AREA", 50.0, facing_down(DISTANCE), shape=shape, size_x=2.0, size_y=1.0)
    size_y = 1.0 if shape in ("RECTANGLE", "ELLIPSE") else 2.0
    if shape in ("RECTANGLE", "SQUARE"):
        area, factor = 2.0 * size_y, rectangle_form_factor(1.0, 0.5 * size_y, DISTANCE)
    else:
        area = np.pi / 4 * 2.0 * size_y
        t, r = np.meshgrid((np.arange(512) + 0.5) / 512 * 2 * np.pi, (np.arange(512) + 0.5) / 512)
        d2 = (r * np.cos(t)) ** 2 + (0.5 * size_y * r * np.sin(t)) ** 2 + DISTANCE**2
        factor = (DISTANCE**2 / d2**2 / np.pi * r).mean() * area * 2.0
    expected = ALBEDO * 50.0 / (np.pi * area) * factor
    np.testing.assert_allclose(plane_radiance([lamp]), expected, rtol=5e-3)


def test_spot_blend():
    """Light the axis of a spot fully and nothing outside its cone."""
    lamp = scenes.lamp("SPOT", 100.0, facing_down(DISTANCE), spot_size=0.5, spot_blend=0.2)
    np.testing.assert_allclose(plane_radiance([lamp]), ALBEDO / np.pi * 100 / (4 * np.pi) / DISTANCE**2, rtol=2e-3)
    aside = scenes.place(x=1.5, z=DISTANCE)
    outside = scenes.lamp("SPOT", 100.0, aside, spot_size=0.5, spot_blend=0.2)
    assert plane_radiance([outside]) == 0.0


@pytest.mark.parametrize("spread", [0.5, 1.5, 3.0])
def test_area_spread(spread):
    """Keep a narrow-spread lamp's power: all of it arrives on a plane large enough."""
    lamp = scenes.lamp("AREA", 50.0, facing_down(1.0), shape="DISK", size_x=0.01, spread=spread)
    camera = scenes.camera_above(half=6.0, height=0.5)
    image = scenes.render(
        scenes.delta({"plane": scenes.quad(40.0)}, [("plane", np.eye(4), "grey")],
                     {"grey": scenes.material(color=1.0)}, [lamp]), camera, size=(96, 96), samples=16, max_bounces=1)
    flux = image[..., 0].mean(dtype=np.float64) * np.pi * 144
    expected = 50.0 if spread < 2.5 else flux
    np.testing.assert_allclose(flux, expected, rtol=0.02)
    assert flux < 50.5


def test_emissive_mesh_both_sides():
    """Light a plane by an emissive square from either of its sides, by its form factor."""
    expected = ALBEDO * 5.0 * rectangle_form_factor(1.0, 1.0, DISTANCE)
    for flip in (1.0, -1.0):
        matrix = scenes.place(z=DISTANCE)
        matrix[2, 2] = matrix[0, 0] = flip
        radiance = plane_radiance(
            objects=[("lamp", matrix, "glow")], materials={"glow": scenes.emitter(5.0)},
            meshes={"lamp": scenes.quad(1.0)})
        np.testing.assert_allclose(radiance, expected, rtol=5e-3)


def standing_form_factor(distance, half, height):
    """Return the form factor from a point to a rectangle that stands on its plane, by summation."""
    y, z = np.meshgrid((np.arange(800) + 0.5) / 400 * half - half, (np.arange(800) + 0.5) / 800 * height)
    d2 = distance**2 + y**2 + z**2
    return (z * distance / d2**2 / np.pi).sum() * (half / 400) * (height / 800)


@pytest.mark.parametrize("distance", [0.02, 0.2, 2.0])
def test_emissive_walls_close_by(distance):
    """Light a plane by the wall that stands on it, by its form factor, however it is sampled at this distance."""
    wall = np.array([[0, 0, 1, -distance], [1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 0, 1]], np.float64)
    image = scenes.render(
        scenes.delta({"plane": scenes.quad(20.0), "wall": scenes.quad(1.0)},
                     [("plane", np.eye(4), "grey"), ("wall", wall, "glow")],
                     {"grey": scenes.material(color=ALBEDO), "glow": scenes.emitter(5.0)}, (), 0.0),
        TINY, size=(48, 48), samples=16, max_bounces=2)[..., 0]
    expected = ALBEDO * 5.0 * standing_form_factor(distance, 1.0, 2.0)
    np.testing.assert_allclose(image.mean(dtype=np.float64), expected, rtol=0.005)


def test_world():
    """Reflect a uniform world by exactly the albedo."""
    np.testing.assert_allclose(plane_radiance(background=2.0), 2.0 * ALBEDO, rtol=2e-3)


def test_all_lights_add_up():
    """Add the light of a lamp, a mesh and the world, sampled by one table."""
    lamp = scenes.lamp("AREA", 50.0, scenes.place(x=3.0, z=DISTANCE), shape="SQUARE", size_x=1.0)
    mesh = dict(objects=[("lamp", scenes.place(x=-3.0, z=DISTANCE), "glow")],
                materials={"glow": scenes.emitter(5.0)}, meshes={"lamp": scenes.quad(0.5)})
    alone = plane_radiance([lamp], max_bounces=1) + plane_radiance(**mesh, max_bounces=1)
    both = plane_radiance([lamp], **mesh, max_bounces=1)
    np.testing.assert_allclose(both, alone, rtol=1e-2)
