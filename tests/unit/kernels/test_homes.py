# SPDX-License-Identifier: GPL-3.0-or-later
"""Test that cells keep to what moves, apart from those of all else, and what keeps their homes."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.homes import ROOM, HomeTable
from burnish.engine.instance_rows import ROW_TYPE, write_places
from burnish.kernels.hash_grid import HashGrid, cell_key, is_mover, wide_key
from burnish.kernels.homes import NOWHERE, Homes, cell_place
from burnish.kernels.types import Instance

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def write_places_of(
    # In:
    grid: HashGrid, homes: Homes, instances: wp.array[int], positions: wp.array[wp.vec3], normals: wp.array[wp.vec3],
    # Out:
    homes_out: wp.array[wp.vec3], normals_out: wp.array[wp.vec3], keys_out: wp.array[wp.int64],
    wide_out: wp.array[wp.int64], movers_out: wp.array[int],
):
    """Write where a point was at home, its normal there and the keys of its cells."""
    i = wp.tid()
    place = cell_place(homes, instances[i], positions[i], normals[i])
    homes_out[i] = place.home
    normals_out[i] = place.normal
    keys_out[i] = cell_key(grid, 4, place, -normals[i])
    wide_out[i] = wide_key(grid, keys_out[i])
    movers_out[i] = wp.where(is_mover(grid, keys_out[i]), 1, 0)


def placed(matrices):
    """Return rows of instances with these transforms."""
    rows = np.zeros(len(matrices), ROW_TYPE)
    write_places(rows, np.array(matrices, float), np.zeros(3), slice(None))
    return rows


def turned(angle, offset, scale=(1.0, 1.0, 1.0)):
    """Return a transform: scaled, turned about z and moved."""
    matrix = np.eye(4)
    c, s = np.cos(angle), np.sin(angle)
    matrix[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.diag(scale)
    matrix[:3, 3] = offset
    return matrix


class Things:
    """Instances that move, and what is known of points on them."""

    def __init__(self, device, matrices):
        self.device, self.rows, self.table = device, placed(matrices), HomeTable(device)

    def move(self, matrices):
        """Put instances elsewhere."""
        rows = placed(matrices)
        moved = np.flatnonzero((rows["to_world"] != self.rows["to_world"]).any((1, 2)))
        self.table.note(self.rows, moved)
        self.rows = rows

    def ask(self, instance, points, normals):
        """Return places, homes, normals there and keys of object-space points, and whether their cells are movers'."""
        world, inverse = self.rows["to_world"][instance], self.rows["to_object"][instance]
        positions = points @ world[:3, :3].T + world[:3, 3]
        turned_normals = normals @ inverse[:3, :3]
        turned_normals /= np.linalg.norm(turned_normals, axis=1, keepdims=True)
        count, grid = len(points), HashGrid()
        outs = [wp.zeros(count, dtype=kind, device=self.device) for kind in (wp.vec3, wp.vec3, wp.int64, wp.int64, int)]
        homes = self.table.struct(wp.array(self.rows, dtype=Instance, device=self.device))
        wp.launch(write_places_of, count, [
            grid, homes, wp.full(count, instance, dtype=int, device=self.device),
            wp.array(positions, dtype=wp.vec3, device=self.device),
            wp.array(turned_normals, dtype=wp.vec3, device=self.device)], outs, device=self.device)
        return positions, turned_normals, *(out.numpy() for out in outs)


POINTS = np.random.default_rng(3).uniform(-0.4, 0.4, (64, 3))
NORMALS = np.eye(3)[np.arange(64) % 3] * np.where(np.arange(64) % 2, -1.0, 1.0)[:, None]
SCALED = turned(0.3, (1.0, 2.0, 0.5), (0.5, 2.0, 1.0))


def test_cells_keep_to_what_moves(device: str) -> None:
    """Wherever an object is, its points lie at home, with the normals that they had there and in the same cells."""
    things = Things(device, [np.eye(4), SCALED])
    before, sides = things.ask(1, POINTS, NORMALS)[:2]
    seen = []
    for step in (1, 2):
        things.move([np.eye(4), turned(0.3 + 0.7 * step, (step, -1.0, 3.0), (0.5, 2.0, 1.0))])
        _, _, homes, normals, keys, wide, movers = things.ask(1, POINTS, NORMALS)
        np.testing.assert_allclose(homes, before, atol=2e-5)
        np.testing.assert_allclose(normals, sides, atol=2e-5)
        assert movers.all()
        seen.append((keys, wide))
    # Rounding moves a point over a cell's border at times.
    assert (seen[0][0] == seen[1][0]).mean() > 0.95
    assert (seen[0][1] == seen[1][1]).mean() > 0.95


def test_what_stands_still_keeps_its_cells(device: str) -> None:
    """A point of an instance that never moved is where it is, to the last bit, whether others have moved or not."""
    things = Things(device, [SCALED, np.eye(4)])
    still = things.ask(0, POINTS, NORMALS)
    things.move([SCALED, turned(1.0, (3.0, 0.0, 0.0))])
    then = things.ask(0, POINTS, NORMALS)
    for one, other in zip(still, then, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(then[2], then[0].astype(np.float32))
    assert not then[-1].any()


def test_movers_do_not_share_cells(device: str) -> None:
    """Two things that were in one place before they moved have cells of their own, wide ones too, as what is there."""
    things = Things(device, [np.eye(4)] * 3)
    things.move([np.eye(4), turned(0.0, (3.0, 0.0, 0.0)), turned(0.0, (0.0, 3.0, 0.0))])
    answers = [things.ask(i, POINTS, NORMALS) for i in range(3)]
    for place in (4, 5):
        sets = [set(answer[place].tolist()) for answer in answers]
        assert not (sets[0] & sets[1] or sets[0] & sets[2] or sets[1] & sets[2])
        assert all(key > 0 for keys in sets for key in keys)


@pytest.mark.parametrize("count", [3, ROOM + 5])
def test_homes_are_given_once(device: str, count: int) -> None:
    """What moves again keeps its home; after others came, homes are forgotten, and no number is given twice."""
    table = HomeTable(device)
    rows = placed([turned(0.0, (i, 0.0, 0.0)) for i in range(count)])
    assert len(table.struct(None).of) == 0
    table.note(rows, np.array([1]))
    first = table.struct(None).of
    later = placed([turned(0.0, (i, 5.0, 0.0)) for i in range(count)])
    table.note(later, np.arange(1, count))
    homes = table.struct(None)
    assert homes.of is first
    of, made = homes.of.numpy(), homes.rows.numpy()
    assert of[0] == int(NOWHERE) and sorted(of[1:]) == list(range(count - 1))
    np.testing.assert_array_equal(made["to_world"][of[1]], rows["to_world"][1])
    np.testing.assert_array_equal(made["to_world"][of[2:]], later["to_world"][2:])
    serials = set(made["serial"][: count - 1].tolist())
    table.forget()
    assert len(table.struct(None).of) == 0
    table.note(later, np.array([0, 2]))
    assert not serials & set(table.struct(None).rows.numpy()["serial"][:2].tolist())
