# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `burnish stress`: runs the stress test of the numbers and writes its table. Needs no bpy.

The cases are in engine/stress. Each is told as it ends, what it missed below it; the last line has the counts.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from ..engine import image_error
from ..engine.errors import BurnishError
from ..engine.settings import Device
from .bench_store import write_text
from .cli_output import Console

__all__ = ["add_command", "run"]


def add_command(commands: Any) -> None:
    """Add the command and its options to the parser's subcommands."""
    parser = commands.add_parser("stress", help="test the numbers with extreme and broken scenes")
    parser.set_defaults(run=run)
    parser.add_argument("--quick", action="store_true",
                        help="run the quick subset: fewer cases, samples and frames; about a minute on two cores")
    parser.add_argument("--device", choices=[str(device) for device in Device], default="auto",
                        help="device of all cases but those of the processor's threads; default: auto")
    parser.add_argument("--only", default="", metavar="PATTERN",
                        help="run the cases whose names hold this text or match it with * and ?")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of all random numbers; default: 0")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures")
    parser.add_argument("--list", action="store_true", help="name the cases and their goals, and run none")
    parser.add_argument("--verbose", action="store_true", help="show all that libraries print, and every figure")


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Run the cases; return 1 where any goal is missed."""
    from ..engine import stress
    from ..engine.device import choose_device, device_info
    from ..engine.stress.tables import as_json, as_line, as_markdown, summary
    from ..engine.warmup import warm_up

    cases = stress.choose_cases(stress.all_cases(), quick=arguments.quick, only=arguments.only)
    if not cases:
        raise BurnishError(f"No case's name holds '{arguments.only}'; see burnish stress --list")
    if arguments.list:
        for case in cases:
            console.print(f"{case.name}: {case.goal}")
        return 0
    if not 0 <= arguments.seed < 1 << 31:
        raise BurnishError(f"--seed must be from 0 to {(1 << 31) - 1}, not {arguments.seed}")
    one = np.zeros((8, 8, 3), np.float32)
    image_error.flip(one, one)  # Missing, it should be missed before the first case.
    device = choose_device(Device(arguments.device))
    console.progress("Building kernels")
    warm_up(device)
    name = f"{device_info(device).name} ({device}){', quick subset' if arguments.quick else ''}"
    trial = stress.Trial(Device.CPU if device == "cpu" else Device.CUDA, quick=arguments.quick, seed=arguments.seed)
    results, start = [], time.perf_counter()
    for number, case in enumerate(cases, 1):
        console.progress(f"{number}/{len(cases)} {case.name}, {time.perf_counter() - start:.0f} s")
        result = stress.run_case(trial, case)
        results.append(result)
        console.print(as_line(result))
        details = result.missed + (result.notes if arguments.verbose or not result.passed else [])
        details += [f"{check.name}: {check.value:.5g}" for check in result.checks if arguments.verbose]
        for detail in details:
            console.print(f"       {detail}")
        # After each: an interrupted run keeps what it has.
        for path, text in ((arguments.markdown, as_markdown), (arguments.json, as_json)):
            if path is not None:
                write_text(path, text(results, name))
    trial.forget_sessions()
    console.print(summary(results))
    return int(any(not result.passed for result in results))
