# SPDX-License-Identifier: GPL-3.0-or-later
"""Fits the coefficients of the Hosek and Wilkie sky (engine/sky/hosek.txt) to pictures that Cycles draws.

    python tests/fit_hosek.py engine/sky/hosek.txt

Cycles draws one patch for each turbidity (in half steps), albedo (0, 0.5, 1) and elevation of the sun; a patch's
columns are zenith angles from 0 to pi, its rows azimuths from the sun's. The model's structure is known: A, B, E and H
are quintic Bezier curves over the cube root of the elevation, linear in turbidity and albedo between their knots; the
five coefficients by which the radiance is linear are products of two such functions. So at each knot the curves are
found by Levenberg and Marquardt's method over all elevations at once, the linear coefficients, polynomials of twice the
degree, by least squares inside it (variable projection: Golub and Pereyra 1973). Knots are then started again from
their neighbours until the half steps between them fit too. Takes some minutes on one core.

Fits start from the curves that the file holds, where there is one. Without it some knots end in other minima, of errors
ten times as large, which don't meet between the knots: fit the places above the horizon first then.
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.engine.sky.hosek import DEGREE, PLACES, bezier, curve_places, lagrange, read_tables, terms  # noqa: E402
from burnish.engine.sky.image import TO_REC709  # noqa: E402
from burnish.engine.sky.preetham import LOWEST  # noqa: E402

SIZE = 28
"""Pixels a side of a patch"""

TURBIDITIES, ALBEDOS = np.arange(1.0, 10.01, 0.5), (0.0, 0.5, 1.0)
CURVE = 0.5 - 0.5 * np.cos(np.pi * np.arange(21) / 20)
"""Places on the curves of the elevations that are drawn"""

STARTS = ((-1.1, -0.3, -3.0, 0.6), (-1.1, -0.2, -1.0, 0.5), (-1.05, -0.3, -6.0, 0.8), (-1.2, -0.5, 0.5, 0.4))
"""A, B, E, H from which the first fits start, the same at all elevations"""

GOOD = 1e-4
"""Root mean square of relative errors from which on a fit is good"""

FLOOR = 0.2
"""Share of a patch's mean below which errors count as absolute"""


def draw(configurations: list[tuple[float, float, float]]) -> np.ndarray:
    """Return what Cycles draws of skies by turbidity, albedo and place on the curve: [N, azimuths, zeniths, RGB]."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    columns = math.ceil(math.sqrt(len(configurations)))
    rows = -(-len(configurations) // columns)
    scene.render.engine, scene.cycles.samples, scene.cycles.max_bounces = 'CYCLES', 1, 0
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = 'BOX', 0.01
    scene.render.resolution_x, scene.render.resolution_y = columns * SIZE, rows * SIZE
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = 'OPEN_EXR', '32'
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = 'ORTHO', max(columns, rows)
    camera.location = (0.5 * columns, 0.5 * rows, 5.0)
    mesh = bpy.data.meshes.new("Patches")
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    places = [corners + (i % columns, i // columns, 0) for i in range(len(configurations))]
    mesh.from_pydata(np.concatenate(places).tolist(), [], np.arange(4 * len(places)).reshape(-1, 4).tolist())
    mesh.uv_layers.new().uv.foreach_set("vector", np.tile(corners[:, :2].ravel(), len(places)).astype(np.float32))
    for polygon, configuration in zip(mesh.polygons, configurations, strict=True):
        polygon.material_index = len(mesh.materials)
        mesh.materials.append(sky_material(*configuration))
    for item in (camera, bpy.data.objects.new("Patches", mesh)):
        scene.collection.objects.link(item)
    scene.camera = camera
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder, "patches.exr"))
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        image.colorspace_settings.name = 'Non-Color'
        pixels = np.array(image.pixels[:], np.float64).reshape(rows, SIZE, columns, SIZE, 4)[..., :3]
    return pixels.swapaxes(1, 2).reshape(-1, SIZE, SIZE, 3)[: len(configurations)]


def sky_material(turbidity: float, albedo: float, place: float):
    """Return a material that shows a sky over the UV map: u the zenith angle, v the azimuth from the sun, over pi."""
    import bpy

    made = bpy.data.materials.new("Sky")
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    output, emission, sky, uv, split, join = (tree.nodes.new("ShaderNode" + kind) for kind in (
        "OutputMaterial", "Emission", "TexSky", "TexCoord", "SeparateXYZ", "CombineXYZ"))
    tree.links.new(uv.outputs["UV"], split.inputs[0])
    for source, operation, target in ((1, 'COSINE', 0), (1, 'SINE', 1), (0, 'COSINE', 2)):
        # Cycles takes z for the cosine of the zenith angle, and x and y for the azimuth alone.
        times, function = tree.nodes.new("ShaderNodeMath"), tree.nodes.new("ShaderNodeMath")
        times.operation, function.operation = 'MULTIPLY', operation
        times.inputs[1].default_value = math.pi
        tree.links.new(split.outputs[source], times.inputs[0])
        tree.links.new(times.outputs[0], function.inputs[0])
        tree.links.new(function.outputs[0], join.inputs[target])
    tree.links.new(join.outputs[0], sky.inputs[0])
    tree.links.new(sky.outputs[0], emission.inputs[0])
    tree.links.new(emission.outputs[0], output.inputs[0])
    elevation = 0.5 * math.pi * place**3
    sky.sky_type, sky.turbidity, sky.ground_albedo = 'HOSEK_WILKIE', turbidity, albedo
    sky.sun_direction = (math.cos(elevation), 0.0, math.sin(elevation))
    return made


class Fit:
    """All measurements, and fits of one knot and channel after the other."""

    def __init__(self, drawn: np.ndarray) -> None:
        """Take XYZ and weights [turbidities, albedos, places, pixels, 3] of what was drawn."""
        seen = (drawn > 0.0).all(-1)
        self.values = drawn @ np.linalg.inv(np.asarray(TO_REC709)).T
        mean = self.values.mean(3, keepdims=True)
        self.weights = seen[..., None] / (np.abs(self.values) + FLOOR * mean)
        angles = (np.arange(SIZE) + 0.5) / SIZE * np.pi
        zenith, azimuth, elevation = angles[None, None], angles[None, :, None], (0.5 * np.pi * CURVE**3)[:, None, None]
        cosine = np.sin(zenith) * np.cos(elevation) * np.cos(azimuth) + np.cos(zenith) * np.sin(elevation)
        self.angle = np.arccos(np.clip(cosine, -1.0, 1.0)).reshape(len(CURVE), -1)
        self.zenith = np.broadcast_to(np.minimum(zenith, LOWEST), cosine.shape).reshape(len(CURVE), -1)
        self.bezier = bezier(CURVE)
        self.polynomial = np.stack([lagrange(curve_places(), x) for x in CURVE])
        self.overlaps = np.einsum("ka,kb->kab", self.polynomial, self.polynomial)

    def project(self, shape: np.ndarray, t: int, a: int, c: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the weighted errors and the best linear coefficients [PLACES, 5] for control points of A, B, E, H."""
        weights = self.weights[t, a, ..., c]
        basis = terms((self.bezier @ shape)[:, None, :], self.zenith, self.angle) * weights[..., None]
        size = np.sqrt((basis**2).mean((0, 1)))
        basis, wanted = basis / size, self.values[t, a, ..., c] * weights
        square = np.einsum("kpi,kpj->kij", basis, basis)
        count = PLACES * basis.shape[-1]
        left = np.einsum("kab,kij->aibj", self.overlaps, square).reshape(count, count)
        right = np.einsum("ka,kpi,kp->ai", self.polynomial, basis, wanted, optimize=True).reshape(count)
        ridge = 1e-11 * np.trace(left) / count
        found = np.linalg.solve(left + ridge * np.eye(count), right).reshape(PLACES, -1)
        return np.einsum("kpi,ki->kp", basis, self.polynomial @ found) - wanted, found / size

    def error(self, shape: np.ndarray, t: int, a: int, c: int) -> float:
        """Return the root mean square of the weighted errors."""
        errors, _ = self.project(shape, t, a, c)
        return math.sqrt((errors**2).sum() / (self.weights[t, a, ..., c] > 0.0).sum())

    def improve(self, shape: np.ndarray, t: int, a: int, c: int, steps: int = 40) -> tuple[np.ndarray, float]:
        """Return better control points and their error, by Levenberg and Marquardt's method."""
        errors, _ = self.project(shape, t, a, c)
        cost, damping = (errors**2).sum(), 1e-3
        for _ in range(steps):
            slope = np.empty((errors.size, shape.size))
            for i in range(shape.size):
                moved = shape.copy()
                moved.flat[i] += (step := 1e-5 * max(1.0, abs(moved.flat[i])))
                slope[:, i] = ((self.project(moved, t, a, c)[0] - errors) / step).ravel()
            square, before = slope.T @ slope, cost
            for _ in range(8):
                change = np.linalg.solve(
                    square + damping * np.diag(square.diagonal() + 1e-12), -slope.T @ errors.ravel())
                moved = shape + change.reshape(shape.shape)
                # H = 1 is a pole.
                if (np.abs((self.bezier @ moved)[:, 3]) < 0.999).all():
                    tried, _ = self.project(moved, t, a, c)
                    if (tried**2).sum() < cost:
                        shape, errors, cost, damping = moved, tried, (tried**2).sum(), max(damping / 8.0, 1e-14)
                        break
                damping *= 4.0
            if cost > 0.99 * before:
                break
        return shape, self.error(shape, t, a, c)


def fit_knots(fit: Fit, known: np.ndarray | None) -> np.ndarray:
    """Return the control points at all knots, [10 turbidities, 2 albedos, 3 of XYZ, DEGREE + 1, 4]; start from some."""
    shapes = np.zeros((10, 2, 3, DEGREE + 1, 4))
    flat = [np.tile(start, (DEGREE + 1, 1)) for start in STARTS]
    for c in range(3):
        for a in range(2):
            for t in range(10):
                best = math.inf
                first = [] if known is None else [known[t, a, c]]
                for start in [*first, *shapes[t - 1 : t, a, c], *shapes[t, :a, c], *flat]:
                    shape, error = fit.improve(start, 2 * t, 2 * a, c)
                    if error < best:
                        shapes[t, a, c], best = shape, error
                    if best < GOOD:
                        break
                print(f"channel {c} albedo {a} turbidity {t + 1}: {best:.1e}", flush=True)
    return shapes


def smooth_knots(fit: Fit, shapes: np.ndarray) -> None:
    """Start knots again from their neighbours where the half steps beside them don't fit."""

    def around(shape: np.ndarray, t: int, a: int, c: int) -> float:
        steps = [fit.error(0.5 * (shape + shapes[n, a, c]), t + n, 2 * a, c) for n in (t - 1, t + 1) if 0 <= n < 10]
        return fit.error(shape, 2 * t, 2 * a, c) + sum(steps) + fit.error(
            0.5 * (shape + shapes[t, 1 - a, c]), 2 * t, 1, c)

    for _ in range(2):
        for t, a, c in np.ndindex(shapes.shape[:3]):
            best = around(shapes[t, a, c], t, a, c)
            if best < 6.0 * GOOD:
                continue
            near = [shapes[n, a, c] for n in (t - 1, t + 1) if 0 <= n < 10]
            for start in [*near, shapes[t, 1 - a, c], np.mean(near, 0)]:
                shape, _ = fit.improve(start, 2 * t, 2 * a, c)
                if (found := around(shape, t, a, c)) < best:
                    shapes[t, a, c], best = shape, found


def write_tables(path: Path, shapes: np.ndarray, weights: np.ndarray) -> None:
    """Write what hosek.read_tables reads."""
    lines = ["# SPDX-License-Identifier: GPL-3.0-or-later", "# Made by tests/fit_hosek.py; see hosek.py.",
             "# Control points: A B E H by turbidity, albedo, XYZ and place on the curve"]
    for heading, array in (("", shapes), ("# Products, by the same in half steps", weights)):
        lines += [heading] if heading else []
        lines += [" ".join(f"{value:.7g}" for value in row) for row in array.reshape(-1, array.shape[-1])]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    """Draw, fit and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", type=Path)
    output = parser.parse_args().output
    grid = [(t, a, x) for t in TURBIDITIES for a in ALBEDOS for x in CURVE]
    drawn = np.concatenate([draw(grid[i : i + 210]) for i in range(0, len(grid), 210)])
    fit = Fit(drawn.reshape(len(TURBIDITIES), len(ALBEDOS), len(CURVE), SIZE * SIZE, 3))
    known = None
    if output.exists():
        known, _ = read_tables(output)
    shapes = fit_knots(fit, known)
    smooth_knots(fit, shapes)
    weights, worst = np.zeros((len(TURBIDITIES), len(ALBEDOS), 3, PLACES, 5)), 0.0
    for t, a, c in np.ndindex(weights.shape[:3]):
        # Linear between the knots.
        low = shapes[t // 2, :, c] * (1.0 - 0.5 * (t % 2)) + shapes[min(t // 2 + t % 2, 9), :, c] * (0.5 * (t % 2))
        shape = low[0] * (1.0 - 0.5 * a) + low[1] * (0.5 * a)
        worst = max(worst, fit.error(shape, t, a, c))
        weights[t, a, c] = fit.project(shape, t, a, c)[1]
    write_tables(output, shapes, weights)
    print(f"largest error {worst:.1e}, written to {output}")


if __name__ == "__main__":
    main()
