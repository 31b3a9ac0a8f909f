# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of the G-buffer alone, for tests: a device scene, its views and the pass, replayed frame by frame."""

from __future__ import annotations

import numpy as np
import warp as wp
from burnish.engine.device_scene import DeviceScene
from burnish.engine.frame_data import frame_row
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.motion import MotionTracker
from burnish.engine.passes.gbuffer import GBufferPass, shines_plainly
from burnish.engine.settings import PerformanceSettings
from burnish.engine.view_data import ViewTracker
from burnish.kernels.gbuffer import GBuffer, SurfaceMaterial, load_material, load_surface
from burnish.kernels.packing import unpack_normal
from burnish.kernels.reprojection import MOVED
from burnish.kernels.view import View

from tests import scenes

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def unpack_gbuffer(
    # In:
    views: wp.array[View], gbuffer: GBuffer, width: int,
    # Out:
    position_out: wp.array[wp.vec3], normal_out: wp.array[wp.vec3], geometric_out: wp.array[wp.vec3],
    material_out: wp.array[SurfaceMaterial],
):
    """Unpack a pixel."""
    pixel = wp.tid()
    position_out[pixel] = load_surface(views[0], gbuffer, width, pixel).position
    normal_out[pixel] = unpack_normal(gbuffer.normal[pixel])
    geometric_out[pixel] = unpack_normal(gbuffer.geometric_normal[pixel])
    material_out[pixel] = load_material(gbuffer, pixel)


class GBufferFrames:
    """Renders G-buffers of one scene."""

    def __init__(self, delta: object, size: tuple[int, int] = (16, 16), *, rasterizing: bool | None = None):
        self.device = str(scenes.SETTINGS.device)
        self.scene = DeviceScene(self.device)
        self.scene.apply(delta, PerformanceSettings())
        self.views = ViewTracker(self.device)
        self.motion = MotionTracker(self.device)
        self.width, self.height = size
        self.gbuffer_pass = GBufferPass(self.device, rasterizing=rasterizing)
        self.gbuffer_pass.resize(*size)
        self.full: tuple[int, int] | None = None
        """Of the frame that this is a part of, from pixel `corner` on"""
        self.corner = (0, 0)
        self.moved = False
        self.graphs: dict | None = None
        """Recorded frames by parity, scene and motion; None: record every frame anew"""

    def update(self, delta: object) -> None:
        """Change the scene before the next frame."""
        self.scene.apply(delta, PerformanceSettings())
        self.moved = True

    def frame(self, camera: object = None, jitter: np.ndarray | None = None, **view: object) -> GBuffer:
        """Render the next frame and return its G-buffer."""
        row = frame_row(camera or scenes.camera_above(), *(self.full or (self.width, self.height)),
                        (*self.corner, self.width, self.height), 0, self.scene.origin)
        self.views.advance(row, moved=self.moved, lit=False, filter_quantiles=jitter,
                           **({"exposure": 1.0, "transparent": False} | view))
        self.moved = False
        motion = self.motion.advance(self.scene)
        parity, scene = self.views.parity, self.scene.scene
        key = (parity, id(motion), bytes(scene.__ctype__()))
        graph = (self.graphs or {}).get(key)
        if graph is None:
            graph = FrameGraph(self.device)
            self.gbuffer_pass.record(
                graph, parity, scene, self.scene.structures, self.views.array,
                filtered=self.scene.structures.has_filtered,
                lean_layers=self.scene.material_table.lean.transparency,
                shining=shines_plainly(scene, self.scene.emitters))
            self.gbuffer_pass.record_reprojection(graph, parity, scene, self.views.array, motion)
            if self.graphs is not None:
                self.graphs[key] = graph
        graph.replay()
        return self.gbuffer_pass.current(parity)

    def unpack(self, gbuffer: GBuffer) -> dict[str, np.ndarray]:
        """Return what a G-buffer holds as pictures [h, w, ...]."""
        shape = (self.height, self.width)
        count = self.height * self.width
        names = {"position": wp.vec3, "normal": wp.vec3, "geometric_normal": wp.vec3, "material": SurfaceMaterial}
        outputs = [wp.zeros(count, dtype=dtype, device=self.device) for dtype in names.values()]
        wp.launch(unpack_gbuffer, count, [self.views.array, gbuffer, self.width], outputs, device=self.device)
        fields = {name: array.numpy() for name, array in zip(names, outputs, strict=True)}
        material = fields.pop("material")
        fields |= {name: material[name] for name in material.dtype.names}
        for name in ("hit", "depth", "emission"):
            fields[name] = getattr(gbuffer, name).numpy()
        taps = self.gbuffer_pass.reprojection.taps.numpy()
        fields["taps"], fields["moved"] = taps & 15, taps & int(MOVED)
        fields["before"] = self.gbuffer_pass.reprojection.position.numpy()
        pixels = np.arange(count)
        fields["motion"] = np.stack([pixels % self.width, pixels // self.width], 1) + 0.5 - fields["before"]
        # On the processor these are views of buffers that later frames write.
        return {name: values.copy().reshape(*shape, *values.shape[1:]) for name, values in fields.items()}

    def shot(self, camera: object = None, **arguments: object) -> dict[str, np.ndarray]:
        """Render the next frame and unpack it."""
        return self.unpack(self.frame(camera, **arguments))
