# SPDX-License-Identifier: GPL-3.0-or-later
"""Open Image Denoise from Blender's own library: what it does to noise, and when final renders use it."""

from __future__ import annotations

from pathlib import Path

import pytest

SCRIPT = """
import numpy as np, bpy
from burnish.addon import oidn
if oidn.library() is None:
    print("absent")
    raise SystemExit
rng = np.random.default_rng(0)
clean = np.ones((128, 128, 4), np.float32) * np.linspace(0.1, 4, 128, dtype=np.float32)[None, :, None]
noisy = clean.copy()
noisy[..., :3] *= rng.exponential(1.0, (128, 128, 1))
noisy[..., 3] = 0.25
def error(picture):
    return np.sqrt(((picture - clean)[..., :3] ** 2).mean())
before = noisy.copy()
alone = oidn.denoise(noisy)
guided = oidn.denoise(noisy, np.ones((128, 128, 3)), np.ones((128, 128, 3)))
assert (noisy == before).all() and (alone[..., 3] == 0.25).all() and alone.dtype == np.float32
assert max(error(alone), error(guided)) < 0.1 * error(noisy), (error(alone), error(guided), error(noisy))
assert abs(alone[..., :3].mean() / clean[..., :3].mean() - 1) < 0.05
# Edges that only the guide has stay sharp.
albedo = np.zeros((128, 128, 3), np.float32)
albedo[:, ::8] = 1.0
striped = np.concatenate([albedo * rng.exponential(1.0, (128, 128, 1)), np.ones((128, 128, 1))], 2).astype(np.float32)
result = oidn.denoise(striped, albedo, np.ones_like(albedo))
assert result[:, ::8, 0].mean() > 5 * result[:, 4::8, 0].mean()
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

def denoise(pixels, albedo=None, normal=None):
    calls.append((pixels.shape, None if albedo is None else albedo.shape, None if normal is None else normal.shape))
    return pixels + 1.0

final.oidn.denoise = denoise
bpy.ops.render.render()
assert not calls
scene.burnish.denoiser.final_denoise = True
bpy.ops.render.render()
assert calls == [((18, 32, 4), None, None)], calls
assert (pictures[1]["Combined"] == pictures[0]["Combined"] + 1.0).all()
scene.burnish.sampling.integrator = 'REALTIME'
bpy.ops.render.render()
assert calls[1:] == [((18, 32, 4), (18, 32, 3), (18, 32, 3))], calls
assert set(pictures[2]) == set(pictures[0]), set(pictures[2])
final.debug_view = "gbuffer.normal"
bpy.ops.render.render()
assert len(calls) == 2
import burnish; burnish.unregister(); print("done")
"""


def test_blenders_library_removes_noise(run_python) -> None:
    """Remove nine tenths of heavy noise, keep the mean, the alpha and the edges of guides."""
    result = run_python(SCRIPT)
    if result.stdout.strip().endswith("absent"):
        pytest.skip("this Blender has no Open Image Denoise")
    assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr


def test_final_renders_denoise_when_asked(run_python) -> None:
    """Denoise the combined pass alone, by default never, and never a debug view."""
    result = run_python(HOST)
    assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr
