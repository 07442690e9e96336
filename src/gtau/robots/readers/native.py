"""Robot files: a `Robot` from YAML, and back. The format is explained in ``docs/lookup/robot-file.md``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from gtau.documents.expressions import RESERVED, evaluate
from gtau.documents.files import write_atomically
from gtau.documents.markup import Document, read_yaml, yaml_text
from gtau.documents.validation import validate
from gtau.errors import GtauError, errors_at
from gtau.robots.geometry import base_joints
from gtau.robots.placement import Mdh, Placement, Pose, exact_placement, short_angles_note
from gtau.robots.readers.source import RobotEntry
from gtau.robots.robot import SPRING_WORDS, Attachment, Coupling, Joint, Platform, Robot, RobotFile


def read_native(path: str | Path) -> Robot:
    """Read a robot file (YAML); ``docs/lookup/robot-file.md`` explains the format.

    Rounded angles of placements are replaced by the exact ones, with a note.
    """
    robot = _robot(read_yaml(path))
    changes: dict[str, float] = {}

    def exact(name: str, placement: Placement) -> Placement:
        meant, change = exact_placement(placement)
        changes[name] = max(change, changes.get(name, 0.0))
        return meant if change else placement

    def end(at: Attachment) -> Attachment:
        return Attachment(at.body, exact(at.body, at.placement))

    joints = tuple(replace(joint, placement=exact(joint.name, joint.placement)) for joint in robot.joints)
    closures = tuple(replace(tie, a=end(tie.a), b=end(tie.b)) for tie in robot.closures)
    notes = short_angles_note(changes)
    return replace(robot, joints=joints, closures=closures).noted(*notes) if notes else robot


def parse_native(text: str, path: str | Path) -> Robot:
    """Read a robot from the text of a robot file, with angles as written; ``path`` is for messages."""
    return _robot(Document(path, text))


def _robot(document: Document) -> Robot:
    constants = _constants(document)
    entry = validate(RobotEntry, document, context=constants)
    # Loops and couplings leave most joints passive, an open chain none: each default is the common case.
    driven = not (entry.closures or entry.couplings)
    joints = [joint.joint(name, driven) for name, joint in entry.joints.items()]
    with errors_at(document.path):
        return Robot(
            name=entry.robot,
            joints=(*(base_joints(entry.floating) if entry.floating else ()), *joints),
            platforms=tuple(
                Platform(name, tuple(platform.dof), Pose(platform.home.xyz, platform.home.rpy))
                for name, platform in entry.platforms.items()
            ),
            closures=tuple(tie.closure for tie in entry.closures),
            couplings=tuple(Coupling(tie.joint, tuple(tie.ratios.items()), tie.offset) for tie in entry.couplings),
            gravity=entry.gravity,
            named_tool=entry.tool,
            floating=entry.floating,
            springs=tuple(spring.spring(name) for name, spring in entry.springs.items()),
            file=RobotFile(entry.source, tuple(entry.notes), constants=tuple(constants.items())),
        )


def _constants(document: Document) -> dict[str, float]:
    written = document.data.get("constants", {})
    if not isinstance(written, Mapping):
        raise document.error(("constants",), "write 'name: value' lines under it")
    values: dict[str, float] = {}
    for name, text in written.items():
        keys = ("constants", name)
        if name in RESERVED or not name.isidentifier() or not name.isascii():
            raise document.error(keys, f"'{name}' cannot name a constant; use letters, digits and _, and none of "
                                       f"{', '.join(sorted(RESERVED))}")  # fmt: skip
        try:
            values[name] = evaluate(text, values)
        except ValueError as error:
            raise document.error(keys, str(error)) from None
    return values


def native_text(robot: Robot) -> str:
    """Write a robot as the text of a robot file (YAML), from which `read_native` reads an equal one."""
    passive = bool(robot.closures or robot.couplings)
    moving = robot.joints[len(robot.base) :]
    homes = {place.name: {"dof": list(place.dof), "home": _pose_data(place.home)} for place in robot.platforms}
    ties = [{str(tie.kind): [_attachment_data(tie.a), _attachment_data(tie.b)]} for tie in robot.closures]
    couplings = [
        {"joint": tie.joint, "ratios": {name: float(ratio) for name, ratio in tie.ratios}}
        | ({"offset": float(tie.offset)} if tie.offset else {})
        for tie in robot.couplings
    ]
    springs = {
        spring.name: {"between": [_attachment_data(spring.a), _attachment_data(spring.b)]}
        | {word: kind in spring.parameters for word, kind in SPRING_WORDS.items()}
        for spring in robot.springs
    }
    groups = {
        "robot": robot.name,
        "source": robot.source,
        "notes": [f"  - {_flow_item(note)}" for note in robot.notes],
        "gravity": robot.gravity,
        "joints": [f"  {_flow({joint.name: _joint_data(joint, passive)})}" for joint in moving],
        "platforms": [f"  {_flow({name: data})}" for name, data in homes.items()],
        "closures": [f"  - {_flow(tie)}" for tie in ties],
        "couplings": [f"  - {_flow_item(tie)}" for tie in couplings],
        "springs": [f"  {_flow({name: data})}" for name, data in springs.items()],
        "tool": robot.named_tool,
        "floating": robot.floating,
    }
    lines: list[str] = []
    for key, value in groups.items():
        if isinstance(value, list) and value:
            lines += [f"{key}:", *value]
        elif value:
            lines.append(_flow({key: list(value) if isinstance(value, tuple) else value}))
    return "\n".join(lines) + "\n"


def write_native(robot: Robot, path: str | Path) -> None:
    """Write a robot file atomically; an existing one is replaced."""
    write_atomically(path, native_text(robot))


def _flow(data: dict[str, Any]) -> str:
    return _flow_item(data)[1:-1]  # without the outer braces


def _flow_item(data: Any) -> str:
    return yaml_text([data], flow=True, width=float("inf")).strip()[1:-1]  # without the list's brackets


def _joint_data(joint: Joint, passive: bool) -> dict[str, Any]:
    data: dict[str, Any] = {"antecedent": joint.antecedent}
    if isinstance(joint.placement, Pose):
        data |= _pose_data(joint.placement) | {"axis": list(joint.axis), "type": joint.kind}
    elif joint.axis != (0.0, 0.0, 1.0):
        raise GtauError(
            f"joint '{joint.name}' has an MDH placement but its axis is not z; "
            "place it by a Pose, or turn its frame so that z is the axis."
        )
    else:
        moving = "theta" if joint.turns else "r"
        data |= _mdh_data(joint.placement)
        offset = data.pop(moving, 0.0)
        data[moving] = f"q {'-' if offset < 0 else '+'} {abs(offset)!r}" if offset else "q"
    if joint.actuated == passive:
        data["actuated"] = joint.actuated
    if joint.home:
        data["home"] = float(joint.home)
    limits = {key: value for key, value in asdict(joint.limits).items() if value is not None}
    if limits:
        data["limits"] = {key: list(value) if key == "position" else float(value) for key, value in limits.items()}
    if joint.parameters != "all":
        data["parameters"] = joint.parameters
    if joint.spring is not None:
        data |= {"stiffness": True} | ({"springref": float(joint.spring)} if joint.spring else {})
    return data


def _mdh_data(placement: Mdh) -> dict[str, Any]:
    values = {field.name: float(getattr(placement, field.name)) for field in fields(placement)}
    return {key: value for key, value in values.items() if value}


def _pose_data(placement: Pose) -> dict[str, Any]:
    values = {"xyz": placement.xyz, "rpy": placement.rpy}
    return {key: [float(x) for x in value] for key, value in values.items() if any(value)}


def _attachment_data(attachment: Attachment) -> dict[str, Any]:
    if isinstance(attachment.placement, Pose):
        return {"body": attachment.body} | _pose_data(attachment.placement)
    # An identity MDH placement is still written as MDH.
    return {"body": attachment.body} | (_mdh_data(attachment.placement) or {"r": 0.0})
