# SPDX-License-Identifier: GPL-3.0-or-later
"""What `burnish bench` measures besides error at equal time: --scaling, --ablation, --profile.

Owns their options and hands over to scaling.py, ablation.py and profiling.py, which are loaded only then.
"""

from __future__ import annotations

import argparse
import importlib

__all__ = ["SWEEPS", "add_arguments", "run_mode"]

SWEEPS = ("triangles", "lamps", "instances", "materials", "textures", "resolution", "glossy")
"""Names for --scaling, as in engine/scaling.py"""
FRAMES = (64, 256)
SECONDS = 240.0
MODULES = {"scaling": "scaling", "ablation": "ablation", "profile": "profiling"}
"""Module of each option"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    names = ",".join(SWEEPS)
    parser.add_argument("--scaling", nargs="?", const=names, metavar="NAME,...",
                        help="measure generated scenes instead: cost of a frame with a moving camera against "
                             f"{names}; needs no SCENE")
    parser.add_argument("--budget-seconds", type=float, default=SECONDS, metavar="SECONDS",
                        help="time for all of --scaling, beyond which larger scenes are left out; default: "
                             f"{SECONDS:g}")
    parser.add_argument("--ablation", nargs="?", const="", metavar="PART,...",
                        help="measure variants of the realtime integrator instead, each with one part off: error and "
                             "time against the default; with parts of variants' names: those alone")
    parser.add_argument("--frames", type=frame_list, default=list(FRAMES), metavar="N,...",
                        help="frames at rest at which --ablation measures errors; default: "
                             f"{','.join(map(str, FRAMES))}")
    parser.add_argument("--flight-truth", type=int, default=0, metavar="N",
                        help="--ablation also measures errors in flight, against N samples of the path tracer; "
                             "default: 0, not")
    parser.add_argument("--time-size", nargs=2, type=int, metavar=("W", "H"),
                        help="size of the moving frames that --ablation times; default: that of the pictures")
    parser.add_argument("--scene-seconds", type=float, default=float("inf"), metavar="SECONDS",
                        help="time for each scene of --ablation: variants beyond it are left out; default: no limit")
    parser.add_argument("--profile", action="store_true",
                        help="measure where the time of a realtime frame with a moving camera goes instead: passes, "
                             "kernels, launches, rays and bytes, beside the device's floor")


def frame_list(text: str) -> list[int]:
    """Convert comma-separated numbers of frames."""
    try:
        values = sorted({int(part) for part in text.split(",")})
    except ValueError:
        values = []
    if not values or values[0] < 1:
        raise argparse.ArgumentTypeError(
            f"--frames must be whole numbers from 1 with commas between them, not '{text}'")
    return values


def run_mode(arguments: argparse.Namespace) -> int | None:
    """Run what the options ask for instead of the benchmark; return its exit status, None where nothing is asked."""
    for option, module in MODULES.items():
        if getattr(arguments, option, None) not in (None, False):
            return importlib.import_module(f".{module}", __package__).run(arguments)
    return None
