# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the hash grid: what its keys tell apart, and that cells are found again whatever else came and went."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import warp as wp
from burnish.engine.frame_data import frame_row
from burnish.engine.passes.cache_buffers import CELL_ARRAYS
from burnish.engine.view_data import ViewTracker
from burnish.kernels.cache_cells import CacheControl, purge_cells
from burnish.kernels.hash_grid import (
    BUCKET,
    NO_CELL,
    REFINE_END,
    REFINE_START,
    SCREEN_LINES,
    HashGrid,
    cell_key,
    cell_level,
    cell_size,
    find_key,
    find_lit_cell,
    indirect_light,
    insert_cell,
    jittered,
    normal_face,
)
from burnish.kernels.homes import still_place
from burnish.kernels.view import View

from tests import scenes

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

AXES = np.concatenate([np.eye(3), -np.eye(3)])


@wp.kernel
def write_keys(
    # In:
    grid: HashGrid, levels: wp.array[int], positions: wp.array[wp.vec3], normals: wp.array[wp.vec3],
    # Out:
    keys_out: wp.array[wp.int64], faces_out: wp.array[int],
):
    """Write the key and the face of point i; the ray arrives against the normal."""
    i = wp.tid()
    keys_out[i] = cell_key(grid, levels[i], still_place(positions[i], normals[i]), -normals[i])
    faces_out[i] = normal_face(normals[i])


@wp.kernel
def write_levels(
    # In:
    views: wp.array[View], grid: HashGrid, positions: wp.array[wp.vec3],
    # Out:
    sizes_out: wp.array[float],
):
    """Write the size of the cell at point i."""
    i = wp.tid()
    sizes_out[i] = cell_size(cell_level(grid, views[0], positions[i], wp.uint32(i)))


@wp.kernel
def write_jitter(
    # In:
    normal: wp.vec3, size: float,
    # Out:
    points_out: wp.array[wp.vec3],
):
    """Write the origin, jittered."""
    i = wp.tid()
    points_out[i] = jittered(still_place(wp.vec3(0.0, 0.0, 0.0), normal), size, wp.uint32(i)).home


@wp.kernel
def insert_points(
    # In:
    views: wp.array[View], positions: wp.array[wp.vec3], normal: wp.vec3,
    # Out:
    grid_out: HashGrid, cells_out: wp.array[int],
):
    """Insert point i."""
    i = wp.tid()
    cells_out[i] = insert_cell(grid_out, views[0], still_place(positions[i], normal), -normal, wp.uint32(i))


@wp.kernel
def find_points(
    # In:
    views: wp.array[View], grid: HashGrid, positions: wp.array[wp.vec3], normal: wp.vec3,
    # Out:
    cells_out: wp.array[int], lights_out: wp.array[wp.vec4],
):
    """Find point i and read its light."""
    i = wp.tid()
    seed = wp.uint32(i)
    level = cell_level(grid, views[0], positions[i], seed)
    place = still_place(positions[i], normal)
    cells_out[i] = find_key(grid, cell_key(grid, level, place, -normal))
    light = wp.vec4(0.0, 0.0, 0.0, 0.0)
    cell = find_lit_cell(grid, views[0], place, -normal, seed)
    if cell != NO_CELL:
        indirect = indirect_light(grid, views[0], cell, place, -normal, seed)
        light = grid.direct[cell] + wp.vec4(indirect[0], indirect[1], indirect[2], 0.0)
    lights_out[i] = light


LINES = 64


def make_grid(device, capacity=1 << 12, pixels=8.0, **fields):
    """Make an empty grid with cells of so many pixels of the views here."""
    grid = HashGrid()
    for name, (dtype, entries) in CELL_ARRAYS.items():
        setattr(grid, name, wp.zeros(capacity * entries, dtype=dtype, device=device))
    grid.live = wp.zeros(1, dtype=int, device=device)
    grid.bucket_mask, grid.minimum, grid.finest = capacity // int(BUCKET) - 1, 1e-3, 1.0
    grid.pixels = pixels * (float(SCREEN_LINES) / LINES) ** 0.5
    grid.level_blend, grid.scan_all, grid.directions = 1, 1, 0
    for name, value in fields.items():
        setattr(grid, name, value)
    return grid


def make_views(device, frames=1, camera=None, lines=LINES, crop=None):
    """Make a view after so many frames."""
    views = ViewTracker(device)
    camera = camera or scenes.camera_above(height=3.0, orthographic=False)
    row = frame_row(camera, lines, lines, crop or (0, 0, lines, lines), 0, np.zeros(3))
    for _ in range(frames):
        views.advance(row, moved=False, lit=False, exposure=1.0, transparent=False, filter_quantiles=None)
    return views, row


def vectors(values, device):
    return wp.array(np.asarray(values, np.float32).reshape(-1, 3), dtype=wp.vec3, device=device)


def keys_of(grid, levels, positions, normals, device):
    """Return keys and faces as arrays."""
    count = len(positions)
    keys, faces = wp.zeros(count, dtype=wp.int64, device=device), wp.zeros(count, dtype=int, device=device)
    wp.launch(write_keys, count, [grid, wp.array(np.broadcast_to(levels, count).astype(np.int32), dtype=int,
                                                 device=device), vectors(positions, device),
                                  vectors(normals, device)], [keys, faces], device=device)
    return keys.numpy(), faces.numpy()


def insert(grid, views, points, normal, device):
    cells = wp.zeros(len(points), dtype=int, device=device)
    wp.launch(insert_points, len(points), [views.array, vectors(points, device), wp.vec3(*normal)], [grid, cells],
              device=device)
    return cells.numpy()


def find(grid, views, points, normal, device):
    cells = wp.zeros(len(points), dtype=int, device=device)
    lights = wp.zeros(len(points), dtype=wp.vec4, device=device)
    wp.launch(find_points, len(points), [views.array, grid, vectors(points, device), wp.vec3(*normal)],
              [cells, lights], device=device)
    return cells.numpy(), lights.numpy()


def test_no_two_sides_share_a_key(device):
    """Tell all axis-aligned normals apart at every point, the two sides of a wall included."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-4, 4, (500, 3))
    points[:250] = np.round(points[:250] * 2) / 2
    grid = make_grid(device)
    keys = [keys_of(grid, 6, points, np.tile(axis, (500, 1)), device)[0] for axis in AXES]
    for a, b in itertools.combinations(keys, 2):
        assert (a != b).all()
    assert all((k != 0).all() for k in keys)


@pytest.mark.parametrize("axis", AXES.tolist())
def test_bumps_do_not_split_cells(device, axis):
    """Keep one key where the normal turns by a degree and the position rounds to either side of a round number."""
    rng = np.random.default_rng(1)
    axis = np.array(axis)
    normals = axis + rng.normal(size=(400, 3)) * np.radians(1.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = np.full((400, 3), 0.26) * (axis == 0) + axis * 2.0 * (1 + 1e-6 * rng.choice([-1, 0, 1], (400, 1)))
    keys, _ = keys_of(make_grid(device), 6, points, normals, device)
    assert len(np.unique(keys)) == 1


@pytest.mark.parametrize("side", AXES)
def test_layers_share_no_cell(device, side):
    """Tell layers apart that face the same way a third of a cell's width from each other: curtains before walls."""
    grid = make_grid(device)
    size = 9.765625e-4 * 2.0**8
    points = np.array([0.4 * size + 0.0 * side, 0.4 * size + 0.3 * size * side])
    keys, _ = keys_of(grid, 8, points, np.array([side, side]), device)
    assert keys[0] != keys[1]
    aside = points[:1] + 0.3 * size * (1.0 - np.abs(side)) * [1.0, 0.5, 0.7]
    found, _ = keys_of(grid, 8, np.concatenate([points[:1], aside]), np.array([side, side]), device)
    assert found.tolist() == [keys[0]] * 2


def test_diagonal_normals_have_one_face(device):
    """Give exact diagonals the same face however they are rounded."""
    rng = np.random.default_rng(2)
    for diagonal in ((1, 1, 0), (1, 0, -1), (0, -1, 1), (1, 1, 1), (-1, 1, -1)):
        normals = np.array(diagonal) / np.linalg.norm(diagonal) + rng.uniform(-1e-6, 1e-6, (100, 3))
        _, faces = keys_of(make_grid(device), 6, np.zeros((100, 3)), normals, device)
        assert len(np.unique(faces)) == 1


def test_keys_tell_places_and_levels_apart(device):
    """Give each cell of a block of 16^3 and each level its own key."""
    index = np.stack(np.meshgrid(*[np.arange(-8, 8)] * 3, indexing="ij"), -1).reshape(-1, 3)
    grid = make_grid(device)
    keys = [keys_of(grid, level, (index + 0.5) * 2.0**(level - 10), np.tile([0, 0, 1], (4096, 1)), device)[0]
            for level in (3, 7)]
    assert len(np.unique(np.concatenate(keys))) == 2 * 4096


def test_published_key_asks_for_the_direction(device):
    """Share a key between walls of a corner seen along one ray, and split one wall by direction, as published."""
    grid = make_grid(device, directions=1)
    normals = np.array([[1.0, 0, 0], [0.995, 0.0995, 0], [0, 0, 1]])
    keys, _ = keys_of(grid, 6, np.full((3, 3), 0.03), normals, device)
    assert keys[0] == keys[1] != keys[2]


def test_cell_sizes_follow_the_footprint(device):
    """Make cells as wide as asked on the mean of the logarithm, at every distance, with a smooth change of levels."""
    distances = np.geomspace(0.2, 50, 24)
    views, row = make_views(device)
    grid = make_grid(device)
    for distance in distances:
        points = np.tile([0.0, 0.0, 3.0 - distance], (2000, 1))
        sizes = wp.zeros(2000, dtype=float, device=device)
        wp.launch(write_levels, 2000, [views.array, grid, vectors(points, device)], [sizes], device=device)
        wanted = np.log2(8.0 * float(row["spread"][0]) * distance)
        assert abs(np.log2(sizes.numpy()).mean() - wanted) < 0.05
        assert len(np.unique(sizes.numpy())) <= 2


@pytest.mark.parametrize("orthographic", (False, True))
def test_cells_grow_less_than_the_pixels_do(device, orthographic):
    """Give a picture of a quarter of the lines cells of twice the size, and a part of a picture those of the whole."""
    camera = scenes.camera_above(height=3.0, orthographic=orthographic)
    grid = make_grid(device, level_blend=0, minimum=1e-6)
    points = np.array([[0.0, 0.0, 3.0 - distance] for distance in (0.07, 0.9, 5.0, 300.0)])
    found = []
    for lines, crop in ((270, None), (1080, None), (1080, (300, 20, 10, 30))):
        views, _ = make_views(device, camera=camera, lines=lines, crop=crop)
        sizes = wp.zeros(len(points), dtype=float, device=device)
        wp.launch(write_levels, len(points), [views.array, grid, vectors(points, device)], [sizes], device=device)
        found.append(sizes.numpy())
    np.testing.assert_array_equal(found[0], 2.0 * found[1])
    np.testing.assert_array_equal(found[1], found[2])


def test_cells_shrink_once_they_are_filled(device):
    """Keep the width of cells for the first frames, halve it evenly over the next ones, but not below the smallest."""
    first, last = int(REFINE_START) + 1, int(REFINE_END) + 1
    points = np.tile([[0.0, 0.0, 1.0]], (4096, 1))
    for smallest, factors in ((1e-6, (1.0, 1.0, 0.75, 0.5, 0.5)), (1.0, (1.0,) * 5)):
        means = []
        for frames in (1, first, (first + last) // 2, last, 2 * last):
            views, _ = make_views(device, frames=frames)
            grid = make_grid(device, finest=0.5, minimum=smallest)
            sizes = wp.zeros(len(points), dtype=float, device=device)
            wp.launch(write_levels, len(points), [views.array, grid, vectors(points, device)], [sizes], device=device)
            means.append(2.0 ** np.log2(sizes.numpy()).mean())
        np.testing.assert_allclose(means, np.array(factors) * means[0], rtol=0.03)


def test_cell_size_of_orthographic_cameras(device):
    """Keep one size at all distances without perspective."""
    views, row = make_views(device, camera=scenes.camera_above(height=3.0))
    grid = make_grid(device, level_blend=0)
    points = np.array([[0.0, 0.0, z] for z in (-100.0, 0.0, 2.9)])
    sizes = wp.zeros(3, dtype=float, device=device)
    wp.launch(write_levels, 3, [views.array, grid, vectors(points, device)], [sizes], device=device)
    wanted = 8.0 * float(row["pixel_size"][0])
    assert len(np.unique(sizes.numpy())) == 1 and 0.5 * wanted < sizes.numpy()[0] <= wanted


def test_jitter_stays_in_the_plane(device):
    """Move look-ups by at most half a cell along each axis of the tangent plane, evenly to all sides."""
    normal = np.array([0.48, 0.6, 0.64])
    points = wp.zeros(4096, dtype=wp.vec3, device=device)
    wp.launch(write_jitter, 4096, [wp.vec3(*normal), 2.0], [points], device=device)
    points = points.numpy()
    assert np.abs(points @ normal).max() < 1e-5
    assert 0.9 < np.linalg.norm(points, axis=1).max() < np.sqrt(2.0)
    assert np.linalg.norm(points.mean(0)) < 0.03


def test_insert_and_find(device):
    """Find every cell that was inserted, one for all equal points, and no other."""
    rng = np.random.default_rng(3)
    views, _ = make_views(device)
    grid = make_grid(device, level_blend=0)
    points = rng.uniform(-2, 2, (600, 3))
    cells = insert(grid, views, points, (0, 0, 1), device)
    assert (cells >= 0).all()
    np.testing.assert_array_equal(insert(grid, views, points, (0, 0, 1), device), cells)
    np.testing.assert_array_equal(find(grid, views, points, (0, 0, 1), device)[0], cells)
    assert (find(grid, views, points, (0, 0, -1), device)[0] < 0).all()
    keys = grid.keys.numpy()
    assert (keys != 0).sum() == grid.live.numpy()[0] == len(np.unique(keys[keys != 0]))


def test_light_is_read_from_lit_cells_alone(device):
    """Read a cell's two means together, and report no samples where there are none."""
    views, _ = make_views(device)
    grid = make_grid(device, level_blend=0, minimum=1.0)
    point = np.array([[0.5, 0.5, 0.0]])
    assert find(grid, views, point, (0, 0, 1), device)[1][0, 3] == 0
    cell = insert(grid, views, point, (0, 0, 1), device)[0]
    assert find(grid, views, point, (0, 0, 1), device)[1][0, 3] == 0, "a new cell knows nothing"
    for name, value in (("direct", (1, 2, 3, 7)), ("indirect", (0.5, 0.5, 0.5, 1))):
        values = getattr(grid, name).numpy()
        values[cell] = value
        getattr(grid, name).assign(values)
    np.testing.assert_allclose(find(grid, views, point, (0, 0, 1), device)[1][0], [1.5, 2.5, 3.5, 7])


def purge(grid, views, row, frames, lifetime, device):
    """Let frames pass."""
    control = CacheControl()
    for name, size, dtype in (("age", 1, int), ("balance", 576, wp.int64), ("factors", 2, wp.vec3),
                              ("counters", 512, int)):
        setattr(control, name, wp.zeros(size, dtype=dtype, device=device))
    control.live = grid.live
    capacity = len(grid.keys)
    for _ in range(frames):
        views.advance(row, moved=False, lit=False, exposure=1.0, transparent=False, filter_quantiles=None)
        wp.launch(purge_cells, capacity // 8, [views.array, capacity, lifetime], [grid, control], device=device)


@pytest.mark.parametrize("scan_all", [1, 0])
def test_holes_do_not_hide_cells(device, scan_all):
    """Find young cells behind the holes that old ones left, and make no duplicates; the published search does both."""
    rng = np.random.default_rng(4)
    views, row = make_views(device)
    grid = make_grid(device, capacity=512, level_blend=0, scan_all=scan_all)
    old, young = rng.uniform(-2, 2, (150, 3)), rng.uniform(-2, 2, (100, 3)) + 8.0
    insert(grid, views, old, (0, 0, 1), device)
    purge(grid, views, row, 15, 20, device)
    cells = insert(grid, views, young, (0, 0, 1), device)
    purge(grid, views, row, 17, 20, device)
    found = find(grid, views, young, (0, 0, 1), device)[0]
    insert(grid, views, young, (0, 0, 1), device)
    keys = grid.keys.numpy()
    keys = keys[keys != 0]
    duplicates = len(keys) - len(np.unique(keys))
    assert (find(grid, views, old, (0, 0, 1), device)[0] < 0).all(), "old cells are freed"
    if scan_all:
        np.testing.assert_array_equal(found, cells)
        assert duplicates == 0
    else:
        assert (found < 0).any() and duplicates > 0


def test_lifetime_shrinks_with_load(device):
    """Free cells sooner where the table is nearly full."""
    rng = np.random.default_rng(5)
    survivors = {}
    for count in (60, 4000):
        views, row = make_views(device)
        grid = make_grid(device, capacity=512, level_blend=0)
        insert(grid, views, rng.uniform(-2, 2, (count, 3)), (0, 0, 1), device)
        before = int(grid.live.numpy()[0])
        purge(grid, views, row, 14, 50, device)
        survivors[count] = int(grid.live.numpy()[0]) / before
    assert survivors[60] == 1.0 and survivors[4000] < 0.8


def test_full_table_says_so(device):
    """Return no cell where the bucket is full, and leave the others alone."""
    rng = np.random.default_rng(6)
    views, _ = make_views(device)
    grid = make_grid(device, capacity=64, level_blend=0)
    points = rng.uniform(-2, 2, (2000, 3))
    cells = insert(grid, views, points, (0, 0, 1), device)
    assert grid.live.numpy()[0] == 64 and (cells < 0).sum() > 1000
    found = find(grid, views, points, (0, 0, 1), device)[0]
    np.testing.assert_array_equal(found, cells)
