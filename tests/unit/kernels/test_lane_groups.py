# SPDX-License-Identifier: GPL-3.0-or-later
"""Threads that share an element, and how short lists are dealt out to threads."""

import numpy as np
import warp as wp
from burnish.engine.frame_graph import FrameGraph
from burnish.kernels.lane_groups import group_sum
from burnish.kernels.list_order import first_dealt, first_listed

VALUES = 64


@wp.kernel
def sum_shared(
    # In:
    first: int,
    values: wp.array[float],
    left_out: int,
    lanes: int,
    # Out:
    sums_out: wp.array[float],
):
    """Sum up 64 values of each element but one, whose threads end at once."""
    element = (first + wp.tid()) // lanes
    lane = (first + wp.tid()) % lanes
    if element == left_out:
        return
    total = float(0.0)
    k = lane
    while k < 64:
        total = total + values[64 * element + k]
        k = k + lanes
    total = group_sum(total, lanes)
    if lane == lanes - 1:
        sums_out[element] = total


@wp.kernel
def take_listed(
    # In:
    dealt: int,
    count: int,
    stride: int,
    # Out:
    times_out: wp.array[int],
):
    """Count how often each element of a list is taken: a short one, which is dealt out, or any."""
    i = first_listed(wp.tid(), stride, count)
    if dealt == 1:
        i = first_dealt(wp.tid(), stride)
    while i < count:
        times_out[i] = times_out[i] + 1
        i = i + stride


def test_sums_of_shared_elements(device):
    """Sums are those of one thread, for an odd number of elements, beside one whose threads have ended."""
    graph = FrameGraph(device)
    count, left_out = 37, 5
    values = np.random.default_rng(1).random((count, VALUES), np.float32)
    sums = wp.full(count, -1.0, dtype=float, device=device)
    graph.launch(sum_shared, graph.lanes * count, [wp.array(values.ravel(), device=device), left_out, graph.lanes],
                 [sums])
    graph.replay()
    found = sums.numpy()
    assert found[left_out] == -1.0
    np.testing.assert_allclose(np.delete(found, left_out), np.delete(values.sum(1), left_out), rtol=1e-5)


def test_lists_are_dealt_out_once(device):
    """Every element of a list is taken by one thread, whatever their numbers."""
    for threads, count in ((1, 7), (64, 3), (64, 64), (96, 200), (70, 33), (4096, 100), (1 << 12, 9999), (1 << 17, 5)):
        for dealt in (0, 1):
            times = wp.zeros(count, dtype=int, device=device)
            wp.launch(take_listed, threads, [dealt, count, threads], [times], device=device)
            assert (times.numpy() == 1).all(), (threads, count, dealt)


def test_first_elements_go_to_warps_of_their_own(device):
    """Threads 0, 32, 64, ... have the first elements; a launch with a thread for each element keeps their order."""

    @wp.kernel
    def firsts(stride: int, out: wp.array[int]):
        """Write down each thread's first element."""
        out[wp.tid()] = first_dealt(wp.tid(), stride)

    out = wp.zeros(128, dtype=int, device=device)
    wp.launch(firsts, 128, [128], [out], device=device)
    assert out.numpy()[::32].tolist() == [0, 1, 2, 3]
    wp.launch(firsts, 128, [1 << 30], [out], device=device)
    assert (out.numpy() == np.arange(128)).all()


def test_short_lists_use_idle_warps(device):
    """Threads of a warp share a list the less the shorter it is; those with an element each take it."""

    @wp.kernel
    def firsts(count: int, stride: int, out: wp.array[int]):
        """Write down each thread's first element."""
        out[wp.tid()] = first_listed(wp.tid(), stride, count)

    threads = 1 << 12
    out = wp.zeros(threads, dtype=int, device=device)
    for count, lanes in ((0, 32), (3, 32), (128, 32), (129, 31), (1000, 4), (2048, 2), (2049, 1), (9999, 1)):
        wp.launch(firsts, threads, [count, threads], [out], device=device)
        taken = out.numpy()
        assert (taken[::lanes][:count] == np.arange(threads)[:len(taken[::lanes])][:count]).all(), count
        assert lanes == 1 or (np.delete(taken, np.s_[::lanes]) >= count).all(), count
    wp.launch(firsts, threads, [5, 1 << 30], [out], device=device)
    assert (out.numpy() == np.arange(threads)).all()
