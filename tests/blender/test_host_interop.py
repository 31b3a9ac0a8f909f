# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures shared between CUDA and Blender's OpenGL, on machines that have both on one device."""

from __future__ import annotations

import pytest

SCRIPT = """
import time, bpy, gpu, numpy as np
gpu.init()
from burnish.addon import gl_interop
from burnish.engine.device import start_warp
start_warp()
import warp as wp
from burnish.engine.display import PictureReader
assert gl_interop.probe("cuda:0"), gpu.platform.renderer_get()
reader, textures = PictureReader("cuda:0"), gl_interop.SharedTextures()
for width, height in ((64, 36), (1920, 1080), (64, 36), (17, 9), (1920, 1080)):
    values = np.random.default_rng(width).uniform(0.0, 1.0, (height * width, 4)).astype(np.float32)
    picture = wp.array(values, dtype=wp.vec4, device="cuda:0")
    texture = textures.upload(reader.on_device(picture, width, height))
    pixels = np.array(texture.read().to_list(), np.float32).reshape(-1, 4)
    np.testing.assert_allclose(pixels, values, atol=1e-3)
times = []
for _ in range(50):
    shared = reader.on_device(picture, width, height)
    start = time.perf_counter()
    textures.upload(shared)
    times.append(time.perf_counter() - start)
print(f"upload of 1920 x 1080: {1e3 * sorted(times)[25]:.3f} ms")
start = time.perf_counter()
for _ in range(50):
    reader.packed(picture, width, height)
print(f"packing and reading back: {1e3 * (time.perf_counter() - start) / 50:.3f} ms")
textures.free()
print("done")
"""


@pytest.mark.gpu
def test_cuda_writes_blenders_textures(fresh_python):
    """Write pictures of several sizes into Blender's textures and read the same pixels back through OpenGL."""
    result = fresh_python(SCRIPT)
    print(result.stdout)
    assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr


def test_no_sharing_without_cuda(fresh_python):
    """Fall back quietly on a processor."""
    result = fresh_python("import bpy\nfrom burnish.addon import gl_interop\nassert not gl_interop.probe('cpu')\n"
                          "print('done')")
    assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr


def test_gl_name_of_a_texture(fresh_python):
    """Find OpenGL's name of a Blender texture, different for two, wherever there is a GL context."""
    result = fresh_python("""
import bpy, gpu
try:
    gpu.init()
except Exception:
    print("skip"); raise SystemExit
from burnish.addon.gl_interop import gl_texture_name
textures = [gpu.types.GPUTexture((8, 8), format='RGBA16F') for _ in range(2)]
names = [gl_texture_name(texture) for texture in textures]
assert all(name > 0 for name in names) and names[0] != names[1], names
print("done")
""")
    if result.stdout.strip() == "skip":
        pytest.skip("no GPU context in background")
    assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr
