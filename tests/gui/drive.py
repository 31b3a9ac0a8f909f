# SPDX-License-Identifier: GPL-3.0-or-later
"""Uses Burnish in a real Blender window as a person would, takes pictures of the screen and notes what they show.

Runs inside Blender: `blender scene.blend --python drive.py -- FOLDER INTEGRATOR`. Writes FOLDER/*.png and
FOLDER/result.json; test_window.py starts it and judges. Only what the screen shows counts; the engine is asked just
whether it rests.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

FOLDER, INTEGRATOR = Path(sys.argv[-2]), sys.argv[-1]
MOVED, EDITED = "Ceramic roughness 0.50", "Gold roughness 0.00"
"""Objects of the gallery: one to move, one whose material to edit."""
LAMP = "Key softbox"
"""Its brightest lamp from the front."""

POLL_SECONDS = 1.0
FIRST_PICTURE_SECONDS = 600.0
"""The first picture may wait for the kernels to be compiled."""
SETTLE_SECONDS = 240.0
VIEWPORT_SAMPLES = {'REFERENCE': 8, 'REALTIME': 24}[INTEGRATOR]
"""After which the viewport rests."""

VISIBLE = 0.05
"""Change of a block's mean that a person sees and noise hardly reaches."""

result: dict[str, Any] = {"steps": [], "blender": bpy.app.version_string}


def grab(name: str | None = None) -> np.ndarray:
    """Return the 3D view on the screen, float [h, w, 3] in 0..1, top row first; keep it as NAME.png if asked."""
    if name:
        subprocess.run(["import", "-window", "root", str(FOLDER / f"{name}.png")], check=True, timeout=60)
    data = subprocess.run(["import", "-window", "root", "-depth", "8", "ppm:-"], check=True, timeout=60,
                          capture_output=True).stdout
    kind, size, depth, pixels = data.split(b"\n", 3)
    assert (kind, depth) == (b"P6", b"255")
    width, height = map(int, size.split())
    screen = np.frombuffer(pixels, np.uint8).reshape(height, width, 3).astype(np.float32) / 255.0
    region = view()[2]
    bottom = height - region.y
    assert region.height <= bottom and region.x + region.width <= width, "the window is larger than the screen"
    return screen[bottom - region.height:bottom, region.x:region.x + region.width]


def view() -> tuple[Any, Any, Any]:
    """Return window, area and region of the 3D view; looked up anew, since Blender replaces them."""
    window = bpy.context.window_manager.windows[0]
    area = max((area for area in window.screen.areas if area.type == 'VIEW_3D'), key=lambda a: a.width * a.height)
    return window, area, next(region for region in area.regions if region.type == 'WINDOW')


def structure(picture: np.ndarray) -> float:
    """Return how much of a picture differs from its commonest tone: 0 when blank, a line of text gives little."""
    height, width = (side // 16 * 16 for side in picture.shape[:2])
    blocks = picture[:height, :width].reshape(height // 16, 16, width // 16, 16, 3).mean((1, 3))
    return float((np.abs(blocks - np.median(blocks, (0, 1))).max(-1) > 0.02).mean())


def difference(first: np.ndarray, second: np.ndarray) -> float:
    """Return the mean absolute difference of two pictures, over blocks of 4x4 pixels so that noise counts little."""
    height, width = (side // 4 * 4 for side in first.shape[:2])
    blocks = (first - second)[:height, :width].reshape(height // 4, 4, width // 4, 4, 3).mean((1, 3))
    return float(np.abs(blocks).mean())


def changed(first: np.ndarray, second: np.ndarray) -> float:
    """Return the share of blocks of 8x8 pixels that differ visibly between two pictures."""
    height, width = (side // 8 * 8 for side in first.shape[:2])
    blocks = (first - second)[:height, :width].reshape(height // 8, 8, width // 8, 8, 3).mean((1, 3))
    return float((np.abs(blocks).max(-1) > VISIBLE).mean())


def wait(condition: Callable[[], bool], seconds: float, what: str) -> Iterator[float]:
    """Give Blender time until `condition` holds."""
    start = time.monotonic()
    while not condition():
        if time.monotonic() - start > seconds:
            grab("failed")
            raise AssertionError(f"{what}: not seen within {seconds:.0f} s")
        yield POLL_SECONDS


def resting() -> bool:
    """Tell whether no viewport is rendering."""
    module = next(module for name, module in sys.modules.items() if name.endswith(".burnish.addon.viewport"))
    return not any(viewport.tick() for viewport in module.viewports)


def settle(name: str) -> Iterator[float]:
    """Wait until the viewport rests, keep its picture as NAME.png and in `pictures`."""
    start = time.monotonic()
    yield POLL_SECONDS
    yield from wait(resting, SETTLE_SECONDS, f"the end of '{name}'")
    yield POLL_SECONDS
    pictures[name] = grab(name)
    result["steps"].append({"name": name, "structure": structure(pictures[name]),
                            "mean": float(pictures[name].mean()), "seconds": time.monotonic() - start})


def expect_change(before: str, after: str, least: float) -> None:
    """Note and require that two settled pictures differ visibly in more than this share of their blocks."""
    amount = changed(pictures[before], pictures[after])
    result[f"{before} to {after}"] = amount
    assert amount > least, f"the picture hardly changed from '{before}' to '{after}': {amount:.5f}"


pictures: dict[str, np.ndarray] = {}


def prepare() -> Iterator[float]:
    """Leave nothing but the 3D view on the screen, in solid mode, seen by the camera."""
    window, area, region = view()
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.screen.screen_full_area(use_hide_panels=True)
    yield POLL_SECONDS
    space = view()[1].spaces.active
    space.show_region_header = space.show_region_toolbar = space.show_region_ui = False
    space.show_gizmo = space.overlay.show_overlays = False
    space.region_3d.view_perspective = 'CAMERA'
    space.shading.type = 'SOLID'
    window, area, region = view()
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.view3d.view_center_camera()
    bpy.context.scene.render.engine = 'BURNISH'
    bpy.context.scene.burnish.sampling.integrator = INTEGRATOR
    bpy.context.scene.burnish.sampling.viewport_samples = VIEWPORT_SAMPLES
    yield 2 * POLL_SECONDS
    pictures["solid"] = grab("solid")


def render_in_view() -> Iterator[float]:
    """Switch to Rendered and wait for a picture."""
    view()[1].spaces.active.shading.type = 'RENDERED'
    start = time.monotonic()
    yield POLL_SECONDS
    yield from wait(lambda: structure(grab()) > 0.3 and difference(grab(), pictures["solid"]) > 0.01,
                    FIRST_PICTURE_SECONDS, "a rendered picture")
    result["first picture seconds"] = time.monotonic() - start
    yield from settle("rendered")


def orbit() -> Iterator[float]:
    """Drag with the middle mouse button; look at the picture while the button is held, and after."""
    region = view()[2]
    x, y = region.x + region.width // 2, region.height // 2
    pointer(["mousemove", str(x), str(y), "mousedown", "2"])
    yield 0.2
    for _ in range(8):
        pointer(["mousemove_relative", "--", "12", "3"])
        yield 0.15
    yield POLL_SECONDS
    held = grab("orbiting")
    result["structure while orbiting"] = structure(held)
    pointer(["mouseup", "2"])
    assert result["structure while orbiting"] > 0.2, "the picture is blank while orbiting"
    yield from settle("orbit")
    expect_change("rendered", "orbit", 0.2)


def pointer(arguments: list[str]) -> None:
    """Move or press the mouse on the virtual screen."""
    subprocess.run(["xdotool", *arguments], check=True, timeout=30)


def edit() -> Iterator[float]:
    """Move an object, edit a material, undo both; each must show."""
    undo_push("before")
    bpy.data.objects[MOVED].location.z += 1.2
    undo_push("move")
    yield from settle("moved")
    expect_change("orbit", "moved", 0.005)
    principled(EDITED).inputs["Roughness"].default_value = 1.0
    undo_push("roughness")
    yield from settle("roughness")
    expect_change("moved", "roughness", 0.001)
    for _ in range(2):
        window, area, region = view()
        with bpy.context.temp_override(window=window, area=area, region=region):
            bpy.ops.ed.undo()
        yield POLL_SECONDS
    yield from settle("undone")
    left = result["left after undo"] = changed(pictures["orbit"], pictures["undone"])
    assert left < 0.25 * result["orbit to moved"], f"undo did not bring the picture back: {left:.5f}"


def principled(name: str) -> Any:
    """Return the Principled BSDF of an object's material."""
    nodes = bpy.data.objects[name].active_material.node_tree.nodes
    return next(node for node in nodes if node.type == 'BSDF_PRINCIPLED')


def undo_push(message: str) -> None:
    """Close an undo step, as an operator does."""
    window, area, region = view()
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.ed.undo_push(message=message)


def switch_lamp() -> Iterator[float]:
    """Turn a lamp off and on again; nothing of its light may stay, and all of it must come back."""
    lamp = bpy.data.objects[LAMP].data
    power, lamp.energy = lamp.energy, 0.0
    yield from settle("lamp off")
    expect_change("undone", "lamp off", 0.02)
    lamp.energy = power
    yield from settle("lamp on")
    left = result["left after the lamp"] = changed(pictures["undone"], pictures["lamp on"])
    assert left < 0.25 * result["undone to lamp off"], f"the lamp's light did not come back: {left:.5f}"


def debug_view() -> Iterator[float]:
    """Look at an intermediate result, chosen as in the panel, and go back to the picture."""
    debug = bpy.context.scene.burnish.debug
    debug.view = 'gbuffer.normal'
    yield from settle("normals")
    expect_change("lamp on", "normals", 0.5)
    debug.view = 'NONE'
    yield from settle("no debug view")
    left = result["left after the debug view"] = changed(pictures["lamp on"], pictures["no debug view"])
    assert left < 0.05, f"the picture did not come back after the debug view: {left:.5f}"


def switch_modes() -> Iterator[float]:
    """Leave and enter Rendered quickly, a few times."""
    shading = view()[1].spaces.active.shading
    for mode in ('SOLID', 'RENDERED') * 3:
        shading.type = mode
        yield 0.3
    yield from wait(lambda: structure(grab()) > 0.3, SETTLE_SECONDS, "a picture after switching modes")
    yield from settle("switched")
    left = result["left after switching"] = changed(pictures["undone"], pictures["switched"])
    assert left < 0.25 * result["orbit to moved"], f"the picture is another after switching modes: {left:.5f}"


def final_render() -> Iterator[float]:
    """Press F12 at a small size while the viewport renders, and look at the saved result."""
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 160, 90, 100
    scene.burnish.sampling.samples = 4
    ends: list[str] = []
    bpy.app.handlers.render_complete.append(lambda *_: ends.append("complete"))
    bpy.app.handlers.render_cancel.append(lambda *_: ends.append("cancelled"))
    bpy.context.preferences.view.render_display_type = 'NONE'
    window, area, region = view()
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.render.render('INVOKE_DEFAULT')
    yield from wait(lambda: bool(ends), SETTLE_SECONDS, "the end of a final render")
    assert ends == ["complete"], f"the final render ended as {ends}"
    path = FOLDER / "final.png"
    scene.render.image_settings.file_format = 'PNG'
    bpy.data.images["Render Result"].save_render(str(path), scene=scene)
    image = bpy.data.images.load(str(path))
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    result["final structure"] = structure(pixels.reshape(image.size[1], image.size[0], -1)[..., :3])
    assert result["final structure"] > 0.3, "the final render is blank"


def everything() -> Iterator[float]:
    """Take all steps in order."""
    own = (switch_lamp, debug_view) if INTEGRATOR == 'REALTIME' else ()
    for step in (prepare, render_in_view, orbit, edit, *own, switch_modes, final_render):
        yield from step()


def advance() -> float | None:
    """Go on with the steps; called by Blender's timer. Ends Blender after the last one."""
    try:
        return next(steps)
    except StopIteration:
        result["finished"] = True
    except Exception as error:
        result["error"] = str(error)
        traceback.print_exc()
    (FOLDER / "result.json").write_text(json.dumps(result, indent=1))
    bpy.ops.wm.quit_blender()
    return None


steps = everything()
bpy.app.timers.register(advance, first_interval=2.0)
