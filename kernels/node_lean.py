# SPDX-License-Identifier: GPL-3.0-or-later
"""A small node machine for the programs that most surfaces have; engine/lean.py says which those are.

It runs the instructions of nodes.py with the same results, but knows few of them and has few registers, and it knows
one closure: a Principled BSDF of metal, dielectric and diffuse reflection alone (or a Diffuse BSDF); plain_bsdf knows
glass too. A kernel with it needs a third of the full machine's registers, so a GPU keeps more of its threads at work.
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .geometry_math import normalize_or, sqr
from .layering import add_dielectric, add_diffuse, add_metal, prepare_bsdf
from .lobe_setup import unit_normal
from .node_closure import xyz
from .node_input import attribute_value, uv_coordinate
from .node_math import safe_divide
from .node_normal import normal_map
from .node_vector import mean_magnitude
from .normals import valid_specular_normal
from .reflectance import BsdfAlbedo, add_base
from .texture import sample_texture
from .types import CLOSURE_PRINCIPLED, Bsdf, Closure, Scene, ShadingPoint, Tables
from .wide_loads import load_constant, load_instance, load_vec4, load_vec4i

__all__ = ["LeanClosure", "LeanSurface", "lean_bsdf", "lean_surface", "plain_bsdf", "run_lean", "run_lean_transparency"]

LEAN_REGISTERS = wp.constant(8)
LeanRegisters = wp.types.matrix(shape=(8, 4), dtype=float)
"""Not an array: that would keep its address, shape and strides in memory too, and twice. Functions would copy it."""


@wp.struct
class LeanClosure:
    """What a lean program says about a point; names as in shading_types.Closure."""

    weight: float
    color: wp.vec3
    normal: wp.vec3
    metallic: float
    roughness: float
    ior: float
    specular_level: float
    specular_tint: wp.vec3
    subsurface: float
    transmission: float
    """Read by plain_bsdf alone"""
    multiscatter: int
    emission: wp.vec3
    """Radiance, the closure's own included"""


@wp.struct
class LeanSurface:
    """A lean closure seen from one direction."""

    albedo: BsdfAlbedo
    normal: wp.vec3
    """Shading normal"""
    cosine: float
    """Between the view and the normal that reflects it"""


@wp.func
def lean_math(sub: int, a: float, b: float, c: float) -> float:
    """Evaluate the commonest of node_math.math's operations."""
    if sub == codes.MATH_ADD:
        return a + b
    if sub == codes.MATH_SUBTRACT:
        return a - b
    if sub == codes.MATH_MULTIPLY:
        return a * b
    if sub == codes.MATH_DIVIDE:
        return safe_divide(a, b)
    if sub == codes.MATH_MULTIPLY_ADD:
        return a * b + c
    if sub == codes.MATH_MINIMUM:
        return wp.min(a, b)
    if sub == codes.MATH_MAXIMUM:
        return wp.max(a, b)
    if sub == codes.MATH_LESS_THAN:
        return wp.where(a < b, 1.0, 0.0)
    if sub == codes.MATH_GREATER_THAN:
        return wp.where(a > b, 1.0, 0.0)
    return wp.min(wp.max(a, b), c)


@wp.func
def lean_vector(sub: int, a: wp.vec4, b: wp.vec4, c: wp.vec4) -> wp.vec4:
    """Evaluate the commonest of node_vector.vector_math's operations."""
    if sub == codes.VECTOR_COMBINE:
        return wp.vec4(a[0], b[0], c[0], wp.max(a[3], wp.max(b[3], c[3])))
    if sub == codes.VECTOR_X:
        return wp.vec4(a[0], a[0], a[0], a[3])
    if sub == codes.VECTOR_Y:
        return wp.vec4(a[1], a[1], a[1], a[3])
    if sub == codes.VECTOR_Z:
        return wp.vec4(a[2], a[2], a[2], a[3])
    if sub == codes.VECTOR_W:
        return wp.vec4(a[3], a[3], a[3], 0.0)
    if sub == codes.VECTOR_XYZ:
        return wp.vec4(a[0], a[1], a[2], 0.0)
    if sub == codes.VECTOR_ADD:
        return a + b
    if sub == codes.VECTOR_SUBTRACT:
        return wp.vec4(a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] + b[3])
    if sub == codes.VECTOR_SCALE:
        return wp.vec4(a[0] * c[0], a[1] * c[0], a[2] * c[0], a[3] * wp.abs(c[0]))
    width = a[3] * mean_magnitude(xyz(b)) + b[3] * mean_magnitude(xyz(a))
    return wp.vec4(a[0] * b[0], a[1] * b[1], a[2] * b[2], width)


@wp.func
def lean_mix(sub: int, t: float, a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Evaluate the commonest of node_color.mix_color's blend types."""
    if sub == codes.MIX_MULTIPLY:
        return wp.lerp(a, wp.cw_mul(a, b), t)
    if sub == codes.MIX_ADD:
        return a + b * t
    if sub == codes.MIX_SUBTRACT:
        return a - b * t
    return a * (1.0 - t) + b * t


@wp.func
def lean_input(scene: Scene, point: ShadingPoint, sub: int, index: int) -> wp.vec4:
    """Return a UV map's coordinate or an attribute."""
    instance = load_instance(scene.geometry.instances, point.instance)
    if sub == codes.INPUT_UV:
        return uv_coordinate(scene, point, instance, index)
    return attribute_value(scene, point, instance, index)


@wp.func
def lean_transform(scene: Scene, sub: int, row: int, a: wp.vec4) -> wp.vec4:
    """Apply three constant rows of an affine matrix (see nodes.transform)."""
    x = load_vec4(scene.materials.constants, row)
    y = load_vec4(scene.materials.constants, row + 1)
    z = load_vec4(scene.materials.constants, row + 2)
    p = wp.vec4(a[0], a[1], a[2], wp.where(sub == codes.TRANSFORM_POINT, 1.0, 0.0))
    scale = (wp.length(xyz(x)) + wp.length(xyz(y)) + wp.length(xyz(z))) / 3.0
    return wp.vec4(wp.dot(x, p), wp.dot(y, p), wp.dot(z, p), a[3] * scale)


@wp.func
def plain_value(scene: Scene, point: ShadingPoint, word: wp.vec4i, a: wp.vec4, b: wp.vec4, c: wp.vec4) -> wp.vec4:
    """Evaluate one instruction that writes a register, normal maps excepted."""
    op = word[0] & 255
    sub = (word[0] >> 16) & 65535
    if op == codes.OP_IMAGE:
        return sample_texture(
            scene.textures, word[2], wp.vec2(a[0], a[1]), a[3], (sub >> 4) & 3, (sub >> 6) & 7)
    if op == codes.OP_INPUT:
        return lean_input(scene, point, sub, word[2])
    if op == codes.OP_MATH:
        x = lean_math(sub, a[0], b[0], c[0])
        return wp.vec4(x, x, x, 0.0)
    if op == codes.OP_MIX:
        m = lean_mix(sub, a[0], xyz(b), xyz(c))
        return wp.vec4(m[0], m[1], m[2], 0.0)
    if op == codes.OP_TRANSFORM:
        return lean_transform(scene, sub, word[2], a)
    return lean_vector(sub, a, b, c)


@wp.func
def lean_value(scene: Scene, point: ShadingPoint, word: wp.vec4i, a: wp.vec4, b: wp.vec4, c: wp.vec4) -> wp.vec4:
    """Evaluate one instruction that writes a register."""
    if (word[0] & 255) == codes.OP_NORMAL_MAP:
        n = normal_map(
            scene, point, (word[0] >> 16) & 65535, xyz(a), b[0], (word[3] & 65535) - 1, (word[3] >> 16) - 1)
        return wp.vec4(n[0], n[1], n[2], 0.0)
    return plain_value(scene, point, word, a, b, c)


@wp.func
def fetch_lean(scene: Scene, operand: int, register: wp.vec4) -> wp.vec4:
    """Return an operand (see node_closure.fetch), given the register that it may be.

    Immediates that are read as an operand do no harm.
    """
    return load_constant(scene.materials.constants, operand, register)


@wp.func
def register_of(operand: int) -> int:
    """Return the number of the register that an operand may be."""
    return operand & (LEAN_REGISTERS - 1)


@wp.func
def argument_operand(scene: Scene, first: int, slot: int) -> int:
    """Return the operand that is argument `slot` of the closure whose argument words start at instruction `first`."""
    return load_vec4i(scene.materials.code, first + slot // 3)[1 + slot % 3]


@wp.func
def empty_lean(point: ShadingPoint) -> LeanClosure:
    """Return the closure of a black surface. An index of 1 reflects nothing."""
    c = LeanClosure()
    c.normal = point.normal
    c.ior = 1.0
    c.specular_level = 0.5
    c.roughness = 1.0
    return c


@wp.func
def run_lean(scene: Scene, point: ShadingPoint, start: int) -> LeanClosure:
    """Run a lean surface program. The closure comes last in it."""
    registers = LeanRegisters()
    emission = wp.vec3(0.0, 0.0, 0.0)
    pc = int(start)
    word = load_vec4i(scene.materials.code, pc)
    op = word[0] & 255
    while op != codes.OP_END and op != codes.OP_CLOSURE:
        if op != codes.OP_TRANSPARENT:
            a = fetch_lean(scene, word[1], registers[register_of(word[1])])
            b = fetch_lean(scene, word[2], registers[register_of(word[2])])
            c = fetch_lean(scene, word[3], registers[register_of(word[3])])
            if op == codes.OP_EMIT:
                emission += xyz(a) * (b[0] * c[0])
            else:
                registers[register_of(word[0] >> 8)] = lean_value(scene, point, word, a, b, c)
        pc += 1
        word = load_vec4i(scene.materials.code, pc)
        op = word[0] & 255
    closure = empty_lean(point)
    if op == codes.OP_CLOSURE:
        sub = (word[0] >> 16) & 65535
        k = argument_operand(scene, pc + 1, codes.ARG_WEIGHT)
        closure.weight = wp.max(fetch_lean(scene, k, registers[register_of(k)])[0], 0.0)
        k = argument_operand(scene, pc + 1, codes.ARG_COLOR)
        closure.color = xyz(fetch_lean(scene, k, registers[register_of(k)]))
        k = argument_operand(scene, pc + 1, codes.ARG_NORMAL)
        closure.normal = normalize_or(xyz(fetch_lean(scene, k, registers[register_of(k)])), point.normal)
        if (sub & 255) == CLOSURE_PRINCIPLED:
            closure.multiscatter = wp.where((sub & codes.CLOSURE_MULTISCATTER) != 0, 1, 0)
            k = argument_operand(scene, pc + 1, codes.ARG_ROUGHNESS)
            closure.roughness = fetch_lean(scene, k, registers[register_of(k)])[0]
            k = argument_operand(scene, pc + 1, codes.ARG_IOR)
            closure.ior = fetch_lean(scene, k, registers[register_of(k)])[0]
            k = argument_operand(scene, pc + 1, codes.ARG_METALLIC)
            closure.metallic = fetch_lean(scene, k, registers[register_of(k)])[0]
            k = argument_operand(scene, pc + 1, codes.ARG_SPECULAR_LEVEL)
            closure.specular_level = fetch_lean(scene, k, registers[register_of(k)])[0]
            k = argument_operand(scene, pc + 1, codes.ARG_SPECULAR_TINT)
            closure.specular_tint = xyz(fetch_lean(scene, k, registers[register_of(k)]))
            k = argument_operand(scene, pc + 1, codes.ARG_SUBSURFACE)
            closure.subsurface = fetch_lean(scene, k, registers[register_of(k)])[0]
            k = argument_operand(scene, pc + 1, codes.ARG_TRANSMISSION)
            closure.transmission = fetch_lean(scene, k, registers[register_of(k)])[0]
            k = argument_operand(scene, pc + 1, codes.ARG_EMISSION)
            closure.emission = xyz(fetch_lean(scene, k, registers[register_of(k)])) * closure.weight
    closure.emission += emission
    return closure


@wp.func
def run_lean_transparency(scene: Scene, point: ShadingPoint, start: int) -> wp.vec3:
    """Run a lean transparency program; return the share of light that passes."""
    registers = LeanRegisters()
    transparency = wp.vec3(0.0, 0.0, 0.0)
    pc = int(start)
    while True:
        word = load_vec4i(scene.materials.code, pc)
        op = word[0] & 255
        if op == codes.OP_END:
            break
        a = fetch_lean(scene, word[1], registers[register_of(word[1])])
        b = fetch_lean(scene, word[2], registers[register_of(word[2])])
        if op == codes.OP_TRANSPARENT:
            transparency += xyz(a) * b[0]
        else:
            c = fetch_lean(scene, word[3], registers[register_of(word[3])])
            registers[register_of(word[0] >> 8)] = plain_value(scene, point, word, a, b, c)
        pc += 1
    return transparency


@wp.func
def full_closure(lean: LeanClosure) -> Closure:
    """Return the same as the struct that layering.py takes, without glass; what a lean closure lacks is 0."""
    c = Closure()
    c.kind = CLOSURE_PRINCIPLED
    c.weight = wp.vec3(lean.weight, lean.weight, lean.weight)
    c.color = lean.color
    c.normal = lean.normal
    c.metallic = lean.metallic
    c.roughness = lean.roughness
    c.ior = lean.ior
    c.specular_level = lean.specular_level
    c.specular_tint = lean.specular_tint
    c.subsurface = lean.subsurface
    c.multiscatter = lean.multiscatter
    c.emission = lean.emission
    return c


@wp.func
def without_layers(bsdf: Bsdf) -> Bsdf:
    """Return a BSDF without coat, sheen and translucency, whose odds are 0 anyway.

    Compilers keep the code of their lobes otherwise: 0 times the odds' scale might be NaN for all they know.
    """
    out = bsdf
    out.pick_coat = 0.0
    out.pick_sheen = 0.0
    out.pick_translucent = 0.0
    return out


@wp.func
def lean_bsdf(tables: Tables, lean: LeanClosure, point: ShadingPoint) -> Bsdf:
    """Return the BSDF of a lean closure: what layering.prepare_bsdf makes of it. Constants leave little of that."""
    bsdf = without_layers(prepare_bsdf(tables, full_closure(lean), point))
    bsdf.pick_glass = 0.0
    return bsdf


@wp.func
def plain_bsdf(tables: Tables, lean: LeanClosure, point: ShadingPoint) -> Bsdf:
    """Return the BSDF of a lean closure that may be glass: what layering.prepare_bsdf makes of it.

    Constants leave little of that function.
    """
    closure = full_closure(lean)
    closure.transmission = lean.transmission
    return without_layers(prepare_bsdf(tables, closure, point))


@wp.func
def lean_surface(tables: Tables, lean: LeanClosure, point: ShadingPoint) -> LeanSurface:
    """Return the albedos of a lean closure: what layering.prepare_bsdf and reflectance.bsdf_albedo make of it."""
    closure = full_closure(lean)
    bsdf = Bsdf()
    bsdf.normal = unit_normal(lean.normal, point.normal)
    bsdf.specular_normal = valid_specular_normal(point.geometric_normal, point.wo, bsdf.normal)
    alpha = sqr(wp.clamp(lean.roughness, 0.0, 1.0))
    bsdf.alpha_x = alpha
    bsdf.alpha_y = alpha
    weight = wp.vec3(lean.weight, lean.weight, lean.weight)
    cos_o = wp.dot(bsdf.specular_normal, point.wo)
    bsdf, weight = add_metal(tables, closure, bsdf, weight, cos_o)
    bsdf, weight = add_dielectric(tables, closure, bsdf, weight, cos_o)
    bsdf = add_diffuse(closure, bsdf, weight, point.wo)
    result = LeanSurface()
    result.normal = bsdf.normal
    result.cosine = cos_o
    result.albedo.roughness = 1.0
    result.albedo.diffuse = bsdf.diffuse
    if cos_o > 0.0 and bsdf.pick_specular > 0.0:
        result.albedo = add_base(tables, bsdf, cos_o, result.albedo)
    return result
