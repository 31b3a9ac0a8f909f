# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line without Blender: options, sentences, exit statuses, clean output, written files."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from burnish.addon import cli, cli_output
from burnish.engine import write
from burnish.engine.errors import BurnishError
from burnish.engine.settings import SamplingSettings, setting_info


def failure(capfd: pytest.CaptureFixture, *arguments: str) -> str:
    """Run the command line, expect it to fail with one sentence and nothing else, and return the sentence."""
    assert cli.main(arguments) == 1
    out, error = capfd.readouterr()
    assert out == ""
    assert error.count("\n") == 1
    assert error.endswith(".\n")
    return error.strip()


def test_help_names_all_commands(capfd: pytest.CaptureFixture) -> None:
    """List the commands and exit with 0."""
    assert cli.main(["--help"]) == 0
    out, error = capfd.readouterr()
    assert error == ""
    for command in ("render", "bench", "warmup", "info"):
        assert f"\n    {command} " in out


def test_options_repeat_the_settings(capfd: pytest.CaptureFixture) -> None:
    """Show each setting's own help and default."""
    assert cli.main(["render", "--help"]) == 0
    out = " ".join(capfd.readouterr().out.split())
    for name, flag in cli.OPTIONS.items():
        field = setting_info(SamplingSettings)[name]
        assert flag in out
        assert field.metadata["help"] in out
        assert f"{field.default} in a new scene" in out


@pytest.mark.parametrize(("arguments", "words"), [
    ((), "required: COMMAND"),
    (("paint",), "paint"),
    (("render", "a.blend"), "--output"),
    (("render", "a.blend", "-o", "a.exr", "--samples", "0"),
     "--samples must be a whole number from 1 to 16777216, not '0'"),
    (("render", "a.blend", "-o", "a.exr", "--samples", "2.5"), "not '2.5'"),
    (("render", "a.blend", "-o", "a.exr", "--time", "nan"), "--time must be a number from 0 to"),
    (("render", "a.blend", "-o", "a.exr", "--seed", "-1"), "--seed"),
    (("render", "a.blend", "-o", "a.exr", "--size", "0", "9"), "--size must be a whole number from 1 to 65536"),
    (("render", "a.blend", "-o", "a.exr", "--size", "9"), "--size"),
    (("render", "a.blend", "-o", "a.exr", "--device", "tpu"), "tpu"),
    (("render", "a.blend", "-o", "a.exr", "--frame", "x"), "--frame"),
    (("render", "a.blend", "-o", "a.exr", "--integrator", "fast"), "fast"),
    (("render", "a.blend", "-o", "a.exr", "--preset", "custom"), "custom"),
    (("render", "a.blend", "-o", "a.exr", "--debug-view", "nothing"), "nothing"),
    (("render", "a.blend", "-o", "a.exr", "--debug-view", "gbuffer.normal", "--integrator", "reference"),
     "has no debug views; use --integrator realtime."),
    (("render", "missing.blend", "-o", "a.exr"), "The scene 'missing.blend' does not exist."),
    (("render", __file__, "-o", "a.jpg"), "must end in .exr or .png"),
])
def test_wrong_arguments_give_a_sentence(capfd: pytest.CaptureFixture, arguments: tuple[str, ...], words: str) -> None:
    """Say in one sentence which argument is wrong and exit with 1."""
    assert words in failure(capfd, *arguments)


def test_a_folder_is_no_output(capfd: pytest.CaptureFixture, tmp_path: Path) -> None:
    """Refuse to write over a folder."""
    folder = tmp_path / "pictures.exr"
    folder.mkdir()
    assert "is a folder" in failure(capfd, "render", __file__, "-o", str(folder))


def test_arguments_are_read_without_blender() -> None:
    """Refuse wrong arguments in a process that has not loaded bpy."""
    script = ("import sys; from burnish.addon import cli; cli.main(['render', 'missing.blend', '-o', 'a.exr']);"
              "raise SystemExit('bpy' in sys.modules)")
    assert subprocess.run([sys.executable, "-c", script], timeout=60, capture_output=True, check=False).returncode == 0


def test_info_says_what_a_bug_report_needs(capfd: pytest.CaptureFixture) -> None:
    """Print the versions, the devices and the folder of built kernels, and nothing else."""
    from burnish.engine.device import kernel_cache_folder

    assert cli.main(["info"]) == 0
    out, error = capfd.readouterr()
    lines = out.splitlines()
    version = tomllib.loads((Path(__file__).parents[2] / "blender_manifest.toml").read_text("utf-8"))["version"]
    assert f"Burnish: {version}" in lines
    assert f"Kernel cache: {kernel_cache_folder()}" in lines
    assert any(line.startswith("Device cpu: ") for line in lines)
    assert error == ""


def test_an_unexpected_error_is_one_sentence(capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hide the traceback of an error that nobody foresaw, but name its type."""
    def broken(arguments: object, console: object) -> int:
        raise ZeroDivisionError("two\nlines")

    monkeypatch.setattr(cli, "run_info", broken)
    assert "ZeroDivisionError: two lines" in failure(capfd, "info")


def test_foreign_output_goes_aside(capfd: pytest.CaptureFixture) -> None:
    """Let only the console's lines out while output is diverted, and everything again afterwards."""
    with cli_output.diverted_output(show_all=False) as console:
        os.write(1, b"native\n")
        os.write(2, b"native\n")
        print("python")
        print("Fra:1 Mem:2M | Sample 1/2")
        console.print("ours")
    print("after")
    assert capfd.readouterr() == ("ours\nafter\n", "")


def test_readers_may_leave() -> None:
    """Go on without a word where nobody reads the lines any more, as behind `| head`, and leave other output as is."""
    reading, writing = os.pipe()
    os.close(reading)
    saved = os.dup(1)
    os.dup2(writing, 1)
    try:
        with cli_output.diverted_output(show_all=False) as console:
            console.print("first")
            console.print("second")
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(writing)


def test_output_returns_after_an_error(capfd: pytest.CaptureFixture) -> None:
    """Restore the output when the diverted block raises."""
    with pytest.raises(BurnishError), cli_output.diverted_output(show_all=False):
        raise BurnishError("no")
    os.write(1, b"native\n")
    assert capfd.readouterr().out == "native\n"


def layers() -> list[write.LayerPixels]:
    """Return two layers of 3x2 pixels whose values tell where they belong."""
    def ramp(channels: int, start: float) -> np.ndarray:
        return np.arange(start, start + 6 * channels, dtype=np.float32).reshape(2, 3, channels)

    first = write.LayerPixels("View", (write.PassPixels("Combined", "RGBA", ramp(4, 0.0)),
                                       write.PassPixels("Depth", "Z", ramp(1, 100.0)),
                                       write.PassPixels("Normal", "XYZ", ramp(3, 200.0))))
    second = write.LayerPixels("Back", (write.PassPixels("Combined", "RGBA", ramp(4, 300.0)),))
    return [first, second]


def test_exr_holds_every_pass(tmp_path: Path) -> None:
    """Read back every channel under its name, bit for bit, the top row first."""
    path = tmp_path / "new" / "picture.exr"
    write.write_exr(path, layers(), {"burnish:samples": 7})
    buffer = oiio.ImageBuf(str(path))
    spec = buffer.spec()
    assert spec.format == oiio.FLOAT
    assert spec.get_int_attribute("burnish:samples") == 7
    pixels = buffer.get_pixels(oiio.FLOAT)
    for layer, prefix in zip(layers(), ("", "Back.Combined."), strict=True):
        for index, channel in enumerate("RGBA"):
            read = pixels[..., spec.channelnames.index(prefix + channel)]
            np.testing.assert_array_equal(read, layer.combined[::-1, :, index])
    depth = pixels[..., spec.channelnames.index("View.Depth.Z")]
    np.testing.assert_array_equal(depth, layers()[0].passes[1].pixels[::-1, :, 0])
    assert {"View.Normal.X", "View.Normal.Y", "View.Normal.Z"} <= set(spec.channelnames)
    assert [entry.name for entry in path.parent.iterdir()] == ["picture.exr"]


def test_a_failed_write_leaves_no_file(tmp_path: Path) -> None:
    """Say that a file can't be written, leave nothing behind and keep the file that was there."""
    path = tmp_path / "picture.exr"
    path.write_text("before")
    with pytest.raises(ZeroDivisionError), write.complete_file(path) as partial:
        partial.write_text("half")
        raise ZeroDivisionError
    assert path.read_text() == "before"
    with pytest.raises(BurnishError, match="can't be saved"):
        write.write_exr(path / "below.exr", layers(), {})
    assert [entry.name for entry in tmp_path.iterdir()] == ["picture.exr"]
