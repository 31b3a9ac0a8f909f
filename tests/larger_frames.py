# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of twice the picture's size on any device (engine/supersampling.py), as small pictures on a GPU have them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from burnish.engine import supersampling
from burnish.engine.supersampling import Supersampling


def draw_larger(replace: Callable[[Any, str, Any], None] = setattr) -> None:
    """Draw small pictures as on a GPU; `replace` sets an attribute, as monkeypatch.setattr does for a while."""
    configure = Supersampling.configure

    def on_gpu(self: Supersampling, *arguments: Any) -> None:
        self.device, device = "cuda:0", self.device
        configure(self, *arguments)
        self.device = device

    replace(Supersampling, "configure", on_gpu)
    replace(supersampling, "is_small", lambda width, height: True)
