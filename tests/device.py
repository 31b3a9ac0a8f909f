# SPDX-License-Identifier: GPL-3.0-or-later
"""The device that `pytest --device` names: tests launch the kernels there that they launch by themselves."""

from __future__ import annotations

import os

DEVICE = "cpu" if os.environ.get("BURNISH_TEST_DEVICE", "cpu") == "cpu" else "cuda:0"
"""As Warp calls it"""
