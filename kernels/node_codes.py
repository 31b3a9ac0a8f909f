# SPDX-License-Identifier: GPL-3.0-or-later
"""Codes of the node machine: opcodes, their sub-operations and flags. Constants only, shared with engine/program.py.

An instruction is a vec4i. Its first word holds opcode (bits 0-7), output register (8-15) and sub-operation (16-31);
the other three are operands or immediates. An operand k >= 0 is register k, an operand k < 0 is constant -1 - k.
Which words are operands is the table OPERANDS in engine/program.py.
"""

import warp as wp

REGISTER_COUNT = wp.constant(32)
ARGUMENT_COUNT = wp.constant(24)
"""Slots of a closure's arguments"""
SUBSURFACE_ARGUMENT_COUNT = wp.constant(27)
"""The same where light is scattered below the surface (CLOSURE_SUBSURFACE)"""
FILM_ARGUMENT_COUNT = wp.constant(30)
"""The same with a thin film, whatever the kind (CLOSURE_FILM)"""

# Reserved constants: filled by engine/materials.py, the same for all programs.
CONSTANT_ORIGIN = wp.constant(0)
"""The scene's origin, to be added to positions for world coordinates; w is 0"""
CONSTANT_CAMERA = wp.constant(1)
"""Three rows: world to camera with z forward, for positions relative to the scene's origin"""
CONSTANT_WINDOW = wp.constant(4)
"""left, right, bottom, top of the image plane"""
CONSTANT_PROJECTION = wp.constant(5)
"""x is 1 for orthographic cameras"""
CONSTANT_FIRST = wp.constant(6)
"""First constant that belongs to a program"""

# Opcodes.
OP_END = wp.constant(0)
OP_ARGS = wp.constant(1)
"""Three further operands of the closure before it; never executed"""
OP_MATH = wp.constant(2)
OP_VECTOR = wp.constant(3)
OP_MIX = wp.constant(4)
OP_COLOR = wp.constant(5)
OP_INPUT = wp.constant(6)
OP_IMAGE = wp.constant(7)
OP_TRANSFORM = wp.constant(8)
OP_RAMP = wp.constant(9)
OP_PROCEDURAL = wp.constant(10)
OP_FRESNEL = wp.constant(11)
OP_NORMAL_MAP = wp.constant(12)
OP_BUMP = wp.constant(13)
OP_SPACE = wp.constant(14)
OP_EMIT = wp.constant(15)
OP_TRANSPARENT = wp.constant(16)
OP_HOLDOUT = wp.constant(17)
OP_CLOSURE = wp.constant(18)
OP_TRACE = wp.constant(19)
"""What rays from the point tell, of exact programs alone (node_rays.py)"""

# OP_TRACE: a.x distance or radius [m], b normal, 0 for the shading normal; the immediate is the number of rays.
TRACE_OCCLUSION = wp.constant(0)
"""Share of rays about the normal that meet nothing within the distance"""
TRACE_BEVEL = wp.constant(1)
"""Mean normal of the object's surface about the point"""
TRACE_INSIDE = wp.constant(2)
TRACE_LOCAL = wp.constant(4)
"""Flags of TRACE_OCCLUSION: about the normal's other side; only the object itself counts"""

# OP_MATH: names follow Blender's ShaderNodeMath.operation.
MATH_ADD = wp.constant(0)
MATH_SUBTRACT = wp.constant(1)
MATH_MULTIPLY = wp.constant(2)
MATH_DIVIDE = wp.constant(3)
MATH_MULTIPLY_ADD = wp.constant(4)
MATH_POWER = wp.constant(5)
MATH_LOGARITHM = wp.constant(6)
MATH_SQRT = wp.constant(7)
MATH_INVERSE_SQRT = wp.constant(8)
MATH_ABSOLUTE = wp.constant(9)
MATH_EXPONENT = wp.constant(10)
MATH_MINIMUM = wp.constant(11)
MATH_MAXIMUM = wp.constant(12)
MATH_LESS_THAN = wp.constant(13)
MATH_GREATER_THAN = wp.constant(14)
MATH_SIGN = wp.constant(15)
MATH_COMPARE = wp.constant(16)
MATH_SMOOTH_MIN = wp.constant(17)
MATH_SMOOTH_MAX = wp.constant(18)
MATH_ROUND = wp.constant(19)
MATH_FLOOR = wp.constant(20)
MATH_CEIL = wp.constant(21)
MATH_TRUNC = wp.constant(22)
MATH_FRACT = wp.constant(23)
MATH_MODULO = wp.constant(24)
MATH_FLOORED_MODULO = wp.constant(25)
MATH_WRAP = wp.constant(26)
MATH_SNAP = wp.constant(27)
MATH_PINGPONG = wp.constant(28)
MATH_SINE = wp.constant(29)
MATH_COSINE = wp.constant(30)
MATH_TANGENT = wp.constant(31)
MATH_ARCSINE = wp.constant(32)
MATH_ARCCOSINE = wp.constant(33)
MATH_ARCTANGENT = wp.constant(34)
MATH_ARCTAN2 = wp.constant(35)
MATH_SINH = wp.constant(36)
MATH_COSH = wp.constant(37)
MATH_TANH = wp.constant(38)
MATH_RADIANS = wp.constant(39)
MATH_DEGREES = wp.constant(40)
MATH_CLAMP = wp.constant(41)
"""min(max(a, b), c)"""
MATH_MAP_SMOOTHSTEP = wp.constant(42)
MATH_MAP_SMOOTHERSTEP = wp.constant(43)
MATH_MAP_LINEAR = wp.constant(44)
"""The factor of Map Range: a value, b from, c to; NaN-free marker handled by the builder"""
MATH_UNEQUAL = wp.constant(45)
"""1 where a differs from b"""

# OP_VECTOR: names follow Blender's ShaderNodeVectorMath.operation, then our own.
VECTOR_ADD = wp.constant(0)
VECTOR_SUBTRACT = wp.constant(1)
VECTOR_MULTIPLY = wp.constant(2)
VECTOR_DIVIDE = wp.constant(3)
VECTOR_MULTIPLY_ADD = wp.constant(4)
VECTOR_CROSS_PRODUCT = wp.constant(5)
VECTOR_PROJECT = wp.constant(6)
VECTOR_REFLECT = wp.constant(7)
VECTOR_REFRACT = wp.constant(8)
VECTOR_FACEFORWARD = wp.constant(9)
VECTOR_DOT_PRODUCT = wp.constant(10)
VECTOR_DISTANCE = wp.constant(11)
VECTOR_LENGTH = wp.constant(12)
VECTOR_SCALE = wp.constant(13)
VECTOR_NORMALIZE = wp.constant(14)
VECTOR_ABSOLUTE = wp.constant(15)
VECTOR_MINIMUM = wp.constant(16)
VECTOR_MAXIMUM = wp.constant(17)
VECTOR_FLOOR = wp.constant(18)
VECTOR_CEIL = wp.constant(19)
VECTOR_FRACTION = wp.constant(20)
VECTOR_MODULO = wp.constant(21)
VECTOR_WRAP = wp.constant(22)
VECTOR_SNAP = wp.constant(23)
VECTOR_SINE = wp.constant(24)
VECTOR_COSINE = wp.constant(25)
VECTOR_TANGENT = wp.constant(26)
VECTOR_ROUND = wp.constant(27)
VECTOR_POWER = wp.constant(28)
VECTOR_SIGN = wp.constant(29)
VECTOR_COMBINE = wp.constant(30)
"""(a.x, b.x, c.x)"""
VECTOR_X = wp.constant(31)
VECTOR_Y = wp.constant(32)
VECTOR_Z = wp.constant(33)
VECTOR_W = wp.constant(34)
"""One component, in all of xyz"""
VECTOR_XYZ = wp.constant(35)
"""xyz with w = 0"""
VECTOR_AVERAGE = wp.constant(36)
VECTOR_ROTATE = wp.constant(37)
"""a rotated by the Euler angles b (XYZ)"""
VECTOR_ROTATE_INVERSE = wp.constant(38)
VECTOR_ROTATE_AXIS = wp.constant(39)
"""a about the axis b (any length, 0: unchanged) by the angle c.x"""
VECTOR_NORMAL_DOT = wp.constant(40)
"""Dot product of a with b normalised"""
VECTOR_BOX_WEIGHTS = wp.constant(41)
"""Weights of the three sides of box projection: a object-space normal, b.x blend"""
VECTOR_BOX_UV = wp.constant(42)
"""Coordinate of one side: a coordinate, b normal, c.x side 0..2"""
VECTOR_WITH_W = wp.constant(43)
"""a with b.x as its w, the fourth coordinate of patterns in four dimensions"""

# OP_MIX: names follow Blender's blend_type.
MIX_MIX = wp.constant(0)
MIX_MULTIPLY = wp.constant(1)
MIX_ADD = wp.constant(2)
MIX_SUBTRACT = wp.constant(3)
MIX_SCREEN = wp.constant(4)
MIX_OVERLAY = wp.constant(5)
MIX_DIVIDE = wp.constant(6)
MIX_DIFFERENCE = wp.constant(7)
MIX_EXCLUSION = wp.constant(8)
MIX_DARKEN = wp.constant(9)
MIX_LIGHTEN = wp.constant(10)
MIX_DODGE = wp.constant(11)
MIX_BURN = wp.constant(12)
MIX_HUE = wp.constant(13)
MIX_SATURATION = wp.constant(14)
MIX_VALUE = wp.constant(15)
MIX_COLOR = wp.constant(16)
MIX_SOFT_LIGHT = wp.constant(17)
MIX_LINEAR_LIGHT = wp.constant(18)

# OP_COLOR.
COLOR_LUMINANCE = wp.constant(0)
COLOR_CLAMP = wp.constant(1)
COLOR_INVERT = wp.constant(2)
COLOR_GAMMA = wp.constant(3)
COLOR_BRIGHT_CONTRAST = wp.constant(4)
COLOR_HUE_SATURATION = wp.constant(5)
COLOR_FROM_HSV = wp.constant(6)
COLOR_FROM_HSL = wp.constant(7)
COLOR_TO_HSV = wp.constant(8)
COLOR_TO_HSL = wp.constant(9)
COLOR_BLACKBODY = wp.constant(10)

# OP_INPUT; the sub-operation's bits 8-9 select the bump offset (0 none, 1 along x, 2 along y).
INPUT_UV = wp.constant(0)
INPUT_ATTRIBUTE = wp.constant(1)
INPUT_POSITION = wp.constant(2)
INPUT_GENERATED = wp.constant(3)
INPUT_OBJECT = wp.constant(4)
INPUT_NORMAL = wp.constant(5)
INPUT_TRUE_NORMAL = wp.constant(6)
INPUT_OBJECT_NORMAL = wp.constant(7)
INPUT_INCOMING = wp.constant(8)
INPUT_REFLECTION = wp.constant(9)
INPUT_PARAMETRIC = wp.constant(10)
INPUT_BACKFACING = wp.constant(11)
INPUT_TANGENT_X = wp.constant(12)
INPUT_TANGENT_Y = wp.constant(13)
INPUT_TANGENT_Z = wp.constant(14)
INPUT_TANGENT_UV = wp.constant(15)
INPUT_WINDOW = wp.constant(16)
INPUT_OBJECT_LOCATION = wp.constant(17)
INPUT_OBJECT_COLOR = wp.constant(18)
INPUT_OBJECT_INDEX = wp.constant(19)
INPUT_OBJECT_RANDOM = wp.constant(20)
INPUT_MATERIAL_INDEX = wp.constant(21)
INPUT_RAY_KIND = wp.constant(22)
"""1 where the ray's visibility has a bit of the immediate"""
INPUT_RAY_LENGTH = wp.constant(23)
INPUT_RAY_DEPTH = wp.constant(24)
INPUT_SCENE_POSITION = wp.constant(25)
"""Position relative to the scene's origin"""
INPUT_PROPERTY = wp.constant(26)
"""A property of the object or its instancer (engine/object_properties.py)"""
INPUT_KIND_DEPTH = wp.constant(27)
"""How many rays of the kind that is the immediate (a VISIBLE_* bit) the path has had, up to DEPTH_MASK"""
INPUT_WIREFRAME = wp.constant(28)
"""1 within half the operand of an edge of the triangle"""
INPUT_SHIFT_X = wp.constant(1 << 8)
INPUT_SHIFT_Y = wp.constant(2 << 8)

# OP_IMAGE: bits 0-3 projection, 4-5 extension, 6-8 interpolation (8: multiply the colour by alpha), see texture.py.
PROJECTION_FLAT = wp.constant(0)
PROJECTION_SPHERE = wp.constant(1)
PROJECTION_TUBE = wp.constant(2)
PROJECTION_EQUIRECTANGULAR = wp.constant(3)
PROJECTION_MIRROR_BALL = wp.constant(4)
PROJECTION_SKY = wp.constant(5)
"""The images of engine/sky: a direction whose z is the sine of its elevation, the sun's azimuth along +x"""
IMAGE_ASSOCIATE = wp.constant(1 << 8)

# OP_TRANSFORM.
TRANSFORM_POINT = wp.constant(0)
TRANSFORM_DIRECTION = wp.constant(1)

# OP_SPACE: vectors between object and world space.
SPACE_POINT_TO_WORLD = wp.constant(0)
SPACE_POINT_TO_OBJECT = wp.constant(1)
SPACE_DIRECTION_TO_WORLD = wp.constant(2)
SPACE_DIRECTION_TO_OBJECT = wp.constant(3)
SPACE_NORMAL_TO_WORLD = wp.constant(4)
SPACE_NORMAL_TO_OBJECT = wp.constant(5)

# OP_RAMP: tables of RAMP_SIZE entries.
RAMP_SIZE = wp.constant(256)
RAMP_LINEAR = wp.constant(0)
"""Look-up by a.x with interpolation; all four channels"""
RAMP_CONSTANT = wp.constant(1)
RAMP_CURVES = wp.constant(2)
"""x, y, z each through its own channel, mixed by the factor w.x; the table's domain is constants[-1 - z's] xy"""
RAMP_CURVES_EXTRAPOLATED = wp.constant(3)

# OP_PROCEDURAL: a is the coordinate, scaled already.
PROCEDURAL_CHECKER = wp.constant(0)
PROCEDURAL_GRADIENT_LINEAR = wp.constant(1)
PROCEDURAL_GRADIENT_QUADRATIC = wp.constant(2)
PROCEDURAL_GRADIENT_EASING = wp.constant(3)
PROCEDURAL_GRADIENT_DIAGONAL = wp.constant(4)
PROCEDURAL_GRADIENT_RADIAL = wp.constant(5)
PROCEDURAL_GRADIENT_QUADRATIC_SPHERE = wp.constant(6)
PROCEDURAL_GRADIENT_SPHERICAL = wp.constant(7)
PROCEDURAL_NOISE = wp.constant(8)
"""Fractal Perlin noise in 3D: b = (detail, roughness, lacunarity), c = (distortion, 1 to normalise, 0)"""
PROCEDURAL_NOISE_COLOR = wp.constant(9)
PROCEDURAL_WAVE = wp.constant(10)
"""Wave profile of the phase a.x: b.x = 0 sine, 1 saw, 2 triangle"""
PROCEDURAL_MAGIC = wp.constant(11)
"""b = (depth, distortion, 0)"""
PROCEDURAL_BRICK = wp.constant(12)
"""b = (offset, offset frequency, squash), c = (squash frequency, brick width, row height); see node_noise.brick"""
PROCEDURAL_BRICK_MORTAR = wp.constant(13)
"""Share of mortar at the edge distance a.x: b = (mortar size, smoothness, 0)"""
PROCEDURAL_WHITE_NOISE_1 = wp.constant(16)
"""One to four dimensions (the fourth in b.x); the colour's codes follow"""
PROCEDURAL_WHITE_NOISE_COLOR_1 = wp.constant(20)
PROCEDURAL_VORONOI = wp.constant(1 << 10)
"""Cells: b = (detail, roughness, lacunarity), c = (randomness, smoothness, exponent); the bits below it say what of"""
VORONOI_1D = wp.constant(0)
VORONOI_2D = wp.constant(1)
VORONOI_3D = wp.constant(2)
VORONOI_4D = wp.constant(3)
VORONOI_METRICS = wp.constant(3 << 2)
"""Mask, as VORONOI_FEATURES"""
VORONOI_EUCLIDEAN = wp.constant(0)
VORONOI_MANHATTAN = wp.constant(1 << 2)
VORONOI_CHEBYCHEV = wp.constant(2 << 2)
VORONOI_MINKOWSKI = wp.constant(3 << 2)
VORONOI_FEATURES = wp.constant(3 << 4)
VORONOI_F1 = wp.constant(0)
"""Distance to the nearest point, a smooth minimum where c has a smoothness"""
VORONOI_F2 = wp.constant(1 << 4)
VORONOI_EDGE = wp.constant(2 << 4)
"""Distance to the nearest border; as VORONOI_RADIUS only with VORONOI_EUCLIDEAN"""
VORONOI_RADIUS = wp.constant(3 << 4)
"""Half the distance from the nearest point to its own nearest neighbor"""
VORONOI_NORMALIZE = wp.constant(1 << 6)
"""Divide color and distance by the greatest that the octaves add up to"""
VORONOI_POSITION = wp.constant(1 << 7)
"""Return the point's position instead of the distance; not with VORONOI_NORMALIZE or VORONOI_COLOR"""
VORONOI_COLOR = wp.constant(1 << 8)
"""Return the color, too; only with VORONOI_F1 and VORONOI_F2"""
PROCEDURAL_GABOR = wp.constant(1 << 11)
"""Value, phase and intensity of Gabor noise: b = (frequency, anisotropy, angle in 2D), c direction in 3D"""
GABOR_2D = wp.constant(0)
GABOR_3D = wp.constant(1)

# OP_FRESNEL.
FRESNEL_IOR = wp.constant(0)
FRESNEL_BLEND = wp.constant(1)
FRESNEL_FACING = wp.constant(2)

# OP_NORMAL_MAP: bits 0-1 space, then flags.
NORMAL_TANGENT = wp.constant(0)
NORMAL_OBJECT = wp.constant(1)
NORMAL_WORLD = wp.constant(2)
NORMAL_INVERT_GREEN = wp.constant(4)
NORMAL_BLENDER_AXES = wp.constant(8)
"""Negate y and z, Blender's convention of its own bakes"""

# OP_CLOSURE: the sub-operation's low byte is the kind (types.CLOSURE_*), then flags.
CLOSURE_MULTISCATTER = wp.constant(1 << 8)
CLOSURE_SUBSURFACE_SHIFT = wp.constant(9)
CLOSURE_SUBSURFACE = wp.constant(3 << 9)
"""How the Principled BSDF scatters light below the surface: one of SUBSURFACE_*"""
CLOSURE_FILM = wp.constant(1 << 11)
"""FILM_ARGUMENT_COUNT arguments follow, whatever the kind"""
SUBSURFACE_NONE = wp.constant(0)
SUBSURFACE_WALK = wp.constant(1)
"""Random walk: the radius is the mean free path"""
SUBSURFACE_LEGACY = wp.constant(2)
"""Random walk with the radii of Blender before 5.2"""
SUBSURFACE_SKIN = wp.constant(3)
"""The same, whose radii grow darker colours' narrower"""

# Slots of a closure's arguments, three to an instruction word; simple BSDFs use the first nine.
ARG_WEIGHT = wp.constant(0)
ARG_COLOR = wp.constant(1)
ARG_NORMAL = wp.constant(2)
ARG_ROUGHNESS = wp.constant(3)
ARG_IOR = wp.constant(4)
ARG_TANGENT = wp.constant(5)
ARG_ANISOTROPIC = wp.constant(6)
ARG_ANISOTROPIC_ROTATION = wp.constant(7)
ARG_DIFFUSE_ROUGHNESS = wp.constant(8)
ARG_METALLIC = wp.constant(9)
ARG_SPECULAR_LEVEL = wp.constant(10)
ARG_SPECULAR_TINT = wp.constant(11)
ARG_TRANSMISSION = wp.constant(12)
ARG_SUBSURFACE = wp.constant(13)
ARG_COAT = wp.constant(14)
ARG_COAT_ROUGHNESS = wp.constant(15)
ARG_COAT_IOR = wp.constant(16)
ARG_COAT_TINT = wp.constant(17)
ARG_COAT_NORMAL = wp.constant(18)
ARG_SHEEN = wp.constant(19)
ARG_SHEEN_ROUGHNESS = wp.constant(20)
ARG_SHEEN_TINT = wp.constant(21)
ARG_EMISSION = wp.constant(22)
ARG_THIN_WALL = wp.constant(23)
# Of closures with CLOSURE_SUBSURFACE alone.
ARG_SUBSURFACE_RADIUS = wp.constant(24)
ARG_SUBSURFACE_IOR = wp.constant(25)
"""0: that of the reflection"""
ARG_SUBSURFACE_ANISOTROPY = wp.constant(26)
# Of closures with CLOSURE_FILM alone.
ARG_FILM_THICKNESS = wp.constant(27)
ARG_FILM_IOR = wp.constant(28)
