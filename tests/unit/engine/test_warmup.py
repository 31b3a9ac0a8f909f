# SPDX-License-Identifier: GPL-3.0-or-later
"""Warming up builds everything that is ever launched: nothing is compiled while a picture is waited for."""

from __future__ import annotations

from pathlib import Path

import pytest
from burnish.engine import warmup
from burnish.engine.warmup import HOST_MODULES, KERNEL_MODULES, SHARED_MODULES, warm_up


def test_all_kernels_are_warmed_up():
    """Name each module of kernels that has a kernel, once."""
    folder = Path(__file__).resolve().parents[3] / "kernels"
    owners = {path.stem for path in folder.glob("*.py") if "@wp.kernel" in path.read_text("utf-8")}
    owners -= {"albedo_tables", "white_share"}  # The processor alone runs them: tables.py, the stress test's furnaces.
    named = [module.__name__.rpartition(".")[2] for module in (*KERNEL_MODULES, *HOST_MODULES)]
    assert set(named) == owners and len(named) == len(owners)
    assert set(SHARED_MODULES) <= set(KERNEL_MODULES)


@pytest.mark.parametrize("device", ["cpu", "cuda:7"])
def test_the_processor_has_its_own(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Build for the processor what it runs beside any device, everything once, and tell how far that is."""
    loads: list[tuple[str, str]] = []
    told: list[tuple[str, int, int]] = []
    monkeypatch.setattr(warmup, "_load", lambda *load: loads.append(load))
    monkeypatch.setattr(warmup, "_ready", set())
    warm_up(device, lambda *step: told.append(step))
    beside = {(module.__name__, "cpu") for module in (*HOST_MODULES, *SHARED_MODULES)}
    assert beside <= set(loads) and len(loads) == len(set(loads))
    drawn = {(module.__name__, device) for module in KERNEL_MODULES}
    assert set(loads) == drawn | beside
    assert {count for _, _, count in told} == {len(loads)}
    assert [number for _, number, _ in told] == sorted(number for _, number, _ in told)
    assert told[-1][1] == len(loads)
