# SPDX-License-Identifier: GPL-3.0-or-later
"""Scattering below surfaces in the path tracer: energy, confinement to an object, passes; others pay nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.passes import wavefront
from burnish.engine.passes.composite import LIGHT_PASSES
from burnish.engine.program import ProgramBuilder
from burnish.engine.session import Session
from burnish.engine.settings import Integrator, SamplingSettings
from burnish.engine.subsurface import subsurface_flags
from burnish.kernels import types

from tests import scenes

PLAIN = {"roughness": 0.5, "ior": 1.5, "specular_tint": 1.0, "coat_ior": 1.5, "coat_tint": 1.0, "sheen_tint": 1.0}
METHODS = ("WALK", "LEGACY", "SKIN")
PASSES = ("Combined", "Emission", "Environment", *LIGHT_PASSES)
SIZE = (24, 24)


def wax(color=0.8, radius=0.3, method="WALK", anisotropy=0.0, **arguments):
    """Make a material that scatters all its light below the surface, and reflects none."""
    below = {"subsurface": 1.0, "subsurface_ior": 1.4, "subsurface_anisotropy": anisotropy,
             "subsurface_radius": (radius,) * 3 if isinstance(radius, float) else radius}
    return scenes.material("PRINCIPLED", color=color, subsurface_method=method, **PLAIN | below | arguments)


def matte(color=0.8):
    """Make the same without a radius: it is a diffuse surface."""
    return scenes.material("PRINCIPLED", color=color, subsurface=1.0, **PLAIN)


def ball(material, others=(), meshes=None, background=1.0, lights=()):
    """Make a ball of a material under an even sky, perhaps among other objects."""
    return scenes.delta({"ball": scenes.sphere(1.0, 24), **(meshes or {})},
                        [("ball", np.eye(4), "wax"), *others], {"wax": material, "black": scenes.material(color=0.0)},
                        lights, background)


def shot(delta, samples=16, half=0.5, passes=("Combined",), size=SIZE):
    """Render what lies below the camera; return the session."""
    session = Session(scenes.SETTINGS)
    session.update(delta)
    session.configure(scenes.SETTINGS, scenes.camera_above(half=half), *size, passes=passes)
    session.step(samples)
    return session


def mean(delta, samples=16, half=0.5):
    """Return the picture's mean color, of pixels that are all finite."""
    picture = shot(delta, samples, half).read()[..., :3]
    assert np.isfinite(picture).all() and picture.min() >= 0.0
    return picture.mean((0, 1), dtype=np.float64)


def test_a_channel_goes_as_far_as_its_radius():
    """Return more light of what goes far in a small body, and the surface's color of what goes nowhere."""
    color = mean(ball(wax(0.5, (1.0, 0.05, 0.0))), 64)
    # Cycles, 1,024 samples.
    assert color == pytest.approx([0.859, 0.477, 0.5], rel=0.02)


@pytest.mark.parametrize("method", METHODS)
def test_white_bodies_gain_nothing(method):
    """Return all light of a white body where light comes out soon, and never more than arrives."""
    found = mean(ball(wax(1.0, 20.0, method)), 64)
    lost = 0.12 if method == "SKIN" else 0.02
    assert (found < 1.01).all() and (found > 1.0 - lost).all(), found


def shards():
    """Make a mesh that encloses nothing: triangles in all directions, one of them without area."""
    rng = np.random.default_rng(4)
    positions = (rng.random((60, 3)) * 2.0 - 1.0).astype(np.float32)
    positions[2] = positions[1]
    return scenes.mesh(positions, np.arange(60, dtype=np.int32).reshape(-1, 3))


@pytest.mark.slow
@pytest.mark.parametrize("mesh", [scenes.quad(2.0), shards()], ids=["open", "shards"])
@pytest.mark.parametrize("anisotropy", [-0.9, 0.0, 0.99])
@pytest.mark.parametrize("method", METHODS)
def test_open_meshes_make_no_light(mesh, anisotropy, method):
    """End below meshes without an inside: finite, not brighter than what arrives, and not black."""
    delta = scenes.delta({"mesh": mesh}, [("mesh", np.eye(4), "wax")],
                         {"wax": wax(1.0, (0.5, 0.01, 30.0), method, anisotropy)}, background=1.0)
    found = mean(delta, 8)
    assert (found < 1.03).all() and found.max() > 0.05, found


@pytest.mark.slow
@pytest.mark.parametrize("changes", [
    {"subsurface_radius": (np.nan, 0.1, 0.1)}, {"subsurface_radius": (np.inf, 1e30, 1e-30)},
    {"subsurface_radius": (-1.0, -1.0, 1e-7)}, {"subsurface_anisotropy": np.nan}, {"subsurface_anisotropy": 1e9},
    {"subsurface_ior": -1.0}, {"subsurface_ior": np.inf}, {"color": (np.inf, -1.0, 1e9)}, {"roughness": np.nan},
], ids=str)
def test_no_input_makes_a_bad_pixel(changes):
    """Stay finite and no brighter than what arrives, whatever the sockets say."""
    for method in METHODS:
        color = changes.get("color", 0.8)
        found = mean(ball(wax(color, 0.2, method, **{k: v for k, v in changes.items() if k != "color"})), 2)
        assert (found < 1.05).all(), (method, found)


def test_walks_stay_in_their_object():
    """Pass through other objects below the surface: their picture is, bit for bit, that without them."""
    inside = [("small", scenes.place(), "black"), ("floor", scenes.place(z=0.3), "black")]
    meshes = {"small": scenes.sphere(0.4, 12), "floor": scenes.quad(0.6)}
    alone, around = (shot(ball(wax(0.9, 0.5), others, meshes)).read() for others in ((), inside))
    np.testing.assert_array_equal(alone, around)


def test_moved_and_scaled_objects_scatter_alike():
    """Draw the same in a body under the structure for instances, and in one whose mesh is scaled."""
    def body(scale):
        delta = ball(wax(0.7, 0.4))
        matrix = np.diag([scale, scale, scale, 1.0])
        delta.instances = dataclasses.replace(delta.instances, transforms=matrix[None])
        mesh = scenes.sphere(1.0 / scale, 24)
        return dataclasses.replace(delta, meshes={"ball": mesh})

    expected = mean(body(1.0), 64)
    assert mean(body(0.25), 64) == pytest.approx(expected, rel=0.01)
    session = shot(body(1.0), 1)
    moved = body(1.0).instances
    moved.transforms = moved.transforms.copy()
    moved.transforms[0, 0, 3] = 0.1
    session.update(types_delta(moved))
    moved.transforms = moved.transforms.copy()
    moved.transforms[0, 0, 3] = 0.0
    session.update(types_delta(moved))
    session.step(64)
    assert session.read()[..., :3].mean((0, 1)) == pytest.approx(expected, rel=0.01)


def types_delta(instances):
    """Return a delta of moved instances."""
    return dataclasses.replace(scenes.delta({}, [], {}), full=False, instances=instances, meshes={}, materials={},
                               lights=None, world=None)


def test_thin_bodies_let_light_through():
    """Light a slab from behind: light of the channel that goes far comes through, of the others none."""
    slab = scenes.box(1.0)
    slab.positions[:, 2] *= 0.05
    lamp = scenes.lamp("POINT", 100.0, scenes.place(z=-2.0), radius=0.2)
    materials = {"wax": wax(0.8, (0.2, 0.005, 0.0))}
    delta = scenes.delta({"slab": slab}, [("slab", np.eye(4), "wax")], materials, [lamp], 0.0)
    red, green, blue = mean(delta, 32, 0.4)
    assert red > 0.1 and green < 0.1 * red and blue == 0.0, (red, green, blue)


def lit_scene(body):
    """Return a coated body on a floor, lamps of two groups and a sky, a pane before a part of it."""
    materials = {"wax": body, "floor": scenes.material(color=(0.6, 0.4, 0.3)),
                 "veil": scenes.transparent(0.5, color=0.5)}
    lamps = [scenes.lamp("AREA", 30.0, scenes.place(x=0.5, z=2.5), shape="SQUARE", size_x=0.5, light_group="key"),
             scenes.lamp("POINT", 10.0, scenes.place(x=-1.5, z=1.5), radius=0.1, light_group="fill")]
    sky = scenes.world(0.3)
    return scenes.delta(
        {"ball": scenes.sphere(0.5, 16), "floor": scenes.quad(2.0), "veil": scenes.quad(0.3)},
        [("ball", scenes.place(z=0.5), "wax"), ("floor", scenes.place(), "floor"),
         ("veil", scenes.place(x=0.5, z=1.2), "veil")],
        materials, lamps, sky)


def coated_wax():
    """Make wax with everything above it."""
    return wax((0.9, 0.5, 0.3), 0.2, subsurface=0.7, specular_level=0.5, coat=0.5, coat_roughness=0.1, sheen=0.2,
               sheen_roughness=0.3)


def test_light_passes_make_up_the_picture():
    """Count light from below the surface as diffuse, and get Combined from the passes, with the same bits."""
    delta = lit_scene(coated_wax())
    session = shot(delta, 4, 0.8, PASSES)
    combined = session.read()
    total = session.read("Emission") + session.read("Environment")
    for lobe in ("Diffuse", "Glossy", "Transmission"):
        direct, indirect, color = (session.read(f"{lobe} {part}") for part in ("Direct", "Indirect", "Color"))
        assert direct.min() >= 0.0 and indirect.min() >= 0.0, lobe
        total = total + (direct + indirect) * color
    np.testing.assert_allclose(total, combined[..., :3], rtol=2e-5, atol=2e-5)
    np.testing.assert_array_equal(combined, shot(delta, 4, 0.8).read())
    # A body that reflects nothing sharply: all is diffuse.
    session = shot(lit_scene(wax(0.8, 0.2)), 4, 0.25, PASSES)
    parts = sum(session.read(f"Diffuse {part}") for part in ("Direct", "Indirect")) * session.read("Diffuse Color")
    np.testing.assert_allclose(parts, session.read()[..., :3], rtol=2e-5, atol=2e-5)


def test_light_groups_make_up_the_picture():
    """Give light from below the surface to the group of the lamp that it comes from."""
    names = ("Combined_key", "Combined_fill")
    delta = lit_scene(coated_wax())
    delta = dataclasses.replace(delta, world=scenes.world(0.0))
    session = shot(delta, 4, 0.8, ("Combined", *names))
    np.testing.assert_allclose(
        sum(session.read(name) for name in names), session.read()[..., :3], rtol=2e-5, atol=2e-5)
    only = dataclasses.replace(delta, lights=delta.lights[:1])
    key, alone = session.read(names[0]).mean(), shot(only, 16, 0.8).read()[..., :3].mean()
    assert key == pytest.approx(alone, rel=0.1)


def bent_below(normal):
    """Make wax whose normals are bent below z = 0."""
    builder = ProgramBuilder()
    below = builder.math("LESS_THAN", builder.component(builder.input("POSITION"), 2), 0.0)
    builder.closure("PRINCIPLED", 1.0, color=0.8, subsurface=1.0, subsurface_method="WALK", subsurface_radius=0.2,
                    normal=builder.vector("SCALE", normal, 0.0, below), **PLAIN)
    return dataclasses.replace(matte(), program=builder.finish())


def test_bump_bends_light_that_comes_out():
    """Take the normals where light comes out of a slab, not where it goes in: the sun is behind."""
    slab = scenes.box(1.0)
    slab.positions[:, 2] *= 0.05
    turned = np.diag([1.0, -1.0, -1.0, 1.0])
    sun, found = scenes.lamp("SUN", 1.0, turned, angle=0.01), []
    for normal in ((0.0, 0.0, 0.0), (0.8, 0.0, -0.6)):
        delta = scenes.delta({"slab": slab}, [("slab", np.eye(4), "wax")], {"wax": bent_below(normal)}, [sun], 0.0)
        found.append(mean(delta, 32, 0.4)[0])
    # 0.6 by the cosine, and more where the normal is turned so that it mirrors the way out (normals.py).
    assert 0.6 * found[0] < found[1] < 0.8 * found[0]
    both = types.MATERIAL_SUBSURFACE | types.MATERIAL_SUBSURFACE_BUMP
    assert subsurface_flags(bent_below((0.8, 0.0, -0.6)).program) == both
    assert subsurface_flags(wax().program) == types.MATERIAL_SUBSURFACE and subsurface_flags(matte().program) == 0


def launches(monkeypatch, delta):
    """Return the kernels that a round of the path tracer has recorded."""
    recorded = []
    real = wavefront.record

    def record(kernel, *args, **named):
        recorded.append(kernel.key)
        return real(kernel, *args, **named)

    with monkeypatch.context() as patch:
        patch.setattr(wavefront, "record", record)
        session = shot(delta, 1, size=(8, 8))
    return recorded, session


def test_other_scenes_pay_nothing(monkeypatch):
    """Record no walk, make no structure and keep no list without such a material: also for one on nothing drawn."""
    below = {"walk_below", "shade_exits", "shade_scattering_paths"}
    recorded, session = launches(monkeypatch, ball(wax()))
    assert below < set(recorded) and "shade_paths" not in recorded
    assert len(session._scene.structures.walks) == 1 and session._scene.rows["walk_mesh"][0] != 0
    coated = scenes.material("PRINCIPLED", color=0.5, coat=1.0, **PLAIN)
    unused = dataclasses.replace(ball(coated), materials={"wax": coated, "other": wax()})
    for delta in (ball(coated), unused, ball(matte())):
        recorded, session = launches(monkeypatch, delta)
        assert recorded and not below & set(recorded)
        assert not session._scene.structures.walks and not session._scene.rows["walk_mesh"].any()
    # A material that loses its radius gives everything back, one that gets it takes it.
    for material, count in ((wax(), 1), (matte(), 0)):
        session.update(dataclasses.replace(types_delta(None), materials={"wax": material}))
        assert len(session._scene.structures.walks) == count
        assert session._scene.material_table.subsurface.scatters == bool(count)


def test_other_materials_keep_their_bits():
    """Draw the other objects of a picture the same whether or not one of a scene scatters light below its surface."""
    coated = scenes.material("PRINCIPLED", color=0.5, coat=1.0, **PLAIN)
    far = [("ball", scenes.place(x=50.0), "black")]
    plain = ball(coated, far)
    scattering = dataclasses.replace(plain, materials={**plain.materials, "black": wax(0.0)})
    np.testing.assert_array_equal(shot(plain, 4).read(), shot(scattering, 4).read())


def test_pictures_at_rest_become_the_path_tracer_s():
    """Draw about what light does below the surface in frames, and come to it when the picture rests."""
    settings = dataclasses.replace(scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME))
    session = Session(settings)
    session.update(ball(wax(0.5, 1.0)))
    session.configure(settings, scenes.camera_above(half=0.5), *SIZE)
    session.step(4)
    assert session.read()[..., :3].mean() == pytest.approx(0.859, rel=0.08)
    session.step(124)
    assert session.read()[..., :3].mean() == pytest.approx(0.859, rel=0.02)


