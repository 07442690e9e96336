"""Loops closed for many samples, in one assembly mode, with velocities and accelerations (paper, eqs. 3 to 8).

Every sample is reached along a path from the home configuration: steps are halved until Newton's corrections shrink
fast, so a solution never jumps to another assembly mode unseen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from gtau.errors import GtauError
from gtau.model.equations import closed_motion, newton_step
from gtau.model.kinematics import Coordinates
from gtau.model.loop_closure import closed_home
from gtau.model.program import Program, compile_program, share
from gtau.robots.robot import Robot

CONDITION = 1e3  # of the scaled passive columns: above this a pose counts as singular
RESIDUAL = 1e-12  # of a closed loop: rad, or lengths over the characteristic length
CONTRACTION = 0.3  # a step is too long if Newton's second correction is not this much smaller
REACH = 0.5  # or if it leads this share of the way to a singular pose, where assembly modes meet
SHORTEST = 2.0**-14  # of the way between two samples: in shorter steps there is no path
SEGMENTS = 128  # of a path, followed in parallel, each of at least SEGMENT samples
SEGMENT = 16
PATHS = 64  # that a thread follows at least

Labels = Callable[[int], str]
"""Name of each sample in messages."""


def numbers(first: int = 0) -> Labels:
    """Call samples by their numbers, counted from ``first``."""
    return lambda sample: f"sample {first + sample}"


@dataclass(frozen=True)
class Motion:
    """Motion of the whole tree."""

    c: np.ndarray  # (n_c, N)
    yd: np.ndarray  # (n_y, N)
    ydd: np.ndarray
    J: np.ndarray  # dy/dq (n_y, n, N)
    condition: np.ndarray  # (N,) of the scaled passive columns

    def __getitem__(self, samples: slice) -> Motion:
        """Select the motion at some of the samples."""
        return Motion(*(array[..., samples] for array in vars(self).values()))


def joined(parts: Sequence[Motion]) -> Motion:
    """Join the motions of all ``parts``, one after the other."""
    arrays = zip(*(vars(part).values() for part in parts), strict=True)
    return Motion(*(np.concatenate(array, axis=-1) for array in arrays))


@dataclass(frozen=True, eq=False)
class Loops:
    """Closures of a robot, compiled for many samples (eqs. 5 to 8); gaps in rad, or lengths over the robot's."""

    layout: Coordinates
    home: np.ndarray  # (n_c,) solved
    step: Program  # from c: the next one by Newton's method, correction, condition
    fast_step: Program  # the same without the condition
    gap: Program  # largest residual less what angles of many turns are rounded by
    motion: Program  # from c, qd and qdd: condition number, yd, ydd and J (n_y, n)

    @property
    def rows(self) -> int:
        """Number of closure equations."""
        robot = self.layout.robot
        return sum(6 if tie.kind == "weld" else 3 for tie in robot.closures) + len(robot.couplings)

    def condition(self, c: np.ndarray) -> np.ndarray:
        """Compute the condition number (N,) of the scaled passive columns at closed configurations ``c`` (n_c, N)."""
        return self.step(c)[-1]

    @cached_property
    def scale(self) -> np.ndarray:
        """Factors (n_c,) by which entries of c become rad, or lengths over the robot's; zero for actuated ones."""
        layout = self.layout
        scale = np.full(self.layout.n_c, 1.0 / self.layout.length)
        scale[np.flatnonzero(layout.angular[: len(layout.robot.joints)])] = 1.0
        scale[layout.actuated] = 0.0
        for slots in layout.platforms:
            if slots.quaternion is not None:
                scale[slots.quaternion] = 2.0  # of a turn by an angle, at most half of it
        return scale

    def followed(self, shortest: float) -> tuple[Any, ...]:
        """Return what the compiled loops follow paths with, in steps of at least the share ``shortest``."""
        programs = tuple((*program.bound(), *program.fixed) for program in (self.step, self.fast_step, self.gap))
        actuated = np.array(self.layout.actuated, dtype=np.int64)
        return programs, self.scale, actuated, (shortest, RESIDUAL, CONTRACTION, REACH)


@lru_cache(maxsize=8)
def close_loops(robot: Robot) -> Loops:
    """Close the loops of a robot at home and check that its actuated joints move all of it; made once a robot."""
    layout = Coordinates(robot)
    home = closed_home(layout)
    (c, step), (inputs, motion) = newton_step(layout), closed_motion(layout)
    return Loops(
        layout,
        home,
        step=compile_program([c], step[:3]),
        fast_step=compile_program([c], step[:2]),
        gap=compile_program([c], step[3:]),
        motion=compile_program(inputs, [output.T for output in motion]),  # entries row by row
    )


def advance(loops: Loops, c: np.ndarray, q: np.ndarray, shortest: float = SHORTEST) -> tuple[np.ndarray, np.ndarray]:
    """Move from closed ``c`` (n_c, N) straight to ``q`` (n, N) as far as the loops close: c, and which arrive (N,)."""
    pairs = np.repeat(np.asarray(c, dtype=float), 2, axis=1)
    filled = _filled(loops, np.repeat(q, 2, axis=1), pairs, np.arange(0, pairs.shape[1], 2), 2, shortest)
    return np.ascontiguousarray(pairs[:, 1::2]), filled == 2


def displaced(loops: Loops, c: np.ndarray, q: np.ndarray, labels: Labels) -> np.ndarray:
    """Move from closed ``c`` (n_c, N) straight to ``q`` (n, N); raises GtauError where the loops do not close."""
    c, reached = advance(loops, c, q)
    if not reached.all():
        raise _unreachable(loops, q, int(np.argmin(reached)), labels)
    return c


def follow(
    loops: Loops, q: np.ndarray, labels: Labels | None = None, start: np.ndarray | None = None, segments: int = SEGMENTS
) -> np.ndarray:
    """Find the configurations (n_c, N) along the path ``q`` (n, N), rad or m, all in the assembly mode of home.

    The path begins at the closed configuration ``start`` (n_c,), or home, and is followed in ``segments`` in parallel.
    """
    q, samples = np.ascontiguousarray(q, dtype=float), q.shape[1]
    labels = labels or numbers()
    begin = loops.home if start is None else start
    c = np.repeat(begin[:, None], samples, axis=1)
    if not samples:
        return c
    length = max(-(-samples // segments), min(SEGMENT, samples))
    starts = np.arange(0, samples, length)
    c[:, [0]], first_reached = advance(loops, begin[:, None], q[:, [0]])
    if not first_reached[0]:
        raise _unreachable(loops, q, 0, labels)
    reached = np.ones(starts.size, dtype=bool)
    half = 1 << (starts.size - 1).bit_length()
    while half := half // 2:  # the head in the middle of the way, the heads of its halves, and so on
        heads = np.arange(half, starts.size, 2 * half)
        c[:, starts[heads]], reached[heads] = advance(loops, c[:, starts[heads - half]], q[:, starts[heads]])
    lost = _follow_segments(loops, q, c, starts[np.flatnonzero(reached)], length)
    # a segment must begin where the previous one ends
    led, joined = advance(loops, c[:, starts[1:] - 1], q[:, starts[1:]])
    redone = False
    for k in range(1, starts.size):
        if starts[k] - 1 in lost:
            break
        if redone:
            led[:, [k - 1]], joined[[k - 1]] = advance(loops, c[:, [starts[k] - 1]], q[:, [starts[k]]])
        if not joined[k - 1]:
            lost.add(starts[k])
            break
        redone = not reached[k] or np.abs(led[:, k - 1] - c[:, starts[k]]).max() > 1e-6
        if redone:
            c[:, starts[k]] = led[:, k - 1]
            lost -= set(range(starts[k], min(starts[k] + length, samples)))
            lost |= _follow_segments(loops, q, c, starts[[k]], length)
    if lost:
        raise _unreachable(loops, q, min(lost), labels)
    return c


def _filled(
    loops: Loops, q: np.ndarray, c: np.ndarray, starts: np.ndarray, length: int, shortest: float = SHORTEST
) -> np.ndarray:
    """Fill ``c`` from each of ``starts`` for ``length`` samples, or as many as can be reached; return how many were."""
    from gtau.model import kernel

    filled = np.zeros(starts.size, dtype=np.int64)

    def work(first: int, last: int) -> None:
        kernel.follow(loops.followed(shortest), c, q, starts[first:last], filled[first:last], length)

    share(work, starts.size, PATHS)
    return filled


def _follow_segments(loops: Loops, q: np.ndarray, c: np.ndarray, starts: np.ndarray, length: int) -> set[int]:
    """Fill ``c`` from each of ``starts`` for ``length`` samples; return those that were not reached."""
    ends = np.minimum(starts + length, q.shape[1])
    filled = _filled(loops, q, c, starts, length)
    return set().union(*map(range, starts + filled, ends))


def _unreachable(loops: Loops, q: np.ndarray, sample: int, labels: Labels) -> GtauError:
    robot = loops.layout.robot
    return GtauError(
        f"robot '{robot.name}': at {labels(sample)} ({pose_words(robot, q[:, sample])}) the loops cannot be closed, or "
        "only beyond a singular pose (type 2), outside the assembly mode of home; check the units, signs and zeros of "
        "the positions and the robot's geometry, or leave these samples out."
    )


def pose_words(robot: Robot, q: np.ndarray) -> str:
    """Name the positions ``q`` (n,) of the actuated joints, for a message."""
    return ", ".join(f"q_{name} = {value:z.4g}" for name, value in zip(robot.actuated, q, strict=True))


def differentiate(loops: Loops, c: np.ndarray, qd: np.ndarray, qdd: np.ndarray, labels: Labels | None = None) -> Motion:
    """Compute velocities and accelerations at closed ``c`` (n_c, N) from qd and qdd (n, N) (eqs. 5 to 8)."""
    layout, samples = loops.layout, c.shape[1]
    condition, yd, ydd, J = np.split(loops.motion(c, qd, qdd), np.cumsum([1, layout.n_y, layout.n_y]))
    condition = np.nan_to_num(condition[0], nan=np.inf)
    singular = condition >= CONDITION
    if singular.any():
        worst = int(np.argmax(condition))
        label = (labels or numbers())(worst)
        pose = pose_words(layout.robot, c[layout.actuated, worst])
        raise GtauError(
            f"robot '{layout.robot.name}': at {label} ({pose}) the pose is too close to a singularity of type 2, "
            "where passive joints can move although the actuated ones stand still "
            f"(condition number {condition[worst]:.3g}, at most {CONDITION:g} allowed), the worst of "
            f"{int(singular.sum())} such among {samples} samples; leave them out or keep the motion away from it."
        )
    return Motion(c, yd, ydd, J.reshape(layout.n_y, len(layout.actuated), samples), condition)
