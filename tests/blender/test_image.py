# SPDX-License-Identifier: GPL-3.0-or-later
"""addon/extract/image.py in a real Blender: it hands over what Blender itself shows, and only when it changed."""

from __future__ import annotations

from collections.abc import Callable
from subprocess import CompletedProcess

import pytest

PREAMBLE = r'''
import os, sys, tempfile
import bpy, numpy as np, warp as wp, OpenImageIO as oiio
wp.config.log_level = wp.LOG_ERROR
from burnish.addon.extract.image import ImageCollector, sequence_frame, sequence_path
from burnish.engine.report import Report
from burnish.engine.scene import AlphaMode, ColorEncoding
from burnish.engine.settings import PerformanceSettings
from burnish.engine.texels import srgb_to_linear
from burnish.engine.textures import TextureStore

folder = tempfile.mkdtemp()
rng = np.random.default_rng(1)
collector = ImageCollector(bpy.context.evaluated_depsgraph_get())

def write(name, pixels):
    path = os.path.join(folder, name)
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, pixels.dtype.name.replace("float16", "half"))
    spec.attribute("oiio:UnassociatedAlpha", 1)
    output = oiio.ImageOutput.create(path)
    assert output.open(path, spec) and output.write_image(np.ascontiguousarray(pixels)), output.geterror()
    output.close()
    return path

def noise(dtype, channels=4, height=12, width=17):
    values = rng.random((height, width, channels))
    return np.rint(values * np.iinfo(dtype).max).astype(dtype) if dtype.startswith("u") else values.astype(dtype)

def blender_pixels(image):
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], image.channels)[::-1]

def stored(image):
    """Hand one image over and return (ImageData, texels 0..1 as stored, Report)."""
    collector.begin(bpy.context.scene, full=True)
    key = collector.key(image)
    store, report = TextureStore("cpu"), collector.report
    store.update(collector.images, PerformanceSettings(), report)
    texels = store.level(key)
    return collector.images[key], texels / (np.iinfo(texels.dtype).max if texels.dtype.kind == "u" else 1.0), report
'''

BYTES_MATCH = r'''
for name, channels in (("a.png", 4), ("b.jpg", 3), ("c.tga", 4), ("d.tif", 3), ("e.png", 1), ("f.bmp", 3)):
    for packed in (False, True):
        image = bpy.data.images.load(write(name, noise("uint8", channels)))
        if packed:
            image.pack()
            os.remove(image.filepath)
        data, texels, report = stored(image)
        assert not report.entries(), (name, packed, report.text())
        assert (data.path is None) == packed and data.encoding is ColorEncoding.SRGB and not data.missing
        difference = np.abs(texels - blender_pixels(image)).max()
        assert difference < 1.0 / 255.0, (name, packed, difference)
        if name != "b.jpg":
            assert difference < 1e-5, (name, packed, difference)
        bpy.data.images.remove(image)
print("OK")
'''

FLOATS_MATCH = r'''
for name, dtype, tolerance in (("a.exr", "float16", 0.0), ("b.hdr", "float32", 1e-3), ("c.exr", "float32", 1e-3)):
    for packed in (False, True):
        image = bpy.data.images.load(write(name, noise(dtype, 3)))
        if packed:
            image.pack()
        data, texels, report = stored(image)
        assert not report.entries() and data.encoding is ColorEncoding.LINEAR
        np.testing.assert_allclose(texels[..., :3], blender_pixels(image)[..., :3], atol=tolerance, err_msg=name)
        bpy.data.images.remove(image)
image = bpy.data.images.load(write("d.png", noise("uint16", 3)))
data, texels, report = stored(image)
assert data.encoding is ColorEncoding.SRGB
# Blender's own decoding is a fast approximation, good to 2e-5.
np.testing.assert_allclose(srgb_to_linear(texels[..., :3]), blender_pixels(image)[..., :3], atol=5e-5)
image.colorspace_settings.name = "Non-Color"
data, texels, report = stored(image)
assert data.encoding is ColorEncoding.LINEAR and data.source_colorspace == "Non-Color"
np.testing.assert_allclose(texels, blender_pixels(image), atol=1e-7)
print("OK")
'''

SPACES_MATCH = r'''
# Blender converts 16-bit files when it loads them, so its pixels tell what the colours should be.
gamma = "Gamma 2.2 Encoded AdobeRGB" if bpy.app.version >= (5, 2, 0) else "Rec.1886"
for name, dtype in (("a.png", "uint16"), ("b.exr", "float16")):
    for packed in (False, True):
        for space in ("Filmic sRGB", "ACEScg", "Linear Rec.2020", "AgX Base sRGB", gamma):
            image = bpy.data.images.load(write(name, noise(dtype, 3)))
            image.colorspace_settings.name = space
            if packed:
                image.pack()
            data, texels, report = stored(image)
            assert not report.entries(), report.text()
            assert data.encoding is ColorEncoding.LINEAR and data.pixels is not None
            expected = blender_pixels(image)[..., :3]
            np.testing.assert_allclose(texels[..., :3], expected, atol=2e-3, rtol=2e-3, err_msg=f"{name} {space}")
            bpy.data.images.remove(image)
bpy.ops.wm.set_working_color_space(convert_colors=False, working_space="ACEScg")
assert bpy.data.colorspace.working_space == "ACEScg"
image = bpy.data.images.load(write("c.png", noise("uint16", 3)))
data, texels, report = stored(image)
assert data.encoding is ColorEncoding.LINEAR and data.source_colorspace == "ACEScg"
np.testing.assert_allclose(texels[..., :3], blender_pixels(image)[..., :3], atol=2e-3, rtol=2e-3)
print("OK")
'''

BLENDER_ONLY = r'''
image = bpy.data.images.new("byte", 7, 5, alpha=True)
values = rng.random((5, 7, 4)).astype(np.float32)
image.pixels.foreach_set(values.ravel())
data, texels, report = stored(image)
np.testing.assert_allclose(texels, values[::-1], atol=0.51 / 255)
np.testing.assert_allclose(texels, blender_pixels(image), atol=1e-5)
assert data.pixels.dtype == np.uint8 and data.encoding is ColorEncoding.SRGB and data.alpha_mode is AlphaMode.STRAIGHT

image = bpy.data.images.new("float", 7, 5, alpha=True, float_buffer=True)
image.pixels.foreach_set(values.ravel() * 3)
data, texels, report = stored(image)
np.testing.assert_allclose(texels, values[::-1] * 3, rtol=1e-3)
assert data.encoding is ColorEncoding.LINEAR and data.alpha_mode is AlphaMode.PREMUL

image = bpy.data.images.new("grid", 64, 32)
image.generated_type = 'COLOR_GRID'
data, texels, report = stored(image)
assert texels.shape == (32, 64, 4) and np.ptp(texels[..., 0]) > 0.2
np.testing.assert_allclose(texels, blender_pixels(image), atol=1e-5)

# Painted over, the file is no longer what counts.
image = bpy.data.images.load(write("painted.png", noise("uint8")))
image.pixels.foreach_set(np.full(12 * 17 * 4, 0.2, np.float32))
data, texels, report = stored(image)
assert image.is_dirty and data.path is None
np.testing.assert_allclose(texels, 0.2, atol=1e-5)
print("OK")
'''

MISSING = r'''
bpy.ops.wm.save_as_mainfile(filepath=os.path.join(folder, "scene.blend"))
write("beside.png", noise("uint8"))
image = bpy.data.images.new("x", 1, 1)
image.source, image.filepath = 'FILE', "//beside.png"
data, texels, report = stored(image)
assert data.path == os.path.join(folder, "beside.png") and not data.missing and not report.entries()
for source, path in (('FILE', "//gone.png"), ('FILE', ""), ('SEQUENCE', "//gone_01.png"), ('MOVIE', "//gone.mp4"),
                     ('TILED', "//gone.<UDIM>.png")):
    image.source, image.filepath = source, path
    data, texels, report = stored(image)
    np.testing.assert_array_equal(texels, [[[1, 0, 1, 1]]])
    assert [entry.owner for entry in report.entries() if entry.kind.name == "MISSING"] == ["image 'x'"], report.text()
image = bpy.data.images.load(write("cut.png", noise("uint8", 4, 200, 200)))
image.pack(data=open(image.filepath, "rb").read()[:300], data_len=300)
data, texels, report = stored(image)
np.testing.assert_array_equal(texels, [[[1, 0, 1, 1]]])
assert "image 'cut.png'" in report.text()
print("OK")
'''

CHANGES = r'''
paths = [write(f"s_{i:03d}.png", noise("uint8")) for i in (1, 2, 3)]
still = bpy.data.images.load(write("still.png", noise("uint8")))
packed = bpy.data.images.load(write("packed.png", noise("uint8")))
packed.pack()
painted = bpy.data.images.new("painted", 4, 4)
sequence = bpy.data.images.load(paths[0])
sequence.source = 'SEQUENCE'
material = bpy.data.materials.new("m")
nodes = material.node_tree.nodes
for image in (still, packed, painted, sequence):
    node = nodes.new("ShaderNodeTexImage")
    node.image = image
user = node.image_user
user.frame_duration, user.frame_start = 3, 1
bpy.ops.mesh.primitive_cube_add()
bpy.context.object.data.materials.append(material)
updates = []

def collect(*args):
    collector.begin(bpy.context.evaluated_depsgraph_get() if not args else args[1])
    for image in (still, packed, painted):
        collector.key(image)
    updates.append((sorted(data.name for data in collector.images.values()), collector.key(sequence, user)))

collect()
assert updates[-1][0] == ["packed.png", "painted", "still.png"], updates
collect()
assert updates[-1][0] == [], updates
bpy.app.handlers.depsgraph_update_post.append(collect)
bpy.context.object.location.x = 2
bpy.context.view_layer.update()
assert updates[-1][0] == [] and len(updates) == 3, updates
painted.pixels.foreach_set(np.full(64, 0.7, np.float32))
painted.update_tag()
bpy.context.view_layer.update()
assert updates[-1][0] == ["painted"], updates
bpy.app.handlers.depsgraph_update_post.clear()
still.colorspace_settings.name = "Non-Color"
os.utime(bpy.path.abspath(still.filepath), (1, 1))
collect()
assert updates[-1][0] == ["still.png"], updates
collector.begin(bpy.context.scene)
collector.key(painted)
assert [data.name for data in collector.images.values()] == ["painted"]

keys, files = [], []
for frame in (1, 2, 3, 9):
    bpy.context.scene.frame_set(frame)
    collector.begin(bpy.context.evaluated_depsgraph_get())
    keys.append(collector.key(sequence, user))
    files.append([os.path.basename(data.path) for data in collector.images.values()])
assert len(set(keys)) == 3 and keys[2] == keys[3], keys
assert files == [["s_001.png"] if updates[0][1] != keys[0] else [], ["s_002.png"], ["s_003.png"], []], files
user.use_cyclic = True
assert [sequence_frame(frame, user) for frame in (-1, 0, 1, 3, 4, 5)] == [2, 3, 1, 3, 1, 2]
user.use_cyclic, user.frame_offset, user.frame_start = False, 10, 3
assert [sequence_frame(frame, user) for frame in (0, 3, 4, 99)] == [11, 11, 12, 13]
assert sequence_path("/a1/b2_007.v3.exr", 12) == "/a1/b2_007.v12.exr"
assert sequence_path("/a1/b2_007.exr", 1234) == "/a1/b2_1234.exr" and sequence_path("/a1/b.exr", 3) == "/a1/b.exr"
print("OK")
'''


@pytest.mark.parametrize("script", [
    pytest.param(BYTES_MATCH, id="bytes"), pytest.param(FLOATS_MATCH, id="floats"),
    pytest.param(SPACES_MATCH, id="spaces", marks=pytest.mark.slow), pytest.param(BLENDER_ONLY, id="blender_only"),
    pytest.param(MISSING, id="missing"), pytest.param(CHANGES, id="changes"),
])
def test_images_are_what_blender_shows(run_python: Callable[..., CompletedProcess], script: str) -> None:
    """Run one group of checks in a Blender of its own."""
    result = run_python(PREAMBLE + script)
    assert result.returncode == 0 and "OK" in result.stdout, result.stdout + result.stderr[-3000:]
