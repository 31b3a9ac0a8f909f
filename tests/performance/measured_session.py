# SPDX-License-Identifier: GPL-3.0-or-later
"""Sessions as the measuring scripts use them: settings of both integrators, frames, and truths kept in files."""

from __future__ import annotations

import dataclasses
import importlib
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.image_error import ImageError, compare  # noqa: E402
from burnish.engine.measure import wait  # noqa: E402
from burnish.engine.scene import CameraData, SceneDelta  # noqa: E402
from burnish.engine.session import Session  # noqa: E402
from burnish.engine.settings import (  # noqa: E402
    Device,
    FilmSettings,
    Integrator,
    LightPathSettings,
    PixelFilter,
    RenderSettings,
    SamplingSettings,
)

COLUMNS = ("lum", "dark", "p5", "p95", "FLIP", "relMSE", "bad")
LEGEND = """\
lum: ratio of mean luminances; dark: the same where the truth is below 1; p5, p95: its percentiles over 16x16 blocks.
FLIP: mean LDR-FLIP of the sRGB pictures. relMSE: squared error over the squared truth + 0.01, the worst 0.5 % of
pixels clipped. bad: pixels that are not finite or negative."""


def error_cells(error: ImageError) -> tuple[Any, ...]:
    """Return the figures of COLUMNS."""
    return (error.luminance, error.dark_luminance, error.block_p5, error.block_p95, error.flip, error.relative_mse,
            error.bad_pixels)


def attempt(name: str, work: Callable[..., object], *arguments: Any) -> int:
    """Do some work and print how long it took; return 1 if it failed, which is told and costs the others nothing."""
    start, failed = time.perf_counter(), 0
    try:
        work(*arguments)
    except Exception:  # noqa: BLE001  one bad scene must not cost the others
        traceback.print_exc()
        failed = 1
    print(f"    {name}: {time.perf_counter() - start:.0f} s", flush=True)
    return failed


def settings_for(integrator: str, device: str, seed: int = 0, **groups: dict[str, Any]) -> RenderSettings:
    """Return settings with single fields changed, as in `cache={"bounces": 1}`."""
    settings = RenderSettings(
        device=Device(device), sampling=SamplingSettings(integrator=Integrator(integrator), seed=seed),
        light_paths=LightPathSettings(max_bounces=0))
    changed = {name: dataclasses.replace(getattr(settings, name), **fields) for name, fields in groups.items()}
    return dataclasses.replace(settings, **changed)


class Measured:
    """One scene in one session."""

    def __init__(self, settings: RenderSettings):
        self.settings = settings
        self.session = Session(settings)

    def load(self, delta: SceneDelta) -> None:
        """Take in a scene or a change of it."""
        self.session.update(delta)

    def look(self, camera: CameraData, size: tuple[int, int], settings: RenderSettings | None = None,
             passes: Sequence[str] = ("Combined",)) -> None:
        """Set the camera, the picture's size and, where given, other settings."""
        self.settings = settings or self.settings
        self.session.configure(self.settings, camera, *size, passes=tuple(passes))

    def frames(self, count: int) -> float:
        """Render so many frames (Reference: samples) and return the wall seconds, the device's work included."""
        start = time.perf_counter()
        self.session.step(count)
        self.wait()
        return time.perf_counter() - start

    def wait(self) -> None:
        """Wait for the device."""
        wait(self.session)

    def picture(self) -> np.ndarray:
        """Return the newest picture [h, w, 3], scene-linear, bottom row first."""
        return self.session.read("Combined")[..., :3]

    def counts(self) -> dict[str, int]:
        """Return what the last frame counted: rays by kind, cells, probes; empty where nothing is counted."""
        return self.session.counts()

    def close(self) -> None:
        """Give the device's memory back."""
        self.session.close()


def truth_of(
    delta: SceneDelta, camera: CameraData, size: tuple[int, int], device: str, samples: int,
    file: Path | None = None, seconds: float = 1e9, measured: Measured | None = None,
) -> np.ndarray:
    """Return Reference's picture [h, w, 3]: from a file (float16 .npy) if there is one, else rendered and kept.

    Args:
        delta: The scene; not looked at where `measured` has it already.
        camera: What to see.
        size: Of the picture [px].
        device: cpu or cuda.
        samples: Per pixel.
        file: Kept copy.
        seconds: Time after which the picture is taken as it is.
        measured: A session of Reference with the scene in it.
    """
    if file is not None and file.exists():
        return np.load(file).astype(np.float32)
    own = measured is None
    if own:
        measured = Measured(settings_for("reference", device, seed=12345))
        measured.load(delta)
    measured.look(camera, size)
    end = time.perf_counter() + seconds
    done = 0
    while done < samples and time.perf_counter() < end:
        done = measured.session.step(min(16 if device == "cpu" else 64, samples - done))
        measured.wait()
    picture = measured.picture()
    if own:
        measured.close()
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        np.save(file, np.clip(picture, 0.0, 6.5e4).astype(np.float16))
    return picture


def positions_of(measured: Measured, camera: CameraData, size: tuple[int, int]) -> np.ndarray:
    """Return the world position of the surface in each pixel's centre [h, w, 3]; 0 without a surface."""
    settings = dataclasses.replace(
        measured.settings, film=FilmSettings(pixel_filter=PixelFilter.BOX, filter_width=0.01))
    before = measured.settings
    measured.look(camera, size, settings, ("Combined", "Position"))
    measured.frames(1)
    positions = measured.session.read("Position")
    measured.settings = before
    return positions


__all__ = ["COLUMNS", "LEGEND", "Measured", "attempt", "compare", "error_cells", "positions_of", "settings_for",
           "truth_of"]
