# SPDX-License-Identifier: GPL-3.0-or-later
"""How many rays frames have by their size and device (engine/ray_budget.py)."""

import dataclasses

import pytest
from burnish.engine import realtime
from burnish.engine.passes.ray_scene import STRIDES
from burnish.engine.presets import apply_preset
from burnish.engine.ray_budget import SMALL_PIXELS, densified, spreading_rays
from burnish.engine.scene import LightKind
from burnish.engine.session import Session
from burnish.engine.settings import (
    CacheSettings,
    Integrator,
    Preset,
    ProbeSettings,
    ReflectionResolution,
    RenderSettings,
    SamplingSettings,
)

from tests import scenes

DEFAULTS = RenderSettings()
FRAMES = dataclasses.replace(
    scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=14))


def test_a_small_picture_has_no_more_rays_than_a_large_one() -> None:
    """Have as many probes and reflection rays at 960x540 as at 1920x1080, and fewer below."""
    def rays(width: int, height: int) -> tuple[int, int]:
        settings = densified(DEFAULTS, width, height, height, "cuda:0")
        stride, tile = STRIDES[settings.reflections.resolution], settings.probes.spawn_tile
        return -(-width // tile) * -(-height // tile), -(-width // stride) * -(-height // stride)

    assert rays(960, 540) == rays(1920, 1080)
    assert rays(640, 360) < rays(1920, 1080)
    assert rays(1280, 720) < rays(1920, 1080)


def test_small_pictures_have_the_cells_of_large_ones() -> None:
    """Let a cell be as large in the scene at 360 lines as at 1080, where it gets as many rays as ever."""
    for lines in (270, 360, 540):
        cells = densified(DEFAULTS, 16 * lines // 9, lines, lines, "cuda:0").cache.cell_pixels
        on_screen = cells * (lines / 1080) ** 0.5  # as wanted_size in kernels/hash_grid.py
        assert on_screen / lines == pytest.approx(DEFAULTS.cache.cell_pixels / 1080)
    # Four times the rays are enough for cells half as wide.
    assert densified(DEFAULTS, 240, 135, 135, "cuda:0").cache.cell_pixels == DEFAULTS.cache.cell_pixels / 2
    # So have frames of twice the size of a small picture.
    doubled = densified(DEFAULTS, 1280, 720, 720, "cuda:0", 2)
    assert doubled.cache.cell_pixels == pytest.approx(DEFAULTS.cache.cell_pixels * (720 / 1080) ** 0.5)


def test_frames_of_twice_the_size_have_more_probes() -> None:
    """Have a probe a tile in frames of 1280x720 that stand for a small picture, unless nobody sees them."""
    doubled, unseen = (densified(DEFAULTS, 1280, 720, 720, "cuda:0", 2, seen=seen) for seen in (True, False))
    assert doubled.probes.spawn_tile == DEFAULTS.probes.spawn_tile // 2
    assert doubled.reflections == DEFAULTS.reflections
    assert (unseen.probes, unseen.cache) == (DEFAULTS.probes, doubled.cache)
    assert densified(DEFAULTS, 1920, 1080, 1080, "cuda:0", 2).probes == DEFAULTS.probes


def test_parts_have_the_cells_of_the_whole() -> None:
    """Let a region of a large frame have its cells."""
    assert densified(DEFAULTS, 640, 360, 2160, "cuda:0").cache == DEFAULTS.cache


@pytest.mark.parametrize(("width", "height", "device", "settings"), [
    (961, 540, "cuda:0", DEFAULTS),
    (240, 134, "cuda:0", DEFAULTS),
    (640, 360, "cpu", DEFAULTS),
    (640, 360, "cuda:0", apply_preset(DEFAULTS, Preset.PAPER)),
    (640, 360, "cuda:0", apply_preset(DEFAULTS, Preset.DRAFT)),
])
def test_others_are_left_alone(width: int, height: int, device: str, settings: RenderSettings) -> None:
    """Change nothing for large pictures and icons, on processors, and where the user or a preset wants it so."""
    assert densified(settings, width, height, height, device) is settings


def test_the_finest_settings_stay() -> None:
    """Know nothing denser than a probe a tile and a ray a pixel."""
    fine = densified(apply_preset(DEFAULTS, Preset.FINE), 320, 180, 180, "cuda:0")
    assert (fine.probes.spawn_tile, fine.reflections.resolution) == (8, ReflectionResolution.FULL)
    odd = dataclasses.replace(DEFAULTS, probes=ProbeSettings(spawn_tile=9))
    assert densified(odd, 320, 180, 180, "cuda:0").probes.spawn_tile == 8


def test_bounce_rays_of_small_pictures_have_a_limit() -> None:
    """Send a ray on from each hit of a picture that has few, or is large."""
    assert spreading_rays(57_600, 640, 360) == 57_600
    assert spreading_rays(230_400, 640, 360) == 1 << 17
    assert spreading_rays(522_240, 1920, 1080) == 522_240
    assert spreading_rays(600_000, SMALL_PIXELS, 1) == 1 << 17
    # Those of small pictures on a GPU, which are drawn at twice the size.
    assert spreading_rays(230_400, 2 * 640, 2 * 360) == 1 << 17


@pytest.mark.slow
def test_frames_are_made_with_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a frame denser as on a GPU: four times the probes and reflection rays, its light within noise the same."""
    floor = scenes.material("PRINCIPLED", color=0.7, roughness=0.3, metallic=0.5)
    meshes = {"floor": scenes.quad(3.0), "box": scenes.box(0.3)}
    objects = [("floor", scenes.place(), "white"), ("box", scenes.place(z=0.3), "white")]
    lamps = [scenes.lamp(LightKind.POINT, 50.0, scenes.place(1.0, 1.0, 2.0), radius=0.2)]
    camera = scenes.camera_above(3.0, 1.0, orthographic=False)
    counts, means = [], []
    for where in ("cpu", "cuda:0"):
        monkeypatch.setattr(
            realtime, "densified", lambda *given, where=where, **seen: densified(*given[:4], where, **seen))
        session = Session(FRAMES)
        session.update(scenes.delta(meshes, objects, {"white": floor}, lamps, 0.2))
        session.configure(FRAMES, camera, 240, 136)
        session.step(4)
        counts.append(session.counts())
        means.append(session.read("Combined")[..., :3].mean())
        session.close()
    assert counts[1]["probes rays"] == pytest.approx(4 * counts[0]["probes rays"], rel=0.1)
    assert counts[1]["reflection rays"] == pytest.approx(4 * counts[0]["reflection rays"], rel=0.1)
    assert means[1] == pytest.approx(means[0], rel=0.02)
