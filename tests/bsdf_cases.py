# SPDX-License-Identifier: GPL-3.0-or-later
"""Closures and points for the tests of the BSDFs, and kernels that evaluate, sample and integrate them in bulk."""

from __future__ import annotations

import numpy as np
import warp as wp
from burnish.engine.tables import albedo_tables
from burnish.kernels import types
from burnish.kernels.principled import evaluate_bsdf, prepare_bsdf, sample_bsdf
from burnish.kernels.sampling import sample_pair
from burnish.kernels.types import Closure, ShadingPoint, Tables

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

DEFAULTS = {
    "kind": int(types.CLOSURE_PRINCIPLED), "weight": (1, 1, 1), "color": (1, 1, 1), "normal": (0, 0, 1),
    "coat_normal": (0, 0, 1), "roughness": 0.5, "ior": 1.5, "specular_level": 0.5, "specular_tint": (1, 1, 1),
    "coat_ior": 1.5, "coat_roughness": 0.03, "coat_tint": (1, 1, 1), "sheen_roughness": 0.5, "sheen_tint": (1, 1, 1),
    "multiscatter": 1,
}
"""A white Principled BSDF with the node's defaults"""


def closure(**fields: object) -> Closure:
    """Return a closure with some fields other than DEFAULTS."""
    result = Closure()
    for name, value in (DEFAULTS | fields).items():
        vector = isinstance(value, tuple | list | np.ndarray)
        setattr(result, name, wp.vec3(*map(float, value)) if vector else value)
    return result


def view(cosine: float) -> tuple[float, float, float]:
    """Return the direction of that cosine to z, in the xz plane."""
    return (float(np.sqrt(max(0.0, 1.0 - cosine * cosine))), 0.0, float(cosine))


def point(wo: tuple, *, backfacing: int = 0, normal: tuple = (0, 0, 1), geometric: tuple | None = None) -> ShadingPoint:
    """Return a point seen from `wo`."""
    result = ShadingPoint()
    result.wo = wp.vec3(*map(float, wo))
    result.normal = wp.vec3(*map(float, normal))
    result.geometric_normal = wp.vec3(*map(float, geometric or normal))
    result.backfacing = backfacing
    return result


@wp.kernel
def evaluate_pairs(
    # In:
    tables: Tables, closures: wp.array[Closure], points: wp.array[ShadingPoint], wi: wp.array2d[wp.vec3],
    # Out:
    f_out: wp.array2d[wp.vec3], pdf_out: wp.array2d[float],
):
    """Evaluate case i towards wi[i, j]."""
    i, j = wp.tid()
    bsdf = prepare_bsdf(tables, closures[i], points[i])
    value = evaluate_bsdf(bsdf, points[i].wo, wi[i, j])
    f_out[i, j] = value.f
    pdf_out[i, j] = value.pdf


@wp.kernel
def sample_many(
    # In:
    tables: Tables, closures: wp.array[Closure], points: wp.array[ShadingPoint],
    # Out:
    wi_out: wp.array2d[wp.vec3], weight_out: wp.array2d[wp.vec3], pdf_out: wp.array2d[float],
    kind_out: wp.array2d[int], delta_out: wp.array2d[int],
):
    """Draw sample j of case i."""
    i, j = wp.tid()
    bsdf = prepare_bsdf(tables, closures[i], points[i])
    u = sample_pair(wp.uint32(i), wp.uint32(j), 0)
    v = sample_pair(wp.uint32(i), wp.uint32(j), 1)
    s = sample_bsdf(bsdf, points[i].wo, wp.vec3(u[0], u[1], v[0]))
    wi_out[i, j] = s.wi
    weight_out[i, j] = s.weight
    pdf_out[i, j] = s.pdf
    kind_out[i, j] = s.kind
    delta_out[i, j] = s.delta


@wp.kernel
def integrate_moments(
    # In:
    tables: Tables, closures: wp.array[Closure], points: wp.array[ShadingPoint], samples: int,
    # Out:
    moments_out: wp.array2d[wp.vec3],
):
    """Integrate the lobe of case i times 1, (1 + wi) / 2 and wi^2 (per component)."""
    i = wp.tid()
    bsdf = prepare_bsdf(tables, closures[i], points[i])
    total = wp.vec3(0.0)
    first = wp.vec3(0.0)
    second = wp.vec3(0.0)
    for k in range(samples):
        u = sample_pair(wp.uint32(i), wp.uint32(k), 0)
        v = sample_pair(wp.uint32(i), wp.uint32(k), 1)
        s = sample_bsdf(bsdf, points[i].wo, wp.vec3(u[0], u[1], v[0]))
        if s.pdf > 0.0:
            total += s.weight
            first += wp.cw_mul(s.weight, s.wi * 0.5 + wp.vec3(0.5))
            second += wp.cw_mul(s.weight, wp.cw_mul(s.wi, s.wi))
    moments_out[i, 0] = total / float(samples)
    moments_out[i, 1] = first / float(samples)
    moments_out[i, 2] = second / float(samples)


@wp.kernel
def prepare_emission(
    # In:
    tables: Tables, closures: wp.array[Closure], points: wp.array[ShadingPoint],
    # Out:
    emission_out: wp.array[wp.vec3],
):
    """Return the radiance that case i emits."""
    i = wp.tid()
    emission_out[i] = prepare_bsdf(tables, closures[i], points[i]).emission


def _cases(closures: list[Closure], points: list[ShadingPoint]) -> list:
    """Return the first inputs of all kernels here."""
    return [albedo_tables(DEVICE), wp.array(closures, dtype=Closure, device=DEVICE),
            wp.array(points, dtype=ShadingPoint, device=DEVICE)]


def evaluate(closures: list[Closure], points: list[ShadingPoint], wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return f * |cos|, float[case, direction, 3], and the pdfs for wi, float[case, direction, 3]."""
    shape = wi.shape[:2]
    outputs = [wp.zeros(shape, dtype=wp.vec3, device=DEVICE), wp.zeros(shape, dtype=float, device=DEVICE)]
    directions = wp.array(wi.astype(np.float32), dtype=wp.vec3, device=DEVICE)
    wp.launch(evaluate_pairs, shape, [*_cases(closures, points), directions], outputs, device=DEVICE)
    return outputs[0].numpy(), outputs[1].numpy()


def sample(closures: list[Closure], points: list[ShadingPoint], count: int) -> dict[str, np.ndarray]:
    """Return the fields of `count` samples a case, [case, sample, ...]."""
    shape = (len(closures), count)
    names = {"wi": wp.vec3, "weight": wp.vec3, "pdf": float, "kind": int, "delta": int}
    outputs = {name: wp.zeros(shape, dtype=dtype, device=DEVICE) for name, dtype in names.items()}
    wp.launch(sample_many, shape, _cases(closures, points), list(outputs.values()), device=DEVICE)
    return {name: array.numpy() for name, array in outputs.items()}


def moments(closures: list[Closure], points: list[ShadingPoint], samples: int) -> np.ndarray:
    """Return the integrals of each lobe times 1, (1 + wi) / 2 and wi^2, float[case, 3, rgb]."""
    out = wp.zeros((len(closures), 3), dtype=wp.vec3, device=DEVICE)
    wp.launch(integrate_moments, len(closures), [*_cases(closures, points), samples], [out], device=DEVICE)
    return out.numpy()


def albedo(closures: list[Closure], points: list[ShadingPoint], samples: int = 4096) -> np.ndarray:
    """Return the directional albedos, float[case, rgb]."""
    return moments(closures, points, samples)[:, 0]


def emission(closures: list[Closure], points: list[ShadingPoint]) -> np.ndarray:
    """Return the radiance that each case emits, float[case, rgb]."""
    out = wp.zeros(len(closures), dtype=wp.vec3, device=DEVICE)
    wp.launch(prepare_emission, len(closures), _cases(closures, points), [out], device=DEVICE)
    return out.numpy()


def chi_squared_score(observed: np.ndarray, expected: np.ndarray) -> float:
    """Return how many standard deviations too large Pearson's statistic is, cells below 10 counts pooled.

    Wilson and Hilferty's cube root makes the chi-squared distribution normal.
    """
    order = np.argsort(expected.ravel())
    seen, due = observed.ravel()[order], expected.ravel()[order]
    small = np.searchsorted(np.cumsum(due), 10.0, side="right")
    small = max(small + 1, int(np.searchsorted(due, 10.0)))
    seen = np.append(seen[small:], seen[:small].sum())
    due = np.append(due[small:], due[:small].sum())
    keep = due > 0.0
    statistic = float(((seen[keep] - due[keep]) ** 2 / due[keep]).sum())
    freedom = max(int(keep.sum()) - 1, 1)
    return ((statistic / freedom) ** (1 / 3) - (1 - 2 / (9 * freedom))) / np.sqrt(2 / (9 * freedom))


def sphere_grid(rows: int, columns: int, fine: tuple[int, int]) -> np.ndarray:
    """Return the centres of rows * fine[0] x columns * fine[1] cells of equal area on the sphere, float[n, 3]."""
    z = (np.arange(rows * fine[0]) + 0.5) / (rows * fine[0]) * 2 - 1
    phi = (np.arange(columns * fine[1]) + 0.5) / (columns * fine[1]) * 2 * np.pi
    z, phi = np.meshgrid(z, phi, indexing="ij")
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], -1).reshape(-1, 3)


def counts_due(pdf: np.ndarray, rows: int, columns: int, fine: tuple[int, int], count: int) -> np.ndarray:
    """Return how many of `count` directions belong in each cell, from pdfs on a sphere_grid."""
    cells = pdf.astype(np.float64).reshape(rows, fine[0], columns, fine[1]).sum((1, 3))
    return cells * (4 * np.pi / pdf.size * count)


def count_on_sphere(directions: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Return how many directions fall in each cell of sphere_grid(rows, columns, (1, 1))."""
    z = np.clip(((directions[:, 2] + 1) / 2 * rows).astype(int), 0, rows - 1)
    phi = np.arctan2(directions[:, 1], directions[:, 0]) % (2 * np.pi)
    column = np.clip((phi / (2 * np.pi) * columns).astype(int), 0, columns - 1)
    return np.bincount(z * columns + column, minlength=rows * columns).reshape(rows, columns)
