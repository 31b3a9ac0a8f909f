# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs that are dealt out over the processor's cores: all run once, and failures arrive."""

from __future__ import annotations

import threading
from functools import partial
from types import SimpleNamespace

import pytest
from burnish.engine import device


@pytest.fixture(params=(1, 2, 5))
def threads(request):
    """Use so many threads."""
    before = device.thread_count()
    device.use_threads(request.param)
    yield request.param
    device.use_threads(before)


def test_each_job_runs_once(threads):
    """Run all jobs, more and fewer than there are threads, and wait for them."""
    for count in (0, 1, 2, 3, 100):
        done = []
        device.run_bands(partial(done.append, i) for i in range(count))
        assert sorted(done) == list(range(count))


@pytest.mark.parametrize("cuda", [False, True])
def test_all_elements_have_a_launch(threads, monkeypatch, cuda):
    """Launch over each element once, on CUDA over all at once, and over none where a mesh has lost all that it had."""
    launched = []
    monkeypatch.setattr(device, "launch", lambda kernel, count, inputs, outputs, where: launched.append(
        (inputs[0], count)))
    output = SimpleNamespace(device=SimpleNamespace(is_cpu=not cuda, alias="cuda:0" if cuda else "cpu"))
    for count in (0, 1, 3 * device.BAND + 1):
        launched.clear()
        device.launch_bands(None, 7, count, [], [output])
        ends = [first + many for first, many in sorted(launched)]
        assert sum(many for _, many in launched) == count and (ends[-1:] or [7]) == [7 + count]
        assert len(launched) == min(count, 1) or not cuda


def test_cores_work_side_by_side(threads):
    """Have as many jobs under way at a time as there are threads."""
    barrier = threading.Barrier(threads)
    device.run_bands([partial(barrier.wait, 10.0)] * threads)


@pytest.mark.parametrize("place", [0, 7, 19])
def test_a_failure_is_raised(threads, place):
    """Raise what a job raises, whichever thread has it, and begin no more jobs."""
    def job(i):
        if i == place:
            raise IndexError(f"job {i}")

    with pytest.raises(IndexError, match=f"job {place}"):
        device.run_bands(partial(job, i) for i in range(20))
    done = []
    device.run_bands(partial(done.append, i) for i in range(4))
    assert sorted(done) == [0, 1, 2, 3]


def test_callers_do_not_wait_for_each_other(threads):
    """End as soon as the own jobs are done, while another caller's keep the pool busy."""
    end, begun = threading.Event(), threading.Event()

    def blocked():
        begun.set()
        end.wait(10.0)

    other = threading.Thread(target=device.run_bands, args=([blocked] * (threads + 1),))
    other.start()
    try:
        assert begun.wait(10.0)
        done = []
        device.run_bands(partial(done.append, i) for i in range(8))
        assert len(done) == 8 and not end.is_set()
    finally:
        end.set()
        other.join()
