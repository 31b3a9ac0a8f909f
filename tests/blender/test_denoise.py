# SPDX-License-Identifier: GPL-3.0-or-later
"""Open Image Denoise from Blender's own library: what it does to noise, and when final renders use it."""

from __future__ import annotations

from pathlib import Path

import pytest

SCRIPT = """
import bpy, numpy as np
import burnish
from burnish.addon import final, oidn
if oidn.library() is None:
    print("absent")
    raise SystemExit
burnish.register()
scene = bpy.context.scene
scene.render.engine = 'BURNISH'
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 48, 32, 100
scene.view_layers[0].use_pass_normal = scene.view_layers[0].use_pass_diffuse_color = True
scene.burnish.device = 'CPU'
pictures, reports = [], []
def keep(layer, view, passes, info):
    pictures.append(passes)
    reports.append(info.report.text())
final.on_finished.append(keep)
def error(picture, truth):
    return np.sqrt(((picture - truth)[..., :3] ** 2).mean())
for integrator in ('REFERENCE', 'REALTIME'):
    scene.burnish.sampling.integrator = integrator
    scene.burnish.denoiser.final_denoise = False
    scene.burnish.sampling.samples = 512
    bpy.ops.render.render()
    scene.burnish.sampling.samples = 4 if integrator == 'REFERENCE' else 20
    bpy.ops.render.render()
    scene.burnish.denoiser.final_denoise = True
    bpy.ops.render.render()
    truth, plain, denoised = (passes["Combined"] for passes in pictures[-3:])
    print(integrator, error(plain, truth), error(denoised, truth))
    assert denoised.dtype == np.float32 and np.isfinite(denoised).all() and (denoised[..., 3] == 1.0).all()
    assert error(denoised, truth) < (0.9 if integrator == 'REFERENCE' else 1.2) * error(plain, truth)
    assert set(pictures[-1]) == set(pictures[-2]), set(pictures[-1])
    if integrator == 'REFERENCE':
        assert (pictures[-1]["Normal"] == pictures[-2]["Normal"]).all()
# A library that fails leaves the picture as it is, and the report says so.
def fail(*arguments):
    raise burnish.engine.errors.BurnishError("Open Image Denoise failed: made to.")
scene.burnish.sampling.integrator, scene.burnish.sampling.samples = 'REFERENCE', 4
burnish.engine.oidn.denoise = fail
bpy.ops.render.render()
assert (pictures[-1]["Combined"] == pictures[1]["Combined"]).all()
assert "error: the picture is not denoised. Open Image Denoise failed: made to." in reports[-1], reports[-1]
burnish.unregister()
assert not burnish.engine.oidn._kept
print("done")
"""

HOST = f"""
import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})
import bpy, numpy as np
from host_fakes import register_with_fakes
final = register_with_fakes()
scene = bpy.context.scene
calls, pictures = [], []
final.on_finished.append(lambda layer, view, passes, info: pictures.append(passes))

def denoise(session):
    calls.append(session._config[-1])
    return session.read("Combined") + 1.0

final.oidn.denoise = denoise
bpy.ops.render.render()
assert not calls
scene.burnish.denoiser.final_denoise = True
bpy.ops.render.render()
assert calls == [("Combined", "Denoised")], calls
assert (pictures[1]["Combined"] == pictures[0]["Combined"] + 1.0).all()
scene.burnish.sampling.integrator = 'REALTIME'
bpy.ops.render.render()
assert calls[1:] == [("Combined", "Denoised")], calls
assert set(pictures[2]) == set(pictures[0]), set(pictures[2])
final.debug_view = "gbuffer.normal"
bpy.ops.render.render()
assert len(calls) == 2
import burnish; burnish.unregister(); print("done")
"""


@pytest.mark.slow
def test_final_renders_have_less_noise(run_python) -> None:
    """Denoise final renders of both integrators, all passes as they were; where that fails keep the picture."""
    result = run_python(SCRIPT)
    if result.stdout.strip().endswith("absent"):
        pytest.skip("this Blender has no Open Image Denoise")
    assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr


def test_final_renders_denoise_when_asked(run_python) -> None:
    """Denoise the combined pass alone, by default never, and never a debug view."""
    result = run_python(HOST)
    assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr
