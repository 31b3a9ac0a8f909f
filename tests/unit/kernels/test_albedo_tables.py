# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the directional-albedo tables: values against independent quadratures, lookups, and the file on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import warp as wp
from burnish.engine import tables as engine_tables
from burnish.kernels import albedo_tables
from burnish.kernels.types import Tables

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

NODES = 16


@wp.kernel
def look_up(
    # In:
    tables: Tables, cosines: wp.array[float], roughness: float, eta: float,
    # Out:
    ggx_out: wp.array[wp.vec2], glass_out: wp.array[wp.vec2], weight_out: wp.array[wp.vec2],
):
    i = wp.tid()
    c = cosines[i]
    ggx_out[i] = albedo_tables.ggx_albedo(tables, c, roughness)
    glass_out[i] = albedo_tables.glass_albedo(tables, c, roughness, eta)
    weight_out[i] = wp.vec2(
        albedo_tables.dielectric_weight(tables, c, roughness, eta), albedo_tables.metal_weight(tables, c, roughness))


@pytest.fixture(scope="module")
def arrays() -> dict[str, np.ndarray]:
    """Return freshly computed tables."""
    return engine_tables.compute_tables(threads=1)


@pytest.fixture(scope="module")
def struct(arrays: dict[str, np.ndarray]) -> Tables:
    """Return the tables as kernels see them."""
    tables = Tables()
    for name, array in arrays.items():
        setattr(tables, name, wp.array(array, dtype=float, device=DEVICE))
    return tables


def looked_up(tables: Tables, cosines: list[float], roughness: float, eta: float = 1.5) -> tuple[np.ndarray, ...]:
    """Return (mirror albedo and mean, glass albedo and mean, weights of dielectric and metal) at the cosines."""
    outputs = [wp.zeros(len(cosines), dtype=wp.vec2, device=DEVICE) for _ in range(3)]
    inputs = [tables, wp.array(np.float32(cosines), device=DEVICE), roughness, eta]
    wp.launch(look_up, len(cosines), inputs, outputs, device=DEVICE)
    return tuple(output.numpy() for output in outputs)


def half_vectors(cosine: float, roughness: float, count: int = 1500) -> tuple[np.ndarray, ...]:
    """Return (view, normals, weight of each): a quadrature over all microfacet normals, D(m) m.z dm = weight."""
    alpha = roughness**2
    u, phi = np.meshgrid((np.arange(count) + 0.5) / count, (np.arange(count) + 0.5) / count * np.pi, indexing="ij")
    tangent = alpha * np.sqrt(u / (1 - u))
    z = 1 / np.sqrt(1 + tangent**2)
    m = np.stack([tangent * z * np.cos(phi), tangent * z * np.sin(phi), z], -1).reshape(-1, 3)
    return np.array([np.sqrt(1 - cosine**2), 0, cosine]), m, 1 / count**2


def smith_lambda(v: np.ndarray, roughness: float) -> np.ndarray:
    """Return Smith's Lambda of directions v."""
    return 0.5 * (np.sqrt(1 + roughness**4 * (v[..., 0] ** 2 + v[..., 1] ** 2) / v[..., 2] ** 2) - 1)


def exact_mirror_albedo(cosine: float, roughness: float, weight: np.ndarray | None = None) -> float:
    """Integrate the GGX BRDF over all normals, without importance sampling of the view."""
    wo, m, part = half_vectors(cosine, roughness)
    c = m @ wo
    wi = 2 * c[:, None] * m - wo
    keep = (c > 0) & (wi[:, 2] > 0)
    masking = 1 / (1 + smith_lambda(wo, roughness) + smith_lambda(wi, roughness))
    factor = 1.0 if weight is None else weight
    # f cos dwi = D G2 / (4 wo.z) * 4 c dm.
    return float((np.where(keep, c * masking, 0) * factor / (m[:, 2] * cosine)).sum() * part)


@pytest.mark.parametrize("cosine_node", [4, 15, 31])
@pytest.mark.parametrize("roughness_node", [8, 20, 31])
def test_mirror_albedo_is_the_integral(arrays: dict[str, np.ndarray], cosine_node: int, roughness_node: int) -> None:
    """Agree with a quadrature of the BRDF over normals to 0.002."""
    want = exact_mirror_albedo(cosine_node / 31, roughness_node / 31)
    assert arrays["ggx_e"][cosine_node, roughness_node] == pytest.approx(want, abs=2e-3)


@pytest.mark.parametrize("name, directional", [
    ("ggx_e_avg", "ggx_e"), ("glass_e_avg", "glass_e"), ("glass_inv_e_avg", "glass_inv_e")])
def test_means_are_those_of_the_directional_tables(
    arrays: dict[str, np.ndarray], name: str, directional: str
) -> None:
    """Integrate the interpolated table over the cosine: the same but for the interpolation's error."""
    table = np.moveaxis(arrays[directional], -2, 0)
    nodes = np.linspace(0, 1, len(table))
    c = (np.arange(2000) + 0.5) / 2000
    flat = table.reshape(len(table), -1)
    mean = np.array([2 * (np.interp(c, nodes, column) * c).mean() for column in flat.T]).reshape(table.shape[1:])
    np.testing.assert_allclose(arrays[name], mean, atol=6e-3)


@pytest.mark.parametrize("inside", [False, True])
def test_smooth_glass_keeps_everything(arrays: dict[str, np.ndarray], inside: bool) -> None:
    """Reflect and refract all light where the roughness is 0."""
    table = arrays["glass_inv_e" if inside else "glass_e"]
    np.testing.assert_allclose(table[:, 1:, 0], 1.0, atol=1e-3)


@pytest.mark.parametrize("ior_node", [3, 8, 12])
def test_smooth_weight_is_the_fresnel_curve(arrays: dict[str, np.ndarray], ior_node: int) -> None:
    """Equal the rescaled Fresnel reflectance at each cosine where the roughness is 0."""
    root = np.sqrt((ior_node / 15) ** 4)
    eta = (1 + root) / (1 - root)
    c = np.arange(1, NODES) / 15
    t = np.sqrt(1 - (1 - c * c) / eta**2)
    f = 0.5 * (((c - eta * t) / (c + eta * t)) ** 2 + ((eta * c - t) / (eta * c + t)) ** 2)
    # Towards Brewster's angle high indices reflect less than F0: the weight is clamped there.
    weight = np.maximum((f - root**2) / (1 - root**2), 0)
    np.testing.assert_allclose(arrays["schlick_ior_s"][ior_node, 1:, 0], weight, atol=1e-3)


def test_metal_weight_lies_by_the_fifth_power(struct: Tables) -> None:
    """Follow Schlick's (1 - cos)^5 closely for smooth metals."""
    c = np.arange(16) / 15
    weight = looked_up(struct, list(c), 0.0)[2][:, 1]
    np.testing.assert_allclose(weight, (1 - c) ** 5, atol=0.02)


def test_lookups_hit_the_nodes(arrays: dict[str, np.ndarray], struct: Tables) -> None:
    """Return the stored value at a node, with the axes in their order."""
    root = np.sqrt((7 / 15) ** 4)
    eta = float((1 + root) / (1 - root))
    ggx, glass, weight = looked_up(struct, [5 / 31, 30 / 31], 12 / 31, eta)
    np.testing.assert_allclose(ggx[:, 0], arrays["ggx_e"][[5, 30], 12], atol=1e-5)
    np.testing.assert_allclose(ggx[:, 1], arrays["ggx_e_avg"][12], atol=1e-5)
    _, glass, weight = looked_up(struct, [2 / 15, 14 / 15], 9 / 15, eta)
    np.testing.assert_allclose(glass[:, 0], arrays["glass_e"][7, [2, 14], 9], atol=1e-4)
    np.testing.assert_allclose(glass[:, 1], arrays["glass_e_avg"][7, 9], atol=1e-4)
    np.testing.assert_allclose(weight[:, 0], arrays["schlick_ior_s"][7, [2, 14], 9], atol=1e-4)
    _, glass, _ = looked_up(struct, [2 / 15, 14 / 15], 9 / 15, 1 / eta)
    np.testing.assert_allclose(glass[:, 0], arrays["glass_inv_e"][7, [2, 14], 9], atol=1e-4)


def test_lookups_are_linear_and_clamped(arrays: dict[str, np.ndarray], struct: Tables) -> None:
    """Interpolate half way between nodes, and hold the border outside."""
    ggx = looked_up(struct, [10.5 / 31, -3.0, 7.0], 12 / 31)[0][:, 0]
    e = arrays["ggx_e"][:, 12]
    np.testing.assert_allclose(ggx, [(e[10] + e[11]) / 2, e[0], e[31]], atol=1e-5)


@pytest.mark.slow
def test_tables_do_not_depend_on_the_threads(arrays: dict[str, np.ndarray]) -> None:
    """Compute the same bits with two threads as with one."""
    for name, array in engine_tables.compute_tables(threads=2).items():
        np.testing.assert_array_equal(array, arrays[name], err_msg=name)


def test_file_round_trip(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Read back what was written, and leave no temporary file."""
    path = tmp_path / "cache" / "tables.npz"
    engine_tables.save_tables(path, arrays)
    loaded = engine_tables.load_tables(path)
    assert loaded is not None
    for name, array in arrays.items():
        np.testing.assert_array_equal(loaded[name], array)
    assert [file.name for file in path.parent.iterdir()] == ["tables.npz"]


@pytest.mark.parametrize("damage", ["missing", "truncated", "garbage", "version", "shape", "nan"])
def test_unusable_files_are_not_read(tmp_path: Path, arrays: dict[str, np.ndarray], damage: str) -> None:
    """Return nothing for files that can't be trusted."""
    path = tmp_path / "tables.npz"
    version = engine_tables.TABLES_VERSION
    changed = dict(arrays)
    if damage == "version":
        version += 1
    elif damage == "shape":
        changed["ggx_e"] = arrays["ggx_e"][:-1]
    elif damage == "nan":
        changed["ggx_e"] = np.full_like(arrays["ggx_e"], np.nan)
    if damage != "missing":
        np.savez(path, version=version, **changed)
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:5000])
    elif damage == "garbage":
        path.write_bytes(b"not an archive at all")
    assert engine_tables.load_tables(path) is None


def test_damaged_file_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                  arrays: dict[str, np.ndarray]) -> None:
    """Compute the tables once where the file is damaged, and never again."""
    path = tmp_path / "tables.npz"
    path.write_bytes(b"broken")
    calls = []
    monkeypatch.setattr(engine_tables, "compute_tables", lambda: calls.append(1) or arrays)
    first = engine_tables.albedo_tables(DEVICE, path)
    second = engine_tables.albedo_tables(DEVICE, path)
    assert len(calls) == 1
    np.testing.assert_array_equal(first.glass_e.numpy(), second.glass_e.numpy())


def test_read_only_folder_is_tolerated(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Give up storing silently where the folder can't be written."""
    blocked = tmp_path / "file"
    blocked.write_text("a file where a folder should be")
    engine_tables.save_tables(blocked / "tables.npz", arrays)
    assert blocked.is_file()
