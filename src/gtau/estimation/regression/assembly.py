"""Assemble the estimation problem from the factors of all runs: payloads and identifiable columns (eqs. 29 to 33)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.column_blocks import (
    ColumnBlock,
    column_blocks,
    column_map,
    payload_columns,
    unknown_names,
)
from gtau.estimation.regression.equations import MODEL, SIGNAL, triangle
from gtau.estimation.regression.factors import Factors
from gtau.estimation.regression.problem import Problem
from gtau.model.base_parameters import BaseParameters, independent_columns
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import Parameter
from gtau.signals.channel import Channel, channels_of
from gtau.signals.reading.statements import Payload

FEWEST_ROWS = 50  # of a joint, in all runs together


def assemble_problem(
    effects: Sequence[ColumnBlock],
    channels: Sequence[Channel],
    factors: Sequence[Factors],
    slowest: float,
    temperatures: Sequence[np.ndarray] | None = None,
    motions: Sequence[int] | None = None,
) -> Problem:
    """Stack the factors of unloaded and loaded runs into one problem (eqs. 29 to 33); raises GtauError.

    A payload is a further body on the robot's tool (eq. 18), so its columns are combinations of the base columns, and
    each run's factor becomes a block of the problem by one product with a small matrix. Factors are one a run, of
    ``channels``; ``slowest`` is the longest delay that can be described, s, 0 for none. ``temperatures`` are
    differences (blocks, n) of the joints' temperatures from their means in each run; ``motions`` a number for each
    run, the same for runs that repeat a motion, whose blocks are left out together.
    """
    blocks: list[np.ndarray] = []
    merged: list[list[np.ndarray]] = []
    for run, factor in enumerate(factors):
        warm = None if temperatures is None else temperatures[run]
        maps = [
            column_map(effects, run, channel, 0.0 if warm is None else warm[:, channel.row]) for channel in channels
        ]
        blocks.append(np.stack([factor.R[:, j] @ M for j, M in enumerate(maps)], axis=1))
        if warm is None:  # all blocks of a run have the same map: their factors need not be merged again
            merged.append([T @ M for T, M in zip(factor.merged, maps, strict=True)])
    rows = np.concatenate([factor.rows for factor in factors])
    filled = rows.sum(axis=1) > 0
    of_run = range(len(factors)) if motions is None else motions
    numbers = [np.arange(len(factor.rows)) for factor in factors]
    count = max(map(len, numbers))
    clusters = np.concatenate([motion * count + number for motion, number in zip(of_run, numbers, strict=True)])
    problem = Problem(
        unknown_names(effects),
        tuple(channels),
        np.concatenate(blocks)[filled],
        rows[filled],
        slowest,
        clusters=clusters[filled],
        factored=tuple(triangle(*parts) for parts in zip(*merged, strict=True)) if merged else None,
    )
    for channel, equations in zip(problem.channels, problem.total_rows, strict=True):
        if equations < FEWEST_ROWS:
            raise GtauError(
                f"joint '{channel.joint}' has {equations} usable rows in all runs together, away from its reversals "
                "and gaps; add runs in which it moves, or longer ones."
            )
    return problem


def plain_problem(
    model: InverseDynamics,
    base: BaseParameters,
    factors: Sequence[Factors],
    payloads: Sequence[Payload | None],
    slowest: float = 0.0,
) -> Problem:
    """Assemble the problem of runs with the channels of the motors alone, whose friction drifts from run to run."""
    channels = channels_of(model.actuated, model.robot.base)
    effects = column_blocks(base, channels, payload_columns(model, base, payloads), (), len(factors))
    require_base_wrench(model, factors)
    problem = assemble_problem(effects, channels, factors, slowest)
    return problem.without(unexcited(problem))


def require_base_wrench(model: InverseDynamics, factors: Sequence[Factors]) -> None:
    """Check that something measured acts on a floating base in some run; raises GtauError."""
    rows = [model.actuated.index(joint) for joint in model.robot.base]
    if rows and not any(factor.R[:, rows, :, SIGNAL].any() for factor in factors):
        raise GtauError(
            f"no measured wrench acts on the base '{model.robot.floating}' in any run, so its equations give only "
            "ratios of parameters, which noise of its motion biases towards zero; log the wrench that holds it in some "
            "runs ('wrenches' of 'base' under 'signals')."
        )


def unexcited(problem: Problem) -> tuple[Parameter, ...]:
    """Find the parameters that these motions cannot separate from those before them."""
    rows = (R[:, MODEL] / sigma for R, sigma in zip(problem.triangles, problem.own_sigma, strict=True))
    kept, _, _ = independent_columns(triangle(*rows, problem.known[:, :-1]))
    return tuple(name for k, name in enumerate(problem.parameters) if k not in kept)
