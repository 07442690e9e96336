"""Assemble the estimation problem from the factors of all runs: payloads and identifiable columns (eqs. 29 to 33).

All runs have the same base columns. The columns of a payload, of friction that drifts or changes with temperature, or
of the offset of a torque sensor are combinations of them: so the factors of each channel and run become a block of the
problem by one product with a small matrix.

The paper's friction, viscous and Coulomb, is among the standard parameters of the model. Further terms are candidates
for every actuated joint, and selected if its own equations support them: ``f3 qd^3``, cubic in speed, and
``fl |tau_load| sign(qd)``, proportional to the torque that the joint transmits; where temperatures are logged,
``fvt (T - T_mean) qd`` and ``fst (T - T_mean) sign(qd)``, with the mean over a block. The bearing of a joint's torque
sensor may have friction of its own (``fv_2_sensor``). Warm-up makes friction drift between runs by per cents, which is
invisible in a single run and ruins the drive gains; so viscous and Coulomb friction may differ between runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.factors import EXTRA, FIXED, KNOWN, MODEL, SIGNAL, SIGNALS, Factors, triangle
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.run_blocks import BLOCKS, PreparedRuns
from gtau.model.base_parameters import BaseParameters, independent_columns, seen_by_sensor
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import DRIFTING, TEMPERATURE_TERMS, TERMS, Parameter, payload_label
from gtau.robots.robot import INERTIAL, PLAIN_FRICTION
from gtau.signals.channel import Channel, channels_of
from gtau.signals.preparation.prepared_run import PreparedRun
from gtau.signals.reading.statements import FIRST_MOMENTS, Payload

INSTANTS = 50  # of a block, over which the mean is taken


@dataclass(frozen=True, eq=False)
class ColumnBlock:
    """Columns of ``names`` (k,), each a combination of the columns of the factors.

    ``columns`` makes the combinations (..., p, k) from a run, a channel and its temperature above the mean, (...,);
    ``stated`` are values of the names that are known: their columns, times these, are added to the column ``known``.
    """

    names: tuple[Parameter, ...]
    columns: Callable[[int, Channel, np.ndarray], np.ndarray]
    stated: Mapping[Parameter, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PayloadColumns:
    """Columns of the payload of one run, which is a body called ``label``.

    Each of its ``unknown`` parameters that act on some actuated joint is the sum of parameters of the unknown kinds
    ``summed`` with the factors ``sums`` (unknown, summed). ``columns`` (n_b, k) are the columns of the unknown and then
    of the known parameters, in base columns.
    """

    run: int
    label: str
    payload: Payload
    unknown: tuple[Parameter, ...]
    summed: tuple[str, ...]
    sums: np.ndarray
    columns: np.ndarray

    @property
    def acts(self) -> bool:
        """Decide whether its known parameters act on some actuated joint."""
        return bool(self.columns[:, len(self.unknown) :].any())

    @property
    def shown(self) -> bool:
        """Decide whether its known parameters act on some actuated joint otherwise than its unknown ones do."""
        return len(independent_columns(self.columns)[0]) > len(self.unknown)

    def regrouping(self, name: Parameter) -> str:
        """Write the sum of parameters that an unknown one stands for."""
        terms = zip(self.summed, self.sums[self.unknown.index(name)], strict=True)
        return " + ".join(kind if kind == name.kind else f"{factor:.5g} {kind}" for kind, factor in terms if factor)


def known_values(payload: Payload) -> dict[str, float]:
    """Return the known inertial parameters of a payload, by kind; empty for an unknown payload."""
    mass = {} if payload.mass is None else {"m": payload.mass}
    return {**mass, **payload.parameters}


def payload_columns(
    idm: InverseDynamics, base: BaseParameters, payloads: Sequence[Payload | None]
) -> tuple[PayloadColumns, ...]:
    """Express the parameters of the payloads of all runs on the robot's tool in base columns (eq. 18).

    Of parameters that act alike first moments are kept rather than inertias, and masses last, so that a parameter is
    called ``m`` only where it is the mass by itself.
    """
    tool_columns = {
        kind: base.matrix[:, idm.parameter_names.index(Parameter(kind, idm.robot.tool))] for kind in INERTIAL
    }
    order = (*FIRST_MOMENTS, *(kind for kind in INERTIAL if kind not in FIRST_MOMENTS))
    blocks = []
    for run, payload in ((run, payload) for run, payload in enumerate(payloads) if payload is not None):
        values = known_values(payload)
        center = dict(zip(FIRST_MOMENTS, payload.center or (), strict=False))
        summed = tuple(kind for kind in order if kind not in values and kind not in center)
        mass = tool_columns["m"] + sum(at * tool_columns[kind] for kind, at in center.items())  # moments are the mass's
        acting = tool_columns | {"m": mass}
        columns = np.reshape([acting[kind] for kind in summed], (len(summed), base.count)).T
        kept, sums, _ = independent_columns(columns)
        label = payload_label(idm.robot, run)
        unknown = tuple(Parameter(summed[k], label) for k in kept)
        both = np.array([acting[kind] for kind in (*(name.kind for name in unknown), *values)]).T
        blocks.append(PayloadColumns(run, label, payload, unknown, summed, sums, both.reshape(base.count, -1)))
    return tuple(blocks)


def column_blocks(
    base: BaseParameters,
    channels: Sequence[Channel],
    payloads: Sequence[PayloadColumns],
    terms: tuple[Parameter, ...],
    drifting: int,
) -> tuple[ColumnBlock, ...]:
    """List the effects in order, with friction ``terms``, and friction that differs between ``drifting`` runs."""
    offsets = tuple(Parameter("off", channel.name) for channel in channels if channel.kind.link_side)
    return (
        ColumnBlock(base.names, lambda run, channel, above: _felt(base, channel, np.eye(base.count))),
        *(_payload_block(base, payload) for payload in payloads),
        _drift_block(base, [channel.joint for channel in channels], drifting),
        _own_block(base, terms),
        _own_block(base, offsets),
    )


def _felt(base: BaseParameters, channel: Channel, columns: np.ndarray) -> np.ndarray:
    """Place columns (n_b, k) in the factors, (p, k); a sensor does not measure its drive."""
    felt = columns * seen_by_sensor(base.standard, channel.joint)[:, None] if channel.kind.link_side else columns
    return np.concatenate([felt, np.zeros((EXTRA, columns.shape[1]))])


def _payload_block(base: BaseParameters, payload: PayloadColumns) -> ColumnBlock:
    values = {Parameter(kind, payload.label): value for kind, value in known_values(payload.payload).items()}

    def columns(run: int, channel: Channel, above: np.ndarray) -> np.ndarray:
        return _felt(base, channel, payload.columns * (run == payload.run))

    return ColumnBlock((*payload.unknown, *values), columns, values)


def _drift_block(base: BaseParameters, joints: Sequence[str], runs: int) -> ColumnBlock:
    """Build the block of friction's differences from its mean in every run; they add up to zero."""
    kinds = {Parameter(kind, joint) for kind in DRIFTING for joint in joints}
    drifting = [k for k, name in enumerate(base.names) if name in kinds] if runs > 1 else []
    units = np.eye(base.count)[:, drifting]

    def columns(run: int, channel: Channel, above: np.ndarray) -> np.ndarray:
        changes = [units * ((k == run) - (run == runs - 1)) for k in range(runs - 1)]
        return _felt(base, channel, np.hstack([units[:, :0], *changes]))

    names = ((base.names[k], run) for run in range(runs - 1) for k in drifting)
    return ColumnBlock(tuple(Parameter(name.kind, name.body, run) for name, run in names), columns)


def _own_block(base: BaseParameters, names: tuple[Parameter, ...]) -> ColumnBlock:
    """Build the block of friction of drives or sensors, and offsets, which uses the columns of their joint."""

    def columns(run: int, channel: Channel, above: np.ndarray) -> np.ndarray:
        M = np.zeros((*above.shape, base.count + EXTRA, len(names)))
        for k, kind in ((k, name.kind) for k, name in enumerate(names) if name.body == channel.name):
            if kind in TERMS:
                M[..., base.count + TERMS.index(kind), k] = 1.0
            else:
                row = base.standard.index(Parameter(TEMPERATURE_TERMS.get(kind, kind), channel.joint))
                M[..., row, k] = above if kind in TEMPERATURE_TERMS else 1.0
        return M

    return ColumnBlock(names, columns)


def column_map(
    blocks: Sequence[ColumnBlock], run: int, channel: Channel, above: np.ndarray | float = 0.0
) -> np.ndarray:
    """Map the columns of a run's factors to the problem's (..., p, n_theta + 4), ``above`` the mean temperature."""
    parts = [block.columns(run, channel, np.asarray(above)) for block in blocks]
    unknown = [np.array([name not in block.stated for name in block.names], dtype=bool) for block in blocks]
    shape = np.broadcast_shapes(*(part.shape[:-2] for part in parts))
    fixed = np.zeros((*shape, parts[0].shape[-2], FIXED))
    fixed[..., KNOWN, KNOWN], fixed[..., SIGNALS, SIGNALS] = 1.0, np.eye(3)
    for block, part, free in zip(blocks, parts, unknown, strict=True):
        if block.stated:
            fixed[..., KNOWN] += part[..., ~free] @ list(block.stated.values())
    columns = [part[..., free] for part, free in zip(parts, unknown, strict=True)]
    return np.concatenate([np.broadcast_to(part, (*shape, *part.shape[-2:])) for part in (*columns, fixed)], axis=-1)


def all_terms(joints: Sequence[str], terms: Iterable[str] = TERMS) -> tuple[Parameter, ...]:
    """List every one of the ``terms`` of every joint, or torque sensor."""
    return tuple(Parameter(term, joint) for joint in joints for term in terms)


def is_transmitted(names: Sequence[Parameter]) -> np.ndarray:
    """Mark the base parameters whose torque a joint transmits by 1, friction and offsets by 0, (n_b,)."""
    return np.array([name.kind not in PLAIN_FRICTION for name in names], dtype=float)


@dataclass(frozen=True, eq=False)
class Temperatures:
    """Mean temperatures by joint, in ``unit``, and differences from them (blocks, n) in each run; 0 without one."""

    reference: dict[str, float]
    by_block: tuple[np.ndarray, ...]
    unit: str
    prepared: tuple[PreparedRun, ...]

    def between(self, run: int, begin: float, end: float) -> np.ndarray:
        """Average the differences (n,) between two instants of a run."""
        logged = self.prepared[run].run
        time = np.linspace(begin, end, INSTANTS)
        temperature = logged.side["temperature"]  # all runs have one
        means = {joint: temperature.at(joint, time).mean() - mean for joint, mean in self.reference.items()}
        return np.array([means.get(joint, 0.0) for joint in logged.joints])


def temperatures_of(prepared: PreparedRuns) -> Temperatures | None:
    """Compute the differences in all runs; None without temperatures. Raises GtauError."""
    logged = [run.run.side["temperature"] for run in prepared if "temperature" in run.run.side]
    if not logged:
        return None
    if len(logged) < len(prepared):
        lacking = next(run.run.name for run in prepared if "temperature" not in run.run.side)
        raise GtauError(f"run '{lacking}' has no temperature, but other runs have; log it in all runs, or in none.")
    joints, means = prepared[0].run.joints, []
    known = [joint for joint in joints if all(joint in temperature.by_joint for temperature in logged)]
    for run, temperature, cut in zip(prepared, logged, prepared.edges, strict=True):
        share = np.interp(np.linspace(0, BLOCKS, BLOCKS * INSTANTS), np.arange(BLOCKS + 1), cut)
        time = run.time[0] + share * (run.time[-1] - run.time[0])
        along = [temperature.at(joint, time).reshape(BLOCKS, INSTANTS).mean(axis=1) for joint in known]
        means.append(np.reshape(along, (len(known), BLOCKS)).T)
    reference = np.mean(np.concatenate(means), axis=0)
    differences = np.zeros((len(prepared), BLOCKS, len(joints)))
    differences[..., [joints.index(joint) for joint in known]] = np.array(means) - reference
    by_joint = dict(zip(known, map(float, reference), strict=True))
    return Temperatures(by_joint, tuple(differences), logged[0].unit, tuple(prepared))


FEWEST_ROWS = 50  # of a joint, in all runs together
MORE_ROWS = "add runs in which it moves, or longer ones; or list a joint that stands still under 'held' of 'robot'"


def assemble_problem(
    effects: Sequence[ColumnBlock],
    channels: Sequence[Channel],
    factors: Sequence[Factors],
    longest_delays: np.ndarray | float,
    temperatures: Sequence[np.ndarray] | None = None,
    motions: Sequence[int] | None = None,
) -> Problem:
    """Stack the factors of unloaded and loaded runs into one problem (eqs. 29 to 33); raises GtauError.

    A payload is a further body on the robot's tool (eq. 18), so its columns are combinations of the base columns, and
    each run's factor becomes a block of the problem by one product with a small matrix. Factors are one a run, of
    ``channels``, each with its longest delay (s, 0 for none). ``temperatures`` are differences (blocks, n) of the
    joints' temperatures from their means in each run; ``motions`` a number for each run, the same for runs that repeat
    a motion, whose blocks are left out together.
    """
    blocks: list[tuple[np.ndarray, np.ndarray]] = []
    merged: list[list[np.ndarray]] = []
    for run, factor in enumerate(factors):
        warm = None if temperatures is None else temperatures[run]
        maps = [
            column_map(effects, run, channel, 0.0 if warm is None else warm[:, channel.row]) for channel in channels
        ]
        blocks.append((factor.R, np.stack(np.broadcast_arrays(*maps), axis=-3)))
        if warm is None:  # all blocks of a run have the same map: their factors need not be merged again
            merged.append([T @ M for T, M in zip(factor.merged, maps, strict=True)])
    rows = np.concatenate([factor.rows for factor in factors])
    filled = rows.sum(axis=1) > 0
    motion_numbers = range(len(factors)) if motions is None else motions
    numbers = [np.arange(len(factor.rows)) for factor in factors]
    count = max(map(len, numbers))
    clusters = np.concatenate([motion * count + number for motion, number in zip(motion_numbers, numbers, strict=True)])
    return Problem(
        tuple(name for effect in effects for name in effect.names if name not in effect.stated),
        tuple(channels),
        lambda: np.concatenate([R @ M for R, M in blocks])[filled],
        rows[filled],
        np.broadcast_to(longest_delays, len(channels)),
        clusters=clusters[filled],
        factored=tuple(triangle(*parts) for parts in zip(*merged, strict=True)) if merged else None,
    )


def require_rows(problem: Problem) -> None:
    """Check that every channel has enough equations; raises GtauError."""
    for channel, equations in zip(problem.channels, problem.rows.sum(axis=0), strict=True):
        if equations < FEWEST_ROWS:
            raise GtauError(
                f"joint '{channel.joint}' has {equations} usable rows in all runs together, away from its reversals "
                f"and gaps; {MORE_ROWS}."
            )


def plain_problem(
    model: InverseDynamics,
    base: BaseParameters,
    factors: Sequence[Factors],
    payloads: Sequence[Payload | None],
    longest_delays: float = 0.0,
) -> Problem:
    """Assemble the problem of runs with the channels of the motors alone, whose friction drifts from run to run."""
    channels = channels_of(model.actuated, model.robot.base)
    effects = column_blocks(base, channels, payload_columns(model, base, payloads), (), len(factors))
    require_base_wrench(model, factors)
    problem = assemble_problem(effects, channels, factors, longest_delays)
    require_rows(problem)
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
