"""A `Robot` as the text of a robot file, from which :mod:`gtau.robots.readers.native` makes an equal one."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from gtau.documents.files import write_atomically
from gtau.documents.yaml_document import yaml_text
from gtau.errors import GtauError
from gtau.robots.robot import (
    DAMPING,
    PRELOAD,
    STIFFNESS,
    Attachment,
    Coupling,
    Joint,
    Mdh,
    Pose,
    Robot,
    Spring,
)


def native_text(robot: Robot) -> str:
    """Write a robot as the text of a robot file (YAML) from which `read_native` makes an equal one.

    A joint with an MDH placement and an axis other than z cannot be expressed, and is refused.
    """
    passive = bool(robot.closures or robot.couplings)
    lines = [_flow({"robot": robot.name})]
    if robot.source:
        lines.append(_flow({"source": robot.source}))
    if robot.notes:
        lines.append("notes:")
        lines += [f"  - {_flow_item(note)}" for note in robot.notes]
    lines.append(_flow({"gravity": list(robot.gravity)}))
    lines.append("joints:")
    moving = robot.joints[len(robot.base) :]
    lines += [f"  {_flow({joint.name: _joint_data(joint, passive)})}" for joint in moving]
    if robot.platforms:
        lines.append("platforms:")
        lines += [
            f"  {_flow({platform.name: {'dof': list(platform.dof), 'home': _pose_data(platform.home)}})}"
            for platform in robot.platforms
        ]
    if robot.closures:
        lines.append("closures:")
        lines += [f"  - {_flow({c.kind: [_attachment_data(c.a), _attachment_data(c.b)]})}" for c in robot.closures]
    if robot.couplings:
        lines.append("couplings:")
        lines += [f"  - {_flow_item(_coupling_data(coupling))}" for coupling in robot.couplings]
    if robot.springs:
        lines.append("springs:")
        lines += [f"  {_flow({spring.name: _spring_data(spring)})}" for spring in robot.springs]
    if robot.named_tool:
        lines.append(_flow({"tool": robot.named_tool}))
    if robot.floating:
        lines.append(_flow({"floating": robot.floating}))
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
