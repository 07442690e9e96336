"""trainnr's torque balance: armature, damping and friction of each joint beside the bodies of the robot's file.

Its smoothing, band, velocity gate, knee of friction and bootstrap are its defaults, made for quadrupeds; where a joint
has too few samples the gate is loosened, as its message asks, and the knee with it. The search box is a quadruped's for
one, else as wide as the torque.
"""

import mujoco
import numpy as np
from exchange import Task
from trainnr.robot.torque_balance import (
    Bandwidth,
    Coulomb,
    JointSamples,
    Smoothing,
    TermBounds,
    VelocityGate,
    fit_terms,
    rigid_torque,
    tick_aligned,
)

task = Task()
if task.masses is None:
    task.refuse("needs a file with the robot's masses")
model = mujoco.MjModel.from_xml_path(task.masses)
smoothing = Smoothing(window_s=max(Smoothing().window_s, 7 / task.rate))  # its cubic needs more than 5 samples


def samples(log):
    times, position, velocity, acceleration = tick_aligned(log["t"], log["q"], smoothing=smoothing)
    return JointSamples(times, tuple(task.joints), position, velocity, acceleration, log["tau"][:-1])


def fit():
    log = samples(task.fit[0])
    most = 3 * float(np.sqrt(np.mean(log.torque**2, axis=0)).max())
    speed = float(np.sqrt(np.mean(log.velocity**2, axis=0)).min())
    box = TermBounds() if model.nu >= 12 else TermBounds((0.0, most), (0.0, most / speed), (0.0, most))
    band = Bandwidth(min(Bandwidth().cutoff_hz, 0.2 * task.rate))
    for share in (1.0, 0.3, 0.1, 0.03):
        gate, coulomb = VelocityGate(share * VelocityGate().still), Coulomb(share * Coulomb().knee)
        try:
            return fit_terms(model, log, bounds=box, gate=gate, bandwidth=band, coulomb=coulomb), coulomb
        except ValueError as error:
            if "loosen the gate" not in str(error) or share < 0.1:
                raise


balance, friction = fit()
terms = {joint.joint: joint.estimates for joint in balance.joints}
found = {}
if task.truth:
    kinds = {"armature": "ia", "damping": "fv", "frictionloss": "fs"}
    pairs = [(p, *p.name.rsplit(".", 1)) for p in balance.result.parameters]
    held = [abs(p.estimate - task.truth.get(f"{kinds[term]}_{joint}", 0.0)) <= p.half_width for p, joint, term in pairs]
    found["held"] = [sum(held), len(held)]


def predict(log):
    aligned = samples(log)
    a, b, c = (np.array([terms[joint][k] for joint in task.joints]) for k in ("armature", "damping", "frictionloss"))
    torque = rigid_torque(model, aligned) + a * aligned.acceleration + b * aligned.velocity
    torque += c * friction.column(aligned.velocity)
    return np.vstack([torque, torque[-1:]])


task.answer(predict, **found)
