# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `burnish render`: opens a .blend file, renders one frame through the RenderEngine and saves it.

Renders as F12 does, so that a picture from here and one from Blender are the same; the passes come from
final.on_finished, since Blender has no pixels of a render result in background.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..engine.errors import BurnishError, InvalidScene
from ..engine.settings import SamplingSettings, setting_info
from ..engine.write import LayerPixels, PassPixels, complete_file, write_exr
from . import final, registered
from .cli_output import Console

__all__ = ["run"]

ENGINE = 'BURNISH'
LARGEST_RESOLUTION = 65536


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Render and save; prints `FILE 640x360 64 samples 12.3 s` last. Raises BurnishError."""
    source, target = Path(arguments.scene), Path(arguments.output)
    with registered(arguments.in_blender):
        return render_file(source, target, arguments, console)


def render_file(source: Path, target: Path, arguments: argparse.Namespace, console: Console) -> int:
    """Open `source`, set it up by `arguments`, render it and save the picture as `target`."""
    console.progress("Opening the scene")
    try:
        bpy.ops.wm.open_mainfile(filepath=str(source.resolve()), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise BurnishError(f"The scene '{source}' can't be opened: {sentence(error)}") from error
    scene = bpy.context.scene
    set_up(scene, arguments)
    start = time.perf_counter()
    layers, information = render(scene, arguments.debug_view)
    seconds = time.perf_counter() - start
    if target.suffix.lower() == ".exr":
        attributes = {"Software": "Burnish", "burnish:samples": information.samples, "burnish:seconds": seconds,
                      "burnish:device": information.device, "burnish:frame": scene.frame_current,
                      **information.header}
        write_exr(target, layers, attributes)
    else:
        save_png(target, layers[0].combined, scene)
    for line in information.report.text().splitlines():
        console.print(line)
    if arguments.timings:
        for line in timing_lines(information):
            console.print(line)
    height, width = layers[0].combined.shape[:2]
    console.print(f"{target} {width}x{height} {information.samples} samples {seconds:.1f} s")
    return 0


def set_up(scene: Any, arguments: argparse.Namespace) -> None:
    """Put the command line's options into the scene."""
    render_settings = scene.render
    render_settings.engine = ENGINE
    render_settings.use_compositing = render_settings.use_sequencer = False
    if arguments.size:
        set_size(render_settings, *arguments.size)
    if arguments.camera is not None:
        cameras = [thing.name for thing in scene.objects if thing.type == 'CAMERA']
        if arguments.camera not in cameras:
            raise InvalidScene(f"The scene has no camera '{arguments.camera}'; it has {listed(cameras)}.")
        scene.camera = scene.objects[arguments.camera]
    if scene.camera is None:
        raise InvalidScene("The scene has no active camera; name one with --camera or set one in the file.")
    if arguments.view_layer is not None:
        if arguments.view_layer not in scene.view_layers:
            raise InvalidScene(f"The scene has no view layer '{arguments.view_layer}'; it has "
                               f"{listed([layer.name for layer in scene.view_layers])}.")
        for layer in scene.view_layers:
            layer.use = layer.name == arguments.view_layer
    if arguments.frame is not None:
        scene.frame_set(arguments.frame)
    for name in ("integrator", "samples", "time_limit", "seed", "device"):
        value = getattr(arguments, name)
        if value is not None:
            assign(scene, name, value)
    if arguments.preset is not None:
        bpy.ops.burnish.apply_preset(preset=arguments.preset.upper())
    if arguments.debug_view and scene.burnish.sampling.integrator != 'REALTIME':
        raise InvalidScene("The scene's integrator has no debug views; use --integrator realtime.")
    if arguments.time_limit and arguments.samples is None:
        # A time alone means: as many samples as fit.
        assign(scene, "samples", setting_info(SamplingSettings)["samples"].metadata["high"])


def set_size(render_settings: Any, width: int, height: int) -> None:
    """Set the size in pixels.

    Blender keeps the sides to 4..65536, but not what a percentage makes of them: below 4 pixels, ask for a multiple.
    """
    multiple = {1: 4, 2: 2, 3: 2}.get(min(width, height), 1)
    if multiple * max(width, height) > LARGEST_RESOLUTION:
        raise InvalidScene(f"Blender can't render {width} x {height} pixels; make the short side at least 4.")
    render_settings.resolution_percentage = 100 // multiple
    render_settings.resolution_x, render_settings.resolution_y = multiple * width, multiple * height


def assign(scene: Any, name: str, value: Any) -> None:
    """Set one of the scene's Burnish settings; enums have their members' names in Blender."""
    owner = scene.burnish if name == "device" else scene.burnish.sampling
    setattr(owner, name, value.upper() if isinstance(value, str) else value)


def listed(names: list[str]) -> str:
    """Return names for a sentence."""
    return ", ".join(f"'{name}'" for name in names) if names else "none"


def timing_lines(information: final.RenderInfo) -> list[str]:
    """Return a table of where a render's time went: seconds by stage, milliseconds by section of a real-time frame."""
    rows = [(name, f"{seconds:.3f} s") for name, seconds in information.stats.times.items()]
    frame = information.frame_times
    if frame:
        rows.append(("one frame", f"{sum(frame.values()):.3f} ms"))
        rows += [(f"  {name}", f"{milliseconds:.3f} ms") for name, milliseconds in frame.items()]
    rows += [(f"  {name}", f"skipped: {reason}") for name, reason in information.skipped.items()]
    width = max((len(name) for name, _ in rows), default=0)
    # Figures end in one column; reasons begin there.
    return [f"{name:<{width}}  {text if 'skipped' in text else format(text, '>12')}" for name, text in rows]


def render(scene: Any, debug_view: str = "") -> tuple[list[LayerPixels], Any]:
    """Render the current frame, or an intermediate result; return all layers and the first one's RenderInfo."""
    layers: list[LayerPixels] = []
    found: list[Any] = []

    def keep(layer: str, view: str, pixels: dict[str, np.ndarray], information: final.RenderInfo) -> None:
        if information.cancelled:
            return
        layer_passes = tuple(PassPixels(name, information.channels[name], framed(array, information, scene))
                             for name, array in pixels.items())
        layers.append(LayerPixels(f"{layer}.{view}" if view else layer, layer_passes))
        found.append(information)

    final.on_finished.append(keep)
    final.debug_view = debug_view
    try:
        bpy.ops.render.render(write_still=False, scene=scene.name)
    except RuntimeError as error:
        raise BurnishError(sentence(error)) from error
    finally:
        final.on_finished.remove(keep)
        final.debug_view = ""
    if not layers:
        raise BurnishError("The render was cancelled; nothing was saved.")
    return layers, replace(found[0], header={name: text for each in found for name, text in each.header.items()})


def framed(pixels: np.ndarray, information: final.RenderInfo, scene: Any) -> np.ndarray:
    """Return `pixels` in the full frame where a render border without cropping made them smaller."""
    if information.crop is None or scene.render.use_crop_to_border:
        return pixels
    x, y, width, height = information.crop
    percentage = scene.render.resolution_percentage
    full_width = scene.render.resolution_x * percentage // 100
    full_height = scene.render.resolution_y * percentage // 100
    frame = np.zeros((full_height, full_width, pixels.shape[2]), np.float32)
    frame[y:y + height, x:x + width] = pixels
    return frame


def sentence(error: RuntimeError) -> str:
    """Return the sentence in an operator's error: the first that is ours, else the first."""
    lines = [line.strip().removeprefix("Error: ") for line in str(error).splitlines() if line.strip()]
    ours = [line.removeprefix("Burnish: ") for line in lines if line.startswith("Burnish: ")]
    return (ours or lines or ["Blender gave no reason"])[0]


def save_png(target: Path, pixels: np.ndarray, scene: Any) -> None:
    """Save float32 [h, w, 4], scene-linear, premultiplied, bottom row first, through the scene's view transform."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new("Burnish", width, height, alpha=True, float_buffer=True)
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).reshape(-1))
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = 'IMAGE'
    settings.file_format = 'PNG'
    settings.color_mode = 'RGBA' if scene.render.film_transparent else 'RGB'
    settings.color_depth = '8'
    settings.color_management = 'FOLLOW_SCENE'
    with complete_file(target) as partial:
        try:
            image.save_render(str(partial), scene=scene)
        except RuntimeError as error:
            raise BurnishError(f"The picture can't be saved as '{target}': {sentence(error)}") from error
    bpy.data.images.remove(image)
