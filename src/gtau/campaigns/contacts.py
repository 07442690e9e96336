"""Contacts along a motion in MuJoCo, between all shapes of a robot's file: meshes, floor and walls."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gtau.errors import GtauError
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.readers.mujoco_process import refuse_deadly

EVERY = 0.01  # s between the poses looked at: 1 cm where the tool moves at 1 m/s


def check_contacts(file: Path, model: InverseDynamics, time: np.ndarray, joints: np.ndarray) -> str:
    """Check a motion (q, qd, qdd of the actuated joints, (3, n, N)) at ``time`` (N,) for contacts in MuJoCo.

    Bodies whose shapes overlap at the start do so in the drawing alone. Returns why no contact can be seen, empty if
    it can; raises GtauError where bodies touch.
    """
    try:
        import mujoco  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        return "MuJoCo is not installed"
    if file.suffix.lower() not in (".xml", ".urdf"):
        return "the robot's file holds no shapes"
    try:
        refuse_deadly(file)
        compiled = mujoco.MjModel.from_xml_path(str(file))
        places = [compiled.joint(joint.name).qposadr[0] for joint in model.robot.joints]
    except (ValueError, KeyError) as error:
        return f"MuJoCo cannot load the robot's file: {str(error).splitlines()[0].removeprefix('Error: ').rstrip('.')}"
    data, drawn = mujoco.MjData(compiled), None
    step = max(1, round(EVERY / (time[1] - time[0])))
    for t, c in zip(time[::step], model.motion(*joints[:3, :, ::step]).c.T, strict=True):
        data.qpos[places] = c[: len(places)]
        mujoco.mj_kinematics(compiled, data)
        mujoco.mj_comPos(compiled, data)
        mujoco.mj_collision(compiled, data)
        touching = {_pair(compiled, contact.geom) for contact in data.contact if contact.dist < 0}
        drawn = touching if drawn is None else drawn
        if new := sorted(touching - drawn):
            one, other = new[0]
            raise GtauError(
                f"in the rehearsal '{one}' touches '{other}' at {t:.3g} s, as MuJoCo sees the robot's file; "
                "limit its joints or give its surroundings in the design file."
            )
    return ""


def _pair(compiled: Any, geoms: np.ndarray) -> tuple[str, str]:
    bodies = (compiled.body(compiled.geom_bodyid[geom]).name for geom in geoms)
    one, other = sorted(compiled.geom(geom).name or body for geom, body in zip(geoms, bodies, strict=True))
    return one, other
