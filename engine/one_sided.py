# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs of surfaces that aren't there from behind: those of hair, whose back Cycles' rays ignore.

A ray that passes through a strand, or is scattered into it, meets it once. Tubes have a far side: it lets everything
through. What no light passes through needs nothing of this, as nothing sees the inside of a tube.
"""

from __future__ import annotations

from dataclasses import replace

from ..kernels import node_codes as codes
from ..kernels import types as kernel_types
from .closure_arguments import ARGUMENTS
from .mesh_features import STRAND
from .program import ProgramBuilder
from .program_layout import Sink

__all__ = ["hide_back_of_hair"]

_WEIGHTS = {int(codes.OP_EMIT): 2, int(codes.OP_TRANSPARENT): 1, int(codes.OP_HOLDOUT): 0,
            int(codes.OP_CLOSURE): int(codes.ARG_WEIGHT)}
"""Which operand of a sink is its weight"""

_THROUGH = {int(kind) for kind in (
    kernel_types.CLOSURE_GLASS, kernel_types.CLOSURE_REFRACTION, kernel_types.CLOSURE_TRANSLUCENT)}


def hide_back_of_hair(builder: ProgramBuilder) -> None:
    """Make the far side of strands transparent, where light passes through the near one; other meshes stay."""
    if not any(_lets_through(builder, sink) for sink in builder.sinks):
        return
    back = builder.math(
        "MULTIPLY", builder.input("BACKFACING"), builder.component(builder.attribute(STRAND), 3))
    front = builder.math("SUBTRACT", 1.0, back)
    builder.sinks = [_weighted(builder, sink, front) for sink in builder.sinks]
    builder.transparent(1.0, back)


def _lets_through(builder: ProgramBuilder, sink: Sink) -> bool:
    if sink.op != codes.OP_CLOSURE:
        return sink.op == codes.OP_TRANSPARENT
    kind = sink.sub & 255
    if kind != kernel_types.CLOSURE_PRINCIPLED:
        return kind in _THROUGH
    constants = [builder.values[sink.operands[ARGUMENTS[name]]].constant for name in ("transmission", "thin_wall")]
    return any(constant is None or any(constant[:3]) for constant in constants)


def _weighted(builder: ProgramBuilder, sink: Sink, factor) -> Sink:
    """Return a sink with its weight times a value."""
    place = _WEIGHTS[int(sink.op)]
    weight = builder.math("MULTIPLY", builder.values[sink.operands[place]], factor)
    return replace(sink, operands=(*sink.operands[:place], weight.index, *sink.operands[place + 1:]))
