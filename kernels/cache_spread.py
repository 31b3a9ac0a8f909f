# SPDX-License-Identifier: GPL-3.0-or-later
"""How light gets from cell to cell faster than a bounce a frame: balance of the whole, and sweeps within a frame.

Indirect light is read from the cache that it is written to, so after the first frame and after edits of light a bounce
takes a frame; a bathroom with white tiles shows 87 % of its light after eight. Two things shorten that.

For SWEEP_FRAMES a frame's bounce rays are links from cell to cell, over which light goes on several times: Jacobi
sweeps of the radiosity that the links sample, each starting from what cells held and adding what the links bring by
the sweep before. They cost no rays.

For REBALANCE_FRAMES all cells' indirect light is scaled before or after these, channel by channel, so that on the
whole it agrees with what is gathered from it (coarse-mesh rebalance of neutron transport; Reed 1971): with O the cells'
light, S what arrives in them from lights by way of one surface and G what the cells' own light adds to that,
a * O = S + a * G gives a = S / (O - G).
"""

from __future__ import annotations

import warp as wp

from .cache_cells import (
    LANES,
    REBALANCE_FRAMES,
    CacheControl,
    add_indirect,
    add_sample,
    blend,
    from_fixed,
    history_share,
    light_cap,
    scaled,
)
from .cache_rays import IDLE, SWEEP_FRAMES, Vertices, cell_seed, hit_place
from .cache_shade import bounced_light, lossy_light
from .geometry_math import is_finite3
from .hash_grid import BUCKET, EMPTY, NO_CELL, HashGrid, coarse_key, find_key, insert_key, wide_key
from .packing import rgb
from .paths import Paths
from .view import View, settling_frames

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

REBALANCE_MAX = wp.constant(4.0)

# Share of a source's own light that stands for a hit of which nothing is known. All of it would feed on itself: a white
# ball under a white sky came out 6 % too bright, while a share of 0.5 leaves rooms a tenth darker for some frames. The
# mean of what is known elsewhere would light rooms that no light reaches.
UNKNOWN_SHARE = wp.constant(0.72)


@wp.func
def sweeping(view: View) -> bool:
    """Return whether light goes on within this frame."""
    return settling_frames(view) < SWEEP_FRAMES


@wp.func
def balances_held(view: View, age: int) -> bool:
    """Return whether what cells hold is balanced before the sweeps: after edits and once there are no more sweeps.

    In the first frames it needs none: the balance after their sweeps is far less noisy.
    """
    return age < REBALANCE_FRAMES and (view.light_age <= view.frame or not sweeping(view))


@wp.func
def add_balance(
    control: CacheControl, swept: int, bounce: int, held: wp.vec3, arrived: wp.vec3, carried: wp.vec3,
):
    """Add a bounce ray to the sums of the balance before or after the sweeps; atomic."""
    first = (swept * LANES + bounce % LANES) * 9
    add_sample(control.balance, first, held)
    add_sample(control.balance, first + 3, arrived)
    add_sample(control.balance, first + 6, carried)


@wp.kernel
def balance_bounces(
    # In:
    views: wp.array[View],
    # Out:
    grid_out: HashGrid,
    control_out: CacheControl,
    vertices_out: Vertices,
):
    """Make the coarse and wide cells about the bounce rays' sources, and sum up the balance of what these hold."""
    bounce = wp.tid()
    vertices_out.around[bounce] = NO_CELL
    vertices_out.far[bounce] = NO_CELL
    source = vertices_out.source[bounce]
    if source == NO_CELL:
        return
    coarse = insert_key(grid_out, vertices_out.coarse[bounce])
    if coarse != NO_CELL:
        grid_out.touched[coarse] = views[0].frame
    vertices_out.around[bounce] = coarse
    if grid_out.directions == 0:
        wide = insert_key(grid_out, wide_key(grid_out, vertices_out.coarse[bounce]))
        if wide != NO_CELL:
            grid_out.touched[wide] = views[0].frame
        vertices_out.far[bounce] = wide
    held = grid_out.indirect[source]
    if held[3] > 0.0 and balances_held(views[0], control_out.age[0]):
        add_balance(
            control_out, 0, bounce, rgb(held), vertices_out.arrived[bounce], vertices_out.carried[bounce])


@wp.func
def balance_sum(control: CacheControl, swept: int, entry: int) -> float:
    """Return one of the nine sums over all lanes, before or after the sweeps."""
    total = wp.int64(0)
    lane = int(0)
    while lane < LANES:
        total = total + control.balance[(swept * LANES + lane) * 9 + entry]
        lane = lane + 1
    return from_fixed(total)


@wp.kernel
def measure_balance(
    # In:
    views: wp.array[View],
    swept: int,
    # Out:
    control_out: CacheControl,
):
    """Find the factors that bring the cells' indirect light into balance (one thread), before or after the sweeps."""
    view = views[0]
    held_factor = wp.vec3(1.0, 1.0, 1.0)
    sample_factor = wp.vec3(1.0, 1.0, 1.0)
    age = control_out.age[0]
    wanted = balances_held(view, age)
    if swept == 1:
        if not sweeping(view):
            return
        wanted = True
        held_factor = control_out.factors[0]
    if wanted:
        # Less and less: the factor is noisy, and what it is to mend soon mends itself.
        strength = 4.0 / (4.0 + float(age))
        channel = int(0)
        while channel < 3:
            held = balance_sum(control_out, swept, channel)
            arrived = balance_sum(control_out, swept, 3 + channel)
            carried = balance_sum(control_out, swept, 6 + channel)
            if held > 0.0:
                factor = arrived / wp.max(held - carried, arrived / REBALANCE_MAX + 1.0e-20 * held)
                factor = wp.pow(wp.max(factor, 0.0), strength)
                held_factor[channel] = held_factor[channel] * factor
                # Sweeps to come gather anew from what has been scaled.
                if arrived + carried > 0.0 and (swept == 1 or not sweeping(view)):
                    sample_factor[channel] = (arrived + factor * carried) / (arrived + carried)
            channel = channel + 1
    control_out.factors[0] = held_factor
    control_out.factors[1] = sample_factor


@wp.func
def is_told(grid: HashGrid, view: View, control: CacheControl, cell: int) -> bool:
    """Return whether a coarse cell has samples of this frame, or of others since the last edit of light."""
    return grid.touched[cell] == view.frame or (control.age[0] > 0 and grid.indirect[cell][3] > 0.0)


@wp.kernel
def find_beyond(
    # In:
    views: wp.array[View],
    control: CacheControl,
    paths: Paths,
    count: int,
    # Out:
    grid_out: HashGrid,
    vertices_out: Vertices,
):
    """Find the coarse cells about the bounce rays' hits, which stand in for cells without indirect light.

    Wide ones where no bounce ray has told a coarse one anything; these are marked, as all bounces know them. All that
    mark a cell write the same.
    """
    view = views[0]
    if not sweeping(view):
        return
    bounce = wp.tid()
    slot = count + bounce
    vertices_out.beyond[bounce] = NO_CELL
    if vertices_out.emission[slot][3] == IDLE or vertices_out.source[bounce] == NO_CELL:
        return
    key = coarse_key(
        grid_out, view, hit_place(grid_out, paths, vertices_out, slot), paths.direction[slot],
        cell_seed(slot, view.frame))
    beyond = find_key(grid_out, key)
    if beyond == NO_CELL or not is_told(grid_out, view, control, beyond):
        beyond = find_key(grid_out, wide_key(grid_out, key))
        if beyond != NO_CELL:
            grid_out.linked[beyond] = view.frame + 1
    vertices_out.beyond[bounce] = beyond


@wp.kernel
def list_cells(
    # In:
    views: wp.array[View],
    grid: HashGrid,
    # Out:
    cells_out: wp.array[int],
    count_out: wp.array[int],
):
    """List the cells in use; a thread looks at a bucket. Atomic: no bands."""
    if not sweeping(views[0]):
        return
    first = wp.tid() * BUCKET
    used = int(0)
    i = int(0)
    while i < BUCKET:
        if grid.keys[first + i] != EMPTY:
            used = used + 1
        i = i + 1
    if used == 0:
        return
    place = wp.atomic_add(count_out, 0, used)
    slot = int(first)
    while slot < first + BUCKET:
        if grid.keys[slot] != EMPTY:
            cells_out[place] = slot
            place = place + 1
        slot = slot + 1


@wp.func
def spread_cell(view: View, control: CacheControl, sample_cap: float, grid_out: HashGrid, cell: int):
    """Blend what a sweep has brought into a cell with what it held before the frame."""
    light = scaled(grid_out.indirect[cell], control.factors[0])
    bounced = grid_out.counts[2 * cell + 1]
    if bounced > 0:
        light = blend(
            light, grid_out.sums, 6 * cell + 3, bounced,
            history_share(light_cap(view, sample_cap), float(control.age[0]), bounced), wp.vec3(1.0, 1.0, 1.0))
        grid_out.counts[2 * cell + 1] = 0
        for i in range(3):
            grid_out.sums[6 * cell + 3 + i] = wp.int64(0)
    elif control.age[0] == 0:
        # Of before the edit: coarse cells with samples know more.
        light[3] = 0.0
    grid_out.spread[cell] = light


@wp.kernel
def spread_cells(
    first: int,
    # In:
    views: wp.array[View],
    control: CacheControl,
    sample_cap: float,
    cells: wp.array[int],
    count: wp.array[int],
    threads: int,
    # Out:
    grid_out: HashGrid,
):
    """Take a sweep's light into the cells in use (list_cells); before the first sweep they have what they held.

    Thread i of so many takes cells i, i + threads, ... of the list.
    """
    if not sweeping(views[0]):
        return
    i = int(first + wp.tid())
    while i < count[0]:
        spread_cell(views[0], control, sample_cap, grid_out, cells[i])
        i = i + threads


@wp.func
def finite_or_black(light: wp.vec3) -> wp.vec3:
    """Return light, black where it is not finite."""
    if is_finite3(light):
        return light
    return wp.vec3(0.0, 0.0, 0.0)


@wp.kernel
def spread_light(
    # In:
    views: wp.array[View],
    count: int,
    goes_on: int,
    # Out:
    grid_out: HashGrid,
    control_out: CacheControl,
    vertices_out: Vertices,
):
    """Find anew what the cache's indirect light adds to each bounce ray; add it up for a further sweep if it `goes_on`.

    Where nothing is known of a hit's cell nor about it, most of the source's own light stands for it: black would be
    lost.
    """
    if not sweeping(views[0]):
        return
    bounce = wp.tid()
    source = vertices_out.source[bounce]
    if source == NO_CELL:
        return
    light = wp.vec4(0.0, 0.0, 0.0, 0.0)
    slot = count + bounce
    if vertices_out.emission[slot][3] != IDLE:
        cell = vertices_out.cell[slot]
        if cell != NO_CELL:
            light = grid_out.spread[cell]
        beyond = vertices_out.beyond[bounce]
        if not light[3] > 0.0 and beyond != NO_CELL:
            light = grid_out.spread[beyond]
        if not light[3] > 0.0:
            light = UNKNOWN_SHARE * grid_out.spread[source]
    # Over the same few links again and again what gives more than it gets would grow beyond the mean of all links, and
    # so would a balance of it: it gives all in the last sweep alone.
    carried = finite_or_black(lossy_light(vertices_out, slot, rgb(light)))
    vertices_out.carried[bounce] = carried
    if goes_on == 0:
        add_balance(
            control_out, 1, bounce, rgb(grid_out.spread[source]), vertices_out.arrived[bounce], carried)
        vertices_out.carried[bounce] = finite_or_black(bounced_light(views[0], vertices_out, slot, rgb(light)))
        return
    sample = vertices_out.arrived[bounce] + carried
    add_indirect(grid_out, source, sample)
    add_indirect(grid_out, vertices_out.around[bounce], sample)
    wide = vertices_out.far[bounce]
    if wide != NO_CELL and grid_out.linked[wide] == views[0].frame + 1:
        add_indirect(grid_out, wide, sample)
