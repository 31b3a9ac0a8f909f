# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of the G-buffer and the direct light alone, for tests: what they give on average, as a picture."""

import dataclasses

import numpy as np
import warp as wp
from burnish.engine.device_scene import DeviceScene
from burnish.engine.environment_split import split_environment
from burnish.engine.frame_data import frame_row
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.lamps import lamp_power
from burnish.engine.motion import MotionTracker
from burnish.engine.passes.direct_light import DirectLightPass
from burnish.engine.passes.gbuffer import GBufferPass
from burnish.engine.pixel_filter import filter_table
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import WorldData
from burnish.engine.settings import DirectLightSettings, PixelFilter
from burnish.engine.view_data import ViewTracker
from burnish.kernels.direct_light import DirectLight
from burnish.kernels.direct_temporal import DirectHistory
from burnish.kernels.gbuffer import GBuffer
from burnish.kernels.packing import from_half, rgb, unpack_color

from tests import scenes
from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def add_light(
    # In:
    gbuffer: GBuffer,
    light: DirectLight,
    # Out:
    total_out: wp.array[wp.vec3d],
):
    """Add a frame's direct light with the surfaces' colours."""
    i = wp.tid()
    diffuse = unpack_color(gbuffer.diffuse[i]) + unpack_color(gbuffer.translucent[i])
    total_out[i] = total_out[i] + wp.vec3d(
        wp.cw_mul(rgb(from_half(light.diffuse[i])), diffuse)
        + wp.cw_mul(rgb(from_half(light.specular[i])), unpack_color(gbuffer.specular[i])))


def local_power(scene):
    """Return the power that the light tree was built with."""
    lamps = scene.lamps
    return float(lamp_power(lamps, scene.radius)[: int((lamps["kind"] != 1).sum())].sum() + scene.emitters.power.sum())


class Frames:
    """Renders frames of direct light of a scene."""

    def __init__(self, delta, camera=None, size=8, exposure=1.0, reflections=None, **settings):
        self.device = DEVICE
        self.scene = DeviceScene(self.device)
        self.scene.apply(delta, scenes.SETTINGS.performance)
        self.size, self.exposure = size, exposure
        self.camera = camera or scenes.camera_above()
        self.views = ViewTracker(self.device)
        self.motion = MotionTracker(self.device)
        self.gbuffer = GBufferPass(self.device)
        self.direct = DirectLightPass(self.device, DirectLightSettings(**settings), reflections)
        self.direct.half_rate_pixels = 0  # small pictures as large ones
        self.history = DirectHistory()
        self.history.length = wp.zeros(size * size, dtype=wp.float16, device=self.device)
        self.history.moments = wp.zeros(size * size, dtype=wp.uint64, device=self.device)
        for each in (self.gbuffer, self.direct):
            each.resize(size, size)
        self.split = split_environment(self.scene.scene, self.device)
        self.quantiles = filter_table(PixelFilter.BOX, 1.0)
        self.graphs = []
        self.picture = wp.zeros(size * size, dtype=wp.vec4, device=self.device)
        self.record()

    def record(self, debug=""):
        """Record both graphs."""
        self.graphs = []
        for parity in (0, 1):
            graph = FrameGraph(self.device)
            motion = self.motion.advance(self.scene)
            scene, filtered = self.scene.scene, self.scene.structures.has_filtered
            current = self.gbuffer.record(
                graph, parity, scene, self.scene.structures, self.views.array, filtered=filtered)
            self.gbuffer.record_reprojection(graph, parity, scene, self.views.array, motion)
            self.direct.record_emitters(graph, scene, local_power(self.scene))
            self.light = self.direct.record(
                graph, parity, scene, self.views.array, current, self.gbuffer.previous(parity),
                self.gbuffer.reprojection, self.split, filtered=filtered, textured=self.scene.emitters.textured,
                local_power=local_power(self.scene), lean_layers=self.scene.material_table.lean.transparency,
                history=self.history)
            if debug:
                self.direct.record_debug(graph, parity, debug, self.picture)
            self.graphs.append(graph)

    def frame(self, moving=True, turning=False):
        """Render one frame; `moving`: as if something moved, so that nothing counts as at rest.

        With `turning` it is the camera alone; it stays where it is.
        """
        camera = self.camera
        if turning:
            camera = dataclasses.replace(camera, clip_end=camera.clip_end + self.views.frame % 2)
        row = frame_row(camera, self.size, self.size, (0, 0, self.size, self.size), 0, self.scene.origin)
        self.views.advance(
            row, moved=moving and not turning, lit=False, exposure=self.exposure, transparent=False,
            filter_quantiles=self.quantiles)
        self.graphs[self.views.parity].replay()

    def add_light(self, total):
        """Add the frame's direct light with the surfaces' colours, exposed, to vec3d [pixels]."""
        wp.launch(add_light, len(total), [self.gbuffer.current(self.views.parity), self.light], [total],
                  device=self.device)

    def light_with_colors(self):
        """Return the frame's direct light with the surfaces' colours, float64 [h, w, 3]."""
        total = wp.zeros(self.size * self.size, dtype=wp.vec3d, device=self.device)
        self.add_light(total)
        return total.numpy().reshape(self.size, self.size, 3) / self.exposure

    def mean(self, frames=256, moving=True):
        """Return the average of that many frames' direct light, float64 [h, w, 3]."""
        total = wp.zeros(self.size * self.size, dtype=wp.vec3d, device=self.device)
        for _ in range(frames):
            self.frame(moving)
            self.add_light(total)
        return total.numpy().reshape(self.size, self.size, 3) / (self.exposure * frames)


def reference(delta, camera=None, size=8, samples=1024):
    """Return the path tracer's light of one bounce, float64 [h, w, 3].

    With few samples of many small pixels, which takes a launch for each sample, instead of many of few large ones.
    """
    parts = next(each for each in (8, 4, 2, 1) if size * each <= 64 and samples % each**2 == 0)
    image = scenes.render(delta, camera, (size * parts, size * parts), samples // parts**2, max_bounces=1)
    return image[..., :3].astype(np.float64).reshape(size, parts, size, parts, 3).mean((1, 3))


def sunny_world(direction=(0.3, 0.2, 0.9), cosine=0.995, sun=200.0, sky=0.0, color=(1.0, 0.8, 0.5), resolution=256):
    """Make a world of constant radiance with one bright round patch."""
    builder = ProgramBuilder()
    unit = np.asarray(direction) / np.linalg.norm(direction)
    along = builder.vector("DOT_PRODUCT", builder.input("POSITION"), builder.combine(*map(float, unit)))
    builder.emit(color, builder.math("GREATER_THAN", along, cosine), sun)
    if sky:
        builder.emit((1.0, 1.0, 1.0), 1.0, sky)
    return WorldData(name="world", program=builder.finish(), importance_resolution=resolution)



