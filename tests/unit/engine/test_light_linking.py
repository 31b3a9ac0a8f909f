# SPDX-License-Identifier: GPL-3.0-or-later
"""Light linking in the engine: numbers and bits of sets, what they let through, and edits of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine.device import launch
from burnish.engine.device_scene import DeviceScene
from burnish.engine.instance_rows import instance_rows
from burnish.engine.lamps import lamp_array
from burnish.engine.light_linking import RECEIVER_SETS, number_sets, same_links
from burnish.engine.report import Report
from burnish.engine.scene import SceneDelta, Visibility
from burnish.engine.session import Session
from burnish.engine.settings import DenoiserSettings, Integrator, SamplingSettings
from burnish.kernels.light_linking import is_linked, is_lit
from burnish.kernels.types import LINK_SHIFT

from tests import scenes

CAMERA = scenes.camera_above(half=1.0)
UNSEEN = int(Visibility.ALL & ~Visibility.CAMERA)


def test_includes_win_and_excludes_leave_out() -> None:
    """Light what is included, or all but what is excluded; what no set names only where none is included."""
    sets = number_sets({
        "in": {"a": True}, "out": {"a": False}, "both": {"a": True, "b": False}, "empty": {}, "same": {"a": True}})
    assert sets.numbers == {"in": 1, "out": 2, "both": 3, "empty": 0, "same": 1} and not sets.left_out
    assert sets.bits("a") == 0b1011
    assert sets.bits("b") == sets.bits("anything else") == sets.others == 0b0101
    assert number_sets({}).bits("a") == 1


def test_sets_beyond_the_last_bit_are_for_everything() -> None:
    """Number 31 different sets, name those left out, and go on knowing sets that say what another says."""
    made = {k: {f"object {k}": True} for k in range(RECEIVER_SETS + 3)}
    sets = number_sets(made | {"again": {"object 30": True}})
    assert [sets.numbers[k] for k in made] == [*range(1, RECEIVER_SETS + 1), 0, 0, 0]
    assert sets.numbers["again"] == 31 and sets.left_out == (31, 32, 33)
    assert sets.bits("object 30") == 1 | 1 << 31 and sets.bits("object 31") == 1


@wp.kernel
def ask(
    # In:
    visibility: wp.array[int],
    receives: wp.array[int],
    # Out:
    answers_out: wp.array2d[int],
):
    """Ask both questions about each light and object."""
    i, k = wp.tid()
    answers_out[i, k] = wp.where(is_lit(visibility[i], receives[k]), 1, 0) + wp.where(is_linked(visibility[i]), 2, 0)


def test_kernels_read_the_same(device: str) -> None:
    """Find each of 31 sets by its bit, bit 31 too, and lights that are for everything."""
    numbers = np.arange(RECEIVER_SETS + 1, dtype=np.int32)
    bits = np.array([1 | (1 << n) for n in numbers.tolist()], np.uint32)
    visibility = wp.array(63 | numbers << int(LINK_SHIFT), dtype=int, device=device)
    answers = wp.zeros((len(numbers), len(bits)), dtype=int, device=device)
    launch(ask, answers.shape, [visibility, wp.array(bits.view(np.int32), dtype=int, device=device)], [answers], device)
    lit = (numbers[:, None] == numbers) | (numbers[:, None] == 0)
    assert (answers.numpy() == lit + 2 * (numbers > 0)[:, None]).all()


def two_squares(lamps, *, numbers=(0, 0), receives=None, glow=None) -> SceneDelta:
    """Make two squares side by side under two lamps, which are linked to sets by `numbers`."""
    for light, number in zip(lamps, numbers, strict=True):
        light.linked_to = number
    objects = [("square", scenes.place(-0.5), "grey"), ("square", scenes.place(0.5), "grey")]
    materials = {"grey": scenes.material("PRINCIPLED", color=(0.7, 0.6, 0.5), roughness=0.3, specular_level=0.5,
                                         ior=1.5)}
    if glow is not None:
        objects.append(("square", scenes.place(z=1.0, scale=0.3), "glow"))
        materials["glow"] = scenes.material(color=0.5, emission=(4.0, 3.0, 2.0))
    made = scenes.delta({"square": scenes.quad(0.42)}, objects, materials, lamps, 0.05)
    if receives is not None:
        made.instances.receives = np.array(receives, np.uint32)
        made.instances.linked_to = np.array([0, 0, glow or 0][:len(objects)], np.int32)
    return made


def red_and_green() -> list:
    """Make two lamps that the camera does not see."""
    lamps = [scenes.lamp("POINT", 1.0, scenes.place(-0.3, z=1.5), radius=0.1, visibility=UNSEEN),
             scenes.lamp("AREA", 1.0, scenes.place(0.3, z=1.5), size_x=0.4, size_y=0.4, visibility=UNSEEN)]
    lamps[0].color, lamps[1].color = (50.0, 5.0, 0.0), (0.0, 30.0, 3.0)
    return lamps


def session_of(made: SceneDelta, integrator: Integrator, frames: int, passes=("Combined",)) -> Session:
    """Render; real-time frames alone."""
    settings = dataclasses.replace(
        scenes.SETTINGS, sampling=SamplingSettings(integrator=integrator),
        denoiser=DenoiserSettings(path_traced_rest=False),
        performance=dataclasses.replace(scenes.SETTINGS.performance, deterministic=True))
    session = Session(settings)
    session.update(made)
    session.configure(settings, CAMERA, 32, 32, passes=passes)
    session.step(frames)
    return session


def halves(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean colours of both squares."""
    return picture[8:24, 5:13, :3].mean((0, 1)), picture[8:24, 19:27, :3].mean((0, 1))


INTEGRATORS = pytest.mark.parametrize("integrator", [Integrator.REFERENCE, Integrator.REALTIME])


@INTEGRATORS
def test_links_to_everything_change_no_bit(integrator: Integrator) -> None:
    """Draw the very picture of a scene without linking where all lights are linked to all objects."""
    plain = session_of(two_squares(red_and_green(), glow=0), integrator, 6).read()
    linked = two_squares(red_and_green(), numbers=(1, 2), receives=(15, 15, 15), glow=3)
    if integrator == Integrator.REALTIME:
        # Where emission is linked, cells take all of it from light samples.
        linked.instances.linked_to[:] = 0
    assert np.array_equal(session_of(linked, integrator, 6).read(), plain)


@pytest.mark.parametrize("integrator", [
    Integrator.REFERENCE, pytest.param(Integrator.REALTIME, marks=pytest.mark.slow)])
def test_each_lamp_lights_its_own_square(integrator: Integrator) -> None:
    """Light by lamps and by an emissive mesh what each is linked to."""
    dark = {"world": 0.05}
    made = two_squares(red_and_green(), numbers=(1, 2), receives=(0b0011, 0b1101, 0b0001), glow=3)
    left, right = halves(session_of(made, integrator, 64).read())
    alone = [halves(session_of(two_squares(lamps, glow=glow), integrator, 64).read()) for lamps, glow in (
        ([red_and_green()[0], scenes.lamp("SUN", 0.0)], 0), ([red_and_green()[1], scenes.lamp("SUN", 0.0)], 0),
        ([scenes.lamp("SUN", 0.0)] * 2, 0), ([scenes.lamp("SUN", 0.0)] * 2, None))]
    red, green, glow, sky = alone
    assert dark and np.allclose(left, red[0] - glow[0] + sky[0], rtol=0.03, atol=0.01), (left, alone)
    assert np.allclose(right, green[1], rtol=0.03, atol=0.01), (right, alone)


@pytest.mark.slow
@INTEGRATORS
def test_edits_of_links_are_drawn(integrator: Integrator) -> None:
    """Follow lamps and objects that change their sets, and forget the light of before."""
    made = two_squares(red_and_green(), numbers=(1, 2), receives=(0b011, 0b101))
    session = session_of(made, integrator, 8)
    table = dataclasses.replace(made.instances, receives=np.array([0b101, 0b011], np.uint32))
    session.update(SceneDelta(instances=table))
    session.step(48)
    left, right = halves(session.read())
    assert left[1] > 5.0 * left[0] and right[0] > 5.0 * right[1], (left, right)
    lights = [dataclasses.replace(light, linked_to=0) for light in made.lights]
    session.update(SceneDelta(lights=lights))
    session.step(48)
    assert not session._scene.light_struct.linked
    open_left, open_right = halves(session.read())
    expected = halves(session_of(two_squares(red_and_green()), integrator, 48).read())
    assert np.allclose((open_left, open_right), expected, rtol=0.05), (open_left, open_right, expected)


def test_light_groups_tell_lamps_in_one_place_apart() -> None:
    """Give each of two lamps in the same place its own group, by what it lights."""
    lamps = [scenes.lamp("POINT", 40.0, scenes.place(z=1.5), radius=0.1, light_group=name, visibility=UNSEEN)
             for name in ("a", "b")]
    made = two_squares(lamps, numbers=(1, 2), receives=(0b011, 0b101))
    passes = ("Combined", "Combined_a", "Combined_b", "Diffuse Direct", "Diffuse Indirect", "Diffuse Color")
    session = session_of(made, Integrator.REFERENCE, 32, passes)
    (a_left, a_right), (b_left, b_right) = (halves(session.read(f"Combined_{name}")) for name in ("a", "b"))
    assert a_left.min() > 0.1 and b_right.min() > 0.1
    assert a_right.max() < 1e-3 * a_left.min() and b_left.max() < 1e-3 * b_right.min()
    direct = halves(session.read("Diffuse Direct"))
    assert np.allclose(*direct, rtol=0.05) and direct[0].min() > 0.1


def test_rows_and_flags() -> None:
    """Put the number into visibility and the bits into the row, and say whether anything is linked."""
    made = two_squares(red_and_green(), numbers=(1, 31), receives=(0x80000001, 3, 1), glow=2)
    assert [int(v) >> 8 for v in lamp_array(made.lights, np.zeros(3), Report())["visibility"]] == [1, 31]
    scene = DeviceScene(scenes.SETTINGS.device)
    scene.apply(made, scenes.SETTINGS.performance)
    rows = instance_rows(made.instances, scene._ranges(), np.zeros(3))
    assert (rows["receives"].view(np.uint32) == made.instances.receives).all()
    assert [int(v) >> 8 for v in rows["visibility"]] == [0, 0, 2]
    assert scene.light_struct.linked == 1
    free = two_squares(red_and_green(), receives=(1, 1, 1), glow=2)
    scene.apply(free, scenes.SETTINGS.performance)
    assert scene.light_struct.linked == 1, "the emissive mesh is"
    free.instances.linked_to[:] = [2, 2, 0]
    scene.apply(free, scenes.SETTINGS.performance)
    assert scene.light_struct.linked == 0, "nothing that shines is"


def test_links_are_compared_by_object() -> None:
    """Take an object more or less for no edit of links, another bit of any object for one."""
    table = two_squares(red_and_green(), receives=(3, 5, 1), glow=1).instances
    fewer = two_squares(red_and_green(), receives=(3, 5)).instances
    other = dataclasses.replace(table, receives=np.array([3, 1, 1], np.uint32))
    plain = two_squares(red_and_green()).instances
    assert same_links(table, table) and same_links(plain, two_squares(red_and_green()).instances)
    assert not same_links(table, other) and not same_links(plain, table) and not same_links(table, None)
    assert not same_links(fewer, dataclasses.replace(fewer, linked_to=np.array([1, 0], np.int32)))
    assert same_links(fewer, dataclasses.replace(fewer, receives=fewer.receives.copy()))
