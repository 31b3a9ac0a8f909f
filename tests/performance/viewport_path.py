# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure the viewport's way from a change in Blender to a picture that can be drawn. Run by hand.

    python tests/performance/viewport_path.py SCENE.blend... [--device cuda] [--size 1920 1080] [--moves 40]

Moves the camera, then an object, through Blender's own depsgraph, the add-on's extractor and the viewport's worker with
its thread, and waits each time for the first picture of it: packed colours in the processor's memory, as they
are uploaded where OpenGL and CUDA do not share a device. Not in it: Blender's timer, which asks for a redraw up to
1/60 s later, and the draw call. Prints medians and the slowest tenth, in milliseconds.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.addon.builds import open_session  # noqa: E402
from burnish.addon.extract.camera import camera_from_scene  # noqa: E402
from burnish.addon.extract.scene import SceneExtractor  # noqa: E402
from burnish.addon.view_request import ViewRequest  # noqa: E402
from burnish.addon.worker import ViewportWorker  # noqa: E402
from burnish.engine.report import Report  # noqa: E402
from burnish.engine.session import Session  # noqa: E402
from burnish.engine.settings import RenderSettings  # noqa: E402

from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.measured_session import attempt, settings_for  # noqa: E402

PATIENCE = 120.0
"""Seconds to wait for a picture"""

WARM_UP = 144
"""Moves before those that are measured: histories fill, light settles, and the frame's records are made"""

TRIANGLES = 20000
"""Of the object that is moved, at most"""


class HiddenViewport:
    """A viewport without a window: its extractor, its worker, and a clock."""

    def __init__(self, file: Path, size: tuple[int, int], device: str):
        self.scene = BlendScene(file, size, device, matte=False)
        settings = settings_for("realtime", device)
        # All pixels, however slow; and one frame for each move, after which the worker rests.
        self.settings = replace(
            settings, performance=replace(settings.performance, viewport_pixel_size=1),
            sampling=replace(settings.sampling, viewport_samples=1))
        self.size, self.extractor, self.extraction = size, SceneExtractor(), 0.0
        self.inside: dict[str, list[float]] = {"update": [], "configure": [], "step": [], "read": []}
        self.worker = ViewportWorker(session_factory=self.open_session)
        self.published, publish = threading.Event(), self.worker._publish

        def tell(*arguments: Any) -> None:
            publish(*arguments)
            self.published.set()

        # Blender's main thread waits without Python; one that looked again and again would hold the worker up.
        self.worker._publish = tell
        self.worker.start()

    def open_session(self, settings: RenderSettings) -> Session:
        """Open the worker's session, whose calls are timed."""
        session = open_session(settings)
        for name in ("update", "configure", "step"):
            setattr(session, name, self.timed(name, getattr(session, name)))
        # The worker reads and packs the picture by its own method.
        self.worker._pixels_to_draw = self.timed("read", self.worker._pixels_to_draw)
        return session

    def timed(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that notes its milliseconds."""
        def run(*arguments: Any, **options: Any) -> Any:
            start = time.perf_counter()
            result = call(*arguments, **options)
            self.inside[name].append((time.perf_counter() - start) * 1e3)
            return result
        return run

    @property
    def serial(self) -> int:
        """Number of the newest picture."""
        return self.worker.picture.serial if self.worker.picture is not None else -1

    def extract(self, graph: bpy.types.Depsgraph) -> None:
        """Hand what has changed in Blender to the worker; inside a handler, where the graph knows what has."""
        start = time.perf_counter()
        self.worker.post_scene(self.extractor.extract(graph, viewport=True, report=Report()))
        self.extraction = time.perf_counter() - start

    def view(self) -> None:
        """Ask for the camera's view."""
        graph, scene = bpy.context.evaluated_depsgraph_get(), self.scene.scene
        camera = camera_from_scene(scene, scene.camera.evaluated_get(graph), *self.size)
        self.worker.post_view(ViewRequest(
            settings=self.settings, camera=camera, width=self.size[0], height=self.size[1]))

    def wait(self, serial: int) -> None:
        """Wait for a picture newer than `serial`.

        Raises:
            RuntimeError: The worker has failed, or none comes.
        """
        end = time.perf_counter() + PATIENCE
        while self.serial <= serial:
            if self.worker.failed or time.perf_counter() > end:
                raise RuntimeError(self.worker.status.error or "no picture came")
            self.published.wait(1.0)
            self.published.clear()

    def settle(self) -> None:
        """Wait until the worker rests."""
        while self.worker.status.busy:
            time.sleep(1e-3)

    def measure(self, name: str, move: Callable[[int], None], moves: int, *, edits: bool) -> None:
        """Time single moves: from the change to the first picture that shows it."""
        def handler(_: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
            self.extract(graph)

        rows = []
        for index in range(WARM_UP + moves):
            self.settle()
            self.extraction, serial, start = 0.0, self.serial, time.perf_counter()
            move(index)
            if edits:
                bpy.app.handlers.depsgraph_update_post.append(handler)
            bpy.context.view_layer.update()
            bpy.app.handlers.depsgraph_update_post.clear()
            evaluated = time.perf_counter()
            self.view()
            asked = time.perf_counter()
            self.wait(serial)
            end = time.perf_counter()
            rows.append([
                evaluated - start - self.extraction, self.extraction, asked - evaluated, end - asked, end - start])
        times = np.array(rows[WARM_UP:]).T * 1e3
        labels = ("Blender", "extraction", "view", "worker", "all")
        inside = {name: np.median(values[-moves:]) for name, values in self.inside.items() if values}
        print(f"VIEWPORT {self.scene.name}, {name}: " + ", ".join(
            f"{label} {np.median(values):.2f} ({np.quantile(values, 0.9):.2f})"
            for label, values in zip(labels, times, strict=True)) + " ms; of the worker "
            + ", ".join(f"{name} {value:.2f}" for name, value in inside.items()), flush=True)

    def close(self) -> None:
        """End the worker."""
        self.worker.stop()
        self.worker.join(10.0)


def movable() -> bpy.types.Object:
    """Return the object with the most triangles that are no more than TRIANGLES."""
    found = [(len(item.data.loop_triangles), item.name, item) for item in bpy.context.scene.objects
             if item.type == 'MESH' and not item.hide_render]
    fitting = [each for each in found if each[0] <= TRIANGLES] or found
    return max(fitting)[2]


def measure(file: Path, options: argparse.Namespace) -> None:
    """Measure one scene."""
    viewport = HiddenViewport(file, tuple(options.size), options.device)
    try:
        viewport.extract(bpy.context.evaluated_depsgraph_get())
        viewport.view()
        viewport.wait(-1)
        camera, item = viewport.scene.scene.camera, movable()
        place, home = camera.location.copy(), item.location.copy()
        step = 0.002 * sum(item.dimensions)

        def pan(index: int) -> None:
            camera.location = place
            camera.location.x += step * (1 + index % 7)

        def push(index: int) -> None:
            item.location = home
            item.location.x += step * (1 + index % 7)

        viewport.measure("camera move", pan, options.moves, edits=False)
        viewport.measure(f"object move ({len(item.data.loop_triangles)} triangles)", push, options.moves, edits=True)
    finally:
        viewport.close()


def main() -> int:
    """Measure all scenes; one that fails is told and skipped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(1920, 1080))
    parser.add_argument("--moves", type=int, default=40)
    options = parser.parse_args()
    return int(sum(attempt(file.stem, measure, file, options) for file in options.scenes) > 0)


if __name__ == "__main__":
    raise SystemExit(main())
