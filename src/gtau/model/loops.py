"""Loops closed at home, and their velocities and accelerations at closed configurations (paper, eqs. 3 to 8)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from gtau.errors import GtauError
from gtau.model.closures import closed_motion, loop_equations, newton_step
from gtau.model.interpreter.program import Program, compile_program
from gtau.model.kinematics import Coordinates, coordinates
from gtau.model.loop_closure import FAR, closed, is_closed, loop_errors
from gtau.robots.geometry import characteristic_length
from gtau.robots.robot import Robot

CONDITION = 1e3  # of the scaled passive columns: above this a pose counts as singular
CLOSER = "correct the placements or give the passive joints a 'home' closer to the assembled robot"


Labels = Callable[[int], str]
"""Name of each sample in messages."""


def numbers(first: int = 0) -> Labels:
    """Call samples by their numbers, counted from ``first``."""
    return lambda sample: f"sample {first + sample}"


@dataclass(frozen=True)
class Motion:
    """State of the whole virtual tree, from the closures, with samples along the last axis.

    ``c`` (n_c, N), ``yd`` and ``ydd`` (n_y, N), ``J = dy/dq`` (n_y, n, N), ``condition`` (N,) of the
    passive columns, lengths scaled by the characteristic length.
    """

    c: np.ndarray
    yd: np.ndarray
    ydd: np.ndarray
    J: np.ndarray
    condition: np.ndarray

    def __getitem__(self, samples: slice) -> Motion:
        """Select the motion at some of the samples."""
        return Motion(*(array[..., samples] for array in (self.c, self.yd, self.ydd, self.J, self.condition)))


def joined(parts: Sequence[Motion]) -> Motion:
    """Join the motions of all ``parts``, one after the other."""
    names = ("c", "yd", "ydd", "J", "condition")
    return Motion(*(np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in names))


@dataclass(frozen=True, eq=False)
class Loops:
    """Closures of a robot with its solved home configuration ``home`` (n_c,), compiled for many samples.

    ``equations`` maps c to the residual (rows,), ``G`` of the passive coordinates (rows, n_passive) and of the
    actuated ones (rows, n). ``step`` maps c to the configuration after a step of Newton's method, the largest
    correction and the condition number of the passive columns, ``fast_step`` to the same without the condition
    number, and ``gap`` to the largest residual less what angles of many turns are rounded by. ``motion``
    maps c, qd and qdd to the condition number, yd, ydd and J (n_y, n) (eqs. 5 to 8). Rows and columns are pure
    numbers: rad, or lengths over the robot's ``length``.
    """

    layout: Coordinates
    home: np.ndarray
    equations: Program
    step: Program
    fast_step: Program
    gap: Program
    motion: Program

    @property
    def length(self) -> float:
        """Characteristic length of the robot, m."""
        return characteristic_length(self.layout.robot)

    @property
    def rows(self) -> int:
        """Number of closure equations."""
        return self.equations.outputs // (1 + self.layout.n_y)

    def condition(self, c: np.ndarray) -> np.ndarray:
        """Compute the condition number (N,) of the scaled passive columns at closed configurations ``c`` (n_c, N)."""
        return self.step(c)[-1]

    def newton(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate residual (rows, N) and scaled passive columns of ``G`` (rows, n_passive, N) at ``c`` (n_c, N)."""
        residual, G_p, _ = self.columns(c)
        return residual, G_p

    def columns(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate residual (rows, N) and scaled ``G`` of the passive and the actuated coordinates (rows, ., N)."""
        rows, passive, actuated = self.rows, len(self.layout.passive), len(self.layout.actuated)
        residual, G_p, G_a = np.split(self.equations(c), np.cumsum([rows, rows * passive]))
        return residual, G_p.reshape(rows, passive, c.shape[1]), G_a.reshape(rows, actuated, c.shape[1])


@lru_cache(maxsize=8)
def close_loops(robot: Robot) -> Loops:
    """Close the loops of a robot at home and check that its actuated joints move all of it; made once a robot."""
    layout = coordinates(robot)
    errors = loop_errors(layout)
    home = closed(errors, layout.home, errors.passive)
    if not is_closed(errors, home):
        raise GtauError(
            f"robot '{robot.name}': the loops do not close near the home configuration, {errors.gap(home)}; {CLOSER}."
        )
    moved = errors.apart(layout.home, home)
    if moved.max() > FAR:
        k = int(moved.argmax())
        raise GtauError(
            f"robot '{robot.name}': the loops close only far from the home configuration, with '{layout.names[k]}' "
            f"{moved[k] * errors.unit[k]:.4g} {'rad' if layout.angular[k] else 'm'} away from it; {CLOSER}."
        )
    c, equations, gap = loop_equations(layout)
    configuration, step = newton_step(layout)
    inputs, motion = closed_motion(layout)
    loops = Loops(
        layout,
        home,
        equations=_compiled([c], equations),
        step=_compiled([configuration], step),
        fast_step=_compiled([configuration], step[:2]),
        gap=_compiled([c], [gap]),
        motion=_compiled(inputs, motion),
    )
    _, G_p, G_a = loops.columns(home[:, None])
    rank = int(np.linalg.matrix_rank(G_p[:, :, 0], tol=1e-7))
    total = int(np.linalg.matrix_rank(np.hstack([G_p[:, :, 0], G_a[:, :, 0]]), tol=1e-7))
    if rank < len(layout.passive):
        _refuse_free(robot, layout, G_p[:, :, 0], rank)
    if total > rank:
        _refuse_redundant(robot, np.hstack([G_p[:, :, 0], G_a[:, :, 0]]), total, total - rank)
    return loops


def _compiled(inputs: list[ca.SX], outputs: list[ca.SX]) -> Program:
    """Compile expressions whose entries come row by row."""
    return compile_program(inputs, [output.T for output in outputs])


def _refuse_free(robot: Robot, layout: Coordinates, G_p: np.ndarray, rank: int) -> None:
    """Refuse passive coordinates left free by rank-deficient columns ``G_p`` of the loop equations."""
    free = np.abs(np.linalg.svd(G_p)[2][rank:]).max(axis=0) > 1e-6
    held = np.abs(G_p).max(axis=0, initial=0.0) > 1e-7  # a turret under a loop turns, and closes none
    names = [layout.names[k] for k in layout.passive[free]]
    if alone := [layout.names[k] for k in layout.passive[free & ~held]]:
        raise GtauError(
            f"robot '{robot.name}': no motor moves {', '.join(alone)} and no closure holds "
            f"{'them' if len(alone) > 1 else 'it'}; hold the joints that stand still in the logs, "
            f"{_by_held(alone[0])}, fix a "
            "base that floats by 'base: fixed', or mark the joint actuated."
        )
    stiff = ""
    if sprung := [joint.name for joint in robot.joints if joint.spring is not None and joint.name in names]:
        stiff = f"hold the springs {', '.join(sprung)} if they hardly deflect, {_by_held(sprung[0])}, "
    raise GtauError(
        f"robot '{robot.name}': with the actuated joints ({', '.join(robot.actuated)}) held at the home configuration "
        f"{', '.join(names)} can still move ({len(layout.passive) - rank} dof); {stiff}actuate more joints, or move "
        "home away from a singular pose."
    )


def _refuse_redundant(robot: Robot, G: np.ndarray, rank: int, excess: int) -> None:
    """Refuse actuated joints that the loop equations tie to each other: the last columns of ``G``, of this rank."""
    n = len(robot.actuated)
    free = np.linalg.svd(G)[2][rank:, G.shape[1] - n :]  # how the motors can move
    ties = np.linalg.svd(free)[2][n - excess :]  # and its orthogonal complement, which they cannot move
    stuck = np.abs(free).max(axis=0, initial=0.0) < 1e-9
    tied = np.abs(ties).max(axis=0) > 1e-6
    fixed, apart = (
        [name for name, it in zip(robot.actuated, which, strict=True) if it] for which in (stuck, tied & ~stuck)
    )
    why = [f"the closures hold {', '.join(fixed)} fixed"] * bool(fixed)
    why += [f"loops or couplings tie {', '.join(apart)} at home"] * bool(apart)
    raise GtauError(
        f"robot '{robot.name}': actuation is redundant, which is not supported: {n} actuated joints for {len(free)} "
        f"dof, where {' and '.join(why)}; mark {excess} of them passive (in MJCF, without an actuator), hold the "
        f"joints that stand still in the logs, {_by_held((apart or fixed)[0])}, or check the closures and the dof of "
        f"platforms."
    )


def _by_held(name: str) -> str:
    return f"by 'held: {{{name}: POSITION}}' or a list of the moving 'joints' beside the robot's 'file'"


def pose_words(robot: Robot, q: np.ndarray) -> str:
    """Name the positions ``q`` (n,) of the actuated joints, for a message."""
    return ", ".join(f"q_{name} = {value:.4g}" for name, value in zip(robot.actuated, q, strict=True))


def differentiate(
    loops: Loops,
    c: np.ndarray,
    qd: np.ndarray,
    qdd: np.ndarray,
    labels: Labels | None = None,
) -> Motion:
    """Compute velocities and accelerations of the whole tree from those of the actuated joints (eqs. 5 to 8).

    ``c`` (n_c, N) are closed configurations, qd and qdd (n, N). Raises GtauError, with the names of ``labels``, at a
    pose too close to a singularity, where the actuated coordinates do not determine the passive ones.
    """
    layout, samples = loops.layout, c.shape[1]
    motion = loops.motion(c, qd, qdd)
    condition, yd, ydd, J = np.split(motion, np.cumsum([1, layout.n_y, layout.n_y]))
    condition = np.nan_to_num(condition[0], nan=np.inf)
    singular = condition >= CONDITION
    if singular.any():
        worst = int(np.argmax(condition))
        label, pose = (labels or numbers())(worst), pose_words(layout.robot, c[layout.actuated, worst])
        raise GtauError(
            f"robot '{layout.robot.name}': at {label} ({pose}) the pose is too close to a singularity of type 2, "
            "where passive joints can move although the actuated ones stand still "
            f"(condition number {condition[worst]:.3g}, at most {CONDITION:g} allowed), the worst of "
            f"{int(singular.sum())} such among {samples} samples; leave them out or keep the motion away from it."
        )
    return Motion(c, yd, ydd, J.reshape(layout.n_y, len(layout.actuated), samples), condition)
