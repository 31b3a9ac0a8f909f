# SPDX-License-Identifier: GPL-3.0-or-later
"""When each kernel of a frame ends, with all branches of the graph running side by side. CUDA only; run by hand.

    python tests/performance/frame_timeline.py SCENE.blend... [--size 1920 1080] [--frames 40]

After each launch of the frame, on its branch, a kernel of one thread writes the device's clock. A row for each launch,
in the order in which they end: milliseconds since the frame's start, how long after what came before on its branch,
section and kernel; medians over the frames of a flight. The stamps themselves make a frame longer, which is told.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

import numpy as np  # noqa: E402
import warp as wp  # noqa: E402
from burnish.addon import registered  # noqa: E402
from burnish.addon.measured_scene import open_measured  # noqa: E402
from burnish.engine import pipeline  # noqa: E402
from burnish.engine.device import choose_device  # noqa: E402
from burnish.engine.frame_graph import FrameGraph  # noqa: E402
from burnish.engine.measure import wait  # noqa: E402
from burnish.engine.measure_moving import measure_frames, there_and_back  # noqa: E402

from tests.performance.measured_session import attempt  # noqa: E402

FLIGHT = 60
STEPS = 1024
"""Most launches of a frame"""


@wp.func_native("""
#ifdef __CUDA_ARCH__
    unsigned long long now;
    asm volatile("mov.u64 %0, %globaltimer;" : "=l"(now));
    return now;
#else
    return 0;
#endif
""")
def device_clock() -> wp.uint64:
    """Return nanoseconds of the device's clock."""
    ...


@wp.kernel(enable_backward=False)
def stamp(place: int, stamps: wp.array[wp.uint64]):
    """Write down what time it is."""
    stamps[place] = device_clock()


class StampedGraph(FrameGraph):
    """A frame that notes when each of its steps ends."""

    def __init__(self, device: str):
        super().__init__(device)
        self.stamps = wp.zeros(STEPS, dtype=wp.uint64, device=device)
        # Modules can't be loaded while a graph is captured.
        wp.launch(stamp, 1, [0], [self.stamps], device=device)

    def _issue(self, step: object) -> None:
        super()._issue(step)
        launches = self._launches()
        wp.launch(stamp, 1, [next(i for i, each in enumerate(launches) if each is step)], [self.stamps],
                  device=self.device)

    def rows(self) -> list[tuple[str, str, str]]:
        """Return branch, section and kernel of each step."""
        return [(step.branch, step.section, step.kernel) for step in self._launches()]


def measure(path: Path, size: tuple[int, int], device: str, frames: int) -> None:
    """Print a scene's timeline."""
    scene = open_measured(path, size, device)
    try:
        cameras = scene.flight(size, FLIGHT)
        session, settings = scene.session, scene.settings
        plain = measure_frames(session, settings, cameras, size, frames=frames).in_a_row
        session.configure(settings, cameras[0], 32, 18)
        pipeline.FrameGraph = StampedGraph
        stamped = measure_frames(session, settings, cameras, size, frames=frames).in_a_row
        view, found, rows = there_and_back(cameras), [], None
        for number in range(frames):
            session.configure(settings, view(number), *size)
            session.step(1)
            wait(session)
            graph = session.pipeline._graph
            rows = rows or graph.rows()
            if graph.rows() == rows:
                times = graph.stamps.numpy()[: len(rows)].astype(np.int64)
                found.append((times - times.min()) / 1e6)
        ends = np.median(found, 0)
        print(f"{path.stem}: {plain:.3f} ms a frame, {stamped:.3f} with stamps, {len(rows)} launches, "
              f"{ends.max():.3f} from first to last", flush=True)
        last: dict[str, float] = {}
        for place in np.argsort(ends):
            branch, section, kernel = rows[place]
            end = ends[place]
            took = end - last.get(branch, 0.0)
            last[branch] = end
            print(f"    {end:7.3f} {took:+7.3f}  {branch or 'trunk':14} {section:28} {kernel}", flush=True)
    finally:
        pipeline.FrameGraph = FrameGraph
        scene.close()


def main() -> int:
    """Measure the scenes of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--size", nargs=2, type=int, default=(1920, 1080))
    parser.add_argument("--frames", type=int, default=40)
    arguments = parser.parse_args()
    device = choose_device("cuda")
    with registered(False):
        return sum(attempt(path.stem, measure, path, tuple(arguments.size), device, arguments.frames)
                   for path in arguments.scenes)


if __name__ == "__main__":
    sys.exit(main())
