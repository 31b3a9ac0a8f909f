# SPDX-License-Identifier: GPL-3.0-or-later
"""engine/one_sided.py: the far side of strands."""

from __future__ import annotations

import pytest
from burnish.engine.mesh_features import STRAND
from burnish.engine.one_sided import hide_back_of_hair
from burnish.engine.program import ProgramBuilder


def principled(builder: ProgramBuilder, **arguments: float) -> None:
    """Add a Principled BSDF, opaque unless `arguments` say otherwise."""
    builder.closure("PRINCIPLED", 1.0, **({"transmission": 0.0, "thin_wall": 0.0} | arguments))


@pytest.mark.parametrize("kind", ["DIFFUSE", "GLOSSY", "PRINCIPLED", "EMISSION"])
def test_opaque_surfaces_stay(kind):
    """Programs that no light passes through are the same, bit by bit."""
    programs = []
    for hidden in (False, True):
        builder = ProgramBuilder()
        if kind == "EMISSION":
            builder.emit((1.0, 0.5, 0.2), 2.0, 1.0)
        elif kind == "PRINCIPLED":
            principled(builder)
        else:
            builder.closure(kind, 1.0, color=(0.5, 0.5, 0.5))
        if hidden:
            hide_back_of_hair(builder)
        programs.append((builder.finish(), builder.has_transparency()))
    assert programs[0] == programs[1]


@pytest.mark.parametrize("kind", ["TRANSPARENT", "TRANSLUCENT", "GLASS", "REFRACTION", "PRINCIPLED", "THIN"])
def test_far_sides_of_strands_let_light_through(kind):
    """What light passes through is transparent where the back of hair is seen; weights of all else go down with it."""
    builder = ProgramBuilder()
    builder.closure("DIFFUSE", 0.25, color=(0.5, 0.5, 0.5))
    if kind == "TRANSPARENT":
        builder.transparent(1.0, 0.75)
    elif kind in ("PRINCIPLED", "THIN"):
        principled(builder, **{"transmission" if kind == "PRINCIPLED" else "thin_wall": 1.0})
    else:
        builder.closure(kind, 0.75, color=(0.5, 0.5, 0.5))
    count = len(builder.sinks)
    hide_back_of_hair(builder)
    assert len(builder.sinks) == count + 1 and builder.has_transparency()
    program = builder.finish()
    assert program.attributes == (STRAND,) and program.transparency
