# SPDX-License-Identifier: GPL-3.0-or-later
"""The stress test: its quick subset, its random scenes, and that it finds what it is there to find."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections import Counter

import hypothesis
import numpy as np
import pytest
from burnish.addon import cli
from burnish.addon import stress as command
from burnish.engine import stress
from burnish.engine.errors import InvalidScene
from burnish.engine.image_error import compare
from burnish.engine.settings import Device, Integrator
from burnish.engine.stress import cases, fuzz, invariance, scenes, tables
from burnish.engine.stress.cases import Case, Trial, run_case
from hypothesis import strategies

SIZE = (16, 12)
ALL = stress.all_cases()
QUICK = stress.choose_cases(ALL, quick=True)
@pytest.fixture(scope="module")
def trial(device):
    """Return a trial whose sessions all tests share, as in the command."""
    made = Trial(Device(device.partition(":")[0]), quick=True)
    yield made
    made.forget_sessions()


def quick_cases():
    """Return the cases as parameters: the first of each subject and every sixth after it, the others marked slow."""
    seen = Counter()
    for case in QUICK:
        if case.group == "random":
            continue
        yield pytest.param(case, id=case.name, marks=pytest.mark.slow if seen[case.group] % 6 else ())
        seen[case.group] += 1


@pytest.mark.parametrize("case", list(quick_cases()))
def test_quick_case(trial, case):
    """Meet the goal of each case of the quick subset."""
    result = run_case(trial, case)
    assert result.passed, "\n".join(result.missed + result.notes)
    assert result.pictures > 0


@pytest.mark.parametrize(("scale", "limit"), [
    (2.0**-10, 0.002), pytest.param(2.0**-5, 0.002, marks=pytest.mark.slow),
    pytest.param(2.0**10, 0.008, marks=pytest.mark.slow)])
def test_small_and_large_scenes_look_the_same(trial, scale, limit):
    """Draw a scene of millimetres as one of metres: no length in the kernels is an absolute one, but FAR [59 km]."""
    room, amounts = scenes.room(invariance.SIZE), (Integrator.REALTIME, 24, invariance.SIZE)
    expected = trial.render(room, *amounts, cache={"minimum_cell": invariance.SMALLEST_CELL})
    scaled = scenes.scaled_and_moved(room, scale)
    picture = trial.render(scaled, *amounts, cache={"minimum_cell": invariance.SMALLEST_CELL * scale})
    assert compare(expected, picture).flip < limit


@pytest.mark.parametrize("count", [4, pytest.param(8, marks=pytest.mark.slow)])
def test_random_scenes(trial, count):
    """Render random scenes, drawn by Hypothesis, without a bad pixel and without raising anything but sentences."""
    health = hypothesis.HealthCheck

    @hypothesis.settings(max_examples=count, deadline=None, derandomize=True, database=None,
                         suppress_health_check=[health.too_slow, health.data_too_large, health.large_base_example])
    @hypothesis.given(strategies.data())
    def example(data):
        fuzz.try_scene(trial, *fuzz.random_scene(fuzz.DrawnChooser(data.draw, strategies)))

    example()


def test_seeded_scenes_repeat():
    """Draw the same scene from the same seed, another from another."""
    first, again, other = (fuzz.describe(*fuzz.random_scene(fuzz.SeededChooser(seed))) for seed in (3, 3, 4))
    assert first == again != other


# That it can fail.


def result_of(run):
    """Return the result of a case made of a function."""
    return run_case(Trial(Device.CPU), Case("test: made up", "", run))


def test_bad_pixels_are_counted():
    """Count pixels that are not finite and negative ones, and let the case fail."""
    picture = np.ones((3, 4, 4), np.float32)
    picture[0, 0, 1], picture[1, 1, 0], picture[2, 2, 3], picture[2, 3] = np.nan, np.inf, -1.0, -2.0

    result = result_of(lambda trial: trial.count(picture))
    assert (result.pictures, result.pixels, result.non_finite, result.negative) == (1, 12, 2, 2)
    assert result.missed == ["2 pixels are not finite", "2 pixels are negative"] and not result.passed


def test_what_a_case_raises_is_its_failure():
    """Take a sentence as it is, name the kind of anything else, and go on."""
    def refuse(trial):
        raise InvalidScene("The camera is broken.")

    assert result_of(refuse).missed == ["The camera is broken."]
    assert result_of(lambda trial: 1 / 0).missed == ["unexpected ZeroDivisionError: division by zero"]


@pytest.mark.parametrize(("value", "good"), [(1.0, True), (1.02, False), (0.98, False), (np.nan, False)])
def test_energy_has_a_goal(value, good):
    """Fail where light is lost or made, or where the ratio is not a number."""
    assert result_of(lambda trial: trial.check_energy("light", value, 0.01)).passed == good


def test_a_difference_has_a_goal():
    """Fail where two pictures that should be the same are not."""
    dark, bright = np.zeros((16, 16, 3), np.float32), np.full((16, 16, 3), 0.5, np.float32)
    assert result_of(lambda trial: trial.check_same("same", dark, dark)).passed
    result = result_of(lambda trial: trial.check_same("other", dark, bright))
    assert not result.passed and result.flip > 0.1


def test_a_furnace_that_loses_light_is_found(trial):
    """Miss the goal of a closed box whose walls return less than they should."""
    def run(trial):
        scene = stress.furnaces.closed_box(0.5, SIZE, metallic=0.0, roughness=1.0)
        scene.delta.materials["wall"] = scenes.principled(0.45, stress.furnaces.EMISSION, color=1.0, roughness=1.0)
        picture = trial.render(scene, Integrator.REFERENCE, 64, SIZE)
        trial.check_energy("box", cases.luminance(picture).mean() / (stress.furnaces.EMISSION / 0.5), 0.01)

    result = run_case(trial, Case("test: dim box", "", run))
    assert not result.passed and result.energy < 0.95


def test_scaling_and_moving_keep_the_picture_plane():
    """Scale lengths by a factor, power by its square, and add the offset to places alone."""
    room = scenes.room(SIZE)
    made = scenes.scaled_and_moved(room, 10.0, (100.0, 0.0, 0.0))
    lamp, before = made.delta.lights[1], room.delta.lights[1]
    assert lamp.color[0] == 100.0 * before.color[0] and lamp.radius == 10.0 * before.radius
    np.testing.assert_array_equal(lamp.transform[:3, 3], 10.0 * before.transform[:3, 3] + (100.0, 0.0, 0.0))
    assert made.camera.window == room.camera.window and made.camera.clip_end == 10.0 * room.camera.clip_end
    baked = scenes.scaled_and_moved(room, 1.0, (1e4, -1e4, 1e4), baked=True).delta
    still = scenes.scaled_and_moved(room, 1.0, baked=True).delta
    for key, mesh in baked.meshes.items():
        np.testing.assert_array_equal(mesh.positions - np.float32((1e4, -1e4, 1e4)), still.meshes[key].positions)


# The command.


def run_command(tmp_path, lines, **options):
    """Run the command with options; its lines go to `lines`."""
    parser = cli.make_parser()
    arguments = parser.parse_args(["stress", "--quick", "--device", "cpu"])
    arguments = argparse.Namespace(**{**vars(arguments), **options})

    class Lines:
        def print(self, line):
            lines.append(line)

        def progress(self, text):
            pass

    return command.run(arguments, Lines())


def test_command_writes_the_table(tmp_path):
    """Write Markdown and JSON, print a line for each case and the counts last, and exit with 0."""
    lines, table, figures = [], tmp_path / "stress.md", tmp_path / "stress.json"
    assert run_command(tmp_path, lines, only="sizes: *reference", markdown=table, json=figures) == 0
    assert lines[-1].startswith("2 cases, 0 failed; 0 non-finite and 0 negative of ") and len(lines) == 3
    found = json.loads(figures.read_text("utf-8"))
    assert [case["name"] for case in found["cases"]] == ["sizes: from 1 x 1, reference", "sizes: regions, reference"]
    assert all(case["passed"] and case["pictures"] for case in found["cases"])
    assert "| sizes: regions, reference | right shape |" in table.read_text("utf-8")


def test_command_exits_with_1_where_a_goal_is_missed(tmp_path, monkeypatch):
    """Say what was missed, count the case as failed, write it down and exit with 1."""
    def miss(trial):
        trial.check("light", 2.0, 0.0, 1.0)

    monkeypatch.setattr(stress, "all_cases", lambda: (Case("test: missed", "none", miss),))
    lines, table = [], tmp_path / "stress.md"
    assert run_command(tmp_path, lines, markdown=table) == 1
    assert lines[0].startswith("MISSED test: missed") and "light is 2, not in 0..1" in lines[1]
    assert lines[-1].startswith("1 cases, 1 failed; ")
    assert "- test: missed: light is 2, not in 0..1" in table.read_text("utf-8")


def test_wrong_arguments_give_a_sentence(capfd):
    """Refuse patterns that no case matches and devices that do not exist."""
    assert cli.main(["stress", "--only", "no such case"]) == 1
    assert "No case's name holds 'no such case'" in capfd.readouterr().err
    assert cli.main(["stress", "--device", "tpu"]) == 1
    assert "tpu" in capfd.readouterr().err


def test_names_are_unique_and_subjects_complete():
    """Name each case once; cover all that the stress test is for, each subject in the quick subset too."""
    assert len({case.name for case in ALL}) == len(ALL)
    groups = {"furnace", "scale", "offset", "seed", "inputs", "lamps", "skies", "halves", "materials", "meshes",
              "cameras", "sizes", "frames", "cache", "random"}
    assert {case.group for case in ALL} == {case.group for case in QUICK} == groups


def test_json_holds_every_figure():
    """Turn results into JSON whole."""
    result = dataclasses.replace(cases.Result("a: b", "goal"), checks=[cases.Check("x", 1.0, 0.0, 2.0)])
    found = json.loads(tables.as_json([result], "cpu"))["cases"][0]
    assert found["checks"] == [{"name": "x", "value": 1.0, "low": 0.0, "high": 2.0}] and found["passed"]
