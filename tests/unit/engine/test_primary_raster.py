# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawing triangles finds what rays find: the same triangle and layer in every pixel, wherever the camera is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine import wide_bvh
from burnish.engine.hair import Strands, make_tubes
from burnish.engine.passes.primary_raster import GROUPS
from burnish.engine.scene import MeshData
from burnish.engine.stress.surfaces import ROOM_SIZE, on_floor, slivers
from burnish.kernels.raster import LANES, raster_tiles
from burnish.kernels.raster_pixels import LARGEST_BITS

from tests import scenes
from tests.gbuffer_frames import GBufferFrames

GREY = {"grey": scenes.material(color=0.5), "veil": scenes.transparent(0.5)}
SIZE = (173, 97)
"""Not a whole number of tiles or blocks either way"""
JITTER = (0.3, -0.2)


def soup(count, seed, size, spread, *, slivers=False):
    """Return `count` random triangles about the origin: edges of about `size`, centres within `spread` [m]."""
    random = np.random.default_rng(seed)
    centres = random.uniform(-spread, spread, (count, 1, 3))
    offsets = random.normal(0.0, size, (count, 3, 3))
    if slivers:
        offsets[:, 2] = offsets[:, 0] + 1e-3 * offsets[:, 2]
    positions = (centres + offsets).reshape(-1, 3).astype(np.float32)
    return scenes.mesh(positions, np.arange(3 * count).reshape(-1, 3))


def camera(half=0.6, *, at=6.0, orthographic=False, **fields):
    """Return a camera at z = `at` that looks down and is wider than high, as the pictures here are.

    It stands askew, so that no ray goes right through an edge of what is symmetric.
    """
    wide = half * SIZE[0] / SIZE[1]
    made = scenes.camera_above(1.0, half, orthographic=orthographic)
    fields.setdefault("transform", tuple(scenes.place(0.0123, 0.0371, at).ravel()))
    return dataclasses.replace(made, window=(-wide, wide, -half, half), **fields)


def found(delta, view, rasterizing, jitter=JITTER, part=None, size=SIZE, **change):
    """Return the hits of a frame's primary rays, and the layers before them; `part`: (size of the whole, corner)."""
    frames = GBufferFrames(delta, size, rasterizing=rasterizing)
    frames.full, frames.corner = part or (None, (0, 0))
    for name, value in change.items():
        setattr(frames.gbuffer_pass.raster, name, value)
    frames.gbuffer_pass.resize(*size)
    frames.frame(view, np.array(jitter))
    hits = frames.gbuffer_pass.hits
    names = ("t", "hit", "barycentrics", *(("layer",) if frames.scene.structures.has_filtered else ()))
    return {name: getattr(hits, name).numpy().copy() for name in names}


def compare(delta, view, differing=0, **arguments):
    """Demand that drawing and rays agree but for some pixels, through which an edge goes; return the hits."""
    drawn, traced = (found(delta, view, rasterizing, **arguments) for rasterizing in (True, False))
    same = (drawn["hit"] == traced["hit"]).all(1)
    if "layer" in traced:
        same &= (drawn["layer"] == traced["layer"]).all(1)
    assert (~same).sum() <= differing
    np.testing.assert_allclose(drawn["t"][same], traced["t"][same], rtol=2e-6)
    hit = same & (traced["hit"][:, 0] >= 0)
    np.testing.assert_allclose(drawn["barycentrics"][hit], traced["barycentrics"][hit], atol=2e-4)
    return traced


def one(mesh, name="grey"):
    """Return a scene of one mesh."""
    return scenes.delta({"mesh": mesh}, [("mesh", np.eye(4), name)], GREY)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize(("count", "size", "spread"), [(4000, 0.03, 3.0), (600, 0.4, 3.0), (40, 4.0, 2.0)])
def test_triangles_of_all_sizes(count, size, spread, orthographic):
    """Draw triangles of less than a pixel, of some tiles, and of most of the picture."""
    half = 3.0 if orthographic else 0.6
    hits = compare(one(soup(count, 1, size, spread)), camera(half, orthographic=orthographic), differing=2)
    assert 0.03 < (hits["hit"][:, 0] >= 0).mean() < 1.0


@pytest.mark.parametrize("clip", [1e-6, 0.1, 5.0])
def test_camera_among_triangles(clip):
    """Draw what lies beside, behind and across the plane of the camera, from near and far clip planes on."""
    view = camera(at=0.0, clip_start=clip, clip_end=9.0)
    hits = compare(one(soup(300, 2, 3.0, 3.0)), view, differing=3)
    assert (hits["hit"][:, 0] >= 0).any()


@pytest.mark.parametrize("orthographic", [False, True])
def test_part_of_a_frame(orthographic):
    """Draw a border's part of a larger frame, and what lies across its sides."""
    view = camera(3.0 if orthographic else 0.6, orthographic=orthographic)
    part = ((2 * SIZE[0], 2 * SIZE[1]), (60, 35))
    hits = compare(one(soup(300, 9, 0.7, 3.0)), view, differing=2, part=part)
    assert (hits["hit"] != found(one(soup(300, 9, 0.7, 3.0)), view, False)["hit"]).any()


def test_tubes_of_hair():
    """Draw strands, each piece of which is one item of the BVH, and what lies between them."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-3, 3, (300, 1, 3)) + np.linspace(0, 1.5, 5)[:, None] * rng.normal(size=(300, 1, 3))
    radii = rng.uniform(0.005, 0.06, (300, 1)) * np.linspace(1, 0.3, 5)
    radii[::3, -1] = 0.0
    hair = make_tubes(Strands(
        points.reshape(-1, 3).astype(np.float32), radii.ravel().astype(np.float32), np.full(300, 5)), 2)
    loose = soup(200, 1, 0.1, 3.0)
    positions = np.concatenate([loose.positions, hair.positions])
    made = one(scenes.mesh(positions, np.concatenate([loose.triangles, hair.triangles + len(loose.positions)])))
    hits = compare(made, camera(), differing=4)
    assert 0.2 < (hits["hit"][:, 0] >= 0).mean() < 1.0
    frames = GBufferFrames(made, SIZE, rasterizing=True)
    assert frames.scene.structures.opaque.wide.tubes


def test_slivers_and_points():
    """Draw triangles that are lines or points, of which few pixels' rays meet any."""
    compare(one(soup(3000, 3, 1.0, 3.0, slivers=True)), camera(), differing=3)
    compare(one(soup(100, 3, 0.0, 3.0)), camera())


@pytest.mark.slow
def test_slivers_lie_where_they_are():
    """Meet a floor of triangles 200,000 times as long as wide where rays do, whichever of them a pixel shows.

    Neither their planes nor the depths at which they are drawn are exact: pixels lay up to a hundredth of the way off.
    """
    scene = on_floor(slivers(2.0, 200000))
    drawn, traced = (
        found(scene.delta, scene.camera, rasterizing, size=ROOM_SIZE) for rasterizing in (True, False))
    assert (drawn["hit"][:, 0] == traced["hit"][:, 0]).all() and (drawn["hit"][:, 0] >= 0).mean() > 0.5
    np.testing.assert_allclose(drawn["t"], traced["t"], rtol=2e-6)


def test_surfaces_have_no_holes():
    """Find a closed surface in all of its pixels: a ball of many small triangles, and the inside of a box."""
    ball = compare(one(scenes.sphere(2.9, 96)), camera(at=0.0))
    assert (ball["hit"][:, 0] == 0).all()
    box = compare(one(scenes.box(3.0, inward=True)), camera(at=0.5))
    assert (box["hit"][:, 0] == 0).all()


def test_coplanar_duplicates_show_the_same_one():
    """Choose the triangle that rays choose where several lie in one plane."""
    delta = scenes.delta(
        {"mesh": scenes.quad(1.0)}, [("mesh", np.eye(4), "grey"), ("mesh", np.eye(4), "grey")], GREY)
    assert (compare(delta, camera())["hit"][:, 0] < 1).all()


def test_full_lists_lose_nothing():
    """Draw at once what the lists have no room for."""
    delta = one(soup(40, 4, 4.0, 2.0))
    for room in ({"tiles": 5}, {"blocks": 1}, {"records": 7}, {"tiles": 1, "blocks": 1}):
        drawn = found(delta, camera(), True, **room)
        whole = found(delta, camera(), True)
        for name, values in whole.items():
            np.testing.assert_array_equal(drawn[name], values)


def test_split_triangles_are_drawn_once(monkeypatch):
    """Leave out the further references to triangles that entered the structure in parts."""
    monkeypatch.setattr(wide_bvh, "SPLIT_AREA", 1.0)
    random = np.random.default_rng(5)
    first, along = random.uniform(-3.0, 3.0, (1500, 3)), 2.0 * random.normal(size=(1500, 3))
    third = first + 0.6 * along + 0.05 * random.normal(size=(1500, 3))
    positions = np.stack([first, first + along, third], 1).reshape(-1, 3)
    delta = one(scenes.mesh(positions.astype(np.float32), np.arange(4500).reshape(-1, 3)))
    frames = GBufferFrames(delta, SIZE, rasterizing=True)
    wide = frames.scene.structures.opaque.wide
    assert wide.split and wide.triangle_count == 1500 < wide.references
    compare(delta, camera(), differing=3)


def test_layers_before_what_is_shown():
    """Note exactly the pixels where rays have a layer to look for."""
    meshes = {"veil": soup(60, 6, 0.5, 2.0), "mesh": soup(60, 7, 0.8, 2.0)}
    delta = scenes.delta(meshes, [("veil", np.eye(4), "veil"), ("mesh", np.eye(4), "grey")], GREY)
    hits = compare(delta, camera(), differing=2)
    layered = hits["layer"][:, 0] >= 0
    assert 0.05 < layered.mean() < 0.9
    frames = GBufferFrames(delta, SIZE, rasterizing=True)
    frames.frame(camera(), np.array(JITTER))
    veiled = frames.gbuffer_pass.raster.seen.veiled.numpy() == 1
    assert veiled[layered].all() and (veiled & ~layered).mean() < 0.01


def test_a_single_pixel_with_layers():
    """Draw layers into pictures of one pixel, and of more after it."""
    meshes = {"veil": scenes.quad(4.0), "mesh": scenes.quad(4.0)}
    delta = scenes.delta(meshes, [("veil", scenes.place(0.0, 0.0, 1.0), "veil"), ("mesh", np.eye(4), "grey")], GREY)
    for size in ((1, 1), (2, 1)):
        hits = compare(delta, camera(), size=size)
        assert (hits["layer"][:, 0] >= 0).all()


def test_instances_beside_what_is_flattened():
    """Show instances that have left the flattened structure, before and behind it, and their layers."""
    meshes = {"veil": soup(60, 6, 0.5, 2.0), "mesh": soup(60, 7, 0.8, 2.0), "ball": scenes.sphere(1.0, 16)}
    objects = [("veil", np.eye(4), "veil"), ("mesh", np.eye(4), "grey"), ("ball", np.eye(4), "grey"),
               ("veil", scenes.place(0.5), "veil")]
    pictures = []
    for rasterizing in (True, False):
        frames = GBufferFrames(scenes.delta(meshes, objects, GREY), SIZE, rasterizing=rasterizing)
        frames.frame(camera(), np.array(JITTER))
        moved = [*objects[:2], ("ball", scenes.place(0.7), "grey"), ("veil", scenes.place(0.2), "veil")]
        frames.update(dataclasses.replace(scenes.delta({}, moved, {}), full=False))
        frames.frame(camera(), np.array(JITTER))
        assert int(frames.scene.scene.geometry.instanced.nodes) != 0
        hits = frames.gbuffer_pass.hits
        pictures.append({name: getattr(hits, name).numpy().copy() for name in ("hit", "layer")})
    for name in ("hit", "layer"):
        assert (pictures[0][name] != pictures[1][name]).any(1).sum() <= 2
        assert len(np.unique(pictures[0][name][:, 0])) >= 3


def test_far_from_the_origin_and_hostile():
    """Lose no pixel of a scene that lies far away, whose vertices are inexact, or that has vertices nobody can see."""
    far = scenes.place(3e4, -2e4, 1e4)
    mesh = soup(300, 8, 0.8, 3.0)
    delta = scenes.delta({"mesh": mesh}, [("mesh", far, "grey"), ("mesh", np.eye(4), "grey")], GREY)
    view = camera()
    matrix = np.array(view.transform).reshape(4, 4)
    matrix[:3, 3] += far[:3, 3]
    # Coordinates there are exact to 2 mm, a thirtieth of a pixel.
    compare(delta, dataclasses.replace(view, transform=tuple(matrix.ravel())), differing=60)
    hostile = MeshData(**{**mesh.__dict__, "positions": mesh.positions.copy()})
    hostile.positions[::30] = 1e6
    compare(one(hostile), camera(), differing=3)


def test_what_covers_a_tile_hides_what_is_behind():
    """Note the depth of a wall in tiles, and draw nothing in tiles that something nearer covers."""
    wall, behind = scenes.quad(20.0), soup(300, 7, 0.7, 1.0)
    behind.positions[:, 2] -= 3.0
    delta = scenes.delta(
        {"wall": wall, "behind": behind}, [("wall", np.eye(4), "grey"), ("behind", np.eye(4), "grey")], GREY)
    frames = GBufferFrames(delta, SIZE, rasterizing=True)
    frames.frame(camera(), np.array(JITTER))
    raster, seen = frames.gbuffer_pass.raster, frames.gbuffer_pass.raster.seen
    covers = seen.covers.numpy()
    assert covers.shape == (11 * 7,)
    # Not where the two triangles of the wall meet.
    known = covers > 0
    assert 0.7 < known.mean() < 1.0
    np.testing.assert_allclose((int(LARGEST_BITS) - covers[known]).astype(np.int32).view(np.float32), 6.0, rtol=1e-5)
    whole = seen.nearest.numpy()
    drawn = []
    for cover in (0, int(LARGEST_BITS) - int(np.float32(0.5).view(np.int32))):
        seen.nearest.zero_()
        seen.covers.fill_(cover)
        wp.launch(
            raster_tiles, GROUPS * int(LANES),
            [frames.views.array, *SIZE, 0, GROUPS, raster.lists], [seen], device=frames.gbuffer_pass.device)
        drawn.append(seen.nearest.numpy())
    np.testing.assert_array_equal(drawn[0], whole)
    assert not drawn[1].any()


@pytest.mark.parametrize("orthographic", [False, True])
def test_walls_behind_one_another(orthographic):
    """Draw slanted walls of many tiles each, of which nearer ones hide a part."""
    random = np.random.default_rng(11)
    corners = np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], np.float32)
    positions = []
    for depth in np.linspace(-4.0, 3.0, 60):
        tilt = random.normal(0.0, 0.15, 2)
        shift = random.uniform(-7.0, 7.0, 2)
        positions.append(corners + [*shift, depth] + [0, 0, 1] * (corners @ [*tilt, 0])[:, None])
    count = len(positions)
    triangles = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(count)])
    mesh = scenes.mesh(np.concatenate(positions).astype(np.float32), triangles)
    hits = compare(one(mesh), camera(3.0 if orthographic else 0.6, orthographic=orthographic), differing=4)
    assert len(np.unique(hits["hit"][:, 1])) > 8
