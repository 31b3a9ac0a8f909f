# SPDX-License-Identifier: GPL-3.0-or-later
"""The farm job template: whole by Open Job Description's own names, and in step with the add-on."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TYPES = {"STRING", "PATH", "INT", "FLOAT"}
FIELDS = {"name", "type", "description", "default", "minLength", "allowedValues", "objectType", "dataFlow",
          "userInterface"}


@pytest.fixture(scope="module")
def template() -> dict:
    """Return the template, which is JSON, as Open Job Description allows beside YAML."""
    return json.loads((ROOT / "docs" / "openjd" / "template.json").read_text("utf-8"))


def test_template_is_whole(template):
    """Name the revision, declare each parameter once with what belongs to it, and run one action for each task."""
    assert template["specificationVersion"] == "jobtemplate-2023-09"
    assert set(template) == {"specificationVersion", "name", "description", "parameterDefinitions", "jobEnvironments",
                             "steps"}
    parameters = template["parameterDefinitions"]
    names = [parameter["name"] for parameter in parameters]
    assert len(set(names)) == len(names) and all(re.fullmatch(r"[A-Za-z_]\w{0,63}", name) for name in names)
    for parameter in parameters:
        assert parameter["type"] in TYPES and set(parameter) <= FIELDS, parameter
        assert ("objectType" in parameter) == (parameter["type"] == "PATH"), parameter
        assert parameter.get("default") in parameter.get("allowedValues", [parameter.get("default")]), parameter
    step, = template["steps"]
    assert set(step) == {"name", "parameterSpace", "script"} and set(step["script"]["actions"]) == {"onRun"}
    task, = step["parameterSpace"]["taskParameterDefinitions"]
    assert task == {"name": "Frame", "type": "INT", "range": "{{Param.Frames}}"}


def test_template_names_what_there_is(template):
    """Refer to parameters that are declared, use all of them, and ask for progress lines by the add-on's variable."""
    declared = {f"Param.{parameter['name']}" for parameter in template["parameterDefinitions"]}
    used = set(re.findall(r"{{\s*([\w.]+)\s*}}", json.dumps(template)))
    assert used == declared | {"Task.Param.Frame"}
    environment, = template["jobEnvironments"]
    variable, = environment["variables"]
    assert f'OPENJD_VARIABLE = "{variable}"' in (ROOT / "addon" / "progress.py").read_text("utf-8")


def test_template_renders_a_frame(template):
    """Set engine, path and format before the frame, which Blender renders as soon as it reads it; then look for it."""
    arguments = template["steps"][0]["script"]["actions"]["onRun"]["args"]
    options = dict(zip(arguments[::2], arguments[1::2], strict=True))
    assert list(options) == ["-b", "-E", "-o", "-F", "-x", "-f", "--python-exit-code", "--python-expr"]
    assert options["-E"] == "BURNISH" and options["-f"] == "{{Task.Param.Frame}}"
    ast.parse(options["--python-expr"].replace("{{Task.Param.Frame}}", "7"))


def test_template_s_check_finds_pictures(template, run_python, tmp_path):
    """Fail a task whose picture is not there, in each format, and no other."""
    arguments = template["steps"][0]["script"]["actions"]["onRun"]["args"]
    check = arguments[-1].replace("{{Task.Param.Frame}}", "7")
    format_names = next(each for each in template["parameterDefinitions"] if each["name"] == "Format")["allowedValues"]
    result = run_python(f"""
import bpy, os
scene = bpy.context.scene
scene.render.resolution_x = scene.render.resolution_y = 8
scene.render.engine = 'BLENDER_WORKBENCH'
scene.render.use_file_extension = True
for name in {format_names!r}:
    scene.render.image_settings.media_type = 'MULTI_LAYER_IMAGE' if "LAYER" in name else 'IMAGE'
    scene.render.image_settings.file_format = name
    scene.render.filepath = {str(tmp_path)!r} + "/" + name + "/frame_####"
    try:
        exec({check!r})
        raise SystemExit("nothing missed")
    except AssertionError:
        pass
    os.makedirs(os.path.dirname(scene.render.frame_path(frame=7)))
    open(scene.render.frame_path(frame=7), "w").close()
    assert "frame_0007." in scene.render.frame_path(frame=7)
    exec({check!r})
print("done")
""")
    assert result.stdout.rstrip().endswith("done"), result.stdout + result.stderr
