# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions drawn from the world's table and their pdf (kernels/environment_table.py)."""

import numpy as np
import pytest
import warp as wp
from burnish.engine.environment import no_environment, running_sums
from burnish.kernels.environment_table import environment_pdf, sample_environment, texel_of
from burnish.kernels.types import Environment

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

COUNT = 1 << 18


@wp.kernel
def draw(
    # In:
    environment: Environment,
    u: wp.array[wp.vec2],
    # Out:
    directions_out: wp.array[wp.vec3],
    pdf_out: wp.array[wp.vec2],
    texels_out: wp.array[int],
):
    """Draw directions; with the pdf that they are drawn with and the one that rays have which find them."""
    i = wp.tid()
    drawn = sample_environment(environment, u[i])
    directions_out[i] = drawn.direction
    pdf_out[i] = wp.vec2(drawn.pdf, environment_pdf(environment, drawn.direction))
    if environment.width > 0:
        texels_out[i] = texel_of(environment, drawn.direction)


def drawn_from(weights, device):
    """Return directions, both pdfs and texels of COUNT directions drawn from a table; without weights from none."""
    environment = no_environment(device)
    if weights is not None:
        rows, columns = running_sums(weights)
        environment.height, environment.width = weights.shape
        environment.rows = wp.array(rows, dtype=float, device=device)
        environment.columns = wp.array(columns.ravel(), dtype=float, device=device)
    u = np.random.default_rng(4).random((COUNT, 2), np.float32)
    directions, pdf = (wp.zeros(COUNT, dtype=kind, device=device) for kind in (wp.vec3, wp.vec2))
    texels = wp.zeros(COUNT, dtype=int, device=device)
    wp.launch(draw, COUNT, [environment, wp.array(u, dtype=wp.vec2, device=device)], [directions, pdf, texels],
              device=device)
    return directions.numpy().astype(np.float64), pdf.numpy().astype(np.float64), texels.numpy()


def sky(height):
    """Return the weights of a sky whose texels differ by some ten thousand times, none of them 0."""
    rng = np.random.default_rng(5)
    return np.exp(rng.normal(0.0, 1.5, (height, 2 * height))) + 0.01


@pytest.mark.parametrize("height", [2, 64])
def test_the_pdf_of_a_direction_is_that_of_drawing_it(device, height):
    """The mean of 1 / pdf is the whole sphere; rays that find the direction are weighed by the same pdf."""
    directions, pdf, _ = drawn_from(sky(height), device)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-5)
    spread = (1.0 / pdf[:, 0]).std() / COUNT**0.5
    assert abs((1.0 / pdf[:, 0]).mean() - 4.0 * np.pi) < 4.0 * spread < 0.4
    # At a texel's border rounding may put the direction into the next one.
    assert (np.abs(pdf[:, 1] / pdf[:, 0] - 1.0) < 1e-3).mean() > 0.999


def test_texels_are_drawn_as_often_as_their_weights_say(device):
    """Counts of the few texels of a small table, within four standard deviations."""
    weights = sky(4)
    _, _, texels = drawn_from(weights, device)
    expected = (weights / weights.sum()).ravel() * COUNT
    counts = np.bincount(texels, minlength=weights.size)
    # Rows and columns are drawn by sums in float32: u has 24 bits.
    assert (np.abs(counts - expected) < 4.0 * np.sqrt(expected) + 2.0).all()


def test_black_texels_are_never_drawn(device):
    """Nor a row of them; what rays find there has a pdf of 0."""
    weights = sky(8)
    weights[3], weights[:, 5] = 0.0, 0.0
    directions, pdf, texels = drawn_from(weights, device)
    row, column = np.divmod(texels, 16)
    inside = np.abs(pdf[:, 1] / pdf[:, 0] - 1.0) < 1e-3
    assert inside.mean() > 0.999 and not ((row[inside] == 3) | (column[inside] == 5)).any()
    assert (pdf[:, 0] > 0.0).all() and np.isfinite(directions).all()


def test_without_a_table_all_directions_are_alike(device):
    """As for a world of one colour."""
    directions, pdf, _ = drawn_from(None, device)
    np.testing.assert_allclose(pdf, 1.0 / (4.0 * np.pi), rtol=1e-6)
    np.testing.assert_allclose(directions.mean(0), 0.0, atol=0.01)
