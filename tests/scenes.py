# SPDX-License-Identifier: GPL-3.0-or-later
"""Small scenes for tests, built from plain data without Blender: the stress test's parts in the tests' short forms."""

import functools
from dataclasses import replace

from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import CameraData, MaterialData, WorldData
from burnish.engine.session import Session
from burnish.engine.settings import (
    Device,
    FilmSettings,
    Integrator,
    LightPathSettings,
    PixelFilter,
    RenderSettings,
    SamplingSettings,
)
from burnish.engine.stress import scenes as made
from burnish.engine.stress.scenes import emitter, lamp, place, sphere
from burnish.engine.stress.scenes import make_mesh as mesh

from tests.device import DEVICE

__all__ = ["SETTINGS", "box", "camera_above", "delta", "emitter", "instances", "lamp", "material", "mesh",
           "place", "quad", "render", "sphere", "transparent", "world"]

SETTINGS = RenderSettings(
    device=Device(DEVICE.partition(":")[0]), film=FilmSettings(pixel_filter=PixelFilter.BOX),
    sampling=SamplingSettings(integrator=Integrator.REFERENCE))
"""The reference integrator on the device that `pytest --device` names"""

world = functools.cache(made.world)


def quad(size=2.0, z=0.0):
    """Make a square of half side `size` facing +z, with UVs 0..1."""
    square = made.quad(size)
    square.positions[:, 2] = z
    return square


def box(size=1.0, inward=False):
    """Make a cube of half side `size`."""
    return made.box((-size,) * 3, (size,) * 3, inward=inward)


def material(kind="DIFFUSE", **arguments):
    """Make a material of one closure, its kind and inputs named as ProgramBuilder.closure names them."""
    return made.material(kind, **{"multiscatter": False, **arguments})


def transparent(weight, kind="DIFFUSE", **arguments):
    """Make a material that lets `weight` of the light through."""
    builder = ProgramBuilder()
    builder.transparent((1.0, 1.0, 1.0), weight)
    builder.closure(kind, 1.0 - weight, **arguments)
    return MaterialData(name="transparent", program=builder.finish(), has_transparency=True)


def placed(objects):
    """Return objects given as (mesh key, transform, material key[, visibility])."""
    return [made.Placed(mesh, material, transform, *rest) for mesh, transform, material, *rest in objects]


def instances(objects):
    """Make a table of (mesh key, transform, material key[, visibility])."""
    return made.make_table(placed(objects))


def delta(meshes, objects, materials, lights=(), background=0.0):
    """Make a full SceneDelta of objects as of `instances`."""
    sky = background if isinstance(background, WorldData) else world(background)
    return made.make_delta(meshes, placed(objects), materials, lights, sky)


def camera_above(height=3.0, half=0.5, orthographic=True, **fields):
    """Make a camera that looks down from z = height, seeing [-half, half]^2 of the plane z = 0."""
    window = (-half, half, -half, half) if orthographic else tuple(w / height for w in (-half, half, -half, half))
    fields.setdefault("clip_start", 1e-3)
    return CameraData(
        kind="orthographic" if orthographic else "perspective",
        transform=tuple(place(z=height).ravel()), window=window, **fields)


def render(scene_delta, camera=None, size=(8, 8), samples=64, settings=SETTINGS, passes=("Combined",), **paths):
    """Render a delta and return the Combined picture [h, w, 4] (and the session where passes are asked for)."""
    if paths:
        settings = replace(settings, light_paths=LightPathSettings(**paths))
    session = Session(settings)
    session.update(scene_delta)
    session.configure(settings, camera or camera_above(), *size, passes=passes)
    session.step(samples)
    return (session.read(), session) if passes != ("Combined",) else session.read()
