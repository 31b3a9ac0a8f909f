# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials, worlds and lamps as translated, against Cycles' pictures and against what their sockets say."""

from __future__ import annotations

from collections.abc import Callable

import pytest

OUTLIERS = 8
"""Of 256 pixels: Cycles' rays meet pixel centres to 1e-2 px only, which decides on which side of a step they fall."""


@pytest.fixture(scope="module")
def run_nodes(run_python: Callable) -> Callable[[str], object]:
    """Return a function that runs a script with everything of node_scenes.py and returns what it finished with."""
    import json
    from pathlib import Path

    folder = str(Path(__file__).resolve().parent)
    preamble = (
        f"sys.path.insert(0, {folder!r})\nimport warp\nwarp.config.log_level = warp.LOG_ERROR\n"
        "from node_scenes import *\nfrom node_graphs import *\nfrom material_graphs import *\n"
        "from cell_graphs import voronoi_graphs, gabor_graphs\nharness = Harness()\n")

    def run(script: str) -> object:
        process = run_python(preamble + script)
        lines = [line for line in process.stdout.splitlines() if line.startswith("RESULT ")]
        assert process.returncode == 0 and lines, process.stdout + process.stderr
        return json.loads(lines[-1].removeprefix("RESULT "))

    return run


FAMILIES = [
    "coordinate_graphs", "math_graphs", "vector_graphs", "mix_graphs", "color_graphs", "mapping_graphs",
    "image_graphs", "pattern_graphs", "normal_graphs", "voronoi_graphs", "gabor_graphs",
]


@pytest.fixture(scope="module")
def compared(run_nodes: Callable) -> dict[str, dict]:
    """Return the comparison of every graph with Cycles, by family: one child process, for its start takes longest."""
    pairs = ", ".join(f"{family!r}: compare_all(harness, {family}())" for family in FAMILIES)
    return run_nodes(f"finish({{{pairs}}})")


@pytest.fixture(scope="module")
def found(run_nodes: Callable) -> dict:
    """Return everything else that tests look at, from one child process, each with a harness of its own."""
    pairs = ", ".join(f"{name!r}: {name}(Harness())" for name in (
        "compare_worlds", "principled_closure", "material_flags", "report_of_everything", "lamp_shaders",
        "oversized_material", "default_closures", "scattering_closures"))
    return run_nodes(f"finish({{{pairs}}})")


@pytest.mark.parametrize("family", FAMILIES)
def test_agree_with_cycles(compared: dict[str, dict], family: str):
    """Yield Cycles' value within 1/255 at every pixel of a plane, graph by graph."""
    assert compared[family]
    wrong = {name: counts for name, counts in compared[family].items() if counts["outliers"] > OUTLIERS}
    assert not wrong, wrong


def test_worlds_agree_with_cycles(found: dict):
    """Show Cycles' panorama within 1/255, and know which worlds are constant."""
    worlds = found["compare_worlds"]
    assert {name: world["outliers"] for name, world in worlds.items() if world["outliers"] > OUTLIERS} == {}
    assert worlds["plain color"]["constant"] == pytest.approx([0.15, 0.3, 0.45])
    assert worlds["panorama"]["constant"] is None and worlds["panorama"]["resolution"] == 512
    assert worlds["nothing"]["constant"] == [0.0, 0.0, 0.0]


def test_slots_without_material_have_a_new_one(found: dict):
    """Draw what has no material as Blender's new Principled BSDF, as Cycles does."""
    new, default = found["default_closures"]
    assert new == pytest.approx(default, abs=1e-6)


def test_principled_sockets(found: dict):
    """Hand every socket of the Principled BSDF over, linked or not."""
    closure = found["principled_closure"]
    assert closure["kind"] == 1 and closure["multiscatter"] == 0
    assert closure["color"] == pytest.approx([0.1, 0.2, 0.3])
    expected = {
        "metallic": 0.11, "roughness": 0.12, "ior": 1.3, "diffuse_roughness": 0.14, "specular_level": 0.15,
        "anisotropic": 0.16, "anisotropic_rotation": 0.17, "transmission": 0.18, "coat": 0.19,
        "coat_roughness": 0.21, "coat_ior": 1.22, "sheen": 0.23, "sheen_roughness": 0.24, "subsurface": 0.25,
        "subsurface_ior": 1.27, "subsurface_anisotropy": 0.28, "subsurface_method": 3,
        "film_thickness": 260.0, "film_ior": 1.27,
    }
    assert {name: closure[name] for name in expected} == pytest.approx(expected)
    assert closure["subsurface_radius"] == pytest.approx([0.26, 0.52, 0.78])
    assert closure["thin_wall"] == int(closure["thin_walls"])
    assert closure["weight"] == pytest.approx([0.7] * 3)
    assert closure["transparency"] == pytest.approx([0.3] * 3)
    assert closure["emission"] == [0.0] * 3
    assert closure["emission_layered"] == pytest.approx([2.0, 4.0, 6.0])
    assert closure["nee_emission"] == pytest.approx([1.4, 2.8, 4.2])


def test_subsurface_scattering(found: dict):
    """Hand the radius over by the method; none without a radius."""
    closures = found["scattering_closures"]
    numbers = {"BURLEY": 2, "RANDOM_WALK": 2 if closures["legacy"] else 1, "RANDOM_WALK_SKIN": 3}
    for method, number in numbers.items():
        closure = closures[method]
        assert closure["kind"] == 1 and closure["subsurface_method"] == number, method
        assert closure["subsurface_radius"] == pytest.approx([0.5, 1.0, 1.5])
        expected = {"subsurface": 1.0, "subsurface_ior": 1.3, "roughness": 0.4, "subsurface_anisotropy": 0.4,
                    "specular_level": 0.0}
        assert {name: closure[name] for name in expected} == pytest.approx(expected)
    assert closures["none"]["subsurface"] == 1.0 and closures["none"]["subsurface_method"] == 0


@pytest.mark.parametrize(("graph", "flags"), [
    ("principled", (False, False, None)),
    ("alpha", (True, False, None)),
    ("alpha_linked", (True, False, None)),
    ("emission", (False, True, [2.0, 4.0, 6.0])),
    ("background", (False, True, [0.5, 1.0, 1.5])),
    ("emission_textured", (False, True, None)),
    ("mix_with_factor_0", (False, False, None)),
    ("mix_half", (True, True, [0.5, 0.5, 0.5])),
    ("add", (True, True, [1.0, 1.0, 1.0])),
    ("no_surface", (False, False, None)),
    ("muted", (False, False, None)),
    ("group", (False, True, [3.0, 3.0, 3.0])),
])
def test_flags(found: dict, graph: str, flags: tuple):
    """Set transparency and emission exactly as the graph can show them."""
    transparency, emission, constant = found["material_flags"][graph]
    assert (transparency, emission) == flags[:2]
    assert constant == (None if flags[2] is None else pytest.approx(flags[2]))


def test_report_names_what_is_not_drawn(found: dict):
    """Name material and node of everything that is approximated, and never fail."""
    text = found["report_of_everything"]
    for words in ("subsurface", "Bevel", "hair", "Light Path"):
        assert words in text, words
    assert "material 'Everything'" in text
    assert "could not be read" not in text


def test_lamp_shader(found: dict):
    """Reduce lamps' node trees to a factor where they are constant, and compile the others."""
    plain, strong, falloff, textured, profile, text = found["lamp_shaders"]
    assert plain == [[1.0, 1.0, 1.0], False]
    assert strong == [pytest.approx([6.0, 3.0, 1.5]), False]
    assert falloff == textured == profile == [[1.0, 1.0, 1.0], True]
    assert text.count("light 'Lamp'") == 1 and "no line TILT=; 100 stands in for it" in text


def test_large_trees_fall_back(found: dict):
    """Draw a material in its viewport color where its tree exceeds the machine, and say so."""
    kind, color, text = found["oversized_material"]
    assert kind == 2 and color == pytest.approx([0.2, 0.3, 0.4])
    assert "too large" in text
