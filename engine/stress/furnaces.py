# SPDX-License-Identifier: GPL-3.0-or-later
"""White furnaces: closed boxes that emit and reflect, and white balls under a white sky, of every kind of surface.

A closed box of emission e whose walls return the share rho of all light has radiance e / (1 - rho) everywhere, at any
scale. The walls are white surfaces of some weight: the colour of a metal or a plastic alone would not set the share,
since light that grazes them is reflected whatever their colour. The share is that weight for metals; layers of plastic
keep a little more or less of it (kernels/white_share.py), as Cycles' do.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from functools import partial

import numpy as np
import warp as wp

from ...kernels.node_lean import LeanClosure
from ...kernels.white_share import measure_white_shares
from ..device import launch
from ..materials import PRINCIPLED_DEFAULTS
from ..settings import Integrator
from ..tables import albedo_tables
from .cases import BOTH, Case, Trial, luminance
from .scenes import (
    EYE,
    Placed,
    StressScene,
    balls_in_sky,
    box,
    look_at,
    make_scene,
    principled,
    scaled_and_moved,
)

__all__ = ["CASES"]

ROUGHNESSES = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0)
ALBEDOS = {0.0: 0.01, 0.5: 0.01, 0.8: 0.01, 0.9: 0.01, 0.95: 0.02}
"""Shares of light that walls return, with what the radiance may be off"""
FLAT_TOLERANCE = 0.01
GLASS_TOLERANCE = 0.03
"""Less than Cycles keeps, or more than there is"""
GLASS_BOUNCES = 64
"""From which on roulette may end paths: light leaves glass of a high IOR after many reflections inside, and ended early
it is all sparks"""
IN_CYCLES = {
    1.0: (1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
    1.33: (1.0, 1.0, 0.9998, 0.9936, 0.9877, 0.9906),
    1.5: (1.0, 1.0, 0.9995, 0.9902, 0.9793, 0.9807),
    2.4: (1.0, 0.9988, 0.9985, 0.9852, 0.9489, 0.9334),
}
"""Share of a white sky's light that balls of white glass keep in Cycles 5.2, by IOR for ROUGHNESSES: 1024 samples, 512
bounces"""
SCALES = (1e-3, 1.0, 1e3)
VIEWS = 1024
"""Of a surface, for its share of the light"""
EMISSION = 0.5

BOX_SIZE = {Integrator.REFERENCE: (32, 24), Integrator.REALTIME: (48, 36)}
BALLS_SIZE = (144, 24)

PATHS = {"quick": {0.0: 8, 0.5: 48, 0.8: 96, 0.9: 192, 0.95: 192},
         "full": {0.0: 64, 0.5: 512, 0.8: 1024, 0.9: 2048, 0.95: 4096}}
"""Samples a pixel by albedo: how long paths are, and how uneven, goes with 1 / (1 - albedo)"""
FRAMES = {"quick": {0.0: 16, 0.5: 48, 0.8: 128, 0.9: 256, 0.95: 384},
          "full": {0.0: 64, 0.5: 128, 0.8: 256, 0.9: 384, 0.95: 768}}


def closed_box(albedo: float, size: tuple[int, int], **arguments: float) -> StressScene:
    """Return a cube of side 2 m that emits EMISSION inwards and returns a share of all light, seen from inside."""
    wall = principled(albedo, EMISSION, color=1.0, **arguments)
    camera = look_at((0.3, -0.8, 0.2), (-0.2, 1.0, -0.3), size, 1.4)
    return make_scene({"box": box((-1, -1, -1), (1, 1, 1), inward=True)}, [Placed("box", "wall", EYE)],
                      {"wall": wall}, camera)


def surfaces(trial: Trial) -> Sequence[dict[str, float]]:
    """Return arguments of walls: roughness x metallic x IOR."""
    if trial.quick:
        return ({"roughness": 0.25, "metallic": 1.0}, {"roughness": 0.75, "metallic": 1.0},
                {"roughness": 1.0, "metallic": 0.0})
    opaque = itertools.product(ROUGHNESSES, (0.0,), (1.0, 1.5, 3.0))
    metals = itertools.product(ROUGHNESSES, (1.0,), (1.5,))
    return [{"roughness": r, "metallic": m, "ior": i} for r, m, i in (*opaque, *metals)]


@functools.cache
def white_share(roughness: float, metallic: float, ior: float = PRINCIPLED_DEFAULTS["ior"]) -> float:
    """Return the share of all light that a white Principled surface of weight 1 returns."""
    closure = LeanClosure()
    closure.weight, closure.color, closure.normal = 1.0, wp.vec3(1.0, 1.0, 1.0), wp.vec3(0.0, 0.0, 1.0)
    closure.roughness, closure.metallic, closure.ior = roughness, metallic, ior
    closure.specular_level, closure.specular_tint, closure.multiscatter = 0.5, wp.vec3(1.0, 1.0, 1.0), 1
    shares = wp.zeros(VIEWS, dtype=float, device="cpu")
    launch(measure_white_shares, VIEWS, [0, albedo_tables("cpu"), closure, VIEWS], [shares], "cpu")
    return float(shares.numpy().mean(dtype=np.float64))


def run_box(trial: Trial, albedo: float, integrator: Integrator) -> None:
    """Find e / (1 - albedo) in closed boxes of every surface, each at one of the scales."""
    tolerance = ALBEDOS[albedo]
    amounts = PATHS if integrator == Integrator.REFERENCE else FRAMES
    amount = amounts["quick" if trial.quick else "full"][albedo]
    size = BOX_SIZE[integrator]
    for number, arguments in enumerate(surfaces(trial)):
        scale = SCALES[number % len(SCALES)]
        scene = scaled_and_moved(closed_box(albedo, size, **arguments), scale)
        picture = trial.render(scene, integrator, amount, size)
        expected = EMISSION / (1.0 - albedo * white_share(**arguments))
        name = " ".join(f"{key} {value:g}" for key, value in {**arguments, "scale": scale}.items())
        trial.check_energy(name, luminance(picture).mean() / expected, tolerance)


def run_balls(trial: Trial, integrator: Integrator, glass: bool) -> None:
    """Find the sky's radiance on white balls of every roughness, metallic and IOR: they can't be told from it."""
    metals = ((0.0, 1.5),) if glass else ((0.0, 1.5), (1.0, 1.5), (0.0, 1.0), (0.0, 3.0), (0.5, 1.33))
    metals = trial.choose(metals[:1], metals)
    iors = ((1.5,) if trial.quick else (1.0, 1.33, 1.5, 2.4)) if glass else (None,)
    # A path that stays long in a ball of slightly rough glass can weigh as much as 300 samples.
    amount = trial.choose(128 if glass else 32, 1024) if integrator == Integrator.REFERENCE else trial.choose(32, 128)
    tolerance = GLASS_TOLERANCE if glass else FLAT_TOLERANCE
    paths = {"light_paths": {"roulette_start": GLASS_BOUNCES}} if glass else {}
    mask = ball_masks(len(ROUGHNESSES), BALLS_SIZE)
    for (metallic, ior), glass_ior in itertools.product(metals, iors):
        arguments = {"metallic": metallic, "ior": glass_ior or ior, "transmission": float(glass)}
        materials = [principled(color=1.0, roughness=roughness, **arguments) for roughness in ROUGHNESSES]
        light = luminance(trial.render(balls_in_sky(materials, BALLS_SIZE), integrator, amount, BALLS_SIZE, **paths))
        shares = IN_CYCLES[arguments["ior"]] if glass else np.ones(len(ROUGHNESSES))
        for roughness, inside, share in zip(ROUGHNESSES, mask, shares, strict=True):
            name = f"roughness {roughness:g} metallic {metallic:g} IOR {arguments['ior']:g}"
            kept = light[inside].mean()
            # To lose less light than Cycles is no fault, to make some is.
            trial.check_energy(name, kept / np.clip(kept, share, 1.0), tolerance)


def ball_masks(count: int, size: tuple[int, int]) -> list[np.ndarray]:
    """Return which pixels show nothing but a ball, one mask [h, w] for each ball of balls_in_sky."""
    x = ((np.arange(size[0]) + 0.5) / size[0] - 0.5) * count
    y = ((np.arange(size[1]) + 0.5) / size[1] - 0.5) * count * size[1] / size[0]
    places = np.arange(count) - 0.5 * (count - 1)
    radius = 0.45 - 1.5 * count / size[0]
    return [np.hypot(x[None, :] - place, y[:, None]) < radius for place in places]


def make_cases() -> tuple[Case, ...]:
    """Return all furnaces."""
    cases = []
    for integrator in BOTH:
        for albedo, tolerance in ALBEDOS.items():
            cases.append(Case(
                f"furnace: closed box, albedo {albedo:g}, {integrator}", f"energy within {tolerance:.0%}",
                partial(run_box, albedo=albedo, integrator=integrator), quick=albedo == 0.5))
        cases.append(Case(f"furnace: white balls, {integrator}", f"energy within {FLAT_TOLERANCE:.0%}",
                          partial(run_balls, integrator=integrator, glass=False)))
        cases.append(Case(f"furnace: glass balls, {integrator}",
                          f"energy within {GLASS_TOLERANCE:.0%} of what Cycles keeps, or up to all of it",
                          partial(run_balls, integrator=integrator, glass=True)))
    return tuple(cases)


CASES = make_cases()
