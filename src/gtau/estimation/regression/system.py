"""Assemble the estimation problem from the factors of all runs: payloads and identifiable columns (eqs. 29 to 33)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.column_blocks import (
    CarriedPayload,
    ColumnBlock,
    carried_payload,
    column_blocks,
    column_map,
    unknown_names,
)
from gtau.estimation.regression.equations import KNOWN, MODEL, SIGNAL, triangle
from gtau.estimation.regression.factors import Factors
from gtau.estimation.regression.friction import Friction, is_transmitted
from gtau.estimation.regression.priors import known_equations
from gtau.estimation.regression.problem import Problem
from gtau.model.base_parameters import BaseParameters, independent_columns
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import Parameter
from gtau.signals.channel import Channel, channels_of
from gtau.signals.reading.statements import Payload, Prior

FEWEST_ROWS = 50  # of a joint, in all runs together


@dataclass(frozen=True, eq=False)
class System:
    """The problem, and the meaning of its parameters.

    ``unexcited`` are base parameters that these motions cannot separate from those before them; they are
    not part of the problem, but of ``whole``. ``block_positions`` (U, 2) are the positions of the problem's units: the
    number of the run, and the time from its beginning (0) to its end (1). ``effects`` are the column blocks, and
    ``above`` (runs, n) the joints' temperatures above their means. ``stated`` are the parameters with a
    prior value. ``of_wrenches`` (U, c, p) is the part of measured wrenches in the problem's column ``known``; None
    without wrenches.
    """

    problem: Problem
    whole: Problem
    base: BaseParameters
    payloads: tuple[CarriedPayload, ...]
    unexcited: tuple[Parameter, ...]
    friction: Friction
    block_positions: np.ndarray
    effects: tuple[ColumnBlock, ...]
    above: np.ndarray
    stated: tuple[str, ...] = ()
    of_wrenches: np.ndarray | None = None

    def map(self, run: int, above: np.ndarray | None = None) -> np.ndarray:
        """Map the columns of the factors of a run to those of ``whole``, for every channel, (c, p, n_theta + 4).

        ``above`` (n,) are the joints' temperatures above their means; those of the whole run if left out.
        """
        if above is None:
            return self._maps[run]
        return np.stack([column_map(self.effects, run, each, above[each.row]) for each in self.whole.channels])

    @cached_property
    def _maps(self) -> list[np.ndarray]:
        return [self.map(run, above) for run, above in enumerate(self.above)]

    def full(self, theta: np.ndarray) -> np.ndarray:
        """Extend parameters of the problem to those of ``whole`` and a 1 for the known column, (n_theta + 1,)."""
        values = dict(zip(self.problem.parameters, theta, strict=True))
        return np.array([*(values.get(name, 0.0) for name in self.whole.parameters), 1.0])

    def motion(self, run: int, theta: np.ndarray) -> np.ndarray:
        """Return the base columns' values in ``run``, with its payload and its own friction, (n_b,)."""
        of_joints = self.map(run)[: len(self.whole.joints), : self.base.count, : KNOWN + 1] @ self.full(theta)
        return np.asarray(of_joints[self._rows, np.arange(len(self._rows))])

    @cached_property
    def _rows(self) -> list[int]:
        """Joint of each base column that may be that joint's friction."""
        joints, bodies = self.whole.joints, [name.body for name in self.base.standard]
        return [joints.index(body) if body in joints else 0 for body in bodies]

    def load(self, run: int, theta: np.ndarray) -> np.ndarray:
        """Return the base columns' values in ``run`` that joints transmit: with payload, without friction, (n_b,)."""
        return self.motion(run, theta) * is_transmitted(self.base.names)

    def loads(self, theta: np.ndarray) -> list[np.ndarray | None]:
        """Return :meth:`load` of each run, None where no friction depends on it."""
        loaded = any(term.kind == "fl" for term in self.friction.terms)
        return [self.load(run, theta) if loaded else None for run in range(len(self.above))]


def assemble_system(
    idm: InverseDynamics,
    base: BaseParameters,
    factors: Sequence[Factors],
    payloads: Sequence[Payload | None],
    slowest: float,
    friction: Friction,
    channels: Sequence[Channel] = (),
    priors: Mapping[str, Prior] | None = None,
    temperatures: Sequence[np.ndarray] | None = None,
    motions: Sequence[int] | None = None,
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
    channels : sequence of Channel
        All channels of the runs; the actuated joints if left out.
    priors : mapping, optional
        Priors on parameters, by name.
    temperatures : sequence of ndarray, optional
        Differences (blocks, n) of the joints' temperatures from their means, for each run.
    motions : sequence of int, optional
        A number for each run, the same for runs that repeat a motion, whose blocks are left out together.

    Raises
    ------
    GtauError
        Where some joint has no usable row in any run, nothing measured acts on a floating base, or a prior names no
        parameter.
    """
    carried = tuple(
        carried_payload(idm, base, run, payload) for run, payload in enumerate(payloads) if payload is not None
    )
    measured = channels or channels_of(idm.actuated, idm.robot.base)
    channels = tuple(each for each in measured if each.kind.modelled)
    given = (each.joint for each in measured if not each.kind.modelled and each.joint != idm.robot.floating)
    wrenches = tuple(dict.fromkeys(given))
    effects = tuple(column_blocks(base, channels, carried, friction, len(factors)))
    parameters = unknown_names(effects)
    blocks: list[np.ndarray] = []
    merged: list[list[np.ndarray]] = []
    for run, factor in enumerate(factors):
        warm = None if temperatures is None else temperatures[run]  # (blocks, n)
        maps = [column_map(effects, run, each, 0.0 if warm is None else warm[:, each.row]) for each in channels]
        blocks.append(np.stack([factor.R[:, j] @ M for j, M in enumerate(maps)], axis=1))
        merged.append([T @ M for T, M in zip(factor.merged, maps, strict=True)] if warm is None else [])
    rows = np.concatenate([factor.rows for factor in factors])
    filled = rows.sum(axis=1) > 0
    block_positions = np.array(
        [(run, (s + 0.5) / len(each.rows)) for run, each in enumerate(factors) for s in range(len(each.rows))]
    )
    of_run = np.arange(len(factors)) if motions is None else np.asarray(motions)
    block = np.concatenate([np.arange(len(each.rows)) for each in factors])
    motion = of_run[block_positions[:, 0].astype(int)]
    priors = priors or {}
    _require_base_wrench(idm, factors)
    problem = Problem(
        parameters,
        channels,
        np.concatenate(blocks)[filled],
        rows[filled],
        slowest,
        known_equations(base, idm.parameter_names, parameters, priors),
        wrenches,
        (motion * (block.max() + 1) + block)[filled],
    )
    if temperatures is None:  # all blocks of a run have the same map: their factors need not be merged again
        problem.__dict__["triangles"] = tuple(triangle(*each) for each in zip(*merged, strict=True))
    _require_rows(problem)
    unexcited = _unexcited(problem)
    return System(
        problem.without(unexcited),
        problem,
        base,
        carried,
        unexcited,
        friction,
        block_positions[filled],
        effects,
        np.array([each.mean(axis=0) for each in temperatures])
        if temperatures is not None
        else np.zeros((len(factors), len(idm.actuated))),
        tuple(name for name, prior in priors.items() if prior.value is not None),
        np.concatenate([factor.R[..., KNOWN] for factor in factors])[filled] if wrenches else None,
    )


def _require_base_wrench(idm: InverseDynamics, factors: Sequence[Factors]) -> None:
    rows = [idm.actuated.index(joint) for joint in idm.robot.base]
    if rows and not any(factor.R[:, rows, :, SIGNAL].any() for factor in factors):
        raise GtauError(
            f"no measured wrench acts on the base '{idm.robot.floating}' in any run, so its equations give only ratios "
            "of parameters, which noise of its motion biases towards zero; log the wrench that holds it in some runs "
            "('wrenches' of 'base' under 'signals')."
        )


def _require_rows(problem: Problem) -> None:
    for channel, count in zip(problem.channels, problem.total_rows, strict=True):
        if count < FEWEST_ROWS:
            raise GtauError(
                f"joint '{channel.joint}' has {count} usable rows in all runs together, away from its reversals and "
                "gaps; add runs in which it moves, or longer ones."
            )


def _unexcited(problem: Problem) -> tuple[Parameter, ...]:
    stacked = np.concatenate(
        [
            *(R[:, MODEL] / sigma for R, sigma in zip(problem.triangles, problem.own_sigma, strict=True)),
            problem.known[:, :-1],
        ]
    )
    kept, _, _ = independent_columns(triangle(stacked))
    return tuple(name for k, name in enumerate(problem.parameters) if k not in kept)
