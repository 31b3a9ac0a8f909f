# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels may ask of the host side: collected here and handed to ui.register, which imports none of it."""

from __future__ import annotations

import logging
import platform
import sys
import threading
from typing import Any

import bpy

from ..engine.settings import Device
from . import preferences, report
from .builds import build_kernels
from .manifest import package_version
from .report import error_sentence

__all__ = ["WarmUp", "diagnostics_text", "make_services"]

log = logging.getLogger(__name__)


class WarmUp:
    """Builds all kernels in a thread; the warm-up operator polls it."""

    def __init__(self, device: Device) -> None:
        self.text = "Building kernels"
        self.progress = 0.0
        self.error = ""
        self._thread = threading.Thread(target=self._run, args=(device,), name="burnish warm-up", daemon=True)

    def start(self) -> None:
        """Start building."""
        self._thread.start()

    @property
    def done(self) -> bool:
        """Whether the thread has ended, with or without an error."""
        return not self._thread.is_alive()

    def _run(self, device: Device) -> None:
        try:
            build_kernels(device, self._tell)
            self.text, self.progress = "Kernels are built", 1.0
        except Exception as error:
            self.error = self.text = error_sentence(error)

    def _tell(self, text: str, progress: float) -> None:
        self.text, self.progress = text, progress


def start_warm_up() -> WarmUp:
    """Start building the kernels for the device in the preferences; return what to poll."""
    warm_up = WarmUp(preferences.preferred_device())
    warm_up.start()
    return warm_up


def diagnostics_text() -> str:
    """Return versions and devices as lines to copy into a bug report."""
    lines = [
        f"Burnish: {package_version()}",
        f"Blender: {bpy.app.version_string} ({bpy.app.build_hash.decode(errors='replace')})",
        f"System: {platform.platform()}",
        f"Python: {sys.version.split()[0]}",
        *(f"{name}: {version}" for name, version in library_versions()),
    ]
    try:
        lines += device_lines()
    except Exception as error:
        lines.append(f"Device: {error_sentence(error)}")
    return "\n".join(lines)


def library_versions() -> list[tuple[str, str]]:
    """Return the versions of the libraries that matter, or what went wrong on their import."""
    versions = []
    for label, name in (("NumPy", "numpy"), ("OpenImageIO", "OpenImageIO"), ("Warp", "warp")):
        try:
            module = __import__(name)
            versions.append((label, str(getattr(module, "__version__", None) or module.VERSION_STRING)))
        except Exception as error:
            versions.append((label, f"not usable ({error})"))
    return versions


def device_lines() -> list[str]:
    """Return lines about the compute device, its kernels and the graphics backend."""
    import gpu

    from ..engine.device import choose_device, device_info, kernel_cache_folder

    info = device_info(choose_device(preferences.preferred_device()))
    lines = [f"Device: {info.name} ({info.alias})", f"Kernel cache: {kernel_cache_folder()}"]
    if info.cuda:
        lines.append(f"Device memory: {info.free_memory / 2**30:.1f} of {info.total_memory / 2**30:.1f} GiB free")
        lines.append(f"CUDA driver: {info.driver}")
    if not bpy.app.background:
        lines.append(f"Graphics: {gpu.platform.backend_type_get()}, {gpu.platform.renderer_get()}, "
                     f"{gpu.platform.version_get()}")
    return lines


def make_services() -> Any:
    """Return the ui.services.Services of this add-on."""
    from ..ui.services import Services

    return Services(
        report_entries=report.published_entries,
        report_details=report.published_details,
        report_text=report.published_text,
        diagnostics_text=diagnostics_text,
        start_warm_up=start_warm_up,
    )
