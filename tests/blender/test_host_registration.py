# SPDX-License-Identifier: GPL-3.0-or-later
"""Registration with Blender: complete, clean, repeatable; and properties that agree with the settings."""

from __future__ import annotations

import pytest

SNAPSHOT = """
import bpy, burnish

def snapshot():
    handlers = {name: len(value) for name in dir(bpy.app.handlers)
                if isinstance(value := getattr(bpy.app.handlers, name), list)}
    engines = {panel.__name__: 'BURNISH' in panel.COMPAT_ENGINES for panel in bpy.types.Panel.__subclasses__()
               if hasattr(panel, "COMPAT_ENGINES") and not panel.__name__.startswith("BURNISH_")}
    ours = {name for name in dir(bpy.types) if "BURNISH" in name.upper()}
    return handlers, {name for name, on in engines.items() if on}, ours, hasattr(bpy.types.Scene, "burnish")
"""


def run(fresh_python, script: str):
    """Run a script and check that it ends well."""
    result = fresh_python(SNAPSHOT + script + "\nprint('done')")
    assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr
    assert "Error" not in result.stderr, result.stderr
    return result


def test_unregister_leaves_nothing(fresh_python):
    """Leave no class, property, handler or panel behind, twice in a row."""
    run(fresh_python, """
before = snapshot()
for _ in range(2):
    burnish.register()
    during = snapshot()
    assert during[3] and len(during[2]) > 20 and len(during[1]) > 150, during
    burnish.unregister()
    assert snapshot() == before, (snapshot(), before)
""")


def test_engine_can_be_chosen(fresh_python):
    """Offer the engine, and survive its removal while a scene uses it."""
    run(fresh_python, """
burnish.register()
bpy.context.scene.render.engine = 'BURNISH'
burnish.unregister()
burnish.register()
bpy.context.scene.render.engine = 'BURNISH'
burnish.unregister()
""")


def test_properties_agree_with_the_settings(fresh_python):
    """Give every setting a property with its default, range and help; read back as the settings' defaults."""
    run(fresh_python, """
import enum
from dataclasses import fields, is_dataclass
from burnish.engine.settings import RenderSettings
burnish.register()
from burnish.addon.extract.settings import settings_from_scene
from burnish.ui.properties import ELSEWHERE
scene = bpy.context.scene

def check(group, settings):
    for field in fields(settings):
        default = getattr(settings, field.name)
        if is_dataclass(default):
            check(getattr(group, field.name), default)
        elif field.name not in ELSEWHERE.get(type(settings), ()):
            prop = group.bl_rna.properties[field.name]
            if isinstance(default, enum.Enum):
                assert prop.default == default.name and all(item.description for item in prop.enum_items), field.name
                assert {item.identifier for item in prop.enum_items} == set(type(default).__members__)
            elif field.metadata["choices"]:
                assert prop.default == 'NONE', field.name
                assert [item.identifier for item in prop.enum_items] == ['NONE', *field.metadata["choices"]]
                for item in prop.enum_items[1:]:
                    assert item.description == field.metadata["choices"][item.identifier].removesuffix(".")
            elif not isinstance(default, bool):
                assert abs(prop.default - default) < 1e-6, field.name
                assert abs(prop.hard_min - field.metadata["low"]) <= 1e-6 * max(1, prop.hard_min), field.name
            assert prop.description == field.metadata["help"].removesuffix("."), field.name

check(scene.burnish, RenderSettings())
read = settings_from_scene(scene, viewport=False)
assert read == RenderSettings(), read
scene.burnish.film.pixel_filter = 'GAUSSIAN'
scene.burnish.light_paths.max_bounces = 7
read = settings_from_scene(scene, viewport=False)
assert read.film.pixel_filter.value == "gaussian" and read.light_paths.max_bounces == 7
scene.burnish.debug.view = 'probes.radiance'
assert settings_from_scene(scene, viewport=True).debug.view == "probes.radiance"
burnish.unregister()
""")


def test_all_panels_name_real_properties(fresh_python):
    """Draw every panel over a recording layout: each property and operator that a panel names exists."""
    run(fresh_python, """
from types import SimpleNamespace
burnish.register()
from burnish import ui
from burnish.addon import report
from burnish.engine.report import Report, ReportKind
entries = Report()
entries.add(ReportKind.SKIPPED, "material 'Floor'", "x", 3)
entries.add(ReportKind.INFO, "", "y")
report.publish("Render", entries, [("Triangles", "3")])
drawn = set()

class Layout:
    def prop(self, data, name, **options):
        assert name in data.bl_rna.properties, (data, name)
        drawn.add(name)
    def operator(self, name, **options):
        module, function = name.split(".")
        getattr(getattr(bpy.ops, module), function).get_rna_type()
        return SimpleNamespace()
    def operator_menu_enum(self, name, property, text):
        assert property in getattr(bpy.ops, name.split(".")[0]).apply_preset.get_rna_type().properties
        assert text == "Preset: Balanced", text
    def label(self, text="", **options): assert isinstance(text, str)
    def separator(self): pass
    def template_preview(self, data): pass
    def template_curve_mapping(self, data, name): self.prop(data, name)
    def prop_search(self, data, name, source, items, **options):
        assert items in source.bl_rna.properties, (source, items)
        self.prop(data, name)
    def template_list(self, kind, identifier, data, name, active_data, active_name, **options):
        assert hasattr(bpy.types, kind)
        self.prop(data, name)
        self.prop(active_data, active_name)
    def menu(self, name, **options): assert hasattr(bpy.types, name), name
    def template_node_view(self, tree, node, socket): drawn.add(node.name)
    def row(self, **options): return Layout()
    column = box = split = row

bpy.ops.mesh.primitive_cube_add()
cube = bpy.context.object
material = bpy.data.materials.new("Floor")
scene = bpy.context.scene
scene.render.engine = 'BURNISH'
scene.burnish.debug.view = 'cache.light'
lamps = [bpy.data.lights.new(kind, kind) for kind in ('POINT', 'SUN', 'SPOT', 'AREA')]
lamps[3].shape = 'RECTANGLE'
shading = SimpleNamespace(type='RENDERED', bl_rna=bpy.types.View3DShading.bl_rna)
panels = [cls for cls in ui._classes() if issubclass(cls, bpy.types.Panel)]
drawn_by = {'REFERENCE': set(), 'REALTIME': set()}
for light, integrator in zip(lamps, ('REFERENCE', 'REALTIME') * 2):
    scene.burnish.sampling.integrator = integrator
    drawn = drawn_by[integrator]
    context = SimpleNamespace(scene=scene, light=light, object=cube, material=material, world=scene.world,
                              view_layer=scene.view_layers[0], engine='BURNISH',
                              space_data=SimpleNamespace(shading=shading))
    for panel in panels:
        if panel.poll(context):
            instance = SimpleNamespace(layout=Layout())
            instance.split_layout = lambda layout=instance.layout: layout
            if hasattr(panel, "_draw_shape"):
                instance._draw_shape = panel._draw_shape
            panel.draw(instance, context)
            if hasattr(panel, "draw_header"):
                panel.draw_header(instance, context)
both = {"integrator", "samples", "motion_steps", "motion_blur_shutter_curve", "energy", "use_pass_emit",
        "visible_shadow", "max_bounces", "lightgroup", "use_pass_diffuse_color", "use_pass_glossy_direct",
        "use_pass_transmission_indirect", "use_pass_mist", "aovs", "use_pass_cryptomatte_asset"}
assert both | {"spot_size", "lightgroups"} <= drawn_by['REFERENCE'], drawn_by
from burnish.engine.settings import (
    CacheSettings, DenoiserSettings, DirectLightSettings, ProbeSettings, ReflectionSettings, setting_info)
groups = (CacheSettings, DenoiserSettings, DirectLightSettings, ProbeSettings, ReflectionSettings)
realtime = {name for group in groups for name in setting_info(group)} | {"view", "viewport_preset"}
assert both | {"angle", "size_y"} | realtime <= drawn_by['REALTIME'], (drawn_by, realtime)
# Final renders of both integrators can be denoised.
assert realtime & drawn_by['REFERENCE'] == {"final_denoise"}, drawn_by
burnish.unregister()
""")


def test_presets_set_the_scene(fresh_python):
    """Apply each preset and recognise it; give viewports one of their own."""
    run(fresh_python, """
from burnish.engine.presets import PRESETS, apply_preset
from burnish.engine.settings import Preset, RenderSettings
burnish.register()
from burnish.addon.extract.settings import settings_from_scene
from burnish.ui.presets import current_preset
scene = bpy.context.scene
scene.burnish.sampling.samples = 7
assert current_preset(scene.burnish) == Preset.BALANCED
for preset in PRESETS:
    assert bpy.ops.burnish.apply_preset(preset=preset.name) == {'FINISHED'}
    assert current_preset(scene.burnish) == preset
    read = settings_from_scene(scene, viewport=False)
    assert read.sampling.samples == 7 and read.cache == apply_preset(RenderSettings(), preset).cache
    assert read.reflections == apply_preset(RenderSettings(), preset).reflections
scene.burnish.reflections.roughness_traced = 0.3
assert current_preset(scene.burnish) == Preset.CUSTOM
scene.burnish.sampling.viewport_preset = 'DRAFT'
assert settings_from_scene(scene, viewport=True).probes.spawn_tile == 32
assert settings_from_scene(scene, viewport=False).probes.spawn_tile == 16
burnish.unregister()
""")


def test_select_and_diagnostics_operators(fresh_python):
    """Select all users of a reported material; diagnostics name the versions."""
    run(fresh_python, """
burnish.register()
bpy.ops.mesh.primitive_cube_add()
cube = bpy.context.object
material = bpy.data.materials.new("It's")
cube.data.materials.append(material)
bpy.ops.object.select_all(action='DESELECT')
assert bpy.ops.burnish.select_owner(owner="material 'It's'") == {'FINISHED'}
assert bpy.context.selected_objects == [cube]
assert bpy.ops.burnish.select_owner(owner=f"object '{bpy.context.scene.camera.name}'") == {'FINISHED'}
assert bpy.context.selected_objects == [bpy.context.scene.camera]
assert bpy.ops.burnish.select_owner(owner="everything") == {'CANCELLED'}
from burnish.addon.services import diagnostics_text
text = diagnostics_text()
for word in ("Burnish: ", "Blender: ", "Warp: ", "NumPy: ", "OpenImageIO: ", "Device: ", "Kernel cache: "):
    assert word in text, text
assert "not usable" not in text and "unknown" not in text, text
burnish.unregister()
""")


def test_preferences_choose_the_kernel_cache(fresh_python, tmp_path):
    """Pass the preferences' folder on to Warp when it is set, and again when Burnish is switched on."""
    script = """
import os
os.environ.pop("WARP_CACHE_PATH", None)
folder = os.path.join(sys.argv[1], "kernels")
from burnish.engine import kernel_cache
burnish.register()
bpy.context.preferences.addons.new().module = "burnish"
chosen = bpy.context.preferences.addons["burnish"].preferences
chosen.kernel_cache = folder
assert kernel_cache.chosen_folder() == folder
chosen.kernel_cache = ""
assert kernel_cache.chosen_folder() is None
chosen.kernel_cache = folder
burnish.unregister()
kernel_cache.set_cache_folder("")
burnish.register()
assert kernel_cache.chosen_folder() == folder
burnish.unregister()
"""
    result = fresh_python(SNAPSHOT + script + "\nprint('done')", tmp_path)
    assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr


@pytest.mark.slow
def test_importing_the_engine_loads_no_bpy(fresh_python):
    """Import the package and its engine without bpy."""
    result = fresh_python("import sys, burnish, burnish.addon, burnish.engine.session\n"
                          "assert 'bpy' not in sys.modules; print('done')")
    assert result.stdout.strip() == "done", result.stderr


def test_registering_loads_no_warp(fresh_python):
    """Register quickly: Warp and OpenImageIO are loaded by the first render only."""
    run(fresh_python, """
import sys
burnish.register()
assert "warp" not in sys.modules and "OpenImageIO" not in sys.modules
burnish.unregister()
""")
