# SPDX-License-Identifier: GPL-3.0-or-later
"""What colour light has whose paths differ by a length: the spectral sensitivities that thin films need.

Belcour and Barla 2017, "A Practical Extension to Microfacet Theory for the Modeling of Varying Iridescence", section 4:
the mean of cos(2 pi m D / wavelength) over a channel's sensitivity is the sensitivity's Fourier transform at m D. It is
tabulated at the places of Cycles' table (scene/shader.cpp, ShaderManager::compute_thin_film_table), because its
pictures include the error of interpolating between these.
"""

from __future__ import annotations

import math

import numpy as np

from ..kernels.thin_film import FILM_NODES, FILM_STEP

__all__ = ["Matrix", "film_rows"]

Matrix = tuple[tuple[float, float, float], ...]

WAVELENGTHS = np.arange(380.0, 781.0, 10.0)
"""[nm]"""

COLOR_MATCHING = np.array("""
    1368 39 6450  4243 120 20050  14310 396 67850  43510 1210 207400  134380 4000 645600  283900 11600 1385600
    348280 23000 1747060  336200 38000 1772110  290800 60000 1669200  195360 90980 1287640  95640 139020 812950
    32010 208020 465180  4900 323000 272000  9300 503000 158200  63270 710000 78250  165500 862000 42160
    290400 954000 20300  433450 994950 8750  594500 995000 3900  762100 952000 2100  916300 870000 1650
    1026300 757000 1100  1062200 631000 800  1002600 503000 340  854450 381000 190  642400 265000 50
    447900 175000 20  283500 107000 0  164900 61000 0  87400 32000 0  46770 17000 0  22700 8210 0  11359 4102 0
    5790 2091 0  2899 1047 0  1440 520 0  690 249 0  332 120 0  166 60 0  83 30 0  42 15 0
    """.split(), np.float64).reshape(-1, 3) * 1e-6
"""CIE 1931 2-degree standard observer at WAVELENGTHS (CIE 018:2019, table 6)"""


def film_rows(from_xyz: Matrix) -> np.ndarray:
    """Return real and imaginary parts for differences of 0, 1, 2, ... FILM_STEP: float32 [2 FILM_NODES, 4].

    Args:
        from_xyz: From CIE XYZ to the scene's linear RGB.
    """
    sensitivity = COLOR_MATCHING @ np.asarray(from_xyz, np.float64).T
    sensitivity /= sensitivity.sum(0)
    difference = np.arange(int(FILM_NODES)) * float(FILM_STEP)
    # The sum of so few wavelengths is exact: between them both factors are smooth, up to the last difference.
    phase = 2.0 * math.pi * difference[:, None] / WAVELENGTHS
    rows = np.zeros((len(difference), 2, 4), np.float32)
    rows[:, 0, :3], rows[:, 1, :3] = np.cos(phase) @ sensitivity, np.sin(phase) @ sensitivity
    return rows.reshape(-1, 4)
