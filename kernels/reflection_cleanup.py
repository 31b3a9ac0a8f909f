# SPDX-License-Identifier: GPL-3.0-or-later
"""Clean-up of reflection samples: sparks and missing samples are replaced by their neighbours (Eto et al. 2023).

The rank test (after Mara et al. 2017) is one that fires: a sample is a spark where fewer than a tenth of its neighbours
come near it. A replaced spark alone would darken, most where light comes in rare bright samples; what it had is spread
over its neighbours, so that a flash becomes a faint glow of the same energy. Soon at rest ever less is spread, so that
what is sharp and bright in a reflection, thin lamps above all, becomes no wider than it is. What a mirror shows of
lamps and shining surfaces is no chance, and never a spark.
"""

from __future__ import annotations

import warp as wp

from .filter_weights import squared_cosine
from .gbuffer import GBuffer
from .packed_halves import pack_halves, unpack_halves
from .packing import rgb, rgba
from .reflection_blocks import (
    JITTER_MAX,
    JITTER_SHIFT,
    MARK_MISSING,
    MARK_SPARK,
    MARK_STEADY,
    FilterCentre,
    FilterTap,
    ReflectionBlocks,
    ReflectionLight,
    block_centre,
    block_depth,
    filter_tap,
    in_grid,
    light_strength,
    pack_state,
    row_reach,
    state_lobe,
    unpack_state,
)
from .reflection_types import SAMPLE_FAR, ReflectionOptions
from .view import SKY_DEPTH, View
from .wide_loads import load_view

# Fast: weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# A neighbour comes near a sample if it has this share of its light; sparks are those that fewer neighbours come near
# than the second (so that a spark is at least four times their ninth decile).
NEAR_SHARE = wp.constant(0.25)
NEAR_NEIGHBORS = wp.constant(0.1)
# Blocks that neighbours are at most away: a diamond of 12.
REACH = wp.constant(2)
# Neighbours of the same surface without which there is nothing to compare with.
NEIGHBORS_MINIMUM = wp.constant(8.0)
# Frames at rest in which ever less of a spark is spread, and after which nothing is.
SPARK_START = wp.constant(8.0)
SPARK_END = wp.constant(12.0)
# What reflects alike: squared cosine of the normals, ratio of the roughnesses.
LIKE_COSINE2 = wp.constant(0.9)
LIKE_ROUGHNESS = wp.constant(0.6)
# Unevenness of the roughness that is no more than rounding.
EVEN = wp.constant(0.02)


@wp.func
def like_weight(centre: FilterCentre, tap: FilterTap) -> float:
    """Return 1 where a block's surface reflects like the centre's, else 0."""
    rough = wp.max(centre.roughness, tap.roughness) + 0.02
    smooth = wp.min(centre.roughness, tap.roughness) + 0.02
    if squared_cosine(centre.normal, tap.normal) < LIKE_COSINE2 or smooth < LIKE_ROUGHNESS * rough:
        return 0.0
    return 1.0


@wp.func
def spread_share(view: View) -> float:
    """Return how much of what a spark has over its neighbours is spread: all in motion, soon nothing at rest."""
    return wp.clamp((SPARK_END - float(wp.min(view.rest, view.light_age))) / (SPARK_END - SPARK_START), 0.0, 1.0)


@wp.func
def uneven_roughness(moments: wp.vec3) -> int:
    """Return how uneven the roughness is, 0..JITTER_MAX, from its sum, that of its square, and the number."""
    mean = moments[0] / moments[2]
    deviation = wp.sqrt(wp.max(moments[1] / moments[2] - mean * mean, 0.0))
    return int(wp.clamp(4.0 * deviation / wp.max(mean, 1.0e-3) - EVEN, 0.0, 1.0) * JITTER_MAX)


@wp.func
def spread_weight(centre: FilterCentre, tap: FilterTap, i: int, j: int) -> float:
    """Return the weight of a block (i, j) blocks away for what is mixed from neighbours."""
    return tap.near * like_weight(centre, tap) * wp.exp(-float(i * i + j * j) / 9.0)


@wp.func
def store_mark(
    mark: int, light: wp.vec4, state: wp.uint64, excess: wp.vec3, block: int, mark_out: wp.array[wp.uint8],
    lights_out: ReflectionLight, excess_out: wp.array[wp.uint64],
):
    """Write what mark_samples finds."""
    mark_out[block] = wp.uint8(mark)
    lights_out.light[block] = pack_halves(light)
    # The root mean square stays the spark's: spread light is as noisy.
    lights_out.state[block] = state
    if (mark & MARK_SPARK) != 0:
        excess_out[block] = pack_halves(rgba(excess, 0.0))


@wp.kernel(cuda_max_registers=80)
def mark_samples(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    options: ReflectionOptions,
    cleanup: int,
    blocks: ReflectionBlocks,
    lights: ReflectionLight,
    # Out:
    mark_out: wp.array[wp.uint8],
    closeness_out: wp.array[wp.float16],
    lights_out: ReflectionLight,
    excess_out: wp.array[wp.uint64],
):
    """Find sparks and missing samples, how uneven the roughness is around and how close what is reflected there.

    Banded over blocks; 43 bytes a block and those of 13 blocks (cached).

    In detail:
        first: Of the band.
        cleanup: 0: nothing is a spark.
        lights_out: The samples, sparks replaced by the mean of their neighbours as far as they are spread.
        excess_out: pack_halves of what was taken from a spark, by the sum of the weights it is spread with.
    """
    block = first + wp.tid()
    mark = int(0)
    steady = int(blocks.mark[block]) == MARK_STEADY
    light = unpack_halves(lights.light[block])
    state = lights.state[block]
    excess = wp.vec3(0.0, 0.0, 0.0)
    closeness = wp.vec2(light[3], wp.where(light[3] > 0.0, 1.0, 0.0))
    if block_depth(blocks.surface[block]) < SKY_DEPTH:
        centre = block_centre(load_view(views), gbuffer, options, blocks, state_lobe(state), block)
        own = light_strength(rgb(light))
        share = spread_share(views[0])
        near = float(0.0)
        count = float(0.0)
        rough = wp.vec3(centre.roughness, centre.roughness * centre.roughness, 1.0)
        sum = wp.vec4(0.0, 0.0, 0.0, 0.0)
        total = float(0.0)
        spread = float(1.0)
        column = block % options.columns
        row = block // options.columns
        i = int(0)
        j = int(-REACH)
        while j <= REACH:
            if in_grid(options, column + i, row + j) and (i != 0 or j != 0):
                tap = filter_tap(options, blocks, lights, centre, column + i, row + j)
                if tap.near > 0.0:
                    rough += wp.vec3(tap.roughness, tap.roughness * tap.roughness, 1.0)
                    w = spread_weight(centre, tap, i, j)
                    if tap.confidence > 0.0 and w > 0.0:
                        count += 1.0
                        spread += w
                        other = unpack_halves(lights.light[tap.block])
                        if other[3] > 0.0:
                            closeness += wp.vec2(other[3] * w, w)
                        if light_strength(rgb(other)) > NEAR_SHARE * own:
                            near += 1.0
                        else:
                            sum += other * w
                            total += w
            i += 1
            if i > row_reach(REACH, j):
                j += 1
                i = -row_reach(REACH, j)
        if unpack_state(state)[1] < 0.0:
            mark = MARK_MISSING
        elif (
            cleanup == 1 and not steady and own > 0.0 and share > 0.0 and count >= NEIGHBORS_MINIMUM
            and near < NEAR_NEIGHBORS * count
        ):
            mark = MARK_SPARK
            taken = (rgb(light) - rgb(sum) / total) * share
            excess = taken / spread
            light = rgba(rgb(light) - taken, light[3])
        mark = mark | (uneven_roughness(rough) << JITTER_SHIFT)
    closeness_out[block] = wp.float16(wp.max(closeness[0] / wp.max(closeness[1], 1.0e-6), 1.0 / SAMPLE_FAR))
    store_mark(mark, light, state, excess, block, mark_out, lights_out, excess_out)


@wp.kernel(cuda_max_registers=80)
def clean_samples(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    options: ReflectionOptions,
    blocks: ReflectionBlocks,
    lights: ReflectionLight,
    excess: wp.array[wp.uint64],
    # Out:
    lights_out: ReflectionLight,
):
    """Replace missing samples by the mean of their neighbours, give out what sparks had; banded over blocks.

    32 bytes a block and the marks of 13 blocks; more of those around what is missing or sparkles. What is replaced has
    the confidence 0; where all neighbours are missing too, it stays unknown.
    """
    block = first + wp.tid()
    light = unpack_halves(lights.light[block])
    words = lights.state[block]
    state = unpack_state(words)
    if block_depth(blocks.surface[block]) < SKY_DEPTH:
        missing = (int(blocks.mark[block]) & MARK_MISSING) != 0
        centre = FilterCentre()
        made = bool(False)
        sum = wp.vec4(0.0, 0.0, 0.0, 0.0)
        given = wp.vec3(0.0, 0.0, 0.0)
        square = float(0.0)
        total = float(0.0)
        column = block % options.columns
        row = block // options.columns
        i = int(0)
        j = int(-REACH)
        while j <= REACH:
            if in_grid(options, column + i, row + j):
                q = block + j * options.columns + i
                mark = int(blocks.mark[q])
                if (mark & MARK_SPARK) != 0 or (missing and (mark & MARK_MISSING) == 0):
                    if not made:
                        centre = block_centre(load_view(views), gbuffer, options, blocks, state_lobe(words), block)
                        made = True
                    tap = filter_tap(options, blocks, lights, centre, column + i, row + j)
                    w = spread_weight(centre, tap, i, j)
                    if w > 0.0 and (mark & MARK_SPARK) != 0:
                        given += rgb(unpack_halves(excess[q])) * w
                    if w > 0.0 and missing:
                        sum += unpack_halves(lights.light[q]) * w
                        square += tap.root * tap.root * w
                        total += w
            i += 1
            if i > row_reach(REACH, j):
                j += 1
                i = -row_reach(REACH, j)
        if missing and total > 1.0e-3:
            light = sum / total
            state = wp.vec2(wp.sqrt(square / total), 0.0)
        elif not missing:
            strength = light_strength(rgb(light))
            light = rgba(rgb(light) + given, light[3])
            state[0] = state[0] + wp.max(light_strength(rgb(light)) - strength, 0.0)
    lights_out.light[block] = pack_halves(light)
    lights_out.state[block] = pack_state(state[0], state[1], state_lobe(words))
