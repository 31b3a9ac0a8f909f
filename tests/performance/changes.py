# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure what is left of things that have passed and of lamps that were switched, in scenes from files. Run by hand.

    python tests/performance/changes.py SCENE.blend... [--device cuda] [--size 640 360] [--only ball,lamp] [--alone]
        [--passes 4] [--rest 64] [--truth 128] [--set GROUP.FIELD=VALUE] [--output out/changes]

ball: a matte ball crosses the picture in 24 frames, at half of the median distance, and then goes on far away. Eight
frames later the picture is held against the mean of four sessions whose ball was far away all the time, by 16x16
blocks. Beside each figure is that of another such session: what chance alone makes. Both are means of --passes
sessions.
lamp: a point lamp between the camera and what it sees, which lights half of the pixels as much as all else does, is
switched off and on again. What is left of its light twelve frames later, by its light. Beside each figure is that of a
session which starts anew in that state and renders as many frames.
--alone judges frames without path-traced samples at rest.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import sys
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.image_error import box_filter  # noqa: E402
from burnish.engine.measure_moving import depths_seen, matrix_of  # noqa: E402
from burnish.engine.scene import InstanceTable, LightData, LightKind, SceneDelta  # noqa: E402

from tests.performance.blend_scene import BlendScene  # noqa: E402
from tests.performance.measured_session import Measured, attempt, positions_of, settings_for  # noqa: E402
from tests.performance.scene_pair import bad_pixels, dark, luminance  # noqa: E402
from tests.performance.settings_text import FILTERED, merged, parse_settings  # noqa: E402
from tests.performance.sheets import Table, error_map, save_sheet, tone  # noqa: E402

CROSSING = 24
"""Frames from one side of the picture to the other"""
AFTER_BALL, AFTER_LAMP = 8, 12
"""Frames after which the goals are meant"""
RADIUS = 0.06
"""Of the ball, by the picture's width at its distance"""
BALL_HEIGHT, LAMP_HEIGHT = 0.35, 0.65
"""By the picture's height, from below"""
FAR = 1000.0
"""Radii from the camera to a ball far away"""
SESSIONS = 4
"""That have not seen the ball near"""
BLOCK, OFF = 16, 0.05
"""Side of blocks [px], and how far they may be off"""
LEFT = 0.02
"""Of a lamp's light, at most"""
BALL = "Ball that passes"
COLUMNS = ("scene", "what", "p5", "p95", "share off by 5 %", "beside: p5", "beside: p95", "beside: share", "bad",
           "met")
GOALS = """\
ball: 5th and 95th percentile of blocks' light eight frames after it has passed, of those that it crossed and of all, by
that of sessions which have not seen it. Goal: within 5 %. lamp (p5): what is there of its light twelve frames after it
went off or came on, beyond what a long rest shows without it. Goal: within 0.02 of none or all of it, or of what a
session shows that starts anew, whose other light is as young. share: of blocks that are off by 5 % of the sum of their
light in both states. Light above 1 counts as 1 in blocks."""


class Stage:
    """A scene with a ball in it and a lamp that can be lit."""

    def __init__(self, path: Path, options: argparse.Namespace):
        self.options, self.size = options, tuple(options.size)
        self.file = BlendScene(path, self.size, options.device, matte=False)
        self.name, self.camera = self.file.name, self.file.camera
        self.settings = settings_for(
            "realtime", options.device, **merged(FILTERED if options.alone else None, parse_settings(options.set)))
        self.content = self.file.extract()
        probe = Measured(self.settings)
        probe.load(self.content)
        places = positions_of(probe, self.camera, self.size)
        probe.close()
        self.axes, self.distance = matrix_of(self.camera), 0.5 * depths_seen(self.camera, places, (50,))[0]
        left, right, bottom, top = self.camera.window
        self.sides, self.heights = (left, right), (bottom, top)
        self.radius = RADIUS * self.distance * (right - left)

    def height(self, share: float) -> float:
        """Return the place in the camera's window at a share of its height."""
        return self.heights[0] + share * (self.heights[1] - self.heights[0])

    def at(self, x: float, y: float) -> np.ndarray:
        """Return the world position at the stage's distance, x and y in the camera's window."""
        return self.axes[:3, 3] + self.axes[:3, :3] @ (np.array((x, y, -1.0)) * self.distance)

    def ball_place(self, frame: int) -> np.ndarray:
        """Return where the ball is: outside to the left in frame 0, to the right before frame CROSSING, then far."""
        if not 0 <= frame < CROSSING:
            return self.axes[:3, 3] + self.axes[:3, 2] * self.radius * (FAR + 0.01 * frame)
        edge = self.radius / self.distance
        first, last = self.sides[0] - 1.2 * edge, self.sides[1] + 1.2 * edge
        x = first + (last - first) * frame / (CROSSING - 1)
        return self.at(x, self.height(BALL_HEIGHT))

    def crossed(self) -> np.ndarray:
        """Return a mask [h, w] of the pixels that the ball covers in any frame."""
        width, height = self.size
        rows = self.height((np.arange(height) + 0.5) / height)
        covered = np.abs(rows - self.height(BALL_HEIGHT)) < self.radius / self.distance
        return np.repeat(covered[:, None], width, 1)

    def with_ball(self) -> tuple[SceneDelta, int]:
        """Return the scene with the ball, and its row among the instances."""
        bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=self.radius)
        ball = bpy.context.object
        ball.name = BALL
        material = bpy.data.materials.new(BALL)
        shader = next(node for node in material.node_tree.nodes if node.type == 'BSDF_PRINCIPLED')
        shader.inputs["Base Color"].default_value = (0.7, 0.2, 0.1, 1.0)
        shader.inputs["Roughness"].default_value = 0.6
        ball.data.materials.append(material)
        for polygon in ball.data.polygons:
            polygon.use_smooth = True
        bpy.context.view_layer.update()
        content = self.file.extract()
        table = content.instances
        row = int(np.flatnonzero(np.array(table.object_names)[table.object_name_index] == ball.name)[0])
        return content, row

    def lamp(self, power: float) -> LightData:
        """Return the lamp [W of each channel]."""
        place = np.eye(4)
        place[:3, 3] = self.at(0.5 * sum(self.sides), self.height(LAMP_HEIGHT))
        return LightData(
            name="Lamp that is switched", kind=LightKind.POINT, transform=place, color=(power,) * 3,
            radius=0.3 * self.radius)

    def start(self, content: SceneDelta, seed: int = 0) -> Measured:
        """Return a session with a scene that looks through the camera."""
        sampling = dataclasses.replace(self.settings.sampling, seed=seed)
        measured = Measured(dataclasses.replace(self.settings, sampling=sampling))
        measured.load(content)
        measured.look(self.camera, self.size)
        return measured

    def shown(self, content: SceneDelta, frames: int, seed: int = 0) -> np.ndarray:
        """Return a scene's picture after so many frames from the first on."""
        measured = self.start(content, seed)
        measured.frames(frames)
        picture = measured.picture()
        measured.close()
        return picture


def moved(table: InstanceTable, row: int, place: np.ndarray) -> InstanceTable:
    """Return instances of which one is elsewhere."""
    transforms = table.transforms.copy()
    transforms[row] = np.eye(4)
    transforms[row, :3, 3] = place
    return dataclasses.replace(table, transforms=transforms)


def blocks(picture: np.ndarray) -> np.ndarray:
    """Return the light of blocks."""
    return box_filter(luminance(np.minimum(picture, 1.0))[..., None], BLOCK)[..., 0]


def block_figures(ratios: np.ndarray) -> tuple[float, float, float]:
    """Return percentiles of ratios and the share that is off."""
    low, high = np.percentile(ratios, (5, 95))
    return float(low), float(high), float((np.abs(ratios - 1.0) > OFF).mean())


def pass_by(stage: Stage, content: SceneDelta, row: int, seed: int, *, near: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the pictures in the middle of the ball's way and some frames after its end; `near`: it comes into view."""
    def instances(frame: int) -> InstanceTable:
        return moved(content.instances, row, stage.ball_place(frame if near else CROSSING + frame))

    measured = stage.start(dataclasses.replace(content, instances=instances(0)), seed)
    measured.frames(stage.options.rest)
    for frame in range(1, CROSSING + AFTER_BALL):
        measured.load(SceneDelta(instances=instances(frame)))
        measured.frames(1)
        if frame == CROSSING // 2:
            during = measured.picture()
    gone = measured.picture()
    measured.close()
    return during, gone


def measure_ball(stage: Stage, table: Table) -> None:
    """Let a ball pass, add its rows and save its pictures."""
    content, row = stage.with_ball()
    seeds = iter(range(SESSIONS + 2 * stage.options.passes))
    passes = [pass_by(stage, content, row, next(seeds), near=True) for _ in range(stage.options.passes)]
    others = [pass_by(stage, content, row, next(seeds), near=False)[1] for _ in range(SESSIONS)]
    beside = [pass_by(stage, content, row, seed, near=False)[1] for seed in seeds]
    steady, light = np.mean(others, 0), np.mean([blocks(picture) for picture in others], 0)
    crossed = box_filter(stage.crossed()[..., None].astype(float), BLOCK)[..., 0] > 0.5
    (during, gone), after = passes[0], [picture for _, picture in passes]
    bad = sum(bad_pixels(picture) for picture in after)

    def figures(pictures: list[np.ndarray], mask: np.ndarray) -> np.ndarray:
        return np.mean([block_figures((blocks(picture) / light)[mask]) for picture in pictures], 0)

    for what, mask in (("ball, crossed", crossed), ("ball, all", np.ones_like(crossed))):
        low, high, share = figures(after, mask)
        good = low >= 1.0 - OFF and high <= 1.0 + OFF and bad == 0
        table.add(stage.name, what, low, high, share, *figures(beside, mask), bad, "yes" if good else "NO")
    save(stage, "ball", [(during, "ball passing"), (gone, f"{AFTER_BALL} frames after"), (steady, "not seen")],
         (steady, gone))


def lamp_power(stage: Stage) -> float:
    """Return the power [W] of a lamp that gives half of the pixels below 1 as much light as all else."""
    watt = stage.distance**2 * 10.0
    without = stage.shown(stage.content, AFTER_BALL)
    lit = stage.shown(dataclasses.replace(stage.content, lights=[*lamps(stage), stage.lamp(watt)]), AFTER_BALL)
    seen = dark(without)
    before, added = luminance(without)[seen], (luminance(lit) - luminance(without))[seen]
    return watt / float(np.median(added / np.maximum(before, 1e-3)))


def lamps(stage: Stage) -> list[LightData]:
    """Return the scene's own lamps."""
    return list(stage.content.lights or ())


def measure_lamp(stage: Stage, table: Table) -> None:
    """Switch the lamp off and on, add its rows and save its pictures."""
    power = lamp_power(stage)
    states = {"off": lamps(stage), "on": [*lamps(stage), stage.lamp(power)]}
    scenes = {name: dataclasses.replace(stage.content, lights=lights) for name, lights in states.items()}
    steady = {name: stage.shown(scene, stage.options.truth, 7) for name, scene in scenes.items()}
    seen = dark(steady["on"])
    low, high = (luminance(steady[name]) for name in ("off", "on"))
    light = (high - low)[seen].sum()
    both = blocks(steady["off"]) + blocks(steady["on"])
    measured = stage.start(scenes["on"])
    measured.frames(stage.options.rest)
    shown = []
    for name, goal in (("off", 0.0), ("on", 1.0)):
        measured.load(SceneDelta(lights=states[name]))
        measured.frames(AFTER_LAMP)
        picture, anew = measured.picture(), stage.shown(scenes[name], AFTER_LAMP)
        shown.append((picture, f"{AFTER_LAMP} frames after it went {name}"))
        bad = bad_pixels(picture)
        row: list[float] = []
        for each in (picture, anew):
            share = float((luminance(each) - low)[seen].sum() / light)
            off = np.abs(blocks(each) - blocks(steady[name])) / both
            row += [share, float("nan"), float((off > OFF).mean())]
        good = min(goal, row[3]) - LEFT <= row[0] <= max(goal, row[3]) + LEFT and bad == 0
        table.add(stage.name, f"lamp {name}", *row, bad, "yes" if good else "NO")
        measured.frames(stage.options.rest - AFTER_LAMP)
    measured.close()
    save(stage, "lamp", [shown[0], (steady["off"], "steady state"), shown[1], (steady["on"], "steady state")],
         (steady["off"], shown[0][0]))


def save(stage: Stage, name: str, pictures: list[tuple[np.ndarray, str]], pair: tuple[np.ndarray, np.ndarray]) -> None:
    """Save pictures beside each other, the error of a pair of them last."""
    exposure = stage.file.exposure
    row = [(tone(picture, exposure), f"{stage.name}: {label}") for picture, label in pictures]
    save_sheet(stage.options.output / f"{stage.name}_{name}.png",
               [[*row, (error_map(*pair, exposure=exposure), "error x4")]])


MEASURES = {"ball": measure_ball, "lamp": measure_lamp}


def measure(path: Path, options: argparse.Namespace, table: Table) -> None:
    """Add the rows of one scene."""
    for name, each in MEASURES.items():
        if not options.only or name in options.only.split(","):
            each(Stage(path, options), table)


def main() -> int:
    """Measure all scenes; one that fails is told and skipped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--size", type=int, nargs=2, default=(640, 360))
    parser.add_argument("--only", default="", help="ball or lamp; default: both")
    parser.add_argument("--alone", action="store_true", help="without path-traced samples at rest")
    parser.add_argument("--passes", type=int, default=4, help="of the ball, whose figures' mean is taken")
    parser.add_argument("--rest", type=int, default=64, help="frames before anything changes")
    parser.add_argument("--truth", type=int, default=128, help="frames of the steady state")
    parser.add_argument("--set", action="append", default=[], metavar="GROUP.FIELD=VALUE")
    parser.add_argument("--output", type=Path, default=Path("out/changes"))
    options = parser.parse_args()
    table = Table(COLUMNS)
    failed = sum(attempt(path.stem, measure, path, options, table) for path in options.scenes)
    title = "After changes, {} x {}, {}".format(*options.size, options.device)
    table.save(options.output / "changes.md", title + (", frames alone" if options.alone else ""), GOALS)
    table.save_json(options.output / "changes.json")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
