# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the G-buffer's frames: positions, materials, alpha, visible lamps, motion and reprojection."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine.debug_views import DEBUG_VIEWS
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.passes.gbuffer import GBufferPass
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import MaterialData, SceneDelta, Visibility
from burnish.kernels import gbuffer
from burnish.kernels.gbuffer_store import FILTER_VARIANCE

from tests import scenes
from tests.gbuffer_frames import GBufferFrames

GREY = {"grey": scenes.material(color=0.5)}


def plane_and_ball(ball=(0.0, 0.0, 1.0), **fields):
    """Return a scene of a large plane and a ball of radius 0.5."""
    return scenes.delta(
        {"plane": scenes.quad(20.0), "ball": scenes.sphere(0.5, 24)},
        [("plane", np.eye(4), "grey"), ("ball", scenes.place(*ball), "grey")], GREY, **fields)


def lacquered_glass():
    """Return a material of rough glass under a sharper coat, of the name of GREY's."""
    return {"grey": scenes.material(
        "PRINCIPLED", color=0.9, roughness=0.6, ior=1.5, specular_level=0.5, specular_tint=1.0, transmission=0.5,
        coat=1.0, coat_roughness=0.1, coat_ior=1.5, coat_tint=1.0, multiscatter=True)}


def tilted_camera(height=3.0, angle=0.5, x=0.0):
    """Return a perspective camera that looks down at an angle [rad] from the vertical."""
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.eye(4)
    matrix[:3, :3] = [[1, 0, 0], [0, c, -s], [0, s, c]]
    matrix[:3, 3] = x, -height * np.tan(angle), height
    return dataclasses.replace(scenes.camera_above(height, 1.0, orthographic=False), transform=tuple(matrix.ravel()))


def exact_points(frames, picture):
    """Return the hit points [h, w, 3] by the barycentrics of the ray query."""
    store = frames.scene.store
    hit = picture["hit"]
    uv = frames.gbuffer_pass.hits.barycentrics.numpy().reshape(*hit.shape[:2], 2).astype(np.float64)
    corners = store.positions.array.numpy()[store.triangles.array.numpy()[hit[..., 1]]].astype(np.float64)
    weights = np.stack([1 - uv.sum(-1), uv[..., 0], uv[..., 1]], -1)
    local = (corners * weights[..., None]).sum(-2)
    matrices = frames.scene.rows["to_world"][hit[..., 0]].astype(np.float64)
    return np.einsum("hwij,hwj->hwi", matrices[..., :3, :3], local) + matrices[..., :3, 3]


@pytest.mark.parametrize("orthographic", [False, True])
def test_positions_from_depth_are_the_hits(orthographic):
    """Get back, from depth and jittered film position, the points that the rays have met."""
    frames = GBufferFrames(plane_and_ball(), (24, 20))
    camera = scenes.camera_above(3.0, 1.0, orthographic=True) if orthographic else tilted_camera()
    picture = frames.shot(camera, jitter=np.array([-0.4, 0.4]))
    assert set(np.unique(picture["hit"][..., 0])) == {0, 1}
    # Barycentrics are floats: on a plane 40 across they round by up to 5e-6.
    np.testing.assert_allclose(picture["position"], exact_points(frames, picture), atol=8e-6)


def test_normals_face_the_camera():
    """Pack shading and geometric normals on the camera's side."""
    frames = GBufferFrames(plane_and_ball(), (24, 24))
    picture = frames.shot(scenes.camera_above(3.0, 1.0))
    ball = picture["hit"][..., 0] == 1
    assert (picture["normal"][~ball] == (0, 0, 1)).all()
    outward = (picture["position"][ball] - (0, 0, 1)) / 0.5
    assert ((picture["normal"][ball] * outward).sum(-1) > 0.99).all()
    assert ((picture["geometric_normal"][ball] * outward).sum(-1) > 0.98).all()


def test_materials_are_packed():
    """Find colours, roughness and exposed emission of each material in its pixels."""
    builder = ProgramBuilder()
    builder.emit((1.0, 2.0, 3.0), 1.0, 1.0)
    builder.closure("PRINCIPLED", 1.0, color=(1.0, 0.6, 0.2), metallic=1.0, roughness=0.25, ior=1.5, multiscatter=True)
    materials = {
        "paint": scenes.material(color=(0.2, 0.5, 0.8)),
        "metal": MaterialData(name="metal", program=builder.finish(), has_emission=True),
        "leaf": scenes.material("TRANSLUCENT", color=(0.1, 0.3, 0.0))}
    objects = [("plane", scenes.place(x=x), name) for x, name in ((-2, "paint"), (0, "metal"), (2, "leaf"))]
    frames = GBufferFrames(scenes.delta({"plane": scenes.quad(1.0)}, objects, materials), (30, 10))
    picture = frames.shot(scenes.camera_above(half=3.0), exposure=2.0)
    paint, metal, leaf = (picture["hit"][5][x] for x in (5, 15, 25))
    assert [int(hit[0]) for hit in (paint, metal, leaf)] == [0, 1, 2]
    row = {name: values[5] for name, values in picture.items()}
    np.testing.assert_allclose(row["diffuse"][5], (0.2, 0.5, 0.8), atol=2e-3)
    assert (row["specular"][5] == 0).all() and (row["translucent"][5] == 0).all()
    np.testing.assert_allclose(row["specular"][15], (1.0, 0.6, 0.2), rtol=0.02)
    np.testing.assert_allclose(row["f0"][15], (1.0, 0.6, 0.2), rtol=0.04)
    np.testing.assert_allclose(row["roughness"][15], 0.25, atol=1e-4)
    np.testing.assert_allclose(row["emission"][15], (2.0, 4.0, 6.0, 1.0))
    assert row["flags"][15] & int(gbuffer.SURFACE_EMITS) and not row["flags"][5] & int(gbuffer.SURFACE_EMITS)
    np.testing.assert_allclose(row["translucent"][25], (0.1, 0.3, 0.0), atol=2e-3)
    assert (row["diffuse"][15] == 0).all() and (row["diffuse"][25] == 0).all()


def test_mixed_materials_average_over_frames():
    """Draw one of two closures in each frame, so that their mean is the mix."""
    builder = ProgramBuilder()
    builder.closure("DIFFUSE", 0.75, color=(0.8, 0.0, 0.0))
    builder.closure("DIFFUSE", 0.25, color=(0.0, 0.8, 0.0))
    mix = MaterialData(name="mix", program=builder.finish())
    frames = GBufferFrames(scenes.delta({"plane": scenes.quad()}, [("plane", np.eye(4), "mix")], {"mix": mix}), (8, 8))
    mean = np.mean([frames.shot()["diffuse"] for _ in range(32)], 0)
    np.testing.assert_allclose(mean[..., 0], 0.6, atol=0.06)
    np.testing.assert_allclose(mean[..., 1], 0.2, atol=0.06)


def test_roughness_is_widened_where_normals_vary():
    """Widen the roughness of a small ball, less of a near one, and not at all of a plane."""
    shiny = {"grey": scenes.material("GLOSSY", color=0.9, roughness=0.1)}
    widths = []
    for half in (1.0, 20.0):
        delta = plane_and_ball()
        delta.materials = shiny
        frames = GBufferFrames(delta, (25, 25))
        picture = frames.shot(scenes.camera_above(3.0, half))
        assert picture["hit"][12, 12, 0] == 1
        widths.append(picture["roughness"][12, 12])
        assert abs(picture["roughness"][0, 0] - 0.1) < 1e-4
    near = np.sqrt(np.sqrt(0.1**4 + ball_widening()))
    np.testing.assert_allclose(widths, [near, np.sqrt(np.sqrt(0.1**4 + 0.18))], rtol=0.03)


def ball_widening():
    """Return what alpha^2 grows by at a ball's middle, 25 pixels of which are two metres."""
    # Squared change of the normal over a pixel's width w on radius r: 2 (w / r)^2; alpha^2 grows by 2 sigma^2 of it.
    return min(4.0 * float(FILTER_VARIANCE) * (2.0 / 25 / 0.5) ** 2, 0.18)


def test_wide_lobes_are_widened_less_and_the_widest_not_at_all():
    """Widen a ball of medium roughness by half of what a smooth one is, and leave a rough one as it is."""
    for roughness, share in ((0.3, 1.0), (0.5, 0.5), (0.6, 0.0), (0.9, 0.0)):
        delta = plane_and_ball()
        delta.materials = {"grey": scenes.material("GLOSSY", color=0.9, roughness=roughness)}
        picture = GBufferFrames(delta, (25, 25)).shot(scenes.camera_above(3.0, 1.0))
        added = picture["roughness"][12, 12].astype(np.float64)**4 - roughness**4
        np.testing.assert_allclose(added, share * ball_widening(), rtol=0.06, atol=1e-4)


def test_coat_and_glass_are_packed():
    """Find the coat's albedo and roughness, widened over a base that is not, and what glass lets through."""
    delta = plane_and_ball()
    delta.materials = lacquered_glass()
    frames = GBufferFrames(delta, (25, 25))
    picture = frames.shot(scenes.camera_above(3.0, 1.0))
    plane, ball = ({name: picture[name][i, i] for name in (
        "coat", "coat_roughness", "roughness", "specular", "transmitted", "diffuse")} for i in (0, 12))
    np.testing.assert_allclose([plane["coat_roughness"], plane["roughness"]], [0.1, 0.6], atol=1e-3)
    np.testing.assert_allclose(ball["roughness"], 0.6, atol=1e-3)
    np.testing.assert_allclose(ball["coat_roughness"], (0.1**4 + ball_widening())**0.25, rtol=0.01)
    # Index 1.5 along the normal, and what the coat lets through to the base: half of it is glass.
    np.testing.assert_allclose(ball["coat"], 0.04, atol=1e-3)
    np.testing.assert_allclose(ball["specular"], 0.04 + 0.96 * 0.04, atol=0.01)
    np.testing.assert_allclose(ball["transmitted"], 0.96 * 0.96 * np.sqrt(0.9) / 2, rtol=0.03)
    np.testing.assert_allclose(ball["diffuse"], 0.96 * 0.96 * 0.9 / 2, rtol=0.02)


def test_transparency_averages_to_alpha():
    """Pass a half transparent plane in about as many frames as it lets light through."""
    frames = GBufferFrames(scenes.delta(
        {"plane": scenes.quad()}, [("plane", np.eye(4), "veil")], {"veil": scenes.transparent(0.7, color=0.5)},
        background=1.0), (8, 8))
    pictures = [frames.shot(transparent=True) for _ in range(32)]
    alpha = np.mean([picture["emission"][..., 3].astype(np.float64) for picture in pictures])
    assert abs(alpha - 0.3) < 0.03
    seen = pictures[0]["hit"][..., 0] == 0
    np.testing.assert_allclose(pictures[0]["diffuse"][seen], 0.5, atol=2e-3)


def test_alpha_of_world_and_holdout():
    """Leave alpha 1 on surfaces and an opaque world, 0 on a transparent world and on holdouts."""
    objects = [("plane", scenes.place(x=-2.0), "grey"),
               ("plane", scenes.place(x=2.0), "grey", int(Visibility.ALL | Visibility.HOLDOUT))]
    frames = GBufferFrames(scenes.delta({"plane": scenes.quad(1.0)}, objects, GREY, background=0.25), (30, 30))
    camera = scenes.camera_above(half=3.0)
    opaque, clear = frames.shot(camera, exposure=2.0), frames.shot(camera, transparent=True)
    np.testing.assert_allclose(opaque["emission"][15, [5, 15, 25]], [[0, 0, 0, 1], [0.5, 0.5, 0.5, 1], [0, 0, 0, 0]])
    np.testing.assert_allclose(clear["emission"][15, [5, 15, 25], 3], [1, 0, 0])
    assert (opaque["diffuse"][15, 25] == 0).all() and opaque["hit"][15, 25, 0] == 1
    assert opaque["hit"][15, 15, 0] == -1 and opaque["depth"][15, 15] >= 1e18


def test_objects_hidden_from_the_camera_are_not_shown():
    """Look through an object that only other rays see."""
    delta = plane_and_ball()
    delta.instances.visibility[1] = int(Visibility.ALL & ~Visibility.CAMERA)
    frames = GBufferFrames(delta)
    assert frames.scene.structures.has_filtered
    assert (frames.shot(scenes.camera_above(3.0, 1.0))["hit"][..., 0] == 0).all()


def test_bad_numbers_stay_out():
    """Store nothing that is not finite, whatever a material says."""
    builder = ProgramBuilder()
    builder.emit((np.inf, 1.0, np.nan), 1.0, 1.0)
    builder.closure("PRINCIPLED", 1.0, color=(np.nan, 1e30, -1.0), metallic=0.5, roughness=np.nan, ior=np.inf)
    bad = MaterialData(name="bad", program=builder.finish(), has_emission=True)
    frames = GBufferFrames(scenes.delta({"plane": scenes.quad()}, [("plane", np.eye(4), "bad")], {"bad": bad}))
    picture = frames.shot(scenes.camera_above())
    assert (picture["hit"][..., 0] == 0).all()
    for name, values in picture.items():
        assert np.isfinite(values.astype(np.float64)).all(), name


@pytest.mark.parametrize("count", [1, 40])
def test_lamps_are_seen(count):
    """Show lamps with an extent in front of surfaces, whether tested one by one or found through the tree."""
    up = np.diag([1.0, -1.0, -1.0, 1.0])
    lamps = [scenes.lamp("AREA", 10.0, scenes.place(x=3.0 * i, z=1.0) @ up, shape="SQUARE", size_x=0.45)
             for i in range(count)]
    below = scenes.lamp("AREA", 10.0, scenes.place(z=-1.0) @ up, shape="SQUARE", size_x=5.0)
    frames = GBufferFrames(scenes.delta(
        {"plane": scenes.quad(200.0)}, [("plane", np.eye(4), "grey")], GREY, [*lamps, below]), (20, 20))
    emission = frames.shot(scenes.camera_above(half=1.0))["emission"][..., :3].astype(np.float64)
    lit = emission[..., 0] > 0
    assert lit.sum() == 16 and lit[8:12, 8:12].all()
    assert np.ptp(emission[lit]) == 0.0


def test_rest_reprojects_onto_itself():
    """Find every pixel of a resting picture at its own centre, jitter or not, with all taps of the same surface."""
    frames = GBufferFrames(plane_and_ball(), (24, 24))
    camera = tilted_camera()
    first = frames.shot(camera, jitter=np.array([-0.5, 0.5]))
    assert (first["taps"] == 0).all()
    before = first
    for _ in range(3):
        picture = frames.shot(camera, jitter=np.array([-0.5, 0.5]))
        y, x = np.mgrid[:24, :24] + 0.5
        assert (picture["before"] == np.stack([x, y], -1)).all()
        assert (picture["motion"] == 0).all()
        plane = (picture["hit"][..., 0] == 0) & (before["hit"][..., 0] == 0)
        before = picture
        calm = plane[1:-1, 1:-1] & plane[:-2, 1:-1] & plane[2:, 1:-1] & plane[1:-1, :-2] & plane[1:-1, 2:]
        calm &= plane[2:, 2:] & plane[2:, :-2] & plane[:-2, 2:] & plane[:-2, :-2]
        assert calm.sum() > 100 and (picture["taps"][1:-1, 1:-1][calm] == 15).all()
        assert (picture["taps"] & 1).mean() > 0.95


def test_motion_of_an_object():
    """See a ball move by its shift in pixels and the plane rest; what it uncovers has no history."""
    frames = GBufferFrames(plane_and_ball(), (40, 40))
    camera = scenes.camera_above(3.0, 1.0)
    frames.shot(camera)
    moved = plane_and_ball((0.2, 0.1, 1.0))
    frames.update(SceneDelta(instances=moved.instances))
    picture = frames.shot(camera)
    ball = picture["hit"][..., 0] == 1
    np.testing.assert_allclose(picture["motion"][ball], np.broadcast_to((4.0, 2.0), (ball.sum(), 2)), atol=2e-4)
    assert (np.abs(picture["motion"][~ball]) < 1e-5).all()
    flags = picture["moved"]
    assert (flags[ball] != 0).all() and (flags[~ball] == 0).all()
    # The pixels at the ball's centre find it there; the plane does not take the ball for itself.
    assert picture["taps"][20, 20] == 15
    y, x = np.mgrid[:40, :40] + 0.5
    was = np.hypot(x - 20, y - 20) < 9
    uncovered = ~ball & was
    assert uncovered.sum() > 10 and (picture["taps"][uncovered] == 0).all()
    still = frames.shot(camera)
    assert (still["motion"] == 0).all() and (still["moved"] == 0).all()


def test_motion_of_a_deforming_mesh():
    """See the vertices of an edited mesh move, twice in a row, and rest after it."""
    frames = GBufferFrames(plane_and_ball(), (20, 20))
    camera = scenes.camera_above(3.0, 1.0)
    frames.shot(camera)
    for shift in (0.1, 0.3):
        ball = scenes.sphere(0.5, 24)
        ball.positions = ball.positions + np.array([shift, 0, 0], np.float32)
        frames.update(SceneDelta(meshes={"ball": ball}))
        picture = frames.shot(camera)
        mask = picture["hit"][..., 0] == 1
        expected = 1.0 if shift == 0.1 else 2.0
        np.testing.assert_allclose(picture["motion"][mask][:, 0], expected, atol=2e-4)
        assert (np.abs(picture["motion"][~mask]) < 1e-5).all() and picture["taps"][10, 12] == 15
    assert (frames.shot(camera)["motion"] == 0).all()


def test_motion_survives_new_objects():
    """Follow an object by its key when others come, whatever its place in the list is then."""
    meshes = {"ball": scenes.sphere(0.5, 16)}
    one = scenes.delta(meshes, [("ball", np.eye(4), "grey")], GREY)
    one.instances.object_keys = ["old"]
    frames = GBufferFrames(one, (20, 20))
    camera = scenes.camera_above(3.0, 1.0)
    frames.shot(camera)
    two = scenes.delta(meshes, [("ball", scenes.place(x=5.0), "grey"), ("ball", scenes.place(x=0.2), "grey")], GREY)
    two.instances.object_keys = ["new", "old"]
    frames.update(SceneDelta(instances=two.instances))
    picture = frames.shot(camera)
    ball = picture["hit"][..., 0] == 1
    np.testing.assert_allclose(picture["motion"][ball], np.broadcast_to((2.0, 0.0), (ball.sum(), 2)), atol=2e-4)


def test_motion_of_the_camera():
    """Reproject a moved camera's points to where the camera of before saw the same points."""
    frames = GBufferFrames(plane_and_ball(background=1.0), (32, 32))
    before = frames.shot(tilted_camera(x=0.0))
    picture = frames.shot(tilted_camera(x=0.2))
    assert (np.abs(picture["motion"][..., 0]) > 0.3).all()
    matched = 0
    for y, x in np.ndindex(32, 32):
        px, py = picture["before"][y, x] - 0.5
        i, j = int(np.floor(px)), int(np.floor(py))
        if picture["taps"][y, x] != 15 or picture["hit"][y, x, 0] != 0:
            continue
        f, g = px - i, py - j
        quad = before["position"][j:j + 2, i:i + 2].astype(np.float64)
        found = (quad[0, 0] * (1 - f) + quad[0, 1] * f) * (1 - g) + (quad[1, 0] * (1 - f) + quad[1, 1] * f) * g
        assert np.linalg.norm(found - picture["position"][y, x]) < 0.02
        matched += 1
    assert matched > 500
    assert (picture["taps"] == 0).any()


def test_motion_of_the_world():
    """Move the world with the camera's rotation, not with its translation."""
    empty = scenes.delta({"plane": scenes.quad()}, [("plane", scenes.place(z=-1000.0), "grey")], GREY, background=1.0)
    frames = GBufferFrames(empty, (16, 16))
    sky = [dataclasses.replace(tilted_camera(angle=angle, x=x), transform=tilted_camera(angle=angle, x=x).transform)
           for angle, x in ((2.0, 0.0), (2.0, 5.0), (2.05, 5.0))]
    frames.shot(sky[0])
    shifted, turned = frames.shot(sky[1]), frames.shot(sky[2])
    assert (shifted["hit"][..., 0] == -1).all()
    assert np.abs(shifted["motion"]).max() < 1e-3 and (shifted["taps"] & 1).mean() > 0.9
    # 0.05 rad in a picture of 16 pixels over 2/3 at distance 1.
    assert np.abs(np.abs(turned["motion"][8, 8, 1]) - np.tan(0.05) * 16 / (2.0 / 3.0)) < 0.1


def test_recorded_frames_follow_camera_and_objects():
    """Replay an even and an odd recorded frame with other cameras and transforms: the same as frames recorded anew."""
    def run(recorded):
        frames = GBufferFrames(plane_and_ball(), (24, 24))
        if recorded:
            frames.graphs = {}
        pictures = []
        for i in range(8):
            if i >= 4:
                moved = plane_and_ball((0.1 * i, 0.0, 1.0))
                frames.update(SceneDelta(instances=moved.instances))
            pictures.append(frames.shot(tilted_camera(x=0.1 * i)))
        assert not recorded or len(frames.graphs) < len(pictures)
        return pictures

    # The ball leaves the flattened structure when it first moves: a new structure, for which a frame is made anew.
    for ours, theirs in zip(run(True), run(False), strict=True):
        for name, values in ours.items():
            assert (values == theirs[name]).all(), name


def test_restart_forgets():
    """Take nothing from the frame before after a cut."""
    frames = GBufferFrames(plane_and_ball())
    frames.shot()
    assert (frames.shot()["taps"] != 0).all()
    frames.views.restart()
    picture = frames.shot(tilted_camera())
    assert (picture["taps"] == 0).all() and (picture["motion"] == 0).all()


def test_debug_views_draw_everything():
    """Draw every view that the table names, each different from the others."""
    delta = plane_and_ball(background=1.0)
    delta.materials = lacquered_glass()
    frames = GBufferFrames(delta, (24, 24))
    frames.shot(scenes.camera_above(3.0, 1.0))
    frames.update(SceneDelta(instances=plane_and_ball((0.2, 0.1, 1.0)).instances))
    frames.shot(scenes.camera_above(3.0, 1.0))
    assert set(GBufferPass.debug_views) == {name for name in DEBUG_VIEWS if name.startswith("gbuffer.")}
    pictures = {}
    for name in GBufferPass.debug_views:
        picture = wp.zeros(24 * 24, dtype=wp.vec4, device=frames.device)
        graph = FrameGraph(frames.device)
        frames.gbuffer_pass.record_debug(graph, frames.views.parity, name, picture)
        graph.replay()
        pictures[name] = picture.numpy()
        assert np.isfinite(pictures[name]).all() and (pictures[name][:, 3] == 1).all()
    assert len({p.tobytes() for p in pictures.values()}) == len(pictures)
