# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth of field of a real-time frame: the picture that anti-aliasing has averaged, blurred by the camera's lens.

Owns the layers at half resolution and the picture shown. Everything that later frames look at stays sharp.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ...kernels import defocus, defocus_gather, defocus_layers, depth_of_field
from ...kernels.antialias import Accumulation
from ...kernels.defocus import Pyramid
from ...kernels.depth_of_field import Blurred
from ..debug_views import DEBUG_VIEWS
from ..frame_graph import FrameGraph

__all__ = ["DepthOfFieldPass", "has_blur"]

MOST_LEVELS = 8
"""Of detail, beside half resolution: disks of a radius of up to 512 pixels"""

WHITE = 32.0
"""Radius [px] that the debug view shows darkest, in a picture of 1080 lines"""


def has_blur(camera: np.ndarray) -> bool:
    """Tell whether anything that a camera (a FrameData row) sees may be out of focus by half a pixel."""
    row = camera[0]
    radius, near = float(row["aperture_radius"]), max(float(row["clip_start"]), 1e-6)
    if radius <= 0.0:
        return False
    left, right, bottom, top = (float(edge) for edge in row["window"])
    pixels = max(row["width"] / max(abs(right - left), 1e-20) / min(float(row["aperture_ratio"]), 1.0),
                 row["height"] / max(abs(top - bottom), 1e-20))
    if row["orthographic"]:
        return True
    focus = float(row["focus_distance"])
    return radius * pixels * max(1.0 / focus, abs(1.0 / focus - 1.0 / near)) > defocus.SHARP


class DepthOfFieldPass:
    """Blurs what is out of focus."""

    name = "depth_of_field"
    debug_views: dict[str, str] = {"depth_of_field.radius": DEBUG_VIEWS["depth_of_field.radius"]}

    def __init__(self, device: str):
        self.device = device
        self.width = self.height = 0

    def resize(self, width: int, height: int) -> None:
        """Allocate all buffers for a size [px]: 36 bytes a pixel."""
        self.width, self.height = width, height
        device, p = self.device, Pyramid()
        p.width, p.height = width, height
        p.columns, p.rows = -(-width // 2), -(-height // 2)
        p.levels = int(defocus.TILE_LEVEL)
        while p.levels < MOST_LEVELS and 2 << p.levels < max(width, height):
            p.levels += 1
        # As wide as a texel of the coarsest level: a tile looks no further than at the next one (find_reach).
        p.largest = float(2 << p.levels)
        self._sizes = [-(-p.columns // (1 << level)) * -(-p.rows // (1 << level)) for level in range(p.levels + 1)]
        count, texels = sum(self._sizes), self._sizes[0]
        p.near, p.behind = (wp.zeros(count, dtype=wp.uint64, device=device) for _ in range(2))
        p.near_spread, p.behind_spread = (wp.zeros(count, dtype=wp.uint32, device=device) for _ in range(2))
        p.reach = wp.zeros(count, dtype=wp.vec2, device=device)
        p.octaves = wp.zeros(count, dtype=wp.uint32, device=device)
        blurred = Blurred()
        blurred.behind, blurred.near, blurred.filled = (
            wp.zeros(texels, dtype=wp.uint64, device=device) for _ in range(3))
        blurred.radius = wp.zeros(texels, dtype=float, device=device)
        blurred.cover = wp.zeros(texels, dtype=wp.uint32, device=device)
        blurred.tiles = wp.zeros(self._sizes[int(defocus.TILE_LEVEL)], dtype=wp.vec2, device=device)
        self._octaves = wp.zeros(len(blurred.tiles), dtype=wp.uint32, device=device)
        self._pyramid, self._blurred = p, blurred
        self._lens = wp.zeros(int(defocus.LENS_WORDS), dtype=float, device=device)
        self.picture = wp.zeros(width * height, dtype=wp.vec4, device=device)
        """Exposed colour, premultiplied by alpha, as the film shows it"""

    def reset(self) -> None:
        """Forget nothing: frames in motion begin anew, and a lens that changes is motion."""

    def record(
        self, graph: FrameGraph, views: wp.array, depth: wp.array, current: wp.array, mean: Accumulation,
    ) -> wp.array:
        """Record blurring a frame.

        Args:
            graph: Takes the launches.
            views: One View.
            depth: float [h * w], along the view axis [m].
            current: vec4h [h * w], this frame alone.
            mean: What anti-aliasing makes of it.

        Returns:
            vec4 [h * w]: `picture`.
        """
        self._depth, p, lens, blurred = depth, self._pyramid, self._lens, self._blurred
        current = current.view(wp.uint64)
        graph.launch(defocus.describe_lens, int(defocus.LENS_WORDS), [views], [lens])
        graph.launch(
            defocus_layers.split_layers, self._sizes[0], [views, lens, mean.color, current, depth], [p])
        for level in range(1, p.levels + 1):
            graph.launch(defocus_layers.coarsen_layers, self._sizes[level], [level], [p])
        graph.launch(defocus_layers.find_reach, len(blurred.tiles), [p], [blurred.tiles, self._octaves])
        graph.launch(
            defocus_gather.gather_behind, self._sizes[0], [lens, depth, p, self._octaves],
            [blurred.behind, blurred.radius])
        graph.launch(
            defocus_gather.gather_near, self._sizes[0], [lens, p, blurred.tiles],
            [blurred.near, blurred.cover, blurred.filled])
        graph.launch(
            depth_of_field.blur_frame, self.width * self.height,
            [views, lens, mean.color, current, mean.samples, depth, p, blurred], [self.picture])
        return self.picture

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record drawing one of `debug_views` of this frame into `picture` (vec4 [h * w]); comes after record()."""
        graph.launch(
            depth_of_field.show_radius, self.width * self.height,
            [self._lens, self._depth, self._pyramid.largest, max(WHITE * self.height / 1080.0, 1.0)], [picture])
