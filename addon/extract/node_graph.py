# SPDX-License-Identifier: GPL-3.0-or-later
"""Walks an inlined node tree and hands its nodes to the translators of the sibling files.

A Graph knows links, socket types and conversions between them; what a node means is in the functions registered
with `translates`. Nothing here raises for odd input: what can't be followed becomes the socket's default value and
one entry of the report.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from ...engine.program import ProgramBuilder, Value
from ...engine.report import Report, ReportKind

__all__ = ["Graph", "no_property", "translates"]

Translator = Callable[["Graph", Any, str], Value]

TRANSLATORS: dict[str, Translator] = {}
"""By bl_idname: (graph, node, identifier of the output) to its value"""

UNEXPECTED = (AttributeError, KeyError, IndexError, TypeError, ValueError)
"""What a node of an older or newer Blender may lead to: an option, a socket or a property that isn't known"""

MEAN_VALUE = 0.5
"""Stands in for what isn't evaluated"""


def translates(*names: str) -> Callable[[Translator], Translator]:
    """Register a function as the translator of node types."""

    def register(function: Translator) -> Translator:
        for name in names:
            TRANSLATORS[name] = function
        return function

    return register


def no_property(name: str) -> tuple[float, ...]:
    """Return what a view layer without properties says."""
    return 0.0, 0.0, 0.0, 0.0


class Graph:
    """One node tree being compiled."""

    def __init__(self, tree, builder: ProgramBuilder, images, report: Report, owner: str, *, world: bool = False,
                 lamp: bool = False, layer: Callable[[str], tuple[float, ...]] = no_property,
                 exact: bool = False, hair: bool = False, scatters: bool = False):
        """Index the links of `tree`.

        Args:
            tree: Inlined node tree; its wrapper must stay alive as long as the graph.
            builder: Receives the operations.
            images: Image collector, `key(image, image_user)` and `computed(key, name, signature, make)`.
            report: Receives what can't be followed.
            owner: Name of the data-block for messages.
            world: Whether the tree is seen from directions instead of surface points.
            lamp: Whether it is a lamp's, which has no mesh.
            layer: Returns a property of the view layer.
            exact: Whether it is for MaterialData.exact, where nodes may send rays.
            hair: Whether hair has the material.
            scatters: Whether it is for MaterialData.hair, where hair scatters light.
        """
        self.builder = builder
        self.images = images
        self.report = report
        self.owner = owner
        self.world = world
        self.lamp = lamp
        self.layer = layer
        self.exact = exact
        self.hair = hair
        self.scatters = scatters
        self.wants_exact = False
        """Whether an exact program would say more than this one"""
        self.wants_hair = False
        """Whether hair scatters light"""
        self.tree = tree
        self.normal: Value = builder.constant(0.0)
        """Normal of shaders without one: 0 is the shading normal"""
        self.from_rec709: tuple | None = None
        """Rows of the matrix from Rec.709 to the working space, None where that is Rec.709"""
        self.widths: list[int] = []
        """Widths of panoramas met, for the world's sampling table"""
        self.disc_rays: int | None = None
        """Kinds of rays (Visibility) to which a sky shows its sun's disc, None: all, wherever the sky is used"""
        self.links = {
            (link.to_node.name, link.to_socket.identifier): (link.from_node, link.from_socket)
            for link in tree.links if link.is_valid and not link.is_muted
        }
        self.inputs: dict[str, dict[str, Any]] = {}
        """Inputs of nodes by the names of both, as far as they were asked for"""
        self.outputs_used = {
            (link.from_node.name, link.from_socket.identifier) for link in tree.links if not link.is_muted}
        self.results: dict[tuple[str, str], Value] = {}

    # Messages.

    def tell(self, node, message: str, kind: ReportKind = ReportKind.APPROXIMATED) -> None:
        """Add a report entry about a node."""
        # Inlining puts a number before each name.
        name = re.sub(r"^\d+_", "", node.name)
        self.report.add(kind, self.owner, f"node '{name}' {message}")

    # Sockets.

    def source(self, node, identifier: str):
        """Return (node, socket) linked to an input, or None."""
        return self.links.get((node.name, identifier))

    def input(self, node, identifier: str):
        """Return an input of a node, or None."""
        if node.name not in self.inputs:
            self.inputs[node.name] = {socket.identifier: socket for socket in node.inputs}
        return self.inputs[node.name].get(identifier)

    def is_linked(self, node, identifier: str) -> bool:
        """Return whether an input is linked."""
        return (node.name, identifier) in self.links

    def is_used(self, node, identifier: str) -> bool:
        """Return whether anything is linked to an output."""
        return (node.name, identifier) in self.outputs_used

    def default(self, node, identifier: str, fallback: Any = 0.0) -> Any:
        """Return an input's own value as float or tuple, `fallback` where the node has no such input."""
        socket = self.input(node, identifier)
        if socket is None or not hasattr(socket, "default_value"):
            return fallback
        value = socket.default_value
        return float(value) if isinstance(value, (bool, int, float)) else tuple(float(x) for x in value)

    def value(self, node, identifier: str, fallback: Any = 0.0) -> Value:
        """Return an input: what is linked to it, converted to its type, else its own value."""
        link = self.source(node, identifier)
        socket = self.input(node, identifier)
        if link is None or socket is None:
            default = self.default(node, identifier, fallback)
            return self.builder.constant(default[:3] if isinstance(default, tuple) else default)
        return self.convert(self.output(*link), link[1].type, socket.type)

    def linked_or(self, node, identifier: str, otherwise: Callable[[], Value]) -> Value:
        """Return an input, or `otherwise()` where nothing is linked to it."""
        return self.value(node, identifier) if self.is_linked(node, identifier) else otherwise()

    def convert(self, value: Value, source: str, target: str) -> Value:
        """Return a value as another socket type takes it."""
        if target in ("VALUE", "INT", "BOOLEAN"):
            if source == "RGBA":
                return self.builder.luminance(value)
            if source in ("VECTOR", "ROTATION"):
                return self.builder.vector("AVERAGE", value)
        if target == "INT" and source == "VALUE":
            return self.builder.math("TRUNC", value)
        return value

    def output(self, node, socket) -> Value:
        """Return the value of a node's output."""
        key = (node.name, socket.identifier)
        if key not in self.results:
            translator = TRANSLATORS.get(node.bl_idname, stand_in)
            try:
                self.results[key] = translator(self, node, socket.identifier)
            except UNEXPECTED as error:
                self.tell(node, f"could not be read ({error}); {MEAN_VALUE} stands in for its output", ReportKind.ERROR)
                self.results[key] = self.builder.constant(MEAN_VALUE)
        return self.results[key]


def stand_in(graph: Graph, node, output: str) -> Value:
    """Return a constant for an output of a node that isn't evaluated, and say so."""
    graph.tell(node, f"is not evaluated; {MEAN_VALUE} stands in for its output")
    is_vector = find(node.outputs, output).type == "VECTOR"
    return graph.builder.constant(0.0 if is_vector else MEAN_VALUE)


def find(sockets, identifier: str):
    """Return the socket of an identifier, or None."""
    return next((socket for socket in sockets if socket.identifier == identifier), None)
