# SPDX-License-Identifier: GPL-3.0-or-later
"""Translates IES Texture nodes: the profile becomes a panorama of directions."""

from __future__ import annotations

import hashlib
import os

import bpy

from ...engine.ies import IesUnreadable, read_ies
from ...engine.program import Value
from ...engine.report import ReportKind
from .node_graph import Graph, translates

__all__: list[str] = []

UNREADABLE = 100.0
"""What Cycles 5.2 takes for a profile that it can't read (kernel/util/ies.h)"""


def profile_text(node) -> str:
    """Return the text of a node's profile; raises OSError or IesUnreadable where there is none."""
    if node.mode == 'INTERNAL':
        if node.ies is None:
            raise IesUnreadable("no text is chosen")
        return node.ies.as_string()
    path = bpy.path.abspath(node.filepath)
    if not path or not os.path.isfile(path):
        raise IesUnreadable(f"there is no file '{path}'")
    with open(path, encoding="latin-1") as file:
        return file.read()


@translates("ShaderNodeTexIES")
def ies_node(graph: Graph, node, output: str) -> Value:
    """IES Texture: the brightness in the direction of its vector, by default that of the light, as the lamp has it."""
    build = graph.builder
    strength = graph.value(node, "Strength")
    try:
        text = profile_text(node)
        profile = read_ies(text)
    except (OSError, IesUnreadable) as error:
        message = f"has an IES profile that can't be read: {error}; {UNREADABLE:g} stands in for it, as in Cycles"
        graph.tell(node, message, ReportKind.MISSING)
        return build.math("MULTIPLY", strength, UNREADABLE)
    key = ("ies", hashlib.sha256(text.encode("utf-8", "replace")).hexdigest())
    graph.images.computed(key, f"IES profile of {graph.owner}", key, profile.panorama)
    direction = build.rgb(graph.linked_or(
        node, "Vector", lambda: build.space("NORMAL_TO_OBJECT", build.input("INCOMING"))))
    value = build.image(key, direction, projection="EQUIRECTANGULAR")
    return build.math("MULTIPLY", strength, build.vector("X", value))
