# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the energy of reflections in real time: white furnaces of every roughness, metal, coats, glass."""

import pytest
from burnish.engine.stress.furnaces import EMISSION, ball_masks, closed_box, white_share
from burnish.engine.stress.scenes import balls_in_sky, principled

from tests import glossy_checks
from tests.light_checks import Setup, luminance

SMALL = Setup((144, 48), truth_samples=256)
GLASS = Setup((144, 48), truth_samples=512)
BOX = Setup((48, 36), truth_samples=512)


def white_box_light(setup, count, albedo, **surface):
    """Return the light of a closed white box after so many frames or samples, by e / (1 - share)."""
    picture = setup.picture(closed_box(albedo, setup.size, **surface), count)
    return luminance(picture).mean() / (EMISSION / (1.0 - albedo * white_share(**surface)))


def check(result):
    """Fail with all figures that miss their goals."""
    missed = [f"{f.name}: {f.value:.4g} is not in {f.low:g}..{f.high:g}" for f in result[0] if not f.good]
    assert not missed, "\n".join(missed)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kinds", [("plastic", "metal"), ("coated plastic", "coated metal"), ("half metal",), ("glass",)])
def test_white_balls(kinds):
    """Find the light of Reference on white balls of every roughness in a white world."""
    if "glass" in kinds:
        check(glossy_checks.white_balls(GLASS, kinds, 128))
    else:
        check(glossy_checks.white_balls(SMALL, kinds, 96))


def test_rough_glass_lets_all_light_out():
    """Keep the light that total reflection holds in rough glass of a high IOR longer than rays are followed."""
    size = (24, 24)
    ball = principled(color=1.0, roughness=0.25, metallic=0.0, ior=2.4, transmission=1.0)
    picture = Setup(size).picture(balls_in_sky([ball], size), 96)
    assert luminance(picture)[ball_masks(1, size)[0]].mean() == pytest.approx(1.0, abs=0.012)


@pytest.mark.slow
@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("roughness", glossy_checks.ROUGHNESSES)
def test_glossy_box(roughness, metallic):
    """Find the light of Reference in a closed box that emits and reflects."""
    check(glossy_checks.glossy_box(BOX, 128, metallic=metallic, roughness=roughness))


@pytest.mark.slow
@pytest.mark.parametrize("how", ["frames", "at rest", "reference"])
@pytest.mark.parametrize(("albedo", "tolerance"), [(0.9, 0.01), (0.95, 0.02)])
@pytest.mark.parametrize(("metallic", "roughness"), [(0.0, 0.5), (0.0, 1.0), (1.0, 0.25)])
def test_white_box(metallic, roughness, albedo, tolerance, how):
    """Find e / (1 - share) in closed white boxes: by frames, as samples join them, and by endless paths."""
    setup = Setup((24, 18), "reference" if how == "reference" else "realtime",
                  groups={"denoiser": {"path_traced_rest": how == "at rest"}})
    light = white_box_light(setup, 512, albedo, metallic=metallic, roughness=roughness)
    assert light == pytest.approx(1.0, abs=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize(("albedo", "tolerance"), [(0.8, 0.01), (0.9, 0.01), (0.95, 0.02)])
@pytest.mark.parametrize("roughness", [0.5, 0.75, 1.0])
def test_frames_of_rough_metal_keep_their_light(roughness, albedo, tolerance):
    """Find e / (1 - share) in boxes whose hits show highlights of emission from all around: no light of its own."""
    setup = Setup((48, 36), "realtime", groups={"denoiser": {"path_traced_rest": False}})
    light = white_box_light(setup, 384, albedo, metallic=1.0, roughness=roughness)
    assert light == pytest.approx(1.0, abs=tolerance)


@pytest.mark.slow
def test_long_paths_keep_their_light():
    """Lose nothing after 32 bounces, where paths may not gain: weights of single samples are above 1 now and then."""
    light = white_box_light(Setup((24, 18), "reference"), 1024, 0.95, metallic=0.0, roughness=0.5)
    assert light == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_coated_box():
    """Find the light of Reference in a closed box with a smooth coat over rough walls."""
    check(glossy_checks.glossy_box(BOX, 128, roughness=0.6, coat=1.0, coat_roughness=0.05))
