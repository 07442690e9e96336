"""Read any robot: catalog names and all kinds of robot files, with the base and the selected joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from types import ModuleType

import numpy as np

from gtau.documents.files import ROBOT, refuse_other_kind
from gtau.documents.yaml_document import read_yaml
from gtau.errors import GtauError
from gtau.extensions import added, registered
from gtau.robots.floating import drawn_base, float_base
from gtau.robots.parts import hold_joints, listed, lock_joints, select_joints
from gtau.robots.placement import Pose, rounded
from gtau.robots.readers.source import BASE_ADVICE, FLOATING, Base, BaseChoice, GivenLimits, RobotSource
from gtau.robots.robot import Robot

CATALOG = Path(__file__).parents[1] / "catalog"
GROUP = "gtau.robots"  # of the entry points that name packages with robot files
LOOPS = ("closed_loop", "name_mot")  # keys that distinguish a file of loops from a robot file
ENDINGS = ".yaml, .urdf, .xml (MJCF), .par or .csv"


def catalog_names() -> tuple[str, ...]:
    """List the robots of the package and of other distributions' catalogs."""
    return (*sorted(file.stem for file in CATALOG.glob("*.yaml")), *_added_robots())


def _added_robots() -> dict[str, Path]:
    """Find the robot files of other distributions by name, in the folders of the packages that they register."""
    packages = [added(GROUP, name, ModuleType) for name in registered(GROUP)]
    folders = [Path(folder) for package in packages for folder in package.__path__]
    return {file.stem: file for folder in folders for file in sorted(folder.glob("*.yaml"))}


def read_robot(source: str | Path | RobotSource) -> Robot:
    """Read a robot as its file describes it, its home not closed yet (see :func:`gtau.load_robot`).

    ``source`` is a name in the catalog, a name in the package robot_descriptions if the file is on disk
    (``panda_description``), or the path of a file, recognised by its ending: a robot file (``.yaml``, ``.yml``), a URDF
    (``.urdf``) with its loops in a YAML file of the same name beside it, or that YAML file, or the folder of both if
    they are called ``robot``; MJCF (``.xml``, ``.mjcf``), a parameter file of OpenSYMORO (``.par``), or a table of MDH
    parameters (``.csv``). A ``RobotSource`` also states the pose of the base and which joints move.
    """
    if not isinstance(source, RobotSource):
        source = RobotSource(file=str(source))
    robot = _read(source.file, source.base)
    try:
        six = drawn_base(robot) if len(robot.joints) > 6 and not robot.floating else ()
        if source.base == FLOATING:
            robot = _floating(robot, six)
        elif isinstance(source.base, Base):
            robot = _fixed(robot, six or robot.base, source.base)
        if source.joints or source.held:
            robot = select_joints(robot, source.joints, source.held)
        if source.limits:
            robot = _limited(robot, source.limits)
        if source.gravity is not None:
            robot = replace(robot, gravity=source.gravity)
        if source.base is None and not robot.floating and len(robot.joints) > 6 and (six := drawn_base(robot)):
            raise GtauError(f"{listed(six)} have no motor and carry the rest, as a base that floats; {BASE_ADVICE}.")
        return robot
    except GtauError as error:
        raise GtauError(f"{source.file}: {error}") from None


def _floating(robot: Robot, six: Sequence[str]) -> Robot:
    """Let the base float, in place of the ``six`` joints that represent it in the file, if any."""
    if six:
        note = f"{listed(six)} were taken as the floating base '{six[-1]}', as they have no motor and carry the rest"
        return float_base(lock_joints(robot, dict.fromkeys(six, 0.0)), six[-1]).noted(note)
    in_use = any(joint.name == "base" for joint in robot.joints)
    return robot if robot.floating else float_base(robot, "floating_base" if in_use else "base")


def _fixed(robot: Robot, six: Sequence[str], base: Base) -> Robot:
    """Fix the base that ``six`` joints represent, if any, and turn it in a world whose gravity points down."""
    if six:
        robot = hold_joints(robot, dict.fromkeys(six, 0.0), "with the base")
    if base.rpy is None:
        return robot
    x, y, z = Pose(rpy=base.rpy).rotation.T @ [0.0, 0.0, -float(np.linalg.norm(robot.gravity))]
    return replace(robot, gravity=(rounded(x), rounded(y), rounded(z)))


def _limited(robot: Robot, given: Mapping[str, GivenLimits]) -> Robot:
    joints = {joint.name: joint for joint in robot.joints}
    for name, limits in given.items():
        joint = robot.joint(name)
        joints[name] = replace(joint, limits=replace(joint.limits, **limits.model_dump(exclude_none=True)))
    return replace(robot, joints=tuple(joints.values()))


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
    from gtau.robots.readers.described import described_file

    if (described := described_file(str(source))) is not None:
        return _read(described, base)
    close = get_close_matches(str(source), catalog_names(), n=1)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    raise GtauError(
        f"no robot is called '{source}'{hint}; choose from the catalog ({', '.join(catalog_names())}) "
        f"or give the path of a file that ends in {ENDINGS}."
    )


def is_loops_file(path: Path) -> bool:
    """Decide whether the file at `path` exists and defines loops beside a URDF."""
    return path.is_file() and any(key in read_yaml(path).data for key in LOOPS)


def _from_yaml(path: Path) -> Robot:
    if is_loops_file(path):
        from gtau.robots.readers.urdf import read_urdf_with_loops

        return read_urdf_with_loops(path.with_suffix(".urdf"), path)
    from gtau.robots.readers.native import read_native

    return read_native(path)


def _from_urdf(path: Path, base: BaseChoice) -> Robot:
    from gtau.robots.readers.urdf import read_urdf, read_urdf_with_loops

    for loops in (path.with_suffix(".yaml"), path.with_suffix(".yml")):
        if is_loops_file(loops):
            return read_urdf_with_loops(path, loops)
    return read_urdf(path, base)
