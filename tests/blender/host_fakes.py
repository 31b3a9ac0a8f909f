# SPDX-License-Identifier: GPL-3.0-or-later
"""A NumPy session and an empty extractor, for tests of the host side in a process with bpy.

The session draws a horizontal ramp in units of full-frame pixels, so that a crop shows where it was taken.
"""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
from burnish.engine.pass_names import first_hit_channels
from burnish.engine.report import Report, ReportKind
from burnish.engine.scene import SceneDelta
from burnish.engine.setting_changes import Change
from burnish.engine.settings import Integrator

CHANNELS = {"Combined": 4, "Depth": 1, "Normal": 3, "Position": 3, "UV": 3, "Emission": 3, "Environment": 3,
            "Object Index": 1, "Material Index": 1} | {
    f"{lobe} {part}": 3 for lobe in ("Diffuse", "Glossy", "Transmission") for part in ("Direct", "Indirect", "Color")}


class FakeSession:
    """Follows Session's contract; class attributes choose how it fails and how slow it is."""

    step_seconds = 0.0
    fail_in = ""
    opened: list[FakeSession] = []
    device, device_name = "cpu", "fake"
    timed = False
    skipped: dict = {}
    traced_samples = 0
    first_hits = SimpleNamespace(manifests={})

    @property
    def frame_times(self):
        real_time = self.settings.sampling.integrator == Integrator.REALTIME
        return {"Surfaces": 1.0, "Composite": 0.5} if real_time and self.was_timed else {}

    def __init__(self, settings):
        self.fail("open")
        self.settings = settings
        self.report = Report()
        self.report.add(ReportKind.SKIPPED, "object 'Smoke'", "volumes are not drawn")
        self.stats = SimpleNamespace(triangles=12, instances=1, lights=1, texture_bytes=0, device_bytes=1 << 20,
                                     structure="flattened", times={"structure": 0.01})
        self.samples_done = 0
        self.closed = False
        self.configured = []
        self.updates = []
        self._config = None
        self.was_timed, self.resets, self.steps = False, 0, []
        self.moves = []
        self.pipeline = SimpleNamespace(records=0)
        FakeSession.opened.append(self)

    def fail(self, where):
        if FakeSession.fail_in == where:
            raise ValueError(f"made to fail in {where}")

    def update(self, delta, progress=None):
        self.fail("update")
        self.updates.append(delta)
        if progress:
            progress("Building the structure", 0.5)

    def configure(self, settings, camera, width, height, crop=None, passes=("Combined",)):
        self.fail("configure")
        config = (settings, camera, width, height, crop, passes)
        if config == self._config:
            return Change.NONE
        self.settings, self._config, self.samples_done = settings, config, 0
        self.configured.append(config)
        return Change.RESTART

    def move(self, delta, camera):
        self.fail("move")
        self.moves.append((self.samples_done, camera))

    def step(self, samples=1, should_stop=None):
        self.fail("step")
        self.was_timed |= self.timed
        self.steps.append((samples, self.timed))
        for _ in range(samples):
            end = time.perf_counter() + FakeSession.step_seconds
            while time.perf_counter() < end:
                if should_stop is not None and should_stop():
                    return self.samples_done
                time.sleep(0.005)
            self.samples_done += 1
        return self.samples_done

    def reset(self):
        self.samples_done = 0
        self.resets += 1

    def read(self, name="Combined"):
        self.fail("read")
        _, _, width, height, crop, passes = self._config
        assert name in passes, (name, passes)
        x, y, w, h = crop or (0, 0, width, height)
        channels = first_hit_channels(name) or CHANNELS.get(name, 3)
        pixels = np.zeros((h, w, channels), np.float32)
        pixels[..., 0] = np.arange(x, x + w, dtype=np.float32)
        if channels > 1:
            pixels[..., 1] = np.arange(y, y + h, dtype=np.float32)[:, None]
        if channels == 4:
            pixels[..., 3] = 1.0
        return pixels

    def close(self):
        self.closed = True


class FakeExtractor:
    """Reads nothing: a full, empty delta first, then empty ones."""

    fail_in_extract = False
    has_catchers = False

    def __init__(self):
        self.first = True

    def materials(self):
        return []

    def linked_materials(self):
        return []

    world = None

    def refresh(self):
        self.first = True

    def extract(self, depsgraph, *, viewport, report, progress=None, cancelled=None, space=None, performance=None):
        if FakeExtractor.fail_in_extract:
            raise KeyError("made to fail in extract")
        report.add(ReportKind.APPROXIMATED, "material 'Floor'", "Noise Texture replaced by its mean")
        delta, self.first = SceneDelta(full=self.first), False
        return delta


def no_build(device, progress, should_stop=lambda: False, integrator=None):
    """Stand in for building kernels."""
    progress("Building kernels 1/1", 1.0)


def register_with_fakes():
    """Register the add-on with its session, extractor and kernel builds replaced; return the final module."""
    import bpy
    import burnish
    from burnish.addon import final, viewport

    burnish.register()
    for module in (final, viewport):
        module.open_session, module.SceneExtractor, module.build_kernels = FakeSession, FakeExtractor, no_build
    scene = bpy.context.scene
    scene.render.engine = 'BURNISH'
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 32, 18, 100
    scene.burnish.sampling.samples = 4
    scene.burnish.sampling.integrator = 'REFERENCE'
    return final
