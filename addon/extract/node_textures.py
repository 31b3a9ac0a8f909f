# SPDX-License-Identifier: GPL-3.0-or-later
"""Translates texture nodes: images, panoramas, and patterns."""

from __future__ import annotations

from collections.abc import Callable

from mathutils import Euler, Matrix

from ...engine.program import Value
from ...engine.report import ReportKind
from .image_tiles import TiledImage
from .node_graph import Graph, translates
from .node_inputs import generated_coordinate, is_identity, uv_coordinate

__all__: list[str] = []

EXTENSIONS = {'REPEAT': 0, 'EXTEND': 1, 'CLIP': 2, 'MIRROR': 3}
INTERPOLATIONS = {'Linear': 0, 'Closest': 1, 'Cubic': 2, 'Smart': 2}
PROJECTIONS = {'FLAT': "FLAT", 'SPHERE': "SPHERE", 'TUBE': "TUBE"}


def coordinate(graph: Graph, node, default: str) -> Value:
    """Return a texture's coordinate: its input, or UV or GENERATED, through the node's own mapping."""
    build = graph.builder

    def unlinked() -> Value:
        if default == "UV":
            return uv_coordinate(graph, "")
        return generated_coordinate(graph) if default == "GENERATED" else build.input(default)

    vector = build.rgb(graph.linked_or(node, "Vector", unlinked))
    mapping = node.texture_mapping
    axes = (mapping.mapping_x, mapping.mapping_y, mapping.mapping_z)
    if axes != ('X', 'Y', 'Z') or mapping.use_min or mapping.use_max:
        graph.tell(node, "has an old texture mapping with swapped axes or limits, which are ignored")
    stretch = Matrix.Diagonal((*mapping.scale, 1.0))
    matrix = Matrix.Translation(mapping.translation) @ Euler(mapping.rotation, 'XYZ').to_matrix().to_4x4() @ stretch
    rows = [tuple(row) for row in matrix][:3]
    return vector if is_identity(rows) else build.transform(rows, vector)


def missing(graph: Graph, node, output: str) -> Value:
    """Return magenta for a node without an image, as Cycles draws it."""
    graph.tell(node, "has no image; drawn magenta", ReportKind.MISSING)
    return graph.builder.constant(1.0 if output == "Alpha" else (1.0, 0.0, 1.0))


@translates("ShaderNodeTexImage")
def image_node(graph: Graph, node, output: str) -> Value:
    """Image Texture; its colour is multiplied by alpha unless the Alpha output is used, as in Cycles."""
    build = graph.builder
    if node.image is None:
        return missing(graph, node, output)
    if node.interpolation in ('Cubic', 'Smart'):
        graph.tell(node, "asks for cubic interpolation; it is drawn with linear interpolation")
    options = {
        "extension": EXTENSIONS[node.extension], "interpolation": INTERPOLATIONS[node.interpolation],
        "associate": not graph.is_used(node, "Alpha"),
    }
    look_up = plain_lookup(graph, node, options)
    if node.projection == 'BOX':
        return box(graph, node, look_up, output)
    texel = look_up(coordinate(graph, node, "UV"))
    return build.component(texel, 3) if output == "Alpha" else texel


LookUp = Callable[[Value], Value]


def plain_lookup(graph: Graph, node, options: dict) -> LookUp:
    """Return what reads a node's image at a coordinate."""
    build, image = graph.builder, node.image
    if image.source == 'TILED' and node.projection in ('FLAT', 'BOX'):
        # Where Cycles projects files along axes, it reads the first tile's alone.
        first = node.projection == 'BOX' and not image.packed_files
        tiled = graph.images.tiles(image, options["extension"], (1001,) if first else None)
        if tiled is None:
            graph.tell(node, "has an image without tiles; drawn magenta", ReportKind.MISSING)
            return lambda place: build.constant((1.0, 0.0, 1.0, 1.0))
        return lambda place: tile_texel(graph, tiled, place, options)
    key = graph.images.key(image, node.image_user)
    projection = PROJECTIONS.get(node.projection, "FLAT")
    return lambda place: build.image(key, place, projection=projection, **options)


def tile_texel(graph: Graph, tiled: TiledImage, place: Value, options: dict) -> Value:
    """Return the texel of an image of tiles: the tile that the coordinate lies in, as in Cycles (kernel/svm/image.h).

    A table tells where the tile lies in the picture of all; see engine/image_atlas.py.
    """
    build, known, atlas = graph.builder, tiled.range, tiled.atlas
    place = build.rgb(place)
    # Rounded towards 0: what is up to 1 below 0 counts as beyond the border of the first tile.
    corner = [build.math("TRUNC", build.component(place, axis)) for axis in range(2)]
    step = known.columns + 1
    column = build.math("CLAMP", build.math("SUBTRACT", corner[0], float(known.column)), -1.0, float(known.columns))
    row = build.math("CLAMP", build.math("SUBTRACT", corner[1], float(known.row)), -1.0, float(known.rows))
    entry = build.math("MULTIPLY_ADD", row, float(step), column)
    last = len(tiled.table) - 1
    entry = build.math("MULTIPLY_ADD", entry, 1.0 / last, (known.entry_of_first + 0.5) / last)
    found = build.ramp("CONSTANT", tiled.table.tobytes(), entry)
    if options["extension"] == EXTENSIONS['REPEAT']:
        inside = build.vector("FRACTION", place)
    else:
        inside = build.vector("SUBTRACT", place, build.combine(*corner, 0.0))
        if options["extension"] == EXTENSIONS['MIRROR']:
            inside = build.vector("ABSOLUTE", inside)
        elif options["extension"] == EXTENSIONS['EXTEND']:
            inside = build.vector("MAXIMUM", inside, 0.0)
    size = [build.component(found, axis) for axis in (2, 3)]
    where = build.vector("MULTIPLY", inside, build.combine(*size, 0.0))
    if options["extension"] == EXTENSIONS['CLIP']:
        # Beyond the border, but within what continues the tile.
        reach = -0.5 * atlas.border
        where = build.vector("MAXIMUM", where, (reach / atlas.width, reach / atlas.height, 0.0))
    where = build.vector("ADD", where, found)
    # Widths are in units of the longer side: of the tile, then of the picture.
    longer = max(atlas.width, atlas.height)
    share = build.math("MAXIMUM", build.math("MULTIPLY", size[0], atlas.width / longer),
                       build.math("MULTIPLY", size[1], atlas.height / longer))
    width = build.math("MULTIPLY", build.component(place, 3), share)
    return build.image(tiled.key, build.vector("WITH_W", where, width),
                       **{**options, "extension": EXTENSIONS['EXTEND']})


def box(graph: Graph, node, look_up: LookUp, output: str) -> Value:
    """Return an image projected along the three axes of the object, blended by its normal."""
    build = graph.builder
    place, normal = coordinate(graph, node, "UV"), build.input("OBJECT_NORMAL")
    weights = build.vector("BOX_WEIGHTS", normal, node.projection_blend)
    total = build.constant(0.0)
    for side in range(3):
        texel = look_up(build.vector("BOX_UV", place, normal, float(side)))
        part = build.component(texel, 3) if output == "Alpha" else build.rgb(texel)
        total = build.vector("MULTIPLY_ADD", part, build.component(weights, side), total)
    return total


@translates("ShaderNodeTexEnvironment")
def environment_node(graph: Graph, node, output: str) -> Value:
    """Environment Texture."""
    build = graph.builder
    if node.image is None:
        return missing(graph, node, output)
    graph.widths.append(node.image.size[0])
    projection = "MIRROR_BALL" if node.projection == 'MIRROR_BALL' else "EQUIRECTANGULAR"
    return build.image(
        graph.images.key(node.image, node.image_user), coordinate(graph, node, "POSITION"), projection=projection,
        extension=EXTENSIONS['REPEAT'], interpolation=INTERPOLATIONS[node.interpolation], associate=True)


def scaled(graph: Graph, node) -> Value:
    """Return a pattern's coordinate times its scale."""
    return graph.builder.vector("MULTIPLY", coordinate(graph, node, "GENERATED"), graph.value(node, "Scale"))


@translates("ShaderNodeTexChecker")
def checker_node(graph: Graph, node, output: str) -> Value:
    """Checker Texture."""
    build = graph.builder
    factor = build.procedural("CHECKER", scaled(graph, node))
    if output == "Fac":
        return factor
    return build.mix("MIX", factor, graph.value(node, "Color2"), graph.value(node, "Color1"))


@translates("ShaderNodeTexGradient")
def gradient_node(graph: Graph, node, output: str) -> Value:
    """Gradient Texture."""
    return graph.builder.procedural("GRADIENT_" + node.gradient_type, coordinate(graph, node, "GENERATED"))


@translates("ShaderNodeTexWhiteNoise")
def white_noise_node(graph: Graph, node, output: str) -> Value:
    """White Noise Texture."""
    build = graph.builder
    count = int(node.noise_dimensions[0])
    w = graph.value(node, "W")
    vector = w if count == 1 else build.rgb(graph.linked_or(node, "Vector", lambda: generated_coordinate(graph)))
    kind = "WHITE_NOISE_COLOR_1" if output == "Color" else "WHITE_NOISE_1"
    return build.white_noise(kind, count, vector, w)


@translates("ShaderNodeTexNoise")
def noise_node(graph: Graph, node, output: str) -> Value:
    """Noise Texture: fractal noise in three dimensions; other kinds have the same look but other values."""
    build = graph.builder
    kind = "NOISE_COLOR" if output == "Color" else "NOISE"
    if node.noise_type != 'FBM' or node.noise_dimensions != '3D':
        graph.tell(node, f"is {node.noise_dimensions} {node.noise_type} noise; 3D FBM noise is drawn instead")
    place = scaled(graph, node)
    if node.noise_dimensions == '1D':
        place = build.combine(build.math("MULTIPLY", graph.value(node, "W"), graph.value(node, "Scale")), 0.0, 0.0)
    octaves = build.combine(*(graph.value(node, name) for name in ("Detail", "Roughness", "Lacunarity")))
    normalize = 1.0 if node.normalize or node.noise_type != 'FBM' else 0.0
    return build.procedural(kind, place, octaves, build.combine(graph.value(node, "Distortion"), normalize, 0.0))


@translates("ShaderNodeTexWave")
def wave_node(graph: Graph, node, output: str) -> Value:
    """Wave Texture: a phase along an axis or a radius, plus noise, through a profile."""
    build = graph.builder
    place = scaled(graph, node)
    # Keeps whole coordinates off the profile's jumps.
    nudged = build.vector("SCALE", build.vector("ADD", place, 0.000001), 0.0, 0.999999)
    bands = node.wave_type == 'BANDS'
    axis = node.bands_direction if bands else node.rings_direction
    if bands and axis == 'DIAGONAL':
        phase = build.math("MULTIPLY", build.vector("DOT_PRODUCT", nudged, 1.0), 10.0)
    elif bands:
        phase = build.math("MULTIPLY", build.component(nudged, "XYZ".index(axis)), 20.0)
    else:
        kept = [0.0 if letter == axis else 1.0 for letter in "XYZ"]
        phase = build.math("MULTIPLY", build.vector("LENGTH", build.vector("MULTIPLY", nudged, kept)), 20.0)
    phase = build.math("ADD", phase, graph.value(node, "Phase Offset"))
    distortion = graph.value(node, "Distortion")
    if distortion.constant is None or distortion.constant[0] != 0.0:
        octaves = build.combine(graph.value(node, "Detail"), graph.value(node, "Detail Roughness"), 2.0)
        finer = build.vector("MULTIPLY", nudged, graph.value(node, "Detail Scale"))
        noise = build.procedural("NOISE", finer, octaves, build.combine(0.0, 1.0, 0.0))
        swing = build.math("MULTIPLY_ADD", noise, 2.0, -1.0)
        phase = build.math("MULTIPLY_ADD", swing, distortion, phase)
    return build.procedural("WAVE", phase, float(('SIN', 'SAW', 'TRI').index(node.wave_profile)))


@translates("ShaderNodeTexMagic")
def magic_node(graph: Graph, node, output: str) -> Value:
    """Magic Texture."""
    build = graph.builder
    params = build.combine(float(node.turbulence_depth), graph.value(node, "Distortion"), 0.0)
    color = build.procedural("MAGIC", scaled(graph, node), params)
    return build.vector("AVERAGE", color) if output == "Fac" else color


@translates("ShaderNodeTexBrick")
def brick_node(graph: Graph, node, output: str) -> Value:
    """Brick Texture: tint per brick between two colours, mortar by the distance to the edge."""
    build = graph.builder
    bricks = build.procedural(
        "BRICK", scaled(graph, node),
        (node.offset, float(node.offset_frequency), node.squash),
        build.combine(
            float(node.squash_frequency), graph.value(node, "Brick Width"), graph.value(node, "Row Height")))
    edge = build.component(bricks, 1)
    joint = build.procedural(
        "BRICK_MORTAR", edge, build.combine(graph.value(node, "Mortar Size"), graph.value(node, "Mortar Smooth"), 0.0))
    if output == "Fac":
        return joint
    tint = build.math("CLAMP", build.math("ADD", build.component(bricks, 0), graph.value(node, "Bias")), 0.0, 1.0)
    color = build.mix("MIX", tint, graph.value(node, "Color1"), graph.value(node, "Color2"))
    return build.mix("MIX", joint, color, graph.value(node, "Mortar"))


VORONOI_FEATURES = {
    'F1': "F1", 'F2': "F2", 'SMOOTH_F1': "F1", 'DISTANCE_TO_EDGE': "EDGE", 'N_SPHERE_RADIUS': "RADIUS"}


@translates("ShaderNodeTexVoronoi")
def voronoi_node(graph: Graph, node, output: str) -> Value:
    """Voronoi Texture; outputs that a feature doesn't have are 0."""
    build = graph.builder
    dimensions, feature = node.voronoi_dimensions, VORONOI_FEATURES[node.feature]
    has_cells = feature in ("F1", "F2")
    known = {"Distance", "Color", "Position", "W"} if has_cells else {"Radius" if feature == "RADIUS" else "Distance"}
    if output not in known:
        return build.constant(0.0)
    scale = graph.value(node, "Scale")
    w = build.math("MULTIPLY", graph.value(node, "W"), scale)
    place = w if dimensions == '1D' else scaled(graph, node)
    if dimensions == '4D':
        place = build.vector("WITH_W", place, w)
    # Along a line all metrics are the same; the other features know Euclid's alone.
    metric = "EUCLIDEAN" if not has_cells else "MANHATTAN" if dimensions == '1D' else node.distance
    options = [dimensions, metric, feature]
    if output in ("Position", "W"):
        options.append("POSITION")
    else:
        # One evaluation serves distance and color.
        options += ["COLOR"] if has_cells and graph.is_used(node, "Color") else []
        options += ["NORMALIZE"] if node.normalize and feature != "RADIUS" else []
    octaves = build.combine(*(graph.value(node, name) for name in ("Detail", "Roughness", "Lacunarity")))
    smoothness = graph.value(node, "Smoothness") if node.feature == 'SMOOTH_F1' else 0.0
    exponent = graph.value(node, "Exponent") if metric == "MINKOWSKI" else 0.0
    shape = build.combine(graph.value(node, "Randomness"), smoothness, exponent)
    cells = build.procedural("VORONOI", place, octaves, shape, *options)
    if output == "Color":
        return build.vector("XYZ", cells)
    if output == "Position":
        return build.constant(0.0) if dimensions == '1D' else build.vector("DIVIDE", build.vector("XYZ", cells), scale)
    if output == "W":
        last = {'1D': 0, '4D': 3}.get(dimensions)
        return build.constant(0.0) if last is None else build.math("DIVIDE", build.component(cells, last), scale)
    return build.component(cells, 3)


@translates("ShaderNodeTexGabor")
def gabor_node(graph: Graph, node, output: str) -> Value:
    """Gabor Texture."""
    build = graph.builder
    noise = build.procedural(
        "GABOR", scaled(graph, node),
        build.combine(*(graph.value(node, name) for name in ("Frequency", "Anisotropy", "Orientation 2D"))),
        graph.value(node, "Orientation 3D"), node.gabor_type)
    return build.component(noise, ("Value", "Phase", "Intensity").index(output))
