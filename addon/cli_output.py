# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps the command line's output clean: what Blender, Warp and libraries print goes aside, ours goes out.

Libraries write to the file descriptors themselves, so those are redirected, not only sys.stdout.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator
from typing import TextIO

__all__ = ["Console", "diverted_output"]


class Console:
    """The process's real standard output and error while everything else is diverted."""

    def __init__(self, out: TextIO, error: TextIO) -> None:
        self.out = out
        self.error = error
        self._tells = error.isatty()
        self._shown = 0

    def print(self, line: str) -> None:
        """Write a line of results; say nothing more where nobody reads any more, as behind `| head`."""
        self.clear()
        try:
            self.out.write(line + "\n")
            self.out.flush()
        except BrokenPipeError:  # what is still in the buffer has to go somewhere, and a render shall end as it would
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.out.fileno())
            os.close(nowhere)
            self.out.flush()

    def progress(self, text: str) -> None:
        """Replace the line of progress on a terminal; elsewhere say nothing."""
        if self._tells:
            width = max(os.get_terminal_size(self.error.fileno()).columns - 1, 20)
            text = text[:width]
            self.error.write("\r" + text.ljust(self._shown))
            self.error.flush()
            self._shown = len(text)

    def clear(self) -> None:
        """Remove the line of progress."""
        if self._shown:
            self.error.write("\r" + " " * self._shown + "\r")
            self.error.flush()
            self._shown = 0


class ProgressLines:
    """Stands in for sys.stdout: shows the render's `Fra:` lines as progress and drops the rest."""

    def __init__(self, console: Console) -> None:
        self.console = console

    def write(self, text: str) -> int:
        """Take a line."""
        if text.startswith("Fra:"):
            self.console.progress(text.strip().partition(" | ")[2])
        return len(text)

    def flush(self) -> None:
        """Do nothing: nothing is buffered."""


@contextlib.contextmanager
def diverted_output(*, show_all: bool) -> Iterator[Console]:
    """Yield the real output while descriptors 1 and 2 lead to a temporary file; `show_all` diverts nothing."""
    if show_all:
        yield Console(sys.stdout, sys.stderr)
        return
    sys.stdout.flush()
    sys.stderr.flush()
    saved = os.dup(1), os.dup(2)
    with (tempfile.TemporaryFile() as aside, os.fdopen(saved[0], "w", encoding="utf-8", closefd=False) as out,
          os.fdopen(saved[1], "w", encoding="utf-8", closefd=False) as error):
        console = Console(out, error)
        os.dup2(aside.fileno(), 1)
        os.dup2(aside.fileno(), 2)
        try:
            with contextlib.redirect_stdout(ProgressLines(console)):
                yield console
        finally:
            console.clear()
            sys.stderr.flush()
            os.dup2(saved[0], 1)
            os.dup2(saved[1], 2)
            for descriptor in saved:
                os.close(descriptor)
