# SPDX-License-Identifier: GPL-3.0-or-later
"""Test of the debug views' colours."""

from __future__ import annotations

import numpy as np
import warp as wp
from burnish.kernels import debug_colors


@wp.kernel
def draw_colors(x: wp.array[float], heat_out: wp.array[wp.vec3], signed_out: wp.array[wp.vec3],
                hash_out: wp.array[wp.vec3]):
    """Evaluate all colours of debug views."""
    i = wp.tid()
    heat_out[i] = debug_colors.heat(x[i])
    signed_out[i] = debug_colors.signed_color(x[i])
    hash_out[i] = debug_colors.hash_color(i - 1)


def test_debug_colors_tell_numbers_apart(device):
    """Make larger numbers lighter, signs red and blue, and identities different, all within 0..1."""
    x = np.concatenate([np.linspace(-2.0, 2.0, 998), [np.nan, np.inf]]).astype(np.float32)
    out = [wp.zeros(1000, dtype=wp.vec3, device=device) for _ in range(3)]
    wp.launch(draw_colors, 1000, [wp.array(x, dtype=float, device=device)], out, device=device)
    heat, signed, hashed = (a.numpy() for a in out)
    for colors in (heat, signed, hashed):
        assert np.isfinite(colors).all() and colors.min() >= 0.0 and colors.max() <= 1.0
    luminance = heat[:998] @ np.array([0.2126, 0.7152, 0.0722])
    inside = (x[:998] >= 0.0) & (x[:998] <= 1.0)
    assert (np.diff(luminance[inside]) > 0.0).all() and (heat[998] == 0.0).all() and (heat[999] == 1.0).all()
    assert signed[0, 2] > signed[0, 0] and signed[997, 0] > signed[997, 2]
    assert (hashed[0] == 0.0).all() and len(np.unique(hashed[1:].round(3), axis=0)) > 980
