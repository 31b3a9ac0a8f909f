# SPDX-License-Identifier: GPL-3.0-or-later
"""A bench for the screen probes: scenes of glowing objects whose radiance every ray knows at once, without a cache."""

from __future__ import annotations

import numpy as np
import warp as wp
from burnish.engine.device_scene import DeviceScene
from burnish.engine.frame_data import frame_row
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.passes.screen_probes import ScreenProbePass
from burnish.engine.settings import PerformanceSettings, ProbeSettings
from burnish.engine.view_data import ViewTracker
from burnish.kernels.gbuffer import GBuffer
from burnish.kernels.geometry_math import to_frame
from burnish.kernels.intersect import MISS, closest_hit, surface_point
from burnish.kernels.packing import pack_color, pack_normal, pack_unorm16, rgba, to_half
from burnish.kernels.probe_rays import MISS_DISTANCE, ProbeRays
from burnish.kernels.reprojection import Reprojection
from burnish.kernels.types import Scene
from burnish.kernels.view import SKY_DEPTH, View, film_position, unproject

from tests import scenes

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

BUFFERS = {"hit": wp.vec2i, "barycentrics": wp.uint32, "depth": wp.float32, "geometric_normal": wp.uint32,
           "normal": wp.uint32, "diffuse": wp.uint32, "specular": wp.uint32, "f0": wp.uint32, "material": wp.uint32,
           "translucent": wp.uint32, "emission": wp.vec4h}


@wp.struct
class Lighting:
    """What rays see."""

    objects: wp.array[float]
    """Radiance per instance"""
    sky: float
    sun_direction: wp.vec3
    sun_cosine: float
    """Of the sun's half angle"""
    sun: float
    """Radiance added to the sky's inside the sun"""
    broken: int
    """1: every seventh ray brings NaN"""


@wp.kernel
def fill_gbuffer(
    # In:
    views: wp.array[View], scene: Scene, width: int, tilt: wp.vec3, specular: float, roughness: float,
    # Out:
    gbuffer_out: GBuffer,
):
    """Trace the primary rays; the shading normal is the geometric one turned by `tilt` (in its frame)."""
    pixel = wp.tid()
    view = views[0]
    film = film_position(view, pixel % width, pixel // width)
    near = unproject(view.camera, film, 0.0)
    far = unproject(view.camera, film, 1.0)
    direction = wp.normalize(far - near)
    hit = closest_hit(scene.geometry, near, direction, 1.0e8)
    gbuffer_out.hit[pixel] = wp.vec2i(hit.instance, hit.triangle)
    gbuffer_out.depth[pixel] = SKY_DEPTH
    if hit.instance == MISS:
        return
    point = surface_point(scene, hit, direction)
    gbuffer_out.barycentrics[pixel] = pack_unorm16(hit.u, hit.v)
    gbuffer_out.depth[pixel] = hit.t * wp.dot(direction, wp.normalize(far - near)) / wp.length(far - near)
    gbuffer_out.geometric_normal[pixel] = pack_normal(point.geometric_normal)
    gbuffer_out.normal[pixel] = pack_normal(wp.normalize(to_frame(point.geometric_normal, tilt)))
    gbuffer_out.diffuse[pixel] = pack_color(wp.vec3(1.0 - specular, 1.0 - specular, 1.0 - specular))
    gbuffer_out.specular[pixel] = pack_color(wp.vec3(specular, specular, specular))
    gbuffer_out.material[pixel] = wp.uint32(roughness * 65535.0)


@wp.kernel
def answer_rays(
    # In:
    views: wp.array[View], scene: Scene, lighting: Lighting,
    # Out:
    rays_out: ProbeRays,
):
    """Give each ray the radiance of what it meets."""
    ray = wp.tid()
    rays_out.radiance[ray] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if rays_out.t_max[ray] == 0.0:
        return
    direction = rays_out.direction[ray]
    hit = closest_hit(scene.geometry, rays_out.origin[ray], direction, rays_out.t_max[ray])
    value = lighting.sky
    distance = float(MISS_DISTANCE)
    if hit.instance == MISS:
        if wp.dot(direction, lighting.sun_direction) > lighting.sun_cosine:
            value = value + lighting.sun
    else:
        value = lighting.objects[hit.instance]
        distance = wp.min(hit.t, MISS_DISTANCE)
    if lighting.broken == 1 and ray % 7 == 0:
        value = wp.nan
    value = value * views[0].exposure
    rays_out.radiance[ray] = rgba(wp.vec3(value, value, value), distance)


@wp.kernel
def fill_previous(
    # In:
    views: wp.array[View], lighting: Lighting, gbuffer: GBuffer, width: int,
    # Out:
    color_out: wp.array[wp.vec4h], reprojection_out: Reprojection,
):
    """Make the frame before of a camera at rest: each object's radiance, every pixel where it was."""
    pixel = wp.tid()
    instance = gbuffer.hit[pixel][0]
    value = lighting.sky
    if instance >= 0:
        value = lighting.objects[instance]
    value = value * views[0].exposure
    color_out[pixel] = to_half(wp.vec4(value, value, value, 1.0))
    reprojection_out.position[pixel] = wp.vec2(float(pixel % width) + 0.5, float(pixel // width) + 0.5)
    reprojection_out.taps[pixel] = wp.uint8(1)


class ProbeBench:
    """Runs the probe pass on a scene."""

    def __init__(self, meshes, radiances, camera, size, settings=None, exposure=1.0, sky=0.0, tilt=(0.0, 0.0, 1.0),
                 specular=0.0, roughness=0.2, jitter=True):
        self.device = scenes.SETTINGS.device.value if scenes.SETTINGS.device.value != "cuda" else "cuda:0"
        self.device_scene = DeviceScene(self.device)
        self.device_scene.apply(scenes.delta(
            meshes, [(name, np.eye(4), "grey") for name in meshes], {"grey": scenes.material(color=0.5)}),
            PerformanceSettings())
        self.scene = self.device_scene.scene
        self.size = size
        self.tracker = ViewTracker(self.device)
        self.exposure = exposure
        self.look = [wp.vec3(*tilt), specular, roughness]
        self.jitter = np.linspace(-0.5, 0.5, 65).astype(np.float32) if jitter else None
        self.gbuffer = GBuffer()
        for name, dtype in BUFFERS.items():
            setattr(self.gbuffer, name, wp.zeros(size[0] * size[1], dtype=dtype, device=self.device))
        self.lighting = Lighting()
        self.lighting.objects = wp.array(np.array(radiances, np.float32), dtype=float, device=self.device)
        self.lighting.sky = sky
        self.lighting.sun_cosine = 2.0
        self.probes = ScreenProbePass(self.device, settings or ProbeSettings(contact_detail=False))
        self.probes.resize(*size)
        self.camera = camera
        self.record()

    def record(self):
        """Record the frame; needed again after `lighting` was changed."""
        self.graph = FrameGraph(self.device)
        count = self.size[0] * self.size[1]
        views = self.tracker.array
        self.graph.launch(fill_gbuffer, count, [views, self.scene, self.size[0], *self.look], [self.gbuffer],
                          banded=False)
        rays, slots = self.probes.record_rays(self.graph, self.scene, views, self.gbuffer)
        self.graph.launch(answer_rays, slots, [views, self.scene, self.lighting], [rays], banded=False)
        color = wp.zeros(count, dtype=wp.vec4h, device=self.device)
        reprojection = Reprojection()
        reprojection.position = wp.zeros(count, dtype=wp.vec2, device=self.device)
        reprojection.taps = wp.zeros(count, dtype=wp.uint8, device=self.device)
        self.graph.launch(fill_previous, count, [views, self.lighting, self.gbuffer, self.size[0]],
                          [color, reprojection], banded=False)
        self.result = self.probes.record_light(self.graph, views, self.gbuffer, color, reprojection)

    def frame(self, camera=None, lit=False, moved=False):
        """Run one frame."""
        self.camera = camera or self.camera
        row = frame_row(self.camera, *self.size, (0, 0, *self.size), 0, self.device_scene.origin)
        self.tracker.advance(row, moved=moved, lit=lit, exposure=self.exposure, transparent=False,
                             filter_quantiles=self.jitter)
        self.graph.replay()

    def irradiance(self):
        """Return irradiance / pi [height, width] (red, exposure taken out) and the confidence."""
        image = self.result.numpy().reshape(self.size[1], self.size[0], 4).astype(np.float64)
        return image[..., 0] / self.exposure, image[..., 3]

    def hits(self):
        """Return the instance that each pixel shows [height, width]."""
        return self.gbuffer.hit.numpy()[:, 0].reshape(self.size[1], self.size[0])
