# SPDX-License-Identifier: GPL-3.0-or-later
"""The directional-albedo tables that the BSDFs need: computed once per machine, kept on disk, put on a device.

The file lies beside Warp's compiled kernels; a missing, outdated or damaged one is computed anew.
"""

from __future__ import annotations

import contextlib
import functools
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import warp as wp

from ..kernels import albedo_tables as kernels
from ..kernels.types import Tables
from .device import load_module, start_warp
from .film_colors import Matrix, film_rows
from .sky.image import TO_REC709

__all__ = ["TABLES_VERSION", "albedo_tables", "compute_tables", "film_table", "load_tables"]

TABLES_VERSION = 3
"""Raise it whenever the tables' meaning or values change."""

NODE_SAMPLES = 4096
"""Per node: errors below 5e-4 against a hundred times as many."""
AVERAGE_SAMPLES = 32768

G, N = int(kernels.GGX_NODES), int(kernels.GLASS_NODES)
SHAPES = {
    "ggx_e": (G, G), "ggx_e_avg": (G,),
    "glass_e": (N, N, N), "glass_e_avg": (N, N),
    "glass_inv_e": (N, N, N), "glass_inv_e_avg": (N, N),
    "schlick_ior_s": (N, N, N), "schlick_s": (N, N),
    "dielectric_c": (N, N, N), "schlick_c": (N, N),
}
"""Names and shapes of the fields of kernels.types.Tables"""


def compute_tables(threads: int | None = None) -> dict[str, np.ndarray]:
    """Integrate all tables on the CPU.

    Args:
        threads: Threads to use, all cores if None.

    Returns:
        Arrays by the names and of the shapes in SHAPES, float32 in [0, 1].
    """
    arrays = {name: wp.zeros(shape, dtype=float, device="cpu") for name, shape in SHAPES.items()}
    load_module(kernels.__name__, "cpu")
    glass = [arrays["glass_e"], arrays["glass_inv_e"], arrays["schlick_ior_s"], arrays["dielectric_c"]]
    averages = [arrays["glass_e_avg"], arrays["glass_inv_e_avg"]]
    # Slabs of one table are disjoint, and a launch on the CPU lets other threads run.
    launches = [(kernels.integrate_glass, (1, N, N), [i, NODE_SAMPLES], glass) for i in range(N)]
    launches += [
        (kernels.integrate_glass_average, (N, N), [AVERAGE_SAMPLES], averages),
        (kernels.integrate_ggx, (G, G), [0, NODE_SAMPLES], [arrays["ggx_e"]]),
        (kernels.integrate_ggx_average, (G,), [AVERAGE_SAMPLES], [arrays["ggx_e_avg"]]),
        (kernels.integrate_schlick, (N, N), [NODE_SAMPLES], [arrays["schlick_s"], arrays["schlick_c"]]),
    ]

    def run(launch: tuple) -> None:
        kernel, dim, inputs, outputs = launch
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device="cpu")

    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        list(pool.map(run, launches))
    return {name: array.numpy().copy() for name, array in arrays.items()}


def load_tables(path: Path) -> dict[str, np.ndarray] | None:
    """Read tables from a file; None if it is missing, damaged or of another version."""
    try:
        with np.load(path, allow_pickle=False) as file:
            if int(file["version"]) != TABLES_VERSION:
                return None
            arrays = {name: file[name] for name in SHAPES}
    except Exception:  # noqa: BLE001 - a damaged archive raises whatever its damage suggests
        return None
    for name, array in arrays.items():
        if array.dtype != np.float32 or array.shape != SHAPES[name]:
            return None
        if not (np.isfinite(array).all() and array.min() >= 0.0 and array.max() <= 1.0):
            return None
    return arrays


def save_tables(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write tables so that a reader never sees half a file; a read-only folder only costs the next start."""
    temporary = path.with_name(f"{path.stem}.{os.getpid()}.tmp.npz")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(temporary, version=TABLES_VERSION, **arrays)
        temporary.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            temporary.unlink()


def default_path() -> Path:
    """Return where the tables are kept: in Warp's kernel cache."""
    start_warp()
    return Path(wp.config.kernel_cache_dir) / "burnish_albedo_tables.npz"


def albedo_tables(device: str, path: Path | None = None) -> Tables:
    """Return the tables on a device, from disk or computed (about two seconds) and then stored.

    Args:
        device: Warp device, such as "cpu" or "cuda:0".
        path: File to use instead of the one in Warp's kernel cache.
    """
    path = path or default_path()
    arrays = load_tables(path)
    if arrays is None:
        arrays = compute_tables()
        save_tables(path, arrays)
    tables = Tables()
    for name, array in arrays.items():
        setattr(tables, name, wp.array(array, dtype=float, device=device))
    tables.film = film_table(TO_REC709, device)
    return tables


@functools.cache
def film_table(from_xyz: Matrix, device: str) -> wp.array:
    """Return the colours of thin films on a device; the same array each time, as kernels may be recorded with it."""
    start_warp()
    return wp.array(film_rows(from_xyz), dtype=wp.vec4, device=device)
