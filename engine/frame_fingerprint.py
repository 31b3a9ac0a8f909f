# SPDX-License-Identifier: GPL-3.0-or-later
"""What a recorded frame freezes of a scene besides settings: with another one it must be recorded anew."""

from __future__ import annotations

from ..kernels.environment_split import EnvironmentSplit
from ..kernels.motion import Motion
from .device_scene import DeviceScene
from .fog import fog_struct
from .passes.gbuffer import shines_plainly

__all__ = ["fingerprint"]


def fingerprint(
    scene: DeviceScene, motion: Motion, split: EnvironmentSplit, blurred: bool,
) -> tuple[bytes, tuple]:
    """Return the addresses and numbers in by-value structs, and what the choice of launches depends on.

    Args:
        scene: The scene.
        motion: Where its things were.
        split: How the world is split.
        blurred: Whether anything is out of focus.
    """
    facts = (scene.structures.has_filtered, shines_plainly(scene.scene, scene.emitters), scene.has_hit_programs,
             scene.world_texels.ptr, scene.emitters.textured, scene.local_power, scene.radius, split.share,
             scene.material_table.lean, scene.material_table.reflectors, scene.material_table.subsurface, blurred)
    structs = [scene.scene, motion, split, scene.homes.struct(scene.instances)]
    structs += [scene.media.frames] if scene.media is not None and scene.media.frames is not None else []
    fog = scene.media and scene.media.fog
    structs += [fog_struct(fog)] if fog is not None else []
    return b"".join(bytes(struct._ctype) for struct in structs), facts
