# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounds of the path tracer: the lean and the full machine shade alike, lists are worked off whole, loops end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from burnish.engine import session as burnish_session
from burnish.engine.device import launch, record
from burnish.engine.passes import reference, wavefront
from burnish.engine.passes.wavefront import Step, Wavefront
from burnish.engine.path_options import path_options
from burnish.engine.session import Session
from burnish.kernels import path_lists
from burnish.kernels.paths import ENDED, HARD_SURVIVAL, HEAVY_PATH, Options, Paths, survival_chance

from tests import light_scenes, scenes
from tests.device import DEVICE
from tests.unit.engine.test_lean import coated, lean_materials, row_of_balls, use_full_machine
from tests.unit.engine.test_media import absorber, boxes

SIZE = (40, 16)


def rendered(change=lambda scene: None, samples=3):
    """Render balls of all materials by path tracing; return the picture and the number of rays."""
    session = Session(scenes.SETTINGS)
    session.update(row_of_balls(lean_materials() | {"coated": coated()}))
    change(session._scene)
    session.configure(scenes.SETTINGS, scenes.camera_above(half=3.5), *SIZE)
    session.step(samples)
    return session.read()[..., :3], session.rays


def test_both_machines_shade_alike():
    """Trace the same paths whether the lean machine takes most hits or the full one takes all."""
    (lean, rays), (full, full_rays) = rendered(), rendered(use_full_machine)
    assert lean.mean() > 0.1 and rays > SIZE[0] * SIZE[1] * 3
    # But for roundings, which compilers do where they like; on CUDA they are more.
    few = DEVICE == "cpu"
    assert np.isclose(rays, full_rays, rtol=0 if few else 1e-3)
    assert np.allclose(lean, full, rtol=1e-5 if few else 1e-2, atol=1e-6 if few else 1e-3)


def test_threads_share_a_list(monkeypatch):
    """Trace the same paths whether one thread of a launch works a list off or five take turns, as many do on CUDA."""
    expected, rays = rendered()
    if DEVICE != "cpu":
        pytest.skip("there many share all lists")
    monkeypatch.setattr(wavefront, "PROCESSOR_THREADS", 5)
    found, found_rays = rendered()
    assert found_rays == rays and np.array_equal(found, expected)


def test_empty_lists_have_no_launch(monkeypatch):
    """Launch nothing over lists that no path is in."""
    if DEVICE != "cpu":
        pytest.skip("there only the device knows")
    launched = []

    def noted(kernel, inputs, outputs, device, count=1):
        command = record(kernel, inputs, outputs, device, count)
        real = command.launch
        command.launch = lambda: (launched.append(kernel.key), real())
        return command

    monkeypatch.setattr(wavefront, "record", noted)
    rendered(samples=1)
    lean, full = launched.count("shade_lean_paths"), launched.count("evaluate_materials")
    # The coated ball, which alone needs the full machine, is seen in the first rounds only.
    assert lean > full > 0 and launched.count("trace_flat_paths") == launched.count("start_round")


@pytest.mark.parametrize(("width", "height", "samples"), [(24, 16, 1), (13, 9, 2), (7, 3, 1), (8, 20, 3), (1, 5, 1)])
def test_every_path_is_listed_once(width, height, samples):
    """List all paths, the first 64 of a wide picture in a square of 8 x 8."""
    device, pixels = DEVICE, width * height
    queue = wp.zeros(pixels * samples, dtype=int, device=device)
    launch(path_lists.list_all, len(queue), [width, pixels], [queue], device)
    listed = queue.numpy()
    assert (np.sort(listed) == np.arange(len(queue))).all()
    assert (np.sort(listed[:pixels]) == np.arange(pixels)).all()
    if width >= 8 and height >= 8:
        assert (listed[:64] % width < 8).all() and (listed[:64] // width < 8).all()


@wp.kernel
def live_on(
    # In:
    limits: wp.array[int],
    rounds: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """End each path after so many rounds of its own."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        paths_out.state[path] = wp.where(rounds[0] >= limits[path], ENDED, rounds[0] + 1)


@pytest.mark.parametrize("limit", [4, 100])
def test_loops_end(limit):
    """Run rounds until no path lives, or as many as are allowed, with the same launches again and again."""
    device, count = DEVICE, 50
    front = Wavefront(64, False, device)
    limits = wp.array(np.arange(64, dtype=np.int32) % 8, dtype=int, device=device)

    def steps():
        return [Step(live_on, [limits, front.rounds]),
                Step(path_lists.list_living, [front.paths.state], fills=("next",), changes=False)]

    for _ in range(2):
        front.forget_rays()
        front.paths.state.zero_()
        assert front.loop("test", (limits,), steps, count, limit, lambda: False)
        assert front.rays == np.minimum(np.arange(count) % 8 + 1, limit).sum()
    assert device != "cpu" or not front.loop("test", (limits,), steps, count, limit, lambda: True)


@wp.kernel
def note_round(
    # In:
    rounds: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    times_out: wp.array[int],
    sums_out: wp.array[int],
):
    """Count the rounds of each path, and add up their numbers."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        times_out[path] = times_out[path] + 1
        sums_out[path] = sums_out[path] + rounds[0]


@pytest.mark.parametrize("limit", [3, 4, 100])
def test_late_steps_come_once_a_round(limit):
    """Run late steps over the paths of each round with its number, the last one's too, whichever half it is."""
    device, count = DEVICE, 50
    front = Wavefront(64, False, device)
    for longest in (7, 8):
        limits = wp.array(np.arange(64, dtype=np.int32) % longest, dtype=int, device=device)
        times, sums = (wp.zeros(64, dtype=int, device=device) for _ in range(2))

        def steps(limits=limits, times=times, sums=sums):
            return [Step(live_on, [limits, front.rounds], lane=1),
                    Step(path_lists.list_living, [front.paths.state], fills=("next",), changes=False),
                    Step(note_round, [front.late_rounds], changes=False, outputs=[times, sums], late=True)]

        for again in (1, 2):
            front.paths.state.zero_()
            assert front.loop("late", (limits,), steps, count, limit, lambda: False)
            lived = np.where(np.arange(64) < count, np.minimum(np.arange(64) % longest + 1, limit), 0)
            assert (times.numpy() == again * lived).all()
            assert (sums.numpy() == again * lived * (lived - 1) // 2).all()


def test_lanes_give_the_same_picture(monkeypatch):
    """Shade materials side by side, and trace shadow rays beside the next round's rays, or all one after the other."""
    found = []
    for apart in (True, False):
        with monkeypatch.context() as patch:
            if not apart:
                patch.setattr(reference, "shadows_may_wait", lambda *_: False)
                steps = reference.path_steps
                patch.setattr(reference, "path_steps", lambda *a, steps=steps: [replace(s, lane=0) for s in steps(*a)])
            found.append(rendered())
    (beside, rays), (after, same_rays) = found
    assert rays == same_rays and np.array_equal(beside, after)


def in_a_box(monkeypatch, ended_harder, kind="DIFFUSE", samples=32, **arguments):
    """Return the mean of the light in a closed box that emits 1, path-traced, and the rays of a sample."""

    def ending(*given):
        options = path_options(*given)
        options.ended_harder = ended_harder
        return options

    size = (24, 24)
    made = light_scenes.furnace(0.9, size)
    if kind != "DIFFUSE":
        made.delta.materials = {name: scenes.material(kind, **arguments) for name in made.delta.materials}
    monkeypatch.setattr(burnish_session, "path_options", ending)
    session = Session(scenes.SETTINGS)
    session.update(made.delta)
    session.configure(scenes.SETTINGS, made.camera, *size)
    session.step(samples)
    return session.read()[..., :3].mean(), session.rays / (size[0] * size[1] * samples)


def test_long_paths_end_harder_without_loss(monkeypatch):
    """Keep the light of a bright box where fewer paths go on after eight bounces; mirrors' go on as they do."""
    light, rays = in_a_box(monkeypatch, 0)
    harder, fewer = in_a_box(monkeypatch, 8)
    assert abs(light - 10.0) < 0.2 and abs(harder - 10.0) < 0.3
    assert fewer < 0.95 * rays
    mirror = {"kind": "GLOSSY", "roughness": 0.0, "color": 0.9}
    assert in_a_box(monkeypatch, 8, **mirror)[1] == in_a_box(monkeypatch, 0, **mirror)[1]
    assert in_a_box(monkeypatch, 8, samples=2, **mirror)[1] < in_a_box(monkeypatch, 0, samples=2, **mirror)[1]


@wp.kernel
def weigh_path(albedo: float, options: Options, bounces: int, weights: wp.array[float]):
    """Note how much a path weighs that goes on off matte walls of one albedo, where samples are few and many."""
    few = wp.tid()
    throughput = wp.vec3(albedo, albedo, albedo)
    for bounce in range(1, bounces):
        chance = survival_chance(options, bounce, throughput, 0.3, few)
        throughput = throughput * (albedo / chance)
        weights[few * bounces + bounce] = throughput[0]


@pytest.mark.parametrize("albedo", [0.5, 0.9, 0.95, 1.0])
def test_weights_of_long_paths_are_bounded(device, albedo):
    """Let no path of many samples that is ended harder weigh ever more: their sums would be noise without bound."""
    bounces, options = 32, Options()
    options.ended_harder, options.roulette_start = 8, 2
    weights = wp.zeros(2 * bounces, dtype=float, device=device)
    wp.launch(weigh_path, 2, inputs=[albedo, options, bounces], outputs=[weights], device=device)
    many, few = weights.numpy().reshape(2, bounces).max(1)
    assert many <= 1.001 * HEAVY_PATH / HARD_SURVIVAL
    assert few > many or albedo < 0.9


def test_pictures_of_few_samples_end_paths_sooner(monkeypatch):
    """Trace fewer rays for a picture of two samples than for two of eight, with its light."""
    light, rays = in_a_box(monkeypatch, 8, samples=2)
    _, more = in_a_box(monkeypatch, 8, samples=8)
    _, all_rays = in_a_box(monkeypatch, 0, samples=2)
    assert rays < 0.97 * more and more < 0.97 * all_rays
    assert abs(light - 10.0) < 2.0


def test_processors_do_not_end_paths_harder():
    """Leave paths alone where nothing waits for the last of them; on a GPU too in scenes with media."""
    for media in (False, True):
        session = Session(scenes.SETTINGS)
        session.update(boxes(absorber(0.1, 0.5, 0.5)) if media else row_of_balls(lean_materials()))
        session.configure(scenes.SETTINGS, scenes.camera_above(half=3.5), *SIZE)
        waits = DEVICE != "cpu" and not media
        assert session._options(False).ended_harder == (8 if waits else 0)
