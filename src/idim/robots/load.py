"""One door to every robot: catalog names, robot files and URDF files."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

from idim.errors import IdimError
from idim.robots.robot import Robot

CATALOG = Path(__file__).with_name("catalog")


def catalog_names() -> tuple[str, ...]:
    """Names of the robots that come with the package."""
    return tuple(sorted(file.stem for file in CATALOG.glob("*.yaml")))


def load_robot(source: str | Path | Robot) -> Robot:
    """Load a robot.

    Parameters
    ----------
    source : str, Path or Robot
        A name of the catalog, the path of a robot file (``.yaml``, ``.yml``) or of a URDF file (``.urdf``), or a
        robot, which is returned as it is.

    Returns
    -------
    Robot

    Raises
    ------
    IdimError
        There is no such robot, or its file is not accepted.
    """
    if isinstance(source, Robot):
        return source
    if source in catalog_names():
        source = CATALOG / f"{source}.yaml"
    path = Path(source)
    match path.suffix.lower():
        case ".yaml" | ".yml":
            from idim.robots.native import read_native

            return read_native(path)
        case ".urdf":
            from idim.robots.urdf import read_urdf

            return read_urdf(path)
        case ".xacro":
            raise IdimError(f"{path} is a xacro file; expand it with 'xacro {path.name} > {path.stem}.urdf' first.")
        case _ if path.is_file():
            raise IdimError(f"{path} is neither a .yaml nor a .urdf file; give it the ending of what it holds.")
    close = get_close_matches(str(source), catalog_names(), n=1)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    raise IdimError(
        f"no robot is called '{source}'{hint}; choose from the catalog ({', '.join(catalog_names())}) "
        "or give the path of a .yaml or .urdf file."
    )
