"""Assemble the estimation problem from the factors of all runs: payloads and identifiable columns (eqs. 29 to 33)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.carried_payload import CarriedPayload, carried_payload
from gtau.estimation.regression.column_maps import ColumnMaps, drift_name
from gtau.estimation.regression.factors import CURRENTS, PUSH, Factors
from gtau.estimation.regression.flight import with_exact_mass
from gtau.estimation.regression.friction import TEMPERATURE_TERMS, Friction, transmitted
from gtau.estimation.regression.known_parameters import known_equations
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.torque_sensors import joint_behind
from gtau.model.base_parameters import BaseParameters, independent_columns
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Robot
from gtau.signals.experiment import Prior
from gtau.signals.payload import Payload

FEWEST_ROWS = 50  # of a joint, in all runs together


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
    carried = tuple(
        carried_payload(idm, base, run, payload) for run, payload in enumerate(payloads) if payload is not None
    )
    columns = ColumnMaps(base, idm.actuated, tuple(sensors), carried, friction, len(factors))
    blocks, maps = [], []
    for run, factor in enumerate(factors):
        of_channels = columns.of_run(run)
        parts = [factor.R[:, j] @ M for j, M in enumerate(of_channels)]
        for j, joint in enumerate(idm.actuated if temperatures is not None else ()):
            of_run, warmth = temperatures[run][:, j], columns.warmth(joint)  # type: ignore[index]
            parts[j] = parts[j] + of_run[:, None, None] * (factor.R[:, j] @ warmth)
            of_channels[j] = of_channels[j] + of_run.mean() * warmth
        maps.append(of_channels)
        blocks.append(np.stack(parts, axis=1))
    rows = np.concatenate([factor.rows for factor in factors])
    filled = rows.sum(axis=1) > 0
    block_positions = np.array(
        [(run, (s + 0.5) / len(each.rows)) for run, each in enumerate(factors) for s in range(len(each.rows))]
    )
    priors = with_exact_mass(idm, base, factors, priors or {})
    problem = Problem(
        columns.parameters,
        idm.actuated,
        np.concatenate(blocks)[filled],
        rows[filled],
        slowest,
        tuple(sensors),
        known_equations(base, idm.parameter_names, columns.parameters, priors),
        idm.robot.base,
        tuple(pushed),
    )
    _require_rows(problem, idm.robot)
    unexcited = _unexcited(problem)
    return System(
        problem.without(unexcited),
        problem,
        base,
        carried,
        unexcited,
        friction,
        block_positions[filled],
        np.array(maps),
        tuple(name for name, prior in priors.items() if prior.value is not None),
        None if temperatures is None else np.array([columns.warmth(channel) for channel in problem.channels]),
        np.concatenate([factor.R[..., -CURRENTS - PUSH] for factor in factors])[filled] if pushed else None,
    )


def _require_rows(problem: Problem, robot: Robot) -> None:
    for channel, count in zip(problem.channels, problem.total_rows, strict=True):
        if count < FEWEST_ROWS:
            joint = joint_behind(channel, robot)
            raise GtauError(
                f"joint '{joint}' has {count} usable rows in all runs together, away from its reversals and gaps; "
                "add runs in which it moves, or longer ones."
            )


def _unexcited(problem: Problem) -> tuple[str, ...]:
    stacked = np.concatenate(
        [
            *(R[:, : problem.n_theta] / sigma for R, sigma in zip(problem.triangles, problem.own_sigma, strict=True)),
            problem.known[:, :-1],
        ]
    )
    kept, _, _ = independent_columns(stacked)
    return tuple(name for k, name in enumerate(problem.parameters) if k not in kept)
