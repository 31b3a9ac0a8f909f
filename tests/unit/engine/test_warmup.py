# SPDX-License-Identifier: GPL-3.0-or-later
"""Warming up builds everything that is ever launched: nothing is compiled while a picture is waited for."""

from __future__ import annotations

from pathlib import Path

from burnish.engine.warmup import KERNEL_MODULES


def test_all_kernels_are_warmed_up():
    """Name each module of kernels that has a kernel, once."""
    folder = Path(__file__).resolve().parents[3] / "kernels"
    owners = {path.stem for path in folder.glob("*.py") if "@wp.kernel" in path.read_text("utf-8")}
    owners -= {"albedo_tables", "white_share"}  # The processor alone runs them: tables.py, the stress test's furnaces.
    named = [module.__name__.rpartition(".")[2] for module in KERNEL_MODULES]
    assert set(named) == owners and len(named) == len(owners)
