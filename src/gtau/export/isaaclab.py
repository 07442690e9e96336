"""Actuators for Isaac Lab as a YAML file, with the bodies as URDF.

Keys are the fields of ``isaaclab.actuators.DelayedPDActuatorCfg`` and its base ``ActuatorBaseCfg``, by joint
(https://isaac-sim.github.io/IsaacLab/main/source/api/lab/isaaclab.actuators.html). ``dynamic_friction`` and
``viscous_friction`` came with Isaac Lab 2.2; Isaac Sim before 5.0 takes ``friction`` as a coefficient, not as a torque.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gtau.estimation.results.result import Result
from gtau.export import urdf
from gtau.export.actuators import TIMESTEP, actuator_notes, actuators, beside_notes, measured, yaml_file
from gtau.export.consistent import consistent_model
from gtau.export.exported import Exported, written
from gtau.export.names import identifier

HEAD = """\
Actuators of '{robot}', identified from logs. Not run in Isaac Lab.
'actuator' has the fields of one DelayedPDActuatorCfg, but for the gains of your controller (0 for torques):
  DelayedPDActuatorCfg(stiffness=..., damping=..., **actuator)
Delays are in physics steps of 'timestep' (s), the same for all joints. Both frictions are the Coulomb friction.
A joint missing under 'armature' has one that is not identifiable apart from its link: see 'measured'."""


def export(result: Result, out: Path) -> Exported:
    """Write ``NAME_isaaclab.yaml``, and the bodies as the export to URDF does, into ``out``.

    Raises
    ------
    GtauError
        Where the result has no physically consistent parameters, or the robot has no URDF.
    """
    model, name = consistent_model(result, "isaaclab"), identifier(result.robot.name)
    bodies, found = urdf.export(result, out), actuators(model)
    lags = [each.lags for each in found]
    fields: dict[str, Any] = {
        "joint_names_expr": [each.joint for each in found],
        "armature": {each.joint: each.armature.value for each in found if each.armature is not None},
        "friction": {each.joint: each.frictionloss for each in found},
        "dynamic_friction": {each.joint: each.frictionloss for each in found},
        "viscous_friction": {each.joint: each.damping for each in found},
        "effort_limit": {each.joint: each.effort for each in found if each.effort is not None},
        "velocity_limit": {each.joint: each.velocity for each in found if each.velocity is not None},
        "min_delay": min(low for low, _ in lags),
        "max_delay": max(high for _, high in lags),
    }
    document = {"timestep": TIMESTEP, "actuator": {k: v for k, v in fields.items() if v != {}}}
    text = yaml_file(HEAD.format(robot=result.robot.name), document | {"measured": measured(found)})
    files = written(out, {f"{name}_isaaclab.yaml": text})
    notes = (*bodies.notes, *actuator_notes(found), *beside_notes(found, "Isaac Lab"))
    return Exported((*files, *bodies.files), notes, bodies.figures)
