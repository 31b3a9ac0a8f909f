# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the alias tables."""

import numpy as np
import pytest
from burnish.engine.alias_table import build_alias_table


def drawn(probability, alias):
    """Return the exact probability of each index under a table."""
    share = probability.astype(np.float64).copy()
    np.add.at(share, alias, 1.0 - probability.astype(np.float64))
    return share / len(probability)


@pytest.mark.parametrize("weights", [
    [1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 5.0], [1e-9, 1.0, 1e9], [3.0, 0.0, 0.5, 0.5, 0.0, 8.0, 1.0],
], ids=str)
def test_table_draws_its_weights(weights):
    """Draw each index with its weight's share."""
    weights = np.array(weights)
    np.testing.assert_allclose(drawn(*build_alias_table(weights)), weights / weights.sum(), atol=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_random_tables(seed):
    """Draw random weights over many orders of magnitude exactly."""
    generator = np.random.default_rng(seed)
    weights = generator.exponential(size=generator.integers(1, 3000)) ** 4
    weights[generator.random(len(weights)) < 0.3] = 0
    if weights.sum() == 0:
        weights[0] = 1
    np.testing.assert_allclose(drawn(*build_alias_table(weights)), weights / weights.sum(), atol=2e-7)


def test_all_zero_is_uniform():
    """Fall back to a uniform choice where nothing weighs anything."""
    np.testing.assert_allclose(drawn(*build_alias_table(np.zeros(5))), 0.2, atol=1e-7)
