# SPDX-License-Identifier: GPL-3.0-or-later
"""The structure of the package: which layer may import what, and the manners every file keeps.

Layers, top first: addon (bpy, engine; ui and nothing else from register) and ui (bpy, engine.settings and presets),
engine (kernels, Warp, NumPy; OpenImageIO in three files), kernels (Warp).
"""

from __future__ import annotations

import ast
import functools
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LAYERS = ("addon", "engine", "kernels", "ui")
MAX_LINES = 400

BLENDER = {"bpy", "bpy_extras", "bl_ui", "bl_operators", "blf", "gpu", "gpu_extras", "idprop", "imbuf", "mathutils",
           "nodeitems_utils", "rna_prop_ui"}
OUTSIDE = {
    "kernels": {"warp"},
    "engine": {"warp", "numpy"},
    "addon": {"numpy"} | BLENDER,
    "ui": BLENDER,
}
"""Third-party modules that each layer may import; the standard library is free to all but kernels."""
INSIDE = {
    "kernels": {"kernels"},
    "engine": {"engine", "kernels"},
    "addon": {"addon", "engine"},
    "ui": {"ui", "engine.presets", "engine.settings"},
}
"""Modules of the package that each layer may import."""
KERNEL_STANDARD_LIBRARY = {"__future__", "math", "typing"}
EXTRA = {
    "engine/read.py": {"OpenImageIO"},
    "engine/image_files.py": {"OpenImageIO"},
    "engine/write.py": {"OpenImageIO"},
    "addon/__init__.py": {"ui"},
    "addon/preferences.py": {"ui.properties"},
    "addon/services.py": {"ui.services"},
}
"""Exceptions: images are read and EXRs read and written by three files; register() is the one place that knows both
sides; the add-on's preferences make their properties as the scene's are made; its services are what register() hands
to ui."""
PRINTING = re.compile(r"^(addon/(cli|cli_\w+|bench|bench_\w+|progress)\.py)$")
"""Files that talk on standard output; all others report through Report or exceptions."""


parse = functools.cache(ast.parse)
"""Several tests read all files"""


def package_files() -> list[Path]:
    """Return all Python files of the package, layers only."""
    return sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.py"))


def python_files() -> list[Path]:
    """Return all Python files of the project."""
    others = [path for folder in ("tests", "sample_blends") for path in (ROOT / folder).rglob("*.py")]
    return [ROOT / "__init__.py", *package_files(), *sorted(others)]


def imported_modules(tree: ast.AST, path: str) -> Iterator[tuple[str, bool]]:
    """Yield every imported module's dotted name and whether it is relative (then named from the package's root)."""
    folder = path.split("/")[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, False) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module, False
        elif isinstance(node, ast.ImportFrom):
            base = folder[:len(folder) - node.level + 1] + ([node.module] if node.module else [])
            yield from ((".".join([*base, alias.name]), True) for alias in node.names)


def import_errors(source: str, path: str) -> list[str]:
    """Return what `source`, the file at `path` below the root, imports against the rules."""
    layer = path.split("/")[0]
    standard = KERNEL_STANDARD_LIBRARY if layer == "kernels" else sys.stdlib_module_names
    errors = []
    for name, relative in imported_modules(parse(source), path):
        top = name.split(".")[0]
        if relative:
            allowed = INSIDE[layer] | EXTRA.get(path, set())
            fine = any(name == module or name.startswith(module + ".") for module in allowed)
        else:
            fine = top in standard or top in OUTSIDE[layer] | EXTRA.get(path, set())
        if not fine:
            errors.append(f"{path} imports {name}")
    return errors


def manner_errors(source: str, path: str) -> list[str]:
    """Return bare excepts and prints in `source`, the file at `path` below the root."""
    errors = []
    for node in ast.walk(parse(source)):
        if isinstance(node, ast.ExceptHandler) and node.type is None:
            errors.append(f"{path}:{node.lineno} has a bare except")
        is_print = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
        if is_print and not PRINTING.match(path):
            errors.append(f"{path}:{node.lineno} prints")
    return errors


def relative(path: Path) -> str:
    """Return a path below the root, with forward slashes."""
    return path.relative_to(ROOT).as_posix()


def test_imports_follow_layers() -> None:
    """Keep each layer to the imports it may have."""
    errors = [error for path in package_files() for error in import_errors(path.read_text("utf-8"), relative(path))]
    assert not errors, "\n".join(errors)


@pytest.mark.parametrize(("path", "source", "expected"), [
    ("engine/session.py", "import bpy", "engine/session.py imports bpy"),
    ("engine/session.py", "def f():\n    from ..addon import report", "engine/session.py imports addon.report"),
    ("engine/passes/reference.py", "import OpenImageIO", "engine/passes/reference.py imports OpenImageIO"),
    ("engine/session.py", "from burnish.kernels import ggx", "engine/session.py imports burnish.kernels"),
    ("addon/extract/mesh.py", "from ...kernels import ggx", "addon/extract/mesh.py imports kernels.ggx"),
    ("addon/final.py", "from .. import ui", "addon/final.py imports ui"),
    ("ui/panels.py", "from ..engine.session import Session", "ui/panels.py imports engine.session.Session"),
    ("kernels/ggx.py", "import numpy as np", "kernels/ggx.py imports numpy"),
])
def test_wrong_imports_are_found(path: str, source: str, expected: str) -> None:
    """Name the file and the module of a forbidden import."""
    assert import_errors(source, path) == [expected]


@pytest.mark.parametrize(("path", "source"), [
    ("engine/image_files.py", "import OpenImageIO as oiio\nfrom .texels import expand_channels"),
    ("addon/__init__.py", "def register():\n    from .. import ui\n    from . import render_engine"),
    ("addon/extract/mesh.py", "import bpy\nfrom ...engine.scene import MeshData\nfrom .image import ImageCollector"),
    ("ui/properties.py", "import bpy\nfrom ..engine import settings"),
])
def test_right_imports_pass(path: str, source: str) -> None:
    """Let allowed imports through."""
    assert import_errors(source, path) == []


def test_no_bare_except_and_no_print() -> None:
    """Keep bare excepts out of the package, and prints to the files that own standard output."""
    errors = [error for path in package_files() for error in manner_errors(path.read_text("utf-8"), relative(path))]
    assert not errors, "\n".join(errors)
    wrong = "try:\n    print()\nexcept:\n    pass"
    assert manner_errors(wrong, "engine/session.py") == [
        "engine/session.py:3 has a bare except", "engine/session.py:2 prints"]
    assert manner_errors("print()", "addon/cli.py") == []


def test_files_are_short_and_licensed() -> None:
    """Begin every Python file with its license and a docstring, and keep it short."""
    errors = []
    for path in python_files():
        source = path.read_text("utf-8")
        lines = source.splitlines()
        if not lines:
            continue
        if lines[0] != "# SPDX-License-Identifier: GPL-3.0-or-later":
            errors.append(f"{relative(path)} does not begin with its SPDX line")
        if ast.get_docstring(parse(source)) is None:
            errors.append(f"{relative(path)} has no docstring")
        if len(lines) > MAX_LINES:
            errors.append(f"{relative(path)} has {len(lines)} lines, more than {MAX_LINES}")
    assert not errors, "\n".join(errors)


@pytest.mark.parametrize("path", [path for path in package_files() if path.parent.name in ("addon", "ui")],
                         ids=lambda path: str(path.relative_to(ROOT)))
def test_annotated_properties_have_no_loops(path: Path) -> None:
    """Keep scopes of their own out of the annotations of Blender's classes, which it can't evaluate on Python 3.11."""
    loops = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp, ast.Lambda)
    classes = [node for node in ast.walk(parse(path.read_text("utf-8"))) if isinstance(node, ast.ClassDef)]
    found = [node.lineno for each in classes for node in each.body if isinstance(node, ast.AnnAssign)
             and any(isinstance(part, loops) for part in ast.walk(node.annotation))]
    assert not found
