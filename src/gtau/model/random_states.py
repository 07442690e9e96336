"""Random feasible states of a robot, to find out what its model can tell apart."""

from __future__ import annotations

from math import ceil

import numpy as np

from gtau.errors import GtauError
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loops import CONDITION, Motion, advance, differentiate, joined
from gtau.robots.robot import Joint

FEASIBLE = 0.02  # share of random poses: where fewer are, a robot is not described well enough to draw them
ENOUGH = 500  # poses that show the share


def _range(joint: Joint, length: float) -> tuple[float, float]:
    if joint.limits.position is not None:
        return joint.limits.position
    reach = np.pi if joint.kind == "revolute" else length
    return joint.home - reach, joint.home + reach


def random_motion(idm: InverseDynamics, samples: int, rng: np.random.Generator) -> Motion:
    """Random states within the position limits, with the loops closed and away from singular poses.

    Speeds and accelerations are normally distributed with a third of their limits (1 rad/s or m/s and
    ten times that per second where there are none) as standard deviation. A pose that cannot be
    reached in the assembly mode of home is replaced by the last one on the way to it; one that is nearly singular or
    beyond the limits is drawn anew.

    Returns
    -------
    Motion
        ``samples`` samples.

    Raises
    ------
    GtauError
        Where the limits leave hardly any feasible pose.
    """
    joints = [idm.robot.joint(name) for name in idm.actuated]
    length = idm.loops.equations.length if idm.loops else 1.0
    bounds = np.array([_range(joint, length) for joint in joints])
    speed = np.array([joint.limits.velocity or 3.0 for joint in joints]) / 3
    push = np.array([joint.limits.acceleration or 30.0 for joint in joints]) / 3
    parts: list[Motion] = []
    found, drawn, share = 0, 0, 1.0
    while found < samples:
        if drawn >= ENOUGH and share < FEASIBLE:
            raise GtauError(
                f"robot '{idm.robot.name}': only {found} of {drawn} random poses within the limits can be reached "
                "away from singularities; narrow the joints' position limits to the workspace."
            )
        count = samples if not drawn else ceil(1.2 * (samples - found) / max(share, FEASIBLE))
        q = rng.uniform(bounds[:, :1], bounds[:, 1:], (len(joints), count))
        qd = rng.normal(size=q.shape) * speed[:, None]
        qdd = rng.normal(size=q.shape) * push[:, None]
        parts.append(_regular(idm, bounds, q, qd, qdd))
        found, drawn = found + parts[-1].c.shape[1], drawn + count
        share = found / drawn
    return joined(parts)[slice(samples)]


def _regular(idm: InverseDynamics, bounds: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> Motion:
    """The states (n, N) whose poses are within ``bounds`` and regular."""
    if idm.loops is None:
        return idm.motion(q, qd, qdd)
    # no shorter steps: poses well before a singularity serve better than those as near to it as can be
    c, _ = advance(idm.loops, np.repeat(idm.loops.home[:, None], q.shape[1], axis=1), q, shortest=2.0**-7)
    arrived = c[idm.layout.actuated]
    inside = ((bounds[:, :1] <= arrived) & (arrived <= bounds[:, 1:])).all(axis=0)  # home may lie outside
    regular = inside & (idm.loops.condition(c) < CONDITION / 10)
    return differentiate(idm.loops, c[:, regular], qd[:, regular], qdd[:, regular])
