# SPDX-License-Identifier: GPL-3.0-or-later
"""Choosing one of several light samples for the shadow ray, by what each would add. Functions only.

Resampled importance sampling (Talbot, Cline and Egbert 2005), with one random number for all of them.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import is_finite3


@wp.struct
class LightChoice:
    """One of several light samples, drawn by what they would add.

    The caller keeps the sample itself: it is large, and here all of it would be copied for each one that is considered.
    """

    keeps_last: int
    """1: the sample considered last is the one to keep, instead of any before"""
    light: wp.vec3
    """What the kept one would add"""
    target: float
    """The same as the number that draws"""
    total: float
    """Of all so far"""
    left: float
    """What is left of the random number"""


@wp.func
def choice_of_none(u: float) -> LightChoice:
    """Return a choice before the first sample; `u`: a random number in [0, 1)."""
    choice = LightChoice()
    choice.keeps_last = 0
    choice.light = wp.vec3(0.0, 0.0, 0.0)
    choice.target = 1.0
    choice.total = 0.0
    choice.left = u
    return choice


@wp.func
def consider(choice: LightChoice, light: wp.vec3, target: float) -> LightChoice:
    """Take what a light sample would add into a choice, unless it is not finite or the target not above 0."""
    out = choice
    out.keeps_last = 0
    if target > 0.0 and is_finite3(light):
        out.total = choice.total + target
        share = target / out.total
        # What is left of a number after each decision is uniform again.
        if choice.left < share:
            out.left = choice.left / share
            out.keeps_last = 1
            out.light = light
            out.target = target
        else:
            out.left = (choice.left - share) / (1.0 - share)
    return out


@wp.func
def chosen_light(choice: LightChoice, count: int) -> wp.vec3:
    """Return what the sample kept out of `count` adds for all of them."""
    return choice.light * (choice.total / (choice.target * float(count)))
