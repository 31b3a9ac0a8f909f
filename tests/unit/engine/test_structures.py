# SPDX-License-Identifier: GPL-3.0-or-later
"""What rays meet in the device scene, against every triangle tried in turn: after builds, moves and edits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from burnish.engine.device import launch
from burnish.engine.device_scene import DeviceScene
from burnish.engine.instance_plan import outer_bounds
from burnish.engine.instance_rows import ROW_TYPE, moved_rows, write_places
from burnish.engine.scene import SceneDelta
from burnish.engine.settings import PerformanceSettings
from burnish.kernels.intersect import any_hit, closest_hit, closest_layer
from burnish.kernels.types import Scene
from burnish.kernels.wide_instances_edit import write_boxes, write_records

from tests import scenes
from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

RAYS = 3000
MATERIALS = {"grey": scenes.material(color=0.5), "clear": scenes.transparent(0.4, color=0.7)}


@wp.kernel
def meet(
    # In:
    scene: Scene,
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    t_max: float,
    # Out:
    t_out: wp.array2d[float],
    found_out: wp.array2d[int],
    weights_out: wp.array2d[wp.vec2],
    blocked_out: wp.array[int],
):
    """Follow rays: row 0 against opaque triangles, row 1 against those that need a test."""
    i = wp.tid()
    opaque = closest_hit(scene.geometry, origin[i], direction[i], t_max)
    layer = closest_layer(scene.geometry, origin[i], direction[i], t_max).hit
    t_out[0, i] = opaque.t
    t_out[1, i] = layer.t
    found_out[0, i] = opaque.instance
    found_out[1, i] = layer.instance
    weights_out[0, i] = wp.vec2(opaque.u, opaque.v)
    weights_out[1, i] = wp.vec2(layer.u, layer.v)
    blocked_out[i] = int(any_hit(scene.geometry, origin[i], direction[i], t_max))


def objects(shift: float = 0.0) -> list[tuple]:
    """Make spheres, some sheared or mirrored, some transparent, over a plane."""
    made = [("plane", np.eye(4), "grey")]
    for i in range(7):
        matrix = scenes.place(x=-1.5 + 0.5 * i + (shift if i == 3 else 0.0), y=0.3 * (i % 3 - 1), z=0.4)
        matrix[0, 1] = 0.3
        matrix[1, 1] = -1.0 if i % 2 else 1.0
        made.append(("ball", matrix, "clear" if i % 3 == 0 else "grey"))
    return made


def meshes(rings: int = 10, radius: float = 0.3) -> dict:
    """Make the meshes of `objects`."""
    return {"ball": scenes.sphere(radius, rings=rings), "plane": scenes.quad(3.0)}


def tried_in_turn(shapes: dict, placed: list[tuple], clear: bool, origin: np.ndarray, direction: np.ndarray,
                  ) -> tuple[np.ndarray, np.ndarray]:
    """Return t (inf without a hit) and the instance of the closest triangle, by Moeller and Trumbore's test.

    Its triple products are taken apart, so that products of matrices give them for all triangles and rays of an object.
    """
    best, owner = np.full(len(origin), np.inf), np.full(len(origin), -1)
    moment = np.cross(origin, direction)
    for number, (key, matrix, material) in enumerate(placed):
        if MATERIALS[material].has_transparency != clear:
            continue
        mesh = shapes[key]
        points = mesh.positions.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        a, b, c = np.moveaxis(points[mesh.triangles], 1, 0)
        across, up = b - a, c - a
        normal = np.cross(across, up)
        with np.errstate(all="ignore"):
            scale = -1.0 / (normal @ direction.T)
            u = (up @ moment.T - np.cross(up, a) @ direction.T) * scale
            v = (np.cross(across, a) @ direction.T - across @ moment.T) * scale
            t = (normal @ origin.T - (normal * a).sum(1)[:, None]) * scale
            t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0), t, np.inf).min(0, initial=np.inf)
        best, owner = np.where(t < best, t, best), np.where(t < best, number, owner)
    return best, owner


def check(made: DeviceScene, shapes: dict, placed: list[tuple]) -> np.ndarray:
    """Compare what rays meet in the device scene with what they meet when every triangle is tried; return instances."""
    rng = np.random.default_rng(4)
    origin = rng.uniform((-2.5, -1.5, -0.5), (2.5, 1.5, 2.0), (RAYS, 3)).astype(np.float32)
    direction = rng.normal(size=(RAYS, 3)).astype(np.float32)
    rays = [wp.array(v - np.float32(offset), dtype=wp.vec3, device=made.device)
            for v, offset in ((origin, made.origin), (direction, 0.0))]
    shapes_out = [((2, RAYS), float), ((2, RAYS), int), ((2, RAYS), wp.vec2), (RAYS, int)]
    outputs = [wp.zeros(shape, dtype=kind, device=made.device) for shape, kind in shapes_out]
    wp.launch(meet, RAYS, [made.scene, *rays, 1e30], outputs, device=made.device)
    t, found, _, blocked = (output.numpy() for output in outputs)
    for row, clear in enumerate((False, True)):
        expected, owner = tried_in_turn(shapes, placed, clear, origin.astype(float), direction.astype(float))
        same = found[row] == owner
        # Rays through edges of the outline may differ.
        assert same.mean() > 0.998, (clear, same.mean())
        hit = same & (owner >= 0)
        np.testing.assert_allclose(t[row][hit], expected[hit], rtol=1e-3, atol=1e-4)
        if owner.max() >= 0:
            assert hit.any()
    np.testing.assert_array_equal(blocked == 1, found[0] >= 0)
    return found


def opened(shapes: dict, placed: list[tuple]) -> DeviceScene:
    """Put a scene on the device."""
    made = DeviceScene(DEVICE)
    made.apply(scenes.delta(shapes, placed, MATERIALS), PerformanceSettings())
    return made


def test_flattened_triangles_are_met() -> None:
    """Meet opaque and transparent triangles where they are, with the vertices' weights in the right order."""
    shapes, placed = meshes(), objects()
    made = opened(shapes, placed)
    assert made.structures.opaque.wide is not None and made.structures.filtered.wide is not None
    check(made, shapes, placed)


@pytest.mark.parametrize("instanced", [False, True])
def test_moved_objects_are_met_where_they_are(instanced: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Move an object twice, out of the flattened triangles or among instances."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 0 if instanced else 1 << 20)
    shapes = meshes()
    made = DeviceScene(DEVICE)
    settings = PerformanceSettings(instancing_threshold=1.0)
    made.apply(scenes.delta(shapes, objects(), MATERIALS), settings)
    nodes = made.structures.opaque.wide.nodes.ptr
    for shift in (0.4, -0.3):
        made.apply(SceneDelta(instances=scenes.instances(objects(shift))), settings)
        check(made, shapes, objects(shift))
    assert made.structures.opaque.wide.nodes.ptr == nodes


def test_deformed_meshes_are_met_where_they_are() -> None:
    """Deform the spheres, with the same triangles and with others."""
    shapes, placed = meshes(), objects()
    made = opened(shapes, placed)
    for edited in (meshes(10, 0.4), meshes(8, 0.25)):
        made.apply(SceneDelta(meshes={"ball": edited["ball"]}), PerformanceSettings())
        check(made, edited, placed)


@pytest.mark.slow
def test_many_meshes_share_a_forest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Meet instances of meshes of one triangle to hundreds, whose trees are built together, some of them moved."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 0)
    monkeypatch.setattr("burnish.engine.instance_level.ALONE", 300)
    one = scenes.mesh([[-0.2, -0.1, 0.0], [0.2, -0.1, 0.1], [0, 0.3, 0]], [[0, 1, 2]])
    shapes = {"ball 0": one} | {f"ball {i}": scenes.sphere(0.1 + 0.02 * i, rings=2 + 2 * i) for i in range(1, 9)}
    placed = [(key, scenes.place(x=-1.6 + 0.4 * i, y=0.5 * k - 0.5, z=0.3 * k), "clear" if i % 3 == 2 else "grey")
              for i, key in enumerate(shapes) for k in range(2)]
    made, settings = DeviceScene(DEVICE), PerformanceSettings(instancing_threshold=1.0)
    made.apply(scenes.delta(shapes, placed, MATERIALS), settings)
    assert not made.structures.flat and len(made.structures.levels.local) == len(shapes)
    trees = [part.tree for local in made.structures.levels.local.values() for part in local.parts if part.tree]
    assert 2 < len({id(tree.wide) for tree in trees}) < len(trees), "some have a tree by themselves, some share one"
    check(made, shapes, placed)
    moved = [(key, scenes.place(z=0.1) @ matrix, material) for key, matrix, material in placed[:4]] + placed[4:]
    made.apply(SceneDelta(instances=scenes.instances(moved)), settings)
    check(made, shapes, moved)


def test_a_forest_too_deep_gives_way_to_trees(monkeypatch: pytest.MonkeyPatch) -> None:
    """Build each mesh's tree by itself where their forest has more levels than a ray's stack has room for."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 0)
    monkeypatch.setattr("burnish.engine.instance_level.build_forest", lambda *_, **__: None)
    shapes = {f"ball {i}": scenes.sphere(0.3, rings=5 + i) for i in range(3)}
    placed = [(key, scenes.place(x=i, y=k), "grey") for i, key in enumerate(shapes) for k in range(2)]
    made = DeviceScene(DEVICE)
    made.apply(scenes.delta(shapes, placed, MATERIALS), PerformanceSettings(instancing_threshold=1.0))
    assert len({id(local.opaque.tree.wide) for local in made.structures.levels.local.values()}) == 3
    check(made, shapes, placed)


@pytest.mark.slow
def test_a_mesh_that_keeps_deforming_keeps_its_tree() -> None:
    """Fit a tree to vertices that move, for as long as that is good for rays, and build it anew after that."""
    made = opened(meshes(), objects())
    seen = []
    for radius in (0.3, 0.32, 0.35, 1.2, 1.2):
        shapes = meshes(10, radius)
        made.apply(SceneDelta(meshes={"ball": shapes["ball"]}), PerformanceSettings())
        check(made, shapes, objects())
        levels = made.structures.levels
        seen.append([(part.tree.wide.nodes.ptr, levels.opaque.struct().nodes)
                     for local in levels.local.values() for part in local.parts if part.tree])
    assert seen[0] == seen[1] == seen[2] == seen[3] != seen[4]


@pytest.mark.slow
def test_instances_that_scatter_get_a_new_level() -> None:
    """Fit the level to instances that move, for as long as that is good for rays, and build it anew after that."""
    made = opened(meshes(), objects())
    nodes = []
    for spread in (1.0, 1.01, 1.02, 4.0, 4.0):
        placed = [(key, scenes.place(x=(spread - 1.0) * (i % 3), z=0.01 + (spread - 1.0) * (i % 2)) @ matrix, material)
                  for i, (key, matrix, material) in enumerate(objects())]
        moved = replace(made.table, transforms=scenes.instances(placed).transforms)
        made.apply(SceneDelta(instances=moved), PerformanceSettings())
        check(made, meshes(), placed)
        nodes.append(made.structures.levels.opaque.struct().nodes)
    assert nodes[0] == nodes[1] == nodes[2] == nodes[3]
    placed = [(key, scenes.place(z=0.01) @ matrix, material) for key, matrix, material in placed]
    made.apply(SceneDelta(instances=replace(made.table, transforms=scenes.instances(placed).transforms)),
               PerformanceSettings())
    assert made.structures.levels.opaque.struct().nodes != nodes[3]
    check(made, meshes(), placed)


def test_objects_whose_material_turns_transparent_are_met_as_such() -> None:
    """Move triangles between the two structures when a material is edited, all of them in the end."""
    shapes, placed = meshes(), objects()
    made = opened(shapes, placed)
    for clear in (True, False):
        now = [(key, matrix, "clear" if clear else "grey") for key, matrix, _ in placed]
        made.apply(SceneDelta(instances=scenes.instances(now)), PerformanceSettings())
        assert (made.structures.opaque.wide is None) == clear
        assert (made.structures.filtered.wide is None) == (not clear)
        check(made, shapes, now)


def test_all_objects_leave() -> None:
    """Meet nothing flattened once everything moves, and nothing at all in an empty scene."""
    shapes, placed = meshes(), objects()
    made = opened(shapes, placed)
    moved = [(key, scenes.place(z=0.2) @ matrix, material) for key, matrix, material in placed]
    made.apply(SceneDelta(instances=scenes.instances(moved)), PerformanceSettings())
    assert made.structures.flat == set()
    check(made, shapes, moved)
    made.apply(SceneDelta(instances=replace(scenes.instances([]), object_keys=[])), PerformanceSettings())
    check(made, shapes, [])


def test_odd_meshes_are_met_or_not() -> None:
    """Build over one triangle, over triangles without area, and over a mesh without triangles."""
    one = scenes.mesh([[-2, -1, 0.1], [2, -1, 0.1], [0, 1.4, 0.1]], [[0, 1, 2]])
    flat = scenes.mesh([[0, 0, 0.5], [1, 0, 0.5], [2, 0, 0.5], [0, 0, 0.5]], [[0, 1, 2], [0, 0, 0], [0, 3, 1]])
    empty = scenes.mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    for shapes in ({"a": one}, {"a": flat}, {"a": one, "b": flat, "c": empty}):
        placed = [(key, np.eye(4), "grey") for key in shapes]
        check(opened(shapes, placed), shapes, placed)


def test_rows_of_moved_objects_are_those_of_a_new_scene() -> None:
    """Write the same rows, bounds and plan whether instances only moved or all of the table is read again."""
    shapes, settings = meshes(), PerformanceSettings()
    made = opened(shapes, objects())
    for shift in (0.4, -0.3):
        there = scenes.instances(objects(shift))
        moved = replace(made.table, transforms=there.transforms)
        assert moved.moved_from(made.table) and not there.moved_from(made.table)
        made.apply(SceneDelta(instances=moved), settings)
        read = opened(shapes, objects())
        read.apply(SceneDelta(instances=there), settings)
        for name in made.rows.dtype.names:
            if name != "instanced":
                np.testing.assert_array_equal(made.rows[name], read.rows[name], name)
        np.testing.assert_array_equal(made.plan.mesh_index, read.plan.mesh_index)
        np.testing.assert_array_equal((made.plan.low, made.plan.high), (read.plan.low, read.plan.high))
        assert made.instances.numpy().tobytes() == made.rows.tobytes()
        # From the second time on nothing else is touched.
        assert made.changes.followed == (shift < 0.0)
        check(made, shapes, objects(shift))


@pytest.mark.slow
def test_objects_out_of_reach_come_back() -> None:
    """Draw an object no more while its place is not finite, and again where it lies afterwards."""
    shapes, placed = meshes(), objects()
    made = opened(shapes, placed)
    for shift in (0.4, np.nan, -0.3, 0.1, np.nan, 0.2):
        table = replace(made.table, transforms=scenes.instances(objects(shift)).transforms)
        made.apply(SceneDelta(instances=table), PerformanceSettings())
        assert made.drawn.all() == np.isfinite(shift)
        check(made, shapes, objects(shift if np.isfinite(shift) else 1e4))


def test_the_radius_follows_large_changes_alone() -> None:
    """Keep the scene's radius, by which the cache's cells are measured, while what lies outermost moves a little."""
    made = opened(meshes(), objects())
    radius = made.radius
    for shift, same in ((0.1, True), (-0.2, True), (0.3, True), (400.0, False), (399.0, False), (0.1, False)):
        made.apply(SceneDelta(instances=replace(
            made.table, transforms=scenes.instances(objects(shift)).transforms)), PerformanceSettings())
        assert (made.radius == radius) == same, (shift, made.radius, radius)
    read = opened(meshes(), objects(400.0))
    assert 0.8 * read.radius <= made.radius <= read.radius


def test_recorded_moves_fit_boxes_as_launches_do() -> None:
    """Have the same nodes, records and told area after each of a row of moves as where nothing is recorded."""
    made, told = opened(meshes(), objects()), []
    home = made.table.transforms.copy()
    for shift in (0.4, -0.3, 0.1, 0.9, 0.4):
        transforms = home.copy()
        transforms[1:7, 2, 3] += shift * np.arange(6)
        made.apply(SceneDelta(instances=replace(made.table, transforms=transforms)), PerformanceSettings())
        levels = [made.structures.levels.opaque, made.structures.levels.filtered]
        for level in levels:
            wide, arrays = level._wide, (level._wide.triangles, level._wide.nodes, level._records)
            assert (level._fitting is not None) == made.changes.followed
            kept, area = [array.numpy().tobytes() for array in arrays], float(level._area._view[0])
            low, high = outer_bounds(made.plan, level.chosen)
            np.testing.assert_array_equal(level._bounds.numpy().reshape(-1, 2, 3), np.stack([low, high], 1))
            launch(write_boxes, len(low), [level._items, level._bounds], [wide.triangles], made.device)
            level._area.note(*wide.refit())
            launch(write_records, len(low), [level._items, *level._rows, level._meshes, made.instances],
                   [level._records], made.device)
            assert [array.numpy().tobytes() for array in arrays] == kept
            assert float(level._area._view[0]) == area
        told.append((levels[0]._area._view[0], levels[1]._area._view[0], made.changes.followed))
    # Boxes half as large again as at first are built anew.
    assert [each[2] for each in told] == [False, True, True, True, False]
    assert told[1] != told[2] and told[4] == told[0]


def test_odd_places_are_written_among_others() -> None:
    """Write the same rows for one instance at a time as for all, and find those whose transforms differ."""
    rng = np.random.default_rng(11)
    transforms = np.tile(np.eye(4), (9, 1, 1))
    transforms[:, :3] += rng.normal(size=(9, 3, 4))
    transforms[1, :3, 2] = 0.0
    transforms[3, 0, 3], transforms[4, 1, 1] = np.nan, np.inf
    transforms[6, :3, :3] = 0.0
    transforms[7] *= 1e-30
    origin, together = np.array([1.0, -2.0, 0.5]), np.zeros(9, ROW_TYPE)
    write_places(together, transforms, origin, slice(None))
    alone = np.zeros(9, ROW_TYPE)
    for index in range(9):
        write_places(alone, transforms, origin, np.array([index]))
    assert together.tobytes() == alone.tobytes()
    np.testing.assert_array_equal(together["to_world"][[3, 4]], np.tile(np.eye(4), (2, 1, 1)))
    for index in (0, 2, 5, 8):
        product = together["to_world"][index].astype(np.float64) @ together["to_object"][index]
        np.testing.assert_allclose(product, np.eye(4), atol=1e-4)
    others = transforms.copy()
    others[2, 3, 3], others[8, 0, 0] = 2.0, 7.0
    # What is not a number differs from itself.
    assert moved_rows(transforms, others).tolist() == [2, 3, 8]
    assert moved_rows(np.asfortranarray(transforms), others).tolist() == [2, 3, 8]
    assert moved_rows(transforms[:0], others[:0]).tolist() == []


def test_matrix_that_is_singular_by_rounding(monkeypatch) -> None:
    """Write the others as always where one matrix has no inverse although its upper part has a determinant."""
    transforms = np.tile(np.eye(4), (3, 1, 1))
    transforms[:, 0, 3] = [1.0, 2.0, 3.0]
    transforms[1, :3, :3] *= 1.0e-20
    real = np.linalg.inv

    def refuse(matrices):
        if (np.abs(np.linalg.det(matrices[:, :3, :3])) < 1.0e-50).any():
            raise np.linalg.LinAlgError("Singular matrix")
        return real(matrices)

    monkeypatch.setattr(np.linalg, "inv", refuse)
    rows = np.zeros(3, ROW_TYPE)
    write_places(rows, transforms, np.zeros(3), slice(None))
    assert np.isfinite(rows["to_object"]).all()
    for i in (0, 2):
        assert np.array_equal(rows["to_object"][i], real(transforms[i]).astype(np.float32))
