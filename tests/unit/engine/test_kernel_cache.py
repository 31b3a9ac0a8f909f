# SPDX-License-Identifier: GPL-3.0-or-later
"""Where built kernels are kept: the chosen folder, the environment before it, and a way out where neither works."""

from __future__ import annotations

import logging
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from burnish.engine import kernel_cache

WHERE = """
from burnish.engine.kernel_cache import set_cache_folder
assert "warp" not in sys.modules
set_cache_folder(sys.argv[1])
from burnish.engine.device import kernel_cache_folder
print(kernel_cache_folder())
"""
BUILD = """
import warp as wp
from burnish.kernels import compaction
assert wp.get_module(compaction.__name__).load(wp.get_device("cpu"), 1)
"""


@pytest.fixture(autouse=True)
def restored(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start without a choice and without the environment's, and leave none behind."""
    monkeypatch.setattr(kernel_cache, "_folder", "")
    monkeypatch.delenv(kernel_cache.CACHE_VARIABLE, raising=False)


def where(run_python: Callable[..., subprocess.CompletedProcess], folder: Path, variable: Path | str,
          script: str = WHERE) -> Path:
    """Return where a new process keeps kernels, given a choice and the environment variable."""
    result = run_python(script, folder, environment={kernel_cache.CACHE_VARIABLE: str(variable)})
    assert result.returncode == 0, result.stderr
    return Path(result.stdout.splitlines()[-1])


@pytest.mark.slow
def test_warp_keeps_kernels_in_the_chosen_folder(
        run_python: Callable[..., subprocess.CompletedProcess], tmp_path: Path) -> None:
    """Keep built kernels in a folder of the chosen one, which is made if need be."""
    chosen = tmp_path / "new" / "kernels"
    folder = where(run_python, chosen, "", WHERE + BUILD)
    assert folder.parent == chosen
    assert list(folder.glob("wp_*compaction*/*.o"))


def test_the_environment_wins(run_python: Callable[..., subprocess.CompletedProcess], tmp_path: Path) -> None:
    """Leave the choice to the environment variable, which a render farm sets."""
    assert where(run_python, tmp_path / "chosen", tmp_path / "variable").parent == tmp_path / "variable"
    assert not (tmp_path / "chosen").exists()


def test_no_choice_is_left_to_warp() -> None:
    """Choose nothing by default, and after the choice is taken back."""
    assert kernel_cache.chosen_folder() is None
    kernel_cache.set_cache_folder("somewhere")
    kernel_cache.set_cache_folder("")
    assert kernel_cache.chosen_folder() is None


def test_an_impossible_folder_is_passed_over(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Warn, and render all the same, where the chosen folder can't be made."""
    (tmp_path / "file").write_text("")
    kernel_cache.set_cache_folder(str(tmp_path / "file" / "kernels"))
    with caplog.at_level(logging.WARNING):
        assert kernel_cache.chosen_folder() is None
    assert "Kernels can't be kept in" in caplog.text
