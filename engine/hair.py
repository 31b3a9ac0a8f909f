# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair strands as meshes: tubes around Catmull-Rom curves, all strands at once.

A tube of few sides whose corners lay on the strand's circle would cover less of the picture than the strand. A convex
outline's mean width is its perimeter over pi (Cauchy), so the corners move out until that is the strand's diameter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["SIDES", "Strands", "Tubes", "fit_to_limit", "make_tubes", "needed_steps", "spared_points",
           "tapered"]

SIDES = 6
"""Of each tube; with four, diffuse hair in the sun is 8 % darker than round hair in Cycles, with six 4 %"""
_WIDER = np.pi / (SIDES * np.sin(np.pi / SIDES))

_TURN = np.pi * (3 - 5 ** 0.5)  # the golden angle

# How far pieces may be off their curve: of the strand's length and of its mean radius.
_LENGTH_SHARE, _RADIUS_SHARE = 0.0015, 0.25
_PIECES_OFF = 0.02  # share of pieces that may be further off
_RADIUS_OFF = 0.03  # of a strand's largest radius, where points are spared


@dataclass(eq=False)
class Strands:
    """C strands of K points in all."""

    points: np.ndarray
    """float32 [K, 3]"""
    radii: np.ndarray
    """float32 [K], in the points' unit"""
    counts: np.ndarray
    """int64 [C], points of each strand, of which those with fewer than two are not drawn"""


@dataclass(eq=False)
class Tubes:
    """V vertices and T triangles around strands."""

    positions: np.ndarray
    """float32 [V, 3]"""
    triangles: np.ndarray
    """int32 [T, 3]"""
    normals: np.ndarray
    """float32 [V, 3], unit, away from the strand"""
    strand: np.ndarray
    """int64 [V], strand of each vertex"""
    point: np.ndarray
    """int64 [V], point of the strands at or before each vertex"""
    fraction: np.ndarray
    """float32 [V], how far each vertex is on the way to the next point"""
    directions: np.ndarray
    """float32 [V / SIDES, 3], unit, along the strand at each ring of vertices"""

    def of_points(self, values: np.ndarray) -> np.ndarray:
        """Return [V, ...], the [K, ...] `values` of points at each vertex, linear between points."""
        following = np.minimum(self.point + 1, len(values) - 1)
        weight = self.fraction.reshape(-1, *([1] * (values.ndim - 1)))
        return (values[self.point] * (1 - weight) + values[following] * weight).astype(np.float32)


def fit_to_limit(counts: np.ndarray, steps: int, limit: int) -> tuple[int, int]:
    """Return how many steps to take between points and to draw every how many-th strand, for `limit` triangles.

    Args:
        counts: int64 [C], points of each strand.
        steps: Wanted pieces between two points.
        limit: Most triangles.
    """
    segments = int(np.maximum(counts - 1, 0).sum())
    while steps > 1 and segments * steps * 2 * SIDES > limit:
        steps //= 2
    return steps, max(1, -(-segments * steps * 2 * SIDES // limit))


def needed_steps(strands: Strands, most: int) -> int:
    """Return how many steps, 1, 2, 4 and so on up to `most`, a curve through the points needs to look like one.

    A Catmull-Rom curve is |b + c - a - d| / 16 from the line between its points b and c at half of the way.
    """
    follows = np.ones(len(strands.points), bool)
    counts = strands.counts[strands.counts > 0]
    follows[np.cumsum(counts) - 1] = False
    b = np.flatnonzero(follows)
    if most == 1 or not len(b):
        return 1
    first = np.repeat(np.cumsum(counts) - counts, counts)[b]
    last = np.repeat(np.cumsum(counts) - 1, counts)[b]
    points = strands.points
    a, c, d = points[np.maximum(b - 1, first)], points[b + 1], points[np.minimum(b + 2, last)]
    off = np.linalg.norm(points[b] + c - a - d, axis=1) / 16
    # Ends count twice: along the line that only changes how fast the curve is.
    length = np.linalg.norm(c - points[b], axis=1)
    inner = (b > first) & (b + 1 < last)
    along = ((points[b] + c - a - d) * (c - points[b])).sum(1) / (16 * np.maximum(length, 1e-20))
    off = np.where(inner, off, np.sqrt(np.maximum(off ** 2 - along ** 2, 0)))
    strand = np.repeat(np.arange(len(counts)), counts)
    width = np.bincount(strand, strands.radii) / counts
    allowed = _LENGTH_SHARE * np.bincount(strand[b], length, len(counts)) + _RADIUS_SHARE * width
    wanted = np.sqrt(off / np.maximum(allowed[strand[b]], 1e-20))
    steps = 1
    while steps < most and (wanted > steps).mean() > _PIECES_OFF:
        steps *= 2
    return steps


def spared_points(points: np.ndarray, radii: np.ndarray) -> int:
    """Return which every how many-th point, a power of two, is enough for strands to look the same.

    Two pieces are left at least: rays find long thin triangles slowly.

    Args:
        points: [C, P, 3], of strands of P points each.
        radii: [C, P].
    """
    pieces = points.shape[1] - 1
    stride = 1
    while pieces % (2 * stride) == 0 and pieces > 2 * stride and _would_do(points, radii, 2 * stride):
        stride *= 2
    return stride


def _would_do(points: np.ndarray, radii: np.ndarray, stride: int) -> bool:
    """Return whether all points but every `stride`-th may be left out."""
    a, b = points[:, :-1:stride], points[:, stride::stride]
    way = b - a
    lengths = np.linalg.norm(np.diff(points, axis=1), axis=2).sum(1, keepdims=True)
    allowed = _LENGTH_SHARE * lengths + _RADIUS_SHARE * radii.mean(1, keepdims=True)
    length = np.linalg.norm(way, axis=2)
    direction = way / np.maximum(length, 1e-20)[..., None]
    largest = radii.max(1, keepdims=True)
    for offset in range(1, stride):
        off = points[:, offset::stride] - a
        along = (off * direction).sum(2)
        across = np.linalg.norm(off - direction * along[..., None], axis=2)
        share = np.clip(along / np.maximum(length, 1e-20), 0, 1)
        radius = radii[:, :-1:stride] * (1 - share) + radii[:, stride::stride] * share
        bad = across > allowed
        bad |= np.abs(radius - radii[:, offset::stride]) > _RADIUS_OFF * largest
        if bad.mean() > _PIECES_OFF:
            return False
    return True


def tapered(shape: float, root: float, tip: float, share: np.ndarray) -> np.ndarray:
    """Return radii at shares 0..1 of the way from root to tip, as Cycles shapes particle hair (blender/curves.cpp).

    Args:
        shape: -1..1, thin to thick.
        root: Radius.
        tip: Radius.
        share: Any shape.
    """
    left = 1 - share
    if shape < 0:
        left = left ** (1 + shape)
    elif shape > 0:
        left = left ** (1 / max(1 - shape, 1e-6))
    return left * (root - tip) + tip


def make_tubes(strands: Strands, steps: int) -> Tubes:
    """Return tubes around `strands`, `steps` pieces between two points."""
    counts = np.where(strands.counts > 1, strands.counts, 0)
    firsts = np.cumsum(strands.counts) - strands.counts
    fine = np.where(counts > 0, (counts - 1) * steps + 1, 0)
    fine_firsts = np.cumsum(fine) - fine
    strand = np.repeat(np.arange(len(fine)), fine)
    along = np.arange(len(strand)) - fine_firsts[strand]
    first, last = firsts[strand], firsts[strand] + counts[strand] - 1
    point = first + along // steps
    fraction = ((along % steps) / steps).astype(np.float32)
    neighbours = [np.clip(point + offset, first, last) for offset in (-1, 0, 1, 2)]
    centres, tangents = _catmull_rom([strands.points[index] for index in neighbours], fraction[:, None])
    radii, _ = _catmull_rom([strands.radii[index] for index in neighbours], fraction)
    directions = _unit(tangents)
    side = _carried_normals(directions, fine, fine_firsts)
    other = np.cross(directions, side)
    angles = (np.arange(SIDES) * (2 * np.pi / SIDES)).astype(np.float32)
    normals = side[:, None] * np.cos(angles)[:, None] + other[:, None] * np.sin(angles)[:, None]
    positions = centres[:, None] + normals * (np.maximum(radii, 0) * _WIDER)[:, None, None]
    return Tubes(
        positions=positions.reshape(-1, 3).astype(np.float32),
        triangles=_triangles(along, fine[strand], centres, radii),
        normals=normals.reshape(-1, 3).astype(np.float32), strand=np.repeat(strand, SIDES),
        point=np.repeat(point, SIDES), fraction=np.repeat(fraction, SIDES),
        directions=directions.astype(np.float32))


def _catmull_rom(values: list[np.ndarray], t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return value and derivative between the second and third of four `values` (Catmull and Rom 1974)."""
    a, b, c, d = values
    linear, square, cube = c - a, 2 * a - 5 * b + 4 * c - d, 3 * (b - c) + d - a
    return b + 0.5 * t * (linear + t * (square + t * cube)), 0.5 * (linear + t * (2 * square + 3 * t * cube))


def _carried_normals(tangents: np.ndarray, counts: np.ndarray, firsts: np.ndarray) -> np.ndarray:
    """Return [F, 3] unit vectors across `tangents` that turn as little as may be along each strand."""
    normals = np.zeros_like(tangents)
    alive = np.flatnonzero(counts)
    least = np.eye(3, dtype=tangents.dtype)[np.abs(tangents[firsts[alive]]).argmin(1)]
    carried = np.zeros((len(counts), 3), tangents.dtype)
    across = _unit(np.cross(tangents[firsts[alive]], least))
    # A turn of its own for each strand: corners that all point along an axis would make hair too wide from there.
    turn = (alive * _TURN % (2 * np.pi))[:, None].astype(tangents.dtype)
    carried[alive] = across * np.cos(turn) + np.cross(tangents[firsts[alive]], across) * np.sin(turn)
    for step in range(int(counts.max(initial=0))):
        alive = alive[counts[alive] > step]
        here = firsts[alive] + step
        across = carried[alive] - tangents[here] * (carried[alive] * tangents[here]).sum(1, keepdims=True)
        carried[alive] = normals[here] = _unit(across)
    return normals


def _triangles(along: np.ndarray, counts: np.ndarray, centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Return int32 [T, 3] between each ring of vertices and the next one of its strand, but those without area."""
    ring = np.flatnonzero(along < counts - 1)
    far = (centres[ring] != centres[ring + 1]).any(1)
    corner = np.arange(SIDES, dtype=np.int32)
    first = (ring * SIDES).astype(np.int32)[:, None]
    a, b = first + corner, first + (corner + 1) % SIDES
    triangles = np.stack([a, b, b + SIDES, a, b + SIDES, a + SIDES], axis=-1).reshape(-1, SIDES, 2, 3)
    # A ring without radius is a point.
    wide = np.stack([far & (radii[ring] > 0), far & (radii[ring + 1] > 0)], axis=-1)
    if wide.all():
        return triangles.reshape(-1, 3)
    return np.concatenate([part.reshape(-1, 3) for part in (
        triangles[wide.all(1)], triangles[wide[:, 0] & ~wide[:, 1], :, 0], triangles[wide[:, 1] & ~wide[:, 0], :, 1])])


def _unit(vectors: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(lengths > 1e-20, vectors / np.maximum(lengths, 1e-20), np.array([0, 0, 1], vectors.dtype))
