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

__all__ = [
    "ENGINES", "FRAMES", "OWN", "PEERS", "Job", "SceneStore", "file_hash", "source_hash", "write_bytes", "write_text",
]

ENGINES = {"truth": "Truth", "realtime": "Burnish Realtime", "realtime+oidn": "Burnish Realtime + OIDN",
           "draft": "Burnish Draft",
           "reference": "Burnish Reference", "reference+oidn": "Burnish Reference + OIDN",
           "cycles": "Cycles", "cycles+oidn": "Cycles + OIDN", "eevee": "EEVEE"}
"""Engines by their names on the command line, with their names in tables"""

OWN = ("realtime", "realtime+oidn", "draft", "reference", "reference+oidn")
"""Engines whose results depend on this package's source"""
FRAMES = ("realtime", "draft")
"""Those of them whose pictures are frames; the second with the preset for the shortest times"""
PEERS = ("cycles", "cycles+oidn", "eevee")

OVERHEAD = 1.5
"""Seconds taken to be spent around each picture, for the time left"""
MOVING = "moving"
"""Clock of the picture that ends a pan"""


@dataclass(frozen=True, kw_only=True)
class Job:
    """One picture to render."""

    engine: str
    samples: int = 0
    seed: int = 0
    budget: float = 0.0
    """Time to fill [s]; 0: as many samples as asked for"""
    clock: str = ""
    """`warm`: the scene is resident; `cold`: a second F12 with everything in; `moving`; empty: fixed samples by F12"""

    @property
    def name(self) -> str:
        """Name for files, without the device."""
        amount = f"{self.budget:g}s" if self.budget else f"{self.samples:05d}" if self.samples else ""
        parts = [self.clock, self.engine.replace("+", "_"), amount, f"seed{self.seed}" if self.seed else ""]
        return "_".join(part for part in parts if part)

    @property
    def label(self) -> str:
        """Name for people."""
        if self.clock == MOVING:
            return f"{ENGINES[self.engine]}, camera moving"
        unit = ("frames" if self.samples != 1 else "frame") if self.engine in FRAMES else "spp"
        amount = f"{self.budget:g} s {self.clock}".rstrip() if self.budget else f"{self.samples} {unit}"
        return f"{ENGINES[self.engine]} {amount}" + (f" seed {self.seed}" if self.seed else "")

    @property
    def weight(self) -> float:
        """Rough cost in seconds, for the time left; a fixed number of samples is a guess."""
        return OVERHEAD + (self.budget or 0.02 * self.samples)


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
            if not path.name.startswith(("bench", "cli", "image_error", "measure", "scaling", "ablation", "stress")):
                total.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return total.hexdigest()[:12]


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file that appears under its name only when it is complete."""
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        raise BurnishError(f"The result can't be saved as '{path}': {error.strerror or error}") from error


def write_text(path: Path, text: str) -> None:
    """Write a text file that appears under its name only when it is complete."""
    write_bytes(path, text.encode())


def read_json(path: Path) -> dict[str, Any] | None:
    """Return a JSON file's content, None where it is missing or broken."""
    try:
        return json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return None


class SceneStore:
    """The files of one scene at one size on one device."""

    def __init__(self, output: Path, scene: Path, size: tuple[int, int], device: str) -> None:
        self.scene = scene
        self.hash = file_hash(scene)
        self.folder = output / f"{scene.stem}-{self.hash}-{size[0]}x{size[1]}"
        self.device = device.partition(":")[0]
        self._source = source_hash()

    def path(self, job: Job, suffix: str) -> Path:
        """Return a job's file; the truth is the same on every device."""
        device = "" if job.engine == "truth" else f"_{self.device}"
        return self.folder / f"{job.name}{device}{suffix}"

    def record(self, job: Job) -> dict[str, Any] | None:
        """Return the record of a picture that is there and still valid, or of why there is none; else None."""
        record = read_json(self.path(job, ".json"))
        if record is None or (job.engine in OWN and record.get("source") != self._source):
            return None
        return record if record.get("no_picture") or self.path(job, ".exr").is_file() else None

    def save(self, job: Job, record: dict[str, Any]) -> None:
        """Write the record of a job whose picture is complete, or that has `no_picture`, with the reason."""
        if job.engine in OWN:
            record = {**record, "source": self._source}
        write_text(self.path(job, ".json"), json.dumps(record, indent=1) + "\n")

    def missing(self, jobs: list[Job]) -> Iterator[Job]:
        """Yield the jobs that have still to be rendered."""
        return (job for job in jobs if self.record(job) is None)

    def facts(self, engine: str) -> dict[str, Any] | None:
        """Return what was measured of an engine itself (its time per sample, its frames), if it is still valid."""
        found = read_json(self.folder / f"facts_{engine.replace('+', '_')}_{self.device}.json")
        return None if found is None or (engine in OWN and found.get("source") != self._source) else found

    def save_facts(self, engine: str, facts: dict[str, Any]) -> None:
        """Keep what was measured of an engine itself."""
        path = self.folder / f"facts_{engine.replace('+', '_')}_{self.device}.json"
        write_text(path, json.dumps({**facts, "source": self._source}, indent=1) + "\n")
