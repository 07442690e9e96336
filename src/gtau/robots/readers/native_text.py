"""Write a `Robot` as a robot file, from which :mod:`gtau.robots.readers.native` reads an equal one."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from gtau.documents.files import write_atomically
from gtau.documents.yaml_document import yaml_text
from gtau.errors import GtauError
from gtau.robots.robot import DAMPING, PRELOAD, STIFFNESS, Attachment, Coupling, Joint, Mdh, Pose, Robot, Spring


def native_text(robot: Robot) -> str:
    """Write a robot as the text of a robot file (YAML), from which `read_native` reads an equal one.

    A joint with an MDH placement and an axis other than z is refused.
    """
    passive, moving = bool(robot.closures or robot.couplings), robot.joints[len(robot.base) :]
    homes = {place.name: {"dof": list(place.dof), "home": _pose_data(place.home)} for place in robot.platforms}
    ties = [{str(tie.kind): [_attachment_data(tie.a), _attachment_data(tie.b)]} for tie in robot.closures]
    groups = {
        "robot": robot.name,
        "source": robot.source,
        "notes": [f"  - {_flow_item(note)}" for note in robot.notes],
        "gravity": robot.gravity,
        "joints": [f"  {_flow({joint.name: _joint_data(joint, passive)})}" for joint in moving],
        "platforms": [f"  {_flow({name: data})}" for name, data in homes.items()],
        "closures": [f"  - {_flow(tie)}" for tie in ties],
        "couplings": [f"  - {_flow_item(_coupling_data(coupling))}" for coupling in robot.couplings],
        "springs": [f"  {_flow({spring.name: _spring_data(spring)})}" for spring in robot.springs],
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


def _coupling_data(coupling: Coupling) -> dict[str, Any]:
    data: dict[str, Any] = {"joint": coupling.joint, "ratios": {name: float(ratio) for name, ratio in coupling.ratios}}
    return data | ({"offset": float(coupling.offset)} if coupling.offset else {})


def _spring_data(spring: Spring) -> dict[str, Any]:
    data: dict[str, Any] = {"between": [_attachment_data(spring.a), _attachment_data(spring.b)]}
    words = {"preload": PRELOAD, "stiffness": STIFFNESS, "damping": DAMPING}
    return data | {word: kind in spring.parameters for word, kind in words.items()}


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
