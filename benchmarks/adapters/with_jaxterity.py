"""jaxterity's windowed re-fit of a twin: friction, damping and actuation scale of each joint beside the file's bodies.

The twin's thermal numbers, which the re-fit does not use, are 1. Bounds are as wide as the torque; scales lie between a
half and two. Of a log with a payload nothing is used, as its bodies are the file's.
"""

import mujoco
import numpy as np
from exchange import Task, filtered
from jaxterity.calibrate import refit_drift_parameters
from jaxterity.data.schema import JointTelemetry
from jaxterity.robot.urdf import from_urdf
from jaxterity.twin import DriftParameter, Twin

task = Task()
if task.masses is None:
    task.refuse("needs a file with the robot's masses")
if task.masses.endswith(".xml"):
    task.refuse("not tried: a floating base")
log, n = task.fit[0], len(task.joints)
robot = from_urdf(task.masses)
if task.rotors:  # it finds none itself
    robot = robot.with_parameters({f"{joint}.armature": ia for joint, ia in zip(task.joints, task.rotors, strict=True)})
twin = Twin(robot, serial="board", C_th=np.ones(n), R_th=np.ones(n), k_pwr=np.ones(n), servo_names=tuple(task.joints))
q, qd, _ = filtered(log, task.cutoff, task.rate)
most = np.sqrt(np.mean(log["tau"] ** 2, axis=0))
slow = np.sqrt(np.mean(qd**2, axis=0))
schema = [DriftParameter("offbody.K_t_scale", 0.5, 2.0, "-", "scale")] if task.gains else []
for joint, torque, speed in zip(task.joints, most, slow, strict=True):
    schema.append(DriftParameter(f"robot.{joint}.friction", 0.0, 3 * torque, "N*m", "friction"))
    schema.append(DriftParameter(f"robot.{joint}.damping", 0.0, 3 * torque / speed, "N*m*s/rad", "damping"))
every = max(1, len(q) // 2000)
inside = slice(None, None, every)
telemetry = JointTelemetry(
    time=log["t"][inside] - log["t"][0],
    joint_names=tuple(task.joints),
    q=q[inside],
    qd=qd[inside],
    tau=log["tau"][inside],
    sample_rate_hz=task.rate / every,
    provenance="board",
)
found = refit_drift_parameters(twin, telemetry, tuple(schema))
scale = np.asarray(found.twin.K_t_scale) if task.gains else np.ones(n)
model = mujoco.MjModel.from_xml_string(found.twin.robot.to_mjcf())
model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
friction = np.array([float(found.sysid_result.fitted[f"robot.{joint}.friction"]) for joint in task.joints])
model.dof_frictionloss[:] = 0.0
data = mujoco.MjData(model)


def predict(log):
    """Inverse dynamics with its friction, as commands."""
    torques = np.empty_like(log["q"])
    states = filtered(log, task.cutoff, task.rate)
    for k, (data.qpos[:], data.qvel[:], data.qacc[:]) in enumerate(zip(*states, strict=True)):
        mujoco.mj_inverse(model, data)
        torques[k] = data.qfrc_inverse
    return (torques + friction * np.sign(states[1])) / scale


task.answer(predict, scales=[(float(value), None) for value in scale] if task.gains else [])
