# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings: from the scene's property groups, or defaults without them."""

from __future__ import annotations

import pytest


def test_settings_without_and_with_the_add_on(run_extraction):
    """Use defaults without the groups, the groups' values with them, and Blender's own film transparency."""
    result = run_extraction(r'''
from burnish.addon.extract.settings import settings_from_scene
from burnish.engine.settings import Device, PixelFilter, RenderSettings
scene = bpy.context.scene
bare = settings_from_scene(scene, False) == RenderSettings()
scene.render.film_transparent = True
transparent = settings_from_scene(scene, False).film.transparent
from burnish.ui import properties
properties.register()
registered = settings_from_scene(scene, False)
defaults = registered.sampling == RenderSettings().sampling and registered.light_paths == RenderSettings().light_paths
scene.burnish.device = 'CPU'
scene.burnish.sampling.samples, scene.burnish.sampling.viewport_samples = 33, 77
scene.burnish.film.pixel_filter, scene.burnish.film.exposure = 'BOX', 2.5
changed, viewport = settings_from_scene(scene, False), settings_from_scene(scene, True)
evaluated = settings_from_scene(bpy.context.evaluated_depsgraph_get().scene_eval, False)
finish(bare=bare, transparent=transparent, defaults=defaults, device=changed.device is Device.CPU,
       filter=changed.film.pixel_filter is PixelFilter.BOX, exposure=changed.film.exposure,
       samples=[changed.sampling.samples, viewport.sampling.samples, viewport.sampling.viewport_samples],
       evaluated=evaluated == changed)
''')
    assert result["bare"] and result["transparent"] and result["defaults"]
    assert result["device"] and result["filter"] and result["exposure"] == pytest.approx(2.5)
    assert result["samples"] == [33, 77, 77]
    assert result["evaluated"]
