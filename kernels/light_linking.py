# SPDX-License-Identifier: GPL-3.0-or-later
"""Light and shadow linking: which surfaces a light is for, and which cast its shadows (engine/light_linking.py).

A light's visibility holds the number of its set of receivers from LINK_SHIFT on, 0 for one that is for everything, and
from BLOCK_SHIFT on that of its set of blockers, 0 for all; an instance's `receives` has a bit for each set that it is
in, and bit 0. Light sampling knows nothing of it: a light that is drawn and is for others adds nothing. Instances that
are not in some set of blockers lie among the triangles that need a test, where shadow rays ask. Scenes without linking
(Lights.linked 0) load nothing for it.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer
from .paths import Paths
from .types import LINK_SHIFT, Scene

LINK_MASK = wp.constant(31)
"""Of the numbers of sets"""
BLOCK_SHIFT = wp.constant(16)


@wp.func
def is_lit(visibility: int, receives: int) -> bool:
    """Return whether a light of this visibility is for an instance that receives these sets."""
    return ((receives >> ((visibility >> LINK_SHIFT) & LINK_MASK)) & 1) != 0


@wp.func
def blockers(visibility: int) -> int:
    """Return the number of the set of what casts a light's shadows, 0 for everything."""
    return (visibility >> BLOCK_SHIFT) & LINK_MASK


@wp.func
def is_linked(visibility: int) -> bool:
    """Return whether a light is for some objects alone, or some alone cast its shadows."""
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
def kinds_lit_inside(scene: Scene, visibility: int, instance: int) -> int:
    """Return the same for a medium that an instance holds; -1: none does, and all lights are for it."""
    if instance < 0:
        return visibility
    return kinds_lit(scene, visibility, instance)


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


@wp.func
def met_by_rays(scene: Scene, visibility: int, pdf: float) -> bool:
    """Return whether rays that a BSDF has drawn by a density `pdf` bring what they meet of a light.

    Not where some objects alone cast its shadows: rays end at all, so that light sampling, which knows better, stands
    for them; mirrors, of density 0, sample no lights.
    """
    if scene.lights.linked == 1 and pdf > 0.0:
        return blockers(visibility) == 0
    return True


@wp.func
def note_blockers(scene: Scene, visibility: int, paths: Paths, path: int):
    """Note, of a lamp or the world, which objects cast its shadows; emissive instances know it themselves."""
    if scene.lights.linked == 1:
        paths.shadow_emitter[path] = wp.vec2i(-1, visibility)


@wp.func
def shadow_set(scene: Scene, paths: Paths, path: int) -> int:
    """Return the number of the set of what stops a path's shadow ray, 0 for everything."""
    if scene.lights.linked == 0:
        return 0
    emitter = paths.shadow_emitter[path]
    if emitter[0] < 0:
        return blockers(emitter[1])
    return blockers(scene.geometry.instances[emitter[0]].visibility)


@wp.func
def is_in(scene: Scene, instance: int, number: int) -> bool:
    """Return whether an instance is in a set."""
    return ((scene.geometry.instances[instance].receives >> number) & 1) != 0
