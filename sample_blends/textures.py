# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures made from formulas: an equirectangular studio, tiles, a weave, bumps, leaf masks. NumPy only.

All arrays are [height, width, channels], bottom row first.
"""

from __future__ import annotations

import numpy as np


def grid(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return u and v of the texel centres, each [height, width]."""
    return np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    """Return the cubic step from 0 at `low` to 1 at `high`."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def directions(width: int, height: int) -> np.ndarray:
    """Return the unit direction of each texel in Blender's equirectangular mapping, [height, width, 3]."""
    u, v = grid(width, height)
    azimuth, elevation = (0.5 - u) * 2.0 * np.pi, (v - 0.5) * np.pi
    horizontal = np.cos(elevation)
    return np.stack([horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), np.sin(elevation)], -1)


def sky(width: int, height: int, zenith, horizon, ground, sun_direction, sun_degrees: float, sun_radiance,
        glow=(0.0, 0.0, 0.0), softboxes=()) -> np.ndarray:
    """Return float32 radiance of a sky: gradient, ground, a sun disk with soft edge, its glow, and softboxes.

    A softbox is (azimuth, elevation, width, height in degrees, radiance).
    """
    ways = directions(width, height)
    up = ways[..., 2:3]
    zenith, horizon, ground = (np.asarray(c, np.float64) for c in (zenith, horizon, ground))
    above = horizon + (zenith - horizon) * np.clip(up, 0.0, 1.0) ** 0.45
    radiance = above + (ground - above) * smoothstep(0.02, -0.06, up)
    sun = np.asarray(sun_direction, np.float64) / np.linalg.norm(sun_direction)
    angle = np.degrees(np.arccos(np.clip(ways @ sun, -1.0, 1.0)))[..., None]
    radiance = radiance + np.asarray(glow) * np.exp(-((angle / 18.0) ** 1.2))
    radiance = radiance + np.asarray(sun_radiance) * smoothstep(sun_degrees * 0.5 + 0.5, sun_degrees * 0.5 - 0.5, angle)
    azimuth = np.degrees(np.arctan2(ways[..., 1], ways[..., 0]))[..., None]
    elevation = np.degrees(np.arcsin(up))
    for at_azimuth, at_elevation, box_width, box_height, light in softboxes:
        away = np.abs((azimuth - at_azimuth + 180.0) % 360.0 - 180.0)
        inside = smoothstep(box_width / 2 + 1.5, box_width / 2 - 1.5, away)
        inside = inside * smoothstep(box_height / 2 + 1.5, box_height / 2 - 1.5, np.abs(elevation - at_elevation))
        radiance = radiance * (1.0 - inside) + np.asarray(light) * inside
    return radiance.astype(np.float32)


def tiles(size: int, count: int, colors, grout, joint: float = 0.03, seed: int = 1) -> np.ndarray:
    """Return `count` x `count` tiles, each of one of `colors` at random, with joints; sRGB values."""
    u, v = grid(size, size)
    chosen = np.random.default_rng(seed).integers(0, len(colors), (count, count))
    color = np.asarray(colors, np.float64)[chosen[(v * count).astype(int), (u * count).astype(int)]]
    edge = np.minimum.reduce([x % 1.0 for x in (u * count, v * count, -u * count, -v * count)])
    mortar = smoothstep(joint, joint * 0.5, edge)[..., None]
    return color * (1.0 - mortar) + np.asarray(grout) * mortar


def checker(size: int, count: int, first, second) -> np.ndarray:
    """Return a checker board; sRGB values."""
    u, v = grid(size, size)
    odd = ((u * count).astype(int) + (v * count).astype(int)) % 2
    return np.where(odd[..., None] == 1, np.asarray(first, np.float64), np.asarray(second, np.float64))


def height_field(size: int, waves: int = 24, seed: int = 3, frequency: int = 12) -> np.ndarray:
    """Return a smooth, tileable random height in 0..1, [size, size]."""
    u, v = grid(size, size)
    random = np.random.default_rng(seed)
    total = np.zeros((size, size))
    for _ in range(waves):
        kx, ky = random.integers(-frequency, frequency + 1, 2)
        total += np.cos(2.0 * np.pi * (kx * u + ky * v + random.random())) / (1.0 + 0.15 * np.hypot(kx, ky))
    return (total - total.min()) / (total.max() - total.min())


def studs(size: int, count: int) -> np.ndarray:
    """Return a height of round studs in 0..1, [size, size]."""
    u, v = grid(size, size)
    radius = np.hypot((u * count) % 1.0 - 0.5, (v * count) % 1.0 - 0.5)
    return np.sqrt(np.clip(1.0 - (radius / 0.42) ** 2, 0.0, 1.0))


def normals_from_height(height: np.ndarray, strength: float) -> np.ndarray:
    """Return the tangent-space normal map of a tileable height, [h, w, 3] in 0..1."""
    dx = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) * 0.5 * strength * height.shape[1]
    dy = (np.roll(height, -1, 0) - np.roll(height, 1, 0)) * 0.5 * strength * height.shape[0]
    normal = np.stack([-dx, -dy, np.ones_like(dx)], -1)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True) * 0.5 + 0.5


def gray(values: np.ndarray) -> np.ndarray:
    """Return [h, w] values as [h, w, 3]."""
    return np.repeat(values[..., None], 3, -1)


def leaf(size: int) -> np.ndarray:
    """Return a leaf as RGBA sRGB values, alpha 0 or 1 but for a thin soft edge; it points along +v."""
    u, v = grid(size, size)
    x = (u - 0.5) * 2.0
    half = 0.62 * np.clip(v * 1.02, 0.0, 1.0) ** 0.55 * np.clip(1.0 - v, 0.0, 1.0) ** 0.8
    lobes = half * (1.0 + 0.10 * np.sin(v * 52.0))
    inside = smoothstep(1.5 / size, -1.5 / size, np.abs(x) - lobes)
    rib = np.exp(-((x / 0.03) ** 2)) + 0.45 * np.exp(-((((v - np.abs(x) * 0.8) * 9.0) % 1.0 - 0.5) / 0.09) ** 2)
    color = np.array([0.34, 0.56, 0.20]) + rib[..., None] * np.array([0.16, 0.17, 0.08]) - 0.05 * v[..., None]
    return np.concatenate([np.clip(color, 0.0, 1.0), inside[..., None]], -1)


def alpha_stripes(size: int) -> np.ndarray:
    """Return white RGBA in three bands of u: alpha 0 with round dots of 1, alpha 0.5, and alpha 1."""
    u, v = grid(size, size)
    dots = (np.hypot((u * 18.0) % 1.0 - 0.5, (v * 9.0) % 1.0 - 0.5) < 0.36).astype(np.float64)
    alpha = np.select([(u * 3.0) % 1.0 < 1.0 / 3.0, (u * 3.0) % 1.0 < 2.0 / 3.0], [dots, np.full_like(u, 0.5)], 1.0)
    return np.concatenate([np.full((size, size, 3), 0.9), alpha[..., None]], -1)
