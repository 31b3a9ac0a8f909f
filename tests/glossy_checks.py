# SPDX-License-Identifier: GPL-3.0-or-later
"""What reflections are held to in white furnaces: the light of Reference for every roughness, metal, coat and glass.

tests/performance/leaks.py prints all figures, tests/unit/engine/test_reflection_furnace.py asserts the quick ones.
"""

import numpy as np

from tests import glossy_scenes as made
from tests.light_checks import Figure, eroded, luminance

ROUGHNESSES = made.ROUGHNESSES


def materials(kind):
    """Return a row of white materials of a kind, one for each roughness."""
    coat = {"coat": 1.0, "coat_roughness": 0.05}
    white = {
        "plastic": lambda r: made.glossy(color=1.0, roughness=r),
        "metal": lambda r: made.glossy(color=1.0, roughness=r, metallic=1.0),
        "coated plastic": lambda r: made.glossy(color=1.0, roughness=r, **coat),
        "coated metal": lambda r: made.glossy(color=1.0, roughness=r, metallic=1.0, **coat),
        "half metal": lambda r: made.glossy(color=1.0, roughness=r, metallic=0.5),
        "glass": lambda r: made.glass(r),
    }
    return [white[kind](roughness) for roughness in ROUGHNESSES]


def white_balls(setup, kinds, frames):
    """Find the light of Reference on rows of white balls, one row for each kind, in a white world.

    Balls see each other, and all of them are nearly as bright as the world. Rough glass keeps 98 % of the light in
    Reference (see albedo_tables.glass_sample), here all of it. Coats of medium roughness lose 1 % over metal.
    """
    tolerance = 0.03 if "glass" in kinds else 0.015 if "coated metal" in kinds else 0.01
    scene = made.white_balls(setup.size, [materials(kind) for kind in kinds])
    picture, truth, positions = setup.picture(scene, frames), setup.truth(scene), setup.positions(scene)
    figures = [bad_pixels(f"white balls, {frames} frames", picture)]
    for j, kind in enumerate(kinds):
        for i, roughness in enumerate(ROUGHNESSES):
            mask = eroded(made.ball_mask(positions, i, j, len(ROUGHNESSES), len(kinds)), 1)
            ratio = luminance(picture)[mask].mean() / luminance(truth)[mask].mean()
            figures.append(Figure(f"white {kind}, roughness {roughness:g}, {frames} frames", ratio, 1 - tolerance,
                                  1 + tolerance))
    return figures, {f"{', '.join(kinds)}: half its light": 0.5 * picture, "Reference": 0.5 * truth}


def glossy_box(setup, frames, tolerance=0.01, color=0.5, **arguments):
    """Find the light of Reference in a closed box that emits and reflects: every ray and every cell takes part."""
    scene = made.glossy_box(setup.size, color=color, **arguments)
    picture, truth = setup.picture(scene, frames), setup.truth(scene)
    what = "box of " + " ".join(f"{name} {value:g}" for name, value in arguments.items()) + f", {frames} frames"
    return [bad_pixels(what, picture),
            Figure(what, luminance(picture).mean() / luminance(truth).mean(), 1 - tolerance, 1 + tolerance)], {
                what: picture, f"{what}: Reference": truth}


def bad_pixels(what, picture):
    """Return the number of pixels that are not finite or negative."""
    return Figure(f"{what}: bad pixels", float((~np.isfinite(picture) | (picture < 0.0)).sum()), 0.0, 0.0)
