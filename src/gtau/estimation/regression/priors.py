"""Known parameters as equations, and the sources of the scale of the drive gains (section 3.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components

from gtau.errors import GtauError, meant
from gtau.estimation.regression.factors import KNOWN, MODEL, SIGNAL
from gtau.estimation.regression.problem import Problem
from gtau.model.base_parameters import BaseParameters, independent_columns
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import Parameter, parameter_of
from gtau.robots.robot import INERTIAL, PLAIN_FRICTION, Robot
from gtau.signals.reading.statements import Payload, Prior

RANK = 1e-9  # of the largest singular value: below it a combination is free of unknown parameters
ROUNDING = 1e-12  # of the size of what is summed, such as a body's parameter: less is rounding
LEAST = 1e-9  # of the largest eigenvalue of the correlations: smaller ones are rounding
OWN_BODY = 0.1  # share of the torque of measured wrenches that no parameter explains: below, a tool may cause it
ANSWERED = 0.1  # share of the squares of the rest to which the currents answer: below, the rest is noise


@dataclass(frozen=True, eq=False)
class ReferenceModel:
    """Parameters known from elsewhere: ``values`` (k,) of ``names`` with their ``covariance`` (k, k)."""

    names: tuple[Parameter, ...]
    values: np.ndarray
    covariance: np.ndarray

    def among(self, parameters: Sequence[Parameter]) -> np.ndarray:
        """Write those among ``parameters`` (n,) as equations ``[P | y]`` (k, n + 1) with errors of unit variance."""
        places = {name: place for place, name in enumerate(parameters)}
        at = [k for k, name in enumerate(self.names) if name in places]
        std = np.sqrt(np.diag(self.covariance)[at])
        sizes, vectors = np.linalg.eigh(self.covariance[np.ix_(at, at)] / np.outer(std, std))
        whitened = (vectors / np.sqrt(np.maximum(sizes, LEAST * sizes.max(initial=0.0)))).T / std
        rows = np.zeros((len(at), len(parameters) + 1))
        rows[:, [places[self.names[k]] for k in at]] = whitened
        rows[:, -1] = whitened @ self.values[at]
        return rows


def stated_inertias(robot: Robot) -> dict[str, float]:
    """Return the file's parameters of bodies and motors by name; other bodies of such a file have no mass."""
    stated = dict(robot.inertias)
    if not stated:
        return {}
    inertial = [Parameter(kind, body) for body in _heavy(robot) for kind in INERTIAL]
    rotors = {Parameter("ia", joint.name) for joint in robot.joints if joint.parameters in ("all", "drive")}
    inertias: dict[str, float] = {name: stated.get(name, 0.0) for name in inertial}
    for body in _heavy(robot):
        sizes = {Parameter(kind, body): size for kind, size in (sizes_of(inertias, body) or {}).items()}
        inertias |= {name: 0.0 for name, size in sizes.items() if abs(inertias[name]) < ROUNDING * size}
    return inertias | {name: value for name, value in stated.items() if name in rotors}


def sizes_of(stated: dict[str, float], body: str) -> dict[str, float] | None:
    """Return the size of each inertial parameter of a body (a change of 100 %), by kind: m, m r and m r^2.

    The radius r is the root mean square distance of its mass from the frame's origin, ``m r^2 = tr(I) / 2``: so a
    centre of mass that the file puts at the origin may move too. None for a body without mass or extent.
    """
    mass = stated[Parameter("m", body)]
    second = sum(stated[Parameter(kind, body)] for kind in ("xx", "yy", "zz")) / 2
    if mass <= 0 or second <= 0:
        return None
    return {
        kind: mass if kind == "m" else second if len(kind) == 2 and kind[0] != "m" else np.sqrt(mass * second)
        for kind in INERTIAL
    }


def inertia_priors(robot: Robot, std: float) -> dict[str, Prior]:
    """Take the file's inertias as priors with a relative standard deviation, each parameter by its own.

    ``std`` is a share of m, m r and m r^2 of each body (see :func:`sizes_of`), and of the rotor inertias. Raises
    GtauError where the file states no inertias, or the share is not positive.
    """
    if not 0 < std < np.inf:
        raise GtauError(f"a relative standard deviation of {std:g} is impossible for inertias; write 0.3 for 30 %.")
    stated = stated_inertias(robot)
    if not stated:
        where = f" ({robot.source})" if robot.source else ""
        raise GtauError(
            f"the file of robot '{robot.name}'{where} states no inertias, which 'prior_inertias' asks for, or gtau "
            "saved the robot without them; give a URDF or MJCF file with <inertial> elements, or leave it out."
        )
    sizes: dict[str, float] = {}
    for body in _heavy(robot):
        sizes |= {Parameter(kind, body): size for kind, size in (sizes_of(stated, body) or {}).items()}
    sizes |= {name: value for name, value in stated.items() if parameter_of(name).kind == "ia" and value > 0}
    return {name: Prior(value=stated[name], std=std * size) for name, size in sizes.items()}


def file_sums(model: InverseDynamics, base: BaseParameters) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sum the inertias of the robot's file to base parameters, (n_b,), zero where these regroup none, with two masks.

    The first of base parameters that regroup inertias alone, the second of the ones among them that regroup a rotor
    inertia which the file does not state.
    """
    names = model.parameter_names
    stated = stated_inertias(model.robot)
    regrouped = base.matrix != 0
    regroups_inertia = regrouped[:, [name.kind in (*INERTIAL, "ia") for name in names]].any(axis=1)
    regroups_friction = regrouped[:, [name.kind in PLAIN_FRICTION for name in names]].any(axis=1)
    unstated = regrouped[:, [name.kind == "ia" and name not in stated for name in names]].any(axis=1)
    inertial = regroups_inertia & ~regroups_friction
    values = base.matrix @ [stated.get(name, 0.0) for name in names]
    return np.where(inertial, values, 0.0), inertial, inertial & unstated


def scale_of_file(model: InverseDynamics, base: BaseParameters, problem: Problem, std: float) -> np.ndarray:
    """Write an equation (k, n_theta + 1) for each scale: on the whole the torques agree with the file's inertias.

    ``<tau_file, tau(theta)> = <tau_file, tau_file>`` over the rows of all joints that share parameters, forces times
    the robot's length, with relative standard deviation ``std``: errors of a file's masses are alike in all bodies, so
    that they do not average out (docs/evidence/index.md). With a prior for each parameter instead,
    gains near zero fit best where file and data differ.
    """
    values, inertial, unstated = file_sums(model, base)
    theta = np.zeros(len(problem.parameters))
    stated = np.append(inertial & ~unstated, np.zeros(len(theta) - base.count, dtype=bool))
    theta[stated] = values[stated[: base.count]]
    motors = [k for k, channel in enumerate(problem.channels) if channel.kind.unknown_gain]
    turns = [model.robot.joint(problem.channels[k].joint).turns for k in motors]
    levers = np.where(turns, 1.0, float(model.layout.length))
    W = [problem.triangles[k][:, MODEL] * stated * lever for k, lever in zip(motors, levers, strict=True)]
    shared = np.array([np.any(rows != 0, axis=0) for rows in W]).astype(int)
    count, numbers = connected_components(shared @ shared.T, directed=False)
    equations = []
    for group in range(count):
        A = np.concatenate([rows for rows, number in zip(W, numbers, strict=True) if number == group])
        size = float(np.sum(np.square(A @ theta)))
        if size > 0:
            equations.append(np.append(A @ theta @ A / size, 1.0) / std)
    return np.reshape(equations, (-1, len(theta) + 1))


def _heavy(robot: Robot) -> list[str]:
    return [joint.name for joint in robot.joints if joint.has_mass] + [body.name for body in robot.platforms]


def known_equations(
    base: BaseParameters, standard: Sequence[str], parameters: Sequence[str], priors: Mapping[str, Prior]
) -> np.ndarray:
    """Write normal priors as equations ``[P | y]`` (k, n_theta + 1) for ``P theta = y`` with errors of unit variance.

    A base parameter is a sum of ``standard`` ones, the columns of ``base.matrix``: ``chi = S x``. Some of these have
    priors, with standard deviations, the others have none: so the equations hold for base-parameter combinations
    free of the latter. ``parameters`` are theta, the base parameters first; bounds are not used here. Raises GtauError
    where a prior names no parameter.
    """
    named = theta_equations(base, standard, parameters, priors)
    stated = {name: prior for name, prior in priors.items() if name in standard and prior.value is not None}
    known = np.array([name in stated for name in standard])
    if not known.any():
        return named
    values = np.array([stated[name].value for name in standard if name in stated], dtype=float)
    spread = np.array([stated[name].std for name in standard if name in stated], dtype=float)
    U = base.matrix[:, ~known & base.matrix.any(axis=0)]
    vectors, sizes, _ = np.linalg.svd(U / np.linalg.norm(U, axis=0))
    P = vectors[:, int(np.count_nonzero(sizes > RANK * sizes.max(initial=0.0))) :].T  # P U = 0
    S = P @ base.matrix[:, known]  # P chi = S x of the known x
    L = np.linalg.cholesky((S * spread) @ (S * spread).T) if len(P) else np.zeros((0, 0))
    rows = np.zeros((len(P), named.shape[1]))
    rows[:, : base.count] = np.linalg.solve(L, P)
    rows[:, -1] = np.linalg.solve(L, S @ values)
    return np.vstack([rows, named])


def theta_equations(
    base: BaseParameters, standard: Sequence[str], parameters: Sequence[str], priors: Mapping[str, Prior]
) -> np.ndarray:
    """Build the equations of priors that name one of theta, no standard parameter; see :func:`known_equations`."""
    rows = []
    for name, prior in priors.items():
        if name in standard:
            continue
        if name not in parameters:
            hint = meant(name, [*standard, *base.names], f"write kind and joint, such as '{standard[0]}'.")
            raise GtauError(f"'priors' names '{name}', which is no parameter of the robot; {hint}")
        if prior.value is not None and prior.std is not None:
            row = np.zeros(len(parameters) + 1)
            row[list(parameters).index(name)] = 1 / prior.std
            row[-1] = prior.value / prior.std
            rows.append(row)
    return np.reshape(rows, (-1, len(parameters) + 1))


def require_scale(
    robot: Robot, problem: Problem, stated: Sequence[str], payloads: Sequence[Payload | None], method: str
) -> None:
    """Check that something fixes the scale of a ``robot``'s drive gains (section 3.3); raises GtauError.

    It may be a payload of known mass, torque sensors, wrenches, parameters that are ``stated``, or voltages.
    """
    if len(problem.voltages):
        return
    other = "or use --method wls with prior_gains"
    elsewhere = problem.scaled
    weighed = any(payload is not None and payload.mass is not None for payload in payloads)
    if not elsewhere and not weighed and stated:
        raise _hidden(stated, other)
    if not elsewhere and not weighed:
        raise GtauError(
            f"method '{method}' needs a scale to find the drive gains, and no run has a payload of known mass; "
            "add 'payload: {name: ..., mass: ...}' to a loaded run (--payload LOG=KG with logs), torque sensors "
            "('joint_torque' under 'signals'), voltages ('voltage' or 'duty' there), or known parameters ('priors', or "
            f"'prior_inertias' for the inertias of the robot's file), {other}."
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
            several = len(problem.wrenches) > 1
            raise GtauError(
                f"the wrench{'es' * several} on {', '.join(problem.wrenches)} {'move' if several else 'moves'} as one "
                f"of the robot's own bodies in every run, so that {'they give' if several else 'it gives'} no scale; "
                f"add a run without the tool, or with another, {other}."
            )
    if len(problem.parameters) in independent_columns(_with_scale(problem))[0]:
        return
    raise _without_effect(robot, problem, stated, other)


def _without_effect(robot: Robot, problem: Problem, stated: Sequence[str], other: str) -> GtauError:
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
        return _hidden(stated, other)
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
    columns = stacked[:, :-1] / np.maximum(np.linalg.norm(stacked[:, :-1], axis=0), 1e-300)
    torque = stacked[:, -1]
    rests = (torque - W @ np.linalg.lstsq(W, torque, rcond=None)[0] for W in (columns[:, :n], columns))
    unexplained, unanswered = (float(np.linalg.norm(rest)) for rest in rests)
    share = unexplained / (float(np.linalg.norm(torque)) or 1.0)
    return share, 1 - (unanswered / (unexplained or 1.0)) ** 2


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
