# SPDX-License-Identifier: GPL-3.0-or-later
"""Failures that a user can act on: each carries a sentence and, where there is one, the remedy.

Programmer errors are assertions; bad input or a bad machine is a BurnishError; what is expected and
recovered from (a missing texture, a NaN vertex) is an entry in a Report (report.py).
"""

from __future__ import annotations

__all__ = ["BurnishError", "DeviceUnavailable", "InvalidScene", "KernelBuildFailed", "OutOfDeviceMemory"]


class BurnishError(Exception):
    """A failure told to the user as one sentence: what happened, to what, and what to do."""


class DeviceUnavailable(BurnishError):
    """The requested compute device does not exist or can't be used."""


class OutOfDeviceMemory(BurnishError):
    """The scene, its textures or the frame buffers don't fit the device's memory."""


class KernelBuildFailed(BurnishError):
    """A kernel module could not be compiled or loaded."""


class InvalidScene(BurnishError):
    """The scene can't be rendered as it is (no camera, an impossible size, ...)."""
