# SPDX-License-Identifier: GPL-3.0-or-later
"""What the benchmark renders and what it has rendered already: jobs, their files, their records. Knows no bpy.

A scene's folder is named after the .blend's content and the size, a job's files after its settings; a record is
written after its picture, so that an interrupted run goes on where it stopped. Burnish's own records also carry a
hash of its source: a changed renderer is measured anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..engine.errors import BurnishError

__all__ = ["ENGINES", "INTEGRATORS", "OWN", "Job", "SceneStore", "file_hash", "source_hash", "write_text"]

ENGINES = {"truth": "Truth", "burnish": "Burnish Reference", "realtime": "Burnish Realtime", "cycles": "Cycles",
           "cycles+oidn": "Cycles + OIDN", "eevee": "EEVEE"}
"""Engines by their names on the command line, with their names in tables"""

INTEGRATORS = {"reference": "burnish", "realtime": "realtime"}
"""Burnish's engines by its integrators"""

OWN = frozenset(INTEGRATORS.values())
"""Engines whose results depend on this package's source"""


@dataclass(frozen=True, kw_only=True)
class Job:
    """One picture to render."""

    engine: str
    samples: int
    seed: int = 0
    budget: float = 0.0
    """Time after which sampling stops [s]; 0: as many samples as asked for"""

    @property
    def name(self) -> str:
        """Name for files, without the device."""
        amount = f"{self.budget:g}s" if self.budget else f"{self.samples:05d}"
        return f"{self.engine.replace('+', '_')}_{amount}" + (f"_seed{self.seed}" if self.seed else "")

    @property
    def label(self) -> str:
        """Name for people."""
        unit = ("frames" if self.samples != 1 else "frame") if self.engine == "realtime" else "spp"
        amount = f"{self.budget:g} s" if self.budget else f"{self.samples} {unit}"
        return f"{ENGINES[self.engine]} {amount}" + (f" seed {self.seed}" if self.seed else "")

    @property
    def weight(self) -> float:
        """Rough cost, for the time left: a sample costs one, and each render something on top."""
        return 20.0 + self.samples * (0.3 if self.engine == "eevee" else 1.0) if not self.budget else 50.0


def file_hash(path: Path) -> str:
    """Return 12 hexadecimal digits of a file's content; raises BurnishError when it can't be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:12]
    except OSError as error:
        raise BurnishError(f"'{path}' can't be read: {error.strerror or error}") from error


def source_hash() -> str:
    """Return 12 hexadecimal digits of Burnish's own source, less the benchmark's."""
    root = Path(__file__).resolve().parent.parent
    total = hashlib.sha256()
    for layer in ("addon", "engine", "kernels"):
        for path in sorted((root / layer).rglob("*.py")):
            if not path.name.startswith(("bench", "cli", "image_error")):
                total.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return total.hexdigest()[:12]


def write_text(path: Path, text: str) -> None:
    """Write a file that appears under its name only when it is complete."""
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, "utf-8")
        partial.replace(path)
    except OSError as error:
        raise BurnishError(f"The result can't be saved as '{path}': {error.strerror or error}") from error


class SceneStore:
    """The files of one scene at one size on one device."""

    def __init__(self, output: Path, scene: Path, size: tuple[int, int], device: str) -> None:
        self.scene = scene
        self.hash = file_hash(scene)
        self.folder = output / f"{scene.stem}-{self.hash}-{size[0]}x{size[1]}"
        self.device = device.partition(":")[0]

    def path(self, job: Job, suffix: str) -> Path:
        """Return a job's file; the truth is the same on every device."""
        device = "" if job.engine == "truth" else f"_{self.device}"
        return self.folder / f"{job.name}{device}{suffix}"

    def record(self, job: Job) -> dict[str, Any] | None:
        """Return the record of a picture that is there and still valid, else None."""
        try:
            record = json.loads(self.path(job, ".json").read_text("utf-8"))
        except (OSError, ValueError):
            return None
        stale = job.engine in OWN and record.get("source") != source_hash()
        return None if stale or not self.path(job, ".exr").is_file() else record

    def save(self, job: Job, record: dict[str, Any]) -> None:
        """Write the record of a job whose picture is complete."""
        write_text(self.path(job, ".json"), json.dumps(record, indent=1) + "\n")

    def missing(self, jobs: list[Job]) -> Iterator[Job]:
        """Yield the jobs that have still to be rendered."""
        return (job for job in jobs if self.record(job) is None)
