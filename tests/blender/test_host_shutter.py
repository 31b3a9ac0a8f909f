# SPDX-License-Identifier: GPL-3.0-or-later
"""The shutter of final renders with a fake session: moments, views, failures, cancellation."""

from __future__ import annotations

from pathlib import Path

import pytest

HOST = f"""
import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})
import bpy, numpy as np
from host_fakes import FakeExtractor, FakeSession, register_with_fakes
final = register_with_fakes()
scene = bpy.context.scene
render, camera = scene.render, scene.camera
render.use_motion_blur = True
for frame, x in ((1, 0.0), (21, 2.0)):
    camera.location.x = x
    camera.keyframe_insert("location", frame=frame)
scene.burnish.sampling.samples, scene.burnish.sampling.motion_steps = 40, 16
scene.frame_set(10, subframe=0.25)
pictures = []
final.on_finished.append(lambda *arguments: pictures.append(arguments))
"""
EPILOGUE = "\nimport burnish; burnish.unregister(); print('done')"


@pytest.fixture
def run_host(run_python):
    """Return a function that runs a script with the add-on registered over fakes, and checks that it ends well."""

    def run(script: str):
        result = run_python(HOST + script + EPILOGUE)
        assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr

    return run


def test_frame_is_restored_after_failures(run_host):
    """Leave the scene at its frame when rendering fails, wherever it does, and close the session."""
    run_host("""
for failure in ("move", "step", "read", ""):
    FakeSession.fail_in = failure
    try:
        bpy.ops.render.render()
        assert not failure, failure
    except RuntimeError as error:
        assert f"made to fail in {failure}" in str(error), error
    assert scene.frame_current_final == 10.25, (failure, scene.frame_current_final)
    assert all(session.closed for session in FakeSession.opened), failure
session = FakeSession.opened[-1]
assert len(pictures) == 1 and pictures[0][3].samples == 40
# 16 moments and back to the frame.
assert len(session.moves) == 17 and session.resets == 1, session.moves
assert sorted(done for done, _ in session.moves)[-1] == 40
""")


def test_stereo_views_share_their_moments(run_host):
    """Move both eyes through the same moments, each from its own place."""
    run_host("""
render.use_multiview = True
bpy.ops.render.render()
session, = FakeSession.opened
assert [picture[1] for picture in pictures] == ["left", "right"] and len(session.moves) == 34
places = np.array([np.array(camera.transform).reshape(4, 4)[:3, 3] for _, camera in session.moves]).reshape(2, 17, 3)
apart = np.linalg.norm(places[1] - places[0], axis=1)
np.testing.assert_allclose(apart, camera.data.stereo.interocular_distance, rtol=1e-3)
assert len(np.unique(places[0], axis=0)) == 17
""")


def test_cancel_keeps_what_is_done(run_host):
    """End within 0.2 s of a cancellation, with the picture so far, at the scene's frame."""
    run_host("""
import time
from types import SimpleNamespace
FakeSession.step_seconds = 0.02

class FakeEngine:
    is_preview, camera_override, resolution_x, resolution_y = False, None, 32, 18
    failures, ended, frames = [], [], []
    def __init__(self):
        self.deadline = time.perf_counter() + 0.5
    def frame_set(self, frame, subframe):
        self.frames.append(frame + subframe)
    def test_break(self):
        return time.perf_counter() > self.deadline
    def begin_result(self, x, y, w, h, layer="", view=""):
        return SimpleNamespace(layers=[SimpleNamespace(passes=[])])
    def end_result(self, result, cancel=False):
        self.ended.append(cancel)
    def report(self, kind, text):
        self.failures.append(text)
    error_set = active_view_set = lambda self, text: None
    update_stats = lambda self, stats, text: None
    update_progress = lambda self, value: None
    update_memory_stats = lambda self, memory_used, memory_peak: None

engine = FakeEngine()
scene.burnish.sampling.samples = 1000
final.render(engine, bpy.context.evaluated_depsgraph_get())
assert time.perf_counter() - engine.deadline < 0.2, time.perf_counter() - engine.deadline
assert engine.ended == [False] and not engine.failures, (engine.ended, engine.failures)
assert engine.frames[-1] == 10.25 and all(10.0 <= frame <= 10.5 for frame in engine.frames), engine.frames
assert pictures[0][3].cancelled and 0 < pictures[0][3].samples < 1000
""")
