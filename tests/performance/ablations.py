# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure what each part of the real-time integrator is worth: error and time with it off. Run by hand.

    python tests/performance/ablations.py SCENE.blend... [--device cuda] [--size 640 360] [--only default,guiding]
        [--truth 4096] [--as-is] [--output out/ablations]

Error after 8 and 64 frames at rest, and 24 frames into a flight, against Reference; milliseconds a frame while flying.
The truths are kept in the output folder.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import traceback
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.camera_path import flight  # noqa: E402
from tests.performance.measured_session import (  # noqa: E402
    LEGEND,
    Measured,
    compare,
    positions_of,
    settings_for,
    truth_of,
)
from tests.performance.sheets import Table, save_sheet, tone  # noqa: E402

FLIGHT, MIDDLE = 60, 24
VARIANTS: dict[str, dict[str, dict[str, Any]]] = {
    "default": {},
    "no guiding": {"probes": {"guiding": False}},
    "no persistence": {"probes": {"persistence": False}},
    "no probe filter": {"probes": {"filtering": False}},
    "no contact detail": {"probes": {"contact_detail": False}},
    "published probe energy": {"probes": {"energy_exact": False}},
    "one bounce in the cache": {"cache": {"bounces": 1}},
    "two bounces in the cache": {"cache": {"bounces": 2}},
    "cells by direction": {"cache": {"key": "direction"}},
    "cells of 16 px": {"cache": {"cell_pixels": 16.0}},
    "cap of 16 samples": {"cache": {"sample_cap": 16}},
    "no scan behind holes": {"cache": {"scan_all": False}},
    "no level blend": {"cache": {"level_blend": False}},
    "no cone test": {"cache": {"cone_test": False}},
    "all bounce rays": {"cache": {"bounce_share": 1.0}},
    "no reuse of lights": {"direct_light": {"temporal_reuse": 0}},
    "all shadow rays": {"direct_light": {"half_rate": False}},
    "no direct filter": {"denoiser": {"direct_iterations": 0}},
    "no diffuse blur": {"denoiser": {"diffuse_radius": 0}},
    "as published": {
        "probes": {"energy_exact": False, "contact_detail": False}, "cache": {
            "key": "direction", "scan_all": False, "level_blend": False, "cone_test": False, "bounces": 1,
            "sample_cap": 16}},
}
"""Changed settings, by group"""


def settings_of(variant: str, integrator: str, device: str) -> Any:
    """Return the settings of a variant."""
    groups = {name: dict(fields) for name, fields in VARIANTS[variant].items()}
    if "key" in groups.get("cache", {}):
        from burnish.engine.settings import CacheKey

        groups["cache"]["key"] = CacheKey(groups["cache"]["key"])
    return settings_for(integrator, device, **groups)


def measure(path: Path, options: argparse.Namespace, table: Table) -> None:
    """Add a row for each variant and save their pictures after 8 frames."""
    size = tuple(options.size)
    scene = BlendScene(path, size, options.device, matte=not options.as_is)
    delta = scene.extract()
    reference = Measured(settings_for("reference", options.device, seed=12345))
    reference.load(delta)
    cameras = flight(scene.camera, positions_of(reference, scene.camera, size), FLIGHT)
    truths = []
    for name, camera, samples in (("rest", cameras[0], options.truth), ("flight", cameras[MIDDLE], options.truth)):
        file = options.output / "truth" / f"{scene.name}_{size[0]}_{name}_{options.truth}.npy"
        truths.append(truth_of(delta, camera, size, options.device, samples, file, options.truth_seconds, reference))
    reference.close()
    measured = Measured(settings_of("default", options.integrator, options.device))
    measured.load(delta)
    panels = [(tone(truths[0], scene.exposure), f"{scene.name}: Reference")]
    wanted = [name for name in options.only.split(",") if name]
    for variant in VARIANTS:
        if wanted and not any(word in variant for word in wanted):
            continue
        measured.look(cameras[0], size, settings_of(variant, options.integrator, options.device))
        measured.session.reset()
        measured.frames(8)
        early = measured.picture()
        measured.frames(56)
        late = measured.picture()
        seconds = 0.0
        for camera in cameras[1:MIDDLE + 1]:
            measured.look(camera, size)
            seconds += measured.frames(1)
        flying = measured.picture()
        errors = compare(truths[0], early), compare(truths[0], late), compare(truths[1], flying)
        cells = [value for e in errors for value in (e.dark_luminance, e.block_p5, e.block_p95, e.flip)]
        table.add(scene.name, variant, *cells, seconds / MIDDLE * 1e3)
        panels.append((tone(early, scene.exposure), f"{variant}: FLIP {errors[0].flip:.3f}"))
    measured.close()
    save_sheet(options.output / f"{scene.name}.png", [panels[i:i + 4] for i in range(0, len(panels), 4)],
               shrink=2 if size[0] >= 640 else 1)


def main() -> int:
    """Measure all scenes; one that fails is told and skipped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(640, 360))
    parser.add_argument("--integrator", default="realtime")
    parser.add_argument("--only", default="", help="parts of variants' names, with commas between them")
    parser.add_argument("--truth", type=int, default=4096)
    parser.add_argument("--truth-seconds", type=float, default=30.0)
    parser.add_argument("--as-is", action="store_true")
    parser.add_argument("--output", type=Path, default=Path("out/ablations"))
    options = parser.parse_args()
    columns = [f"{name} {when}" for when in ("8", "64", "flying") for name in ("dark", "p5", "p95", "FLIP")]
    table = Table(("scene", "variant", *columns, "ms"))
    failed = 0
    for path in options.scenes:
        try:
            measure(path, options, table)
        except Exception:  # noqa: BLE001  one bad scene must not cost the others
            traceback.print_exc()
            failed += 1
    table.save(options.output / "ablations.md", f"Ablations, {options.size[0]} x {options.size[1]}, {options.device}",
               f"After 8 and 64 frames at rest, and in frame {MIDDLE} of a flight. {LEGEND}")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
