"""Robots of the package robot_descriptions.

Importing a module of that package may clone a repository. So the modules are parsed as data: the paths that they join,
below the package's folder of repositories. Nothing is executed or fetched.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from gtau.errors import GtauError

PACKAGE = "robot_descriptions"
FILES = ("URDF_PATH", "MJCF_PATH")
Value = Path | str | None


def described_file(name: str) -> Path | None:
    """Find the file of a robot by its name there, such as ``panda_description`` or ``panda``; None if unknown."""
    spec = find_spec(PACKAGE) if name.isidentifier() else None
    folders = [Path(place) for place in (spec.submodule_search_locations or ())] if spec else []
    modules = [folder / f"{stem}.py" for folder in folders for stem in (name, f"{name}_description")]
    module = next((path for path in modules if path.stem.endswith("_description") and path.is_file()), None)
    if module is None:
        return None
    known: dict[str, Value] = {}
    repositories = _repositories(module.with_name("_repositories.py"))
    for statement in _parsed(module).body:
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name) and statement.value:
            known[statement.target.id] = _value(statement.value, known, repositories)
    file = next((known[variable] for variable in FILES if known.get(variable)), None)
    if file is None:
        raise GtauError(
            f"the URDF of '{module.stem}' of the package {PACKAGE} is made by xacro; write it to a file, and give that "
            "file."
        )
    if not Path(file).is_file():
        raise GtauError(
            f"the package {PACKAGE} has '{module.stem}', but not its file on disk ({file}); fetch it ('{PACKAGE} pull "
            f"{module.stem}'), or give the robot's file."
        )
    return Path(file)


def _parsed(module: Path) -> ast.Module:
    try:
        return ast.parse(module.read_text(encoding="utf-8"))
    except (OSError, SyntaxError, ValueError):
        raise GtauError(f"{module} cannot be read; install the package {PACKAGE} again, or give a file.") from None


def _repositories(module: Path) -> dict[str, str]:
    """Find the folder of each repository, relative to the common folder."""
    repositories: dict[str, str] = {}
    for node in ast.walk(_parsed(module)):
        for key, value in zip(node.keys, node.values, strict=True) if isinstance(node, ast.Dict) else ():
            if isinstance(key, ast.Constant) and isinstance(value, ast.Call):
                folders = [word.value for word in value.keywords if word.arg == "cache_path"]
                repositories |= {
                    str(key.value): str(folder.value) for folder in folders if isinstance(folder, ast.Constant)
                }
    return repositories


def _value(node: ast.expr, known: Mapping[str, Value], repositories: Mapping[str, str]) -> Value:
    """Evaluate a name, a text, a join of paths or the folder of a repository; None for anything else."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.Name):
        return known.get(node.id)
    if not isinstance(node, ast.Call) or not node.args:
        return None
    called = ast.unparse(node.func).lstrip("_")
    parts = [_value(argument, known, repositories) for argument in node.args]
    if called == "path.join" and None not in parts:
        return Path(*(part for part in parts if part is not None))
    if called == "clone_to_cache" and parts[0] in repositories:
        folder = os.environ.get("ROBOT_DESCRIPTIONS_CACHE", f"~/.cache/{PACKAGE}")
        return Path(folder).expanduser() / repositories[str(parts[0])]
    return None
