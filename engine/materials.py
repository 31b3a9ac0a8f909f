# SPDX-License-Identifier: GPL-3.0-or-later
"""All programs on the device: resolves the names in them and concatenates them into the node machine's arrays."""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Iterable, Mapping

import numpy as np
import warp as wp

from ..kernels import node_codes as codes
from ..kernels.types import (
    MATERIAL_CONSTANT_EMISSION,
    MATERIAL_EMISSION,
    MATERIAL_EXACT,
    MATERIAL_FLAT_SHIFT,
    MATERIAL_HAIR,
    MATERIAL_LEAN,
    MATERIAL_LEAN_FLAT,
    MATERIAL_LEAN_STRANDS,
    MATERIAL_LEAN_TRANSPARENCY,
    MATERIAL_LOOKS,
    MATERIAL_PLAIN,
    MATERIAL_STRANDS,
    MATERIAL_SUBSURFACE,
    MATERIAL_TRANSPARENCY,
    Material,
    Materials,
)
from .clear_glass import clear_glass
from .closure_arguments import is_hair_alone
from .lean import LeanPrograms, has_film, is_lean, is_lean_strand, is_lean_transparency, looks_within
from .object_properties import PROPERTY_PREFIX
from .program import TANGENT_PREFIX, Program, ProgramBuilder
from .program_layout import OPERANDS, Instruction
from .reflectors import Reflectors, find_reflectors
from .scene import CameraData, CameraKind, InstanceTable, MaterialData
from .subsurface import SubsurfaceUse, subsurface_flags, subsurface_use

__all__ = [
    "PRINCIPLED_DEFAULTS", "MaterialTable", "attribute_names", "default_material", "materials_in_use", "single_program",
]

END = (codes.OP_END, 0, 0, 0)


PRINCIPLED_DEFAULTS = {
    "ior": 1.5, "specular_level": 0.5, "specular_tint": (1.0, 1.0, 1.0), "coat_ior": 1.5, "coat_tint": 1.0,
    "sheen_tint": 1.0, "sheen_roughness": 0.5,
}
"""Arguments of a new Principled BSDF that are not zero in Blender, but its colour and roughness"""


@functools.cache
def default_program() -> Program:
    """Return a new Principled BSDF's program."""
    builder = ProgramBuilder()
    builder.closure("PRINCIPLED", 1.0, multiscatter=True, color=0.8, roughness=0.5, coat_roughness=0.03,
                    **PRINCIPLED_DEFAULTS)
    return builder.finish()


def default_material() -> MaterialData:
    """Return the material of slots without one: a new Principled BSDF, as in Cycles since Blender 5.0."""
    return MaterialData(name="Default", program=default_program())


def materials_in_use(table: InstanceTable, used_slots: list[np.ndarray], drawn: np.ndarray) -> set[Hashable]:
    """Return the keys of materials that any drawn triangle has.

    Args:
        table: All instances.
        used_slots: Material slots that the triangles of each of the table's meshes have.
        drawn: bool [N]: which instances are drawn.
    """
    sets = len(table.material_sets)
    pairs = np.unique(table.mesh_index[drawn].astype(np.int64) * sets + table.material_set_index[drawn])
    keys: set[Hashable] = set()
    for mesh, index in zip(*(part.tolist() for part in np.divmod(pairs, sets)), strict=True):
        chosen = table.material_sets[index]
        keys.update(chosen[min(slot, len(chosen) - 1)] for slot in used_slots[mesh].tolist())
    return keys


def attribute_names(programs: Iterable[Program]) -> list[str]:
    """Return all attributes that the programs read, sorted; the empty name is the active colour attribute.

    Tangents (program.tangent_attribute) are not among them, which are optional, nor are properties of objects.
    """
    others = (TANGENT_PREFIX, PROPERTY_PREFIX)
    return sorted({name for program in programs for name in program.attributes if not name.startswith(others)})


class MaterialTable:
    """The materials and the world of one session, as kernels.types.Materials (all but `instance_materials`).

    Material 0 is always the default one (key None).
    """

    def __init__(self, device: str) -> None:
        """Start with the default material and a black world on `device`."""
        self.device = device
        self._nothing = wp.empty(0, dtype=wp.vec4, device=device)
        self.uses_camera = False
        """Whether any program reads the camera: then `set_camera` restarts are due when it moves"""
        self.uses_window = False
        """Whether any reads the place on the film"""
        self.lean = LeanPrograms()
        """What the lean node machine can run, of the materials in use"""
        self.reflectors = Reflectors()
        """What the materials in use reflect and refract"""
        self.subsurface = SubsurfaceUse()
        """What they scatter below the surface"""
        self._programs: dict[Hashable, tuple[Program, int]] = {}
        self._used: frozenset[Hashable] | None = None
        self._is_clear = np.zeros(0, bool)
        self._clear_in_use = False
        self.indices: dict[Hashable, int] = {}
        self.aov_starts: dict[str, np.ndarray] = {}
        """By shader AOV, the first instruction of each material's program, then the world's: int32 [materials + 1];
        -1 without one"""
        self.bytes = 0
        self.build({}, None, lambda key: 0, lambda name: -1, lambda name: -1)

    def index(self, key: Hashable) -> int:
        """Return a material's index, that of the default material for unknown keys."""
        return self.indices.get(key, 0)

    def scattering(self, table: InstanceTable) -> np.ndarray:
        """Return which instances have a material that sends rays within the object, as below its surface: bool [N]."""
        below = {key for key, (_, flags) in self._programs.items() if flags & (MATERIAL_SUBSURFACE | MATERIAL_LOOKS)}
        sets = np.array([not below.isdisjoint(keys) for keys in table.material_sets], bool)
        return sets[table.material_set_index] if below else np.zeros(len(table.material_set_index), bool)

    def build(
        self,
        materials: Mapping[Hashable, MaterialData],
        world: Program | None,
        image_index: Callable[[Hashable], int],
        uv_map_index: Callable[[str], int],
        attribute_index: Callable[[str], int],
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
        world_aovs: Mapping[str, Program] | None = None,
    ) -> None:
        """Build all arrays anew.

        Args:
            materials: Materials by key.
            world: The world's program, None for black.
            image_index: Returns the texture of an image key.
            uv_map_index: Returns the id of a UV map's name (columns of Geometry.uv_offsets), -1 where no mesh has it.
            attribute_index: The same for attributes, and for properties of objects.
            origin: What the host subtracted from all world coordinates.
            world_aovs: Shader AOVs of the world.
        """
        table = _Table(image_index, uv_map_index, attribute_index)
        table.constants[codes.CONSTANT_ORIGIN] = (*origin, 0.0)
        everything = {None: default_material(), **materials}
        self.indices = {key: row for row, key in enumerate(everything)}
        records = np.zeros(len(everything), dtype=Material.numpy_dtype())
        self.uses_camera = world is not None and world.uses_camera
        self._programs = {}
        clear = np.zeros((len(everything), 4), np.float32)
        for row, (key, data) in enumerate(everything.items()):
            twins = data.exact, data.hair
            table.note_twins([each and table.add_code(each.surface, each, table.add_tables(each)) for each in twins])
            self.uses_camera |= any(each is not None and each.uses_camera for each in twins)
            base = table.add_tables(data.program)
            records[row]["surface_start"] = table.add_code(data.program.surface, data.program, base)
            # Next to it: the distance is stored.
            records[row]["flags"] = material_flags(data) | table.add_flat(data.program, base) << MATERIAL_FLAT_SHIFT
            records[row]["transparency_start"] = table.add_code(data.program.transparency, data.program, base)
            records[row]["emission_start"] = table.add_code(data.program.emission, data.program, base)
            records[row]["emission"] = data.constant_emission or (0.0, 0.0, 0.0)
            records[row]["pass_index"] = data.pass_index
            self.uses_camera |= data.program.uses_camera
            self._programs[key] = data.program, int(records[row]["flags"])
            clear[row] = clear_glass(data)
        self._used = None
        self._clear, self._is_clear = wp.array(clear, dtype=wp.vec4, device=self.device), clear[:, 3] != 0.0
        self.note_used(everything)
        world_start = table.add_code(world.emission, world, table.add_tables(world)) if world else 0
        self._add_aovs(table, [*(data.aovs for data in everything.values()), world_aovs or {}])
        self._upload(table, records, world_start)

    def _add_aovs(self, table: _Table, programs: list[Mapping[str, Program]]) -> None:
        """Add the programs of shader AOVs: of each material, and of the world as the last."""
        self.aov_starts = {}
        for row, found in enumerate(programs):
            for name, program in found.items():
                starts = self.aov_starts.setdefault(name, np.full(len(programs), -1, np.int32))
                starts[row] = table.add_code(program.emission, program, table.add_tables(program))
                self.uses_camera |= program.uses_camera

    def note_used(self, keys: Iterable[Hashable]) -> None:
        """Take in which materials are on anything drawn: `lean` and `reflectors` tell of these alone."""
        used = frozenset(key if key in self._programs else None for key in keys)
        if used == self._used:
            return
        self._used = used
        programs, flags = zip(*(self._programs[key] for key in used), strict=True) if used else ((), ())
        self.reflectors = find_reflectors(programs)
        self._clear_in_use = bool(self._is_clear[[self.index(key) for key in used]].any())
        self.subsurface = subsurface_use(flags)
        self.lean = LeanPrograms(
            *(all(each & bit for each in flags)
              for bit in (MATERIAL_LEAN, MATERIAL_LEAN_FLAT, MATERIAL_LEAN_TRANSPARENCY, MATERIAL_PLAIN)),
            films=any(has_film(program) for program in programs),
            **{name: any(each & bit for each in flags) for name, bit in (
                ("exact", MATERIAL_EXACT), ("hair", MATERIAL_HAIR), ("strands", MATERIAL_STRANDS))},
            lean_strands=all(each & MATERIAL_LEAN_STRANDS for each in flags if each & MATERIAL_HAIR))

    def _upload(self, table: _Table, records: np.ndarray, world_start: int) -> None:
        """Copy everything to the device."""
        code = np.array(table.code, dtype=np.int32)
        # All but the output register.
        self.uses_window = bool((code[:, 0] & ~0xFF00 == codes.OP_INPUT | codes.INPUT_WINDOW << 16).any())
        constants = np.array(table.constants, dtype=np.float32)
        ramps = np.frombuffer(b"".join(table.ramps), dtype=np.float32).reshape(-1, 4)
        if not len(ramps):
            ramps = np.zeros((1, 4), dtype=np.float32)
        self._materials = wp.array(records, dtype=Material, device=self.device)
        self._code = wp.array(code, dtype=wp.vec4i, device=self.device)
        self._constants = wp.array(constants, dtype=wp.vec4, device=self.device)
        self._ramps = wp.array(ramps, dtype=wp.vec4, device=self.device)
        self._world_start = world_start
        self.bytes = records.nbytes + code.nbytes + constants.nbytes + ramps.nbytes

    def set_camera(self, camera: CameraData, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """Tell the programs where the camera is; needed before rendering where `uses_camera`.

        Args:
            camera: The camera.
            origin: The scene's origin, as given to `build`.
        """
        matrix = np.array(camera.transform, dtype=np.float64).reshape(4, 4)
        matrix[:3, 3] -= origin
        rows = np.linalg.inv(matrix)[:3]
        rows[2] *= -1.0  # z forward, as Cycles has it
        if camera.panoramic:
            # Cycles turns the space of such cameras: x along the view and z up, mirror balls y against the view.
            x, y, z = rows
            rows = np.array([x, -z, y] if camera.kind == CameraKind.MIRROR_BALL else [z, -x, y])
        # Panoramas have no window: no division, so that what looks for one gets small numbers.
        orthographic = float(camera.kind != CameraKind.PERSPECTIVE)
        block = np.vstack([rows, camera.window, (orthographic, 0.0, 0.0, 0.0)]).astype(np.float32)
        source = wp.array(block, dtype=wp.vec4, device=self.device)
        wp.copy(self._constants, source, dest_offset=codes.CONSTANT_CAMERA, count=len(block))

    def struct(self) -> Materials:
        """Return the device arrays; the caller adds `instance_materials`."""
        materials = Materials()
        materials.materials = self._materials
        materials.clear = self._clear if self._clear_in_use else self._nothing
        materials.code = self._code
        materials.constants = self._constants
        materials.ramps = self._ramps
        materials.world_start = self._world_start
        return materials


def material_flags(data: MaterialData) -> int:
    """Return the MATERIAL_* bits of a material."""
    flags = MATERIAL_TRANSPARENCY if data.has_transparency else 0
    if data.has_emission:
        flags |= MATERIAL_EMISSION
        flags |= MATERIAL_CONSTANT_EMISSION if data.constant_emission is not None else 0
    flags |= subsurface_flags(data.program)
    if data.exact is not None:
        flags |= MATERIAL_EXACT | (MATERIAL_LOOKS if looks_within(data.exact) else 0)
    if data.hair is not None:
        flags |= MATERIAL_HAIR | (MATERIAL_STRANDS if is_hair_alone(data.hair) else 0)
        flags |= MATERIAL_LEAN_STRANDS if is_lean_strand(data.hair) else 0
    if data.exact is None and data.hair is None:
        flags |= MATERIAL_LEAN if is_lean(data.program.surface, data.program) else 0
        flags |= MATERIAL_PLAIN if is_lean(data.program.surface, data.program, glass=True) else 0
    flags |= MATERIAL_LEAN_FLAT if is_lean(data.program.flat or data.program.surface, data.program) else 0
    return flags | (MATERIAL_LEAN_TRANSPARENCY if is_lean_transparency(data.program) else 0)


def single_program(
    program: Program, image_index: Callable[[Hashable], int], origin: tuple[float, float, float], device: str,
    attribute_index: Callable[[str], int] = lambda name: -1,
) -> tuple[Materials, int]:
    """Return the arrays of one program alone, of no mesh, and where its emission starts.

    Args:
        program: Of a lamp, or of a volume's coefficient.
        image_index: Returns the texture of an image key.
        origin: What the host subtracted from all world coordinates.
        device: Where to put them.
        attribute_index: Returns the number of an attribute's name, or of a property's, -1 for what counts as 0.
    """
    table = _Table(image_index, lambda name: -1, attribute_index)
    table.constants[codes.CONSTANT_ORIGIN] = (*origin, 0.0)
    start = table.add_code(program.emission, program, table.add_tables(program))
    materials = Materials()
    materials.materials = wp.zeros(1, dtype=Material, device=device)
    materials.code = wp.array(np.array(table.code, np.int32), dtype=wp.vec4i, device=device)
    materials.constants = wp.array(np.array(table.constants, np.float32), dtype=wp.vec4, device=device)
    ramps = np.frombuffer(b"".join(table.ramps) or bytes(16), np.float32).reshape(-1, 4)
    materials.ramps = wp.array(ramps, dtype=wp.vec4, device=device)
    return materials, start


class _Table:
    """The growing arrays, and the resolvers of names."""

    def __init__(self, image_index: Callable, uv_map_index: Callable, attribute_index: Callable) -> None:
        self.image_index = image_index
        self.uv_map_index = uv_map_index
        self.attribute_index = attribute_index
        self.code: list[Instruction] = [END]
        self.constants: list[tuple[float, ...]] = [(0.0, 0.0, 0.0, 0.0)] * codes.CONSTANT_FIRST
        # An identity camera until set_camera is called.
        self.constants[codes.CONSTANT_CAMERA:codes.CONSTANT_CAMERA + 3] = [
            (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.0)]
        self.constants[codes.CONSTANT_WINDOW] = (-0.5, 0.5, -0.5, 0.5)
        self.zero = -1 - len(self.constants)
        self.constants.append((0.0, 0.0, 0.0, 0.0))
        self.ramps: list[bytes] = []
        self.ramp_rows: dict[bytes, int] = {}

    def add_tables(self, program: Program) -> int:
        """Append a program's constants and ramps; return the index of its first constant."""
        base = len(self.constants)
        self.constants.extend(program.constants)
        for ramp in program.ramps:
            if ramp not in self.ramp_rows:
                self.ramp_rows[ramp] = len(self.ramps) * codes.RAMP_SIZE
                self.ramps.append(ramp)
        return base

    def add_code(self, instructions: tuple[Instruction, ...], program: Program, base: int) -> int:
        """Append a program's instructions, resolved; return where they start. Empty programs share one place."""
        if not instructions:
            return 0
        start = len(self.code)
        self.code.extend(self.resolve(instruction, program, base) for instruction in instructions)
        self.code.append(END)
        return start

    def note_twins(self, starts: list[int | None]) -> None:
        """Write where the exact program is that was just added, and hair's: into the end before the surface program."""
        if any(start is not None for start in starts):
            self.code[-1] = (codes.OP_END, *(start or 0 for start in starts), 0)

    def add_flat(self, program: Program, base: int) -> int:
        """Append a flat program after the surface program just added; return how far, 0 where they are the same."""
        if not program.flat or program.flat == program.surface:
            return 0
        self.add_code(program.flat, program, base)
        return len(program.surface) + 1

    def resolve(self, instruction: Instruction, program: Program, base: int) -> Instruction:
        """Return an instruction with operands and immediates that index the arrays."""
        op = instruction[0] & 255
        count = OPERANDS[op]
        head = instruction[0]
        words = [word - base if word < 0 and i < count else word for i, word in enumerate(instruction[1:])]
        if op == codes.OP_IMAGE:
            words[1] = self.image_index(program.images[words[1]])
        elif op == codes.OP_TRANSFORM:
            words[1] = base + words[1] if words[1] >= 0 else -1 - words[1]
        elif op == codes.OP_RAMP:
            words[1] = self.ramp_rows[program.ramps[words[1]]]
        elif op == codes.OP_NORMAL_MAP and words[2] != 0:
            uv_map = self.uv_map_index(program.uv_maps[(words[2] & 65535) - 1])
            tangent = self.attribute_index(program.attributes[(words[2] >> 16) - 1])
            words[2] = uv_map + 1 | tangent + 1 << 16
        elif op == codes.OP_INPUT:
            return self.resolve_input(head, words, program)
        return head, *words

    def resolve_input(self, head: int, words: list[int], program: Program) -> Instruction:
        """Return an input instruction with the ids of what it names; what no mesh has becomes 0."""
        kind = head >> 16 & 255
        if kind == codes.INPUT_TANGENT_UV:
            uv_map = self.uv_map_index(program.uv_maps[words[1]])
            return head, words[0], uv_map, self.attribute_index(program.attributes[words[2]])
        if kind not in (codes.INPUT_UV, codes.INPUT_ATTRIBUTE, codes.INPUT_PROPERTY):
            return head, *words
        if kind == codes.INPUT_UV:
            index = self.uv_map_index(program.uv_maps[words[1]])
        else:
            name = program.attributes[words[1]]
            index = self.attribute_index(name)
            if index < 0 and name and kind == codes.INPUT_ATTRIBUTE and self.uv_map_index(name) >= 0:
                # Blender lets attribute nodes name UV maps.
                index = self.uv_map_index(name)
                head = head - (codes.INPUT_ATTRIBUTE << 16) + (codes.INPUT_UV << 16)
        if index < 0:
            out = head & 0xFF00
            return codes.OP_VECTOR | out | codes.VECTOR_XYZ << 16, self.zero, self.zero, self.zero
        return head, words[0], index, 0
