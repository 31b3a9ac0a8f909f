# SPDX-License-Identifier: GPL-3.0-or-later
"""What a case of the stress test is, what it may do and what is noted of it.

A case renders pictures through a Trial, which counts their pixels that are not finite or negative (the goal of both
is always 0), and compares figures with their goals. Sessions live on from case to case: what one leaves behind must
not show in the next.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import image_error
from ..errors import BurnishError
from ..report import ReportKind
from ..sanitize import sanitize_mesh
from ..session import Session
from ..settings import (
    CacheSettings,
    DenoiserSettings,
    Device,
    FilmSettings,
    Integrator,
    PixelFilter,
    RenderSettings,
    SamplingSettings,
)
from .scenes import StressScene

__all__ = ["BOTH", "Case", "Check", "Result", "Trial", "luminance", "run_case"]

BOTH = (Integrator.REFERENCE, Integrator.REALTIME)

CAPACITY = 14
"""Of the cache, as a power of two: enough for small pictures"""

FLIP_LIMIT = 0.01
"""Two pictures of the same thing differ by no more"""


@dataclass(frozen=True)
class Check:
    """A figure and the range it should be in."""

    name: str
    value: float
    low: float
    high: float

    @property
    def good(self) -> bool:
        """Whether the goal is met."""
        return bool(np.isfinite(self.value)) and self.low <= self.value <= self.high

    def sentence(self) -> str:
        """Return what was missed."""
        return f"{self.name} is {self.value:.4g}, not in {self.low:.4g}..{self.high:.4g}"


@dataclass(frozen=True)
class Case:
    """One named case."""

    name: str
    """Group and name, as `furnace: closed box, albedo 0.9`"""
    goal: str
    """Besides that no pixel is negative or not finite"""
    run: Callable[[Trial], None]
    quick: bool = True
    """Whether it is in the quick subset, where it may do less (Trial.quick)"""

    @property
    def group(self) -> str:
        """Return the part of the name before the colon."""
        return self.name.partition(":")[0]


@dataclass
class Result:
    """What was found in one case."""

    name: str
    goal: str
    seconds: float = 0.0
    pictures: int = 0
    pixels: int = 0
    non_finite: int = 0
    negative: int = 0
    rejected: int = 0
    """Samples of path tracing that were left out of the film because they were not finite"""
    energy: float | None = None
    """The ratio of mean luminances to what they should be that is furthest from 1"""
    flip: float | None = None
    """The largest difference of two pictures that should be the same"""
    checks: list[Check] = field(default_factory=list)
    failure: str = ""
    """What was raised, as a sentence"""
    notes: list[str] = field(default_factory=list)
    """Figures without a goal"""

    @property
    def missed(self) -> list[str]:
        """Return what was missed, as sentences; none where the case passed."""
        sentences = [check.sentence() for check in self.checks if not check.good]
        sentences += [f"{count} pixels are {what}" for what, count in
                      (("not finite", self.non_finite), ("negative", self.negative)) if count]
        return sentences + ([self.failure] if self.failure else [])

    @property
    def passed(self) -> bool:
        """Whether all goals are met."""
        return not self.missed

    def as_dict(self) -> dict[str, Any]:
        """Return everything for JSON."""
        return {**asdict(self), "passed": self.passed, "missed": self.missed}


def luminance(picture: np.ndarray) -> np.ndarray:
    """Return luminances [h, w] in float64."""
    return picture[..., :3].astype(np.float64) @ image_error.LUMINANCE_WEIGHTS.astype(np.float64)


class Trial:
    """What a case works with."""

    def __init__(self, device: Device | str, *, quick: bool = True, seed: int = 0):
        self.device, self.quick, self.seed = Device(device), quick, seed
        self.result = Result("", "")
        self._sessions: dict[Integrator, Session] = {}

    def choose(self, quick: Any, full: Any) -> Any:
        """Return one of two values: that of the quick subset, or of the full run."""
        return quick if self.quick else full

    def settings(self, integrator: Integrator, **groups: dict[str, Any]) -> RenderSettings:
        """Return settings with changed fields by group; frames at rest go on, path tracing does not take over."""
        made = RenderSettings(
            device=self.device, film=FilmSettings(pixel_filter=PixelFilter.BOX, filter_width=1.0),
            sampling=SamplingSettings(integrator=integrator, seed=self.seed),
            cache=CacheSettings(capacity=CAPACITY), denoiser=DenoiserSettings(path_traced_rest=False))
        return replace(made, **{name: replace(getattr(made, name), **fields) for name, fields in groups.items()})

    def session(self, integrator: Integrator, *, fresh: bool = False) -> Session:
        """Return the session of an integrator; `fresh` makes a new one that is the caller's."""
        if fresh:
            return Session(self.settings(integrator))
        if integrator not in self._sessions:
            self._sessions[integrator] = Session(self.settings(integrator))
        return self._sessions[integrator]

    def forget_sessions(self) -> None:
        """Start the next picture with new sessions."""
        for session in self._sessions.values():
            session.close()
        self._sessions = {}

    def start(self, scene: StressScene, integrator: Integrator, size: tuple[int, int], *, fresh: bool = False,
              **groups: dict[str, Any]) -> tuple[Session, RenderSettings]:
        """Return a session that is ready for its first step, and its settings.

        Meshes go through what extraction lets them go through.
        """
        session, settings = self.session(integrator, fresh=fresh), self.settings(integrator, **groups)
        meshes = {key: sanitize_mesh(mesh)[0] for key, mesh in scene.delta.meshes.items()}
        session.update(replace(scene.delta, meshes=meshes))
        session.configure(settings, scene.camera, *size)
        # The same settings and camera as the scene before: nothing of it may be left.
        session.reset()
        return session, settings

    def render(self, scene: StressScene, integrator: Integrator, amount: int, size: tuple[int, int], *,
               fresh: bool = False, **groups: dict[str, Any]) -> np.ndarray:
        """Return the picture after so many samples or frames, float32 [h, w, 3], what is bad in it counted and zero."""
        session, _ = self.start(scene, integrator, size, fresh=fresh, **groups)
        session.step(amount)
        return self.take(session)

    def take(self, session: Session) -> np.ndarray:
        """Return a session's picture, counted as `render` does."""
        picture = self.count(session.read())
        result = self.result
        result.rejected += sum(
            entry.count for entry in session.report.entries()
            if entry.kind == ReportKind.ERROR and "not finite" in entry.message and not entry.owner)
        return picture

    def count(self, picture: np.ndarray) -> np.ndarray:
        """Count a picture [h, w, 4]; return [h, w, 3] with 0 where it is not finite."""
        result, finite = self.result, np.isfinite(picture)
        result.pictures += 1
        result.pixels += picture.shape[0] * picture.shape[1]
        result.non_finite += int((~finite.all(-1)).sum())
        result.negative += int((np.where(finite, picture, 0.0) < 0.0).any(-1).sum())
        return np.where(finite, picture, np.float32(0.0))[..., :3]

    # What is compared with goals.

    def check(self, name: str, value: float, low: float, high: float) -> None:
        """Note a figure and whether it is in its range."""
        self.result.checks.append(Check(name, float(value), low, high))

    def check_energy(self, name: str, ratio: float, tolerance: float) -> None:
        """Note a ratio that should be 1."""
        ratio, worst = float(ratio), self.result.energy
        if worst is None or not np.isfinite(ratio) or abs(ratio - 1.0) > abs(worst - 1.0):
            self.result.energy = ratio
        self.check(f"{name}: energy", ratio, 1.0 - tolerance, 1.0 + tolerance)

    def check_same(self, name: str, expected: np.ndarray, picture: np.ndarray, limit: float = FLIP_LIMIT) -> None:
        """Note the FLIP of two pictures that should be the same."""
        difference = image_error.flip(expected, picture)
        self.result.flip = max(self.result.flip or 0.0, difference)
        self.check(f"{name}: FLIP", difference, 0.0, limit)

    def note(self, text: str) -> None:
        """Note a figure without a goal, once."""
        if text not in self.result.notes:
            self.result.notes.append(text)


def run_case(trial: Trial, case: Case) -> Result:
    """Run a case and return what was found; what it raises is a failure."""
    trial.result = result = Result(case.name, case.goal)
    start = time.perf_counter()
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", RuntimeWarning)
            case.run(trial)
        result.notes += sorted({f"{each.message} ({Path(each.filename).name}:{each.lineno})" for each in caught})
    except BurnishError as error:
        result.failure = str(error)
    except Exception as error:
        result.failure = f"unexpected {type(error).__name__}: {' '.join(str(error).split())[:300]}"
    if not result.passed:
        # What went wrong may have left its marks in them.
        trial.forget_sessions()
    result.seconds = time.perf_counter() - start
    return result
