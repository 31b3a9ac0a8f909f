# SPDX-License-Identifier: GPL-3.0-or-later
"""The Shadow pass: what share of the light that lamps send to a surface arrives there.

As EEVEE has it: of all lamps together, diffuse and glossy; the world and emissive meshes do not count. The path
tracer's kernels find the hits and trace a ray from each to a lamp, transparent things included. Of several lamps drawn
by chance one gets the ray, by what it sends (Talbot, Cline and Egbert 2005): what is sent is known without noise that
what arrives does not have, and a pixel in full light is 1.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import luminance
from .lamp_sample import LightSample, no_light
from .layering import prepare_bsdf
from .light_choice import choice_of_none, consider
from .light_linking import kinds_lit
from .lights import class_total, sample_light_of
from .path_shading import candidate_place, front_of, set_shadow_ray, visible_part
from .paths import ENDED, Paths, has_hit, hit_point
from .principled import evaluate_bsdf
from .sampling import (
    DIMENSION_FIRST_BOUNCE,
    DIMENSION_LIGHT,
    DIMENSION_LIGHT_CHOICE,
    DIMENSION_RESAMPLE,
    sample_number,
    sample_pair,
)
from .types import HOLDOUT, LIGHT_ENVIRONMENT, LIGHT_TRIANGLE, Bsdf, Scene, ShadingPoint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Lamps drawn for each ray.
CANDIDATES = wp.constant(4)


@wp.func
def sent_by(scene: Scene, point: ShadingPoint, bsdf: Bsdf, s: LightSample) -> float:
    """Return the luminance that a light sample of a lamp brings to the eye if nothing is in its way, else 0."""
    if s.kind < 0 or s.kind == LIGHT_ENVIRONMENT or s.kind == LIGHT_TRIANGLE:
        return 0.0
    value = evaluate_bsdf(bsdf, point.wo, s.wi)
    reflected = wp.dot(point.geometric_normal, s.wi) > 0.0
    f = visible_part(value.f, value.diffuse, reflected, kinds_lit(scene, s.visibility, point.instance))
    sent = luminance(wp.cw_mul(f, s.radiance), scene.luminance) / s.pdf
    return wp.where(wp.isfinite(sent), wp.max(sent, 0.0), 0.0)


@wp.func
def aim_at_lamp(scene: Scene, paths: Paths, path: int) -> float:
    """Set up the ray of a hit whose closure is known; return what its lamps send."""
    point = hit_point(scene, paths, path, 0)
    if scene.lights.class_count == 0 or (scene.geometry.instances[point.instance].visibility & HOLDOUT) != 0:
        return 0.0
    bsdf = prepare_bsdf(scene.tables, paths.closure[path], point)
    seed = paths.seed[path]
    index = paths.index[path]
    place = sample_pair(seed, index, DIMENSION_FIRST_BOUNCE + DIMENSION_LIGHT)
    refill = sample_number(seed, index, DIMENSION_FIRST_BOUNCE + DIMENSION_LIGHT_CHOICE)
    side = front_of(bsdf)
    classes = class_total(scene.lights, side)
    choice = choice_of_none(sample_number(seed, index, DIMENSION_FIRST_BOUNCE + DIMENSION_RESAMPLE))
    kept = no_light()
    k = int(0)
    while k < CANDIDATES:
        u = candidate_place(place, float(k), CANDIDATES)
        s = sample_light_of(scene, classes, point.position, side, u, refill)
        sent = sent_by(scene, point, bsdf, s)
        choice = consider(choice, wp.vec3(1.0, 1.0, 1.0), sent)
        if choice.keeps_last == 1:
            kept = s
        k = k + 1
    total = choice.total / float(CANDIDATES)
    if kept.kind >= 0:
        set_shadow_ray(scene, point, kept, wp.vec3(total, total, total), paths, path)
    return total


@wp.kernel
def aim_at_lamps(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """End all listed paths, those that have hit something with a ray to a lamp.

    Their radiance gets what lamps send as alpha, -1 where nothing was hit.
    """
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        paths_out.shadow_distance[path] = 0.0
        sent = float(-1.0)
        if has_hit(paths_out, path):
            sent = aim_at_lamp(scene, paths_out, path)
        paths_out.radiance[path] = wp.vec4(0.0, 0.0, 0.0, sent)
        paths_out.state[path] = ENDED


@wp.kernel
def add_shadows(
    # In:
    paths: Paths,
    first_pixel: int,
    pixel_count: int,
    sample_count: int,
    # Out:
    sums_out: wp.array[wp.vec3],
):
    """Add up what has arrived, what was sent, and how many paths have hit nothing."""
    local = wp.tid()
    sums = wp.vec3(0.0, 0.0, 0.0)
    sample = int(0)
    while sample < sample_count:
        found = paths.radiance[sample * pixel_count + local]
        if found[3] < 0.0:
            sums += wp.vec3(0.0, 0.0, 1.0)
        else:
            sums += wp.vec3(found[0], found[3], 0.0)
        sample += 1
    sums_out[first_pixel + local] = sums_out[first_pixel + local] + sums
