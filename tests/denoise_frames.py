# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of synthetic light for the tests of the denoisers."""

import numpy as np
import pytest
import warp as wp
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.passes.diffuse_denoise import DiffuseDenoisePass
from burnish.engine.passes.direct_denoise import DirectDenoisePass
from burnish.engine.settings import DenoiserSettings
from burnish.kernels.direct_light import DirectLight
from burnish.kernels.gbuffer import GBuffer
from burnish.kernels.reprojection import Reprojection
from burnish.kernels.view import View

from tests.device import DEVICE

SIZE = 32
UP, SIDE = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
LONG_AGO = 5000


def packed_normal(n):
    """Pack like kernels/packing.py does, for axis-aligned normals looking forwards."""
    x, y = round(n[0] * 32767) + 32768, round(n[1] * 32767) + 32768
    return np.uint32(x | (y << 16))


def taps_inside(position):
    """Return which of the four pixels around positions [h, w, 2; px] are in the picture: bits, uint8 [h, w]."""
    taps = np.zeros(position.shape[:2], np.uint8)
    corner = np.floor(position - 0.5).astype(int)
    for tap in range(4):
        at = corner + (tap & 1, tap >> 1)
        taps |= np.where(((at >= 0) & (at < position.shape[1::-1])).all(-1), 1 << tap, 0).astype(np.uint8)
    return taps


class Frames:
    """A camera that looks down on a plane 5 m away, and one or both denoisers."""

    def __init__(self, make=DirectDenoisePass, depth=5.0, normal=UP, size=SIZE, **settings):
        self.size = size
        count = size * size
        self.denoiser = make(DEVICE, DenoiserSettings(**settings))
        self.denoiser.resize(size, size)
        self.direct = make is DirectDenoisePass
        self.gbuffer = GBuffer()
        depths = np.broadcast_to(np.asarray(depth, np.float32), (size, size)).reshape(-1)
        normals = np.empty((size, size), np.uint32)
        normals[:] = packed_normal(normal) if isinstance(normal, tuple) else normal
        self.gbuffer.depth = wp.array(depths.copy(), dtype=float, device=DEVICE)
        for name in ("normal", "geometric_normal"):
            setattr(self.gbuffer, name, wp.array(normals.reshape(-1), dtype=wp.uint32, device=DEVICE))
        # Half rough everywhere.
        self.gbuffer.material = wp.full(count, 32768, dtype=wp.uint32, device=DEVICE)
        for name in ("diffuse", "specular", "translucent"):
            setattr(self.gbuffer, name, wp.zeros(count, dtype=wp.uint32, device=DEVICE))
        self.paint(0.5)
        self.reprojection = Reprojection()
        self.reprojection.position = wp.zeros(count, dtype=wp.vec2, device=DEVICE)
        self.reprojection.taps = wp.zeros(count, dtype=wp.uint8, device=DEVICE)
        self.input = [wp.zeros(count, dtype=wp.vec4h, device=DEVICE) for _ in range(2)]
        self.row = np.zeros(1, View.numpy_dtype())
        for name in ("camera", "previous"):
            camera = self.row[name]
            camera["camera_to_world"] = camera["world_to_camera"] = np.eye(4)
            camera["window"] = (-0.5, 0.5, -0.5, 0.5)
            camera["width"] = camera["height"] = camera["crop_width"] = camera["crop_height"] = size
            camera["spread"] = 1.0 / size
        self.row["exposure"] = 1.0
        self.views = wp.zeros(1, dtype=View, device=DEVICE)
        self.graphs = [self.record(parity) for parity in (0, 1)]
        self.frame = 0
        self.move((0.0, 0.0))

    def paint(self, albedo):
        """Give pixels such albedos [h, w], or all the same, diffuse and specular, as kernels/packing.py packs them."""
        root = np.sqrt(np.broadcast_to(albedo, (self.size, self.size)))
        wide, narrow = (np.rint(root * scale).astype(np.uint32) for scale in (2047.0, 1023.0))
        for array in (self.gbuffer.diffuse, self.gbuffer.specular):
            array.assign((wide | wide << 11 | narrow << 22).reshape(-1))

    def record(self, parity):
        graph = FrameGraph(DEVICE)
        light = self.input[0]
        if self.direct:
            light = DirectLight()
            light.diffuse, light.specular = self.input
        self.output = self.denoiser.record(
            graph, parity, self.views, self.gbuffer, self.gbuffer, self.reprojection, light)
        return graph

    def move(self, shift, valid=None):
        """Let every pixel have been `shift` pixels to the left and below of where it is now."""
        y, x = np.mgrid[: self.size, : self.size].astype(np.float32)
        position = np.stack([x + 0.5 - shift[0], y + 0.5 - shift[1]], -1)
        taps = taps_inside(position)
        if valid is not None:
            taps *= valid
        self.reprojection.position.assign(position.reshape(-1, 2))
        self.reprojection.taps.assign(taps.reshape(-1))

    def show(self, light, specular=None, weight=1.0, rest=0, light_age=LONG_AGO, moved_age=LONG_AGO):
        """Denoise a frame; return the picture (the first of the two) as [h, w, 3]."""
        for array, values in zip(self.input, (light, light if specular is None else specular), strict=True):
            image = np.empty((self.size, self.size, 4), np.float16)
            image[..., :3] = np.broadcast_to(np.asarray(values, np.float32), (self.size, self.size))[..., None]
            image[..., 3] = weight
            array.assign(image.reshape(-1, 4))
        self.row["rest"], self.row["light_age"], self.row["frame"] = rest, light_age, LONG_AGO + self.frame
        self.row["moved_age"] = moved_age
        self.views.assign(self.row)
        self.graphs[self.frame & 1].replay()
        self.frame += 1
        return self.picture()

    def picture(self, specular=False):
        array = self.output
        if self.direct:
            array = array.specular if specular else array.diffuse
        return array.numpy().astype(np.float32).reshape(self.size, self.size, 4)[..., :3]

    def lengths(self):
        history = self.denoiser.history.current((self.frame - 1) & 1)
        if self.direct:
            values = np.abs(history.length.numpy())
        else:
            values = history.state.numpy().view(np.float16).reshape(-1, 4)[:, 0]
        return values.astype(np.float32).reshape(self.size, self.size)


BOTH = pytest.mark.parametrize("make", [DirectDenoisePass, DiffuseDenoisePass])
"""Both denoisers."""


def halves(left, right):
    """Return a picture whose left and right half differ."""
    return np.where(np.arange(SIZE) < SIZE // 2, left, right)[None, :].repeat(SIZE, 0)


def noise(rng):
    """Return log-normal samples of mean 1, sigma 1."""
    return rng.lognormal(-0.5, 1.0, (SIZE, SIZE))
