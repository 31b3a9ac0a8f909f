# SPDX-License-Identifier: GPL-3.0-or-later
"""What a viewport asks its worker for: settings, camera and size; and what follows from that. Knows nothing of bpy."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..engine.scene import CameraData
from ..engine.setting_changes import Change, change_since
from ..engine.settings import Integrator, RenderSettings
from .resolution import divided_size

__all__ = ["ViewRequest", "divided_crop", "divided_settings", "picture_area", "real_time", "restarts", "step_text"]


@dataclass(frozen=True, kw_only=True)
class ViewRequest:
    """What a viewport wants to see; equal requests keep the samples."""

    settings: RenderSettings
    camera: CameraData
    width: int
    """Region's size [px]"""
    height: int
    crop: tuple[int, int, int, int] | None = None
    """x, y, width, height [px] of the part to render, from the bottom left; None for all"""
    traced: bool = False
    """Whether the scene has what real-time frames don't know (SceneFacts.traced)"""


def restarts(new: ViewRequest, old: ViewRequest | None) -> bool:
    """Tell whether the samples gathered for `old` are worthless for `new` (more samples of the same view are not)."""
    if old is None or change_since(new.settings, old.settings) != Change.NONE:
        return True
    return (new.camera, new.width, new.height, new.crop) != (old.camera, old.width, old.height, old.crop)


def real_time(request: ViewRequest) -> bool:
    """Tell whether a request is for real-time frames; panoramic cameras have none, nor have some scenes."""
    traced = request.camera.panoramic or request.traced
    return request.settings.sampling.integrator == Integrator.REALTIME and not traced


def step_text(request: ViewRequest, done: int) -> str:
    """Return the status line of a picture."""
    limit, view = request.settings.sampling.viewport_samples, request.settings.debug.view
    text = f"{'Frame' if real_time(request) else 'Sample'} {done}" + (f"/{limit}" if limit > 0 else "")
    return f"{text} | {view}" if real_time(request) and view else text


def divided_crop(crop: tuple[int, int, int, int], divider: int) -> tuple[int, int, int, int]:
    """Return the rendered pixels that cover a crop rectangle of screen pixels (x, y, width, height)."""
    x, y, width, height = crop
    left, bottom = x // divider, y // divider
    return left, bottom, divided_size(x + width, divider) - left, divided_size(y + height, divider) - bottom


def divided_settings(settings: RenderSettings, divider: int) -> RenderSettings:
    """Return the settings of a picture of fewer pixels than the screen: to make up for these would take their time."""
    if divider == 1:
        return settings
    return replace(settings, probes=replace(settings.probes, dense_small=False),
                   denoiser=replace(settings.denoiser, supersample_small=False))


def picture_area(request: ViewRequest, divider: int) -> tuple[float, float, float, float]:
    """Return where a picture lies in the region, as fractions: left, bottom, right, top."""
    if request.crop is None:
        return 0.0, 0.0, 1.0, 1.0
    x, y, width, height = divided_crop(request.crop, divider)
    columns, rows = divided_size(request.width, divider), divided_size(request.height, divider)
    return x / columns, y / rows, (x + width) / columns, (y + height) / rows
