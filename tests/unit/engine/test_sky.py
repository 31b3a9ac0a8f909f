# SPDX-License-Identifier: GPL-3.0-or-later
"""The sky models: symmetry, energy, what they make of their settings, and what Cycles says in some directions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from burnish.engine import environment
from burnish.engine.program import ProgramBuilder
from burnish.engine.program_probe import SkyProbe
from burnish.engine.scene import Visibility
from burnish.engine.sky import multiple, single
from burnish.engine.sky.atmosphere import HEIGHT, WIDTH, atmosphere_rays, row_elevations
from burnish.engine.sky.disc import LIMB_DARKENING, sun_disc
from burnish.engine.sky.hosek import curve_places, evaluate
from burnish.engine.sky.image import SkyKind, SkySettings, disc_of, sky_at_sun, sky_pixels, sky_xyz
from burnish.kernels.node_texture import project_sky

LOW = math.radians(15.0)

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def project(
    # In:
    directions: wp.array[wp.vec3],
    # Out:
    uv_out: wp.array[wp.vec2],
):
    """Look directions up."""
    i = wp.tid()
    uv_out[i] = project_sky(directions[i])


def settings(kind: str, elevation: float = LOW, **values) -> SkySettings:
    """Return settings of a model by the start of its name."""
    return SkySettings(next(each for each in SkyKind if each.startswith(kind)), elevation, **values)


def irradiance(image: np.ndarray, towards: tuple[float, float, float]) -> np.ndarray:
    """Return what a plane gets from a picture of the sky, lowest row first; the sun's azimuth is +x."""
    edges = np.linspace(-1.0, 1.0, HEIGHT + 1)
    elevations = np.sin(np.copysign(edges**2, edges) * 0.5 * math.pi)
    azimuths = math.pi - 2.0 * math.pi * (np.arange(WIDTH) + 0.5) / WIDTH
    cosine = np.maximum(atmosphere_rays(row_elevations(), azimuths) @ np.array(towards), 0.0)
    solid_angle = np.diff(elevations)[:, None] * (2.0 * math.pi / WIDTH)
    return np.einsum("ywc,yw->c", image, cosine * solid_angle)


def looked_up(sky: SkySettings, direction: np.ndarray) -> np.ndarray:
    """Return the radiance in a direction as the kernels interpolate it; the sun's azimuth is +x."""
    pixels, scale = sky_pixels(sky)
    elevation = math.asin(direction[2]) * 2.0 / math.pi
    x = (0.5 - math.atan2(direction[1], direction[0]) / (2.0 * math.pi)) * WIDTH - 0.5
    y = (0.5 + 0.5 * math.copysign(math.sqrt(abs(elevation)), elevation)) * HEIGHT - 0.5
    i, j = math.floor(x), math.floor(y)
    total = np.zeros(3)
    for di, wx in ((0, 1.0 - (x - i)), (1, x - i)):
        for dj, wy in ((0, 1.0 - (y - j)), (1, y - j)):
            row, column = min(max(j + dj, 0), HEIGHT - 1), min(max(i + di, 0), WIDTH - 1)
            total += wx * wy * pixels[HEIGHT - 1 - row, column]
    return total * scale


@pytest.mark.parametrize("kind", list(SkyKind))
def test_symmetric_about_the_sun(kind: SkyKind):
    """Look the same to the left and right of the sun, be finite, and be brightest in the sun's half."""
    image = sky_xyz(SkySettings(kind, LOW, turbidity=3.0))
    assert image.shape == (HEIGHT, WIDTH, 3) and np.isfinite(image).all()
    np.testing.assert_array_equal(image, image[:, ::-1])
    assert irradiance(image, (1.0, 0.0, 0.0))[1] > 1.2 * irradiance(image, (-1.0, 0.0, 0.0))[1]


CYCLES = {
    ("SINGLE", LOW, 1.0): (
        (62.308, 41.368, 17.58), (1.6316, 2.4068, 3.4672), (0.61866, 1.002, 1.6563),
        (0.53452, 0.85415, 1.4298), (29.417, 17.23, 5.8286)),
    ("MULTIPLE", LOW, 1.0): (
        (69.164, 57.292, 36.059), (1.8685, 3.4606, 6.1741), (0.74219, 1.5217, 3.1571),
        (0.6243, 1.2737, 2.6676), (1.9979, 1.9114, 1.684)),
    ("MULTIPLE", 0.0, 1.0): (
        (19.41, 4.7563, 0.3126), (0.47737, 0.54453, 0.80508), (0.21887, 0.27146, 0.47001),
        (0.15795, 0.20202, 0.37017), (0.2952, 0.054221, 0.030508)),
    ("SINGLE", 0.0, 1.0): (
        (11.897, 2.974, 0.0), (0.39042, 0.46723, 0.5051), (0.18295, 0.23641, 0.29574),
        (0.13191, 0.17305, 0.22516), (3.9057, 0.61952, 0.0)),
    ("PREETHAM", 0.0, 2.2): (
        (1.0345, 0.87885, 0.97455), (0.26402, 0.4473, 0.82011), (0.22655, 0.36757, 0.72257),
        (0.22698, 0.35112, 0.68799), (0.93735, 0.80711, 0.91468)),
    ("HOSEK", 0.0, 2.2): (
        (0.16516, 0.22043, 0.26645), (0.043863, 0.084922, 0.15641), (0.027132, 0.052233, 0.10739),
        (0.02302, 0.041704, 0.090211), (0.15943, 0.18777, 0.18021)),
}
"""Radiance that Cycles 5.2 draws at five pixels of a panorama, by model, the sun's elevation and turbidity"""

PIXELS = ((130, 128), (160, 40), (200, 300), (250, 10), (120, 128))
"""Rows from below and columns, of 256 x 512"""


@pytest.mark.parametrize("case", list(CYCLES), ids=str)
def test_radiance_of_cycles(case: tuple[str, float, float]):
    """Draw what Cycles draws, within 1 % of each channel; the sun on the left, or where its vector points."""
    kind, elevation, turbidity = case
    azimuth = 0.5 * math.pi
    if kind in ("PREETHAM", "HOSEK"):
        x, y, z = np.array([0.3, 0.4, 0.7]) / np.linalg.norm([0.3, 0.4, 0.7])
        elevation, azimuth = math.asin(z), math.atan2(y, x)
    sky = settings(kind, elevation, turbidity=turbidity)
    for (row, column), expected in zip(PIXELS, CYCLES[case], strict=True):
        phi = (0.5 - (column + 0.5) / 512.0) * 2.0 * math.pi - azimuth
        theta = (1.0 - (row + 0.5) / 256.0) * math.pi
        direction = np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])
        np.testing.assert_allclose(looked_up(sky, direction), expected, rtol=0.01, atol=2e-3)


@pytest.mark.parametrize(("model", "kind", "above"), [
    (single, "SINGLE", single.to_xyz(single.sun_spectrum())), (multiple, "MULTIPLE", multiple.SUN @ multiple.TO_XYZ)])
def test_energy(model, kind: str, above: np.ndarray):
    """Give the ground less than what comes in above the air, and the less the lower the sun and the more dust."""
    before = np.zeros(3)
    for degrees in (2.0, 10.0, 30.0, 60.0, 90.0):
        sky = settings(kind, math.radians(degrees))
        direct = model.sun(np.array([sky.sun_elevation]), *sky.atmosphere)[0] * math.sin(sky.sun_elevation)
        total = direct + irradiance(sky_xyz(sky), (0.0, 0.0, 1.0))
        assert (total > before).all() and (total < above * math.sin(sky.sun_elevation) * 1.05).all()
        dusty = model.sun(np.array([sky.sun_elevation]), *replace(sky, aerosols=5.0).atmosphere)[0]
        assert (dusty * math.sin(sky.sun_elevation) < direct).all()
        before = total


@pytest.mark.parametrize("kind", ["SINGLE", "MULTIPLE"])
def test_no_air_no_sky(kind: str):
    """Be black where nothing scatters, and bluer the cleaner the air."""
    assert not sky_xyz(settings(kind, air=0.0, aerosols=0.0)).any()
    blue = [x[2] / x[0] for x in (sky_pixels(settings(kind, aerosols=a))[0][30, 100] for a in (0.0, 1.0, 10.0))]
    assert blue[0] > blue[1] > blue[2]


def test_night_keeps_its_digits():
    """Raise a dark sky so that half floats hold it, by a power of two."""
    pixels, scale = sky_pixels(settings("SINGLE", math.radians(-8.0)))
    assert scale < 0.1 and math.log2(scale) == round(math.log2(scale)) and 1.0 <= pixels.max() < 2.0
    assert sky_pixels(settings("MULTIPLE"))[1] == 1.0


def test_odd_settings_stay_finite():
    """Draw something finite at the ends of all ranges."""
    for kind in SkyKind:
        for elevation in (-0.5 * math.pi, 0.0, 0.5 * math.pi):
            for extreme in ({"altitude": 0.0, "air": 0.0, "turbidity": 1.0, "albedo": 0.0},
                            {"altitude": 1e5, "air": 1e3, "aerosols": 1e3, "ozone": 1e3, "turbidity": 10.0,
                             "albedo": 1.0}):
                pixels, scale = sky_pixels(SkySettings(kind, elevation, **extreme))
                assert np.isfinite(pixels).all() and pixels.min() >= 0.0 and 0.0 < scale <= 1.0


def test_disc_holds_the_suns_irradiance():
    """Shine as strongly as the whole sun, but for its darkened limb, wherever it stands and however large it is."""
    one = np.ones(3)
    limb = 1.0 - LIMB_DARKENING / 3.0
    for size in (0.0005, 0.0095, 0.2):
        disc = sun_disc(one, one, np.eye(3), LOW, size, 100.0)
        np.testing.assert_allclose(disc.irradiance, limb * one, rtol=4e-3)
        assert disc.lamp_elevation == pytest.approx(LOW, abs=1e-3 * size)
        assert disc.lamp_angle == pytest.approx(size, rel=3e-3)
        assert disc.pixels[0].max() == disc.pixels[:, 0].max() == 0.0 and disc.pixels.max() == 1.0


def test_setting_sun_is_cut():
    """Show the upper half of a sun on the horizon, none below it, and light from the middle of what is seen."""
    whole, half = (sun_disc(np.ones(3), np.ones(3), np.eye(3), elevation, 0.02, 0.0) for elevation in (0.1, 0.0))
    assert half.irradiance[0] == pytest.approx(0.5 * whole.irradiance[0], rel=0.01)
    assert 0.003 < half.lamp_elevation < 0.006 and half.lamp_angle == pytest.approx(0.02 / math.sqrt(2.0), rel=0.01)
    assert sun_disc(np.ones(3), np.ones(3), np.eye(3), -0.02, 0.02, 0.0) is None
    # From a mountain one looks further down.
    assert sun_disc(np.ones(3), np.ones(3), np.eye(3), -0.02, 0.02, 3000.0) is not None
    assert disc_of(settings("SINGLE", -0.02), 0.02) is None and disc_of(settings("PREETHAM"), 0.02) is None


def test_red_sun_has_no_negative_light():
    """Clip the colours of a setting sun, which lie outside Rec.709."""
    disc = disc_of(settings("SINGLE", 0.0, aerosols=3.0), 0.0095)
    assert disc.pixels.min() >= 0.0 and disc.irradiance[0] > 3.0 * disc.irradiance[1]
    assert (sky_at_sun(settings("SINGLE")) > sky_at_sun(settings("SINGLE", -0.1))).all()


def test_hosek_curves_are_smooth():
    """Change gently between the knots of turbidity, albedo and the sun's elevation, and meet at them."""
    angle = np.linspace(0.05, 2.0, 8)
    zenith = np.full(8, 1.0)
    for turbidity in (2.0, 3.0, 6.0):
        below, above = (evaluate(1.0, turbidity + step, 0.3, zenith, angle) for step in (-1e-6, 1e-6))
        np.testing.assert_allclose(below, above, rtol=1e-3)
    places = curve_places()
    for place in 0.5 * (places[3:-1] + places[4:]):
        near = [evaluate(0.5 * math.pi * (1.0 - (place + step) ** 3), 3.3, 0.4, zenith, angle)
                for step in (-0.02, 0.0, 0.02)]
        np.testing.assert_allclose(near[1], 0.5 * (near[0] + near[2]), rtol=0.02)


def test_rows_and_columns_are_found(device: str):
    """Look a direction up at the texel that was computed for it."""
    elevations, azimuths = row_elevations(), math.pi - 2.0 * math.pi * (np.arange(WIDTH) + 0.5) / WIDTH
    rays = atmosphere_rays(elevations, azimuths).reshape(-1, 3).astype(np.float32)
    found = wp.zeros(len(rays), dtype=wp.vec2, device=device)
    wp.launch(project, len(rays), [wp.array(rays, dtype=wp.vec3, device=device)], [found], device=device)
    uv = found.numpy().reshape(HEIGHT, WIDTH, 2)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    np.testing.assert_allclose(uv[..., 0] * WIDTH, x + 0.5, atol=0.01)
    # Towards the poles a float's z says little of the elevation.
    np.testing.assert_allclose(uv[..., 1] * HEIGHT, y + 0.5, atol=0.05)


def test_probe_knows_rotations():
    """Find the rotation in front of a sky, and none where there is a stretch, a shift or anything else."""
    turn = [(0.0, -1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)]
    stretch = [(2.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)]
    shift = [(1.0, 0.0, 0.0, 0.5), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)]

    def found(*blocks, name: str = "GENERATED", direction: bool = False):
        probe = SkyProbe(int(Visibility.DIFFUSE), (1.0, 2.0, 3.0))
        place = probe.input(name)
        for rows in blocks:
            place = probe.transform(rows, place, direction=direction)
        assert probe.sky_at(place).constant[:3] == (1.0, 2.0, 3.0)
        return probe.turn()

    np.testing.assert_array_equal(found(), np.eye(3))
    np.testing.assert_allclose(found(turn, turn), np.diag([-1.0, -1.0, 1.0]))
    assert found(stretch) is None and found(shift) is None and found(name="NORMAL") is None
    np.testing.assert_array_equal(found(shift, direction=True), np.eye(3))


@pytest.mark.parametrize(("mask", "same"), [(Visibility.CAMERA, True), (Visibility.GLOSSY, False)])
def test_camera_alone_may_see_another_world(mask: Visibility, same: bool):
    """Let texels stand for a world that is another one for camera rays alone, as they never see texels."""
    build = ProgramBuilder()
    build.emit(build.vector("MULTIPLY", build.input("POSITION"), build.input("RAY_KIND", int(mask))), 1.0, 1.0)
    assert environment._is_same_for_all(build.finish()) is same
