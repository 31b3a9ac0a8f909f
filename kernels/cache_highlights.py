# SPDX-License-Identifier: GPL-3.0-or-later
"""Highlights of lights on what the cache's rays hit: light that glossy surfaces send on as they reflect it.

Cells know no direction, so what lights a hit counts as matte there, all that it reflects. Here the strongest glossy
lobe of a hit takes its direct light for itself, as for what mirrors show (reflection_highlights.py): to the cell's
light comes what the hit's own light sample is worth to the lobe, less what it is worth as matte light. Light that the
sun sends along a facade goes down to the ground then, not to all sides. Where a sample is worth the same both ways
nothing is added: the cell's own direct light, which is a mean over places, stays beside its indirect light, and both
together keep what they had.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .geometry_math import max_component, mean_component, power_heuristic
from .lamp_sample import LightSample
from .packing import rgb
from .reflectance import BsdfAlbedo
from .reflection_highlights import (
    BEHIND_MAX,
    HIGHLIGHT_ALBEDO,
    HIGHLIGHT_DENSITY,
    highlight_lobe,
    lobe_albedo,
    lobe_density,
    make_highlight,
    pack_lobe,
    unpack_lobe,
)
from .types import VISIBLE_GLOSSY, ShadingPoint, Tables

# Part of all that a hit reflects from which its lobe is too much of it to do without a light in any frame.
GLOSSY_PART = wp.constant(0.25)
# Most that a highlight may bring, by the cell's direct light: lights that are seldom chosen would leave blotches.
BRIGHTEST_HIGHLIGHT = wp.constant(32.0)


@wp.func
def shows_highlights(vertices: Vertices) -> bool:
    """Return whether hits have lobes at all."""
    return vertices.lobe.shape[0] > 0


@wp.func
def store_lobe(vertices: Vertices, albedo: BsdfAlbedo, weight: wp.vec3, total: wp.vec3, behind: float, slot: int):
    """Store the lobe of a hit that reflects `total` of all light, `behind` of it from the other side.

    `weight`: what the ray brings of the hit's light.
    """
    if not shows_highlights(vertices):
        return
    word = wp.uint64(0)
    if behind < BEHIND_MAX:
        lobe = highlight_lobe(albedo, wp.vec3(0.0, 0.0, 0.0), 1.0)
        if mean_component(lobe.albedo) > HIGHLIGHT_ALBEDO * mean_component(total):
            lobe.albedo = wp.cw_mul(lobe.albedo, weight)
            word = pack_lobe(lobe)
    vertices.lobe[slot] = word


@wp.func
def is_glossy(vertices: Vertices, slot: int) -> bool:
    """Return whether a hit's lobe is much of what it reflects."""
    if not shows_highlights(vertices):
        return False
    lobe = max_component(lobe_albedo(vertices.lobe[slot]))
    return lobe > GLOSSY_PART * max_component(rgb(vertices.reflectance[slot]))


@wp.func
def highlight_excess(
    tables: Tables, word: wp.uint64, point: ShadingPoint, normal: wp.vec3, s: LightSample, kinds: int, matte: float,
) -> float:
    """Return what a light sample is worth to a hit's lobe beyond matte light, over the lobe's albedo, by the latter.

    Lamps without extent light the lobe; of other light it gets a share by the density of its samples: that of suns and
    bulbs nearly whole, that of skies and walls around hardly. What has no direction needs no lobe, and something may
    hide a part of it from the lobe alone, whose own light counts as matte then: white metal balls under a white sky
    were 1 % bright. The share knows no angles, as the lobe's value goes with them, and lobes are as wide as for lamps:
    with widths by the density of each sample they gave 1 to 2 % too much in boxes that emit.

    Args:
        tables: Albedos.
        word: From store_lobe; not 0.
        point: The hit.
        normal: Its shading normal.
        s: The sample.
        kinds: Lobes that the light lights (VISIBLE_*).
        matte: Density [1/sr] that turns its radiance into irradiance / pi, above 0.
    """
    if (kinds & VISIBLE_GLOSSY) == 0 or wp.dot(normal, s.wi) <= 0.0 or wp.dot(point.geometric_normal, s.wi) <= 0.0:
        return -1.0
    share = float(1.0)
    if s.delta == 0:
        share = power_heuristic(s.pdf, HIGHLIGHT_DENSITY)
    # A probe's ray stands for a wide part of what it sees: sharp lobes would leave sparks.
    value = lobe_density(tables, make_highlight(unpack_lobe(word), point, normal, 0.0), s.wi, s.pdf, 1)
    return share * (value / matte - 1.0)


@wp.func
def highlight_light(vertices: Vertices, slot: int, sampled: wp.vec3, counted: wp.vec3) -> wp.vec3:
    """Return the radiance that a hit's lobe adds to its matte light, or takes off.

    Args:
        vertices: Of the rays.
        slot: The ray's.
        sampled: The hit's own light sample, irradiance / pi.
        counted: Direct light that its matte reflection has, irradiance / pi.
    """
    if not shows_highlights(vertices):
        return wp.vec3(0.0, 0.0, 0.0)
    word = vertices.lobe[slot]
    if word == wp.uint64(0):
        return wp.vec3(0.0, 0.0, 0.0)
    light = sampled * vertices.highlight[slot]
    brightest = max_component(light)
    limit = BRIGHTEST_HIGHLIGHT * max_component(counted)
    if brightest > limit:
        light = light * (limit / brightest)
    return wp.cw_mul(lobe_albedo(word), light)
