# SPDX-License-Identifier: GPL-3.0-or-later
"""What the real-time integrator is held to, as functions that measure: energy, leaks, corners, contacts, changes.

Each returns Figures, with the goal of each, and the pictures they come from. tests/performance/leaks.py prints them
all, tests/unit/engine/test_realtime_light.py asserts the quick ones.
"""

import dataclasses

import numpy as np
from burnish.engine.image_error import LUMINANCE_WEIGHTS, box_filter
from burnish.engine.scene import SceneDelta
from burnish.engine.session import Session
from burnish.engine.settings import (
    DenoiserSettings,
    FilmSettings,
    Integrator,
    PixelFilter,
    RenderSettings,
    SamplingSettings,
)

from tests import light_scenes, scenes


@dataclasses.dataclass
class Figure:
    """A measured number and the range that it should be in."""

    name: str
    value: float
    low: float
    high: float

    @property
    def good(self):
        """Whether the goal is met."""
        return bool(np.isfinite(self.value)) and self.low <= self.value <= self.high


@dataclasses.dataclass
class Setup:
    """How to measure."""

    size: tuple = (96, 54)
    integrator: str = "realtime"
    truth_samples: int = 512
    groups: dict = dataclasses.field(default_factory=dict)
    """Changed settings by group, as {group: {field: value}}"""

    def settings(self, integrator=None):
        """Return the settings; at rest the frames go on, path tracing does not take over."""
        made = RenderSettings(
            device=scenes.SETTINGS.device, film=FilmSettings(pixel_filter=PixelFilter.BOX, filter_width=1.0),
            sampling=SamplingSettings(
                integrator=Integrator(integrator or self.integrator), seed=77 if integrator else 0),
            denoiser=DenoiserSettings(path_traced_rest=False))
        changed = {name: dataclasses.replace(getattr(made, name), **fields) for name, fields in self.groups.items()}
        return dataclasses.replace(made, **changed)

    def session(self, scene, integrator=None):
        """Return a session that is ready for the first frame."""
        settings = self.settings(integrator)
        session = Session(settings)
        session.update(scene.delta)
        session.configure(settings, scene.camera, *self.size)
        return session

    def picture(self, scene, frames):
        """Return the picture after so many frames."""
        session = self.session(scene)
        session.step(frames)
        return session.read()[..., :3]

    def truth(self, scene):
        """Return Reference's picture."""
        session = self.session(scene, "reference")
        session = self.session(scene, "reference")
        session.step(self.truth_samples)
        return session.read()[..., :3]

    def positions(self, scene):
        """Return world positions [h, w, 3] of the surfaces in the pixels' centres; 0 without a surface."""
        settings = dataclasses.replace(
            self.settings("reference"), film=FilmSettings(pixel_filter=PixelFilter.BOX, filter_width=0.01))
        session = Session(settings)
        session.update(scene.delta)
        session.configure(settings, scene.camera, *self.size, passes=("Combined", "Position"))
        session.step(1)
        return session.read("Position")


def luminance(picture):
    """Return luminances [h, w] in float64."""
    return picture.astype(np.float64) @ LUMINANCE_WEIGHTS.astype(np.float64)


def furnace(setup, albedo, frames, tolerance):
    """Find e / (1 - albedo) everywhere in a closed emitting box."""
    picture = setup.picture(light_scenes.furnace(albedo, setup.size), frames)
    ratio = luminance(picture) * (1.0 - albedo)
    coarse = box_filter(ratio[..., None], 8)
    what = f"furnace {albedo}, {frames} frames"
    # Where walls that emit meet, light sampling alone is noisy without bound and its share of a hit's light differs
    # from that of the cell around it: blocks in corners may stray by 7 %.
    return [Figure(f"{what}: mean radiance of e/(1-albedo)", ratio.mean(), 1 - tolerance, 1 + tolerance),
            Figure(f"{what}: darkest 8x8 block", coarse.min(), 0.93, np.inf),
            Figure(f"{what}: brightest 8x8 block", coarse.max(), 0.0, 1.07)], {
                what: 0.4 * (1.0 - albedo) * picture}


def white_sky(setup, albedo, frames, shape):
    """Find the albedo on convex things under a sky of radiance 1."""
    scene = light_scenes.white_sky(albedo, setup.size, shape)
    picture = setup.picture(scene, frames)
    inside = eroded(setup.positions(scene).any(-1), 2)
    ratio = luminance(picture)[inside] / albedo
    what = f"white sky, {shape} of albedo {albedo}, {frames} frames"
    return [Figure(f"{what}: mean radiance of the albedo", ratio.mean(), 0.99, 1.01),
            Figure(f"{what}: 1st percentile", np.percentile(ratio, 1), 0.95, np.inf),
            Figure(f"{what}: 99th percentile", np.percentile(ratio, 99), 0.0, 1.05)], {what: picture}


def eroded(mask, pixels):
    """Return a mask without what is within so many pixels (or the border) of its outside."""
    for _ in range(pixels):
        padded = np.pad(mask, 1)
        mask = mask & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask


def thin_wall(setup, frames):
    """Find next to no light on the dark side of a wall 2 cm thick."""
    scene = light_scenes.divided_room(setup.size)
    picture, x = setup.picture(scene, frames), setup.positions(scene)[..., 0]
    y = luminance(picture)
    # The pixels that show the wall's top, or share themselves with it, belong to neither side.
    pixel = np.abs(np.diff(x[0])).max()
    lit, dark = y[x < -0.01 - pixel], y[x > 0.01 + pixel]
    near = y[(x > 0.01 + pixel) & (x < 0.01 + 9 * pixel)]
    what = f"wall of 2 cm, {frames} frames"
    return [Figure(f"{what}: mean of the dark side by the lit side's", dark.mean() / lit.mean(), 0.0, 0.005),
            Figure(f"{what}: within 8 px of the wall", near.mean() / lit.mean(), 0.0, 0.005),
            Figure(f"{what}: brightest dark pixel", dark.max() / lit.mean(), 0.0, 0.05)], {what: picture}


def room_corner(setup, frames):
    """Find the light within 8 pixels of a room's edges as Reference does."""
    scene = light_scenes.closed_room(0.7, setup.size)
    picture, truth, p = setup.picture(scene, frames), setup.truth(scene), setup.positions(scene)
    wall = np.stack([np.abs(p[..., 0] - 2), np.abs(p[..., 1] - 2), np.abs(p[..., 2])], -1).argmin(-1)
    ring = rings(wall != 0, 8) | rings(wall == 0, 8) | rings(wall == 1, 8) | rings(wall != 1, 8)
    what = f"room corner, {frames} frames"
    return ring_figures(what, picture, truth, ring), {what: picture, f"{what}: Reference": truth}


def contact(setup, frames):
    """Find the light on the floor within 8 pixels of a cube as Reference does."""
    scene = light_scenes.contact(setup.size)
    picture, truth, p = setup.picture(scene, frames), setup.truth(scene), setup.positions(scene)
    floor = p[..., 2] < 1e-3
    what = f"contact, {frames} frames"
    figures = ring_figures(what, picture, truth, rings(~floor, 8) & floor)
    y, t, seen = luminance(picture), luminance(truth), ~floor
    for distance in range(1, 9):
        grown = rings(seen, 1) | seen
        ring, seen = grown & ~seen & floor, grown
        figures.append(Figure(f"{what}: {distance} px away", y[ring].sum() / t[ring].sum(), 0.9, 1.1))
    return figures, {what: picture, f"{what}: Reference": truth}


def rings(mask, pixels):
    """Return which pixels outside of a mask are within so many pixels of it (in steps to the four neighbours)."""
    grown = mask
    for _ in range(pixels):
        padded = np.pad(grown, 1)
        grown = grown | padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]
    return grown & ~mask


def ring_figures(what, picture, truth, mask):
    """Return luminance ratios over a mask and over its part in each 8x8 block."""
    y, t = luminance(picture) * mask, luminance(truth) * mask
    block_y, block_t = box_filter(y[..., None], 8), box_filter(t[..., None], 8)
    full = box_filter(mask[..., None].astype(float), 8) > 0.25
    low, high = np.percentile(block_y[full] / block_t[full], (5, 95))
    return [Figure(f"{what}: ratio within 8 px", y.sum() / t.sum(), 0.9, 1.1),
            Figure(f"{what}: 5th percentile of 8x8 blocks there", low, 0.9, np.inf),
            Figure(f"{what}: 95th percentile", high, 0.0, 1.1)]


def light_switch(setup, frames=64, after=12, kept=0):
    """Switch the lamp of a room of albedo 0.7 off and on: 12 frames later the light is gone, and back.

    `kept` is 1 to leave a lamp of a thousandth of its power on, 0 to leave none.
    """
    scene = light_scenes.closed_room(0.7, setup.size)
    session = setup.session(scene)
    session.step(frames)
    before = session.read()[..., :3]
    curves, pictures = {}, {"switch: on": before}
    for name, lamps in (("off", scene.lamps[len(scene.lamps) - kept:]), ("on", scene.lamps)):
        session.update(SceneDelta(lights=list(lamps)))
        curve = []
        for _ in range(after):
            session.step(1)
            curve.append(luminance(session.read()[..., :3]).mean() / luminance(before).mean())
        curves[name] = curve
        pictures[f"switch: {after} frames after {name}"] = session.read()[..., :3]
        if name == "off":
            session.step(frames - after)
    print("    off:", " ".join(f"{v:.4f}" for v in curves["off"]))
    print("    on: ", " ".join(f"{v:.4f}" for v in curves["on"]))
    what = f"switch, {kept} dim lamps kept: light {after} frames after it"
    return [Figure(f"{what} went off", curves["off"][-1], 0.0, 0.02),
            Figure(f"{what} came on", curves["on"][-1], 0.98, 1.02)], pictures


def mover(setup, frames=48, after=8):
    """Let a ball pass: eight frames later all is as if it had never been there."""
    passing = light_scenes.Passing(setup.size)
    session = setup.session(passing.scene)
    session.step(frames)
    for frame in range(1, passing.FRAMES + after):
        session.update(passing.change(frame))
        session.step(1)
        if frame == passing.FRAMES // 2:
            during = session.read()[..., :3]
    gone = session.read()[..., :3]
    # The steady state, from a session that has never seen the ball near.
    fresh = setup.session(passing.scene)
    fresh.update(passing.change(passing.FRAMES))
    fresh.step(max(frames, 128))
    steady = fresh.read()[..., :3]
    block = box_filter(luminance(gone)[..., None], 16) / box_filter(luminance(steady)[..., None], 16)
    return [Figure(f"{after} frames after a ball: darkest 16x16 block of the steady state", block.min(), 0.95, np.inf),
            Figure("    brightest 16x16 block", block.max(), 0.0, 1.05),
            Figure("    mean", block.mean(), 0.95, 1.05)], {
                "ball passing": during, f"{after} frames after": gone, "steady state": steady}
