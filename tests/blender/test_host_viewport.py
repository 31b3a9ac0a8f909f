# SPDX-License-Identifier: GPL-3.0-or-later
"""The viewport's main-thread half with a fake engine and context, and its drawing on a headless GPU context."""

from __future__ import annotations

from pathlib import Path

import pytest

PREAMBLE = f"""
import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})
import time, bpy, numpy as np
from types import SimpleNamespace
from host_fakes import FakeExtractor, FakeSession, register_with_fakes
from burnish.engine.scene import CameraData
register_with_fakes()
from burnish.addon import viewport
START_GPU
viewport.camera_from_view = lambda region, view, space, depsgraph: CameraData(focus_distance=view.focus)
viewport.border_from_view = lambda region, view, space, depsgraph: space.border

class FakeEngine:
    def __init__(self):
        self.redraws, self.updates, self.texts = 0, 0, []
    def tag_redraw(self): self.redraws += 1
    def tag_update(self): self.updates += 1
    def update_stats(self, stats, text): self.texts.append((stats, text))
    def bind_display_space_shader(self, scene): pass
    def unbind_display_space_shader(self): pass

shading = SimpleNamespace(use_scene_lights_render=True, use_scene_world_render=True, render_pass='COMBINED')
def make_context(width=64, height=36):
    return SimpleNamespace(scene=bpy.context.scene, region=SimpleNamespace(width=width, height=height),
                           region_data=SimpleNamespace(focus=1.0),
                           space_data=SimpleNamespace(shading=shading, border=None))

depsgraph = bpy.context.evaluated_depsgraph_get()

def until(condition):
    end = time.perf_counter() + 5.0
    while not condition():
        assert time.perf_counter() < end, "timed out"
        time.sleep(0.002)

def drawn(engine, context, background=(0.0, 0.0, 0.0, 0.0)):
    width, height = context.region.width, context.region.height
    offscreen = gpu.types.GPUOffScreen(width, height, format='RGBA32F')
    from mathutils import Matrix
    to_clip = Matrix(((2 / width, 0, 0, -1), (0, 2 / height, 0, -1), (0, 0, 1, 0), (0, 0, 0, 1)))
    with offscreen.bind():
        frame = gpu.state.active_framebuffer_get()
        frame.clear(color=background)
        with gpu.matrix.push_pop():
            gpu.matrix.load_matrix(Matrix.Identity(4))
            gpu.matrix.load_projection_matrix(to_clip)
            viewport.view_draw(engine, context, depsgraph)
        pixels = np.array(frame.read_color(0, 0, width, height, 4, 0, 'FLOAT').to_list(), np.float32)
    return pixels.reshape(height, width, 4)
"""
EPILOGUE = "\nimport burnish; burnish.unregister(); print('done')"

NO_GPU = 3
START_GPU = f"""
import gpu
try:
    gpu.init()
except Exception:
    raise SystemExit({NO_GPU})
"""
NO_DISPLAY = """
class NoDisplay:
    can_share = free = draw = lambda self, *arguments: None
viewport.Display = NoDisplay
"""


@pytest.fixture
def run_viewport(run_python):
    """Return a function that runs a script with a fake viewport; skips where there is no OpenGL."""

    def run(script: str, *, draws: bool = False):
        result = run_python(PREAMBLE.replace("START_GPU", START_GPU if draws else NO_DISPLAY) + script + EPILOGUE)
        if result.returncode == NO_GPU:
            pytest.skip("no GPU context in background")
        assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr
        return result

    return run


def test_picture_reaches_the_screen(run_viewport):
    """Draw the session's pixels unchanged and scene-linear, over the whole region, and then rest."""
    run_viewport("""
engine, context = FakeEngine(), make_context()
context.scene.burnish.sampling.viewport_samples = 4
viewport.view_update(engine, context, depsgraph)
viewport.view_draw(engine, context, depsgraph)
assert bpy.app.timers.is_registered(viewport._tick)
until(lambda: not engine.viewport._worker.status.busy)
assert viewport._tick() is None and engine.redraws == 1
pixels = drawn(engine, context)
ramp = np.arange(64.0)
assert np.abs(pixels[..., 0] - ramp).max() <= 0.25, np.abs(pixels[..., 0] - ramp).max()
assert np.abs(pixels[..., 1] - np.arange(36.0)[:, None]).max() <= 0.25
assert (pixels[..., 3] == 1.0).all()
assert engine.texts[-1] == ("flattened", "Sample 4/4"), engine.texts[-1]
redraws = engine.redraws
assert viewport._tick() is None and engine.redraws == redraws
""", draws=True)


def test_transparent_film_shows_what_is_behind(run_viewport):
    """Blend premultiplied pictures with alpha over the background."""
    run_viewport("""
class HalfSession(FakeSession):
    def read(self, name="Combined"):
        pixels = np.zeros((36, 64, 4), np.float32)
        pixels[:, 32:] = 0.5
        return pixels
viewport.open_session = HalfSession
engine, context = FakeEngine(), make_context()
context.scene.render.film_transparent = True
context.scene.burnish.sampling.viewport_samples = 1
context.scene.burnish.performance.viewport_pixel_size = 1
viewport.view_update(engine, context, depsgraph)
viewport.view_draw(engine, context, depsgraph)
until(lambda: not engine.viewport._worker.status.busy)
pixels = drawn(engine, context, background=(0.0, 1.0, 0.0, 1.0))
assert np.allclose(pixels[:, :31], (0.0, 1.0, 0.0, 1.0), atol=1e-3), pixels[0, 0]
assert np.allclose(pixels[:, 33:], (0.5, 1.0, 0.5, 1.0), atol=1e-3), pixels[0, 63]
""", draws=True)


def test_border_is_drawn_alone(run_viewport):
    """Leave everything outside the render region as it was."""
    run_viewport("""
engine, context = FakeEngine(), make_context()
context.space_data.border = (16, 9, 32, 18)
viewport.view_update(engine, context, depsgraph)
viewport.view_draw(engine, context, depsgraph)
context.scene.burnish.sampling.viewport_samples = 2
viewport.view_draw(engine, context, depsgraph)
until(lambda: not engine.viewport._worker.status.busy)
pixels = drawn(engine, context)
assert np.abs(pixels[9:27, 16:48, 0] - np.arange(16.0, 48.0)).max() <= 0.25
pixels[9:27, 16:48] = 0.0
assert not pixels.any()
""", draws=True)


def test_half_float_path_without_the_shader(run_viewport):
    """Draw the same picture where the shader for packed colours can't be built."""
    run_viewport("""
from burnish.addon import display
def refuse():
    raise RuntimeError("no shader")
display._build_shader = refuse
engine, context = FakeEngine(), make_context()
context.scene.burnish.sampling.viewport_samples = 2
viewport.view_update(engine, context, depsgraph)
viewport.view_draw(engine, context, depsgraph)
until(lambda: not engine.viewport._worker.status.busy)
pixels = drawn(engine, context)
assert np.abs(pixels[..., 0] - np.arange(64.0)).max() <= 0.25
""", draws=True)


def test_view_draw_never_blocks(run_viewport):
    """Return from every draw within 30 ms while a sample takes seconds."""
    run_viewport("""
engine, context = FakeEngine(), make_context(640, 360)
viewport.view_update(engine, context, depsgraph)
viewport.view_draw(engine, context, depsgraph)
until(lambda: engine.viewport._worker.picture is not None)
drawn(engine, context)
FakeSession.step_seconds = 5.0
times = []
for i in range(20):
    context.region_data.focus = 2.0 + i
    viewport.view_draw(engine, context, depsgraph)
    times.append(engine.viewport.draw_seconds)
assert sorted(times)[-2] < 0.03, times
""", draws=True)


def test_failures_show_a_sentence_and_the_next_update_recovers(run_viewport):
    """Show a worker's and an extraction's failure in the viewport, and start anew at the next update."""
    run_viewport("""
from burnish.addon import report
engine, context = FakeEngine(), make_context()
FakeSession.fail_in = "step"
viewport.view_update(engine, context, depsgraph)
viewport.view_draw(engine, context, depsgraph)
until(lambda: engine.viewport._worker.failed)
viewport._tick()
viewport.view_draw(engine, context, depsgraph)
assert engine.texts[-1][0] == "Burnish stopped" and "made to fail in step" in engine.texts[-1][1], engine.texts[-1]
assert "made to fail in step" in report.published_text()
FakeExtractor.fail_in_extract = True
viewport.view_update(engine, context, depsgraph)
assert "made to fail in extract" in engine.texts[-1][1], engine.texts[-1]
viewport.view_draw(engine, context, depsgraph)
assert "made to fail in extract" in engine.texts[-1][1], engine.texts[-1]
FakeSession.fail_in, FakeExtractor.fail_in_extract = "", False
viewport.view_update(engine, context, depsgraph)
viewport.view_draw(engine, context, depsgraph)
until(lambda: engine.viewport._worker.picture is not None)
viewport.stop_all()
assert all(session.closed for session in FakeSession.opened)
""")


def test_realtime_report_and_figures(run_viewport):
    """Name what real-time frames approximate, once, with the milliseconds of their sections; nothing path traced."""
    run_viewport("""
from burnish.addon import report
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import MaterialData
builder = ProgramBuilder()
builder.closure("GLOSSY", 1.0, color=1.0, roughness=0.8)
FakeExtractor.materials = lambda self: [MaterialData(name="Plastic", program=builder.finish())] * 2
engine, context = FakeEngine(), make_context()
sampling = context.scene.burnish.sampling
sampling.integrator, sampling.viewport_samples = 'REALTIME', 5
for _ in range(2):
    viewport.view_update(engine, context, depsgraph)
    viewport.view_draw(engine, context, depsgraph)
    until(lambda: not engine.viewport._worker.status.busy)
viewport._tick()
viewport.view_draw(engine, context, depsgraph)
assert engine.texts[-1] == ("flattened", "Frame 5/5"), engine.texts[-1]
text = report.published_text()
assert text.count("take diffuse light") == 1 and "(x2)" in text, text
assert "Real-time frame: 1.50 ms" in text and "Composite: 0.50 ms" in text, text
sampling.integrator = 'REFERENCE'
viewport.view_draw(engine, context, depsgraph)
until(lambda: not engine.viewport._worker.status.busy)
viewport._tick()
text = report.published_text()
assert "diffuse light" not in text and "Real-time frame" not in text, text
""")


def test_fog_comes_and_goes(run_viewport):
    """Say what frames approximate as soon as the world has a medium, and no more without it: nothing else changes."""
    run_viewport("""
import dataclasses
from burnish.addon import report
from burnish.engine.media import MediumData
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import SceneDelta, WorldData
clear = WorldData(name="world", program=ProgramBuilder().finish())
foggy = dataclasses.replace(clear, medium=MediumData(extinction=(1.0, 1.0, 1.0)))
real = FakeSession.update
def update(self, delta, progress=None):
    real(self, delta, progress)
    self.samples_done = 0
FakeSession.update = update
engine, context = FakeEngine(), make_context()
sampling = context.scene.burnish.sampling
sampling.integrator, sampling.viewport_samples = 'REALTIME', 5
viewport.view_update(engine, context, depsgraph)
for world in (clear, foggy, clear):
    FakeExtractor.world = world
    FakeExtractor.extract = lambda self, *args, **named: SceneDelta(world=world)
    viewport.view_update(engine, context, depsgraph)
    viewport.view_draw(engine, context, depsgraph)
    until(lambda: engine.viewport._worker.status.text == "Frame 5/5")
    viewport._tick()
    assert ("fog scatters" in report.published_text()) == (world is foggy), report.published_text()
""")


def test_freeing_the_engine_ends_its_worker(run_viewport):
    """Stop the thread and close the session when Blender drops the RenderEngine, without any call from it."""
    run_viewport("""
engine, context = FakeEngine(), make_context()
viewport.view_update(engine, context, depsgraph)
viewport.view_draw(engine, context, depsgraph)
worker = engine.viewport._worker
until(lambda: worker.picture is not None)
del engine
assert worker.join(2.0) and all(session.closed for session in FakeSession.opened)
assert not viewport.viewports
""")


def test_two_viewports_and_an_empty_update(run_viewport):
    """Keep viewports apart, and don't restart a picture for an update without changes."""
    run_viewport("""
engines, context = (FakeEngine(), FakeEngine()), make_context()
context.scene.burnish.sampling.viewport_samples = 3
for engine in engines:
    viewport.view_update(engine, context, depsgraph)
    viewport.view_draw(engine, context, depsgraph)
for engine in engines:
    until(lambda: not engine.viewport._worker.status.busy)
assert len(FakeSession.opened) == 2
serials = [engine.viewport._worker.picture.serial for engine in engines]
for engine in engines:
    viewport.view_update(engine, context, depsgraph)
    viewport.view_draw(engine, context, depsgraph)
time.sleep(0.05)
assert [engine.viewport._worker.picture.serial for engine in engines] == serials
""")


def test_another_device_starts_over(run_viewport):
    """Open a new session with the whole scene when the device changes."""
    run_viewport("""
engine, context = FakeEngine(), make_context()
context.scene.burnish.device = 'CPU'
viewport.view_update(engine, context, depsgraph)
viewport.view_draw(engine, context, depsgraph)
until(lambda: FakeSession.opened)
context.scene.burnish.device = 'AUTO'
viewport.view_draw(engine, context, depsgraph)
assert engine.updates == 1
viewport.view_update(engine, context, depsgraph)
viewport.view_draw(engine, context, depsgraph)
until(lambda: len(FakeSession.opened) == 2 and FakeSession.opened[0].closed)
assert FakeSession.opened[1].updates[0].full
""")


def test_handlers(run_viewport):
    """Stop all workers before a file load and read everything after undo."""
    run_viewport("""
from burnish.addon import handlers
engine, context = FakeEngine(), make_context()
viewport.view_update(engine, context, depsgraph)
viewport.view_draw(engine, context, depsgraph)
until(lambda: engine.viewport._worker.picture is not None)
worker = engine.viewport._worker
handlers.after_undo(None)
viewport.view_update(engine, context, depsgraph)
until(lambda: sum(delta.full for delta in FakeSession.opened[0].updates) == 2)
bpy.ops.wm.read_homefile(use_empty=True)
assert not worker.alive and not viewport.viewports and FakeSession.opened[0].closed
""")
