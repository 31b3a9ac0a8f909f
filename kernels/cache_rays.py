# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache's thin kernels: probe rays, bounce rays and shadow rays. They know no materials.

One set of arrays holds the frame's rays: first the probes' rays, a slot each, then the bounce rays. `Paths` is that
of the path tracer, so that its kernels for transparent layers serve here too; `Vertices` is what the cache needs to
know of each hit.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import INV_PI, to_frame
from .hash_grid import NO_CELL, HashGrid, cell_level, cell_size, coarse_key
from .homes import CellPlace, cell_place
from .intersect import MISS, any_hit, closest_hit, offset_origin
from .lamp_hit import FAR
from .packing import rgb, unpack_normal
from .paths import ENDED, PENDING_NONE, Paths, store_hit
from .probe_rays import ProbeRays
from .sampling import hash32, hash_combine, hashed_unit, pixel_seed_of, sample_cosine, sample_pair
from .types import VISIBLE_DIFFUSE, Scene
from .view import View, settling_frames

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Share of the bounce rays that go on from where the last frame's ended: chains of any length form.
KEPT_SHARE = wp.constant(0.25)

# Dimensions of the cache's random numbers.
DIMENSION_CLOSURE = wp.constant(0)
DIMENSION_LIGHT = wp.constant(1)
DIMENSION_PLACE = wp.constant(2)
DIMENSION_BOUNCE = wp.constant(4)
STREAM_CELL = wp.constant(wp.uint32(0x43454C4C))
STREAM_ORIGIN = wp.constant(wp.uint32(0x4F524947))
STREAM_SHIFT = wp.constant(wp.uint32(0x53484946))
STREAM_SIDE = wp.constant(wp.uint32(0x53494445))

# Vertices.emission[3] of slots without a ray.
IDLE = wp.constant(-1.0)

# Of HashGrid.linked: any cell will do.
NO_MARK = wp.constant(0)

# Paths.radiance[3] of hits that look for no light in this frame; else 1 with a shadow ray and 0 without.
UNWATCHED = wp.constant(-1.0)


@wp.struct
class Vertices:
    """Where the frame's rays ended, one slot a ray."""

    position: wp.array[wp.vec4]
    """[m, scene space]; w = error bound of it along the normal [m]"""
    geometric_normal: wp.array[wp.uint32]
    """pack_normal, on the ray's side"""
    normal: wp.array[wp.uint32]
    """pack_normal of the shading normal"""
    reflectance: wp.array[wp.vec4]
    """All light reflected or let through, per channel; w = share of it that comes from behind the surface"""
    emission: wp.array[wp.vec4]
    """Radiance that the ray brings besides what the cache knows; w = distance, IDLE where there is no ray"""
    lobe: wp.array[wp.uint64]
    """pack_lobe of the glossy lobe, 0 for none; without any slot where no lobe counts (cache_highlights.py)"""
    highlight: wp.array[float]
    """What the hit's light sample is worth to that lobe beyond matte light, over the lobe's albedo, by matte light"""
    cell: wp.array[int]
    """NO_CELL for misses and full buckets"""
    source: wp.array[int]
    """Per bounce ray: the cell that it lights; NO_CELL for none"""
    coarse: wp.array[wp.int64]
    """Per bounce ray: key of the coarse cell about its source"""
    arrived: wp.array[wp.vec3]
    """Per bounce ray: radiance that it brings to its source from lights by way of one surface"""
    carried: wp.array[wp.vec3]
    """Per bounce ray: what the cache's indirect light adds to that"""
    around: wp.array[int]
    """Per bounce ray: coarse cell about its source, NO_CELL for none"""
    far: wp.array[int]
    """Per bounce ray: wide cell about its source, NO_CELL for none"""
    beyond: wp.array[int]
    """Per bounce ray, while light spreads: coarse cell about its hit, or wide one, NO_CELL for none"""


@wp.func
def slot_seed(slot: int) -> wp.uint32:
    """Return the seed of a ray's sequences; the frame is the index in them."""
    return pixel_seed_of(slot, 0, 0x43414348)


@wp.func
def cell_seed(slot: int, frame: int) -> wp.uint32:
    """Return the random number with which a ray's hit looks up its cell."""
    return hash_combine(hash_combine(slot_seed(slot), STREAM_CELL), wp.uint32(frame))


@wp.func
def hit_place(grid: HashGrid, paths: Paths, vertices: Vertices, slot: int) -> CellPlace:
    """Return the place of a ray's hit."""
    return cell_place(
        grid.homes, paths.hit[slot][0], rgb(vertices.position[slot]), unpack_normal(vertices.geometric_normal[slot]))


@wp.func
def is_near(grid: HashGrid, view: View, vertices: Vertices, slot: int) -> bool:
    """Return whether a hit is nearer than a cell is wide: too near for the cell's direct light (cone test)."""
    level = cell_level(grid, view, rgb(vertices.position[slot]), cell_seed(slot, view.frame))
    return vertices.emission[slot][3] < cell_size(level)


@wp.func
def start_layers(paths: Paths, slot: int, frame: int):
    """Set what the kernels for transparent layers read."""
    paths.seed[slot] = slot_seed(slot)
    paths.index[slot] = wp.uint32(frame)
    paths.throughput[slot] = wp.vec3(1.0, 1.0, 1.0)
    paths.kind[slot] = VISIBLE_DIFFUSE
    paths.cone[slot] = wp.vec2(0.0, 0.0)


@wp.kernel
def load_probe_rays(
    first: int,
    # In:
    views: wp.array[View],
    rays: ProbeRays,
    filtered: int,
    # Out:
    paths_out: Paths,
):
    """Take over the probes' rays."""
    slot = first + wp.tid()
    t_max = rays.t_max[slot]
    paths_out.t[slot] = t_max
    paths_out.state[slot] = wp.where(t_max > 0.0, 1, ENDED)
    paths_out.origin[slot] = rays.origin[slot]
    paths_out.direction[slot] = rays.direction[slot]
    if filtered == 1:
        start_layers(paths_out, slot, views[0].frame)


@wp.func
def bounce_origin(
    grid: HashGrid, vertices: Vertices, begin: int, bounce: int, bounces: int, count: int, u: float, mark: int,
) -> int:
    """Return the slot of the ray from whose hit a bounce ray starts, or -1: one of `count` from `begin` on.

    Of the slots that share this bounce ray the one whose cell knows least of indirect light; its value has no say. Not
    one whose cell has the `mark`.
    """
    low = begin + int(wp.int64(bounce) * wp.int64(count) / wp.int64(bounces))
    high = begin + int(wp.int64(bounce + 1) * wp.int64(count) / wp.int64(bounces))
    chosen = int(-1)
    least = float(1.0e30)
    shift = int(u * float(high - low))
    i = int(0)
    while i < high - low:
        slot = low + (i + shift) % (high - low)
        cell = vertices.cell[slot]
        if cell != NO_CELL:
            known = grid.indirect[cell][3]
            if known < least and (mark == NO_MARK or grid.linked[cell] != mark):
                least = known
                chosen = slot
        i = i + 1
    return chosen


@wp.func
def send_bounce(
    view: View, grid: HashGrid, paths: Paths, vertices: Vertices, bounce: int, slot: int, origin: int, filtered: int,
):
    """Send a bounce ray on from the hit of slot `origin`, whose cell it lights."""
    seed = slot_seed(slot)
    index = wp.uint32(view.frame)
    vertices.source[bounce] = vertices.cell[origin]
    p = vertices.position[origin]
    position = wp.vec3(p[0], p[1], p[2])
    side = unpack_normal(vertices.geometric_normal[origin])
    normal = unpack_normal(vertices.normal[origin])
    vertices.coarse[bounce] = coarse_key(
        grid, view, cell_place(grid.homes, paths.hit[origin][0], position, side), paths.direction[origin],
        cell_seed(slot, view.frame))
    share = 1.0 - vertices.reflectance[origin][3]
    if hashed_unit(hash_combine(seed, STREAM_SIDE), index) >= share:
        side = -side
        normal = -normal
        share = 1.0 - share
    # The slot's ray of the frame before has had the sequence's neighbouring point. Where this one goes on from its end,
    # the next would turn away from where that came from: cells got 2 to 5 % less of the light of one bright place.
    turn = index
    if origin == slot:
        turn = hash32(index)
    direction = wp.normalize(to_frame(normal, sample_cosine(sample_pair(seed, turn, DIMENSION_BOUNCE))))
    if not wp.dot(direction, side) > 0.0:
        # Below the triangle: absorbed, as the path tracer does. The sample counts as black.
        return
    paths.state[slot] = 1
    paths.origin[slot] = offset_origin(position, side, p[3], direction)
    paths.direction[slot] = direction
    paths.t[slot] = FAR
    paths.pdf[slot] = wp.max(wp.dot(normal, direction), 0.0) * share * INV_PI
    if filtered == 1:
        start_layers(paths, slot, view.frame)


# Frames since the start or an edit of light in which every hit may send a ray on: a bounce takes a frame, and the more
# cells learn of it the sooner it has come everywhere.
SPREADING_FRAMES = wp.constant(48.0)

# Those in which light goes on within the frame (cache_spread.py).
SWEEP_FRAMES = wp.constant(16.0)


@wp.kernel
def start_bounces(
    first: int,
    # In:
    views: wp.array[View],
    grid: HashGrid,
    count: int,
    bounces: int,
    settled: int,
    filtered: int,
    late: int,
    # Out:
    paths_out: Paths,
    vertices_out: Vertices,
    pending_out: wp.array[int],
):
    """Send a ray on from some of the hits, or from where the same slot's ray ended in the frame before.

    While light spreads all `bounces` slots have one, later `settled` of them. `late` 1: the next frame traces them.
    """
    bounce = first + wp.tid()
    slot = count + bounce
    view = views[0]
    if bounce == 0:
        pending_out[0] = wp.where(late == 1, view.frame + 1, 0)
    active = bounces
    if settling_frames(view) >= SPREADING_FRAMES:
        active = settled
    seed = slot_seed(slot)
    index = wp.uint32(view.frame)
    choice = hashed_unit(hash_combine(seed, STREAM_ORIGIN), index)
    origin = int(-1)
    if choice < KEPT_SHARE and view.restart == 0 and vertices_out.cell[slot] != NO_CELL:
        origin = slot
    if origin < 0 and bounce < active:
        shift = hashed_unit(hash_combine(seed, STREAM_SHIFT), index)
        origin = bounce_origin(grid, vertices_out, 0, bounce, active, count, shift, NO_MARK)
    if bounce >= active:
        origin = -1
    paths_out.state[slot] = ENDED
    paths_out.t[slot] = 0.0
    vertices_out.source[bounce] = NO_CELL
    if origin < 0:
        return
    send_bounce(view, grid, paths_out, vertices_out, bounce, slot, origin, filtered)


@wp.kernel
def mark_sources(
    # In:
    views: wp.array[View],
    vertices: Vertices,
    begin: int,
    # Out:
    grid_out: HashGrid,
):
    """Mark the cells from which bounce rays start, from `begin` on; all that mark a cell write the same."""
    source = vertices.source[begin + wp.tid()]
    if source != NO_CELL:
        grid_out.linked[source] = views[0].frame + 1


@wp.kernel
def continue_bounces(
    first: int,
    # In:
    views: wp.array[View],
    grid: HashGrid,
    count: int,
    begin: int,
    width: int,
    further: int,
    filtered: int,
    # Out:
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Send `further` rays on from where this frame's bounce rays, `width` from `begin` on, have ended.

    They start in cells from which none has started so far: those have no light of their own in this frame's sweeps.
    What stands in for it is less than they have, since cells that rays seldom meet lie closer to windows than those
    in view, and each bounce would lose by it.
    """
    i = first + wp.tid()
    bounce = begin + width + i
    slot = count + bounce
    view = views[0]
    paths_out.state[slot] = ENDED
    paths_out.t[slot] = 0.0
    vertices_out.source[bounce] = NO_CELL
    if settling_frames(view) >= SWEEP_FRAMES:
        return
    shift = hashed_unit(hash_combine(slot_seed(slot), STREAM_SHIFT), wp.uint32(view.frame))
    origin = bounce_origin(grid, vertices_out, count + begin, i, further, width, shift, view.frame + 1)
    if origin >= 0:
        send_bounce(view, grid, paths_out, vertices_out, bounce, slot, origin, filtered)


@wp.kernel
def resume_bounces(
    first: int,
    # In:
    views: wp.array[View],
    pending: wp.array[int],
    count: int,
    # Out:
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Drop bounce rays that the frame before has not left for this one; those of an older one have been traced."""
    bounce = first + wp.tid()
    if pending[0] != views[0].frame:
        paths_out.state[count + bounce] = ENDED
        paths_out.t[count + bounce] = 0.0
        vertices_out.source[bounce] = NO_CELL


@wp.kernel(cuda_max_registers=64)
def trace_cache_rays(
    first: int,
    # In:
    scene: Scene,
    offset: int,
    # Out:
    paths_out: Paths,
):
    """Find the closest opaque hit of every ray from slot `offset` on."""
    slot = offset + first + wp.tid()
    if paths_out.state[slot] == ENDED:
        paths_out.hit[slot] = wp.vec2i(MISS, 0)
        return
    store_hit(paths_out, slot, closest_hit(
        scene.geometry, paths_out.origin[slot], paths_out.direction[slot], paths_out.t[slot]))


@wp.func
def finish_cache_shadow(paths: Paths, slot: int, blocked: bool, filtered: int):
    """End a shadow ray that is blocked; keep the light where nothing else has to be asked."""
    if blocked:
        paths.shadow_distance[slot] = 0.0
    elif filtered == 0 and paths.shadow_pending[slot] == PENDING_NONE:
        light = paths.shadow_light[slot]
        paths.radiance[slot] = wp.vec4(light[0], light[1], light[2], paths.radiance[slot][3])
        paths.shadow_distance[slot] = 0.0


@wp.kernel(cuda_max_registers=64)
def trace_cache_shadows(
    # In:
    scene: Scene,
    filtered: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Trace listed shadow rays against opaque triangles."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        distance = paths_out.shadow_distance[slot]
        if distance != 0.0:
            blocked = bool(False)
            if distance > 0.0:
                blocked = any_hit(
                    scene.geometry, paths_out.shadow_origin[slot], paths_out.shadow_direction[slot], distance)
            finish_cache_shadow(paths_out, slot, blocked, filtered)
        i = i + stride
