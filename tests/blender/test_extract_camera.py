# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras: points must land where Blender itself projects them."""

from __future__ import annotations

import pytest

SETUP = r'''
import itertools, math, random
from types import SimpleNamespace
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector
from burnish.addon.extract.camera import border_from_view, camera_from_scene, camera_from_view
from burnish.engine.errors import InvalidScene
from burnish.engine.scene import CameraKind

scene = bpy.context.scene
camera = link("Camera", bpy.data.cameras.new("Camera"))
scene.camera = camera
camera.location, camera.rotation_euler, camera.scale = (1, -4, 2), (1.1, 0.2, 0.4), (2, 3, 0.5)
data = camera.data


def evaluated():
    """Evaluate the scene; returns (depsgraph, camera)."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    return depsgraph, camera.evaluated_get(depsgraph)


def project(result, point):
    """Return where CameraData puts a world point in the frame, 0..1."""
    local = np.linalg.inv(np.array(result.transform).reshape(4, 4)) @ [*point, 1.0]
    depth = -local[2] if result.kind == CameraKind.PERSPECTIVE else 1.0
    left, right, bottom, top = result.window
    return ((local[0] / depth - left) / (right - left), (local[1] / depth - bottom) / (top - bottom))


def refusal(function, *arguments):
    """Return the text of the InvalidScene that a call raises."""
    try:
        function(*arguments)
    except InvalidScene as error:
        return str(error)
'''


def test_final_camera_projects_as_blender(run_extraction):
    """Agree with world_to_camera_view for every lens, fit, shift, aspect and shape of frame."""
    result = run_extraction(SETUP + r'''
worst, worst_matrix, cases = 0.0, 0.0, 0
shapes = ((1920, 1080), (600, 900), (500, 500))
for kind, fit, size, aspect, shift in itertools.product(
        ('PERSP', 'ORTHO'), ('AUTO', 'HORIZONTAL', 'VERTICAL'), shapes, ((1, 1), (2, 1), (1, 1.5)),
        ((0, 0), (0.3, -0.2))):
    data.type, data.sensor_fit, data.lens, data.ortho_scale = kind, fit, 35, 5
    data.sensor_width, data.sensor_height = 32, 18
    data.shift_x, data.shift_y = shift
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
    depsgraph, item = evaluated()
    found = camera_from_scene(depsgraph.scene_eval, item, *size)
    for number in range(5):
        point = item.matrix_world.normalized() @ Vector((0.4 * number - 1, 0.7 - 0.3 * number, -2 - number))
        expected = world_to_camera_view(scene, camera, point)
        worst = max(worst, *(abs(a - b) for a, b in zip(project(found, point), expected[:2])))
        matrix = item.calc_matrix_camera(depsgraph, x=size[0], y=size[1], scale_x=aspect[0], scale_y=aspect[1])
        clip = matrix @ (item.matrix_world.normalized().inverted() @ point).to_4d()
        worst_matrix = max(worst_matrix, *(abs(a - (b / clip.w * 0.5 + 0.5))
                                           for a, b in zip(project(found, point), clip[:2])))
    cases += 1
lengths = np.linalg.norm(np.array(found.transform).reshape(4, 4)[:3, :3], axis=0)
same = camera_from_scene(depsgraph.scene_eval, item, *size)
finish(worst=worst, worst_matrix=worst_matrix, cases=cases, lengths=lengths.tolist(), same=found == same,
       hashable=len({found, same}))
''')
    assert result["cases"] == 108
    assert result["worst"] < 1e-5 and result["worst_matrix"] < 1e-5, "float32 matrices"
    assert result["lengths"] == pytest.approx([1.0, 1.0, 1.0])
    assert result["same"] and result["hashable"] == 1


def test_depth_of_field(run_extraction):
    """Follow Cycles: radius lens / (2 f-stop), distance along the view axis to the focus object."""
    result = run_extraction(SETUP + r'''
def lens():
    depsgraph, item = evaluated()
    found = camera_from_scene(depsgraph.scene_eval, item, 100, 50)
    return [found.aperture_radius, found.focus_distance, found.aperture_blades, found.aperture_rotation,
            found.aperture_ratio]
data.lens = 50
off = lens()[0]
dof = data.dof
dof.use_dof, dof.focus_distance, dof.aperture_fstop = True, 3.5, 2.0
dof.aperture_blades, dof.aperture_rotation, dof.aperture_ratio = 6, 0.5, 1.5
distance = lens()
dof.focus_object = link("Target", None)
target = dof.focus_object
depsgraph, item = evaluated()
target.matrix_world = item.matrix_world.normalized() @ Matrix.Translation((1.5, -2.0, -7.25))
focused = lens()[1]
data.type = 'ORTHO'
finish(off=off, distance=distance, focused=focused, orthographic=lens()[0])
''')
    assert result["off"] == 0.0
    assert result["distance"] == pytest.approx([0.0125, 3.5, 6, 0.5, 1.5])
    assert result["focused"] == pytest.approx(7.25, abs=1e-4)
    assert result["orthographic"] == pytest.approx(0.25)


def test_view_cameras(run_extraction):
    """Take lens, zoom and shift of a viewport from its window matrix, in all three kinds of view."""
    result = run_extraction(SETUP + r'''
data.lens, data.shift_x, data.shift_y, data.clip_end = 35, 0.2, -0.1, 77
data.dof.use_dof = True
region = SimpleNamespace(width=800, height=600)
v3d = SimpleNamespace(clip_start=0.5, clip_end=500.0, use_local_camera=False, camera=None, use_render_border=False,
                      render_border_min_x=0.25, render_border_max_x=0.75, render_border_min_y=0.0,
                      render_border_max_y=0.5)
depsgraph, item = evaluated()
pose = item.matrix_world.normalized()
worst, kinds, found = 0.0, [], {}
for mode, kind in (("CAMERA", 'PERSP'), ("CAMERA", 'ORTHO'), ("PERSP", 'PERSP'), ("ORTHO", 'ORTHO')):
    data.type = kind
    depsgraph, item = evaluated()
    window = item.calc_matrix_camera(depsgraph, x=800, y=600)
    rv3d = SimpleNamespace(view_perspective=mode, window_matrix=window, view_matrix=pose.inverted())
    result = camera_from_view(region, rv3d, v3d, depsgraph)
    found[mode + kind] = [result.clip_start, result.clip_end, result.aperture_radius > 0.0]
    kinds.append(result.kind.value)
    for number in range(5):
        point = pose @ Vector((0.4 * number - 1, 0.7 - 0.3 * number, -2 - number))
        clip = window @ rv3d.view_matrix @ point.to_4d()
        worst = max(worst, *(abs(a - (b / clip.w * 0.5 + 0.5)) for a, b in zip(project(result, point), clip[:2])))
behind = np.array(result.transform).reshape(4, 4)[:3, 3] - np.array(pose.translation)
rv3d.view_perspective = "PERSP"
border = [border_from_view(region, rv3d, v3d, depsgraph)]
v3d.use_render_border = True
border.append(border_from_view(region, rv3d, v3d, depsgraph))
rv3d.view_perspective = "CAMERA"
data.show_passepartout = False
depsgraph, item = evaluated()
border.append(border_from_view(region, rv3d, v3d, depsgraph))
data.show_passepartout, data.passepartout_alpha = True, 1.0
scene.render.resolution_x, scene.render.resolution_y = 800, 300
depsgraph, item = evaluated()
border.append(border_from_view(region, rv3d, v3d, depsgraph))
scene.render.use_border, scene.render.border_min_x, scene.render.border_max_x = True, 0.5, 1.0
scene.render.border_min_y, scene.render.border_max_y = 0.0, 1.0
border.append(border_from_view(region, rv3d, v3d, depsgraph))
finish(worst=worst, kinds=kinds, found=found, behind=[float(np.linalg.norm(behind)), float(behind @ pose.col[2][:3])],
       border=border)
''')
    assert result["worst"] < 1e-5
    assert result["kinds"] == ["perspective", "orthographic", "perspective", "orthographic"]
    assert result["found"]["CAMERAPERSP"] == pytest.approx([0.1, 77.0, True])
    assert result["found"]["PERSPPERSP"] == pytest.approx([0.5, 500.0, False])
    assert result["found"]["ORTHOORTHO"] == pytest.approx([0.0, 500.0, False])
    assert result["behind"] == pytest.approx([250.0, 250.0], rel=1e-4), "what lies behind the view point shows too"
    whole, region_part, camera_all, frame, scene_part = result["border"]
    assert whole is None and region_part == [200, 0, 400, 300] and camera_all is None
    # The frame keeps its width, and its centre is where the shift puts it: both windows share the plane.
    assert frame[0] == 0 and frame[2] == pytest.approx(800, abs=1) and frame[3] == pytest.approx(300, abs=1)
    assert scene_part[0] == pytest.approx(400, abs=1) and scene_part[3] == frame[3]


def test_panoramas_in_the_viewport(run_extraction):
    """Show the panorama where Blender draws the camera's frame, and what is around it beyond its edges."""
    result = run_extraction(SETUP + r'''
data.type, data.shift_x, data.shift_y, data.lens = 'PANO', 0.1, -0.05, 35
data.dof.use_dof = True
scene.render.resolution_x, scene.render.resolution_y = 800, 400
scene.render.resolution_percentage = 50
region = SimpleNamespace(width=800, height=400)
v3d = SimpleNamespace(clip_start=0.5, clip_end=500.0, use_local_camera=False, camera=None, use_render_border=False)
worst, kinds, wider = 0.0, [], []
for kind in data.bl_rna.properties["panorama_type"].enum_items.keys():
    data.panorama_type = kind
    depsgraph, item = evaluated()
    final = camera_from_scene(depsgraph.scene_eval, item, 800, 400)
    window = item.calc_matrix_camera(depsgraph, x=800, y=400)
    rv3d = SimpleNamespace(view_perspective="CAMERA", window_matrix=window,
                           view_matrix=item.matrix_world.normalized().inverted())
    shown = camera_from_view(region, rv3d, v3d, depsgraph)
    kinds.append(final.kind.value)
    worst = max(worst, *(abs(a - b) for a, b in zip(shown.window, final.window)),
                *(abs(a - b) for a, b in zip(shown.transform, final.transform)))
    assert (shown.kind, shown.fov, shown.polynomial) == (final.kind, final.fov, final.polynomial)
    assert (shown.aperture_radius, shown.clip_end) == (final.aperture_radius, final.clip_end)
    # Zoomed out: the frame is half as wide, its middle in the middle.
    rv3d.window_matrix = Matrix.Diagonal((0.5, 0.5, 1.0, 1.0)) @ window
    zoomed = camera_from_view(region, rv3d, v3d, depsgraph)
    for low in (0, 2):
        size, middle = final.window[low + 1] - final.window[low], final.window[low + 1] + final.window[low]
        wider += [(zoomed.window[low + 1] - zoomed.window[low]) / size,
                  1.0 + zoomed.window[low + 1] + zoomed.window[low] - middle]
data.show_passepartout, data.passepartout_alpha = True, 1.0
depsgraph, item = evaluated()
finish(worst=worst, kinds=kinds, wider=wider, border=border_from_view(region, rv3d, v3d, depsgraph))
''')
    assert result["worst"] < 1e-4, "float32 matrices"
    assert len(set(result["kinds"])) == 7 and not {"perspective", "orthographic"} & set(result["kinds"])
    assert result["wider"][0::2] == pytest.approx([2.0] * 14, abs=1e-4)
    assert result["wider"][1::2] == pytest.approx([1.0] * 14, abs=1e-3)
    assert result["border"] == pytest.approx([200, 100, 400, 200], abs=1)


def test_cameras_that_cannot_be_used(run_extraction):
    """Refuse missing and custom cameras, empty panoramas and broken transforms; look through other objects."""
    result = run_extraction(SETUP + r'''
depsgraph, item = evaluated()
missing = refusal(camera_from_scene, depsgraph.scene_eval, None, 10, 10)
empty = refusal(camera_from_scene, depsgraph.scene_eval, item, 0, 10)
data.type = 'CUSTOM'
depsgraph, item = evaluated()
custom = refusal(camera_from_scene, depsgraph.scene_eval, item, 10, 10)
data.type, data.panorama_type = 'PANO', 'EQUIRECTANGULAR'
data.latitude_min = data.latitude_max = 0.5
depsgraph, item = evaluated()
panorama = refusal(camera_from_scene, depsgraph.scene_eval, item, 10, 10)
data.panorama_type = 'FISHEYE_LENS_POLYNOMIAL'
for power in range(1, 5):
    setattr(data, f"fisheye_polynomial_k{power}", 0.0)
depsgraph, item = evaluated()
polynomial = refusal(camera_from_scene, depsgraph.scene_eval, item, 10, 10)
data.type = 'PERSP'
camera.scale = (0, 1, 1)
depsgraph, item = evaluated()
flat = refusal(camera_from_scene, depsgraph.scene_eval, item, 10, 10)
spot = link("Spot", bpy.data.lights.new("Spot", 'SPOT')); spot.data.spot_size = math.radians(90)
depsgraph, item = evaluated()
window = camera_from_scene(depsgraph.scene_eval, spot.evaluated_get(depsgraph), 100, 100).window
finish(missing=missing, empty=empty, custom=custom, panorama=panorama, polynomial=polynomial, flat=flat, window=window)
''')
    assert "no camera" in result["missing"] and "0 x 10" in result["empty"]
    assert "'Camera' is custom" in result["custom"] and "Panoramic" in result["custom"]
    assert "panorama of camera 'Camera' ends where it begins" in result["panorama"]
    assert "polynomial of camera 'Camera'" in result["polynomial"] and "K1" in result["polynomial"]
    assert "'Camera' has a scale of zero" in result["flat"]
    # Cycles takes a lens of 16 mm / tan(half the cone) on a 36 mm sensor.
    assert result["window"] == pytest.approx([-1.125, 1.125, -1.125, 1.125])
