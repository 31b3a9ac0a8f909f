# SPDX-License-Identifier: GPL-3.0-or-later
"""Where things are in the frames before and after, for the Vector pass.

The render's dependency graph is evaluated for both and then for its own frame again, as Cycles does. Vertices are read
of those meshes alone that Blender evaluates anew. Main thread or render job; keeps nothing of bpy.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import bpy
import numpy as np

from ...engine.report import Report
from ...engine.scene import CameraData, FrameMotion
from .changes import MeshKeys
from .geometry import read_positions
from .instances import Gathered, build_table, gather_instances, kept_rows

__all__ = ["OtherFrame", "read_other_frames"]


@dataclass(eq=False)
class OtherFrame:
    """One of the two."""

    cameras: dict[str, CameraData]
    """By view"""
    object_keys: list[Hashable]
    transforms: np.ndarray
    positions: dict[tuple[int, int], np.ndarray]
    """float32 [V, 3], by MeshKeys' slots"""

    def motion(self, view: str, mesh_keys: dict[tuple[int, int], int]) -> FrameMotion:
        """Return it as the engine takes it, for one view; `mesh_keys` are the extracted scene's by slot."""
        positions = {mesh_keys[slot]: values for slot, values in self.positions.items() if slot in mesh_keys}
        return FrameMotion(camera=self.cameras[view], object_keys=self.object_keys, transforms=self.transforms,
                           positions=positions)


def read_other_frames(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph,
                      cameras: Callable[[], dict[str, CameraData]]) -> tuple[OtherFrame, OtherFrame]:
    """Return where things are one frame before and after; evaluated data read before must not be used any more.

    Args:
        engine: Renders `depsgraph`.
        depsgraph: Of a final render.
        cameras: Returns the cameras of all views as they are evaluated.
    """
    frame, subframe = depsgraph.scene.frame_current, depsgraph.scene.frame_subframe
    still = set(MeshKeys.describe(gather(depsgraph).sources)[1])
    try:
        return tuple(read_at(engine, depsgraph, frame + step, subframe, still, cameras) for step in (-1, 1))
    finally:
        engine.frame_set(frame, subframe)


def gather(depsgraph: bpy.types.Depsgraph) -> Gathered:
    """Return all that is visible; the extraction of the frame itself reports what is odd."""
    return gather_instances(depsgraph, space=None, report=Report())


def read_at(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, frame: int, subframe: float,
            still: set[Hashable], cameras: Callable[[], dict[str, CameraData]]) -> OtherFrame:
    """Evaluate a frame and return it; meshes of a version in `still` are the same as in the frame rendered."""
    engine.frame_set(frame, subframe)
    gathered = gather(depsgraph)
    versions, slots = MeshKeys.describe(gathered.sources)
    table = build_table(gathered, versions, kept_rows(gathered, versions, Report())[1])
    positions = {}
    for source, version in zip(gathered.sources, versions, strict=True):
        if version is not None and version not in still and slots[version] not in positions:
            values = read_positions(source)
            if values is not None:
                positions[slots[version]] = values
    return OtherFrame(cameras(), table.object_keys, table.transforms, positions)
