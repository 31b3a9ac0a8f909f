# SPDX-License-Identifier: GPL-3.0-or-later
"""Preview pictures of materials, worlds and lamps: few samples, little time, and none for icons."""

from __future__ import annotations

import dataclasses
import logging
from typing import Any

from ..engine.settings import Integrator, RenderSettings

__all__ = ["ICON_SIZE_MAX", "render", "with_preview_budget"]

log = logging.getLogger(__name__)

ICON_SIZE_MAX = 96
"""Pictures below this size [px] are icons in lists: not worth a scene upload each."""
PREVIEW_SAMPLES = 32
PREVIEW_SECONDS = 2.0


def with_preview_budget(settings: RenderSettings) -> RenderSettings:
    """Return the settings of a preview: path traced, since it is all about reflections."""
    sampling = dataclasses.replace(settings.sampling, integrator=Integrator.REFERENCE, samples=PREVIEW_SAMPLES,
                                   time_limit=PREVIEW_SECONDS)
    return dataclasses.replace(settings, sampling=sampling)


def render(engine: Any, depsgraph: Any) -> None:
    """Render a preview; a failure is logged, since an icon is no place for a message."""
    from . import final
    from .extract.scene import ExtractionCancelled, SceneExtractor
    from .progress import Cancelled

    if min(engine.resolution_x, engine.resolution_y) < ICON_SIZE_MAX:
        return
    try:
        job = final.FinalRender(engine, depsgraph, overrides=with_preview_budget)
        final.build_kernels(job.settings.device, job.progress.stage, should_stop=engine.test_break,
                            integrator=job.settings.sampling.integrator)
        session = final.open_session(job.settings)
        try:
            job.run(session, SceneExtractor(), depsgraph)
        finally:
            session.close()
    except (Cancelled, ExtractionCancelled):
        log.debug("Preview cancelled")
    except Exception:
        log.exception("The preview could not be rendered")
