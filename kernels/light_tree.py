# SPDX-License-Identifier: GPL-3.0-or-later
"""Choosing a light by the tree of engine/light_tree.py, and the probability of having chosen a given one."""

from __future__ import annotations

import warp as wp

from .types import LightTree

# A light below this share of its sibling's importance is still chosen now and then: bounds are not the light.
LEAST_CHANCE = wp.constant(1.0e-4)


@wp.struct
class ChosenLight:
    """A light and with which probability the tree chose it."""

    entry: int
    """-1: the tree is empty"""
    chance: float


@wp.func
def node_importance(tree: LightTree, node: int, position: wp.vec3) -> float:
    """Return power over the squared distance to the node's bounds, or that to be expected to a light in them."""
    low = tree.low[node]
    high = tree.high[node]
    x = wp.max(wp.max(low[0] - position[0], position[0] - high[0]), 0.0)
    y = wp.max(wp.max(low[1] - position[1], position[1] - high[1]), 0.0)
    z = wp.max(wp.max(low[2] - position[2], position[2] - high[2]), 0.0)
    return high[3] / wp.max(wp.max(x * x + y * y + z * z, low[3]), 1.0e-30)


@wp.func
def first_child_chance(tree: LightTree, child: int, position: wp.vec3) -> float:
    """Return the probability of taking `child` rather than its sibling child + 1."""
    first = node_importance(tree, child, position)
    second = node_importance(tree, child + 1, position)
    if second <= 0.0:
        return 1.0
    if first <= 0.0:
        return 0.0
    return wp.clamp(first / (first + second), LEAST_CHANCE, 1.0 - LEAST_CHANCE)


@wp.func
def choose_by_tree(tree: LightTree, position: wp.vec3, u: wp.vec2) -> ChosenLight:
    """Descend to a light; u in [0, 1)^2.

    A float has bits for about 24 decisions and loses some at each; the second number refills it half-way.
    """
    chosen = ChosenLight()
    chosen.entry = -1
    chosen.chance = 1.0
    if tree.high[1][3] <= 0.0:
        return chosen
    node = int(1)
    random = float(u[0])
    for level in range(tree.levels):
        if level == 8:
            random = wp.min(wp.abs(random + u[1]) - wp.floor(random + u[1]), 0.9999999)
        chance = first_child_chance(tree, 2 * node, position)
        if random < chance:
            random = random / chance
            node = 2 * node
            chosen.chance = chosen.chance * chance
        else:
            random = (random - chance) / (1.0 - chance)
            node = 2 * node + 1
            chosen.chance = chosen.chance * (1.0 - chance)
        random = wp.min(random, 0.9999999)
    chosen.entry = tree.entries[node - (1 << tree.levels)]
    return chosen


@wp.func
def chance_by_tree(tree: LightTree, entry: int, position: wp.vec3) -> float:
    """Return the probability with which choose_by_tree takes `entry`."""
    place = tree.places[entry]
    chance = float(1.0)
    node = int(1)
    for level in range(tree.levels):
        first = first_child_chance(tree, 2 * node, position)
        bit = (place >> (tree.levels - 1 - level)) & 1
        chance = chance * wp.where(bit == 0, first, 1.0 - first)
        node = 2 * node + bit
    return chance
