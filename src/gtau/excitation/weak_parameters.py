"""Unknowns that a motion leaves unidentified, and the further motion that would identify them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.triangle import triangle
from gtau.excitation.criteria import root_covariance
from gtau.excitation.design import Design
from gtau.excitation.evaluation import PER_HARMONIC, Grid, Point, design_grid, evaluate, information
from gtau.excitation.forecast import Forecast
from gtau.excitation.task import DesignProblem, close
from gtau.model.loops import Motion

WEAK = 0.3  # relative standard deviation from which an unknown counts as unidentified
WORTH = 0.7  # a motion is named where it brings a standard deviation below this part of what it was
SPANS = {"over its whole range, slowly": (0.9, 0.2), "as fast as it may": (0.5, 0.9)}
"""What one joint alone does: the part of its range, and of its speed limit."""


@dataclass(frozen=True)
class Weak:
    """An unknown that stays unidentified, its relative standard deviation, and the motion of one joint that helps most.

    ``joint`` is None where no such motion helps; ``then`` is the relative standard deviation with that motion added.
    Both are infinite for an unknown that cannot be separated from others at all.
    """

    name: str
    relative: float
    joint: str | None
    how: str
    then: float


def weak_unknowns(design: Design, expected: Forecast) -> tuple[Weak, ...]:
    """List gains and parameters that a design leaves unidentified, with the best single-joint motion to add for each.

    A relative standard deviation is the ``expected`` one over the prior value, or over a typical one where that is
    zero; the effect of a further motion on it is the ratio of the design's own, which are those of a coarser grid.
    Candidates are every joint moving alone, slowly over its range or fast in the middle of it, for as long as a run;
    they are carried out with every payload of the experiment.
    """
    task = design.task
    points = evaluate(task, design.x, design_grid(task))
    unknowns, R = task.unknowns, information(points)
    middle = np.mean([point.joints[0].mean(axis=1) for point in points], axis=0)
    before = _relative(task, R)
    relative = {
        k: expected.std.get(name, np.inf) / unknowns.scale[k]
        for k, name in enumerate(unknowns.names)
        if not name.startswith("delay_") and "@" not in name
    }
    weak = [k for k, each in relative.items() if each >= WEAK]
    if not weak:
        return ()
    then = {
        (joint, how): _relative(task, triangle(R, more))
        for j, joint in enumerate(task.model.actuated)
        for how, (span, speed) in SPANS.items()
        for more in [_alone(task, middle, j, span, speed)]
        if more is not None
    }
    found = []
    for k in weak:
        helpful = [(float(after[k] / before[k]), *way) for way, after in then.items() if after[k] < WORTH * before[k]]
        part, joint, how = min(helpful) if helpful else (1.0, None, "")
        found.append(Weak(unknowns.names[k], float(relative[k]), joint, how, float(part * relative[k])))
    return tuple(found)


def _relative(task: DesignProblem, R: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(root_covariance(R, task.unknowns.precision), axis=1) / task.unknowns.scale)


def _possible(task: DesignProblem, joints: np.ndarray) -> Motion | None:
    """Compute the motion along joints (4, n, N); None where the robot cannot go there or bodies come too close."""
    try:
        motion = close(task.model, joints[0], joints[1], joints[2], None)
    except GtauError:
        return None
    clear = task.limits.clearance is None or task.limits.clearance.holds(motion.c)
    return motion if clear else None


def _alone(task: DesignProblem, middle: np.ndarray, j: int, span: float, speed: float) -> np.ndarray | None:
    """Factor of the information from joint j moving alone about the pose ``middle`` (n,); None where it cannot."""
    limits, every = task.limits, tuple(range(len(task.payloads)))
    low, high = limits.position[j] if np.isfinite(limits.position[j]).all() else middle[j] + np.array([-np.pi, np.pi])
    center = (low + high) / 2
    for _ in range(4):
        amplitude = span * (high - low) / 2
        omega = min(speed * limits.velocity[j] / amplitude, np.sqrt(speed * limits.acceleration[j] / amplitude))
        period = 2 * np.pi / omega
        samples = 8 * PER_HARMONIC
        time = period / samples * np.arange(samples)
        joints = np.zeros((4, len(middle), samples))
        joints[0] = middle[:, None]
        joints[0, j] = center + amplitude * np.sin(omega * time)
        joints[1, j] = amplitude * omega * np.cos(omega * time)
        joints[2, j] = -amplitude * omega**2 * np.sin(omega * time)
        motion = _possible(task, joints)
        if motion is None:
            span /= 2
            center = (center + middle[j]) / 2
            continue
        step = period / samples
        grid = Grid(time, step, np.empty((4, 0, 0)))
        alone = Point(task, grid, every, joints, motion, None, task.regressor(motion))
        # as long as a run: the rows of one cycle count for all of its cycles
        return information([alone]) * np.sqrt(task.series.period / period)
    return None
