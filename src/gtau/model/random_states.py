"""Draw random feasible states of a robot, to find the structure of its model."""

from __future__ import annotations

from math import ceil

import numpy as np

from gtau.errors import GtauError
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loop_paths import advance
from gtau.model.loops import CONDITION, Motion, differentiate, joined
from gtau.robots.robot import Joint

FEASIBLE = 0.02  # share of random poses: where fewer are, they are drawn nearer to home
ENOUGH = 500  # poses that show the share
MOVED = 0.1  # of the way from home to a pose: one that stops earlier adds no information to home
SMALLEST = 2.0**-8  # share of the range about home in which poses are drawn
REGULAR = CONDITION / 10  # condition number of regular poses


def _range(joint: Joint, length: float) -> tuple[float, float]:
    if joint.limits.position is not None:
        return joint.limits.position
    reach = np.pi if joint.turns else length
    return joint.home - reach, joint.home + reach


def random_motion(idm: InverseDynamics, samples: int, rng: np.random.Generator, condition: float = REGULAR) -> Motion:
    """Draw random states within the position limits, with the loops closed and away from singular poses.

    Speeds and accelerations are normally distributed with a third of their limits (1 rad/s or m/s and
    ten times that per second where there are none) as standard deviation. A pose that cannot be
    reached in the assembly mode of home is replaced by the last one on the way to it; one that hardly left home, is
    nearly singular or beyond the limits is redrawn. If few feasible poses remain, all are drawn closer to home.

    Parameters
    ----------
    idm : InverseDynamics
        Model of the robot.
    samples : int
        States wanted.
    rng : Generator
        Random number generator.
    condition : float
        Condition number of the scaled passive columns below which a pose is regular.

    Returns
    -------
    Motion
        ``samples`` samples.

    Raises
    ------
    GtauError
        Hardly any pose around home is feasible.
    """
    joints = [idm.robot.joint(name) for name in idm.actuated]
    length = idm.loops.equations.length if idm.loops else 1.0
    bounds = np.array([_range(joint, length) for joint in joints])
    home = np.clip((idm.loops.home if idm.loops else idm.layout.home)[idm.layout.actuated], *bounds.T)[:, None]
    speed = np.array([joint.limits.velocity or 3.0 for joint in joints]) / 3
    push = np.array([joint.limits.acceleration or 30.0 for joint in joints]) / 3
    parts: list[Motion] = []
    found, drawn, share, box = 0, 0, 1.0, 1.0
    while found < samples:
        if drawn >= ENOUGH and share < FEASIBLE:
            if box <= SMALLEST:
                raise GtauError(
                    f"robot '{idm.robot.name}': hardly any pose within the position limits can be reached away from "
                    "singularities, even close to home; give limits and a home within the workspace, and check which "
                    "joints are actuated."
                )
            parts, found, drawn, share, box = [], 0, 0, 1.0, box / 2
        count = samples if not drawn else ceil(1.2 * (samples - found) / max(share, FEASIBLE))
        q = home + box * (rng.uniform(bounds[:, :1], bounds[:, 1:], (len(joints), count)) - home)
        qd = rng.normal(size=q.shape) * speed[:, None]
        qdd = rng.normal(size=q.shape) * push[:, None]
        parts.append(_regular(idm, bounds, q, qd, qdd, condition))
        found, drawn = found + parts[-1].c.shape[1], drawn + count
        share = found / drawn
    return joined(parts)[slice(samples)]


def _regular(
    idm: InverseDynamics, bounds: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, condition: float
) -> Motion:
    """Select the states (n, N) whose poses are within ``bounds`` and regular."""
    if idm.loops is None:
        return idm.motion(q, qd, qdd)
    home = idm.loops.home[:, None]
    # no shorter steps: poses well before a singularity are better than those very close to it
    c, _ = advance(idm.loops, np.repeat(home, q.shape[1], axis=1), q, shortest=2.0**-7)
    arrived, start = c[idm.layout.actuated], home[idm.layout.actuated]
    inside = ((bounds[:, :1] <= arrived) & (arrived <= bounds[:, 1:])).all(axis=0)  # home may lie outside
    moved = np.linalg.norm(arrived - start, axis=0) >= MOVED * np.linalg.norm(q - start, axis=0)
    regular = inside & moved & (idm.loops.condition(c) < condition)
    return differentiate(idm.loops, c[:, regular], qd[:, regular], qdd[:, regular])
