"""Read any robot: catalog names, all kinds of robot files, and robots of the package robot_descriptions.

Importing a module of that package may clone a repository. So they are parsed as data instead: the paths that they join,
below the folder in which the package keeps its repositories. Nothing is executed, and nothing is fetched.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np

from gtau.documents.files import ROBOT, refuse_other_kind
from gtau.errors import GtauError
from gtau.extensions import added, registered
from gtau.robots.floating import drawn_base, float_base
from gtau.robots.geometry import rounded
from gtau.robots.parts import hold_joints, listed, lock_joints, select_joints
from gtau.robots.readers.source import BASE_ADVICE, FLOATING, Base, BaseChoice, GivenLimits, RobotSource
from gtau.robots.robot import Pose, Robot

CATALOG = Path(__file__).parents[1] / "catalog"
PACKAGE = "robot_descriptions"
GROUP = "gtau.robots"  # of the entry points that name packages with robot files
FILES = ("URDF_PATH", "MJCF_PATH")
Value = Path | str | None
ENDINGS = ".yaml, .urdf, .xml (MJCF), .par or .csv"


def catalog_names() -> tuple[str, ...]:
    """List the robots that come with the package, and those of other distributions' catalogs."""
    return (*sorted(file.stem for file in CATALOG.glob("*.yaml")), *_added_robots())


def _added_robots() -> dict[str, Path]:
    """Find the robot files of other distributions by name: those in the folders of the packages that they register."""
    packages = [added(GROUP, name, ModuleType) for name in registered(GROUP)]
    folders = [Path(folder) for package in packages for folder in package.__path__]
    return {file.stem: file for folder in folders for file in sorted(folder.glob("*.yaml"))}


def read_robot(source: str | Path | RobotSource) -> Robot:
    """Read a robot as its file describes it, its home not closed yet (see :func:`gtau.load_robot`).

    Parameters
    ----------
    source : str, Path or RobotSource
        A name of the catalog, one of the package robot_descriptions where that is installed and has the file on disk
        (``panda_description``), or the path of a file, recognised by its ending: a robot file (``.yaml``, ``.yml``), a
        URDF (``.urdf``) with its loops in a YAML file of the same name beside it, or that YAML file, or the folder of
        both where they are called ``robot``; MJCF (``.xml``, ``.mjcf``), a parameter file of OpenSYMORO (``.par``), or
        a table of MDH parameters (``.csv``). A ``RobotSource`` also says how its base stands and which joints move.

    Returns
    -------
    Robot
        Its ``notes`` list anomalies in the file and decisions of the reader.

    Raises
    ------
    GtauError
        The robot does not exist, or its file is invalid.
    """
    if not isinstance(source, RobotSource):
        source = RobotSource(file=str(source))
    robot = _read(source.file, source.base)
    try:
        six = () if robot.floating else drawn_base(robot)
        if source.base == FLOATING and six:
            robot = replace(float_base(lock_joints(robot, dict.fromkeys(six, 0.0)), six[-1]), notes=robot.notes)
            note = (
                f"{listed(six)} were taken as the floating base '{six[-1]}', as they have no motor and carry the rest"
            )
            robot = replace(robot, notes=(*robot.notes, note))
        elif source.base == FLOATING and not robot.floating:
            taken = any(joint.name == "base" for joint in robot.joints)
            robot = float_base(robot, "floating_base" if taken else "base")
        elif isinstance(source.base, Base):
            if held := six or robot.base:
                robot = hold_joints(robot, dict.fromkeys(held, 0.0), "with the base")
            if source.base.rpy is not None:
                robot = _mounted(robot, source.base.rpy)
        robot = select_joints(robot, source.joints, source.held) if source.joints or source.held else robot
        robot = _limited(robot, source.limits)
        robot = robot if source.gravity is None else replace(robot, gravity=source.gravity)
        if source.base is None and not robot.floating and (six := drawn_base(robot)):
            raise GtauError(f"{listed(six)} have no motor and carry the rest, as a base that floats; {BASE_ADVICE}.")
        return robot
    except GtauError as error:
        raise GtauError(f"{source.file}: {error}") from None


def _limited(robot: Robot, given: Mapping[str, GivenLimits]) -> Robot:
    """Replace limits of joints by those given."""
    for name in given:
        robot.joint(name)  # refuses a name that no joint has
    joints = (
        replace(joint, limits=replace(joint.limits, **given[joint.name].model_dump(exclude_none=True)))
        if joint.name in given
        else joint
        for joint in robot.joints
    )
    return replace(robot, joints=tuple(joints)) if given else robot


def _mounted(robot: Robot, rpy: tuple[float, float, float]) -> Robot:
    """Rotate the base of a robot in a world in which its gravity points down."""
    x, y, z = Pose(rpy=rpy).rotation.T @ [0.0, 0.0, -float(np.linalg.norm(robot.gravity))]
    return replace(robot, gravity=(rounded(x), rounded(y), rounded(z)))


def _read(source: str | Path, base: BaseChoice) -> Robot:
    if source in {file.stem for file in CATALOG.glob("*.yaml")}:
        source = CATALOG / f"{source}.yaml"
    path = Path(source)
    if not path.exists():
        path = _added_robots().get(str(source), path)
    if (path / "robot.urdf").is_file():
        path = path / "robot.urdf"
    refuse_other_kind(path, ROBOT)
    match path.suffix.lower():
        case ".yaml" | ".yml":
            return _from_yaml(path)
        case ".urdf":
            return _from_urdf(path, base)
        case ".xml" | ".mjcf":
            from gtau.robots.readers.mjcf import read_mjcf

            return read_mjcf(path, base)
        case ".sdf":
            raise GtauError(
                f"{path} is an SDF file, which is not read; make an MJCF file of it by 'sdf2mjcf {path.name} "
                f"{path.stem}.xml' of the package sdformat-mjcf, or give a URDF or a robot file."
            )
        case ".par":
            from gtau.robots.readers.symoro import read_par

            return read_par(path)
        case ".csv":
            from gtau.robots.readers.mdh_table import read_mdh_csv

            return read_mdh_csv(path)
        case ".xacro":
            raise GtauError(f"{path} is a xacro file; expand it with 'xacro {path.name} > {path.stem}.urdf' first.")
        case _ if path.is_file():
            raise GtauError(f"{path} ends in none of {ENDINGS}; give it the ending of its format.")
    if (described := _described_file(str(source))) is not None:
        return _read(described, base)
    close = get_close_matches(str(source), catalog_names(), n=1)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    raise GtauError(
        f"no robot is called '{source}'{hint}; choose from the catalog ({', '.join(catalog_names())}) "
        f"or give the path of a file that ends in {ENDINGS}."
    )


def _from_yaml(path: Path) -> Robot:
    from gtau.robots.readers.urdf import is_loops_file, read_urdf_with_loops

    if is_loops_file(path):
        return read_urdf_with_loops(path.with_suffix(".urdf"), path)
    from gtau.robots.readers.native import read_native

    return read_native(path)


def _from_urdf(path: Path, base: BaseChoice) -> Robot:
    from gtau.robots.readers.urdf import is_loops_file, read_urdf, read_urdf_with_loops

    for loops in (path.with_suffix(".yaml"), path.with_suffix(".yml")):
        if is_loops_file(loops):
            return read_urdf_with_loops(path, loops)
    return read_urdf(path, base)


def _described_file(name: str) -> Path | None:
    """Find the file of a robot by its name there, such as ``panda_description`` or ``panda``; None if unknown.

    Raises
    ------
    GtauError
        The package knows the robot, but its file is not on disk, or is made by xacro.
    """
    spec = find_spec(PACKAGE) if name.isidentifier() else None
    folders = [Path(each) for each in (spec.submodule_search_locations or ())] if spec else []
    modules = [folder / f"{each}.py" for folder in folders for each in (name, f"{name}_description")]
    module = next((each for each in modules if each.stem.endswith("_description") and each.is_file()), None)
    if module is None:
        return None
    known: dict[str, Value] = {}
    repositories = _repositories(module.with_name("_repositories.py"))
    for statement in _parsed(module).body:
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name) and statement.value:
            known[statement.target.id] = _value(statement.value, known, repositories)
    file = next((known[each] for each in FILES if known.get(each)), None)
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
    """Find the folder of each repository, below that of all."""
    found: dict[str, str] = {}
    for each in ast.walk(_parsed(module)):
        for key, value in zip(each.keys, each.values, strict=True) if isinstance(each, ast.Dict) else ():
            if isinstance(key, ast.Constant) and isinstance(value, ast.Call):
                folders = [word.value for word in value.keywords if word.arg == "cache_path"]
                found |= {str(key.value): str(each.value) for each in folders if isinstance(each, ast.Constant)}
    return found


def _value(node: ast.expr, known: Mapping[str, Value], repositories: Mapping[str, str]) -> Value:
    """Evaluate a name, a text, a join of paths or the folder of a repository; None for anything else."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.Name):
        return known.get(node.id)
    if not isinstance(node, ast.Call) or not node.args:
        return None
    called = ast.unparse(node.func).lstrip("_")
    parts = [_value(each, known, repositories) for each in node.args]
    if called == "path.join" and None not in parts:
        return Path(*(part for part in parts if part is not None))
    if called == "clone_to_cache" and parts[0] in repositories:
        folder = os.environ.get("ROBOT_DESCRIPTIONS_CACHE", f"~/.cache/{PACKAGE}")
        return Path(folder).expanduser() / repositories[str(parts[0])]
    return None
