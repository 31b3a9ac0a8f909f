# SPDX-License-Identifier: GPL-3.0-or-later
"""Media that vary in space, path-traced: what passes, what shines, energy; what does not vary pays nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.media import MediumData
from burnish.engine.passes import wavefront
from burnish.engine.passes.media_light import VOLUME_PASSES
from burnish.engine.volume_data import VolumeData
from burnish.engine.volume_program import OPTIONAL_PREFIX, FieldData, FieldSum, VaryingData, VolumeBuilder

from tests import scenes
from tests.unit.engine.test_media import MEDIA_KERNELS, PASSES, absorber, boxes, cloud, lit_scene, seen, shot

VOLUME_KERNELS = {"march_volumes", "scatter_in_volumes", "weaken_in_volumes"}
WHITE = (1.0, 1.0, 1.0)


def height(power=1):
    """Return the object's z from 0 at the bottom to 1 at the top of its box, to a power, as a coefficient's program."""
    builder = VolumeBuilder(optional=False)
    z = builder.component(builder.input("OBJECT"), 2)
    z = builder.math("ADD", builder.math("MULTIPLY", z, 0.5), 0.5)
    return builder.compiled(z if power == 1 else builder.math("POWER", z, float(power)))


def gradient(extinction, scattering=None, emission=(0.0, 0.0, 0.0)):
    """Return a medium that is denser towards the top of its box, from nothing on."""
    phases = () if scattering is None else ((FieldData(scattering, height()), FieldData((0.0,) * 3)),)
    glow = FieldData(emission, height()) if any(emission) else FieldData()
    return MediumData(varying=VaryingData(FieldData(extinction, height()), glow, phases))


def test_absorption_is_that_of_the_integral():
    """Show the world through a box whose density grows along the way, alone and with a homogeneous one about it."""
    expected = np.exp([-0.2 / 2.0, -1.0 / 2.0, -4.0 / 2.0])
    assert seen(boxes(gradient((0.1, 0.5, 2.0))), 64) == pytest.approx(expected, rel=0.02)
    both = boxes(gradient((0.1, 0.5, 2.0)), absorber(0.4, 0.0, 0.2))
    assert seen(both, 256) == pytest.approx(expected * np.exp([-0.7, 0.0, -0.35]), rel=0.06)


def test_what_shines_is_that_of_the_integral():
    """Add what a medium emits where nothing dims it, and where it dims itself."""
    clear = MediumData(varying=VaryingData(emission=FieldData((0.25, 0.5, 1.0), height())))
    assert seen(boxes(clear, background=0.0), 64) == pytest.approx([0.25, 0.5, 1.0], rel=0.02)
    dim = gradient((1.0, 1.0, 1.0), emission=(0.5, 0.5, 0.5))
    # Emission and extinction are in proportion: a share of what is not let through.
    assert seen(boxes(dim, background=0.0), 128) == pytest.approx([0.5 * (1.0 - np.exp(-1.0))] * 3, rel=0.02)


def test_white_clouds_lose_no_light():
    """See nothing of a cloud that scatters all light in an even world."""
    assert seen(boxes(gradient(WHITE, WHITE), background=0.7), 256) == pytest.approx(0.7, rel=0.01)


def test_colored_clouds_are_those_of_homogeneous_ones():
    """Draw a medium whose program comes to a constant as the homogeneous medium of that constant, in each channel."""
    builder = VolumeBuilder(optional=False)
    one = builder.compiled(builder.math("ADD", builder.math("MULTIPLY", builder.input("OBJECT"), 0.0), 1.0))
    plain = cloud(2.0, 0.4, (0.9, 0.5, 0.1))
    scattering = FieldData(plain.phases[0].scattering, one)
    varying = MediumData(varying=VaryingData(
        FieldData((2.0, 2.0, 2.0), one), FieldData(), ((scattering, FieldData((0.4,) * 3)),)))
    assert seen(boxes(varying), 256) == pytest.approx(seen(boxes(plain), 256), rel=0.02, abs=0.003)


def test_shadow_rays_are_dimmed():
    """Light a floor through a box: the mean over paths is what the integral lets through."""
    floor = ("floor", scenes.place(z=-1.5), "white")
    sun = scenes.lamp("SUN", 1.0)
    more = {"others": [floor], "materials": {"white": scenes.material(color=0.8)},
            "meshes": {"floor": scenes.quad(4.0)}, "lights": [sun], "background": 0.0}
    clear = seen(boxes(absorber(0.0, 0.0, 0.0), **more), 16)
    dimmed = seen(boxes(gradient((0.1, 0.5, 1.0)), **more), 256)
    assert dimmed / clear == pytest.approx(np.exp([-0.2, -1.0, -2.0]), rel=0.05)


@pytest.mark.slow
def test_fog_of_the_world_is_as_low_as_it_says():
    """Look down through a fog that falls off with the height: what passes is its integral, not that of its cells."""
    builder = VolumeBuilder(optional=False)
    z = builder.component(builder.input("POSITION"), 2)
    fog = builder.compiled(builder.math("EXPONENT", builder.math("MULTIPLY", builder.math("MAXIMUM", z, -1.0), -2.0)))
    medium = MediumData(varying=VaryingData(FieldData((0.4, 0.8, 1.6), fog)))
    floor = scenes.delta({"floor": scenes.quad(50.0)}, [("floor", np.eye(4), "lit")],
                         {"lit": scenes.emitter(1.0)}, background=0.0)
    foggy = dataclasses.replace(floor, world=dataclasses.replace(floor.world, medium=medium))
    assert seen(foggy, 128) == pytest.approx(np.exp([-0.2, -0.4, -0.8]), rel=0.03)


def grids_of(cells, **values):
    """Return a cube of side 2 whose grids have these values."""
    to_object = np.diag([*(2.0 / np.array(cells)), 1.0])
    to_object[:3, 3] = -1.0
    shape = (*cells[::-1], 4)
    return VolumeData(grids={name: np.broadcast_to(np.float32(value), shape).copy() for name, value in values.items()},
                      to_object=to_object, cells=cells, scaled=True)


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_volume_objects_have_the_density_of_their_grids(scale):
    """Read grids by name, 1 for those that there are not, 0 for those that must be; larger ones are less dense."""
    builder = VolumeBuilder(optional=True)
    density = builder.math("MULTIPLY", builder.optional_grid("density"), builder.optional_grid("none"))
    density = builder.math("ADD", density, builder.component(builder.attribute("missing"), 0))
    medium = MediumData(in_grids=VaryingData(FieldData((0.5, 1.0, 2.0), builder.compiled(density))),
                        extinction=(9.0, 9.0, 9.0))
    delta = boxes(medium)
    mesh = dataclasses.replace(delta.meshes["box"], volume=grids_of((8, 4, 2), density=0.5))
    delta = dataclasses.replace(delta, meshes={"box": mesh}, instances=dataclasses.replace(
        delta.instances, transforms=scenes.place(scale=scale)[None]))
    assert seen(delta, 64) == pytest.approx(np.exp([-0.5, -1.0, -2.0]), rel=0.03)


def test_passes_and_light_groups_make_up_the_picture():
    """Give what media that vary scatter to the passes of volumes, and light to the group of its lamp."""
    names = ("Combined_key", "Combined_fill")
    medium = gradient(WHITE, (0.5, 0.4, 0.3), (0.1, 0.2, 0.3))
    session = shot(lit_scene(medium), 4, 0.8, (*PASSES, *VOLUME_PASSES))
    total = session.read("Emission") + session.read("Environment")
    for name in VOLUME_PASSES:
        assert session.read(name).mean() > 1e-4
        total = total + session.read(name)
    for lobe in ("Diffuse", "Glossy", "Transmission"):
        total = total + session.read(f"{lobe} Color") * (
            session.read(f"{lobe} Direct") + session.read(f"{lobe} Indirect"))
    np.testing.assert_allclose(total, session.read()[..., :3], rtol=2e-4, atol=2e-5)
    clear = gradient(WHITE, (0.5, 0.4, 0.3))
    grouped = shot(dataclasses.replace(lit_scene(clear), world=scenes.world(0.0)), 4, 0.8, ("Combined", *names))
    parts = [grouped.read(name)[..., :3] for name in names]
    assert min(part.max() for part in parts) > 0.0
    np.testing.assert_allclose(sum(parts), grouped.read()[..., :3], rtol=2e-4, atol=2e-5)


def test_terms_share_a_number_or_are_added_up():
    """Table one number for terms that have one in common, and three for others."""
    builder = VolumeBuilder(optional=False)
    x, y = (builder.component(builder.input("OBJECT"), axis) for axis in (0, 1))
    total = FieldSum(builder)
    total.add(builder.constant((1.0, 0.5, 0.0)), x)
    total.add(builder.constant((0.0, 0.5, 2.0)), x)
    assert total.finish() == FieldData((1.0, 1.0, 2.0), builder.compiled(x))
    total.add(builder.constant((1.0, 1.0, 1.0)), y)
    assert total.finish().wide
    even = FieldSum(builder)
    even.add(builder.constant((1.0, 0.5, 0.0)), builder.constant(2.0))
    assert even.finish() == FieldData((2.0, 1.0, 0.0))
    assert OPTIONAL_PREFIX not in "".join(builder.attributes)


def test_homogeneous_media_have_the_kernels_that_they_had(monkeypatch):
    """Launch nothing for what varies in scenes without that."""
    recorded = []
    kept = wavefront.record

    def record(kernel, *args, **options):
        recorded.append(kernel.key)
        return kept(kernel, *args, **options)

    monkeypatch.setattr(wavefront, "record", record)
    shot(boxes(cloud(1.0)), 1)
    assert not VOLUME_KERNELS & set(recorded) and MEDIA_KERNELS & set(recorded)
    recorded.clear()
    shot(boxes(gradient(WHITE, WHITE)), 1)
    assert set(recorded) >= VOLUME_KERNELS and not {"march_media", "scatter_paths"} & set(recorded)


@pytest.mark.slow
@pytest.mark.parametrize("extinction", [1e-30, 1e25, np.inf, np.nan, -1.0], ids=str)
def test_no_input_makes_a_bad_pixel(extinction):
    """Stay finite."""
    picture = shot(boxes(gradient((extinction, 1.0, 0.0), (0.5, 0.5, 1e25), (1e20, 0.0, 0.0))), 2).read()
    assert np.isfinite(picture).all() and picture.min() >= 0.0


def test_flat_objects_hold_nothing():
    """Draw the world as it is where an object with a medium that varies has been made flat, which has no inverse."""
    delta = boxes(gradient((1.0, 1.0, 1.0)))
    flat = np.array(delta.instances.transforms)
    flat[:, :, 0] = 0.0
    delta = dataclasses.replace(delta, instances=dataclasses.replace(delta.instances, transforms=flat))
    assert seen(delta, 4) == pytest.approx(1.0, abs=1.0e-3)
