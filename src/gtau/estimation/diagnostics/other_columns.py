"""Fit the data with columns read otherwise: torques reversed, or an angle that is measured from another link.

- Joints share the parameters of their links, so that one reversed torque contradicts the others. Each is reversed in
  turn, the best first, as long as that explains much more. All reversed together explain the same, with negative
  masses: the inertias of the robot's file decide between the two.
- A parallelogram holds the angle of a joint against the link before the preceding one, and its motor stands there:
  Fanuc, ABB and palletisers log ``J2 + J3`` as J3. The motor becomes a joint of its own, coupled to both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.effort import REVERSED_CHANNELS
from gtau.estimation.diagnostics.refits import described_otherwise, residual_ratio, unrefined
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import likeliest, ml_or_wls
from gtau.estimation.regression.dataset import System, reduce_runs
from gtau.estimation.regression.factors import SIGNALS
from gtau.findings import Finding
from gtau.findings.words import listed
from gtau.progress import Progress
from gtau.robots.robot import Coupling, Robot

REVERSED_LEFT = 0.7  # part of the residual variance, geometric mean of all joints, left with one torque reversed
TURNED_LEFT = 0.5  # part of the residual variance, geometric mean of all joints, left with an angle from another link

COLUMNS = "columns"


def reversed_torques(fit: Fit) -> EstimatedEffect | None:
    """Find the joints whose torques are reversed against the other joints; None where gains have their own signs."""
    if fit.free_gains:
        return None
    unaltered, joints = unrefined(fit), fit.system.problem.joints
    best, turned = unaltered, list[int]()
    while len(turned) < len(joints) // 2:
        tried = [(_reversed(best, j), j) for j in range(len(joints)) if j not in turned]
        other, j = min(tried, key=lambda pair: residual_ratio(pair[0], best))
        if residual_ratio(other, best) > REVERSED_LEFT:
            break
        best, turned = other, [*turned, j]
    if not turned:
        return None
    names = tuple(joints[j] for j in turned)
    advice = f"check the signs of the {fit.dataset.runs[0].kind} and position columns of {listed(names)}"
    remains = {"remains": residual_ratio(best, unaltered)}
    text = f"reversed torques of {listed(names)}"
    cause = Finding(REVERSED_CHANNELS, names, values=remains, text=text, advice=advice)
    return described_otherwise(fit, COLUMNS, cause, best, unaltered)


def _reversed(fit: Fit, joint: int) -> Fit:
    problem = fit.system.problem
    blocks = problem.blocks.copy()
    blocks[:, joint, :, SIGNALS] *= -1
    other = replace(problem, blocks=blocks)
    return replace(fit, system=replace(fit.system, problem=other), solution=fit.solve(other))


def angle_from_another_link(fit: Fit, progress: Progress) -> EstimatedEffect | None:
    """Find a joint whose angle is measured, and whose motor stands, as in a parallelogram."""
    unaltered, best, cause = unrefined(fit), fit, None
    remains = float(TURNED_LEFT)
    described = list(_with_parallelogram(fit.dataset.robot))
    for number, (joint, before, robot) in enumerate(described):
        progress("angles from other links", number, len(described))
        try:
            other = _fitted(fit, robot)
        except GtauError:
            continue
        if (ratio := residual_ratio(other, unaltered)) < remains:
            remains, best = ratio, other
            beside = fit.dataset.robot.joint(before).antecedent
            text = f"an angle of '{joint}' that is measured from '{beside}', as with a parallelogram,"
            advice = (
                "log the angle between the links, or describe the parallelogram in the robot file, as the catalog's "
                f"'palletiser' does: the motor '{joint}' turns beside '{before}', and a rod moves the link"
            )
            cause = Finding(COLUMNS, (joint,), values={"remains": ratio}, text=text, advice=advice)
    progress("angles from other links", len(described), len(described))
    return None if cause is None else described_otherwise(fit, COLUMNS, cause, best, unaltered)


def angle_of_parallelogram(system: System, progress: Progress) -> Finding | None:
    """Say which angle makes the iteration of the gains diverge, if one does."""
    try:
        angle = angle_from_another_link(fit_by(likeliest, system, free_gains=True), progress)
    except GtauError:
        return None
    return None if angle is None else angle.cause


def _with_parallelogram(robot: Robot) -> Iterator[tuple[str, str, Robot]]:
    """Describe the robot with each motor standing beside the motor before it, where their axes are parallel."""
    joints = {joint.name: joint for joint in robot.joints}
    for joint in robot.joints:
        before = joints.get(joint.antecedent)
        if before is None or not (joint.actuated and before.actuated and joint.turns and before.turns):
            continue
        along = float(np.array(before.axis) @ np.array(joint.placement.rotation) @ np.array(joint.axis))
        if robot.closures or robot.couplings or not np.isclose(abs(along), 1.0, rtol=0, atol=1e-6):
            continue
        link = replace(joint, name=f"{joint.name} link", actuated=False, parameters="inertial")
        motor = replace(before, name=joint.name, parameters="drive", limits=joint.limits, home=0.0)
        moved = dict.fromkeys((joint.name,), link.name)
        others = tuple(
            link if other is joint else replace(other, antecedent=moved.get(other.antecedent, other.antecedent))
            for other in robot.joints
        )
        place = robot.joints.index(joint)
        sign = 1.0 if along > 0 else -1.0
        coupling = Coupling(link.name, ((joint.name, sign), (before.name, -sign)))
        tool = moved.get(robot.tool, robot.tool)
        yield joint.name, before.name, replace(
            robot, joints=(*others[:place], motor, *others[place:]), couplings=(*robot.couplings, coupling),
            named_tool=tool,
        )  # fmt: skip


def _fitted(fit: Fit, robot: Robot) -> Fit:
    """Fit the same runs with another robot; raises GtauError where it cannot follow them."""
    dataset = reduce_runs(robot, fit.dataset.runs, fit.dataset.preparation)
    gains = None if fit.free_gains else fit.gains
    system = dataset.system(per_run=len(dataset.runs) > 1)
    return fit_by(ml_or_wls(gains), system, fit.free_gains)
