"""Find frames on a body by the user's specification: a link of a URDF, or a pose."""

from __future__ import annotations

from pathlib import Path

from gtau.errors import GtauError
from gtau.robots.readers.source import Base
from gtau.robots.robot import Placement, Pose


def frame_on(body: str, frame: str | Pose, file: str | Path | None) -> tuple[str, Placement]:
    """Find a frame fixed to a ``body``: its name, and its pose in the body's own frame.

    Parameters
    ----------
    body : str
        The joint or platform that has the body's name.
    frame : str or Pose
        Empty for the body's own frame; a link of the URDF ``file``, or the six numbers ``x y z roll pitch yaw``
        (m, rad) from the body's frame, or these as a pose.
    file : path, optional
        The robot's file.

    Raises
    ------
    GtauError
        The frame does not exist, or is on another body.
    """
    own = f"the frame of '{body}'"
    if isinstance(frame, Pose):
        return f"a frame on '{body}'", frame
    if not frame:
        return own, Pose()
    words = frame.replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return frame, _link(body, frame, file)
    if len(numbers) != 6:
        raise GtauError(
            f"frame '{frame}' has {len(numbers)} numbers; write 'x y z roll pitch yaw' (m, rad) from {own}."
        )
    x, y, z, roll, pitch, yaw = numbers
    return f"{x:g} {y:g} {z:g} m, {roll:g} {pitch:g} {yaw:g} rad from {own}", Pose((x, y, z), (roll, pitch, yaw))


def _link(body: str, link: str, file: str | Path | None) -> Placement:
    from gtau.robots.readers.urdf import read_urdf_tree

    if file is None or Path(file).suffix.lower() != ".urdf":
        raise GtauError(
            f"frame '{link}' is the name of a link, which only a URDF has; give the URDF, or the frame as 'x y z roll "
            f"pitch yaw' (m, rad) from the frame of '{body}'."
        )
    tree = read_urdf_tree(Path(file), {}, Base())
    on_body = [name for name, each in tree.frames.items() if each.body == body]
    if link not in tree.frames:
        raise GtauError(f"{file} has no link '{link}'; on '{body}' are {', '.join(on_body) or 'none'}.")
    if link not in on_body:
        raise GtauError(
            f"link '{link}' of {file} is not fixed to '{body}', which carries the payload; choose from "
            f"{', '.join(on_body) or 'none, and write the pose'}."
        )
    return tree.frames[link].placement
