# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow linking in the engine: shadow rays of a light pass what is not in its set, those of other lights don't."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.device_scene import DeviceScene
from burnish.engine.instance_rows import stops_all
from burnish.engine.light_linking import is_linked, same_links
from burnish.engine.scene import SceneDelta
from burnish.engine.session import Session
from burnish.engine.settings import DenoiserSettings, Integrator, SamplingSettings

from tests import scenes

CAMERA = scenes.camera_above(half=1.0)
INTEGRATORS = pytest.mark.parametrize("integrator", [Integrator.REFERENCE, Integrator.REALTIME])
GREY = {"grey": scenes.material(color=0.5), "black": scenes.material(color=0.0)}


def shadowed(*, blocked_by: tuple[int, int] = (0, 0), blocks: int = 0b111, roof: bool = True,
             emissive: int | None = None) -> SceneDelta:
    """Make a floor, a black roof behind the camera, and two lamps above it whose shadows sets cast.

    Args:
        blocked_by: Sets of the lamps.
        blocks: Bits of the sets that the roof is in.
        roof: Whether there is one.
        emissive: Set of what casts the shadows of a panel that shines instead of the lamps, None without one.
    """
    lamps = [scenes.lamp("POINT", 1.0, scenes.place(x, z=4.5), radius=0.1) for x in (-0.3, 0.3)]
    lamps[0].color, lamps[1].color = (300.0, 30.0, 0.0), (0.0, 30.0, 300.0)
    for light, number in zip(lamps, blocked_by, strict=True):
        light.blocked_by = number
    objects, materials = [("floor", scenes.place(), "grey")], dict(GREY)
    if roof:
        objects.append(("roof", scenes.place(z=3.5), "black"))
    if emissive is not None:
        materials["glow"] = scenes.material(color=0.0, emission=(40.0, 30.0, 20.0))
        objects.append(("panel", scenes.place(z=4.5), "glow"))
    made = scenes.delta({"floor": scenes.quad(1.5), "roof": scenes.quad(0.8), "panel": scenes.quad(0.3)}, objects,
                        materials, () if emissive is not None else lamps, 0.0)
    bits = np.full(len(objects), 0b111, np.uint32)
    if roof:
        bits[1] = blocks
    numbers = np.zeros(len(objects), np.int32)
    numbers[-1] = emissive or 0
    if any(blocked_by) or emissive:
        made.instances = dataclasses.replace(
            made.instances, receives=bits, linked_to=np.zeros_like(numbers), blocked_by=numbers,
            spared=(bits & 0b110) != 0b110)
    return made


def session_of(made: SceneDelta, integrator: Integrator, samples: int) -> Session:
    """Render; real-time frames alone."""
    settings = dataclasses.replace(
        scenes.SETTINGS, sampling=SamplingSettings(integrator=integrator),
        denoiser=DenoiserSettings(path_traced_rest=False))
    session = Session(settings)
    session.update(made)
    session.configure(settings, CAMERA, 16, 16)
    session.step(samples)
    return session


def shown(made: SceneDelta, integrator: Integrator, samples: int = 16) -> np.ndarray:
    """Return the mean colour of the middle of the floor."""
    return session_of(made, integrator, samples).read()[4:12, 4:12, :3].mean((0, 1))


@INTEGRATORS
def test_lamps_are_shaded_by_their_sets_alone(integrator: Integrator) -> None:
    """Let the light of one lamp through the roof, that of both, and that of none."""
    free = shown(shadowed(roof=False), integrator)
    assert free.min() > 0.02
    dark = shown(shadowed(), integrator)
    assert dark.max() < 0.02 * free.max()
    both = shown(shadowed(blocked_by=(1, 1), blocks=0b101), integrator)
    np.testing.assert_allclose(both, free, rtol=0.03)
    one = shown(shadowed(blocked_by=(1, 2), blocks=0b101), integrator)
    assert one[0] > 0.9 * free[0] and one[2] < 0.02 * free[2], (one, free)
    np.testing.assert_allclose(shown(shadowed(blocked_by=(1, 2), blocks=0b111), integrator), dark, atol=1e-3)


@pytest.mark.slow
@INTEGRATORS
def test_emissive_meshes_are_too(integrator: Integrator) -> None:
    """Let the light of an emissive mesh through a roof that is not in its set, and none through one that is."""
    free = shown(shadowed(roof=False, emissive=0), integrator, 32)
    through = shown(shadowed(emissive=1, blocks=0b101), integrator, 32)
    np.testing.assert_allclose(through, free, rtol=0.06)
    assert shown(shadowed(emissive=2, blocks=0b101), integrator, 32).max() < 0.15 * free.max()


def test_only_what_spares_a_light_needs_a_test() -> None:
    """Keep all else among the opaque triangles, and all of it where no light has such a set."""
    scene = DeviceScene(scenes.SETTINGS.device)
    scene.apply(shadowed(), scenes.SETTINGS.performance)
    assert not scene.structures.has_filtered and scene.light_struct.linked == 0
    made = shadowed(blocked_by=(1, 2), blocks=0b101)
    assert stops_all(made.instances).tolist() == [True, False]
    scene.apply(made, scenes.SETTINGS.performance)
    assert scene.structures.has_filtered and scene.light_struct.linked == 1
    assert [int(value) >> 16 & 31 for value in scene.lamps["visibility"]] == [1, 2]
    assert is_linked(made.lights, None, np.zeros(1, bool)) and not is_linked(shadowed().lights, None, np.zeros(1, bool))


def test_sets_of_blockers_are_compared() -> None:
    """Take another set of what casts an emissive mesh's shadows for an edit of links."""
    table = shadowed(emissive=1).instances
    assert same_links(table, dataclasses.replace(table, blocked_by=table.blocked_by.copy()))
    assert not same_links(table, dataclasses.replace(table, blocked_by=table.blocked_by * 2))
