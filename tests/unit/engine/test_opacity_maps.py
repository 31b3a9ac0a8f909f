# SPDX-License-Identifier: GPL-3.0-or-later
"""Opacity micromaps: what they claim against the programs, rays through them against every triangle, their renewal."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine import opacity_answers, opacity_maps
from burnish.engine.device_scene import DeviceScene
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import AlphaMode, ImageData, MaterialData, SceneDelta, Visibility
from burnish.engine.session import Session
from burnish.engine.settings import PerformanceSettings
from burnish.kernels.filter_lean import lean_transparency
from burnish.kernels.intersect import Hit, closest_layer, shadow_layer, surface_point
from burnish.kernels.types import VISIBLE_SHADOW, Scene

from tests import scenes
from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

UNKNOWN, CLEAR, SOLID, MIXED = range(4)
DOWN = wp.constant(wp.vec3(0.0, 0.0, -1.0))


@pytest.fixture(autouse=True)
def fine_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make maps as fine on the processor as on CUDA."""
    monkeypatch.setitem(opacity_maps.FINE_TEXELS, "cpu", opacity_maps.FINE_TEXELS["cuda"])


@wp.kernel
def ask_materials(
    # In:
    scene: Scene,
    faces: wp.array[wp.vec2i],
    weights: wp.array[wp.vec2],
    # Out:
    transparency_out: wp.array[wp.vec3],
):
    """Run the programs of points on triangles, by the weights of the second and third vertex."""
    i = wp.tid()
    hit = Hit()
    hit.t = 1.0
    hit.instance = faces[i][0]
    hit.triangle = faces[i][1]
    hit.u = weights[i][0]
    hit.v = weights[i][1]
    transparency_out[i] = lean_transparency(scene, surface_point(scene, hit, DOWN), VISIBLE_SHADOW, 0)


@wp.kernel
def follow(
    # In:
    scene: Scene,
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    t_max: float,
    # Out:
    t_out: wp.array2d[float],
    face_out: wp.array2d[wp.vec2i],
    solid_out: wp.array2d[int],
):
    """Find layers: row 0 the closest, row 1 what a shadow ray meets."""
    i = wp.tid()
    layer = closest_layer(scene.geometry, origin[i], direction[i], t_max)
    shadow = shadow_layer(scene.geometry, origin[i], direction[i], t_max)
    t_out[0, i] = layer.hit.t
    t_out[1, i] = shadow.hit.t
    face_out[0, i] = wp.vec2i(layer.hit.instance, layer.hit.triangle)
    face_out[1, i] = wp.vec2i(shadow.hit.instance, shadow.hit.triangle)
    solid_out[0, i] = layer.solid
    solid_out[1, i] = shadow.solid


def blobs(size: tuple[int, int] = (48, 64), seed: int = 3, steep: float = 6.0) -> np.ndarray:
    """Return a picture [H, W, 4] of 8 bits: random colours, an alpha of soft blobs that reach 0 and 1."""
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(*(np.arange(n) / n for n in size), indexing="ij")
    waves = sum(np.sin(2 * np.pi * (a * x + b * y) + c) for a, b, c in rng.integers(1, 4, (5, 3)))
    pixels = rng.integers(0, 256, (*size, 4)).astype(np.uint8)
    pixels[..., 3] = np.rint(255 * np.clip(0.5 + steep * waves / 5, 0, 1))
    return pixels


def masked(threshold: float | None = None, extension: int = 0, interpolation: int = 0, channel: int = 3,
           rows=None, **fields) -> MaterialData:
    """Make a material cut out by an image, read as it is or compared with a threshold."""
    build = ProgramBuilder()
    uv = build.uv("UVMap") if rows is None else build.transform(rows, build.uv("UVMap"))
    look = build.image("leaf", uv, extension=extension, interpolation=interpolation)
    alpha = build.component(look, channel)
    if threshold is not None:
        alpha = build.math("GREATER_THAN", alpha, threshold)
    alpha = build.math("CLAMP", alpha, 0.0, 1.0)
    build.transparent(1.0, build.math("SUBTRACT", 1.0, alpha))
    build.closure("DIFFUSE", alpha, color=0.8)
    return MaterialData(name="leaf", program=build.finish(), has_transparency=True, **fields)


def leaves(count: int = 40, seed: int = 5, reach: float = 1.2):
    """Make a mesh of triangles in random places, with random coordinates of which some repeat the picture."""
    rng = np.random.default_rng(seed)
    centers = rng.uniform(-1, 1, (count, 1, 3))
    points = (centers + rng.normal(size=(count, 3, 3)) * 0.4).reshape(-1, 3)
    uvs = rng.uniform(-reach, 1 + reach, (count, 1, 2)) + rng.normal(size=(count, 3, 2)) * 0.3
    return scenes.mesh(points, np.arange(3 * count).reshape(-1, 3), uvs=uvs)


def opened(material: MaterialData, pixels: np.ndarray | None = None, mesh=None, settings=None, objects=None,
           **image) -> DeviceScene:
    """Put leaves of a material on the device."""
    delta = scenes.delta({"leaves": mesh or leaves()}, objects or [("leaves", np.eye(4), "leaf")], {"leaf": material})
    delta.images["leaf"] = ImageData(name="leaf", pixels=blobs() if pixels is None else pixels, **image)
    made = DeviceScene(DEVICE)
    made.apply(delta, settings or PerformanceSettings())
    return made


def words_of(made: DeviceScene) -> tuple[np.ndarray, np.ndarray]:
    """Return the words of the triangles [N, 12] and all words."""
    words = made.structures.filtered.wide.triangles.numpy()
    return words[:12 * len(made.structures.filtered.faces)].reshape(-1, 12), words


def state_at(triangle: np.ndarray, words: np.ndarray, weights: np.ndarray) -> int:
    """Return the state of a point by the weights of all three vertices, as wide_bvh.py describes the map."""
    state, level = int(triangle[7]) >> 30, int(triangle[7]) & 15
    if state != MIXED:
        return state
    weights, number = np.array(weights, np.float64), 0
    for _ in range(level):
        weights = 2 * weights
        digit = int(np.argmax(weights)) if weights.max() >= 1 else 3
        if digit < 3:
            weights[digit] -= 1
        else:
            weights = 1 - weights
        number = 4 * number + digit
    place = int(triangle[11]) + (8 if int(triangle[7]) & 32 else 0)
    return int(words[place + number // 16]) >> 2 * (number % 16) & 3


def check_claims(made: DeviceScene, points: int = 400) -> np.ndarray:
    """Compare what the maps claim with programs at random points of all triangles; return how often they say what."""
    triangles, words = words_of(made)
    faces = made.structures.filtered.faces.numpy()[triangles[:, 3].astype(np.int64)]
    weights = np.random.default_rng(1).dirichlet((1, 1, 1), (len(faces), points)).astype(np.float32)
    said = np.array([[state_at(triangle, words, w) for w in rows]
                     for triangle, rows in zip(triangles, weights, strict=True)]).ravel()
    answer = wp.zeros(len(said), dtype=wp.vec3, device=DEVICE)
    wp.launch(ask_materials, len(said), [made.scene, *(wp.array(rows.reshape(-1, 2), dtype=kind, device=DEVICE)
              for rows, kind in ((np.repeat(faces, points, 0), wp.vec2i), (weights[..., 1:], wp.vec2)))], [answer],
              device=DEVICE)
    passes = answer.numpy()[:, 0]
    np.testing.assert_allclose(passes[said == CLEAR], 1.0, atol=1e-5)
    np.testing.assert_allclose(passes[said == SOLID], 0.0, atol=2e-3)
    return np.bincount(said, minlength=3) / len(said)


@pytest.mark.parametrize("extension", range(4))
@pytest.mark.parametrize("threshold", [None, 0.3])
def test_claims_agree_with_programs(extension: int, threshold: float | None) -> None:
    """Claim nothing that a look-up contradicts, under every way in which pictures go on, and much of the rest."""
    shares = check_claims(opened(masked(threshold, extension)))
    assert shares[CLEAR] > 0.1 and shares[SOLID] > (0.01 if extension == 2 else 0.1)
    assert shares[UNKNOWN] < (0.65 if threshold is None else 0.5)


@pytest.mark.parametrize(("fields", "image"), [
    ({"interpolation": 1, "threshold": 0.5}, {}),
    ({"channel": 1, "threshold": 0.4}, {}),
    ({"channel": 0, "threshold": 0.4}, {"alpha_mode": AlphaMode.CHANNEL_PACKED}),
    ({"channel": 2, "threshold": 0.4}, {"source_colorspace": "Non-Color"}),
    ({"threshold": 0.5, "rows": [[1.5, 0.7, 0.0, 0.1], [-0.7, 1.5, 0.0, 0.3], [0.0, 0.0, 1.0, 0.0]]}, {}),
])
def test_claims_hold_for_other_look_ups(fields: dict, image: dict) -> None:
    """Hold for closest texels, colours stored in every way, and moved coordinates."""
    pixels = blobs()
    smooth = np.moveaxis(np.stack([blobs(seed=k)[..., 3] for k in range(3)]), 0, -1)
    pixels[..., :3] = smooth
    shares = check_claims(opened(masked(**fields), pixels, **image))
    assert shares[CLEAR] + shares[SOLID] > 0.3


@pytest.mark.parametrize("kind", [np.uint16, np.float16, np.float32])
def test_claims_hold_for_other_texels(kind: type) -> None:
    """Hold for pictures of 16 bits and floats."""
    pixels = blobs().astype(np.float64) / 255
    pixels = np.rint(pixels * 65535).astype(kind) if kind is np.uint16 else pixels.astype(kind)
    shares = check_claims(opened(masked(0.3), pixels), 100)
    assert shares[UNKNOWN] < 0.5


def test_each_mesh_has_its_own_maps() -> None:
    """Claim of each of several meshes what its own material and coordinates say."""
    meshes = {"leaves": leaves(), "others": leaves(30, seed=6), "plane": scenes.quad(3.0)}
    placed = [("plane", np.eye(4), "clear"), ("leaves", np.eye(4), "leaf"), ("others", np.eye(4), "leaf"),
              ("leaves", scenes.place(y=2.0), "coarse")]
    materials = {"leaf": masked(0.3), "coarse": masked(0.6, channel=1), "clear": scenes.transparent(1.0)}
    delta = scenes.delta(meshes, placed, materials)
    delta.images["leaf"] = ImageData(name="leaf", pixels=np.repeat(blobs()[..., 3:], 4, 2))
    made = DeviceScene(DEVICE)
    made.apply(delta, PerformanceSettings())
    assert check_claims(made, 100)[UNKNOWN] < 0.5


def test_odd_coordinates_stay_unknown() -> None:
    """Claim nothing of triangles whose coordinates are not finite, far away, or cover too much of a picture."""
    mesh = leaves(4)
    uvs = mesh.uv_maps["UVMap"].reshape(-1, 3, 2)
    uvs[0, 1, 0], uvs[1, 2, 1], uvs[2, 0] = np.nan, np.inf, 1e9
    uvs[3] = [(0, 0), (900, 0), (0, 900)]
    triangles, _ = words_of(opened(masked(0.3), mesh=mesh))
    assert (triangles[:, 7] >> 30 == UNKNOWN).all()


def test_whole_triangles_need_no_map() -> None:
    """Keep no map for triangles that are the same everywhere, nor for a material that is clear without an image."""
    pixels = blobs()
    for alpha, state in ((0, CLEAR), (255, SOLID)):
        pixels[..., 3] = alpha
        triangles, words = words_of(opened(masked(), pixels))
        assert (triangles[:, 7] >> 30 == state).all() and len(words) == triangles.size
    triangles, _ = words_of(opened(scenes.transparent(1.0)))
    assert (triangles[:, 7] >> 30 == CLEAR).all()


def crossings(made: DeviceScene, mesh, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return t (inf without a hit) and state of every triangle on every ray [rays, triangles], each tried in turn."""
    triangles, words = words_of(made)
    by_face = triangles[np.argsort(triangles[:, 3])]
    (t, weights), states = crossed(mesh, origin, direction), np.full((len(origin), len(by_face)), CLEAR)
    for ray, k in np.argwhere(np.isfinite(t)):
        states[ray, k] = state_at(by_face[k], words, weights[ray, k])
    return t, states


def crossed(mesh, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return t (inf without a hit) [rays, triangles] and the vertices' weights [rays, triangles, 3]."""
    t = np.full((len(origin), len(mesh.triangles)), np.inf)
    weights = np.zeros((*t.shape, 3))
    for k, (a, b, c) in enumerate(mesh.positions.astype(np.float64)[mesh.triangles]):
        cross = np.cross(direction, c - a)
        scale = 1.0 / (cross @ (b - a))
        u = ((origin - a) * cross).sum(1) * scale
        other = np.cross(origin - a, b - a)
        v = (direction * other).sum(1) * scale
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (other @ (c - a) * scale >= 0)
        t[met, k] = (other @ (c - a) * scale)[met]
        weights[:, k] = np.stack([1 - u - v, u, v], 1)
    return t, weights


def test_rays_meet_what_the_maps_leave() -> None:
    """Pass over what is clear, report what is solid, keep the rest; shadow rays end at what is solid, in any order."""
    mesh = leaves(60)
    # Rays can't look up a picture of floats by themselves.
    made = opened(masked(0.3), (blobs() / 255).astype(np.float32), mesh)
    rng = np.random.default_rng(7)
    origin, direction = rng.uniform(-2, 2, (1500, 3)).astype(np.float32), rng.normal(size=(1500, 3)).astype(np.float32)
    outputs = [wp.zeros((2, 1500), dtype=kind, device=DEVICE) for kind in (float, wp.vec2i, int)]
    rays = [wp.array(x, dtype=wp.vec3, device=DEVICE) for x in (origin, direction)]
    wp.launch(follow, 1500, [made.scene, *rays, 1e30], outputs, device=DEVICE)
    t, face, solid = (output.numpy() for output in outputs)
    distances, states = crossings(made, mesh, origin.astype(float), direction.astype(float))
    seen = np.where(states == CLEAR, np.inf, distances)
    first = seen.argmin(1)
    hits = np.isfinite(seen.min(1))
    assert (states == CLEAR)[np.isfinite(distances)].mean() > 0.2 and 0.1 < hits.mean() < 0.99
    # Rays through the edges of parts may be rounded to the other side.
    same = (face[0, :, 0] >= 0) == hits
    same &= ~hits | ((face[0, :, 1] == first) & (solid[0] == (states[np.arange(1500), first] == SOLID)))
    assert same.mean() > 0.998
    np.testing.assert_allclose(t[0][same & hits], seen.min(1)[same & hits], rtol=1e-3, atol=1e-4)
    # Shadow rays may end at a solid triangle further on than the closest; else both find the same.
    ended = ((states == SOLID) & np.isfinite(distances)).any(1)
    assert (ended | (solid[1] == 0)).mean() > 0.998
    assert (solid[1] >= solid[0]).all() and (solid[1] > solid[0]).any()
    np.testing.assert_array_equal(t[1][solid[1] == 0], t[0][solid[1] == 0])


def test_scenes_without_masks_do_without(monkeypatch: pytest.MonkeyPatch) -> None:
    """Launch and keep nothing without transparency, where what is clear shines, and when switched off."""
    launches = []
    launch = opacity_maps.launch_bands
    monkeypatch.setattr(
        opacity_maps, "launch_bands", lambda kernel, *rest: (launches.append(kernel), launch(kernel, *rest)))
    for material, settings in ((scenes.material(color=0.5), None), (masked(has_emission=True), None),
                               (masked(), PerformanceSettings(opacity_maps=False))):
        made = opened(material, settings=settings)
        assert launches == [] and made.opacity_maps.bytes == 0
        if made.structures.filtered.wide is not None:
            triangles, words = words_of(made)
            assert len(words) == triangles.size and not triangles[:, [7, 11]].any()
    made = opened(masked())
    assert launches and made.opacity_maps.bytes > 0
    # Nothing that they depend on has changed.
    for first in (True, False):
        launches.clear()
        moved = scenes.instances([("leaves", scenes.place(x=0.1 if first else 0.2), "leaf")])
        made.apply(SceneDelta(instances=moved), PerformanceSettings())
        assert bool(launches) == first and made.opacity_maps.bytes > 0, "what moves gets a tree and maps of its own"


def test_objects_that_some_rays_do_not_see_have_none() -> None:
    """Leave objects alone that are invisible to a kind of ray: nothing there stops that one."""
    hidden = int(Visibility.ALL & ~Visibility.SHADOW)
    made = opened(masked(), objects=[("leaves", np.eye(4), "leaf", hidden), ("leaves", np.eye(4), "leaf")])
    triangles, _ = words_of(made)
    owner = made.structures.filtered.faces.numpy()[triangles[:, 3].astype(np.int64), 0]
    assert not triangles[owner == 0, 7].any() and (triangles[owner == 1, 7] >> 30 == MIXED).any()


def test_instances_share_maps_and_edits_renew_them() -> None:
    """Keep one map for all instances of a mesh with a material; renew it with image, material and set of materials."""
    placed = [("leaves", scenes.place(x=float(i)), "leaf") for i in range(3)]
    made = opened(masked(0.3), objects=placed)
    triangles, _ = words_of(made)
    mixed = triangles[triangles[:, 7] >> 30 == MIXED]
    assert len(np.unique(mixed[:, 11])) * 3 == len(mixed) > 30
    before = check_claims(made, 30)
    pixels = blobs(seed=9)
    made.apply(SceneDelta(images={"leaf": ImageData(name="leaf", pixels=pixels)}), PerformanceSettings())
    assert np.abs(check_claims(made, 30) - before).max() > 0.02
    made.apply(SceneDelta(materials={"leaf": masked(0.9)}), PerformanceSettings())
    stricter = check_claims(made, 30)
    assert stricter[CLEAR] > 0.05
    made.apply(SceneDelta(materials={"other": masked(0.05)}, instances=scenes.instances(
        [(mesh, place, "other") for mesh, place, _ in placed])), PerformanceSettings())
    assert check_claims(made, 30)[CLEAR] < stricter[CLEAR]
    made.use_opacity_maps(False)
    triangles, words = words_of(made)
    assert not triangles[:, [7, 11]].any() and len(words) == triangles.size
    made.use_opacity_maps(True)
    assert check_claims(made, 30)[SOLID] > 0.05


def test_large_triangles_go_without_where_texels_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bound the work: make maps of the triangles that cover the fewest texels."""
    mesh = leaves(8)
    size = np.repeat([0.1, 1.0], 4)
    mesh.uv_maps["UVMap"][:].flat = (np.array([(0, 0), (1, 0), (0, 1)]) * size[:, None, None]).ravel()
    monkeypatch.setattr(opacity_maps, "TEXELS_MAX", dict.fromkeys(opacity_maps.TEXELS_MAX, 1000.0))
    pixels = blobs()
    pixels[..., 3] = 255
    triangles, _ = words_of(opened(masked(0.3), pixels, mesh))
    known = (triangles[:, 7] >> 30)[np.argsort(triangles[:, 3])]
    np.testing.assert_array_equal(known == SOLID, [True] * 4 + [False] * 4)


def test_maps_get_coarser_before_they_get_large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep to the room there is, and claim less, not wrongly."""
    monkeypatch.setattr(opacity_answers, "IMAGE_WORDS_MAX", 0)
    fine = opened(masked(0.3))
    monkeypatch.setattr(opacity_maps, "WORDS_MAX", 100)
    coarse = opened(masked(0.3))
    assert 0 < coarse.opacity_maps.bytes <= 1600 < fine.opacity_maps.bytes
    assert check_claims(coarse)[UNKNOWN] > check_claims(fine)[UNKNOWN]


@pytest.mark.parametrize("threshold", [None, 0.5])
def test_pictures_are_the_same_with_and_without(threshold: float | None) -> None:
    """Path trace leaves under a sky and a lamp: the same samples, but for rounding where they go on behind a leaf."""
    delta = scenes.delta(
        {"leaves": leaves(30, reach=0.3), "floor": scenes.quad(3.0, -1.5)},
        [("leaves", np.eye(4), "leaf"), ("floor", np.eye(4), "grey")],
        {"leaf": masked(threshold), "grey": scenes.material(color=0.5)},
        lights=[scenes.lamp("POINT", 100.0, scenes.place(z=4.0))], background=0.5)
    delta.images["leaf"] = ImageData(name="leaf", pixels=blobs())
    pictures = {}
    for on in (True, False):
        settings = dataclasses.replace(scenes.SETTINGS, performance=PerformanceSettings(opacity_maps=on))
        session = Session(settings)
        session.update(delta)
        session.configure(settings, scenes.camera_above(half=1.5), 32, 32)
        session.step(4)
        pictures[on] = session.read()[..., :3]
    assert pictures[True].std() > 0.05
    same = np.isclose(pictures[True], pictures[False], rtol=1e-3, atol=1e-4).all(-1)
    # Half transparent points draw other numbers where clear layers lie before them.
    assert same.mean() > (0.9 if threshold is None else 0.99)
    np.testing.assert_allclose(pictures[True].mean(), pictures[False].mean(), rtol=0.01)


def test_the_switch_works_in_a_running_session() -> None:
    """Switch maps off and on again between pictures."""
    delta = scenes.delta({"leaves": leaves(10)}, [("leaves", np.eye(4), "leaf")], {"leaf": masked(0.5)}, background=1.0)
    delta.images["leaf"] = ImageData(name="leaf", pixels=blobs())
    session = Session(scenes.SETTINGS)
    session.update(delta)
    for on in (True, False, True):
        settings = dataclasses.replace(scenes.SETTINGS, performance=PerformanceSettings(opacity_maps=on))
        session.configure(settings, scenes.camera_above(half=1.0), 4, 4)
        triangles, _ = words_of(session._scene)
        assert triangles[:, 7].any() == on
