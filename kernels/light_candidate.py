# SPDX-License-Identifier: GPL-3.0-or-later
"""Light samples as the random numbers that make them, so that another pixel or frame can take them over.

A candidate is a light and a point of the unit square; `replay` turns it into a direction at any receiver. Resampling
is done over these numbers (primary-sample space): the integrand is f(wi) L / pdf(u), the measure is du for each
light, and a candidate that moves to another receiver keeps its measure, so no Jacobian appears (the random replay of
Lin et al. 2022, "Generalized Resampled Importance Sampling", section 7.2, for paths of one segment).
"""

from __future__ import annotations

import warp as wp

from .direct_emitters import EMITTER_WORDS, sample_baked
from .environment_split import EnvironmentSplit
from .environment_table import equirect_direction
from .geometry_math import PI, TWO_PI, safe_sqrt
from .lamp_hit import FAR
from .lamp_sample import LightSample, no_light
from .lamp_tables import draw_lamp
from .light_tree import choose_by_tree
from .sampling import BELOW_ONE
from .types import LIGHT_ENVIRONMENT, Environment, Lights, Scene

# Candidate.light: the kind in its two highest bits, an index below.
CANDIDATE_NONE = wp.constant(0)
CANDIDATE_LAMP = wp.constant(1)
CANDIDATE_EMITTER = wp.constant(2)
CANDIDATE_WORLD = wp.constant(3)
"""Index: the texel of the excess table"""

INDEX_BITS = wp.constant(wp.uint32((1 << 30) - 1))


@wp.struct
class Candidate:
    """A light and where on it, 8 bytes; all zero is none."""

    light: wp.uint32
    """CANDIDATE_* << 30 | index"""
    u: wp.uint32
    """16 bits each of two numbers in (0, 1)"""


@wp.struct
class LightClasses:
    """What there is to choose from: 1 or 0 for local lights, suns and the world's excess."""

    local: float
    sun: float
    world: float
    sun_share: float
    """Sum of the suns' chances in the scene's light table"""


@wp.struct
class Choice:
    """A candidate and how it came about."""

    candidate: Candidate
    chance: float
    """Probability of the light (of the texel); the place on it is uniform. 0: nothing was found"""


@wp.func
def make_candidate(kind: int, index: int, u: wp.vec2) -> Candidate:
    """Pack a candidate."""
    c = Candidate()
    c.light = (wp.uint32(kind) << wp.uint32(30)) | wp.uint32(index)
    # The middle of one of 65536 steps, so that the numbers read back are uniform and never 0 or 1.
    x = wp.uint32(wp.min(u[0] * 65536.0, 65535.0))
    y = wp.uint32(wp.min(u[1] * 65536.0, 65535.0))
    c.u = x | (y << wp.uint32(16))
    return c


@wp.func
def candidate_kind(c: Candidate) -> int:
    """Return CANDIDATE_*."""
    return int(c.light >> wp.uint32(30))


@wp.func
def candidate_index(c: Candidate) -> int:
    """Return the lamp, emissive triangle or texel."""
    return int(c.light & INDEX_BITS)


@wp.func
def candidate_place(c: Candidate) -> wp.vec2:
    """Return the numbers that place the sample on its light."""
    x = float(c.u & wp.uint32(65535)) + 0.5
    y = float(c.u >> wp.uint32(16)) + 0.5
    return wp.vec2(x, y) * 1.52587890625e-5


@wp.func
def sun_share(lights: Lights) -> float:
    """Return the sum of the suns' chances in the scene's light table; 0 where there are none."""
    if lights.class_count == 0 or lights.lamp_count == lights.local_lamp_count:
        return 0.0
    share = 1.0 - lights.weight[0]
    if lights.environment_class >= 0:
        share = share - lights.weight[lights.environment_class]
    # Weights are rounded: what is left over from them is no sun.
    return wp.where(share > 1.0e-4, share, 0.0)


@wp.func
def choose_sun(lights: Lights, share: float, u: wp.vec2, random: float) -> Choice:
    """Draw one of the suns by their chances; a scene has one or two."""
    left = random * share
    count = lights.lamp_count - lights.local_lamp_count
    sun = int(0)
    while sun < count - 1 and left >= lights.weight[1 + sun]:
        left = left - lights.weight[1 + sun]
        sun = sun + 1
    choice = Choice()
    choice.candidate = make_candidate(CANDIDATE_LAMP, lights.local_lamp_count + sun, u)
    choice.chance = lights.weight[1 + sun] / share
    return choice


@wp.func
def choose_local(lights: Lights, position: wp.vec3, place: wp.vec2, u: wp.vec2) -> Choice:
    """Draw a local lamp or an emissive triangle by the tree."""
    choice = Choice()
    choice.chance = 0.0
    local = choose_by_tree(lights.tree, position, wp.vec3(0.0, 0.0, 0.0), place)
    if local.entry >= 0:
        kind = wp.where(local.entry < lights.local_lamp_count, CANDIDATE_LAMP, CANDIDATE_EMITTER)
        index = wp.where(local.entry < lights.local_lamp_count, local.entry, local.entry - lights.local_lamp_count)
        choice.candidate = make_candidate(kind, index, u)
        choice.chance = local.chance
    return choice


@wp.func
def choose_texel(table: Environment, place: wp.vec2, u: wp.vec2) -> Choice:
    """Draw a texel of the excess table (as sample_environment does)."""
    count = table.width * table.height
    texel = wp.min(int(place[0] * float(count)), count - 1)
    if place[1] >= table.probability[texel]:
        texel = table.alias[texel]
    choice = Choice()
    choice.candidate = make_candidate(CANDIDATE_WORLD, texel, u)
    choice.chance = table.weight[texel]
    return choice


@wp.func
def light_classes(lights: Lights, split: EnvironmentSplit) -> LightClasses:
    """Return what can be chosen; the same for every candidate of a pixel."""
    classes = LightClasses()
    classes.sun_share = sun_share(lights)
    classes.local = 0.0
    if lights.class_count > 0:
        classes.local = wp.where(lights.weight[0] > 0.0, 1.0, 0.0)
    classes.sun = wp.where(classes.sun_share > 0.0, 1.0, 0.0)
    classes.world = wp.where(split.share > 0.0, 1.0, 0.0)
    return classes


@wp.func
def choose(
    scene: Scene, split: EnvironmentSplit, classes: LightClasses, position: wp.vec3, which: wp.vec2, u: wp.vec2,
) -> Choice:
    """Draw a candidate for a receiver: equal chances for local lights, suns and the world's excess, as far as any.

    Args:
        scene: The scene.
        split: How the world is split.
        classes: From light_classes.
        position: Of the receiver.
        which: x: the class, and what is left of it the light; y: more of the same for trees and tables.
        u: Where on the light.
    """
    choice = Choice()
    choice.chance = 0.0
    total = classes.local + classes.sun + classes.world
    if total == 0.0:
        return choice
    drawn = which[0] * total
    if drawn < classes.local:
        choice = choose_local(scene.lights, position, wp.vec2(wp.min(drawn, BELOW_ONE), which[1]), u)
    elif drawn < classes.local + classes.sun:
        choice = choose_sun(scene.lights, classes.sun_share, u, wp.min(drawn - classes.local, BELOW_ONE))
    else:
        drawn = wp.min(drawn - classes.local - classes.sun, BELOW_ONE)
        choice = choose_texel(split.table, wp.vec2(drawn, which[1]), u)
    choice.chance = choice.chance / total
    return choice


@wp.func
def replay_texel(split: EnvironmentSplit, visibility: int, texel: int, u: wp.vec2) -> LightSample:
    """Return the sample of the world's excess at a place in the part of a texel that holds it."""
    width = split.table.width
    height = split.table.height
    s = LightSample()
    s.kind = LIGHT_ENVIRONMENT
    box = split.box[texel]
    scale = 1.0 / float(split.points)
    left = float(box & wp.uint32(255)) * scale
    across = float((box >> wp.uint32(8)) & wp.uint32(255)) * scale
    top = float((box >> wp.uint32(16)) & wp.uint32(255)) * scale
    down = float(box >> wp.uint32(24)) * scale
    x = (float(texel % width) + left + u[0] * across) / float(width)
    y = (float(texel // width) + top + u[1] * down) / float(height)
    s.wi = equirect_direction(x, y)
    s.normal = -s.wi
    s.distance = FAR
    s.shadow = 1
    s.visibility = visibility
    sin_theta = wp.max(safe_sqrt(1.0 - s.wi[2] * s.wi[2]), 1.0e-6)
    s.pdf = float(width * height) / (TWO_PI * PI * sin_theta * wp.max(across * down, 1.0e-6))
    s.radiance = split.excess[texel]
    return s


@wp.func
def replay(
    scene: Scene, split: EnvironmentSplit, emitters: wp.array[wp.uint64], position: wp.vec3, c: Candidate,
) -> LightSample:
    """Return what a candidate is for a receiver; kind -1 where it is nothing.

    `pdf` [1/sr] is that of the place alone, without the choice of the light. `radiance` is exact for lamps and
    constant emission, that of the world a mean over a part of a texel; of textured emission it is an estimate, which
    the ray's factor divides out again.

    Args:
        scene: The scene.
        split: How the world is split.
        emitters: From bake_emitters.
        position: Of the receiver.
        c: The candidate.
    """
    kind = candidate_kind(c)
    index = candidate_index(c)
    u = candidate_place(c)
    s = no_light()
    # Indices are checked: a candidate may stem from before an edit.
    if kind == CANDIDATE_LAMP and index < scene.lights.lamp_count:
        s = draw_lamp(scene.lights, index, position, u)
    if kind == CANDIDATE_EMITTER and index * EMITTER_WORDS < emitters.shape[0]:
        s = sample_baked(emitters, index, position, u)
    if kind == CANDIDATE_WORLD and index < split.table.width * split.table.height:
        s = replay_texel(split, scene.environment.visibility, index, u)
    if not (s.pdf > 0.0):
        s.kind = -1
    return s
