"""Assemble the estimation problem from the factors of all runs: payloads and identifiable columns (eqs. 29 to 33)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.base_parameters import BaseParameters, independent_columns
from gtau.estimation.regression.factors import CURRENTS, EXTRA, PUSH, Factors
from gtau.estimation.regression.friction import DRIFTING, TEMPERATURE_TERMS, TERMS, Friction, transmitted
from gtau.estimation.regression.known_parameters import known_equations
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.torque_sensors import joint_behind, of_drive, sensor_name
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import INERTIAL, Robot
from gtau.signals.experiment import Prior
from gtau.signals.payload import Payload

FEWEST_ROWS = 50  # of a joint, in all runs together
EXACT = 1e-6  # relative standard deviation of what counts as exact: of 1e6 rows without signal it stands against all


@dataclass(frozen=True, eq=False)
class CarriedPayload:
    """The payload of one run.

    ``unknown`` maps the name in the problem of each unknown parameter that acts on some actuated joint
    to its kind, and ``regroupings`` the kind to the formula of what it stands for: ``sums`` (unknown, free)
    of the kinds ``free`` that are not known. In base columns, a unit of each is ``unknown_columns``
    (n_b, unknown), and all that is known together ``known_column`` (n_b,).
    """

    run: int
    payload: Payload
    unknown: Mapping[str, str]
    regroupings: Mapping[str, str]
    free: tuple[str, ...]
    sums: np.ndarray
    unknown_columns: np.ndarray
    known_column: np.ndarray


@dataclass(frozen=True, eq=False)
class System:
    """The problem, and what its parameters are.

    ``unexcited`` are base parameters that these motions cannot separate from those before them; they are
    not part of the problem, but of ``whole``. ``block_positions`` (U, 2) say where the problem's units stand: the
    number of the run, and the time from its beginning (0) to its end (1). ``maps`` (runs, c, p, n_theta + 4) lead
    from the columns of the runs' factors to those of ``whole``, at the mean temperatures of each run. ``stated`` are
    the parameters with a prior value. ``warmth`` (c, p, n_theta + 4) is what is added to the maps for each degree.
    ``pushes`` (U, c, p) are the rows of what measured wrenches add to the motors' torques; None without wrenches.
    """

    problem: Problem
    whole: Problem
    base: BaseParameters
    payloads: tuple[CarriedPayload, ...]
    unexcited: tuple[str, ...]
    friction: Friction
    block_positions: np.ndarray
    maps: np.ndarray
    stated: tuple[str, ...] = ()
    warmth: np.ndarray | None = None
    pushes: np.ndarray | None = None

    def motion(self, run: int, theta: np.ndarray) -> np.ndarray:
        """Return the base columns' values in ``run``, with its payload and its own friction, (n_b,)."""
        values = dict(zip(self.problem.parameters, theta, strict=True))
        last = len(self.maps) - 1
        chi = np.array([values.get(name, 0.0) for name in self.base.names])
        for k, name in enumerate(self.base.names):
            drifts = [values.get(drift_name(name, other), 0.0) for other in range(last)]
            chi[k] += drifts[run] if run < last else -sum(drifts)
        for j, joint in enumerate(self.whole.joints):
            for term, kind in TEMPERATURE_TERMS.items():
                if value := values.get(f"{term}_{joint}"):
                    k, column = self.base.standard.index(f"{kind}_{joint}"), f"{term}_{joint}"
                    chi[k] += value * self.maps[run, j, k, self.whole.parameters.index(column)]
        return chi + self._payload(run, values)

    def load(self, run: int, theta: np.ndarray) -> np.ndarray:
        """Return the base columns' values in ``run`` that joints transmit: with payload, without friction, (n_b,)."""
        values = dict(zip(self.problem.parameters, theta, strict=True))
        chi = np.array([values.get(name, 0.0) for name in self.base.names]) * transmitted(self.base.names)
        return chi + self._payload(run, values)

    def _payload(self, run: int, values: Mapping[str, float]) -> np.ndarray:
        """Return the values that the payload of ``run`` adds to the base columns, (n_b,)."""
        of_run = [carried for carried in self.payloads if carried.run == run]
        return sum(
            (
                each.unknown_columns @ [values.get(name, 0.0) for name in each.unknown] + each.known_column
                for each in of_run
            ),
            np.zeros(self.base.count),
        )


def known_values(payload: Payload) -> dict[str, float]:
    """Return the known inertial parameters of a payload, by kind; empty for an unknown payload."""
    mass = {} if payload.mass is None else {"m": payload.mass}
    return {**mass, **payload.parameters}


def assemble_system(
    idm: InverseDynamics,
    base: BaseParameters,
    factors: Sequence[Factors],
    payloads: Sequence[Payload | None],
    slowest: float,
    friction: Friction,
    sensors: Sequence[str] = (),
    priors: Mapping[str, Prior] | None = None,
    temperatures: Sequence[np.ndarray] | None = None,
    pushed: Sequence[str] = (),
) -> System:
    """Stack the factors of unloaded and loaded runs into one problem (eqs. 29 to 33).

    A payload is a further body on the robot's tool (eq. 18), so its columns are
    combinations of the base columns, and each run's factor becomes a block of the problem by one
    product with a small matrix.

    Parameters
    ----------
    idm, base : InverseDynamics, BaseParameters
        Model and base parameters, whose columns the factors have.
    factors, payloads : sequences
        One entry a run; None for a run without payload.
    slowest : float
        Longest delay that can be described, s; 0 for none.
    friction : Friction
        Terms to take, and whether friction may drift between runs.
    sensors : sequence of str
        Joints with a torque sensor, whose factors follow those of the joints.
    priors : mapping, optional
        What is known of parameters, by name.
    temperatures : sequence of ndarray, optional
        Deviations (stretches, n) of the joints' temperatures from their means, for each run.
    pushed : sequence of str
        Bodies on which measured wrenches act.

    Raises
    ------
    GtauError
        Where some joint has no usable row in any run, or a prior names no parameter.
    """
    carried = tuple(_carried(idm, base, run, payload) for run, payload in enumerate(payloads) if payload is not None)
    drifting = [
        k
        for k, name in enumerate(base.names)
        if name in {f"{kind}_{joint}" for kind in DRIFTING for joint in idm.actuated}
    ]
    last = len(factors) - 1
    drifts = [drift_name(base.names[k], run) for run in range(last) for k in drifting] if friction.per_run else []
    offsets = [f"off_{sensor_name(joint)}" for joint in sensors]
    names = [*base.names, *(name for each in carried for name in each.unknown), *drifts, *friction.terms, *offsets]
    position = {name: k for k, name in enumerate(names)}
    n_b, n_theta = base.count, len(names)
    blocks, maps = [], []

    def warmth(joint: str) -> np.ndarray:
        """Map a joint's friction columns to those of the problem for friction per degree, (p, n_theta + 4)."""
        E = np.zeros((n_b + EXTRA, n_theta + 1 + CURRENTS))
        for term, kind in TEMPERATURE_TERMS.items():
            if f"{term}_{joint}" in position:
                E[base.standard.index(f"{kind}_{joint}"), position[f"{term}_{joint}"]] = 1.0
        return E

    for run, factor in enumerate(factors):
        # from the columns of the factor to those of the problem
        M = np.zeros((n_b + EXTRA, n_theta + 1 + CURRENTS))
        M[:n_b, :n_b] = np.eye(n_b)
        M[-CURRENTS - PUSH, n_theta] = -1.0  # torques that the motors need not give
        M[-CURRENTS:, n_theta + 1 :] = np.eye(CURRENTS)
        for each in carried:
            if each.run == run:
                M[:n_b, [position[name] for name in each.unknown]] = each.unknown_columns
                M[:n_b, n_theta] = each.known_column
        for k in drifting if drifts else ():
            # a run's difference from the mean friction; those of all runs add up to zero
            for other in range(last):
                M[k, position[drift_name(base.names[k], other)]] = (other == run) - (run == last)
        of_joints = []
        for joint in idm.actuated:
            M_j = M.copy()
            for t, term in enumerate(TERMS):
                if f"{term}_{joint}" in position:
                    M_j[n_b + t, position[f"{term}_{joint}"]] = 1.0
            of_joints.append(M_j)
        for joint in sensors:
            M_j = M.copy()
            for k, name in enumerate(base.standard):
                if of_drive(name, joint):  # its column, without its value, is that of what the sensor has of its own
                    M_j[k] = 0.0
                    own = f"{name.split('_', 1)[0]}_{sensor_name(joint)}"
                    if own in position:
                        M_j[k, position[own]] = 1.0
            of_joints.append(M_j)
        parts = [factor.R[:, j] @ M_j for j, M_j in enumerate(of_joints)]
        for j, joint in enumerate(idm.actuated if temperatures is not None else ()):
            of_run = temperatures[run][:, j]  # type: ignore[index]
            parts[j] = parts[j] + of_run[:, None, None] * (factor.R[:, j] @ warmth(joint))
            of_joints[j] = of_joints[j] + of_run.mean() * warmth(joint)
        maps.append(of_joints)
        blocks.append(np.stack(parts, axis=1))
    rows = np.concatenate([factor.rows for factor in factors])
    filled = rows.sum(axis=1) > 0
    block_positions = np.array(
        [(run, (s + 0.5) / len(each.rows)) for run, each in enumerate(factors) for s in range(len(each.rows))]
    )
    priors = _in_flight(idm, base, factors, priors or {})
    known = known_equations(base, idm.parameter_names, names, priors)
    problem = Problem(
        tuple(names),
        idm.actuated,
        np.concatenate(blocks)[filled],
        rows[filled],
        slowest,
        tuple(sensors),
        known,
        idm.robot.base,
        tuple(pushed),
    )
    for channel, count in zip(problem.channels, problem.total_rows, strict=True):
        if count < FEWEST_ROWS:
            joint = joint_behind(channel, idm.robot)
            raise GtauError(
                f"joint '{joint}' has {count} usable rows in all runs together, away from its reversals and gaps; "
                "add runs in which it moves, or longer ones."
            )
    unexcited = _unexcited(problem)
    stated = tuple(name for name, prior in priors.items() if prior.value is not None)
    return System(
        problem.without(unexcited),
        problem,
        base,
        carried,
        unexcited,
        friction,
        block_positions[filled],
        np.array(maps),
        stated,
        None if temperatures is None else np.array([warmth(channel) for channel in problem.channels]),
        np.concatenate([factor.R[..., -CURRENTS - PUSH] for factor in factors])[filled] if pushed else None,
    )


def _in_flight(
    idm: InverseDynamics, base: BaseParameters, factors: Sequence[Factors], priors: Mapping[str, Prior]
) -> Mapping[str, Prior]:
    """Take the mass of a robot for exact where nothing acts on its floating base in any run.

    The base equations are homogeneous then: parameters that all are too small leave less of the noise in the motion.
    Against that a mass stated to a per mil would not stand; how much it may be wrong is part of
    :func:`gtau.estimation.estimators.scale_uncertainty.scale_uncertainty`.

    Raises
    ------
    GtauError
        The mass is not among the ``priors``.
    """
    rows = [idm.actuated.index(joint) for joint in idm.robot.base]
    if not rows or any(factor.R[:, rows, :, -CURRENTS].any() for factor in factors):
        return priors
    name = whole_mass(base, idm.parameter_names)
    prior = priors.get(name)
    if prior is None or not prior.value:
        raise GtauError(
            f"nothing that is measured acts on the base '{idm.robot.floating}' in any run, so that its equations give "
            "ratios of parameters alone, which noise of its motion biases towards zero; log the wrench that holds it "
            "in some runs ('wrenches' of 'base' under 'signals')"
            + (f", or weigh the robot (priors: {{{name}: {{value: ..., std: ...}}}}, kg)." if name else ".")
        )
    return {**priors, name: prior.model_copy(update={"std": EXACT * abs(prior.value)})}


def whole_mass(base: BaseParameters, standard: Sequence[str]) -> str:
    """Return the name of the base parameter that is the mass of all bodies of a floating robot."""
    masses = np.array([name.startswith("m_") for name in standard], dtype=float)
    found = (name for name, row in zip(base.names, base.matrix, strict=True) if np.allclose(row, masses, atol=1e-6))
    return next(found, "")


def drift_name(name: str, run: int) -> str:
    """Name the difference of a friction parameter from its mean, in a run."""
    return f"{name}@{run + 1}"


def _carried(idm: InverseDynamics, base: BaseParameters, run: int, payload: Payload) -> CarriedPayload:
    column = {name: k for k, name in enumerate(idm.parameter_names)}
    values = known_values(payload)
    free = [kind for kind in INERTIAL if kind not in values]
    columns = base.matrix[:, [column[f"{kind}_{idm.robot.tool}"] for kind in free]]
    kept, coefficients, _ = independent_columns(columns)
    known = base.matrix[:, [column[f"{kind}_{idm.robot.tool}"] for kind in values]] @ np.array(list(values.values()))
    formulas = {
        free[k]: " + ".join(
            f"{coefficients[row, other]:.5g} {kind}" if other != k else kind
            for other, kind in enumerate(free)
            if coefficients[row, other]
        )
        for row, k in enumerate(kept)
    }
    unknown = {f"{free[k]}_L{run + 1}": free[k] for k in kept}
    return CarriedPayload(run, payload, unknown, formulas, tuple(free), coefficients, columns[:, kept], known)


def _unexcited(problem: Problem) -> tuple[str, ...]:
    stacked = np.concatenate(
        [
            *(R[:, : problem.n_theta] / sigma for R, sigma in zip(problem.triangles, problem.own_sigma, strict=True)),
            problem.known[:, :-1],
        ]
    )
    kept, _, _ = independent_columns(stacked)
    return tuple(name for k, name in enumerate(problem.parameters) if k not in kept)


def require_scale(robot: Robot, system: System, payloads: Sequence[Payload | None], method: str) -> None:
    """Check that something fixes the scale of the drive gains of a ``robot`` (section 3.3).

    A payload of known mass in some runs, torque sensors, or known parameters.

    Raises
    ------
    GtauError
        Without any of them, with one payload in all runs, or where what is known acts on no joint in a way of its own.
    """
    problem = system.problem
    other = "or use --method wls with prior_gains"
    elsewhere, weighed = problem.scaled, any(payload is not None and payload.mass is not None for payload in payloads)
    if not elsewhere and not weighed and system.stated:
        raise _hidden(system.stated, other)
    if not elsewhere and not weighed:
        raise GtauError(
            f"method '{method}' needs a scale to find the drive gains, and no run has a payload of known mass; "
            "add 'payload: {name: ..., mass: ...}' to a loaded run, torque sensors ('joint_torque' under 'signals'), "
            f"or known parameters ('priors'), {other}."
        )
    if not elsewhere and len({None if payload is None else payload.name for payload in payloads}) < 2:
        raise GtauError(
            f"method '{method}' needs runs with two different loads to find the drive gains, and all runs carry "
            "the same payload; "
            f"add a run without payload, {other}."
        )
    if problem.n_theta in independent_columns(_with_scale(problem))[0]:
        return
    if problem.sensors:
        raise GtauError(
            f"the torque sensors of {', '.join(problem.sensors)} measure no load that the motors carry too, so they "
            "cannot give the scale of the drive gains; add sensors of other joints, runs that move them against "
            f"gravity, {other}."
        )
    if len(problem.known):
        raise _hidden(system.stated, other)
    if problem.pushed:
        raise GtauError(
            f"the wrenches on {', '.join(problem.pushed)} have no effect of their own on any actuated joint, so they "
            "cannot give the scale of the drive gains; check their columns, their 'body' and 'at' under 'signals', "
            f"carry a payload of known mass in some runs, {other}."
        )
    if problem.driveless:
        raise GtauError(
            f"nothing measured acts on the base '{robot.floating}' from outside, or it has no effect of its own "
            "on the motors, so the scale of the drive gains is open; log the wrench that holds the base ('base' under "
            f"'signals'), carry a payload of known mass in some runs, {other}."
        )
    on = f"'{robot.tool}'" + ("" if robot.named_tool else ", which was assumed")
    raise GtauError(
        f"the payload's known parameters have no effect of their own on any actuated joint where it sits, on {on}, "
        "so they cannot give the scale of the drive gains; check 'tool' in the robot file, give more known "
        f"'parameters' of the payload, {other}."
    )


def _hidden(stated: Sequence[str], other: str) -> GtauError:
    names = ", ".join(stated[:4]) + (" and others" if len(stated) > 4 else "")
    return GtauError(
        f"the known parameters under 'priors' ({names}) cannot give the scale of the drive gains, as they act on "
        "the motors only together with unknown ones; give priors for all parameters of the same sums (gtau robot lists "
        f"them), or for the base parameter, {other}."
    )


def _with_scale(problem: Problem) -> np.ndarray:
    """Stack weighted rows ``[W_theta | known]``, of sensors with the torque that their own columns explain."""
    n, rows = problem.n_theta, []
    for j, (R, own, sigma) in enumerate(zip(problem.triangles, problem.own_columns, problem.own_sigma, strict=True)):
        known = R[:, n]
        if not problem.free[j]:
            torque, columns = R[:, n + 1], R[:, own]
            known = known - columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]
        rows.append(np.column_stack([R[:, :n], known]) / sigma)
    return np.concatenate([*rows, problem.known * np.append(np.ones(n), -1.0)])
