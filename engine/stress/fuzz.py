# SPDX-License-Identifier: GPL-3.0-or-later
"""Random scenes. Where Hypothesis is installed it draws them, and shrinks one that fails to the least that fails."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from ..errors import BurnishError
from ..media import MediumData, PhaseData
from ..program import ProgramBuilder
from ..scene import CameraData, CameraKind, LightData, LightKind, MaterialData, MeshData, Visibility
from ..volume_program import FieldData, VaryingData, VolumeBuilder
from .cases import BOTH, Case, Trial
from .scenes import Placed, StressScene, box, lamp, look_at, make_mesh, make_scene, material, principled, quad, sphere

__all__ = ["CASES", "BadPicture", "Chooser", "DrawnChooser", "SeededChooser", "random_scene", "try_scene"]

SIZES = ((9, 7), (16, 8), (1, 1), (5, 3))
EXAMPLES = {"quick": 12, "full": 150}
SPECIAL = (0.0, 1.0, -1.0, 1e-42, 1e-12, 1e12, 3.4e38, math.inf, -math.inf, math.nan)
"""Values that one in eight numbers has"""
CLOSURES = (
    "DIFFUSE", "GLOSSY", "GLASS", "REFRACTION", "TRANSLUCENT", "SHEEN", "TOON_DIFFUSE", "TOON_GLOSSY")
ARGUMENTS = {
    "roughness": 0.5, "metallic": 1.0, "ior": 3.0, "transmission": 1.0, "coat": 1.0, "coat_roughness": 0.5,
    "sheen": 1.0, "anisotropic": 1.0, "specular_level": 1.0, "subsurface": 1.0, "diffuse_roughness": 1.0,
    "sheen_roughness": 1.0, "sheen_tint": 1.0, "coat_ior": 3.0, "coat_tint": 1.0, "specular_tint": 1.0,
    "anisotropic_rotation": 1.0, "thin_wall": 1.0, "film_thickness": 1000.0, "subsurface_radius": 1.0}
"""Arguments of the Principled BSDF and what random ones reach up to"""
METHODS = ("WALK", "SKIN", "LEGACY")
VECTORS = ("normal", "coat_normal", "tangent")


class BadPicture(AssertionError):
    """A random scene gave a picture with bad pixels, or raised something that is no sentence."""


class Chooser(Protocol):
    """What draws the parts of a scene."""

    def number(self, low: float, high: float) -> float:
        """Return a number between two bounds."""

    def whole(self, low: int, high: int) -> int:
        """Return a whole number between two bounds, both included."""

    def pick(self, options: Sequence[Any]) -> Any:
        """Return one of several."""


class SeededChooser:
    """Draws by a seed."""

    def __init__(self, seed: int):
        self._rng = np.random.default_rng(seed)

    def number(self, low: float, high: float) -> float:
        """Return a number between two bounds."""
        return float(self._rng.uniform(low, high))

    def whole(self, low: int, high: int) -> int:
        """Return a whole number between two bounds, both included."""
        return int(self._rng.integers(low, high + 1))

    def pick(self, options: Sequence[Any]) -> Any:
        """Return one of several."""
        return options[self.whole(0, len(options) - 1)]


class DrawnChooser:
    """Draws through Hypothesis (`draw` of its `data` strategy), which shrinks towards the first and the smallest."""

    def __init__(self, draw: Callable[[Any], Any], strategies: Any):
        self._draw, self._strategies = draw, strategies

    def number(self, low: float, high: float) -> float:
        """Return a number between two bounds."""
        return self._draw(self._strategies.floats(low, high))

    def whole(self, low: int, high: int) -> int:
        """Return a whole number between two bounds, both included."""
        return self._draw(self._strategies.integers(low, high))

    def pick(self, options: Sequence[Any]) -> Any:
        """Return one of several."""
        return self._draw(self._strategies.sampled_from(options))


def value(choose: Chooser, low: float, high: float) -> float:
    """Return a number between two bounds, now and then a special one."""
    return choose.pick(SPECIAL) if choose.whole(0, 7) == 7 else choose.number(low, high)


def random_mesh(choose: Chooser) -> MeshData:
    """Return a mesh, perhaps with a broken number in it."""
    kind = choose.pick(("quad", "ball", "box", "inward box", "triangles"))
    if kind == "triangles":
        count = choose.whole(1, 6)
        made = make_mesh([[value(choose, -1, 1) for _ in range(3)] for _ in range(3 * count)], np.arange(3 * count))
    else:
        made = {"quad": lambda: quad(1.0, 2), "ball": lambda: sphere(0.7, 6), "box": lambda: box((-1,) * 3, (1,) * 3),
                "inward box": lambda: box((-1,) * 3, (1,) * 3, inward=True)}[kind]()
    name = choose.pick(("", "", "positions", "corner_normals"))
    if name:
        array = getattr(made, name).copy()
        array.reshape(-1)[choose.whole(0, array.size - 1)] = choose.pick(SPECIAL)
        made = replace(made, **{name: array})
    return made


def random_material(choose: Chooser) -> MaterialData:
    """Return a material of one closure, perhaps shining."""
    emission = abs(value(choose, 0, 5)) if choose.whole(0, 3) == 3 else 0.0
    color = tuple(value(choose, 0, 1) for _ in range(3))
    if choose.whole(0, 2) < 2:
        names = [choose.pick(list(ARGUMENTS)) for _ in range(choose.whole(0, 4))]
        chosen: dict[str, Any] = {name: value(choose, 0.0, ARGUMENTS[name]) for name in names}
        if "film_thickness" in chosen:
            chosen["film_ior"] = value(choose, 1.0, 3.0)
        if "subsurface_radius" in chosen:
            chosen |= {"subsurface": value(choose, 0, 1), "subsurface_anisotropy": value(choose, -1, 1),
                       "subsurface_ior": value(choose, 1, 2), "subsurface_method": choose.pick(METHODS)}
        if choose.whole(0, 3) == 3:
            chosen[choose.pick(VECTORS)] = tuple(value(choose, -1, 1) for _ in range(3))
        if choose.whole(0, 3) == 3:
            chosen["tangent"] = (0.0, 0.0, 1.0)
        return principled(1.0, emission, color=color, **chosen)
    film = {}
    if choose.whole(0, 3) == 3:
        film = {"film_thickness": value(choose, 0, 1000), "film_ior": value(choose, 1, 3)}
    return material(choose.pick(CLOSURES), 1.0, emission, color=color, roughness=value(choose, 0, 1),
                    ior=value(choose, 1, 2), anisotropic=value(choose, -1, 1), tangent=(0.0, 0.0, 1.0), **film)


def random_medium(choose: Chooser) -> MediumData:
    """Return a medium of up to two phase functions, perhaps glowing, perhaps with more light than it gets."""
    phases = tuple(PhaseData(tuple(value(choose, 0, 3) for _ in range(3)), value(choose, -1, 1))
                   for _ in range(choose.whole(0, 2)))
    glow = tuple(value(choose, 0, 1) for _ in range(3)) if choose.whole(0, 3) == 3 else (0.0, 0.0, 0.0)
    medium = MediumData(tuple(value(choose, 0, 5) for _ in range(3)), glow, phases)
    return replace(medium, varying=random_fields(choose, medium)) if choose.whole(0, 1) else medium


def random_fields(choose: Chooser, medium: MediumData) -> VaryingData:
    """Return the medium's coefficients times noise or a coordinate, one or all of them by channels."""
    builder = VolumeBuilder(optional=False)
    place = builder.input(choose.pick(("OBJECT", "GENERATED", "POSITION")))
    if choose.whole(0, 1):
        place = builder.vector("SINE", builder.vector("MULTIPLY", place, value(choose, 0, 20)))
    one, wide = builder.compiled(builder.vector("AVERAGE", place)), builder.compiled(place)
    scattering = tuple((FieldData(part.scattering, one), FieldData((part.anisotropy,) * 3)) for part in medium.phases)
    extinction = FieldData(medium.extinction, one)
    if choose.whole(0, 1):
        extinction = FieldData((1.0, 1.0, 1.0), wide, wide=True)
    return VaryingData(extinction, FieldData(medium.emission, one), scattering)


def filled(choose: Chooser, made: MaterialData) -> MaterialData:
    """Return the material, now and then with a medium behind it, or with that alone."""
    kind = choose.pick(("none", "none", "filled", "bare"))
    if kind == "none":
        return made
    if kind == "bare":
        builder = ProgramBuilder()
        builder.transparent((1.0, 1.0, 1.0), 1.0)
        made = MaterialData(name="boundary", program=builder.finish(), has_transparency=True, bare=True)
    return replace(made, medium=random_medium(choose))


def random_transform(choose: Chooser) -> np.ndarray:
    """Return a place with a turn and a scale, now and then mirrored, flat, huge or tiny."""
    matrix, angle = np.eye(4), choose.number(0.0, 6.3)
    matrix[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    with np.errstate(all="ignore"):
        matrix[:3, :3] *= [value(choose, 0.2, 1.5) for _ in range(3)]
    matrix[:3, 3] = [value(choose, -2.0, 2.0) for _ in range(3)]
    return matrix


def random_lamp(choose: Chooser) -> LightData:
    """Return a lamp."""
    matrix = np.eye(4)
    matrix[:3, 3] = choose.number(-2, 2), choose.number(-2, 2), choose.number(1, 3)
    return lamp(choose.pick(list(LightKind)), value(choose, 0, 100), matrix, radius=value(choose, 0, 0.5),
                angle=value(choose, 0, 0.2), spot_size=value(choose, 0.1, 3), size_x=value(choose, 0.1, 2),
                size_y=value(choose, 0.1, 2), spread=value(choose, 0.1, 3.1), shape=choose.pick(
                    ("SQUARE", "RECTANGLE", "DISK", "ELLIPSE")))


def random_camera(choose: Chooser, size: tuple[int, int]) -> CameraData:
    """Return a camera that mostly looks at the origin."""
    eye = (choose.number(-3, 3), choose.number(-4, -0.1), choose.number(-1, 3))
    camera = look_at(eye, (0.0, 0.0, 0.0), size, choose.pick((1.0, 0.01, 20.0)), clip_start=value(choose, 0, 1))
    kind = choose.pick((CameraKind.PERSPECTIVE, CameraKind.ORTHOGRAPHIC))
    return replace(camera, kind=kind, aperture_radius=choose.pick((0.0, 0.0, 0.1)), clip_end=value(choose, 5, 1e4))


def random_scene(choose: Chooser) -> tuple[StressScene, tuple[int, int]]:
    """Return a scene and the size of its picture."""
    size, count = choose.pick(SIZES), choose.whole(0, 4)
    objects = [
        Placed(i, i, random_transform(choose), choose.pick((
            int(Visibility.ALL), int(Visibility.CAMERA), int(Visibility.ALL | Visibility.HOLDOUT),
            int(Visibility.ALL), int(Visibility.ALL | Visibility.SHADOW_CATCHER))))
        for i in range(count)]
    meshes = {i: random_mesh(choose) for i in range(count)}
    materials = {i: filled(choose, random_material(choose)) for i in range(count)}
    lights = [random_lamp(choose) for _ in range(choose.whole(0, 3))]
    sky = choose.pick((0.0, 1.0)) if choose.whole(0, 1) else abs(value(choose, 0, 2))
    scene = make_scene(meshes, objects, materials, random_camera(choose, size), lights, sky)
    if choose.whole(0, 5) == 5:
        world = replace(scene.delta.world, medium=random_medium(choose))
        scene = replace(scene, delta=replace(scene.delta, world=world))
    return scene, size


def describe(scene: StressScene, size: tuple[int, int]) -> str:
    """Return a scene in a few words."""
    table = scene.delta.instances
    parts = [f"{size[0]} x {size[1]}", f"{len(table.mesh_index)} objects"]
    parts += [f"scale {np.diag(matrix)[:3]} at {matrix[:3, 3]}" for matrix in table.transforms]
    parts += [f"lamp {light.kind} {light.color[0]:g}" for light in scene.delta.lights]
    return ", ".join([*parts, f"sky {scene.delta.world.constant}", f"camera {scene.camera.kind}"])


def try_scene(trial: Trial, scene: StressScene, size: tuple[int, int]) -> None:
    """Render a scene with both integrators; raises BadPicture with a description."""
    for integrator in BOTH:
        result = trial.result
        before = result.non_finite, result.negative
        try:
            trial.render(scene, integrator, 3, size)
        except BurnishError:
            continue  # A sentence is an answer.
        except Exception as error:
            trial.forget_sessions()
            raise BadPicture(f"{integrator}: {type(error).__name__}: {error} ({describe(scene, size)})") from error
        if (result.non_finite, result.negative) != before:
            found = f"{result.non_finite - before[0]} not finite, {result.negative - before[1]} negative"
            trial.forget_sessions()
            raise BadPicture(f"{integrator}: {found} pixels ({describe(scene, size)})")


def run_random(trial: Trial) -> None:
    """Render random scenes; with Hypothesis the failure is the smallest found."""
    count = EXAMPLES["quick" if trial.quick else "full"]
    try:
        hypothesis = importlib.import_module("hypothesis")
        strategies = importlib.import_module("hypothesis.strategies")
    except ImportError:
        for number in range(count):
            try_scene(trial, *random_scene(SeededChooser(1000 * trial.seed + number)))
        trial.note(f"{count} scenes by seed; install hypothesis to have failures shrunk")
        return

    def example(data: Any) -> None:
        try_scene(trial, *random_scene(DrawnChooser(data.draw, strategies)))

    checks = hypothesis.HealthCheck
    wrapped = hypothesis.settings(
        max_examples=count, deadline=None, database=None, derandomize=True, print_blob=False,
        suppress_health_check=[checks.too_slow, checks.data_too_large, checks.large_base_example])(
            hypothesis.given(strategies.data())(example))
    wrapped()
    trial.note(f"{count} scenes by Hypothesis")


CASES = (Case("random: scenes", "no bad pixel, nothing raised but sentences", run_random),)
