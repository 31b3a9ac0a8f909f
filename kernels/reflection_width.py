# SPDX-License-Identifier: GPL-3.0-or-later
"""How wide the filters of reflections stay at rest: ever narrower, as the mean over frames takes their place."""

from __future__ import annotations

import warp as wp

from .view import View

# Fast: weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Frames at rest from which on the filters shrink, inversely to the frames.
REST_START = wp.constant(12.0)


@wp.func
def filter_reach(view: View) -> float:
    """Return by how much filters are narrower: 1 in motion, falling to nearly 0 at rest.

    As in progressive density estimation (Hachisuka et al. 2008) width and noise of the mean both vanish. All pixels
    shrink alike: were filters to stay wide where a pixel's own mean is noisy, those that had met a bright sample would
    take their neighbours' darkness, and those that had not would keep it; light of what is small would be lost.
    """
    rest = float(wp.min(view.rest, view.light_age))
    return REST_START / wp.max(rest, REST_START)
