# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure energy, leaks and the speed of changes on scenes made in code, each against its goal. Run by hand.

Of the real-time integrator frames alone are judged, without the path-traced samples that join them at rest.

    python tests/performance/leaks.py [--device cuda] [--size 320 180] [--only furnace,wall,balls,boxes] [--long]
        [--set GROUP.FIELD=VALUE] [--output out/leaks]

--long adds 10,000 frames of the furnace. The checks are tests/light_checks.py and tests/glossy_checks.py (balls: white
ones of every roughness in a white world; boxes: closed ones that emit and reflect); needs no Blender.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from tests.performance.sheets import Table, save_sheet, tone  # noqa: E402


def all_checks(long: bool) -> dict[str, list[Callable]]:
    """Return the checks by name, each a function of a Setup."""
    from tests import glossy_checks as g
    from tests import light_checks as c

    furnaces = [lambda s, a=a, t=t: c.furnace(s, a, 256, t) for a, t in (
        (0.5, 0.01), (0.8, 0.01), (0.9, 0.01), (0.95, 0.02))]
    checks = {
        "furnace": furnaces,
        "sky": [lambda s: c.white_sky(s, 0.5, 64, "plane"), lambda s: c.white_sky(s, 0.8, 64, "sphere")],
        "wall": [lambda s: c.thin_wall(s, 8), lambda s: c.thin_wall(s, 64)],
        "corner": [lambda s: c.room_corner(s, 64)],
        "contact": [lambda s: c.contact(s, 64)],
        "switch": [c.light_switch, lambda s: c.light_switch(s, kept=1)],
        "mover": [c.mover],
        "balls": [lambda s, k=k: g.white_balls(s, k, 64) for k in (
            ("plastic", "metal"), ("coated plastic", "coated metal"), ("half metal",), ("glass",))],
        "boxes": [lambda s, m=m, r=r: g.glossy_box(s, 256, metallic=m, roughness=r)
                  for m in (0.0, 1.0) for r in g.ROUGHNESSES] + [
            lambda s: g.glossy_box(s, 256, roughness=0.6, coat=1.0, coat_roughness=0.05)],
    }
    if long:
        checks["drift"] = [lambda s, a=a, t=t: c.furnace(s, a, 10000, t) for a, t in ((0.5, 0.01), (0.95, 0.02))]
    return checks


def main() -> int:
    """Run the checks, print their figures; returns 1 where a goal is missed or a check fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(96, 54))
    parser.add_argument("--integrator", default="realtime")
    parser.add_argument("--truth", type=int, default=512)
    parser.add_argument("--only", default="", help="names with commas between them")
    parser.add_argument("--long", action="store_true")
    parser.add_argument("--set", action="append", default=[], metavar="GROUP.FIELD=VALUE")
    parser.add_argument("--output", type=Path, default=Path("out/leaks"))
    options = parser.parse_args()
    os.environ["BURNISH_TEST_DEVICE"] = options.device
    from tests.light_checks import Setup
    from tests.performance.settings_text import parse_settings

    setup = Setup(tuple(options.size), options.integrator, options.truth, parse_settings(options.set))
    table = Table(("check", "measured", "goal", "met"))
    wanted = [name for name in options.only.split(",") if name]
    missed = 0
    for name, checks in all_checks(options.long).items():
        if wanted and name not in wanted:
            continue
        panels = []
        start = time.perf_counter()
        for check in checks:
            try:
                figures, pictures = check(setup)
            except Exception:  # noqa: BLE001  one failure must not cost the others
                traceback.print_exc()
                missed += 1
                continue
            for figure in figures:
                missed += not figure.good
                goal = f"{figure.low:g}..{figure.high:g}"
                table.add(figure.name, float(figure.value), goal, "yes" if figure.good else "NO")
            panels += [(tone(picture), label) for label, picture in pictures.items()]
        print(f"    {name}: {time.perf_counter() - start:.1f} s", flush=True)
        if panels:
            save_sheet(options.output / f"{name}.png", [panels[i:i + 3] for i in range(0, len(panels), 3)])
    title = f"Energy, leaks, changes: {options.integrator}, frames alone, {options.device}"
    table.save(options.output / "leaks.md", title)
    return int(missed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
