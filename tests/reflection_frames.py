# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of synthetic reflections for the tests of their denoiser: a plane that reflects a ceiling of given light."""

import numpy as np
import warp as wp
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.passes.reflection_denoise import ReflectionDenoisePass
from burnish.engine.settings import DenoiserSettings
from burnish.kernels.gbuffer import GBuffer
from burnish.kernels.reflection_types import LOBE_TRANSMISSION, WAITS, ReflectionOptions, ReflectionSamples
from burnish.kernels.reprojection import Reprojection
from burnish.kernels.view import View

from tests.denoise_frames import taps_inside
from tests.device import DEVICE

LONG_AGO = 5000
ALPHA_MIN = 5e-4


def packed_normals(n):
    """Pack unit vectors [..., 3] as kernels/packing.py does."""
    n = n / np.abs(n).sum(-1, keepdims=True)
    x, y = n[..., 0], n[..., 1]
    below = n[..., 2] < 0.0
    fold_x, fold_y = (1 - np.abs(y)) * np.where(x < 0, -1, 1), (1 - np.abs(x)) * np.where(y < 0, -1, 1)
    x, y = np.where(below, fold_x, x), np.where(below, fold_y, y)
    a, b = (np.round(np.clip(v, -1, 1) * 32767).astype(np.int64) + 32768 for v in (x, y))
    return (a | (b << 16)).astype(np.uint32)


def draw_lobe(wo, alpha, rng):
    """Return directions about the normal +z, their density and f cos / density by the bounded visible normals.

    Args:
        wo: Views [n, 3].
        alpha: GGX alpha [n].
        rng: Random numbers.
    """
    a2 = alpha * alpha
    s = 1 + np.hypot(wo[:, 0], wo[:, 1])
    k = (1 - a2) * s * s / (s * s + a2 * wo[:, 2] ** 2)
    stretched = np.stack([alpha * wo[:, 0], alpha * wo[:, 1], wo[:, 2]], -1)
    length = np.linalg.norm(stretched, axis=1)
    stretched /= length[:, None]
    u, v = rng.random((2, len(wo)))
    b = k * stretched[:, 2]
    z = (1 - u) * (1 + b) - b
    r = np.sqrt(np.maximum(1 - z * z, 0))
    h = stretched + np.stack([r * np.cos(2 * np.pi * v), r * np.sin(2 * np.pi * v), z], -1)
    m = np.stack([alpha * h[:, 0], alpha * h[:, 1], np.maximum(h[:, 2], 1e-12)], -1)
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    wi = 2 * (wo * m).sum(1, keepdims=True) * m - wo
    d = 1 / (np.pi * a2 * ((m[:, 0] ** 2 + m[:, 1] ** 2) / a2 + m[:, 2] ** 2) ** 2)

    def smith(w):
        return 0.5 * (np.sqrt(1 + a2 * (w[:, 0] ** 2 + w[:, 1] ** 2) / np.maximum(w[:, 2] ** 2, 1e-20)) - 1)

    pdf = d / (2 * (k * wo[:, 2] + length))
    weight = d / (4 * wo[:, 2] * (1 + smith(wo) + smith(wi))) / pdf
    return wi, pdf, np.where(wi[:, 2] > 0, weight, 0.0)


class ReflectionFrames:
    """A camera that looks straight down on a glossy plane under a ceiling whose light is a function of the place."""

    def __init__(self, size=32, stride=2, window=0.5, depth=5.0, ceiling=5.0, roughness=0.2, lobe=0, seed=1,
                 orthographic=False, jitter=False, **settings):
        self.size, self.stride, self.depth, self.height = size, stride, depth, ceiling
        self.rng = np.random.default_rng(seed)
        self.window, self.orthographic = window, orthographic
        count = size * size
        options = ReflectionOptions()
        options.width = options.height = size
        options.stride, options.lobe = stride, lobe
        options.columns = options.rows = self.columns = -(-size // stride)
        options.traced = options.weak = 0.2
        options.diffuse, options.blend = 1.0, 0.1
        self.options = options
        self.roughness = np.broadcast_to(np.asarray(roughness, np.float64), (size, size)).reshape(-1).copy()
        self.gbuffer = GBuffer()
        full = np.full(count, 0xFFFFFFFF, np.uint32)
        for name in ("diffuse", "specular", "f0", "translucent", "coat", "transmitted"):
            setattr(self.gbuffer, name, wp.array(full, dtype=wp.uint32, device=DEVICE))
        flags = 1 << 29 if lobe == LOBE_TRANSMISSION else 0
        material = (self.roughness * 65535 + 0.5).astype(np.uint32) | np.uint32(127 << 16 | flags)
        self.gbuffer.material = wp.array(material, dtype=wp.uint32, device=DEVICE)
        self.gbuffer.depth = wp.array(np.full(count, depth, np.float32), dtype=float, device=DEVICE)
        self.normals = np.tile([0.0, 0.0, 1.0], (count, 1))
        for name in ("normal", "geometric_normal"):
            setattr(self.gbuffer, name, wp.array(packed_normals(self.normals), dtype=wp.uint32, device=DEVICE))
        self.reprojection = Reprojection()
        self.reprojection.position = wp.zeros(count, dtype=wp.vec2, device=DEVICE)
        self.reprojection.taps = wp.zeros(count, dtype=wp.uint8, device=DEVICE)
        blocks = self.columns**2
        self.samples = ReflectionSamples()
        self.samples.place = wp.zeros(blocks, dtype=wp.uint8, device=DEVICE)
        self.samples.radiance = wp.zeros(blocks, dtype=wp.uint64, device=DEVICE)
        self.samples.direction = wp.zeros(blocks, dtype=wp.uint32, device=DEVICE)
        self.samples.pdf = wp.zeros(blocks, dtype=float, device=DEVICE)
        self.samples.shift = wp.zeros(blocks, dtype=wp.uint32, device=DEVICE)
        self.row = np.zeros(1, View.numpy_dtype())
        for name in ("camera", "previous"):
            camera = self.row[name]
            camera["camera_to_world"] = camera["world_to_camera"] = np.eye(4)
            half = 0.5 * window * (depth if orthographic else 1.0)
            camera["window"] = (-half, half, -half, half)
            camera["width"] = camera["height"] = camera["crop_width"] = camera["crop_height"] = size
            camera["orthographic"] = int(orthographic)
            camera["pixel_size" if orthographic else "spread"] = 2 * half / size
        self.row["exposure"] = 1.0
        self.place_x = 0.0
        self.views = wp.zeros(1, dtype=View, device=DEVICE)
        self.denoiser = ReflectionDenoisePass(DEVICE, DenoiserSettings(**settings), lobe)
        self.denoiser.resize(size, size, stride)
        self.graphs, self.outputs = [], []
        for parity in (0, 1):
            graph = FrameGraph(DEVICE)
            self.outputs.append(self.denoiser.record(
                graph, parity, self.views, self.gbuffer, self.gbuffer, self.reprojection, options, self.samples,
                jitter=jitter))
            self.graphs.append(graph)
        self.frame = 0
        self.move(0.0)

    @property
    def pixel(self):
        """Width of a pixel on the plane [m]."""
        return self.window * self.depth / self.size

    def move(self, x):
        """Put the camera at a place along x, which shows the plane moved the other way."""
        shift = (self.place_x - x) / self.pixel
        for name, place in (("previous", self.place_x), ("camera", x)):
            matrix = np.eye(4)
            matrix[0, 3] = place
            self.row[name]["camera_to_world"] = matrix
            self.row[name]["world_to_camera"] = np.linalg.inv(matrix)
        self.place_x = x
        v, u = np.mgrid[: self.size, : self.size].astype(np.float32)
        position = np.stack([u + 0.5 - shift, v + 0.5], -1)
        self.reprojection.position.assign(position.reshape(-1, 2))
        self.reprojection.taps.assign(taps_inside(position).reshape(-1))

    def trace(self, pixels, light):
        """Return direction, density, f cos / density * light and distance of one sample at each of some pixels.

        The lobe is drawn about +z and so is the normal; `light` takes x, y and returns the ceiling's radiance there.
        """
        x, y = (((pixels % self.size + 0.5) / self.size - 0.5) * self.window * self.depth,
                ((pixels // self.size + 0.5) / self.size - 0.5) * self.window * self.depth)
        wo = np.stack([-x, -y, np.full(len(pixels), self.depth)], -1)
        if self.orthographic:
            wo = np.tile([0.0, 0.0, 1.0], (len(pixels), 1))
        wo /= np.linalg.norm(wo, axis=1, keepdims=True)
        alpha = np.maximum(self.roughness[pixels] ** 2, ALPHA_MIN)
        wi, pdf, weight = draw_lobe(wo, alpha, self.rng)
        distance = self.height / np.maximum(wi[:, 2], 1e-3)
        hit = wi * distance[:, None]
        return wi, pdf, weight * light(x + hit[:, 0] + self.place_x, y + hit[:, 1]), distance

    def truth(self, light, samples):
        """Return the mean of many samples at every pixel, unfiltered: [h, w]."""
        pixels = np.arange(self.size**2)
        return sum(self.trace(pixels, light)[2] for _ in range(samples)).reshape(self.size, self.size) / samples

    def place_all(self, turn=None):
        """Draw the pixel at which each block is sampled; return pixels and which of them are in the picture.

        With a `turn` all of a block's pixels take turns, and the number tells whose it is.
        """
        place = self.rng.integers(0, self.stride**2, self.columns**2)
        if turn is not None:
            place[:] = (np.arange(len(place)) + turn) % self.stride**2
        block = np.arange(self.columns**2)
        x = block % self.columns * self.stride + place % self.stride
        y = block // self.columns * self.stride + place // self.stride
        valid = (x < self.size) & (y < self.size)
        return place, np.where(valid, y * self.size + x, 0), valid

    def give(self, place, valid, values, distance, direction, pdf):
        """Set the samples of the frame to come; `values` is one number or colour for each block."""
        values = np.broadcast_to(np.asarray(values, np.float64).reshape(len(place), -1), (len(place), 3))
        halves = np.concatenate(
            [values, np.minimum(np.broadcast_to(distance, (len(place),)), 6e4)[:, None]], 1).astype(np.float16)
        self.samples.radiance.assign(np.ascontiguousarray(halves).view(np.uint64).reshape(-1))
        self.samples.place.assign(np.where(valid, place, int(WAITS)).astype(np.uint8))
        self.samples.direction.assign(packed_normals(direction))
        self.samples.pdf.assign(np.where(valid, pdf, 0.0).astype(np.float32))

    def draw(self, light, noise=None):
        """Draw the samples of the frame to come, each multiplied by noise(rng, count)."""
        place, pixels, valid = self.place_all()
        direction, pdf, values, distance = self.trace(pixels, light)
        if noise is not None:
            values = values * noise(self.rng, len(values))
        self.give(place, valid, values, distance, direction, pdf)

    def show(self, rest=0, light_age=LONG_AGO, restart=0):
        """Denoise a frame; return the picture [h, w] (red)."""
        self.row["rest"], self.row["light_age"], self.row["frame"] = rest, light_age, LONG_AGO + self.frame
        self.row["restart"] = restart
        self.views.assign(self.row)
        self.graphs[self.frame & 1].replay()
        self.frame += 1
        return self.picture()[..., 0]

    def picture(self):
        """Return the last frame's mean [h, w, 3]."""
        packed = self.outputs[(self.frame - 1) & 1].numpy()
        codes = np.stack([packed >> np.uint64(21 * c) & np.uint64(0x1FFFFF) for c in range(3)], -1).astype(np.uint32)
        values = (codes << np.uint32(8)).view(np.float32) * np.float32(2.0**79)
        return values.reshape(self.size, self.size, 3)

    def state(self):
        """Return lengths, short means, deviations and closeness of the last frame's means [h, w, 4]."""
        values = self.denoiser.history.current((self.frame - 1) & 1).state.numpy().view(np.float16)
        return values.astype(np.float32).reshape(self.size, self.size, 4)

    def confidence(self):
        """Return the confidence of the last frame's light [h, w]."""
        values = self.denoiser.filtered.state.numpy().view(np.float16).astype(np.float32)
        return values.reshape(self.size, self.size, 4)[..., 1]
