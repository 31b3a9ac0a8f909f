# SPDX-License-Identifier: GPL-3.0-or-later
"""What the passes of reflection rays know of a scene, and their options."""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from ...kernels.environment_split import EnvironmentSplit
from ...kernels.fog import Fog
from ...kernels.media import Media
from ...kernels.motion import Motion
from ...kernels.reflection_types import LOBE_REFLECTION, ReflectionOptions
from ...kernels.types import Scene
from ..device_scene import DeviceScene
from ..settings import ReflectionResolution, ReflectionSettings

__all__ = ["STRIDES", "RayScene", "reflection_options", "scatters_below"]

STRIDES = {ReflectionResolution.FULL: 1, ReflectionResolution.HALF: 2, ReflectionResolution.QUARTER: 4}


@dataclass(frozen=True)
class RayScene:
    """What a record needs to know of the scene, besides its arrays."""

    scene: Scene
    split: EnvironmentSplit
    motion: Motion
    world: wp.array
    """Its radiance by texels, where it is known (DeviceScene.world_texels)"""
    filtered: bool = True
    """Whether there are triangles that need a test per hit (Structures.has_filtered)"""
    programs: bool = True
    """Whether lights may be programs (DeviceScene.has_hit_programs)"""
    all_plain: bool = False
    """Whether the lean node machine runs all materials, glass included (MaterialTable.lean)"""
    lean_layers: bool = False
    """Whether it runs all transparency programs"""
    lean_strands: bool = False
    """Whether the lean machine of hair runs all programs of hair"""
    mirrors: bool = True
    """Whether any material sends rays on: mirrors sharper than reflection_chain.MIRROR_ROUGHNESS, or glass"""
    scatters: bool = False
    """Whether any is translucent: sends those on that come from another one"""
    below: bool = False
    """Whether light is scattered below surfaces"""
    deterministic: bool = False
    """Whether frames shall be the same in every run"""
    settled: bool = False
    """Whether cells take the light of the rays' hits in the frame after (RadianceCachePass.is_settled)"""
    glossy: bool = False
    """Whether any material shows highlights (Reflectors.glossy)"""

    media: Media | None = None
    """What fills its objects (SceneMedia.frames); None: nothing"""
    fog: Fog | None = None
    """None: there is none"""

    @property
    def needs_full(self) -> bool:
        """Whether anything takes the full node machine."""
        return not self.all_plain or self.scene.environment.constant == 0


def reflection_options(
    settings: ReflectionSettings, width: int, height: int, lobe: int = int(LOBE_REFLECTION),
) -> ReflectionOptions:
    """Return the kernels' options for settings and a size [px]."""
    options = ReflectionOptions()
    stride = STRIDES[settings.resolution]
    options.width, options.height, options.stride = width, height, stride
    options.columns, options.rows = -(-width // stride), -(-height // stride)
    options.lobe = int(lobe)
    options.traced, options.weak = settings.roughness_traced, min(settings.roughness_weak, settings.roughness_traced)
    options.diffuse, options.blend = settings.roughness_diffuse, settings.roughness_blend
    return options


def scatters_below(scene: DeviceScene, settings: ReflectionSettings) -> bool:
    """Return whether frames scatter light below surfaces (kernels/reflection_below.py)."""
    return settings.subsurface and scene.material_table.subsurface.scatters
