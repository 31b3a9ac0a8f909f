# SPDX-License-Identifier: GPL-3.0-or-later
"""Highlights seen from aside, where reflectance is that of a facet between view and light, not that of the surface."""

from __future__ import annotations

import numpy as np
import pytest

from tests import scenes
from tests.light_checks import Setup, luminance
from tests.light_scenes import LitScene, look_at
from tests.unit.engine.test_mirrored_highlights import SHARED, towards

SIZE = (48, 30)


def floor_under_the_sun(slope, **closure):
    """Make a floor that reflects at its surface alone, under a sun and seen from 65 degrees beside its reflection."""
    floor = scenes.material("PRINCIPLED", color=0.0, **SHARED, **closure)
    sun = scenes.lamp("SUN", 3.0, towards((0.0, 0.0, 0.0), (0.0, -slope, -1.0)), angle=0.02)
    delta = scenes.delta({"floor": scenes.quad(8.0)}, [("floor", np.eye(4), "floor")], {"floor": floor}, [sun])
    return LitScene(delta, look_at((2.7 * slope, -1.3 * slope, 3.0), (0.0, 0.0, 0.0), SIZE, 0.5))


@pytest.mark.parametrize("slope", [pytest.param(1.0, marks=pytest.mark.slow), 1.7, 2.7])
@pytest.mark.parametrize("roughness", [0.3, pytest.param(0.6, marks=pytest.mark.slow), 0.8])
def test_dielectrics_are_as_bright_from_aside(slope, roughness):
    """Match the path tracer within 2 %: 0.85 to 1.07 by Schlick's curve, whose albedo was right."""
    scene, setup = floor_under_the_sun(slope, roughness=roughness), Setup(SIZE, truth_samples=96)
    ratio = luminance(setup.picture(scene, 8)).mean() / luminance(setup.truth(scene)).mean()
    assert ratio == pytest.approx(1.0, abs=0.02)
