"""Sources of the scale of the drive gains: payloads, sensors, wrenches or known parameters (section 3.3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.factors import KNOWN, MODEL, SIGNAL
from gtau.estimation.regression.problem import Problem
from gtau.model.base_parameters import independent_columns
from gtau.robots.robot import Robot
from gtau.signals.reading.statements import Payload

OWN_BODY = 0.1  # share of the torque of measured wrenches that no parameter explains: below, a tool may cause it
ANSWERED = 0.1  # share of the squares of the rest to which the currents answer: below, the rest is noise


def require_scale(robot: Robot, system: System, payloads: Sequence[Payload | None], method: str) -> None:
    """Check that something fixes the scale of a ``robot``'s drive gains (section 3.3); raises GtauError."""
    problem = system.problem
    other = "or use --method wls with prior_gains"
    elsewhere, weighed = problem.scaled, any(payload is not None and payload.mass is not None for payload in payloads)
    if not elsewhere and not weighed and system.stated:
        raise _hidden(system.stated, other)
    if not elsewhere and not weighed:
        raise GtauError(
            f"method '{method}' needs a scale to find the drive gains, and no run has a payload of known mass; "
            "add 'payload: {name: ..., mass: ...}' to a loaded run (--payload LOG=KG with logs), torque sensors "
            "('joint_torque' under 'signals'), or known parameters ('priors', or 'prior_inertias' for the inertias "
            f"of the robot's file), {other}."
        )
    if not elsewhere and len({None if payload is None else payload.name for payload in payloads}) < 2:
        raise GtauError(
            f"method '{method}' needs runs with two different loads to find the drive gains, and all runs carry "
            "the same payload; "
            f"add a run without payload, {other}."
        )
    if problem.wrenches and problem.unknown_gains.all() and not (len(problem.known) or weighed):
        by_own_columns, answered = unexplained_wrench_share(problem)
        if by_own_columns < OWN_BODY and answered < ANSWERED:
            raise GtauError(_always_carried(problem.wrenches, other))
    if len(problem.parameters) in independent_columns(_with_scale(problem))[0]:
        return
    raise _without_effect(robot, system, other)


def _without_effect(robot: Robot, system: System, other: str) -> GtauError:
    problem = system.problem
    if problem.sensor_channels:
        sensors = [problem.channels[k] for k in problem.sensor_channels]
        named = " and the ".join(
            f"{kind.group} of {', '.join(sensor.joint for sensor in sensors if sensor.kind == kind)}"
            for kind in dict.fromkeys(sensor.kind for sensor in sensors)
        )
        return GtauError(
            f"the {named} measure no load that the motors carry too, so they "
            "cannot give the scale of the drive gains; add sensors of other joints, runs that move them against "
            f"gravity, {other}."
        )
    if len(problem.known):
        return _hidden(system.stated, other)
    if problem.wrenches:
        return GtauError(
            f"the wrenches on {', '.join(problem.wrenches)} have no effect of their own on any actuated joint, so they "
            "cannot give the scale of the drive gains; check their columns, their 'body' and 'at' under 'signals', "
            f"carry a payload of known mass in some runs, {other}."
        )
    if robot.floating:
        return GtauError(
            f"the wrench on the base '{robot.floating}' has no effect of its own on the motors, so it cannot give the "
            "scale of the drive gains; check its columns and 'at' under 'base' of 'signals', carry a payload of known "
            f"mass in some runs, {other}."
        )
    on = f"'{robot.tool}'" + ("" if robot.named_tool else ", which was assumed")
    return GtauError(
        f"the payload's known parameters have no effect of their own on any actuated joint where it sits, on {on}, "
        "so they cannot give the scale of the drive gains; check 'tool' in the robot file, give more known "
        f"'parameters' of the payload, {other}."
    )


def _hidden(stated: Sequence[str], other: str) -> GtauError:
    names = ", ".join(stated[:4]) + (" and others" if len(stated) > 4 else "")
    return GtauError(
        f"the known parameters under 'priors' ({names}) cannot give the scale of the drive gains, as they act on "
        "the motors only together with unknown ones; give priors for all parameters of the same sums (gtau robot "
        f"--verbose lists them), or for the base parameter, {other}."
    )


def unexplained_wrench_share(problem: Problem) -> tuple[float, float]:
    """Compute the share of the torque of wrenches that no parameter explains, and the share of that in the currents.

    The wrench of a tool carried in all runs is explained by unknown inertia of the body. The remainder is then noise,
    without an effect on the currents; for another load the currents contain the whole wrench torque over the gain. The
    second is a share of squares; both are of rows weighted by each joint's noise, and of a base that is fixed.
    """
    n, joints, rows = len(problem.parameters), len(problem.joints), []
    for j, (R, sigma) in enumerate(zip(problem.triangles, problem.own_sigma, strict=True)):
        currents = np.zeros((len(R), joints))
        currents[:, j] = R[:, SIGNAL]
        rows.append(np.column_stack([R[:, MODEL], currents, R[:, KNOWN]]) / sigma)
    stacked = np.concatenate(rows)
    columns, torque = stacked[:, :-1] / np.maximum(np.linalg.norm(stacked[:, :-1], axis=0), 1e-300), stacked[:, -1]
    unexplained, unanswered = (
        float(np.linalg.norm(torque - W @ np.linalg.lstsq(W, torque, rcond=None)[0])) for W in (columns[:, :n], columns)
    )
    share = unexplained / (float(np.linalg.norm(torque)) or 1.0)
    return share, 1 - (unanswered / (unexplained or 1.0)) ** 2


def _always_carried(bodies: Sequence[str], other: str) -> str:
    several = len(bodies) > 1
    return (
        f"the wrench{'es' * several} on {', '.join(bodies)} {'move' if several else 'moves'} as one of the robot's own "
        f"bodies in every run, so that {'they give' if several else 'it gives'} no scale; add a run without the tool, "
        f"or with another, {other}."
    )


def _with_scale(problem: Problem) -> np.ndarray:
    """Stack weighted rows ``[W_theta | known]``, of sensors with the torque that their own columns explain."""
    rows = []
    for j, (R, kept, sigma) in enumerate(zip(problem.triangles, problem.own_columns, problem.own_sigma, strict=True)):
        known = R[:, KNOWN]
        if not problem.unknown_gains[j]:
            torque, columns = R[:, SIGNAL], R[:, kept]
            known = known - columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]
        rows.append(np.column_stack([R[:, MODEL], known]) / sigma)
    return np.concatenate([*rows, problem.known * np.append(np.ones(len(problem.parameters)), -1.0)])
