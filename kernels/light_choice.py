# SPDX-License-Identifier: GPL-3.0-or-later
"""Choosing one of several light samples for the shadow ray, by what each would add. Functions only.

Resampled importance sampling (Talbot, Cline and Egbert 2005), with one random number for all of them.
"""

from __future__ import annotations

import warp as wp

from .lamp_sample import LightSample


@wp.struct
class LightChoice:
    """One of several light samples, drawn by what they would add."""

    kept: LightSample
    """`kind` below 0: none yet"""
    light: wp.vec3
    """What it would add"""
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
    choice.kept.kind = -1
    choice.light = wp.vec3(0.0, 0.0, 0.0)
    choice.target = 1.0
    choice.total = 0.0
    choice.left = u
    return choice


@wp.func
def consider(choice: LightChoice, s: LightSample, light: wp.vec3, target: float) -> LightChoice:
    """Take a light sample that would add something into a choice."""
    out = choice
    out.total = choice.total + target
    share = target / out.total
    # What is left of a number after each decision is uniform again.
    if choice.left < share:
        out.left = choice.left / share
        out.kept = s
        out.light = light
        out.target = target
    else:
        out.left = (choice.left - share) / (1.0 - share)
    return out


@wp.func
def chosen_light(choice: LightChoice, count: int) -> wp.vec3:
    """Return what the sample kept out of `count` adds for all of them."""
    return choice.light * (choice.total / (choice.target * float(count)))
