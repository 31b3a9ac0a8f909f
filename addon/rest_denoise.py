# SPDX-License-Identifier: GPL-3.0-or-later
"""When a viewport at rest is denoised: once there are some path-traced samples, and then for a share of the time.

From then on only denoised pictures are shown: noise would flicker between them. Used by the worker's thread alone.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from ..engine.errors import BurnishError
from .view_request import ViewRequest, real_time

__all__ = ["FIRST_SAMPLES", "RestDenoiser"]

log = logging.getLogger(__name__)

FIRST_SAMPLES = 8
"""Path-traced samples of the first denoised picture: those of the first turn (engine/passes/rest.py)"""
SHARE = 0.2
"""Largest share of the time that goes into it"""


class RestDenoiser:
    """Knows what the newest denoised picture of a view was made of, and what it cost."""

    def __init__(self, library: Any = None) -> None:
        """Take Open Image Denoise's library; None: nothing is denoised."""
        self._library = library
        self._samples = 0
        self._ended = self._cost = 0.0

    def takes_over(self, request: ViewRequest, session: Any) -> bool:
        """Return whether a view's pictures are denoised from now on."""
        wanted = request.settings.sampling.viewport_denoise and real_time(request) and not request.settings.debug.view
        if self._library is None or not wanted:
            # Another picture is shown meanwhile.
            self._samples = 0
            return False
        samples = session.traced_samples
        if samples < self._samples:
            self._samples = 0
        return samples >= FIRST_SAMPLES

    def picture(self, session: Any, should_stop: Callable[[], bool], *, last: bool) -> Any:
        """Return a denoised picture on the device, vec4 [h * w]; None where none is due or it was told to stop.

        Args:
            session: takes_over() holds for it.
            should_stop: Polled often on a processor.
            last: Whether there will be no more samples.
        """
        samples, start = session.traced_samples, time.perf_counter()
        if samples == self._samples:
            return None
        if self._samples and not last and start - self._ended < self._cost / SHARE:
            return None
        try:
            picture = session.resolve_denoised(self._library, should_stop)
        except BurnishError as error:
            # The picture is right without: it must not end the viewport.
            log.warning("%s The viewport is not denoised any more.", error)
            self._library = None
            return None
        if picture is not None:
            self._samples, self._ended = samples, time.perf_counter()
            self._cost = self._ended - start
        return picture
