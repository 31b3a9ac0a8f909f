# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels for the processor are built with products and sums as one instruction, and with what else was asked for."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.device import FUSED, fused_operations, launch

wp.set_module_options({"enable_backward": False})


@wp.kernel
def take_difference(x: wp.array[float], y: wp.array[float], z: wp.array[float], difference: wp.array[float]):
    """Subtract z from the product of x and y."""
    i = wp.tid()
    product = x[i] * y[i]
    difference[i] = product - z[i]


def test_products_keep_their_last_bits(monkeypatch):
    """Take the rounded product from the product: what rounding took is left, where one instruction does both."""
    try:
        with open("/proc/cpuinfo", encoding="ascii") as file:
            if " fma" not in file.read():
                pytest.skip("the processor has no such instruction")
    except OSError:
        pytest.skip("nobody tells what the processor has")
    # Which all tests' kernels have.
    monkeypatch.setattr(wp.config, "cpu_compiler_flags", wp.config.cpu_compiler_flags.replace(FUSED, "").strip())
    random = np.random.default_rng(3)
    x, y = random.uniform(1.0, 2.0, (2, 64)).astype(np.float32)
    arrays = [wp.array(values, dtype=float, device="cpu") for values in (x, y, x * y)]
    difference = wp.zeros(64, dtype=float, device="cpu")
    launch(take_difference, 64, arrays, [difference], "cpu")
    exact = x.astype(np.float64) * y.astype(np.float64) - (x * y).astype(np.float64)
    np.testing.assert_allclose(difference.numpy(), exact, rtol=1e-6)
    assert (exact != 0).sum() > 32


@pytest.mark.parametrize(("own", "everywhere", "expected"), [
    (None, "-march=native", f"-march=native {FUSED}"),
    ("-march=native -mllvm=-inline-threshold=200000", "", f"-march=native -mllvm=-inline-threshold=200000 {FUSED}"),
    ("-ffp-contract=off -march=native", None, "-ffp-contract=off -march=native"),
    (None, "", FUSED),
    (f"{FUSED} -O1", "", f"{FUSED} -O1"),
    (None, None, None),
])
def test_other_flags_stay(monkeypatch, own, everywhere, expected):
    """Add the flag once to a module's own flags, else to those of all; none where Warp takes none, or afterwards."""
    module = wp.Module(f"flags_{own}_{everywhere}", None)
    module.options["cpu_compiler_flags"] = own
    monkeypatch.setattr(wp.config, "cpu_compiler_flags", everywhere)
    with fused_operations(module), fused_operations(module):
        assert module.options["cpu_compiler_flags"] == expected
    assert module.options["cpu_compiler_flags"] == own
