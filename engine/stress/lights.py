# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps of 1e-12 to 1e12 W and of odd sizes, worlds with suns of 1e6, NaN and infinity, and light beyond halves."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from ..program import ProgramBuilder
from ..scene import AlphaMode, ColorEncoding, ImageData, LightData
from ..settings import Integrator
from .cases import BOTH, Case, Trial, luminance
from .scenes import (
    EYE,
    Placed,
    StressScene,
    emitter,
    lamp,
    look_at,
    make_scene,
    material,
    place,
    principled,
    quad,
    room,
    sphere,
    world,
)

__all__ = ["CASES"]

SIZE = (32, 24)
POWERS = (1e-12, 1e-6, 1e-3, 1e3, 1e6, 1e12)
HALF_POWERS = (1e-3, 1e3)
"""What halves hold without an exposure that follows the light"""
EXPOSED_POWERS = (1e-6, 1e-3, 1e3, 1e6, 1e12)
"""Exposures reach up to 1e6"""
LINEAR = 1e-3
HALF_LINEAR = 0.03


def lit_floor(light: LightData) -> StressScene:
    """Return a grey floor and a plastic ball under one lamp."""
    return make_scene(
        {"floor": quad(3.0), "ball": sphere(0.5)},
        [Placed("floor", "grey", EYE), Placed("ball", "plastic", place(0.5, 0.25, 0.5))],
        {"grey": material(color=0.6), "plastic": principled(color=0.5, roughness=0.3)},
        look_at((0.0, -3.0, 2.0), (0.0, 0.0, 0.25), SIZE, 0.9), [light])


def make_lamps(power: float) -> dict[str, LightData]:
    """Return a lamp of every kind, with and without a size, of so many watts."""
    high = place(-0.5, -0.5, 2.0)
    return {
        "point without size": lamp("POINT", power, high), "point": lamp("POINT", power, high, radius=0.25),
        "sphere": lamp("POINT", power, high, radius=0.25, soft_falloff=False),
        "sun without size": lamp("SUN", power / 20.0, high), "sun": lamp("SUN", power / 20.0, high, angle=0.05),
        "spot without size": lamp("SPOT", power, high, spot_size=1.2),
        "spot": lamp("SPOT", power, high, radius=0.125, spot_size=1.2, spot_blend=1.0),
        "area": lamp("AREA", power, high, shape="RECTANGLE", size_x=0.5, size_y=1.0),
        "disk with spread": lamp("AREA", power, high, shape="DISK", size_x=0.5, size_y=0.5, spread=1.5),
    }


def run_powers(trial: Trial, integrator: Integrator, exposed: bool) -> None:
    """Find light in proportion to a lamp's power; `exposed`: with an exposure that undoes it."""
    amount = trial.choose(4, 16)
    base = make_lamps(20.0)
    names = trial.choose(list(base)[1::6], list(base))
    powers = POWERS if integrator == Integrator.REFERENCE else HALF_POWERS
    powers = trial.choose(EXPOSED_POWERS[::4], EXPOSED_POWERS) if exposed else powers
    tolerance = LINEAR if integrator == Integrator.REFERENCE else HALF_LINEAR
    for name in names:
        expected = luminance(trial.render(lit_floor(base[name]), integrator, amount, SIZE)).mean()
        for factor in powers:
            film = {"exposure": 1.0 / factor} if exposed else {}
            picture = trial.render(lit_floor(make_lamps(20.0 * factor)[name]), integrator, amount, SIZE, film=film)
            ratio = luminance(picture).mean() / expected * (1.0 if exposed else 1.0 / factor)
            trial.check_energy(f"{name} of {20.0 * factor:g} W", ratio, tolerance)


def run_extreme_powers(trial: Trial, integrator: Integrator) -> None:
    """Render lamps beyond what halves hold: nothing but the count of bad pixels, and light where there is much."""
    for factor in POWERS:
        for name, light in make_lamps(20.0 * factor).items():
            if trial.quick and name != "area":
                continue
            picture = trial.render(lit_floor(light), integrator, 3, SIZE)
            if factor > 1.0:
                trial.check(f"{name} of {20.0 * factor:g} W: mean", luminance(picture).mean(), 0.01, np.inf)


def run_odd_lamps(trial: Trial, integrator: Integrator) -> None:
    """Render lamps of extreme sizes, angles and spreads, alone and all together."""
    high = place(-0.5, -0.5, 2.0)
    lights = [
        *(lamp("POINT", 20.0, high, radius=radius) for radius in (1e-30, 1e-12, 1e-6, 1e3, 1e9, 1e18)),
        *(lamp("SUN", 1.0, high, angle=angle) for angle in (1e-12, 1e-6, 3.14, math.pi, 6.3)),
        *(lamp("SPOT", 20.0, high, spot_size=angle, spot_blend=blend)
          for angle, blend in ((1e-6, 0.0), (0.01, 1.0), (3.14, 0.0), (3.1415926, 1.0))),
        *(lamp("AREA", 20.0, high, shape="RECTANGLE", size_x=x, size_y=y, spread=spread) for x, y, spread in (
            (1e-12, 1e-12, 3.14159265), (1e-6, 1e6, 3.14159265), (1e9, 1e9, 3.14159265), (1.0, 1.0, 0.0),
            (1.0, 1.0, 1e-6), (0.0, 1.0, 1.0))),
        lamp("POINT", 20.0, place(0.5, 0.25, 0.5), radius=0.25), lamp("POINT", 20.0, place(0.0, 0.0, 0.0)),
        lamp("POINT", -20.0, high), lamp("AREA", 20.0, np.diag([-1.0, 1.0, 1.0, 1.0]) @ high, size_x=1.0),
        lamp("AREA", 20.0, np.diag([0.0, 0.0, 0.0, 1.0]), size_x=1.0),
    ]
    scene = lit_floor(lights[0])
    scene.delta.lights = lights
    trial.render(scene, integrator, 4, SIZE)
    for light in lights[::trial.choose(5, 1)]:
        trial.render(lit_floor(light), integrator, 3, SIZE)


# Worlds.


def sky_of(pixels: np.ndarray) -> StressScene:
    """Return a white floor and a metal ball under a panorama."""
    def build(builder: ProgramBuilder) -> None:
        builder.emit(builder.image("sky", builder.input("POSITION"), projection="EQUIRECTANGULAR"), 1.0, 1.0)

    image = ImageData(name="sky", pixels=pixels, encoding=ColorEncoding.LINEAR, alpha_mode=AlphaMode.NONE)
    return make_scene(
        {"floor": quad(20.0), "ball": sphere(0.5)},
        [Placed("floor", "white", EYE), Placed("ball", "metal", place(0.75, 0.5, 0.5))],
        {"white": material(color=0.5), "metal": principled(color=0.9, metallic=1.0, roughness=0.3)},
        look_at((0.0, -3.0, 1.5), (0.0, 0.0, 0.25), SIZE, 0.9), background=world(build=build), images={"sky": image})


def panorama(base: float = 0.5, size: tuple[int, int] = (32, 64)) -> np.ndarray:
    """Return a grey panorama, float32 [H, W, 3], zenith first."""
    return np.full((*size, 3), base, np.float32)


def run_broken_skies(trial: Trial, integrator: Integrator) -> None:
    """Render skies with a patch of each kind of bad value: the rest of the sky still shines."""
    expected = luminance(trial.render(sky_of(panorama()), integrator, 8, SIZE)).mean()
    for name, value in (("NaN", np.nan), ("inf", np.inf), ("-inf", -np.inf), ("negative", -1.0), ("denormal", 1e-42)):
        if trial.quick and name not in ("NaN", "inf"):
            continue
        pixels = panorama()
        pixels[3:5, 10:13] = value
        picture = trial.render(sky_of(pixels), integrator, 8, SIZE)
        trial.check_energy(f"sky with {name}", luminance(picture).mean() / expected, 0.1)
    for value in (np.nan, np.inf, 3e38, 1e-42, 0.0):
        trial.render(sky_of(panorama(value)), integrator, 4, SIZE)


def run_sun_in_sky(trial: Trial, integrator: Integrator) -> None:
    """Find the irradiance of skies with a texel of 1e4, 1e5 and 1e6 on the floor."""
    amount = trial.choose(24, 256)
    for value in trial.choose((1e6,), (1e4, 1e5, 1e6)):
        pixels = panorama(0.1, (128, 256))
        pixels[30, 60] = value
        rows = (np.arange(128) + 0.5) / 128 * np.pi
        weights = np.maximum(np.cos(rows), 0.0) * np.sin(rows) * (np.pi / 128) * (2.0 * np.pi / 256)
        irradiance = float((pixels[..., 0] * weights[:, None]).sum())
        scene = sky_of(pixels)
        # Nothing but the floor, which sees half of the sky.
        scene.delta.instances.visibility[1] = 0
        # Halves hold no more than 65504: the picture is made darker by a factor.
        exposure = min(1.0, 100.0 / irradiance)
        picture = trial.render(scene, integrator, amount, SIZE, film={"exposure": exposure})
        found = luminance(picture)[:SIZE[1] // 3].mean() / exposure
        trial.check_energy(f"sun of {value:g}", found / (irradiance * 0.5 / np.pi), 0.03)


def run_half_overflow(trial: Trial, integrator: Integrator) -> None:
    """Render radiance beyond the range of halves: seen, reflected, refracted, and as light on all else."""
    for radiance in trial.choose((7e4, 1e30), (6e4, 7e4, 1e6, 1e12, 1e30)):
        scene = room(SIZE)
        scene.delta.materials["panel"] = emitter((radiance, 2.0, 0.5 * radiance))
        picture = trial.render(scene, integrator, 6, SIZE)
        trial.check(f"panel of {radiance:g}: brightest", picture.max(), 1e4, np.inf)
        trial.render(room(SIZE, power=radiance), integrator, 6, SIZE)
        scene = room(SIZE)
        scene.delta.world = world((radiance, radiance, 1.0))
        trial.render(scene, integrator, 6, SIZE)


def make_cases() -> tuple[Case, ...]:
    """Return all cases."""
    cases = [
        Case("lamps: 1e-12 to 1e12 W, reference", "energy within 0.1 %",
             partial(run_powers, integrator=Integrator.REFERENCE, exposed=False)),
        Case("lamps: 1e-3 to 1e3 of the power, realtime", "energy within 3 %",
             partial(run_powers, integrator=Integrator.REALTIME, exposed=False)),
        Case("lamps: 1e-6 to 1e12 with exposure, realtime", "energy within 3 %",
             partial(run_powers, integrator=Integrator.REALTIME, exposed=True)),
        Case("lamps: 1e-12 to 1e12 W, realtime", "light above 1 kW", partial(
            run_extreme_powers, integrator=Integrator.REALTIME)),
    ]
    for integrator in BOTH:
        cases += [
            Case(f"lamps: odd sizes and angles, {integrator}", "no bad pixel", partial(
                run_odd_lamps, integrator=integrator)),
            Case(f"skies: NaN, inf, denormal, {integrator}", "energy within 10 % of a clean sky", partial(
                run_broken_skies, integrator=integrator)),
            Case(f"skies: suns of 1e4 to 1e6, {integrator}", "irradiance within 3 %", partial(
                run_sun_in_sky, integrator=integrator)),
            Case(f"halves: radiance of 6e4 to 1e30, {integrator}", "no bad pixel", partial(
                run_half_overflow, integrator=integrator)),
        ]
    return tuple(cases)


CASES = make_cases()
