"""Actuators for simulators: identified and unidentified quantities of each motor and its joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import yaml

from gtau.estimation.results.estimate import Estimate
from gtau.export.consistent import ConsistentModel
from gtau.robots.parameter import Parameter
from gtau.robots.units import torque_unit

TIMESTEP = 0.005  # s: of physics in the files, in which delays are counted


@dataclass(frozen=True, eq=False)
class Actuator:
    """Motor and joint, SI units at the joint.

    ``gain`` turns current (or the logged torque) into torque; ``armature`` is None where it is not identifiable apart
    from the inertia of links: it is part of the base parameter ``regrouped``, and ``chosen`` is its value in the
    exported bodies. ``damping``, ``frictionloss`` and ``cubic`` are viscous, Coulomb and cubic
    friction. ``effort`` and ``velocity`` are limits of the robot's file, None where it has none.
    """

    joint: str
    unit: str
    gain: Estimate
    armature: Estimate | None
    regrouped: str
    chosen: float
    damping: float
    frictionloss: float
    cubic: float
    offset: float
    effort: float | None
    velocity: float | None
    delay: Estimate

    @property
    def lag(self) -> float:
        """Delay from command to torque, s; 0 if negative (no simulator allows that) or not identifiable."""
        return max(self.delay.value or 0.0, 0.0) if self.delay.std is not None else 0.0

    @property
    def lags(self) -> tuple[int, int]:
        """Ends of the interval of the delay, in steps of ``TIMESTEP``."""
        low, high = self.delay.interval() or (self.lag, self.lag)
        return max(round(low / TIMESTEP), 0), max(round(high / TIMESTEP), 0)


def actuators(model: ConsistentModel) -> tuple[Actuator, ...]:
    """List the actuators of an identified model."""
    result = model.result
    return tuple(_actuator(model, joint) for joint in result.robot.motors)


def _actuator(model: ConsistentModel, joint: str) -> Actuator:
    result, limits = model.result, model.result.robot.joint(joint).limits
    armature, regrouped = _armature(model, joint)
    gain = replace(result.drive_gains[joint], value=model.gains[joint])
    return Actuator(
        joint,
        torque_unit(result.robot, joint),
        gain,
        armature,
        regrouped,
        model.of("ia", joint),
        model.of("fv", joint),
        model.of("fs", joint),
        model.cubic(joint),
        model.of("off", joint),
        limits.effort,
        limits.velocity,
        result.delays[joint],
    )


def _armature(model: ConsistentModel, joint: str) -> tuple[Estimate | None, str]:
    """Find the rotor inertia if it is a base parameter of its own, else the base parameter that contains it."""
    base, name = model.result.base, Parameter("ia", joint).name
    column = base.matrix[:, model.result.model.parameter_names.index(name)]
    parts = [k for k, factor in enumerate(column) if factor]
    if len(parts) == 1 and (base.matrix[parts[0]] != 0).sum() == 1:
        found = model.result.parameters[base.names[parts[0]]]
        if found.value is not None:
            return replace(found, value=model.of("ia", joint)), ""
    return None, base.names[parts[0]] if parts else ""


def actuator_notes(found: Sequence[Actuator]) -> list[str]:
    """List the actuator quantities that are not identifiable or missing in the robot's file."""
    notes = []
    together = [f"'{each.joint}' ({each.regrouped or 'no effect'})" for each in found if each.armature is None]
    if together:
        notes.append(
            "the armature is not identifiable apart from the inertia of links, whose sum is the base parameter in "
            f"brackets: {', '.join(together)}; its value in the exported bodies was chosen and goes with them alone"
        )
    if missing := [each.joint for each in found if each.effort is None]:
        notes.append(f"the robot file has no effort limit of {', '.join(missing)}: none is in the files")
    if unknown := [each.joint for each in found if each.delay.std is None]:
        notes.append(f"the delay of {', '.join(unknown)} is not identifiable, and 0 in the files")
    if early := [each.joint for each in found if each.delay.std is not None and (each.delay.value or 0.0) < 0]:
        notes.append(f"the delay of {', '.join(early)} is estimated below 0, and 0 in the files")
    return notes


def beside_notes(found: Sequence[Actuator], target: str) -> list[str]:
    """List the quantities for which a ``target`` has no field."""
    notes = [f"the YAML file was not run in {target}: its keys are the fields of its documentation"]
    if bent := [each.joint for each in found if each.cubic]:
        notes.append(f"{target} has no friction cubic in speed, which is under 'measured': {', '.join(bent)}")
    if offset := [each.joint for each in found if each.offset]:
        notes.append(f"offsets of torque are under 'measured', as {target} has none: {', '.join(offset)}")
    return notes


def measured(found: Sequence[Actuator]) -> dict[str, Any]:
    """Describe the actuators by joint, with intervals, for people and programs."""
    return {each.joint: _measured(each) for each in found}


def _measured(each: Actuator) -> dict[str, Any]:
    per = "1" if each.gain.unit == "1" else each.gain.unit
    entry: dict[str, Any] = {"current_to_torque": _estimate(each.gain, per), "delay": _estimate(each.delay, "s")}
    if each.armature is not None:
        entry["armature"] = _estimate(each.armature, each.armature.unit)
    else:
        chosen = {"not_identifiable_apart_from": each.regrouped, "with_exported_bodies": each.chosen}
        entry["armature"] = chosen
    plain = {"damping": each.damping, "frictionloss": each.frictionloss, "offset": each.offset}
    entry |= plain | ({"damping_cubic": each.cubic} if each.cubic else {})
    return entry | {key: value for key, value in (("effort", each.effort), ("velocity", each.velocity)) if value}


def _estimate(each: Estimate, unit: str) -> dict[str, Any]:
    interval = each.interval()
    found: dict[str, Any] = {"value": each.value, "unit": unit}
    return found | ({} if interval is None else {"interval": list(interval)})


def yaml_file(head: str, document: dict[str, Any]) -> str:
    """Write a YAML file with a comment on top."""
    text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
    return "".join(f"# {line}\n" for line in head.splitlines()) + text
