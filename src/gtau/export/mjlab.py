"""Actuators for mjlab as a YAML file, with the bodies as MJCF.

Keys are the fields of ``mjlab.actuator.BuiltinMotorActuatorCfg`` and its base ``ActuatorCfg`` (mjlab of 2026,
https://mujocolab.github.io/mjlab/source/actuators.html). A field left out keeps the value of the body's XML.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gtau.estimation.results.result import Result
from gtau.export.actuators import TIMESTEP, Actuator, actuator_notes, actuators, beside_notes, measured, yaml_file
from gtau.export.consistent import consistent_model
from gtau.export.exported import Exported, written
from gtau.export.mujoco_actuators import body_texts
from gtau.export.names import identifier

HEAD = """\
Actuators of '{robot}', identified from logs. Not run in mjlab.
Each entry of 'actuators' has the fields of one BuiltinMotorActuatorCfg (commands are torques, N m or N):
  BuiltinMotorActuatorCfg(**entry)
Delays are in physics steps of 'timestep' (s); stiffness and damping of a position controller are yours.
'{body}' holds the bodies, without actuators, and what a field left out keeps."""


def export(result: Result, out: Path) -> Exported:
    """Write ``NAME_mjlab.yaml`` and the bodies, ``NAME_body.xml``, into ``out``.

    Raises
    ------
    GtauError
        Where the result has no physically consistent parameters, or MuJoCo is not installed or refuses them.
    """
    model, name = consistent_model(result, "mjlab"), identifier(result.robot.name)
    found, body = actuators(model), f"{name}_body.xml"
    texts, notes, figures = body_texts(model)
    document = {"timestep": TIMESTEP, "actuators": list(map(_fields, found)), "measured": measured(found)}
    head = HEAD.format(robot=result.robot.name, body=body)
    files = written(out, {f"{name}_mjlab.yaml": yaml_file(head, document), body: texts.body})
    return Exported(files, (*notes, *actuator_notes(found), *beside_notes(found, "mjlab")), figures)


def _fields(each: Actuator) -> dict[str, Any]:
    fields: dict[str, Any] = {"target_names_expr": [each.joint]}
    if each.armature is not None:
        fields["armature"] = each.armature.value
    fields |= {"frictionloss": each.frictionloss, "viscous_damping": each.damping}
    fields |= {} if each.effort is None else {"effort_limit": each.effort}
    fields |= {} if each.velocity is None else {"velocity_limit": each.velocity}
    low, high = each.lags
    return fields | {"delay_min_lag": low, "delay_max_lag": high}
