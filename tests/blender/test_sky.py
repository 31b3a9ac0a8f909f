# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky Textures against Cycles: what is seen of them, how their suns shine, and what edits send."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="module")
def found(run_python: Callable) -> dict:
    """Return what the functions of sky_worlds.py found, from one child process, each with a harness of its own."""
    folder = str(Path(__file__).resolve().parent)
    names = ("compare_skies", "compare_material", "find_suns", "light_of_suns")
    process = run_python(
        f"sys.path.insert(0, {folder!r})\nimport warp\nwarp.config.log_level = warp.LOG_ERROR\n"
        "from node_scenes import *\nfrom sky_worlds import *\n"
        f"finish({{{', '.join(f'{name!r}: {name}(Harness())' for name in names)}}})", timeout=600)
    lines = [line for line in process.stdout.splitlines() if line.startswith("RESULT ")]
    assert process.returncode == 0 and lines, process.stdout + process.stderr
    return json.loads(lines[-1].removeprefix("RESULT "))


@pytest.mark.slow
def test_skies_look_as_in_cycles(found: dict):
    """Show the radiance of Cycles' panoramas within 1 %; the sun's disc and the fitted model within 2 %."""
    skies = found["compare_skies"]
    assert all(brightest > 1000.0 for name, (_, brightest) in skies.items() if "sun" in name)
    wrong = {name: error for name, (error, _) in skies.items()
             if error > (0.02 if "sun" in name or "HOSEK" in name else 0.01)}
    assert not wrong, wrong


@pytest.mark.slow
def test_skies_on_surfaces(found: dict):
    """Show a sky in a material's nodes as Cycles does."""
    assert found["compare_material"] < 0.01


@pytest.mark.slow
def test_suns_become_lamps(found: dict):
    """Make a lamp of a sun that the world shows undistorted, and let the camera alone see the disc then."""
    suns = found["find_suns"]
    plain = suns["plain"]["lamp"]
    assert suns["plain"]["camera"] == 1 and suns["plain"]["width"] == 512
    elevation = math.radians(15.0)
    np.testing.assert_allclose(plain["towards"], (0.0, math.cos(elevation), math.sin(elevation)), atol=1e-3)
    assert plain["angle"] == pytest.approx(0.009512, rel=5e-3) and plain["visibility"] & 1 == 0
    np.testing.assert_allclose(plain["color"], (190.4, 140.7, 79.6), rtol=0.01)
    np.testing.assert_allclose(suns["strong"]["lamp"]["color"], 3.0 * np.array(plain["color"]), rtol=1e-5)
    assert suns["strong"]["lamp"]["visibility"] == plain["visibility"] & ~4
    # Without saturation a colour becomes its largest channel.
    np.testing.assert_allclose(suns["dimmed"]["lamp"]["color"], [0.5 * 0.25 * plain["color"][0] / 1.5] * 3, rtol=1e-3)
    np.testing.assert_allclose(suns["turned"]["lamp"]["towards"], suns["turned"]["lamp"]["expected"], atol=1e-5)
    assert not np.allclose(suns["turned"]["lamp"]["towards"], plain["towards"], atol=0.1)
    np.testing.assert_allclose(suns["turned"]["lamp"]["color"], plain["color"], rtol=1e-4)
    # The others' Background has a strength of 1.5.
    np.testing.assert_allclose(1.5 * np.array(suns["by ray"]["lamp"]["color"]), plain["color"], rtol=1e-4)


@pytest.mark.slow
def test_other_suns_stay_in_the_picture(found: dict):
    """Show the disc to all rays, and make its sampling table fine enough, where no lamp can stand for it."""
    suns = found["find_suns"]
    for name in ("off", "none", "set"):
        assert suns[name]["lamp"] is None and suns[name]["camera"] == 0 and suns[name]["width"] == 512
    for name in ("fading", "huge"):
        assert suns[name]["lamp"] is None and suns[name]["camera"] == 0
    assert suns["fading"]["width"] > 1500


@pytest.mark.slow
@pytest.mark.parametrize("shown_by", ["lamp", "picture"])
def test_suns_shine_as_in_cycles(found: dict, shown_by: str):
    """Light a plane as strongly as in Cycles, within 2 %."""
    expected, drawn = found["light_of_suns"][shown_by]
    np.testing.assert_allclose(drawn, expected, rtol=0.02)
    assert min(expected) > 5.0


def test_edits_of_the_sky(run_extraction: Callable):
    """Send the sky's picture, its sun and nothing else when the sun rises, and no picture where only the sun turns."""
    result = run_extraction(r'''
world = bpy.data.worlds.new("World"); world.use_nodes = True; bpy.context.scene.world = world
tree = world.node_tree
node = tree.nodes.new("ShaderNodeTexSky")
tree.links.new(node.outputs[0], tree.nodes["Background"].inputs[0])
lamp = link("Lamp", bpy.data.lights.new("Lamp", 'POINT'))
view = Viewport()
def sent(action):
    result = view.after(action)
    lights = view.delta.lights
    return {**result, "images": [key[0] for key in view.delta.images],
            "lights": None if lights is None else [light.name for light in lights]}
finish(
    first=sent(lambda: None),
    rises=sent(lambda: setattr(node, "sun_elevation", 0.5)),
    turns=sent(lambda: setattr(node, "sun_rotation", 1.0)),
    again=sent(lambda: setattr(node, "sun_rotation", 1.0)),
    lamp=sent(lambda: setattr(lamp.data, "energy", 7.0)),
    stronger=sent(lambda: setattr(node, "sun_intensity", 2.0)),
    cloudy=sent(lambda: setattr(node, "sun_disc", False)),
)
''')
    both = ["Lamp", "sun of world 'World'"]
    assert result["first"]["images"] == ["sky", "sun"] and result["first"]["lights"] == both
    assert result["rises"]["images"] == ["sky", "sun"] and result["rises"]["lights"] == both
    assert result["rises"]["world"] and not result["rises"]["instances"] and not result["rises"]["full"]
    assert result["turns"]["images"] == [] and result["turns"]["lights"] == both and result["turns"]["world"]
    assert result["again"]["images"] == [] and result["again"]["lights"] is None and not result["again"]["world"]
    assert result["lamp"]["lights"] == both and not result["lamp"]["world"]
    assert result["stronger"]["images"] == [] and result["stronger"]["lights"] == both
    assert result["cloudy"]["lights"] == ["Lamp"] and result["cloudy"]["world"]
