"""Payloads in the formats of controllers: URScript, Franka's JSON, KRL, RAPID, and a ROS message.

Every format describes the same body: mass in kg, centre of mass, inertia about it, in the requested frame. Numbers
have the digits that their intervals allow; unmeasured ones are rounded too, so that zeros are zeros.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml

from gtau.documents.files import identifier
from gtau.documents.validation import PATH, TEXT, takes
from gtau.errors import GtauError
from gtau.estimation.results.payload_body import PayloadBody
from gtau.export.exported import Exported, refuse_unknown, written
from gtau.findings import to_width
from gtau.robots.parameter import RigidBody
from gtau.robots.placement import angles_of


@takes(payload=("what PayloadEstimate.in_frame returns", (PayloadBody,)), kind=TEXT, out=PATH)
def export_payload(payload: PayloadBody, kind: str, out: str | Path) -> Exported:
    """Export a weighed payload for a controller.

    Parameters
    ----------
    payload : PayloadBody
        From :meth:`gtau.PayloadEstimate.in_frame`, in the frame that the controller expects.
    kind : str
        One of ``WRITERS``.
    out : path
        Folder of the files.

    Returns
    -------
    Exported
        Files written, and notes on the frame and on parameters not identifiable from the motion.

    Raises
    ------
    GtauError
        Where the mass is not identifiable, the frame was not named, or the files cannot be written.

    Examples
    --------
    >>> result = gtau.load("result/model.json")
    >>> run = gtau.read_run("unknown.csv", result.recording.signals, payload={"name": "load"})
    >>> body = gtau.weigh(result, result.robot, [run])[0].in_frame("0 0 0 0 0 0")  # from the frame of the carrier
    >>> [file.name for file in gtau.export_payload(body, "ros", "exported").files]
    ['load.yaml']
    """
    refuse_unknown(kind, WRITERS)
    if not payload.named:
        refuse_unnamed(kind, payload.frame, ())
    if payload.rigid is None:
        raise GtauError(
            f"the mass of payload '{payload.name}' is not identifiable, and {kind} needs one; give its 'center' in the "
            "experiment file, or weigh it along another motion."
        )
    writer, expected = WRITERS[kind]
    notes = [f"in {payload.frame}; {expected}"]
    head = f"payload '{payload.name}' in {payload.frame}, weighed by gtau"
    if unseen := ", ".join(payload.unseen):
        head += f"; {unseen} not measured"
        notes.append(f"the motion does not show {unseen} of '{payload.name}', taken from a compact body instead")
    if payload.doubt:
        notes.append(payload.doubt)
    texts = writer(identifier(payload.name), _rounded(payload, payload.rigid), " ".join(head.split()))
    return Exported(written(Path(out), texts), tuple(notes))


TENSOR = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
FINE = 1e-6, 1e-4  # half-widths without an interval: of a centre, m; of an inertia, share of the largest entry
FINER = (1.0, 1e-1, 1e-2, 1e-3)  # shares of the half-widths, until the rounded inertia is realisable


def _rounded(payload: PayloadBody, rigid: RigidBody) -> RigidBody:
    """Round a body to the digits of its intervals, its inertia to a realisable one."""
    half = {key: estimate.half_interval() for key, estimate in payload.parameters.items()}

    def rounded(values: np.ndarray, keys: Sequence[str], without: float, share: float = 1.0) -> list[float]:
        keyed = zip(values.tolist(), keys, strict=True)
        return [float(to_width(x, share * (half[key] or without))) + 0.0 for x, key in keyed]

    entries, inertia = rigid.inertia[np.triu_indices(3)], rigid.inertia
    for share in FINER:
        xx, xy, xz, yy, yz, zz = rounded(entries, TENSOR, FINE[1] * float(np.abs(entries).max()), share)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        least, middle, largest = np.linalg.eigvalsh(inertia)
        if least > 0 and least + middle >= largest:
            break
    mass = float(to_width(rigid.mass, half["m"])) if half["m"] else rigid.mass
    return RigidBody(mass, np.array(rounded(rigid.center, ("cx", "cy", "cz"), FINE[0])), inertia)


def refuse_unnamed(kind: str, frame: str, links: Sequence[str]) -> None:
    """Refuse a default ``frame`` for a controller with its own frame; ``links`` are frames on the same body."""
    if kind == "ros":  # the message goes with any frame_id
        return
    offered = f"{', '.join(links)} in the robot's file, or " if links else ""
    raise GtauError(
        f"a controller ({kind}) takes the payload in the frame of its flange, which need not be {frame}; name it by "
        f"--frame (in Python in_frame): {offered}'x y z roll pitch yaw' (m, rad) from {frame}, '0 0 0 0 0 0' if it is "
        "the flange's."
    )


def _ur(name: str, body: RigidBody, head: str) -> Mapping[str, str]:
    """Write a line of URScript: kg, m, and ``[Ixx, Iyy, Izz, Ixy, Ixz, Iyz]`` in kg m2, in axes of the flange."""
    # https://www.universal-robots.com/manuals/EN/HTML/SW10_6/Content/prod-scriptmanual/G5/set_target_payload.htm
    entries = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    line = f"set_target_payload({_number(body.mass)}, [{_listed(body.center)}], [{_listed(entries)}])"
    return {f"{name}.script": f"# {head}\n{line}\n"}


def _franka(name: str, body: RigidBody, head: str) -> Mapping[str, str]:
    """Write the configuration of an end effector, and the fields of the request of a load; matrices by columns."""
    # https://download.franka.de/ride-cli-doc-v1.1.1/ ("End effector commissioning")
    # https://docs.ros.org/en/humble/p/franka_msgs/srv/SetLoad.html
    center, by_columns = body.center.tolist(), body.inertia.flatten(order="F").tolist()
    effector = {
        "id": name.replace("_", "-"),
        "name": name,
        "mass": body.mass,
        "centerOfMass": center,
        "inertia": by_columns,
        "transformation": np.eye(4).flatten(order="F").tolist(),
    }
    load = {"mass": body.mass, "center_of_mass": center, "load_inertia": by_columns}
    texts = {f"{name}_endeffector-config.json": effector, f"{name}_set_load.json": load}
    return {file: json.dumps(content, indent=1) + "\n" for file, content in texts.items()}


def _kuka(name: str, body: RigidBody, head: str) -> Mapping[str, str]:
    """Write a line of ``$config.dat``: kg; mm; degrees about Z, Y', X'' to the principal axes; their moments, kg m2."""
    # https://infosys.beckhoff.com/content/1033/tf5120/13081587595.html (KRC_WriteLoadData)
    moments, axes = body.principal
    roll, pitch, yaw = np.round(np.degrees(angles_of(axes)), 6)
    frame = _fields("XYZABC", [*(1e3 * body.center), yaw, pitch, roll])
    line = f"LOAD_DATA[1]={{M {_number(body.mass)},CM {{{frame}}},J {{{_fields('XYZ', moments)}}}}}"
    return {f"{name}.dat": f"; {head}\n{line}\n"}


def _abb(name: str, body: RigidBody, head: str) -> Mapping[str, str]:
    """Write a module with a ``loaddata``: kg; mm; principal axes as a quaternion (scalar first), moments in kg m2."""
    # https://developercenter.robotstudio.com/api/robotstudio/api/ABB.Robotics.RobotStudio.Stations.RsLoadData.html
    from scipy.spatial.transform import Rotation

    moments, axes = body.principal
    x, y, z, w = np.round(Rotation.from_matrix(axes).as_quat(canonical=True), 9)
    record = f"[{_number(body.mass)},[{_listed(1e3 * body.center)}],[{_listed([w, x, y, z])}],{_listed(moments)}]"
    name = name[:27]  # RAPID's names have 32 characters at most
    return {f"{name}.mod": f"MODULE {name}_load\n  ! {head}\n  PERS loaddata {name}:={record};\nENDMODULE\n"}


def _ros(name: str, body: RigidBody, head: str) -> Mapping[str, str]:
    """Write a geometry_msgs/Inertia: kg, m, and entries of the tensor about the centre of mass in kg m2."""
    # https://docs.ros.org/en/humble/p/geometry_msgs/msg/Inertia.html
    entries = dict(zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), body.inertia[np.triu_indices(3)], strict=True))
    message = {"m": body.mass, "com": dict(zip("xyz", map(float, body.center), strict=True))}
    message |= {key: float(value) for key, value in entries.items()}
    return {f"{name}.yaml": f"# {head}\n{yaml.safe_dump(message, sort_keys=False)}"}


WRITERS: Mapping[str, tuple[Callable[[str, RigidBody, str], Mapping[str, str]], str]] = {
    "ur": (_ur, "the controller takes it in the frame of the tool flange"),
    "franka": (_franka, "Franka takes it in the frame of the flange; 'transformation' is left to be set"),
    "kuka": (_kuka, "KUKA takes it in the frame of the flange; write the number of your tool in LOAD_DATA"),
    "abb": (_abb, "ABB takes it in the wrist frame as the load of a tool, and in the tool frame as a payload"),
    "ros": (_ros, "geometry_msgs/InertiaStamped names it as header.frame_id"),
}
"""Writer of each kind, and a note on the frame that the controller expects."""


def _number(value: float) -> str:
    return str(np.format_float_positional(np.round(value, 12) + 0.0, trim="0"))  # not every controller reads exponents


def _listed(values: np.ndarray | list[float]) -> str:
    return ",".join(map(_number, values))


def _fields(names: str, values: np.ndarray | list[float]) -> str:
    return ",".join(f"{name} {_number(value)}" for name, value in zip(names, values, strict=True))
