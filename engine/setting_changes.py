# SPDX-License-Identifier: GPL-3.0-or-later
"""What an edit of the settings asks of a session that runs with the old ones."""

from __future__ import annotations

import enum

from .settings import FRAME_GROUPS, RenderSettings

__all__ = ["Change", "change_since"]


class Change(enum.IntFlag):
    """What a new RenderSettings asks of a running session."""

    NONE = 0
    RESTART = 1
    """The accumulated samples are no longer valid."""
    RESIZE = 2
    """Frame buffers must be reallocated (implies RESTART)."""
    DEVICE = 4
    """Everything must move to another device."""


def change_since(new: RenderSettings, old: RenderSettings | None) -> Change:
    """Return what `new` asks of a session that ran with `old`; the one place that knows which edits restart."""
    if old is None or new.device != old.device:
        return Change.DEVICE | Change.RESIZE | Change.RESTART
    performance = ("texture_budget", "texture_size_limit", "opacity_maps", "deterministic")
    same = (all(getattr(new, name) == getattr(old, name) for name in FRAME_GROUPS)
            and all(getattr(new.performance, name) == getattr(old.performance, name) for name in performance)
            and (new.sampling.seed, new.sampling.integrator) == (old.sampling.seed, old.sampling.integrator))
    return Change.NONE if same else Change.RESTART
