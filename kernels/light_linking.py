# SPDX-License-Identifier: GPL-3.0-or-later
"""Light linking: which surfaces a light is for (engine/light_linking.py numbers the sets of receivers).

A light's visibility holds the number of its set from LINK_SHIFT on, 0 for one that is for everything; an instance's
`receives` has a bit for each set that it is in, and bit 0. Light sampling knows nothing of it: a light that is drawn
and is for others adds nothing. Scenes without linking (Lights.linked 0) load nothing for it.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer
from .paths import Paths
from .types import LINK_SHIFT, Scene


@wp.func
def is_lit(visibility: int, receives: int) -> bool:
    """Return whether a light of this visibility is for an instance that receives these sets."""
    return ((receives >> (visibility >> LINK_SHIFT)) & 1) != 0


@wp.func
def is_linked(visibility: int) -> bool:
    """Return whether a light is for some objects alone."""
    return (visibility >> LINK_SHIFT) != 0


@wp.func
def is_for(scene: Scene, visibility: int, instance: int) -> bool:
    """Return whether a light of this visibility is for an instance."""
    if scene.lights.linked == 1:
        return is_lit(visibility, scene.geometry.instances[instance].receives)
    return True


@wp.func
def kinds_lit(scene: Scene, visibility: int, instance: int) -> int:
    """Return a light's visibility as an instance has it: that of a light that is for others is 0."""
    return wp.where(is_for(scene, visibility, instance), visibility, 0)


@wp.func
def kinds_lit_at(scene: Scene, gbuffer: GBuffer, pixel: int, visibility: int) -> int:
    """Return the same for the surface in a pixel, also of the frame before: there may be fewer instances now."""
    if scene.lights.linked == 1:
        instance = gbuffer.hit[pixel][0]
        if instance >= 0 and instance < scene.geometry.instances.shape[0]:
            return kinds_lit(scene, visibility, instance)
    return visibility


@wp.func
def same_links(scene: Scene, gbuffer: GBuffer, pixel: int, other: int) -> bool:
    """Return whether the same lights are for the surfaces in two pixels of this frame."""
    if scene.lights.linked == 1:
        here = scene.geometry.instances[gbuffer.hit[pixel][0]].receives
        return here == scene.geometry.instances[gbuffer.hit[other][0]].receives
    return True


@wp.func
def note_receiver(scene: Scene, instance: int, paths: Paths, path: int):
    """Note which instance a ray leaves, where that decides which lights it brings."""
    if scene.lights.linked == 1:
        paths.receiver[path] = instance


@wp.func
def receives_at(scene: Scene, bounce: int, paths: Paths, path: int) -> int:
    """Return Instance.receives of what a ray has left after `bounce` bounces; all bits for 0: the camera sees all."""
    if scene.lights.linked == 1 and bounce > 0:
        return scene.geometry.instances[paths.receiver[path]].receives
    return -1


@wp.func
def lamp_counts(scene: Scene, visibility: int, bounce: int, paths: Paths, path: int) -> bool:
    """Return whether a lamp of this visibility that a ray has met is for what the ray has left."""
    return is_lit(visibility, receives_at(scene, bounce, paths, path))


@wp.func
def emission_counts(scene: Scene, instance: int, bounce: int, paths: Paths, path: int) -> bool:
    """Return the same of what an instance emits that a ray has met."""
    if scene.lights.linked == 1:
        return is_lit(scene.geometry.instances[instance].visibility, receives_at(scene, bounce, paths, path))
    return True
