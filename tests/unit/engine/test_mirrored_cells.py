# SPDX-License-Identifier: GPL-3.0-or-later
"""What mirrors show of surfaces that no probe looks at closely: cells of few samples, steadied by wider ones."""

from __future__ import annotations

import numpy as np

from tests import scenes
from tests.glossy_scenes import metal, panel
from tests.light_scenes import look_at, slab
from tests.unit.engine.test_reflections import SIZE, Samples


def bulb_room():
    """Make a white room with a mirror on a wall and three small bright bulbs above it."""
    meshes = {"room": scenes.box(2.0, inward=True), "mirror": slab((-1.2, 1.97, -0.8), (1.2, 1.99, 0.6))}
    meshes |= {f"bulb {x}": slab((x - 0.06, 1.88, 0.74), (x + 0.06, 1.96, 0.86)) for x in (-1, 0, 1)}
    materials = {"room": scenes.material(color=0.8), "mirror": metal(0.0), "bulb": panel((1.0, 0.85, 0.6), 40.0)}
    return scenes.delta(meshes, [(name, np.eye(4), name.split()[0]) for name in meshes], materials)


def test_walls_in_mirrors_have_no_sparks():
    """Show an even wall as such after some frames: single cells have met the bright wall about the bulbs, or not.

    Which ones is chance: so in the mean of four views, and of ten frames of each.
    """
    spread, brightest = [], []
    for x in (0.76, 0.79, 0.82, 0.85):
        samples = Samples(bulb_room(), look_at((x, -1.6, 0.0), (0.0, 1.98, -0.1), SIZE, 0.45))
        for frame in range(12):
            samples.frame()
            if frame < 2:
                continue
            light = samples.radiance()[0][samples.albedo("specular").mean(-1) > 0.5].mean(-1)
            assert light.size > 400 and light.mean() > 0.08
            spread.append(light.std() / light.mean())
            brightest.append(light.max() / light.mean())
    # 1.9 and 25 by the cells alone.
    assert np.mean(spread) < 1.6 and np.mean(brightest) < 19.0
