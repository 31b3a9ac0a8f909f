# SPDX-License-Identifier: GPL-3.0-or-later
"""Importing the engine before the first picture: when somebody wants it, in a thread, and never in Blender's way."""

from __future__ import annotations

import pytest

START = """
import sys, threading, bpy, burnish
burnish.register()
from burnish.addon import early_import
SESSION = "burnish.engine.session"

def threads():
    return [thread for thread in threading.enumerate() if thread.name == "burnish import"]
"""


def run(fresh_python, script: str) -> None:
    """Run a script with the add-on and check that it ends well."""
    result = fresh_python(START + script + "\nburnish.unregister()\nassert not threads()\nprint('done')")
    assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr


def test_a_file_with_the_engine_begins_the_import(fresh_python):
    """Import all that a picture needs once a scene has the engine, and nothing for another one or once more."""
    run(fresh_python, """
bpy.context.scene.render.engine = 'CYCLES' if hasattr(bpy.types.Scene, 'cycles') else 'BLENDER_EEVEE'
early_import.after_load()
assert not threads() and SESSION not in sys.modules
bpy.context.scene.render.engine = 'BURNISH'
early_import.after_load()
[thread] = threads()
early_import.after_load()
assert len(threads()) <= 1
thread.join()
assert SESSION in sys.modules and "burnish.kernels.wide_bvh_build" in sys.modules
early_import.after_load()
assert not threads()
""")


@pytest.mark.slow
def test_stopping_leaves_the_rest(fresh_python):
    """Stop between two modules; what was left out is imported when it is asked for."""
    run(fresh_python, """
early_import.begin()
early_import.stop()
assert not threads() and SESSION not in sys.modules
import burnish.engine.session
""")


def test_nothing_waits_without_a_window(fresh_python):
    """Leave no handler where Blender has no window: there the picture is wanted at once."""
    run(fresh_python, """
assert bpy.app.background and early_import.after_load not in bpy.app.handlers.load_post
""")
