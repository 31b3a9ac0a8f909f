# SPDX-License-Identifier: GPL-3.0-or-later
"""Which materials an image masks: programs whose answer is known, and those of which nothing must be claimed."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.alpha_masks import MaskedBy, find_mask
from burnish.engine.program import ProgramBuilder
from burnish.kernels import node_codes as codes
from burnish.kernels.opacity_pieces import CHANNEL_LUMINANCE


def mask_of(alpha) -> MaskedBy | None:
    """Return the mask of a Principled BSDF whose alpha `alpha` builds."""
    build = ProgramBuilder()
    value = build.math("CLAMP", alpha(build), 0.0, 1.0)
    build.transparent(1.0, build.math("SUBTRACT", 1.0, value))
    build.closure("PRINCIPLED", value, color=0.8)
    return find_mask(build.finish())


def image(build: ProgramBuilder, **options):
    """Return a look-up by the UV map."""
    return build.image("leaf", build.uv("UVMap"), **options)


def table(values) -> bytes:
    """Return a ramp's table of grey values."""
    rows = np.ones((codes.RAMP_SIZE, 4), np.float32)
    rows[:, :3] = np.asarray(values, np.float32)[:, None]
    return rows.tobytes()


def test_plain_alpha_is_known_at_its_ends() -> None:
    """Know of alpha itself only that nothing of 0 is seen and all of 1."""
    mask = mask_of(lambda b: b.component(image(b), 3))
    assert mask.image == "leaf" and mask.uv_map == "UVMap" and mask.channel == 3 and mask.extension == 0
    assert mask.clear[0] <= 0.0 and mask.clear[1] == 0.0
    assert 0.99 < mask.solid[0] <= 1.0 and mask.solid[1] >= 1.0
    assert mask.u == (1.0, 0.0, 0.0) and mask.v == (0.0, 1.0, 0.0)


def test_thresholds_are_found() -> None:
    """Know all but the neighbourhood of a threshold, either way round, and after other sums."""
    mask = mask_of(lambda b: b.math("GREATER_THAN", b.component(image(b, extension=2), 3), 0.3))
    assert mask.extension == 2
    assert 0.29 < mask.clear[1] <= 0.3 <= mask.solid[0] < 0.31
    mask = mask_of(lambda b: b.math("LESS_THAN", b.math("MULTIPLY", b.component(image(b), 0), 2.0), 0.5))
    assert mask.channel == 0 and mask.solid[0] <= 0.0
    assert 0.24 < mask.solid[1] <= 0.25 <= mask.clear[0] < 0.26 and mask.clear[1] >= 1.0
    mask = mask_of(lambda b: b.math("ROUND", b.math("MULTIPLY_ADD", b.component(image(b), 3), 0.5, 0.4)))
    assert 0.19 < mask.clear[1] <= 0.2 <= mask.solid[0] < 0.21


def test_colors_and_ramps_are_understood() -> None:
    """Know what a colour's luminance says, and a ramp."""
    mask = mask_of(lambda b: b.math("GREATER_THAN", b.luminance(image(b, associate=True)), 0.5))
    assert mask.channel == CHANNEL_LUMINANCE and mask.associate
    assert 0.49 < mask.clear[1] <= 0.5 <= mask.solid[0] < 0.51
    steep = table(np.clip((np.arange(codes.RAMP_SIZE) / 255 - 0.4) * 5, 0, 1))
    mask = mask_of(lambda b: b.component(b.ramp("LINEAR", steep, b.component(image(b), 1)), 0))
    assert mask.channel == 1
    assert 0.38 < mask.clear[1] <= 0.4 and 0.59 <= mask.solid[0] < 0.61


def test_constant_transforms_of_the_coordinate_are_taken_along() -> None:
    """Compose matrices, sums, scales and swapped components; all else that moves a coordinate is not understood."""
    rows = [[2.0, 0.5, 0.0, 0.1], [-0.5, 3.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.0]]

    def moved(build: ProgramBuilder):
        uv = build.vector("ADD", build.transform(rows, build.uv("UVMap")), (0.5, -0.25, 0.0))
        uv = build.vector("SCALE", uv, 0.0, 2.0)
        return build.combine(build.component(uv, 1), build.component(uv, 0), 0.0)

    mask = mask_of(lambda b: b.component(b.image("leaf", moved(b)), 3))
    np.testing.assert_allclose(mask.v, (4.0, 1.0, 1.2), atol=1e-6)
    np.testing.assert_allclose(mask.u, (-1.0, 6.0, -0.1), atol=1e-6)
    waved = mask_of(lambda b: b.component(b.image("leaf", b.vector("SINE", b.uv("UVMap"))), 3))
    assert waved is None
    mixed = mask_of(lambda b: b.component(b.image("leaf", b.vector("ADD", b.uv("UVMap"), b.uv("other"))), 3))
    assert mixed is None


@pytest.mark.parametrize("alpha", [
    lambda b: b.math("MULTIPLY", b.component(image(b), 3), b.math("ADD", b.input("OBJECT_RANDOM"), 0.5)),
    lambda b: b.math("ADD", b.component(image(b), 3), b.fresnel("FACING", 0.5)),
    lambda b: b.component(b.image("leaf", b.uv("UVMap"), projection="SPHERE"), 3),
    lambda b: b.component(b.image("leaf", b.input("GENERATED")), 3),
    lambda b: b.math("SINE", b.component(image(b), 3)),
    lambda b: 0.5,
])
def test_nothing_is_claimed_of_what_varies_otherwise(alpha) -> None:
    """Claim nothing solid of materials that depend on more than the image, are half transparent or not understood."""
    mask = mask_of(alpha)
    assert mask is None or (mask.solid[0] > mask.solid[1] and mask.clear[1] <= 0.0)


def test_rays_that_differ_stay_unknown() -> None:
    """Claim nothing where shadow rays see another alpha than others; claim what holds for all of them."""
    assert mask_of(lambda b: b.mix("MIX", b.input("RAY_KIND", 16), b.component(image(b), 3), 0.5)) is None
    mask = mask_of(lambda b: b.math("MULTIPLY", b.component(image(b), 3), b.math(
        "SUBTRACT", 1.0, b.math("MULTIPLY", b.math("LESS_THAN", b.input("RAY_LENGTH"), 3.0), 0.5))))
    assert mask.clear[1] == 0.0 and mask.solid[0] > mask.solid[1]


def test_what_is_clear_everywhere_needs_no_image() -> None:
    """Know of a Transparent BSDF without a mask that all light passes."""
    mask = mask_of(lambda b: 0.0)
    assert mask.image is None and mask.clear == (0.0, 0.0)
    build = ProgramBuilder()
    build.transparent((1.0, 0.5, 1.0), 1.0)
    assert find_mask(build.finish()) is None
    assert find_mask(ProgramBuilder().finish()) is None
