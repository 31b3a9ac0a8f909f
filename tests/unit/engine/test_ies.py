# SPDX-License-Identifier: GPL-3.0-or-later
"""IES files: what they say in each direction, and what is said of broken ones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from burnish.engine.ies import IesUnreadable, read_ies


def text(vertical, horizontal, candelas, kind=1, tilt="TILT=NONE", multiplier=2.0, ballast=0.5):
    """Return an IES file."""
    rows = [" ".join(f"{x:g}" for x in values) for values in (vertical, horizontal, *candelas)]
    head = f"1 1000 {multiplier} {len(vertical)} {len(horizontal)} {kind} 2 0.1 0.1 0"
    return "\n".join(["IESNA:LM-63-2002", "[TEST] a file", tilt, head, f"{ballast} 1 50", *rows, ""])


SYMMETRIC = text([0, 30, 60, 90], [0], [[100, 90, 60, 10]])


def test_axis_and_units():
    """Give watts per candela of 4 pi / 177.83 on the file's angles, and nothing beyond them."""
    profile = read_ies(SYMMETRIC)
    found = profile.at(np.zeros(5) + 1.0, np.radians([0.0, 30.0, 60.0, 89.99, 120.0]))
    expected = np.array([100.0, 90.0, 60.0, 10.0, 0.0]) * 4.0 * math.pi / 177.83
    np.testing.assert_allclose(found, expected, rtol=1e-2)


def test_panorama_points_down():
    """Place the file's 0 degrees at the lower end of the picture, that is along -z."""
    picture = read_ies(SYMMETRIC).panorama()
    assert picture.shape[1] == 1 and picture[-1, 0, 0] == pytest.approx(100.0 * 4.0 * math.pi / 177.83, rel=1e-3)
    assert picture[0, 0, 0] == 0.0


@pytest.mark.parametrize("horizontal", [[0, 45, 90], [0, 45, 90, 135, 180], [90, 135, 180, 225, 270]])
def test_symmetries(horizontal):
    """Mirror what a file gives of one quarter or half."""
    values = [[100 + 10 * i] * 2 for i in range(len(horizontal))]
    profile = read_ies(text([0, 180], horizontal, values, multiplier=1.0, ballast=1.0))
    assert profile.horizontal[0] == 0.0 and profile.horizontal[-1] == pytest.approx(2.0 * math.pi)
    np.testing.assert_allclose(profile.watts, profile.watts[::-1])


def test_last_angle_may_be_absent():
    """Close the circle of files that leave out 360 degrees."""
    profile = read_ies(text([0, 90], [0, 90, 180, 270], [[4, 1], [3, 1], [2, 1], [3, 1]]))
    assert len(profile.horizontal) == 5 and (profile.watts[0] == profile.watts[-1]).all()


def test_tilt_is_skipped():
    """Read past the tilt's angles and factors."""
    tilted = SYMMETRIC.replace("TILT=NONE", "TILT=INCLUDE\n1\n2\n0 90\n1 0.8")
    np.testing.assert_array_equal(read_ies(tilted).watts, read_ies(SYMMETRIC).watts)


@pytest.mark.parametrize(("broken", "message"), [
    ("", "no line TILT="), (SYMMETRIC[:-8], "ends before"), (SYMMETRIC.replace("90 60", "ninety 60"), "'ninety'"),
    (text([0, 90], [0], [[1, 1]], kind=3), "type 3"), (text([0, 90], [10, 350], [[1, 1]] * 2), "begin at 0"),
    (text([0, 90], [0, 100], [[1, 1]] * 2), "end before 360"), (text([90, 0], [0], [[1, 1]]), "ascend"),
    (text([0, 90], [0], [[1, 1e999]]), "not finite"),
])
def test_broken_files(broken, message):
    """Say what is wrong with a file."""
    with pytest.raises(IesUnreadable, match=message):
        read_ies(broken)
