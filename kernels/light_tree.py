# SPDX-License-Identifier: GPL-3.0-or-later
"""Choosing a light by the tree of engine/light_tree.py, and the probability of having chosen a given one."""

from __future__ import annotations

import warp as wp

from .geometry_math import safe_sqrt
from .sampling import BELOW_ONE, fraction
from .types import LightTree
from .wide_loads import load_vec4

# A light below this share of its sibling's importance is still chosen now and then: bounds are not the light.
LEAST_CHANCE = wp.constant(1.0e-4)
# Importance at grazing incidence over that at normal incidence.
LEAST_FACING = wp.constant(0.1)


@wp.struct
class ChosenLight:
    """A light and with which probability the tree chose it."""

    entry: int
    """-1: the tree is empty"""
    chance: float
    left: float
    """What the choice left of its number: uniform in [0, 1) again"""


@wp.func
def facing(low: wp.vec4, high: wp.vec4, position: wp.vec3, normal: wp.vec3) -> float:
    """Return the largest cosine at the receiver that a point in the ball around a node's bounds may have, not below 0.

    Conty Estevez and Kulla 2018, section 3.1; 1 where the normal is zero, which stands for a receiver on both sides.
    """
    if normal[0] == 0.0 and normal[1] == 0.0 and normal[2] == 0.0:
        return 1.0
    to_center = wp.vec3(low[0] + high[0], low[1] + high[1], low[2] + high[2]) * 0.5 - position
    half = wp.vec3(high[0] - low[0], high[1] - low[1], high[2] - low[2]) * 0.5
    d2 = wp.dot(to_center, to_center)
    r2 = wp.dot(half, half)
    if d2 <= r2:
        return 1.0
    # Distances along the normal, and up to where the ball's cone touches it.
    along = wp.dot(to_center, normal)
    reach = wp.sqrt(d2 - r2)
    if along >= reach:
        return 1.0
    # The angle to the centre less the ball's.
    return wp.clamp((along * reach + safe_sqrt((d2 - along * along) * r2)) / d2, 0.0, 1.0)


@wp.func
def node_importance(tree: LightTree, node: int, position: wp.vec3, normal: wp.vec3) -> float:
    """Return power over the squared distance to the node's bounds, or that to be expected to a light in them.

    It is weighed by the cosine at the receiver, of which a share is kept above the horizon: shading normals differ
    from `normal`, and shine does not fall with the cosine.
    """
    low = load_vec4(tree.low, node)
    high = load_vec4(tree.high, node)
    cosine = facing(low, high, position, normal)
    if cosine <= 0.0:
        return 0.0
    x = wp.max(wp.max(low[0] - position[0], position[0] - high[0]), 0.0)
    y = wp.max(wp.max(low[1] - position[1], position[1] - high[1]), 0.0)
    z = wp.max(wp.max(low[2] - position[2], position[2] - high[2]), 0.0)
    return (LEAST_FACING + (1.0 - LEAST_FACING) * cosine) * high[3] / wp.max(
        wp.max(x * x + y * y + z * z, low[3]), 1.0e-30)


@wp.func
def first_child_chance(tree: LightTree, child: int, position: wp.vec3, normal: wp.vec3) -> float:
    """Return the probability of taking `child` rather than its sibling child + 1."""
    first = node_importance(tree, child, position, normal)
    second = node_importance(tree, child + 1, position, normal)
    if second <= 0.0:
        return 1.0
    if first <= 0.0:
        return 0.0
    return wp.clamp(first / (first + second), LEAST_CHANCE, 1.0 - LEAST_CHANCE)


@wp.func
def choose_by_tree(tree: LightTree, position: wp.vec3, normal: wp.vec3, u: wp.vec2) -> ChosenLight:
    """Descend to a light; u in [0, 1)^2. Light from behind `normal` is lost; zero: none is.

    A float has bits for about 24 decisions and loses some at each; the second number refills it half-way.
    """
    chosen = ChosenLight()
    chosen.entry = -1
    chosen.chance = 1.0
    chosen.left = u[0]
    if tree.high[1][3] <= 0.0:
        return chosen
    node = int(1)
    random = float(u[0])
    for level in range(tree.levels):
        if level == 8:
            random = fraction(random + u[1])
        chance = first_child_chance(tree, 2 * node, position, normal)
        if random < chance:
            random = random / chance
            node = 2 * node
            chosen.chance = chosen.chance * chance
        else:
            random = (random - chance) / (1.0 - chance)
            node = 2 * node + 1
            chosen.chance = chosen.chance * (1.0 - chance)
        random = wp.min(random, BELOW_ONE)
    chosen.left = random
    chosen.entry = tree.entries[node - (1 << tree.levels)]
    return chosen


@wp.func
def chance_by_tree(tree: LightTree, entry: int, position: wp.vec3, normal: wp.vec3) -> float:
    """Return the probability with which choose_by_tree takes `entry`."""
    place = tree.places[entry]
    chance = float(1.0)
    node = int(1)
    for level in range(tree.levels):
        first = first_child_chance(tree, 2 * node, position, normal)
        bit = (place >> (tree.levels - 1 - level)) & 1
        chance = chance * wp.where(bit == 0, first, 1.0 - first)
        node = 2 * node + bit
    return chance
