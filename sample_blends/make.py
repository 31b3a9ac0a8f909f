# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the sample scenes: `python make.py [NAME...] [--preview DIR] [--output DIR]` with the bpy module installed.

Each scene is built from nothing, so the script is the scenes' source and the .blend files are its output.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).resolve().parent
NAMES = ("gallery", "cornell", "atrium", "stress")
SIZE_LIMIT = 1_000_000
"""Bytes that a sample may have."""


def preview(name: str, directory: Path, samples: int, percentage: int) -> None:
    """Render the current file, which was saved already, with Cycles to a PNG in `directory`."""
    import bpy

    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine, render.resolution_percentage = "CYCLES", percentage
    cycles.samples, cycles.use_denoising = samples, True
    render.filepath = str(directory / f"{name}.png")
    bpy.ops.render.render(write_still=True)


def register_burnish() -> Callable[[], None]:
    """Register Burnish if it is installed, so that the files can name it; return what undoes that."""
    try:
        burnish = importlib.import_module("burnish")
    except ImportError:
        return lambda: None
    burnish.register()
    return burnish.unregister


def main(arguments: list[str] | None = None) -> int:
    """Build the named scenes (all by default), save them, and render previews if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"scenes to make, of {', '.join(NAMES)}")
    parser.add_argument("--output", type=Path, default=HERE, metavar="DIR", help="where the .blend files go")
    parser.add_argument("--preview", type=Path, metavar="DIR", help="also render each with Cycles into DIR")
    parser.add_argument("--samples", type=int, default=32, help="samples per pixel of the previews")
    parser.add_argument("--percentage", type=int, default=50, help="size of the previews in per cent of 1280x720")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.names) - set(NAMES))
    if unknown:
        parser.error(f"There is no sample named {unknown[0]!r}; the samples are {', '.join(NAMES)}.")
    sys.path.insert(0, str(HERE))
    unregister = register_burnish()
    try:
        return make(options)
    finally:
        unregister()


def make(options: argparse.Namespace) -> int:
    """Build and save the scenes; return the exit status."""
    parts = importlib.import_module("parts")
    for name in options.names or NAMES:
        importlib.import_module(name).build()
        path = options.output.resolve() / f"{name}.blend"
        path.parent.mkdir(parents=True, exist_ok=True)
        parts.save_scene(path)
        size = path.stat().st_size
        print(f"{path.name}: {size / 1000:.0f} kB")
        if size > SIZE_LIMIT:
            print(f"{path.name} has {size} bytes; a sample may have {SIZE_LIMIT}.", file=sys.stderr)
            return 1
        if options.preview:
            preview(name, options.preview.resolve(), options.samples, options.percentage)
    return 0


if __name__ == "__main__":
    sys.exit(main())
