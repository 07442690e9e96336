"""Read any robot: catalog names and all kinds of robot files, with the base and the selected joints.

Importing a module of the package robot_descriptions may clone a repository. So its modules are parsed as data: the
paths that they join, below the package's folder of repositories. Nothing is executed or fetched.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np

from gtau.documents.files import ROBOT, refuse_other_kind
from gtau.documents.markup import read_yaml
from gtau.errors import GtauError, errors_at, meant
from gtau.extensions import added, registered
from gtau.robots.geometry import drawn_base, float_base
from gtau.robots.parts import hold_joints, listed, lock_joints, select_joints
from gtau.robots.placement import Placement, Pose, rounded
from gtau.robots.readers.source import BASE_ADVICE, FLOATING, Base, BaseChoice, RobotSource
from gtau.robots.robot import Robot

CATALOG = Path(__file__).parents[1] / "catalog"
GROUP = "gtau.robots"  # of the entry points that name packages with robot files
LOOPS = ("closed_loop", "name_mot")  # keys that distinguish a file of loops from a robot file
PACKAGE = "robot_descriptions"
FILES = ("URDF_PATH", "MJCF_PATH")
ASSIGNED = re.compile(r"^(\w+)(?:: *str)? *= *_?(clone_to_cache|path\.join)\(([^()]*)", re.MULTILINE)
ARGUMENT = re.compile(r"(?:^|,)\s*(?:(\w+)|[\"']([^\"']*)[\"'])\s*(?=,|$)")  # no keyword
REPOSITORY = re.compile(r"[\"']([^\"']+)[\"']: *\w+\([^()]*?cache_path *= *[\"']([^\"']+)[\"']")
ENDINGS = ".yaml, .urdf, .xacro, .xml (MJCF), .par or .csv"


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
    robot = _read(source.file, source)
    with errors_at(source.file):
        six = drawn_base(robot) if len(robot.joints) > 6 and not robot.floating else ()
        if source.base == FLOATING and six:
            taken = f"{listed(six)} were taken as the floating base '{six[-1]}'"
            robot = float_base(lock_joints(robot, dict.fromkeys(six, 0.0)), six[-1])
            robot = robot.noted(f"{taken}, as they have no motor and carry the rest")
        elif source.base == FLOATING and not robot.floating:
            in_use = any(joint.name == "base" for joint in robot.joints)
            robot = float_base(robot, "floating_base" if in_use else "base")
        elif isinstance(source.base, Base):
            robot = _fixed(robot, six or robot.base, source.base)
        if source.joints or source.held:
            robot = select_joints(robot, source.joints, source.held)
        if source.limits:
            given = {name: limits.model_dump(exclude_none=True) for name, limits in source.limits.items()}
            new = {name: replace(robot.joint(name).limits, **limits) for name, limits in given.items()}
            joints = (replace(joint, limits=new.get(joint.name, joint.limits)) for joint in robot.joints)
            robot = replace(robot, joints=tuple(joints))
        if source.gravity is not None:
            robot = replace(robot, gravity=source.gravity)
        if source.base is None and not robot.floating and len(robot.joints) > 6 and (six := drawn_base(robot)):
            raise GtauError(f"{listed(six)} have no motor and carry the rest, as a base that floats; {BASE_ADVICE}.")
        return robot


def _fixed(robot: Robot, six: Sequence[str], base: Base) -> Robot:
    """Fix the base that ``six`` joints represent, if any, and turn it in a world whose gravity points down."""
    if six:
        robot = hold_joints(robot, dict.fromkeys(six, 0.0), "with the base")
    if base.rpy is None:
        return robot
    x, y, z = Pose(rpy=base.rpy).rotation.T @ [0.0, 0.0, -float(np.linalg.norm(robot.gravity))]
    return replace(robot, gravity=(rounded(x), rounded(y), rounded(z)))


def _read(source: str | Path, written: RobotSource) -> Robot:
    base = written.base
    if source in {file.stem for file in CATALOG.glob("*.yaml")}:
        source = CATALOG / f"{source}.yaml"
    path = Path(source)
    if not path.exists():
        path = _added_robots().get(str(source), path)
    if (path / "robot.urdf").is_file():
        path = path / "robot.urdf"
    refuse_other_kind(path, ROBOT)
    if (written.xacro or written.packages) and path.suffix.lower() != ".xacro":
        raise GtauError(f"'xacro' and 'packages' are for xacro files, which '{written.file}' is not; remove them.")
    match path.suffix.lower():
        case ".yaml" | ".yml" if is_loops_file(path):
            from gtau.robots.readers.urdf import read_urdf_with_loops

            return read_urdf_with_loops(path.with_suffix(".urdf"), path)
        case ".yaml" | ".yml":
            from gtau.robots.readers.native import read_native

            return read_native(path)
        case ".urdf":
            return _from_urdf(path, base, path.parent)
        case ".xml" | ".mjcf":
            from gtau.robots.readers.mjcf import read_mjcf

            return read_mjcf(path, base)
        case ".sdf":
            raise GtauError(
                f"{path} is an SDF file, which is not read; make an MJCF file of it by 'sdf2mjcf {path.name} "
                f"{path.stem}.xml' of the package sdformat-mjcf, or give a URDF or a robot file."
            )
        case ".par" | ".csv" as ending:
            from gtau.robots.readers.mdh_table import read_mdh_csv, read_par

            return read_par(path) if ending == ".par" else read_mdh_csv(path)
        case ".xacro" if path.is_file():
            from gtau.documents.expressions import expanded

            with expanded(path, written.xacro, written.packages) as urdf:
                return _from_urdf(urdf, base, path.parent)
        case _ if path.is_file():
            raise GtauError(f"{path} ends in none of {ENDINGS}; give it the ending of its format.")
    if (described := _described(str(source))) is not None:
        return _read(described, written)
    files = map(str, path.parent.glob("*") if path.suffix else ())
    hint = meant(str(source), [*catalog_names(), *files])
    raise GtauError(
        f"no robot is called '{source}'{hint and f' ({hint})'}; choose from the catalog ({', '.join(catalog_names())}) "
        f"or give the path of a file that ends in {ENDINGS}."
    )


def is_loops_file(path: Path) -> bool:
    """Decide whether the file at `path` exists and defines loops beside a URDF."""
    return path.is_file() and any(key in read_yaml(path).data for key in LOOPS)


def _from_urdf(path: Path, base: BaseChoice, folder: Path) -> Robot:
    from gtau.robots.readers.urdf import read_urdf, read_urdf_with_loops

    for loops in (folder / f"{path.stem}.yaml", folder / f"{path.stem}.yml"):
        if is_loops_file(loops):
            return read_urdf_with_loops(path, loops)
    return read_urdf(path, base)


def _described(name: str) -> Path | None:
    """Find the file of a robot of robot_descriptions, such as ``panda_description`` or ``panda``; None if unknown."""
    spec = find_spec(PACKAGE) if name.isidentifier() else None
    folders = [Path(place) for place in (spec.submodule_search_locations or ())] if spec else []
    modules = [folder / f"{stem}.py" for folder in folders for stem in (name, f"{name}_description")]
    module = next((path for path in modules if path.stem.endswith("_description") and path.is_file()), None)
    if module is None:
        return None
    try:
        texts = [file.read_text(encoding="utf-8") for file in (module, module.with_name("_repositories.py"))]
    except (OSError, ValueError):
        raise GtauError(f"{module} cannot be read; install the package {PACKAGE} again, or give a file.") from None
    cache = Path(os.environ.get("ROBOT_DESCRIPTIONS_CACHE", f"~/.cache/{PACKAGE}")).expanduser()
    known: dict[str, Path | None] = {}
    repositories = dict(REPOSITORY.findall(texts[1]))
    for variable, function, written in ASSIGNED.findall(texts[0]):
        first, *parts = ARGUMENT.findall(written)
        if function == "clone_to_cache":
            known[variable] = cache / repositories[first[1]] if first[1] in repositories else None
        elif (folder := known.get(first[0])) is not None:
            known[variable] = folder.joinpath(*(text or str(known.get(name)) for name, text in parts))
    file = next((known[variable] for variable in FILES if known.get(variable)), None)
    if file is None:
        raise GtauError(
            f"the package {PACKAGE} names no URDF or MJCF file of '{module.stem}'; where xacro makes it, give the path "
            "of the xacro file."
        )
    if not file.is_file():
        raise GtauError(
            f"the package {PACKAGE} has '{module.stem}', but not its file on disk ({file}); fetch it ('{PACKAGE} pull "
            f"{module.stem}'), or give the robot's file."
        )
    return file


def frame_on(body: str, frame: str | Pose, file: str | Path | None) -> tuple[str, Placement]:
    """Find a frame fixed to a ``body``, a joint or platform: its name, and its pose in the body's frame.

    The ``frame`` is empty for the body's, a link of the URDF ``file``, ``x y z roll pitch yaw`` (m, rad), or a pose.
    """
    body_frame = f"the frame of '{body}'"
    if isinstance(frame, Pose):
        return f"a frame on '{body}'", frame
    if not frame:
        return body_frame, Pose()
    try:
        numbers = [float(word) for word in frame.replace(",", " ").split()]
    except ValueError:
        return frame, _link(body, frame, file)
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        wrong = f"has {len(numbers)} numbers" if len(numbers) != 6 else "has a number that is not finite"
        raise GtauError(f"frame '{frame}' {wrong}; write 'x y z roll pitch yaw' (m, rad) from {body_frame}.")
    x, y, z, roll, pitch, yaw = numbers
    return f"{x:g} {y:g} {z:g} m, {roll:g} {pitch:g} {yaw:g} rad from {body_frame}", Pose((x, y, z), (roll, pitch, yaw))


def links_on(body: str, file: str | Path) -> list[str]:
    """List the links of the robot's ``file`` that are fixed to a ``body``; none if it is not a URDF."""
    if Path(file).suffix.lower() != ".urdf":
        return []
    from gtau.robots.readers.urdf_tree import read_urdf_tree

    tree = read_urdf_tree(Path(file), {}, Base())
    on_body = {name for name, frame in tree.frames.items() if frame.body == body}
    return [name for link in tree.root.findall("link") if (name := link.get("name", "")) in on_body]


def _link(body: str, link: str, file: str | Path | None) -> Placement:
    if file is None or Path(file).suffix.lower() != ".urdf":
        raise GtauError(
            f"frame '{link}' is the name of a link, which only a URDF has; name the URDF (--robot, or --experiment of "
            f"gtau use), or write the frame as 'x y z roll pitch yaw' (m, rad) from the frame of '{body}'."
        )
    from gtau.robots.readers.urdf_tree import read_urdf_tree

    frames = read_urdf_tree(Path(file), {}, Base()).frames
    on_body = ", ".join(name for name, frame in frames.items() if frame.body == body)
    if link not in frames:
        raise GtauError(f"{file} has no link '{link}'; on '{body}' are {on_body or 'none'}.")
    if frames[link].body != body:
        raise GtauError(
            f"link '{link}' of {file} is not fixed to '{body}', which carries the payload; choose from "
            f"{on_body or 'none, and write the pose'}."
        )
    return frames[link].placement
