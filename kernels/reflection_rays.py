# SPDX-License-Identifier: GPL-3.0-or-later
"""The rays of glossy reflections and of refraction: their queue, their states and random numbers. Functions only.

A frame's rays lie in a row without gaps, in the order of their blocks, so that neighbours stay together. The states are
the path tracer's and the radiance cache's structs: `Paths` is the segment under way and `Vertices` the hit in which a
ray ends, so that the cache's kernels light these hits as they light those of probe rays. In addition to what the
structs say:

- Paths.state: surfaces met so far, the pixel's included; ENDED once nothing is left to trace. Hits that must be lit get
  1 again.
- Paths.throughput: what the light found now is worth, over the pixel's albedo.
- Paths.pdf: the least density with which any direction of the ray was drawn: the widest lobe.
- Vertices.emission: throughput * light found on the way; w = length of the way [m], IDLE where there is no ray.
- Vertices.reflectance: of the hit in which a ray ends, over the chance of ending there; 0: there is nothing to light.
  w = LEFT: the full node machine has yet to run.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import IDLE, Vertices
from .hash_grid import NO_CELL
from .intersect import offset_origin
from .lamp_hit import FAR
from .light_linking import note_receiver
from .packing import pack_normal
from .paths import ENDED, Paths
from .reflection_types import SAMPLE_FAR, ReflectionOptions, ReflectionSamples, place_pixel
from .sampling import pixel_seed_of
from .types import VISIBLE_DIFFUSE, VISIBLE_GLOSSY, VISIBLE_TRANSMISSION, Scene, ShadingPoint
from .view import View

# Dimensions of reflections' random numbers; each further surface takes as many as there are here.
DIMENSION_CLASS = wp.constant(200)
DIMENSION_DIRECTION = wp.constant(201)
DIMENSION_LOBE = wp.constant(202)
"""x: which lobe, y: end, mirror or refract"""
DIMENSION_CLOSURE = wp.constant(203)
DIMENSIONS = wp.constant(4)

# Indices from here on are those of pixels that stand in for one of their block that reflects nothing.
STAND_IN = wp.constant(1 << 20)

# Vertices.reflectance[3] of hits that the lean machine can't run.
LEFT = wp.constant(-2.0)

# Density [1/sr] of directions that are drawn for certain.
PDF_MAX = wp.constant(1.0e9)

# Paths.kind, beside VISIBLE_* bits, of rays that have gone through clear glass alone; see kind_through.
CLEAR_WAY = wp.constant(1 << 30)

# ReflectionRays.found: where a ray's light came from
FOUND_NONE = wp.constant(wp.uint8(0))
FOUND_WORLD = wp.constant(wp.uint8(1))
FOUND_EMITTER = wp.constant(wp.uint8(2))
"""Emission alone: a black surface"""
FOUND_HIT = wp.constant(wp.uint8(3))
"""A hit that is yet to be lit, in which the ray ended by chance: it could have gone on"""
FOUND_WHOLE_HIT = wp.constant(wp.uint8(4))
"""The same for certain: all that the surface reflects"""
FOUND_SCREEN = wp.constant(wp.uint8(5))
"""The frame before shows it"""
FOUND_OWN = wp.constant(wp.uint8(6))
"""Lit by a shadow ray of its own and the cache's indirect light"""
FOUND_CELL = wp.constant(wp.uint8(7))
"""Lit by a cell's means alone"""
FOUND_DIRECT = wp.constant(wp.uint8(8))
"""Lit by a shadow ray of its own alone: for indirect light other rays go on"""
FOUND_BELOW = wp.constant(wp.uint8(9))
"""To be found: where light goes in that comes out here (reflection_below.py)"""
FOUND_EXIT = wp.constant(wp.uint8(10))
"""A place where it does, which is yet to be lit"""


@wp.struct
class ReflectionRays:
    """The queue of rays, besides their states."""

    source: wp.array[wp.uint8]
    """Per block: SOURCE_* in reflection_types.py"""
    flag: wp.array[int]
    """Per block: 1 has a ray"""
    rank: wp.array[int]
    """Per block: how many have one up to here, its own included"""
    block: wp.array[int]
    """Per ray"""
    found: wp.array[wp.uint8]
    """Per ray: FOUND_*"""
    glossy: int
    """1: hits show highlights, and the rest is there"""
    least_density: float
    """Of a ray whose hit shows any [1/sr]: what others show is too blurred"""
    lobe: wp.array[wp.uint64]
    """Per ray: reflection_highlights.pack_lobe of the hit in which it ended; 0: none"""
    highlight: wp.array[float]
    """Per ray: what the lobe makes of the light sample, over what matte light does"""
    shared: wp.array[float]
    """Per ray: density with which it has gone on [1/sr], for each ray that ends instead; 0: it shows all lights"""


@wp.func
def ray_count(rays: ReflectionRays, blocks: int) -> int:
    """Return how many rays there are in this frame."""
    return rays.rank[blocks - 1]


@wp.func
def sequence_seed(view: View, width: int, pixel: int) -> wp.uint32:
    """Return the seed of a pixel's sequences."""
    return pixel_seed_of(
        view.camera.crop_x + pixel % width, view.camera.crop_y + pixel // width, view.camera.seed)


@wp.func
def place_of_frame(stride: int, frame: int) -> int:
    """Return the place in a block whose turn it is: neighbouring frames lie far apart."""
    if stride == 2:
        y = frame & 1
        return y * 2 + (y ^ ((frame >> 1) & 1))
    if stride == 4:
        x = (frame & 1) * 2 + ((frame >> 2) & 1)
        y = ((frame ^ (frame >> 1)) & 1) * 2 + (((frame >> 2) ^ (frame >> 3)) & 1)
        return y * 4 + x
    return 0


@wp.func
def sequence_index(stride: int, frame: int, place: int) -> wp.uint32:
    """Return the index in a pixel's sequences: it counts the pixel's turns.

    A pixel that stands in for another takes numbers of their own, so that none comes twice.
    """
    if place == place_of_frame(stride, frame):
        return wp.uint32(frame // (stride * stride))
    return wp.uint32(frame + STAND_IN)


@wp.func
def make_idle(paths: Paths, vertices: Vertices, slot: int):
    """Mark a slot as without a ray."""
    paths.state[slot] = ENDED
    vertices.emission[slot] = wp.vec4(0.0, 0.0, 0.0, IDLE)
    vertices.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    vertices.cell[slot] = NO_CELL


@wp.struct
class RayStart:
    """Where a ray begins."""

    block: int
    """-1: the slot has no ray"""
    pixel: int
    seed: wp.uint32
    """Of the pixel's sequences"""
    index: wp.uint32
    """In them"""


@wp.func
def find_start(
    view: View, options: ReflectionOptions, samples: ReflectionSamples, rays: ReflectionRays, paths: Paths,
    vertices: Vertices, slot: int,
) -> RayStart:
    """Return where the ray of a slot begins; slots without one are marked."""
    start = RayStart()
    if slot >= ray_count(rays, options.columns * options.rows):
        make_idle(paths, vertices, slot)
        start.block = -1
        return start
    start.block = rays.block[slot]
    place = int(samples.place[start.block])
    start.pixel = place_pixel(options, start.block, place)
    start.seed = sequence_seed(view, options.width, start.pixel)
    start.index = sequence_index(options.stride, view.frame, place)
    return start


@wp.func
def start_ray(
    samples: ReflectionSamples, rays: ReflectionRays, paths: Paths, vertices: Vertices, slot: int, start: RayStart,
    direction: wp.vec3, weight: wp.vec3, pdf: float, cone: wp.vec2,
):
    """Set up a new slot with its first direction, ended yet; see send_ray."""
    samples.direction[start.block] = pack_normal(direction)
    samples.pdf[start.block] = pdf
    paths.state[slot] = ENDED
    paths.seed[slot] = start.seed
    paths.index[slot] = start.index
    paths.throughput[slot] = weight
    paths.pdf[slot] = pdf
    paths.cone[slot] = cone
    vertices.emission[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    vertices.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    vertices.cell[slot] = NO_CELL
    rays.found[slot] = FOUND_NONE


@wp.func
def send_ray(
    scene: Scene, paths: Paths, slot: int, point: ShadingPoint, direction: wp.vec3, kind: int, surfaces: int,
):
    """Send a ray on from a surface, the `surfaces`-th on its way."""
    note_receiver(scene, point.instance, paths, slot)
    paths.state[slot] = surfaces
    paths.origin[slot] = offset_origin(point.position, point.geometric_normal, point.error, direction)
    paths.direction[slot] = direction
    paths.t[slot] = FAR
    paths.kind[slot] = kind


@wp.func
def gather(vertices: Vertices, slot: int, light: wp.vec3, length: float):
    """Add light found on the way and length of way; `light` is throughput included."""
    e = vertices.emission[slot]
    vertices.emission[slot] = wp.vec4(
        e[0] + light[0], e[1] + light[1], e[2] + light[2], wp.min(e[3] + length, SAMPLE_FAR))


# What kernels mean by `reflection`: who else shows the lights that a ray meets.
REFRACTED = wp.constant(0)
"""Nobody: rays that went through glass. Of those that a translucent lobe has scattered light samples show all"""
REFLECTED = wp.constant(1)
"""Light samples, for rays that come straight from the pixel's surface, over no mirror; both share them"""
GATHERED = wp.constant(2)
"""Light samples show all of them (direct diffuse light), but those that mirrors show"""


@wp.func
def first_density(reflection: int, paths: Paths, slot: int) -> float:
    """Return the density that a ray shares light with (reflection_lights.py); 0: it counts in full, -1: not at all."""
    kind = paths.kind[slot] & (CLEAR_WAY - 1)
    if reflection == GATHERED:
        return wp.where(kind == VISIBLE_GLOSSY, 0.0, -1.0)
    if kind == VISIBLE_DIFFUSE or kind == (VISIBLE_DIFFUSE | VISIBLE_TRANSMISSION):
        return -1.0
    return wp.where(reflection == REFLECTED and comes_straight(paths, slot), paths.pdf[slot], 0.0)


@wp.func
def shared_with_samples(rays: ReflectionRays, paths: Paths, slot: int) -> float:
    """Return the density by which a ray shares lights with samples at the mirror that it comes from, 0 for none."""
    if rays.glossy == 0 or paths.state[slot] <= 1:
        return 0.0
    return rays.shared[slot]


@wp.func
def comes_straight(paths: Paths, slot: int) -> bool:
    """Return whether a ray has met nothing but clear glass since the pixel's surface: light samples meet what it does.

    Where light does not go on behind clear glass (clear_glass.py), only rays that have met nothing do.
    """
    return paths.state[slot] == 1 or (paths.kind[slot] & CLEAR_WAY) != 0


@wp.func
def clear_length(paths: Paths, vertices: Vertices, slot: int) -> float:
    """Return how far behind the pixel's surface a ray begins that has gone through clear glass alone; 0 for others.

    So far back lies, about, what light samples of the lights ahead are sent from.
    """
    return wp.where((paths.kind[slot] & CLEAR_WAY) != 0, vertices.emission[slot][3], 0.0)


@wp.func
def passes_samples(scene: Scene, point: ShadingPoint, direction: wp.vec3, kind: int) -> bool:
    """Return whether light samples go through a surface, too, where a ray of a kind goes on."""
    through = kind == VISIBLE_TRANSMISSION and wp.dot(direction, point.wo) < 0.0
    if not through or scene.materials.clear.shape[0] == 0:
        return False
    return scene.materials.clear[point.material][3] != 0.0


@wp.func
def kind_through(
    scene: Scene, point: ShadingPoint, direction: wp.vec3, kind: int, paths: Paths, slot: int,
) -> int:
    """Return the kind of a ray that goes on from glass: with CLEAR_WAY where light samples go there, too.

    One from a lobe that light samples show alone keeps that lobe's kind beside its own.
    """
    if not (comes_straight(paths, slot) and passes_samples(scene, point, direction, kind)):
        return kind
    return kind | (paths.kind[slot] & VISIBLE_DIFFUSE) | CLEAR_WAY
