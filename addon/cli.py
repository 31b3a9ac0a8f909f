# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: `burnish render|bench|stress|warmup|info`, the same as `blender --command burnish ...`.

Owns the options and the contract with whoever calls it: results on standard output, on failure exit status 1 and
exactly one sentence on standard error. Options are parsed before bpy is imported; the commands are in cli_render.py,
bench.py, stress.py and here.
"""

from __future__ import annotations

import argparse
import enum
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from ..engine.errors import BurnishError
from ..engine.settings import DebugSettings, Device, Preset, RenderSettings, SamplingSettings, setting_info
from .cli_output import Console, diverted_output

__all__ = ["main", "register", "unregister"]

EXAMPLES = """examples:
  burnish render scene.blend --output picture.png
  burnish render scene.blend --output picture.exr --size 1920 1080 --time 60
  burnish render scene.blend --output light.png --integrator realtime --samples 64 --timings
  burnish warmup"""

OPTIONS = {"integrator": "--integrator", "samples": "--samples", "time_limit": "--time", "seed": "--seed"}
"""Sampling settings that are options, by their names in engine.settings."""


class Parser(argparse.ArgumentParser):
    """Raises what is wrong with the arguments as a sentence instead of printing the usage."""

    def error(self, message: str) -> NoReturn:
        """Raise BurnishError with argparse's message."""
        raise BurnishError(f"{message[:1].upper()}{message[1:].rstrip('.')}; see {self.prog} --help.")


def number(kind: type, name: str, low: float, high: float) -> Callable[[str], float]:
    """Return a converter of argument `name` to `kind` that keeps to the range low..high."""

    def convert(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            noun = "a whole number" if kind is int else "a number"
            raise BurnishError(f"{name} must be {noun} from {low:.10g} to {high:.10g}, not '{text}'.")
        return value

    return convert


def add_setting(parser: argparse.ArgumentParser, settings_class: type, name: str, flag: str) -> None:
    """Add the option `flag` for setting `name`: its range, help and default come from its declaration."""
    field = setting_info(settings_class)[name]
    info, default = field.metadata, field.default
    unit = f" [{info['unit']}]" if info["unit"] else ""
    text = f"{info['help']}{unit}; default: the scene's, {default} in a new scene"
    if isinstance(default, enum.Enum):
        parser.add_argument(flag, dest=name, choices=[str(member) for member in type(default)], help=text)
    else:
        kind = type(default)
        parser.add_argument(flag, dest=name, type=number(kind, flag, info["low"], info["high"]), help=text,
                            metavar="N" if kind is int else "SECONDS")


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line; each command's function is in `run`."""
    from . import bench, stress

    parser = Parser(prog="burnish", description="Render .blend files with Burnish.", epilog=EXAMPLES,
                    formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, dest="command")
    add_render(commands)
    bench_parser = commands.add_parser("bench", help="measure speed and error on scenes")
    bench.add_arguments(bench_parser)
    bench_parser.set_defaults(run=run_bench)
    stress.add_command(commands)
    warmup = commands.add_parser("warmup", help="compile all kernels ahead of the first render")
    add_setting(warmup, RenderSettings, "device", "--device")
    warmup.set_defaults(run=run_warmup)
    info = commands.add_parser("info", help="print versions and devices")
    info.set_defaults(run=run_info)
    for command in (warmup, info):
        command.set_defaults(verbose=False)
    return parser


def add_render(commands: Any) -> None:
    """Add the command `render`."""
    parser = commands.add_parser("render", help="render one frame of a .blend file")
    parser.add_argument("scene", metavar="SCENE.blend", help="file to render")
    parser.add_argument("--output", "-o", required=True, metavar="FILE",
                        help=".exr: scene-linear floats with all passes; .png: through the scene's view transform")
    parser.add_argument("--frame", type=number(int, "--frame", -1048574, 1048574), metavar="N",
                        help="frame to render; default: the file's current one")
    parser.add_argument("--size", nargs=2, type=number(int, "--size", 1, 65536), metavar=("W", "H"),
                        help="size in pixels; default: the scene's")
    parser.add_argument("--camera", metavar="NAME", help="camera object; default: the scene's active one")
    parser.add_argument("--view-layer", metavar="NAME", help="view layer; default: all that are enabled")
    for name, flag in OPTIONS.items():
        add_setting(parser, SamplingSettings, name, flag)
    add_setting(parser, RenderSettings, "device", "--device")
    parser.add_argument("--preset", choices=[str(preset) for preset in Preset if preset != Preset.CUSTOM],
                        help="set probes, cache, direct light, reflections and denoiser of the realtime integrator; "
                        "default: the scene's")
    view = setting_info(DebugSettings)["view"].metadata
    parser.add_argument("--debug-view", choices=list(view["choices"]), metavar="NAME", default="",
                        help=f"{view['help']}; with the realtime integrator; one of: {', '.join(view['choices'])}")
    parser.add_argument("--timings", action="store_true", help="print where the time went")
    parser.add_argument("--verbose", action="store_true", help="show all that Blender and Warp print")
    parser.set_defaults(run=run_render)


def run_render(arguments: argparse.Namespace, console: Console) -> int:
    """Render a frame."""
    check_render(arguments)
    from . import cli_render

    return cli_render.run(arguments, console)


def check_render(arguments: argparse.Namespace) -> None:
    """Raise BurnishError for what can't work whatever is in the scene, before the seconds that loading bpy takes."""
    source, target = Path(arguments.scene), Path(arguments.output)
    if arguments.debug_view and arguments.integrator == "reference":
        raise BurnishError("The reference integrator has no debug views; use --integrator realtime.")
    if not source.is_file():
        raise BurnishError(f"The scene '{source}' does not exist.")
    if target.suffix.lower() not in (".exr", ".png"):
        raise BurnishError(f"The output '{target}' must end in .exr or .png.")
    if target.is_dir():
        raise BurnishError(f"The output '{target}' is a folder; name a file.")


def run_bench(arguments: argparse.Namespace, console: Console) -> int:
    """Hand over to bench.py."""
    from . import bench

    return bench.run(arguments)


def run_warmup(arguments: argparse.Namespace, console: Console) -> int:
    """Build all kernels for a device."""
    from ..engine.device import choose_device
    from ..engine.warmup import warm_up

    device = choose_device(Device(arguments.device or Device.AUTO))

    def progress(name: str, done: int, count: int) -> None:
        console.progress(f"Building kernels {done}/{count} ({name})")

    seconds = warm_up(device, progress)
    console.print(f"Kernels for {device} are ready after {seconds:.1f} s")
    return 0


def run_info(arguments: argparse.Namespace, console: Console) -> int:
    """Print what a bug report should say."""
    import platform

    from ..engine.device import choose_device, device_info, kernel_cache_folder
    from .manifest import package_version

    console.print(f"Burnish: {package_version()}")
    console.print(f"Python: {platform.python_version()} on {platform.platform()}")
    for alias in dict.fromkeys((choose_device(Device.AUTO), choose_device(Device.CPU))):
        info = device_info(alias)
        console.print(f"Device {alias}: {info.name}")
        if info.cuda:
            console.print(f"  memory: {info.free_memory / 2**30:.1f} of {info.total_memory / 2**30:.1f} GiB free")
            console.print(f"  driver: {info.driver}")
    console.print(f"Warp: {info.warp_version}")
    console.print(f"Kernel cache: {kernel_cache_folder()}")
    return 0


def main(argv: Sequence[str] | None = None, *, in_blender: bool = False) -> int:
    """Run the command line and return its exit status: 0, or 1 after one sentence on standard error.

    Args:
        argv: Arguments without the program's name; None takes the process's own.
        in_blender: Runs inside a Blender where the add-on is registered and whose scene must not be replaced silently.
    """
    try:
        arguments = make_parser().parse_args(argv)
        arguments.in_blender = in_blender
        with diverted_output(show_all=getattr(arguments, "verbose", True)) as console:
            return arguments.run(arguments, console)
    except SystemExit as exit_:  # argparse after --help
        return exit_.code if isinstance(exit_.code, int) else 1
    except KeyboardInterrupt:
        sentence = "Interrupted; nothing was saved."
    except BurnishError as error:
        sentence = str(error)
    except Exception as error:
        if "--verbose" in (sys.argv[1:] if argv is None else argv):
            raise
        sentence = f"Unexpected {type(error).__name__}: {error}; run it again with --verbose to see where."
    print(" ".join(sentence.split()).rstrip(".") + ".", file=sys.stderr)
    return 1


_command: Any = None


def _execute(argv: list[str]) -> int:
    return main(argv, in_blender=True)


def register() -> None:
    """Make `blender --command burnish` known."""
    global _command
    import bpy

    _command = bpy.utils.register_cli_command("burnish", _execute)


def unregister() -> None:
    """Take the command back."""
    global _command
    import bpy

    if _command is not None:
        bpy.utils.unregister_cli_command(_command)
        _command = None
