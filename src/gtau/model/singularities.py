"""Draw random regular states of a robot, and measure how far a pose is from singularities (Gosselin and Angeles, 1990).

At a singularity of **type 2** (parallel) the passive joints can move although the actuated ones stand still: the
passive columns G_p of the closures lose rank, and nothing can be identified there. At one of **type 1** (serial) the
actuated joints can move although the tool stands still, orientation included: its Jacobian J_t loses rank, as of a
stretched arm of six joints, not of a planar one of two; the model holds there.

Distances are reciprocal condition numbers, 1 at best and 0 at a singularity: ``k / sqrt(sum(s^2) sum(1 / s^2))`` of k
singular values s, lengths being counted in characteristic lengths. For type 2 these are the singular values of G_p. For
type 1 they belong to the tool's rows of an orthonormal basis of the motions (qd, twist of the tool): ``s / sqrt(1 +
s^2)`` with singular values s of J_t, as many as J_t has at most poses. A single one is compared with the largest among
random poses.
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from typing import Literal

import casadi as ca
import numpy as np

from gtau.errors import GtauError
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import constant, frames, twists
from gtau.model.loops import CONDITION, Motion, advance, differentiate, joined
from gtau.model.program import compile_program
from gtau.robots.robot import Joint

FEASIBLE = 0.02  # share of random poses: where fewer are, they are drawn nearer to home
ENOUGH = 500  # poses that show the share
MOVED = 0.1  # of the way from home to a pose: one that stops earlier adds no information to home
SMALLEST = 2.0**-8  # share of the range about home in which poses are drawn
REGULAR = CONDITION / 10  # condition number of regular poses


def _range(joint: Joint, length: float) -> tuple[float, float]:
    reach = np.pi if joint.turns else length
    return joint.limits.position or (joint.home - reach, joint.home + reach)


def random_motion(idm: InverseDynamics, samples: int, rng: np.random.Generator, condition: float = REGULAR) -> Motion:
    """Draw ``samples`` random states within the position limits, with the loops closed and away from singular poses.

    Speeds and accelerations are normally distributed with a third of their limits (1 rad/s or m/s and ten times that
    per second where there are none) as standard deviation. A pose that cannot be reached in the assembly mode of home
    is replaced by the last one on the way to it; one that hardly left home, whose condition number is above
    ``condition``, or beyond the limits is redrawn, and if few are feasible, all closer to home.
    """
    joints = [idm.robot.joint(name) for name in idm.actuated]
    length = idm.layout.length if idm.loops else 1.0
    bounds = np.array([_range(joint, length) for joint in joints])
    home = np.clip(idm.home[idm.layout.actuated], *bounds.T)[:, None]
    speed = np.array([joint.limits.velocity or 3.0 for joint in joints]) / 3
    push = np.array([joint.limits.acceleration or 30.0 for joint in joints]) / 3
    parts: list[Motion] = []
    regular, drawn, share, box = 0, 0, 1.0, 1.0
    while regular < samples:
        if drawn >= ENOUGH and share < FEASIBLE:
            if box <= SMALLEST:
                raise GtauError(
                    f"robot '{idm.robot.name}': hardly any pose within the position limits can be reached away from "
                    "singularities, even close to home; give limits and a home within the workspace, and check which "
                    "joints are actuated."
                )
            parts, regular, drawn, share, box = [], 0, 0, 1.0, box / 2
        count = samples if not drawn else ceil(1.2 * (samples - regular) / max(share, FEASIBLE))
        q = home + box * (rng.uniform(bounds[:, :1], bounds[:, 1:], (len(joints), count)) - home)
        qd = rng.normal(size=q.shape) * speed[:, None]
        parts.append(_regular(idm, bounds, q, qd, rng.normal(size=q.shape) * push[:, None], condition))
        regular, drawn = regular + parts[-1].c.shape[1], drawn + count
        share = regular / drawn
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


Distances = Callable[[Motion], np.ndarray]
TYPES: tuple[Literal[1, 2], ...] = (1, 2)
POSES = 64  # random ones, that show the rank of J_t
NO_MOTION = 1e-7  # share of the largest singular value of J_t: rounding


def singular_distances(idm: InverseDynamics) -> Distances:
    """Prepare the distances (2, N) of motions to singularities of type 1 and 2, NaN for type 2 without closures."""
    layout, jacobian = idm.layout, tool_jacobian(idm)
    # the rank of J_t at most poses, and its largest singular value there
    s = np.linalg.svd(jacobian(random_motion(idm, POSES, np.random.default_rng(0))), compute_uv=False)
    rank = int((s > NO_MOTION * s.max()).sum(axis=1).max())
    largest = float(s.max())

    def distances(motion: Motion) -> np.ndarray:
        s = np.linalg.svd(jacobian(motion), compute_uv=False)[:, :rank]
        if rank == 1:  # a single singular value has no reference in the pose itself
            type_1 = np.minimum(s[:, 0] / largest, 1.0)
        else:
            share = s / np.hypot(1.0, s)
            with np.errstate(divide="ignore", over="ignore"):
                type_1 = rank / np.sqrt((share**2).sum(axis=1) * (share**-2).sum(axis=1))
        if not layout.robot.closures:
            return np.stack([type_1, np.full_like(type_1, np.nan)])
        # ``condition`` is sqrt(sum(s^2) sum(1 / s^2)) of the passive columns
        return np.stack([type_1, len(layout.passive) / motion.condition])

    return distances


def tool_jacobian(idm: InverseDynamics) -> Callable[[Motion], np.ndarray]:
    """Compile the Jacobian J_t (N, rows, n) of the tool, or of the point where a ``connect`` ties it, along motions."""
    layout, robot, length = idm.layout, idm.robot, idm.layout.length
    n, passive = len(layout.actuated), layout.passive
    (c, _, _, symbols), J = idm.symbols
    ends = [end for tie in robot.closures if tie.kind == "connect" for end in (tie.a, tie.b)]
    points = [] if robot.platforms else [end.placement.position for end in ends if end.body == robot.tool]
    speeds = ca.SX.sym("qd", n)
    twist = twists(layout, frames(layout, c), J @ speeds)[robot.tool]
    if points:
        rows = (twist.linear + ca.cross(twist.angular, constant(points[0]))) / length
    else:
        rows = ca.vertcat(twist.linear / length, twist.angular)
    scaled = ca.jacobian(rows, speeds) @ constant(np.diag(layout.unit[layout.actuated]))
    program = compile_program([c, symbols], [scaled.T])

    def jacobian(motion: Motion) -> np.ndarray:
        samples = motion.c.shape[1]
        return program(motion.c, motion.J[passive].reshape(-1, samples)).reshape(-1, n, samples).transpose(2, 0, 1)

    return jacobian
