# SPDX-License-Identifier: GPL-3.0-or-later
"""The project's own files: manifest, requirements, settings, changelog, and what must not stand in any of them."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = (".ci", "addon", "docs", "engine", "kernels", "sample_blends", "tests", "ui")
IGNORED = {"__pycache__", ".ruff_cache", ".pytest_cache", ".venv.lock"}
TEXT = {".md", ".py", ".toml", ".txt", ".json", ".yaml", ".yml", ""}

REGISTRIES = ("pypi" + ".org", "pythonhosted" + ".org", "npmjs" + ".org", "crates" + ".io", "debian" + ".org")
MACHINE_PATHS = re.compile(r"(?<![\w.~$)}>-])/(?:work|tmp|root|home|opt)/")


def text_files() -> list[Path]:
    """Return the project's text files (not what builds leave behind)."""
    inner = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.is_file()]
    return [path for path in [*ROOT.iterdir(), *inner]
            if path.is_file() and path.suffix in TEXT and not IGNORED & set(path.parts)]


def read_toml(name: str) -> dict:
    """Return a TOML file at the root."""
    return tomllib.loads((ROOT / name).read_text("utf-8"))


def pinned(package: str) -> set[str]:
    """Return the versions of a package that requirements.txt pins."""
    return set(re.findall(rf"^{re.escape(package)}==(\S+)", (ROOT / "requirements.txt").read_text("utf-8"), re.M))


def extension_tool() -> Path:
    """Return Blender's own tool for extensions, found without loading Blender."""
    package = Path(importlib.util.find_spec("bpy").origin).parent
    return next(package.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))


def test_manifest_is_valid() -> None:
    """Let Blender's own tool judge the manifest."""
    result = subprocess.run([sys.executable, extension_tool(), "validate", ROOT], capture_output=True, text=True,
                            timeout=60)
    assert result.returncode == 0, result.stdout + result.stderr


def test_versions_agree() -> None:
    """Give the same version of Burnish and of Warp in every file that names one."""
    manifest, project = read_toml("blender_manifest.toml"), read_toml("pyproject.toml")
    assert manifest["version"] == project["project"]["version"]
    assert f"## {manifest['version']}" in (ROOT / "CHANGELOG.md").read_text("utf-8")
    wheels = [Path(wheel).name.split("-") for wheel in manifest["wheels"]]
    assert {(wheel[0], wheel[1]) for wheel in wheels} == {("warp_lang", *pinned("warp-lang"))}
    assert len(wheels) == len(manifest["platforms"])


def test_every_folder_is_installed() -> None:
    """List every package folder in pyproject.toml."""
    listed = set(read_toml("pyproject.toml")["tool"]["setuptools"]["packages"])
    layers = [ROOT / layer for layer in ("addon", "engine", "kernels", "ui")]
    found = {path.parent for layer in layers for path in layer.rglob("*.py")}
    assert listed == {"burnish"} | {".".join(["burnish", *folder.relative_to(ROOT).parts]) for folder in found}


@pytest.mark.parametrize("name", ["bpy", "numpy", "openimageio", "warp-lang", "pytest", "setuptools", "flip-evaluator"])
def test_requirements_are_pinned_with_hashes(name: str) -> None:
    """Pin what set-up needs, one version for each Python, each with hashes."""
    assert len(pinned(name)) == (2 if name in ("bpy", "numpy", "openimageio") else 1)
    text = (ROOT / "requirements.txt").read_text("utf-8")
    for block in re.split(r"\n(?=\S)", text.strip()):
        assert "--hash=sha256:" in block, block.splitlines()[0]


def test_no_registry_and_no_machine_path() -> None:
    """Name no package registry and no folder of the machine it was written on."""
    errors = []
    for path in text_files():
        for number, line in enumerate(path.read_text("utf-8", errors="replace").splitlines(), 1):
            if any(host in line for host in REGISTRIES) or MACHINE_PATHS.search(line):
                errors.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}")
    assert not errors, "\n".join(errors)


def test_settings_page_lists_current_settings() -> None:
    """Find the table of docs/settings.md as engine.settings would make it."""
    result = subprocess.run([sys.executable, ROOT / "tests" / "readme_settings.py"], capture_output=True, text=True,
                            timeout=60)
    assert result.returncode == 0, result.stderr


def test_every_test_says_what_it_tests() -> None:
    """Give every test a docstring of one imperative sentence."""
    errors = []
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_") and not ast.get_docstring(node):
                errors.append(f"{path.relative_to(ROOT)}:{node.lineno} {node.name} has no docstring")
    assert not errors, "\n".join(errors)


def test_importing_the_engine_does_not_load_blender() -> None:
    """Import the engine in a fresh process and find no bpy in it."""
    script = "import sys, burnish, burnish.engine.settings; raise SystemExit('bpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], timeout=60, check=False).returncode == 0
