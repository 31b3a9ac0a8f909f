# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene as plain data: what extraction hands over and a Session takes. NumPy and Python values only.

Conventions. World coordinates are Blender's (right-handed, z up, metres), float64 in transforms; meshes are in
object space, float32. Colours are scene-linear RGB in Blender's working space. Angles are radians. Keys are
hashable and stable between updates (an integer or string made from a data-block's session_uid, or a tuple).
Arrays are copies, C-contiguous, owned by the receiver.
"""

from __future__ import annotations

import enum
import functools
import math
from collections.abc import Hashable
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from .image_atlas import Atlas
from .media import MediumData
from .program import Program
from .sky.image import TO_REC709
from .volume_data import VolumeData

if TYPE_CHECKING:
    from .image_loading import ImageLoading

__all__ = [
    "AlphaMode", "CameraData", "CameraKind", "ColorEncoding", "FrameMotion", "ImageData", "InstanceTable", "LightData",
    "LightKind", "MaterialData", "MeshData", "MistData", "SceneDelta", "Visibility", "WorldData",
]

Key = Hashable


@dataclass(kw_only=True, eq=False)
class MeshData:
    """One evaluated mesh in object space; V vertices, T triangles."""

    name: str
    positions: np.ndarray
    """float32 [V, 3]"""
    triangles: np.ndarray
    """int32 [T, 3], indices into positions"""
    material_slots: np.ndarray
    """int32 [T], index into the instance's materials"""
    corner_normals: np.ndarray
    """float32 [T, 3, 3], unit shading normals per corner (flat faces carry the face normal)"""
    uv_maps: dict[str, np.ndarray] = field(default_factory=dict)
    """float32 [T, 3, 2] per UV map, by name; the first is the active render map"""
    attributes: dict[str, np.ndarray] = field(default_factory=dict)
    """float32 [T, 3, 4] per generic or colour attribute, by name"""
    generated: tuple[np.ndarray, np.ndarray] | None = None
    """(location float32[3], size float32[3]) of the texture space, for Generated coordinates"""
    volume: VolumeData | None = None
    """Of a volume object, whose box this is"""


class Visibility(enum.IntFlag):
    """Kinds of rays that see an object, and what else is special about it. Bits shared with kernels/types.py."""

    CAMERA = 1
    DIFFUSE = 2
    GLOSSY = 4
    TRANSMISSION = 8
    SHADOW = 16
    VOLUME = 32
    HOLDOUT = 64
    """Not a ray kind: the object cuts a transparent hole in the picture."""
    SHADOW_CATCHER = 128
    """Not a ray kind: the camera sees how much darker all other things make it (passes/shadow_catcher.py)."""
    ALL = CAMERA | DIFFUSE | GLOSSY | TRANSMISSION | SHADOW | VOLUME


@dataclass(kw_only=True, eq=False)
class InstanceTable:
    """All N visible instances, as arrays."""

    mesh_keys: list[Key]
    """M distinct mesh keys (into SceneDelta.meshes or meshes sent before)"""
    mesh_index: np.ndarray
    """int32 [N], index into mesh_keys"""
    transforms: np.ndarray
    """float64 [N, 4, 4], object to world, row-major (column vectors)"""
    object_keys: list[Key]
    """N keys that stay the same between updates for the same instance (object uid, persistent ids)"""
    object_names: list[str]
    """K names of objects, for messages"""
    object_name_index: np.ndarray
    """int32 [N], index into object_names"""
    material_sets: list[tuple[Key, ...]]
    """S distinct tuples of material keys by slot; never empty (the default material has key None)"""
    material_set_index: np.ndarray
    """int32 [N], index into material_sets"""
    visibility: np.ndarray
    """int32 [N], Visibility bits"""
    pass_index: np.ndarray
    """int32 [N], Object.pass_index"""
    random_id: np.ndarray
    """uint32 [N], Blender's per-instance random id (Object Info)"""
    color: np.ndarray
    """float32 [N, 4], Object.color"""
    asset_names: list[str] = field(default_factory=list)
    """K names of the objects' uppermost parents, for Cryptomatte; empty: their own"""
    light_groups: list[str] = field(default_factory=list)
    """Names of light groups"""
    light_group_index: np.ndarray | None = None
    """int32 [N], index into light_groups of what an instance emits, -1 for none; None: none at all"""
    linked_to: np.ndarray | None = None
    """int32 [N], number of the set of receivers that what an instance emits is for, 0: everything (light_linking.py)"""
    receives: np.ndarray | None = None
    """uint32 [N], bit k where it is in set k, and bit 0; None: all lights"""
    blocked_by: np.ndarray | None = None
    """int32 [N], number of the set of what casts shadows of what an instance emits, 0: everything"""
    spared: np.ndarray | None = None
    """bool [N], whether it casts no shadow of some lights; None: none does"""
    property_names: tuple[str, ...] = ()
    """P names of objects' properties that programs read (object_properties.py)"""
    properties: np.ndarray | None = None
    """float32 [P, N, 4], their values; None without any"""

    @functools.cached_property
    def has_catchers(self) -> bool:
        """Whether any instance is a shadow catcher; asked for in every frame."""
        return bool((self.visibility & int(Visibility.SHADOW_CATCHER)).any())

    def moved_from(self, other: InstanceTable) -> bool:
        """Return whether this is the other table with nothing but other transforms, by its very arrays and lists."""
        return all(getattr(self, item.name) is getattr(other, item.name)
                   for item in fields(self) if item.name != "transforms")

    @staticmethod
    def empty() -> InstanceTable:
        """Return the table of a scene without objects."""
        none = np.zeros(0, np.int32)
        return InstanceTable(
            mesh_keys=[], mesh_index=none, transforms=np.zeros((0, 4, 4)), object_keys=[], object_names=[],
            object_name_index=none, material_sets=[(None,)], material_set_index=none, visibility=none,
            pass_index=none, random_id=np.zeros(0, np.uint32), color=np.zeros((0, 4), np.float32))


@dataclass(kw_only=True, eq=False)
class MaterialData:
    """One material as programs of the node machine (engine/program.py)."""

    name: str
    program: Program
    """The whole surface: registers of its closures"""
    exact: Program | None = None
    """What the path tracer and the camera's view run instead where they draw more than the others: with rays"""
    hair: Program | None = None
    """What the path tracer runs instead of both where hair scatters light: closures of the kind HAIR"""
    pass_index: int = 0
    has_transparency: bool = False
    """May let light through unrefracted (Transparent BSDF, alpha below 1)"""
    has_emission: bool = False
    emission_sampling: bool = True
    """Whether its emissive triangles are sampled as lamps"""
    constant_emission: tuple[float, float, float] | None = None
    """The emitted radiance where it is the same everywhere, else None (the program is evaluated)"""
    aovs: dict[str, Program] = field(default_factory=dict)
    """Shader AOVs by the names of their passes (pass_names.py): programs that emit the value"""
    medium: MediumData | None = None
    """What fills closed meshes; None: nothing"""
    bare: bool = False
    """Whether there is nothing to see but the medium: no surface"""


class ColorEncoding(enum.StrEnum):
    """How stored texel values become scene-linear."""

    LINEAR = "linear"
    """Already scene-linear in the working space, or not a colour"""
    SRGB = "srgb"
    """sRGB transfer function over the working space's primaries (decoded after filtering, as Cycles does)"""


class AlphaMode(enum.StrEnum):
    """What the image's alpha means; see Blender's Image.alpha_mode."""

    STRAIGHT = "STRAIGHT"
    PREMUL = "PREMUL"
    CHANNEL_PACKED = "CHANNEL_PACKED"
    NONE = "NONE"


@dataclass(kw_only=True, eq=False)
class ImageData:
    """One image: a file that OpenImageIO reads, or pixels."""

    name: str
    path: str | None = None
    """Absolute path of a file; None where `pixels` is given"""
    pixels: np.ndarray | None = None
    """[H, W, C] uint8, uint16, float16 or float32, C in 1..4, **top row first**; integers are 0..max"""
    encoding: ColorEncoding = ColorEncoding.SRGB
    source_colorspace: str = ""
    """Name as in Blender, for messages and for files whose space is neither sRGB nor linear"""
    alpha_mode: AlphaMode = AlphaMode.STRAIGHT
    missing: bool = False
    """Could not be read: drawn magenta (1, 0, 1)"""
    atlas: Atlas | None = None
    """Tiles that make the picture up, instead of a file or pixels"""


class LightKind(enum.StrEnum):
    """Blender's lamp types."""

    POINT = "POINT"
    SUN = "SUN"
    SPOT = "SPOT"
    AREA = "AREA"


@dataclass(kw_only=True, eq=False)
class LightData:
    """One lamp instance; Blender's units (watts; watts per square metre for suns)."""

    name: str
    kind: LightKind
    transform: np.ndarray
    """float64 [4, 4], lamp to world; lamps shine along their local -z"""
    color: tuple[float, float, float]
    """Colour times power: Light.color * energy * 2**exposure * temperature tint, *not* divided by areas"""
    radius: float = 0.0
    """Point and spot: shadow_soft_size [m]"""
    soft_falloff: bool = True
    """Point and spot: Light.use_soft_falloff (disk facing the shading point) instead of a sphere"""
    angle: float = 0.0
    """Sun: angular diameter [rad]"""
    spot_size: float = 0.785
    """Spot: full cone angle [rad]"""
    spot_blend: float = 0.15
    shape: str = "SQUARE"
    """Area: SQUARE, RECTANGLE, DISK, ELLIPSE"""
    size_x: float = 1.0
    size_y: float = 1.0
    """Area: full lengths before the transform's scale; equal for SQUARE and DISK"""
    spread: float = 3.14159265
    """Area: spread angle [rad]"""
    normalize: bool = True
    """Whether `color` is a total power (else radiance-like strength per area)"""
    cast_shadow: bool = True
    use_mis: bool = True
    visibility: int = int(Visibility.ALL)
    light_group: str = ""
    linked_to: int = 0
    """Number of the set of receivers that it is for, 0: everything (light_linking.py)"""
    blocked_by: int = 0
    """Number of the set of what casts its shadows, 0: everything"""
    program: Program | None = None
    """Factor on `color` where the node tree varies (lamp_needs.py); None: it is in `color`"""


@dataclass(frozen=True, kw_only=True)
class MistData:
    """The mist of a world; the defaults are what Cycles takes without one."""

    start: float = 0.0
    """Distance from the camera up to which there is none [m]"""
    depth: float = 100.0
    """Distance over which it becomes opaque [m]"""
    falloff: float = 1.0
    """Exponent of its growth"""


@dataclass(kw_only=True, eq=False)
class WorldData:
    """The surroundings as a program evaluated per direction (register: radiance)."""

    name: str
    program: Program
    constant: tuple[float, float, float] | None = None
    """Radiance where it is the same in every direction, else None"""
    importance_resolution: int = 1024
    """Width of the sampling table [texels]; the height is half of it"""
    sampling: bool = True
    visibility: int = int(Visibility.ALL)
    light_group: str = ""
    mist: MistData = MistData()
    occlusion_distance: float = 10.0
    """Distance within which things count for the Ambient Occlusion pass [m]"""
    aovs: dict[str, Program] = field(default_factory=dict)
    """As of materials"""
    medium: MediumData | None = None
    """What fills everything, without end"""
    sun: LightData | None = None
    """Lamp that shines as the sun of its sky does, which the program shows to the camera alone; the host hands it over
    among SceneDelta.lights"""


class CameraKind(enum.StrEnum):
    """Projections; kernels/panorama.py has those after the first two."""

    PERSPECTIVE = "perspective"
    ORTHOGRAPHIC = "orthographic"
    EQUIRECTANGULAR = "equirectangular"
    CUBE_FACE = "equiangular cubemap face"
    MIRROR_BALL = "mirror ball"
    FISHEYE_EQUIDISTANT = "fisheye equidistant"
    FISHEYE_EQUISOLID = "fisheye equisolid"
    FISHEYE_POLYNOMIAL = "fisheye lens polynomial"
    CYLINDER = "central cylindrical"

    @property
    def fisheye(self) -> bool:
        """Whether it shows what lies within an angle of the view axis, CameraData.fov."""
        return self in (
            CameraKind.FISHEYE_EQUIDISTANT, CameraKind.FISHEYE_EQUISOLID, CameraKind.FISHEYE_POLYNOMIAL)


@dataclass(frozen=True, kw_only=True)
class CameraData:
    """A camera: equal values mean that the accumulated picture stays valid.

    Image-plane coordinates x, y run over `window` as the film's pixels run from left to right and from bottom to
    top. A perspective ray starts at the origin towards (x, y, -1) in camera space, an orthographic one at (x, y, 0)
    towards (0, 0, -1); lens, sensor fit, shift, zoom and pixel aspect are all folded into `window`. For panoramas x, y
    are coordinates of the projection: longitude and latitude [rad]; angles across a cube's face [rad], -pi/4 to pi/4;
    -1 to 1 across a mirror ball; the angle around a cylinder [rad] and the height on one of radius 1; on a fisheye's
    plane the angle with the view axis [rad] (equidistant), its sine of half that (equisolid), or what the polynomial
    takes. Their clip distances and the focus are distances from the camera.
    """

    kind: CameraKind = CameraKind.PERSPECTIVE
    transform: tuple[float, ...] = (1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
    """16 float64, camera to world, row-major, without scale; the camera looks along its local -z"""
    window: tuple[float, float, float, float] = (-0.5, 0.5, -0.28125, 0.28125)
    """left, right, bottom, top of the full frame on the plane at distance 1 (metres for orthographic)"""
    clip_start: float = 0.1
    clip_end: float = 1000.0
    aperture_radius: float = 0.0
    """Lens radius [m]; 0 is a pinhole"""
    focus_distance: float = 10.0
    """Distance of the plane in focus along the view axis [m]"""
    aperture_blades: int = 0
    """0..2: round"""
    aperture_rotation: float = 0.0
    aperture_ratio: float = 1.0
    fov: float = math.pi
    """Fisheyes: the full angle that is seen [rad]; beyond it the picture is transparent black"""
    polynomial: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """Fisheye polynomial in the radius, from the constant on: minus the angle with the view axis [rad]"""

    @property
    def panoramic(self) -> bool:
        """Whether it has more than a window onto the world: real-time frames, which project, don't suit it."""
        return self.kind not in (CameraKind.PERSPECTIVE, CameraKind.ORTHOGRAPHIC)


@dataclass(kw_only=True, eq=False)
class FrameMotion:
    """Where things are in another frame, for the Vector pass; what is not named here is where it is in this one."""

    camera: CameraData
    object_keys: list[Key]
    """As of an InstanceTable"""
    transforms: np.ndarray
    """float64 [N, 4, 4], by object_keys"""
    positions: dict[Key, np.ndarray] = field(default_factory=dict)
    """float32 [V, 3], by mesh key, of meshes that deform; left out where V is another then"""


@dataclass(kw_only=True, eq=False)
class SceneDelta:
    """What changed since the last update; None means unchanged, an empty list or dict means there is none."""

    full: bool = False
    """Forget everything sent before (file load, first update)"""
    meshes: dict[Key, MeshData] = field(default_factory=dict)
    """New or changed meshes; those no longer in any instance are dropped by the session"""
    instances: InstanceTable | None = None
    materials: dict[Key, MaterialData] = field(default_factory=dict)
    """New or changed materials"""
    images: dict[Key, ImageData] = field(default_factory=dict)
    """New or changed images, by the keys that programs use"""
    loading: ImageLoading | None = None
    """Has begun to read some of them"""
    lights: list[LightData] | None = None
    world: WorldData | None = None
    """None: unchanged; a world that Blender lacks is a black WorldData"""
    luminance_weights: tuple[float, float, float] = (0.2126729, 0.7151522, 0.0721750)
    """Of the working space"""
    from_xyz: tuple[tuple[float, float, float], ...] = TO_REC709
    """From CIE XYZ to the working space"""
    extra: dict[str, Any] = field(default_factory=dict)
    """Free for measurements (extraction times)"""
