# SPDX-License-Identifier: GPL-3.0-or-later
"""Opens engine sessions and builds kernels, one build at a time in the whole process; knows nothing of bpy.

Two threads that load the same Warp module for the first time race; viewports, final renders, previews and the warm-up
operator all build through here.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from ..engine.settings import Device, Integrator, RenderSettings

__all__ = ["build_kernels", "build_rest", "open_session", "telling_builds"]

_lock = threading.Lock()
_text = "Building kernels"

LOCK_POLL_SECONDS = 0.1


def open_session(settings: RenderSettings) -> Any:
    """Return a new engine Session; raises DeviceUnavailable."""
    from ..engine.session import Session

    return Session(settings)


def build_kernels(device: Device, progress: Callable[[str, float], None],
                  should_stop: Callable[[], bool] = lambda: False, integrator: Integrator | None = None) -> None:
    """Build kernel modules for `device`, or wait until another thread has.

    Args:
        device: Where the kernels will run.
        progress: Called with a text ("Building kernels 3/9 (name)") and a fraction; what it raises ends the build
            between two modules.
        should_stop: Ends the waiting for another thread's build when it returns True.
        integrator: Those alone that most of its pictures need, where that is possible; None: all.

    Raises:
        DeviceUnavailable: There is no such device.
        KernelBuildFailed: A module could not be compiled.
    """
    while not _lock.acquire(timeout=LOCK_POLL_SECONDS):
        progress(_text, 0.0)
        if should_stop():
            return
    try:
        _build(device, progress, integrator)
    finally:
        _lock.release()


def build_rest(device: str) -> None:
    """Begin to build what build_kernels has left out for a device (Warp's name), in the background."""
    from ..engine import warmup

    warmup.build_rest(device)


def telling_builds(progress: Callable[[str, float], None]) -> AbstractContextManager[None]:
    """Tell of kernels that are built because the calling thread needs them, within a block."""
    from ..engine.device import hear_of_builds

    return hear_of_builds(lambda name: progress(f"Building kernels ({name})", 0.0))


def _build(device: Device, progress: Callable[[str, float], None], integrator: Integrator | None) -> None:
    from ..engine.device import choose_device
    from ..engine.warmup import warm_up

    def tell(name: str, done: int, count: int) -> None:
        global _text
        _text = f"Building kernels {done}/{count} ({name})"
        progress(_text, done / max(count, 1))

    progress("Building kernels", 0.0)
    warm_up(choose_device(device), tell, integrator)
