# SPDX-License-Identifier: GPL-3.0-or-later
"""What figures.py draws: figures of Eto et al. 2023, each with a scene, settings that are compared, and what to see.

Figures 1, 11, 12 and Table 1 need scenes from files and are in figures.py itself, as are the curves of Figure 6.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from tests import glossy_scenes as made  # noqa: E402
from tests.performance.settings_text import Groups, merged  # noqa: E402


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One comparison of settings."""

    number: str
    title: str
    caption: str
    """What the paper shows, and what is seen here"""
    scene: Callable[[tuple[int, int]], made.GlossyScene]
    variants: dict[str, Groups]
    """Settings by label"""
    shared: Groups | None = None
    """Settings that all variants have"""
    frames: int = 32
    crop: tuple[float, float, float, float] | None = None
    """Part of the picture that is shown large: x, y, width, height as shares, y upwards; None: all"""


def polished_floor(size: tuple[int, int]) -> made.GlossyScene:
    """Make a floor of low roughness before coloured walls and shining panels."""
    return made.colored_room(size, made.glossy(color=0.15, roughness=0.12, specular_level=1.0))


def steel_floor(size: tuple[int, int]) -> made.GlossyScene:
    """Make a metal floor of medium roughness under a shining bar."""
    return made.thin_emitter(size, made.metal(0.18), upright=True)


# One frame alone: what is to be seen is not averaged away. After few frames: at rest filters become narrow and sparks
# are kept.
ALONE: Groups = {"denoiser": {"reflection_temporal": False, "antialiasing": False}}
LOOK_UP: Groups = {"reflections": {"hit_lighting": False, "screen_reuse": False}}


FIGURES = (
    Figure(
        number="2", title="Reflections from probes alone, and traced", scene=polished_floor,
        caption="The paper: reflections of low roughness that are looked up in the screen probes lose their detail; "
        "rays up to r_rt keep it. The floor has roughness 0.12.",
        variants={"probes alone (r_rt = 0)": {"reflections": {"roughness_traced": 0.0, "roughness_blend": 0.0}},
                  "rays up to r_rt = 0.2": {"reflections": {"roughness_traced": 0.2}}}),
    Figure(
        number="3", title="Jitter of look-ups in the radiance cache", scene=made.off_screen, shared=LOOK_UP,
        caption="The paper: without jitter the cells of the hash grid are seen in mirrors; jitter in the hit's plane "
        "turns their borders into noise that the filters remove. Hits are not lit themselves here, nor taken from the "
        "frame before, so that cells are seen at all.",
        variants={"without jitter": {"reflections": {"jitter": False}},
                  "with jitter": {"reflections": {"jitter": True}}},
        crop=(0.15, 0.3, 0.5, 0.5)),
    Figure(
        number="4", title="Cells placed by the BRDF at the first hit", scene=made.off_screen, shared=LOOK_UP,
        caption="The paper: reflections find no cells where no probe ray has been, and stay black there; sending probe "
        "rays into reflections as well makes the cells. With hits lit by themselves rays make the cells they need.",
        variants={"diffuse probe rays": {"probes": {"specular_rays": False}},
                  "probe rays by the BRDF": {"probes": {"specular_rays": True}},
                  "hits lit themselves": {"reflections": {"hit_lighting": True}}}),
    Figure(
        number="5", title="From a quarter of the pixels to all of them", scene=made.rough_metal, shared=ALONE, frames=8,
        caption="The paper: one ray for 2 x 2 pixels a frame, upscaled by the last pass of the filter. One frame "
        "alone, with a ray for each pixel, for 2 x 2 and for 4 x 4.",
        variants={"each pixel": {"reflections": {"resolution": "full"}},
                  "2 x 2 pixels": {"reflections": {"resolution": "half"}},
                  "4 x 4 pixels": {"reflections": {"resolution": "quarter"}}}),
    Figure(
        number="7", title="Weights of the filter", scene=steel_floor,
        caption="The paper: a Gaussian g smears reflections over surfaces, g d (distance to the plane) over lobes, "
        "g d p (density of the neighbour's ray here) follows the lobe. p alone gives a lobe squared, too narrow, and "
        "averaging compressed light darkens; the ratio of both densities in linear light gives the lobe itself. A "
        "narrow bar in metal of roughness 0.18, with a narrow, the usual and a wide kernel.",
        variants={"g d p, as published": {"denoiser": {"reflection_ratio": False}},
                  "ratio of densities": {"denoiser": {"reflection_ratio": True}},
                  "ratio, kernel 0.5": {"denoiser": {"reflection_ratio": True, "reflection_kernel": 0.5}},
                  "ratio, kernel 2": {"denoiser": {"reflection_ratio": True, "reflection_kernel": 2.0}}}),
    Figure(
        number="8", title="Passes of the filter", scene=made.rough_metal, shared=ALONE, frames=8,
        caption="The paper: k passes reach 2^k pixels far; mirrors are the least steady with few of them. One frame "
        "alone.",
        variants={f"k = {k}": {"denoiser": {"reflection_iterations": k}} for k in (2, 3, 4)}),
    Figure(
        number="9", title="Jitter where roughness varies", scene=made.brushed, shared=ALONE, frames=8,
        caption="The paper: where roughness changes from pixel to pixel the fixed steps of the last pass leave a "
        "pattern; jitter of its taps hides it. One frame alone.",
        variants={"without jitter": {"reflections": {"jitter": False}},
                  "with jitter": {"reflections": {"jitter": True}}},
        crop=(0.3, 0.25, 0.4, 0.4)),
    Figure(
        number="10", title="Clean-up of sparks and missing samples", scene=made.bumpy_chrome,
        shared=merged(ALONE, {"reflections": {"screen_reuse": False}}), frames=8,
        caption="The paper: samples that found no cell, and sparks, are replaced by their neighbours before the filter "
        "spreads them. One frame alone.",
        variants={"without clean-up": {"denoiser": {"reflection_cleanup": False}},
                  "with clean-up": {"denoiser": {"reflection_cleanup": True}}}),
)

PAPER_TABLE = {
    "interpolation": (0.31, 0.31, 0.37, 0.33), "ray-traced reflection": (0.28, 0.26, 0.18, 0.18),
    "denoise and upscale": (0.60, 0.85, 0.96, 0.46), "GI-1.0, rest": (3.09, 3.66, 3.10, 3.14),
    "total": (4.28, 5.08, 4.61, 4.11)}
"""Table 1 of the paper: ms at 1920 x 1080 on an RX 7900 XTX, for Figures 11 a to d"""

TABLE_ROWS = {
    "interpolation": ("probe interpolation", "contact detail", "reflection samples", "refraction samples"),
    "denoise and upscale": (
        "reflection denois", "refraction denois", "reflection clean", "refraction clean", "reflection filter",
        "refraction filter", "reflection tempor", "refraction tempor", "reflection upscal", "refraction upscal"),
    "ray-traced reflection": ("reflection", "refraction"),
    "GI-1.0, rest": ("probe", "cache", "diffuse", "reprojection"),
}
"""Beginnings of the names of our sections that belong to a row of the table; the first row that fits"""
OUTSIDE = "outside of the paper's total"
"""Row of all else: rays from the camera, materials, direct light, composite"""


def table_row(section: str) -> str:
    """Return the row of the table that a section belongs to."""
    name = section.lower()
    return next((row for row, starts in TABLE_ROWS.items() if name.startswith(starts)), OUTSIDE)
