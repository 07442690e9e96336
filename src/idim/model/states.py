"""Random feasible states of a robot, to find out what its model can tell apart."""

from __future__ import annotations

import numpy as np

from idim.errors import IdimError
from idim.model.inverse_dynamics import InverseDynamics
from idim.model.loops import CONDITION, Motion, advance, differentiate
from idim.robots.robot import Joint


def _range(joint: Joint, length: float) -> tuple[float, float]:
    if joint.limits.position is not None:
        return joint.limits.position
    reach = np.pi if joint.kind == "revolute" else length
    return joint.home - reach, joint.home + reach


def random_motion(idm: InverseDynamics, samples: int, rng: np.random.Generator) -> Motion:
    """Random states within the position limits, with the loops closed and away from singular poses.

    Speeds and accelerations are normally distributed with a third of their limits (1 rad/s or m/s and
    ten times that per second where there are none) as standard deviation. A pose that cannot be
    reached in the assembly mode of home is replaced by the last one on the way to it.

    Returns
    -------
    Motion
        At most ``samples`` samples.

    Raises
    ------
    IdimError
        Where the limits leave hardly any feasible pose.
    """
    joints = [idm.robot.joint(name) for name in idm.actuated]
    length = idm.loops.equations.length if idm.loops else 1.0
    bounds = np.array([_range(joint, length) for joint in joints])
    speed = np.array([joint.limits.velocity or 3.0 for joint in joints]) / 3
    push = np.array([joint.limits.acceleration or 30.0 for joint in joints]) / 3
    q = rng.uniform(bounds[:, :1], bounds[:, 1:], (len(joints), samples))
    qd = rng.normal(size=q.shape) * speed[:, None]
    qdd = rng.normal(size=q.shape) * push[:, None]
    if idm.loops is None:
        return idm.motion(q, qd, qdd)
    # no shorter steps: poses well before a singularity serve better than those as near to it as can be
    c, _ = advance(idm.loops, np.repeat(idm.loops.home[:, None], samples, axis=1), q, shortest=2.0**-7)
    arrived = c[idm.layout.actuated]
    inside = ((bounds[:, :1] <= arrived) & (arrived <= bounds[:, 1:])).all(axis=0)  # home may lie outside
    regular = inside & (idm.loops.condition(c) < CONDITION / 10)
    if regular.sum() < samples // 10:
        raise IdimError(
            f"robot '{idm.robot.name}': only {regular.sum()} of {samples} random poses within the limits can be "
            "reached away from "
            "singularities; narrow the joints' position limits to the workspace."
        )
    return differentiate(idm.loops, c[:, regular], qd[:, regular], qdd[:, regular])
