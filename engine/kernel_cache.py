# SPDX-License-Identifier: GPL-3.0-or-later
"""Where built kernels are kept: the chosen folder, unless the environment names one. Loads no Warp."""

from __future__ import annotations

import logging
import os
import tempfile

__all__ = ["CACHE_VARIABLE", "chosen_folder", "set_cache_folder"]

log = logging.getLogger(__name__)

CACHE_VARIABLE = "WARP_CACHE_PATH"
"""Environment variable from which Warp takes its kernel cache; set by a user or a render farm, it wins."""

_folder = ""


def set_cache_folder(folder: str) -> None:
    """Choose the folder that Warp keeps built kernels in from its next start; empty: the user's cache folder."""
    global _folder
    _folder = folder


def chosen_folder() -> str | None:
    """Return the folder to tell Warp, or None to leave the choice to it.

    A folder that can't be written to is passed over with a warning: rendering is worth more than the cache's place.
    """
    if not _folder or os.environ.get(CACHE_VARIABLE):
        return None
    try:
        os.makedirs(_folder, exist_ok=True)
        with tempfile.TemporaryFile(dir=_folder):
            return _folder
    except OSError as error:
        log.warning("Kernels can't be kept in '%s' (%s); they go to the user's cache folder.", _folder, error)
        return None
