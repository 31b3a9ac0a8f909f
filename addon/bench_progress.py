# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark's progress with the time left, and its way of stopping when it is interrupted. Knows no bpy."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from types import FrameType
from typing import Any

from .cli_output import Console
from .progress import format_duration

__all__ = ["Interruption", "Progress"]

BAR = 24
"""Width of the bar [characters]"""
GRACE = 3.0
"""Seconds that a second interruption waits for the picture being rendered"""


class Progress:
    """Tells which picture is being rendered and how long all that are left will take."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.total = self.done = 0.0
        self.count = self.index = 0
        self.start = time.perf_counter()

    def expect(self, weights: list[float]) -> None:
        """Take in the rough costs of pictures that will be rendered."""
        self.total += sum(weights)
        self.count += len(weights)

    def begin(self, text: str) -> None:
        """Say what is rendered now."""
        self.index += 1
        share = self.done / self.total if self.total > 0.0 else 0.0
        elapsed = time.perf_counter() - self.start
        left = f", about {format_duration(elapsed * (1.0 / share - 1.0))} left" if share > 0.0 else ""
        self.console.print(f"[{self.index}/{self.count}] {text}{left}")
        bar = "#" * round(BAR * share)
        self.console.progress(f"[{bar:<{BAR}}] {100.0 * share:.0f} %{left}")

    def end(self, weight: float) -> None:
        """Count a picture's cost as spent."""
        self.done += weight


class Interruption:
    """While this is entered, Ctrl-C asks for an end after the picture being rendered; a second one ends at once.

    Blender's render operator never looks at Python's signals, so a thread reads them: it tells, and ends the process
    at the second. What is complete is on the disk then.
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self.requested = False
        self._count = 0

    def __enter__(self) -> Interruption:
        self._active = threading.current_thread() is threading.main_thread()
        if self._active:
            self._reader, self._writer = socket.socketpair()
            self._writer.setblocking(False)
            self._old_descriptor = signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
            self._old_handler = signal.signal(signal.SIGINT, self._handle)
            threading.Thread(target=self._listen, daemon=True).start()
        return self

    def __exit__(self, *_: Any) -> None:
        if self._active:
            signal.signal(signal.SIGINT, self._old_handler)
            signal.set_wakeup_fd(self._old_descriptor)
            self._writer.close()

    def check(self) -> None:
        """Raise KeyboardInterrupt if the user has asked for an end."""
        if self.requested:
            raise KeyboardInterrupt

    def stopped(self) -> bool:
        """Tell whether the user has asked for an end."""
        return self.requested

    def _handle(self, number: int, frame: FrameType | None) -> None:
        """Stand in for Python's handler; the thread does the work."""

    def _listen(self) -> None:
        while data := self._reader.recv(1):
            if data[0] != signal.SIGINT:
                continue
            self._count += 1
            self.requested = True
            if self._count == 1:
                self.console.print("Interrupted: the picture being rendered is the last one; once more ends at once")
                continue
            time.sleep(GRACE)
            os._exit(130)
        self._reader.close()
