# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles of a scene and the rays of a real-time frame through it, for timing structures alone.

The rays come in the order in which the frame's kernels follow them: pixels in blocks of 8 x 8, 64 rays for a probe
one after the other, shadow rays from where those meet something.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

FAR = np.float32(1e30)


@dataclass
class Triangles:
    """All triangles of a scene in world space, and its camera."""

    name: str
    points: np.ndarray
    """float32 [V, 3]"""
    indices: np.ndarray
    """int32 [T, 3]"""
    camera: np.ndarray
    """float64 [4, 4], camera to world"""
    window: np.ndarray
    """float64 [4], as CameraData.window"""

    def save(self, folder: Path) -> None:
        """Write NAME.npz."""
        folder.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(folder / f"{self.name}.npz", points=self.points, indices=self.indices, camera=self.camera,
                            window=self.window)


def load_triangles(path: Path, size: tuple[int, int]) -> Triangles:
    """Read a .blend (needs bpy) or what Triangles.save wrote."""
    if path.suffix == ".npz":
        with np.load(path) as data:
            return Triangles(path.stem, data["points"], data["indices"], data["camera"], data["window"])
    from tests.performance.blend_scene import BlendScene

    scene = BlendScene(path, size, "cpu", matte=False)
    delta = scene.extract()
    points, indices, first = [], [], 0
    for i, mesh_index in enumerate(delta.instances.mesh_index.tolist()):
        if mesh_index < 0:
            continue
        mesh, matrix = delta.meshes[delta.instances.mesh_keys[mesh_index]], delta.instances.transforms[i]
        points.append((mesh.positions @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32))
        indices.append(mesh.triangles + first)
        first += len(mesh.positions)
    return Triangles(scene.name, np.concatenate(points), np.concatenate(indices).astype(np.int32),
                     np.array(scene.camera.transform, np.float64).reshape(4, 4), np.array(scene.camera.window))


@dataclass
class Rays:
    """N rays; `any_hit` where only blockage matters."""

    name: str
    origin: np.ndarray
    direction: np.ndarray
    """float32 [N, 3]"""
    t_max: np.ndarray
    """float32 [N]"""
    any_hit: bool = False

    def sorted(self) -> Rays:
        """Return the rays by the octant of their direction and the Morton code of their origin."""
        low, high = self.origin.min(0), self.origin.max(0)
        cells = ((self.origin - low) / np.maximum(high - low, 1e-20) * 1023.99).astype(np.uint64)
        code = np.zeros(len(cells), np.uint64)
        for bit in range(10):
            for axis in range(3):
                code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
        octant = ((self.direction < 0) @ np.array([4, 2, 1])).astype(np.uint64)
        order = np.argsort((octant << np.uint64(30)) | code)
        return Rays(self.name + ", sorted", self.origin[order], self.direction[order], self.t_max[order], self.any_hit)


def pixels_in_blocks(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of all pixels in blocks of 8 x 8."""
    y, x = np.mgrid[0:height, 0:width].reshape(2, -1)
    order = np.lexsort((x % 8, y % 8, x // 8, y // 8))
    return x[order], y[order]


def normalized(v: np.ndarray) -> np.ndarray:
    """Return unit vectors, float32."""
    return (v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30)).astype(np.float32)


def about(normal: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Rotate `local` (z along the normal) into frames about unit normals."""
    other = np.where(np.abs(normal[:, :1]) > 0.5, np.float32([[0, 1, 0]]), np.float32([[1, 0, 0]]))
    tangent = normalized(np.cross(other, normal))
    return normalized(local[:, :1] * tangent + local[:, 1:2] * np.cross(normal, tangent) + local[:, 2:] * normal)


Trace = Callable[[Rays], tuple[np.ndarray, np.ndarray]]


def make_rays(scene: Triangles, size: tuple[int, int], trace: Trace, seed: int = 0) -> list[Rays]:
    """Return a frame's rays: primary, diffuse, shadow and reflection.

    Args:
        scene: Triangles and camera.
        size: Pixels.
        trace: Finds hits: t [N] and face [N], -1 for none.
        seed: Of the random directions.
    """
    rng, (width, height) = np.random.default_rng(seed), size
    x, y = pixels_in_blocks(width, height)
    left, right, bottom, top = scene.window
    local = np.stack([left + (x + 0.5) / width * (right - left), bottom + (y + 0.5) / height * (top - bottom),
                      np.full(len(x), -1.0)], axis=-1)
    primary = Rays("primary", np.broadcast_to(scene.camera[:3, 3].astype(np.float32), local.shape).copy(),
                   normalized(local @ scene.camera[:3, :3].T), np.full(len(x), FAR))
    hit = Hits(scene, primary, *trace(primary))

    # A probe for each 16 x 16 pixels, at one of them; rays over the hemisphere in 8 x 8 cells of the unit square.
    tiles = (y // 16) * ((width + 15) // 16) + x // 16
    shuffled = rng.permutation(len(x))
    chosen = np.sort(shuffled[np.unique(tiles[shuffled], return_index=True)[1]])
    chosen = chosen[hit.face[chosen] >= 0]
    cell = np.mgrid[0:8, 0:8].reshape(2, 64)
    u, v = ((cell[:, None, :] + rng.random((2, len(chosen), 64))) / 8).reshape(2, -1)
    radius, angle = np.sqrt(u), 2 * np.pi * v
    cosine = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - u)], axis=-1)
    owner = np.repeat(chosen, 64)
    diffuse = Rays("diffuse", hit.position[owner], about(hit.normal[owner], cosine), np.full(len(owner), FAR))

    further = Hits(scene, diffuse, *trace(diffuse))
    lit = np.flatnonzero(further.face >= 0)
    light = scene.camera[:3, 3] + 0.3 * (np.median(hit.position, axis=0) - scene.camera[:3, 3])
    to_light = light.astype(np.float32) - further.position[lit]
    shadow = Rays("shadow", further.position[lit], normalized(to_light),
                  np.linalg.norm(to_light, axis=1).astype(np.float32) * np.float32(0.999), any_hit=True)

    chosen = np.flatnonzero((x % 2 == 0) & (y % 2 == 0) & (hit.face >= 0))
    normal, incoming = hit.normal[chosen], primary.direction[chosen]
    mirror = incoming - 2 * np.sum(incoming * normal, axis=1, keepdims=True) * normal
    rough = normalized(mirror + 0.25 * rng.normal(size=mirror.shape))
    rough = np.where(np.sum(rough * normal, axis=1, keepdims=True) > 0, rough, normalized(mirror))
    reflection = Rays("reflection", hit.position[chosen], rough, np.full(len(chosen), FAR))
    return [primary, diffuse, shadow, reflection]


class Hits:
    """Where rays met triangles, moved a little to the side they came from."""

    def __init__(self, scene: Triangles, rays: Rays, t: np.ndarray, face: np.ndarray):
        self.face = face
        corners = scene.points[scene.indices[np.maximum(face, 0)]]
        normal = normalized(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        self.normal = np.where(np.sum(normal * rays.direction, axis=1, keepdims=True) > 0, -normal, normal)
        reach = np.linalg.norm(np.ptp(scene.points, axis=0))
        t = np.where(face >= 0, t, 0)[:, None]
        self.position = (rays.origin + t * rays.direction + 1e-5 * reach * self.normal).astype(np.float32)
