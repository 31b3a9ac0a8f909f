# SPDX-License-Identifier: GPL-3.0-or-later
"""Structs shared by the kernels: scene, shading point, closure, BSDF, path state. No functions, no kernels.

Spaces: positions are world space relative to the scene's origin (subtracted in float64 on the host), float32.
Directions are unit length and point away from the surface: `wo` towards the viewer, `wi` towards the light.
"""

from __future__ import annotations

import warp as wp

from .shading_types import Bsdf, BsdfSample, BsdfValue, Closure, ShadingPoint, Tables

__all__ = [
    "Bsdf", "BsdfSample", "BsdfValue", "Closure", "Environment", "FlatTriangles", "FrameData", "Geometry", "Instance",
    "Light", "Lights", "Material", "Materials", "Scene", "ShadingPoint", "Tables", "TextureInfo", "Textures",
]

# Ray kinds and object flags: the bits of engine.scene.Visibility.
VISIBLE_CAMERA = wp.constant(1)
VISIBLE_DIFFUSE = wp.constant(2)
VISIBLE_GLOSSY = wp.constant(4)
VISIBLE_TRANSMISSION = wp.constant(8)
VISIBLE_SHADOW = wp.constant(16)
VISIBLE_VOLUME = wp.constant(32)
HOLDOUT = wp.constant(64)
SHADOW_CATCHER = wp.constant(128)
DEPTH_SHIFT = wp.constant(21)
"""A path's kind has from here on how many of its rays were diffuse, then glossy, then transmitted: DEPTH_BITS each"""
DEPTH_BITS = wp.constant(3)
DEPTH_MASK = wp.constant(7)
LINK_SHIFT = wp.constant(8)
"""The bits from here on number the set of objects that a light is for; 0: everything. See light_linking.py"""

# Kinds of closure that a material program can end in.
CLOSURE_NONE = wp.constant(0)
CLOSURE_PRINCIPLED = wp.constant(1)
CLOSURE_DIFFUSE = wp.constant(2)
CLOSURE_GLOSSY = wp.constant(3)
CLOSURE_GLASS = wp.constant(4)
CLOSURE_REFRACTION = wp.constant(5)
CLOSURE_TRANSLUCENT = wp.constant(6)
CLOSURE_SHEEN = wp.constant(7)
CLOSURE_TOON_DIFFUSE = wp.constant(8)
CLOSURE_TOON_GLOSSY = wp.constant(9)
CLOSURE_HAIR = wp.constant(10)

# Light.kind
LIGHT_POINT = wp.constant(0)
LIGHT_SUN = wp.constant(1)
LIGHT_SPOT = wp.constant(2)
LIGHT_AREA = wp.constant(3)
LIGHT_TRIANGLE = wp.constant(4)
LIGHT_ENVIRONMENT = wp.constant(5)

# Light.flags
LIGHT_SPHERE = wp.constant(1)
LIGHT_ELLIPSE = wp.constant(2)
LIGHT_NO_SHADOW = wp.constant(4)
LIGHT_HITTABLE = wp.constant(8)
"""Has an extent and takes part in multiple importance sampling: rays can meet it"""

# Material.flags
MATERIAL_TRANSPARENCY = wp.constant(1)
MATERIAL_EMISSION = wp.constant(2)
MATERIAL_CONSTANT_EMISSION = wp.constant(4)
MATERIAL_LEAN = wp.constant(8)
"""The lean machine (node_lean.py) runs its surface program"""
MATERIAL_LEAN_TRANSPARENCY = wp.constant(16)
"""The same of its transparency program"""
MATERIAL_LEAN_FLAT = wp.constant(32)
"""The same of its flat program: the surface program without normal maps and bump"""
MATERIAL_PLAIN = wp.constant(64)
"""The lean machine runs its surface program, of which plain glass may be a part (node_lean.plain_bsdf)"""
MATERIAL_SUBSURFACE = wp.constant(128)
"""Scatters light below the surface: the path tracer shades it by kernels of its own (reference_subsurface.py)"""
MATERIAL_SUBSURFACE_BUMP = wp.constant(256)
"""The same with a normal map or bump, which shades light where it comes out too"""
MATERIAL_EXACT = wp.constant(512)
"""Has a program of its own for the camera's view and the path tracer: the end before its surface program says where"""
MATERIAL_LOOKS = wp.constant(1024)
"""That program sends rays within the object (node_rays.py)"""
MATERIAL_HAIR = wp.constant(2048)
"""Has a program of its own, for the path tracer, of closures of hair (hair_lobes.py): the same end says where"""
MATERIAL_STRANDS = wp.constant(4096)
"""Its closures are hair's alone: real-time frames scatter light in it, too"""
MATERIAL_LEAN_STRANDS = wp.constant(8192)
"""The lean machine of hair (node_strands.py) runs that program"""
MATERIAL_FLAT_SHIFT = wp.constant(16)
"""The bits from here on hold how many instructions after the surface program the flat one starts; 0: they are one"""


@wp.struct
class Instance:
    """One placed mesh. Rows of the affine transforms; object space is the mesh's own."""

    to_world: wp.mat44
    to_object: wp.mat44
    mesh: int
    """Row of Geometry.uv_offsets and attribute_offsets"""
    triangle_offset: int
    """First triangle of the mesh in Geometry.triangles"""
    material_offset: int
    """First slot in Materials.instance_materials"""
    material_count: int
    instanced: int
    """1 where its triangles lie in object space (wide_instances.py), 0 where they are flattened"""
    visibility: int
    flipped: int
    """1 where the transform mirrors (negative determinant)"""
    object_id: int
    pass_index: int
    random: float
    """Object Info's random value, 0..1"""
    color: wp.vec4
    generated_location: wp.vec3
    generated_size: wp.vec3
    receives: int
    """Bit 0, and one for each set of receivers that it is in"""
    walk_mesh: wp.uint64
    """Object-space wp.Mesh of all triangles where light is scattered below the surface, else 0. Rows have a multiple of
    16 bytes, see wide_loads.py"""


@wp.struct
class FlatTriangles:
    """Triangles in world space in an 8-wide BVH (wide_bvh.py)."""

    nodes: wp.array[wp.uint32]
    """Empty where there are no triangles"""
    triangles: wp.array[wp.uint32]
    faces: wp.array[wp.vec2i]
    """(instance, triangle) per face; triangle indexes Geometry.triangles"""
    decided: int
    """1: rays decide by themselves which of them stop them (opacity_answers.py)"""
    tubes: int
    """1: some references are tubes (tube_items.py)"""


@wp.struct
class InstanceLevel:
    """Instances in an 8-wide BVH over those of their meshes (wide_instances.py)."""

    nodes: wp.uint64
    """Address, 0 where there are none"""
    records: wp.uint64
    decided: int
    tubes: int
    """As FlatTriangles has them"""


@wp.struct
class Geometry:
    """All triangles and the structures over them."""

    flat: FlatTriangles
    """The flattened opaque triangles"""
    flat_filtered: FlatTriangles
    """The flattened triangles that need a test per hit"""
    instanced: InstanceLevel
    """The opaque triangles of instances that are not flattened"""
    instanced_filtered: InstanceLevel
    """Those that need a test per hit (transparency, ray visibility)"""
    mesh_faces: wp.array[int]
    """Triangle (index into `triangles`) per face of the object-space structures"""
    instances: wp.array[Instance]
    triangles: wp.array[wp.vec3i]
    """Vertex indices into `positions`"""
    slots: wp.array[int]
    """Material slot per triangle"""
    positions: wp.array[wp.vec3]
    """Object space"""
    corners: wp.array[wp.vec4]
    """Object space, 6 a triangle: its vertices' positions, the first one's w the material slot, then its normals"""
    uvs: wp.array[wp.vec2]
    """All UV maps one after another, 3 entries a triangle"""
    uv_offsets: wp.array2d[int]
    """[mesh, uv map id]: add 3 * (triangle - triangle_offset) + corner; -1 where the mesh lacks the map"""
    attributes: wp.array[wp.vec4]
    """All other attributes alike"""
    attribute_offsets: wp.array2d[int]


@wp.struct
class Material:
    """Where a material's programs lie and what it can do."""

    surface_start: int
    """First instruction of the whole program"""
    transparency_start: int
    """First instruction of the part that yields transparency alone"""
    emission_start: int
    """First instruction of the part that yields emission alone"""
    flags: int
    emission: wp.vec3
    """Radiance where MATERIAL_CONSTANT_EMISSION is set"""
    pass_index: int


@wp.struct
class Materials:
    """All programs of the node machine (nodes.py)."""

    materials: wp.array[Material]
    instance_materials: wp.array[int]
    """Material per (instance.material_offset + slot)"""
    clear: wp.array[wp.vec4]
    """Tint and index of each material (clear_glass.py), 0: not clear, below 0: not smooth. Empty: light stops at all"""
    properties: wp.array[wp.vec4]
    """Properties of objects that programs read, of all instances one after another"""
    code: wp.array[wp.vec4i]
    """Instructions, see nodes.py"""
    constants: wp.array[wp.vec4]
    ramps: wp.array[wp.vec4]
    world_start: int


@wp.struct
class TextureInfo:
    """One image, see texture.py."""

    width: int
    height: int
    levels: int
    """Mip levels, at least 1; each follows the one before it, sides halved and rounded down"""
    offset: int
    """First texel of level 0 in the array that `format` names"""
    format: int
    """TEXELS_* in texture.py"""
    srgb: int
    """1: decode the sRGB transfer function after filtering"""
    alpha: int
    """ALPHA_* in texture.py: how colour and alpha relate in the stored texels"""
    padding: int
    """Rows of a multiple of 16 bytes, see wide_loads.py"""


@wp.struct
class Textures:
    """All images; filled by engine/textures.py, read by texture.py only."""

    infos: wp.array[TextureInfo]
    bytes4: wp.array[wp.uint32]
    """RGBA texels of 8 bits, red in the lowest byte; the others are of 16 bits, halves and floats"""
    shorts4: wp.array[wp.vec4us]
    halves4: wp.array[wp.vec4h]
    floats4: wp.array[wp.vec4]


@wp.struct
class Light:
    """One lamp. Meaning of the fields by kind, see lights.py."""

    kind: int
    radiance: wp.vec3
    """Emitted radiance on the surface; intensity [W/sr] for lamps of radius 0; irradiance [W/m2] for suns of angle 0"""
    position: wp.vec3
    direction: wp.vec3
    """Unit vector along which the lamp shines (its local -z)"""
    axis_u: wp.vec3
    axis_v: wp.vec3
    """Area: full edges or diameters [m]. Spot: cone axes over its scale, so that the cone is round in them"""
    radius: float
    """Point and spot [m]"""
    one_minus_cos: float
    """Sun: of half its angle"""
    area: float
    spot_cos: float
    spot_smooth: float
    spread_tan: float
    spread_norm: float
    """Area: attenuation (tan - tan of the angle) * norm; 0 = full hemisphere"""
    flags: int
    """LIGHT_* bits"""
    visibility: int
    """VISIBLE_* bits, and the set of receivers from LINK_SHIFT on; so has that of emissive instances"""


@wp.struct
class Environment:
    """A sampling table over the world: piecewise constant over an equirectangular grid."""

    width: int
    height: int
    rows: wp.array[float]
    """Running sum of the rows' probabilities"""
    columns: wp.array[float]
    """Per row, the running sum of its texels' probabilities in it"""
    probability: wp.array[float]
    """Alias method (Vose 1991), where strata don't matter: for the part of the world that is sampled as a light"""
    alias: wp.array[int]
    weight: wp.array[float]
    """The same part's probability of each texel, sums to 1"""
    constant: int
    """1: the same radiance everywhere (`radiance`), no program"""
    radiance: wp.vec3
    visibility: int


@wp.struct
class LightTree:
    """All lights that have a place, as a binary tree; see engine/light_tree.py and light_tree.py."""

    low: wp.array[wp.vec4]
    """Lower bounds of each node, as a heap from index 1; w = least squared distance that counts"""
    high: wp.array[wp.vec4]
    """Upper bounds; w = power"""
    entries: wp.array[int]
    """Light per leaf: local lamps, then emissive triangles; -1 for padding"""
    places: wp.array[int]
    """Leaf per light"""
    levels: int


@wp.struct
class Lights:
    """Everything that emits. One is chosen by its class (local lights, each sun, the world), local ones by the tree."""

    lamps: wp.array[Light]
    """Local lamps, then suns"""
    tables: wp.array[wp.vec4]
    """What lamps' node trees say, see lamp_tables.py"""
    lamp_count: int
    local_lamp_count: int
    triangles: wp.array[wp.vec2i]
    """(instance, triangle) of emissive triangles"""
    emitter_offset: wp.array[int]
    """Per instance: first entry in emitter_index, -1 for instances without emitters"""
    emitter_index: wp.array[int]
    """Per triangle of an instance with emitters: index into `triangles` or -1"""
    emitter_power: wp.array[float]
    """Per emissive triangle, both sides [W]"""
    environment_power: float
    """Luminance of the world integrated over the sphere; 0 where it is not sampled"""
    tree: LightTree
    class_count: int
    """0: nothing emits. Class 0 are the local lights, then the suns, then the world"""
    environment_class: int
    """-1: the world is not sampled"""
    weight: wp.array[float]
    """Probability of each class, sums to 1; lights.class_weight leaves out suns that set"""
    linked: int
    """1: some lights are for some objects alone"""


@wp.struct
class Scene:
    """Everything a ray can meet; passed by value to every kernel."""

    geometry: Geometry
    materials: Materials
    textures: Textures
    lights: Lights
    environment: Environment
    tables: Tables
    luminance: wp.vec3
    """Weights of the working space's primaries"""


@wp.struct
class FrameData:
    """What changes from frame to frame; lives in a one-element device array so that a captured graph sees it."""

    camera_to_world: wp.mat44
    """Relative to the scene's origin"""
    world_to_camera: wp.mat44
    window: wp.vec4
    """left, right, bottom, top on the image plane at distance 1 (orthographic: metres; panoramas: see panorama.py)"""
    orthographic: int
    clip_start: float
    clip_end: float
    aperture_radius: float
    focus_distance: float
    aperture_blades: int
    aperture_rotation: float
    aperture_ratio: float
    width: int
    height: int
    """Full frame [px]"""
    crop_x: int
    crop_y: int
    """First pixel rendered, bottom-left origin"""
    crop_width: int
    crop_height: int
    sample: int
    """Index of the first sample of this launch"""
    seed: int
    spread: float
    """Angle between the rays of neighbouring pixels [rad]; orthographic: 0, see `pixel_size`"""
    pixel_size: float
    """Footprint of a pixel at the camera [m]; perspective: 0"""
    panorama: int
    """A mapping of panorama.py; 0: none, the camera is perspective or orthographic"""
    edge: float
    """Fisheyes: largest angle with the view axis that is seen [rad]"""
    polynomial: wp.vec4
    polynomial_start: float
    """Fisheye polynomial: -angle [rad] at the centre, and factors of the first to fourth power of the radius"""
    padding: wp.vec3
    """The previous camera of a View begins at a multiple of 16 bytes, see wide_loads.load_previous_view"""
