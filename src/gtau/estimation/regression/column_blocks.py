"""Blocks of columns: contribution of each effect to the equations of every channel (eqs. 29 to 33).

All runs have the same base columns. The columns of an effect (a payload, friction that drifts or changes with
temperature, the offset of a torque sensor) are combinations of them: so the factors of each channel and run become a
block of the problem by one product with a small matrix. An effect is a :class:`ColumnBlock`; :func:`column_blocks`
lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gtau.estimation.regression.equations import FIXED, KNOWN, SIGNALS
from gtau.estimation.regression.factors import EXTRA
from gtau.estimation.regression.friction import DRIFTING, TEMPERATURE_TERMS, TERMS, Friction
from gtau.model.base_parameters import BaseParameters, independent_columns, seen_by_sensor
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import Parameter
from gtau.robots.robot import INERTIAL
from gtau.signals.channel import Channel
from gtau.signals.reading.statements import FIRST_MOMENTS, Payload


@dataclass(frozen=True, eq=False)
class ColumnBlock:
    """Named columns, each a combination of the columns of the factors.

    Attributes
    ----------
    names : tuple of Parameter
        (k,).
    columns : callable
        From a run, a channel and its temperature above the mean, (...,), to the combinations (..., p, k).
    stated : mapping
        Values of the names that are known: their columns, times these, are added to the column ``known``.
    """

    names: tuple[Parameter, ...]
    columns: Callable[[int, Channel, np.ndarray], np.ndarray]
    stated: Mapping[Parameter, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class CarriedPayload:
    """The payload of one run.

    ``unknown`` maps the name in the problem of each unknown parameter that acts on some actuated joint
    to its kind, and ``regroupings`` the kind to its regrouping formula: ``sums`` (unknown, free)
    of the kinds ``free`` that are not known. ``columns`` (n_b, k) are those of the unknown and then of the known
    parameters, in base columns.
    """

    run: int
    payload: Payload
    unknown: Mapping[Parameter, str]
    regroupings: Mapping[str, str]
    free: tuple[str, ...]
    sums: np.ndarray
    columns: np.ndarray

    @property
    def acts(self) -> bool:
        """Decide whether its known parameters act on some actuated joint."""
        return bool(self.columns[:, len(self.unknown) :].any())


def known_values(payload: Payload) -> dict[str, float]:
    """Return the known inertial parameters of a payload, by kind; empty for an unknown payload."""
    mass = {} if payload.mass is None else {"m": payload.mass}
    return {**mass, **payload.parameters}


def carried_payload(idm: InverseDynamics, base: BaseParameters, run: int, payload: Payload) -> CarriedPayload:
    """Express the parameters of a ``payload`` on the robot's tool in base columns (eq. 18).

    Of parameters that act alike first moments are kept rather than inertias, and masses last, so that a parameter is
    called ``m`` only where it is the mass by itself.
    """
    values, center = known_values(payload), dict(zip(FIRST_MOMENTS, payload.center or (), strict=False))
    order = (*FIRST_MOMENTS, *(kind for kind in INERTIAL if kind not in FIRST_MOMENTS))
    free = [kind for kind in order if kind not in values and kind not in center]
    of_tool = {kind: base.matrix[:, idm.parameter_names.index(Parameter(kind, idm.robot.tool))] for kind in INERTIAL}
    of_tool["m"] = of_tool["m"] + sum(each * of_tool[kind] for kind, each in center.items())  # moments are the mass's
    columns = np.reshape([of_tool[kind] for kind in free], (len(free), base.count)).T
    kept, coefficients, _ = independent_columns(columns)
    formulas = {
        free[k]: " + ".join(
            f"{coefficients[row, other]:.5g} {kind}" if other != k else kind
            for other, kind in enumerate(free)
            if coefficients[row, other]
        )
        for row, k in enumerate(kept)
    }
    unknown = {Parameter(free[k], f"L{run + 1}"): free[k] for k in kept}
    both = np.array([of_tool[kind] for kind in (*unknown.values(), *values)]).T.reshape(base.count, -1)
    return CarriedPayload(run, payload, unknown, formulas, tuple(free), coefficients, both)


def column_blocks(
    base: BaseParameters, channels: Sequence[Channel], carried: Sequence[CarriedPayload], friction: Friction, runs: int
) -> list[ColumnBlock]:
    """List the effects of the model, in the order of their parameters in the problem.

    Parameters
    ----------
    base : BaseParameters
        Whose standard columns the factors have.
    channels : sequence of Channel
        Those of the problem.
    carried : sequence of CarriedPayload
        Payloads of all runs.
    friction : Friction
        Terms to take, and whether friction may drift between runs.
    runs : int
        Number of runs.
    """
    offsets = tuple(Parameter("off", channel.name) for channel in channels if channel.kind.link_side)
    return [
        ColumnBlock(base.names, lambda run, channel, above: _felt(base, channel, np.eye(base.count))),
        *(_payload_block(base, each) for each in carried),
        _drift_block(base, [channel.joint for channel in channels], runs if friction.per_run else 1),
        _own_block(base, friction.terms),
        _own_block(base, offsets),
    ]


def _felt(base: BaseParameters, channel: Channel, columns: np.ndarray) -> np.ndarray:
    """Place columns (n_b, k) in those of the factors, (p, k); a sensor does not measure those of its joint's drive."""
    felt = columns * seen_by_sensor(base.standard, channel.joint)[:, None] if channel.kind.link_side else columns
    return np.concatenate([felt, np.zeros((EXTRA, columns.shape[1]))])


def _payload_block(base: BaseParameters, carried: CarriedPayload) -> ColumnBlock:
    values = {Parameter(kind, f"L{carried.run + 1}"): value for kind, value in known_values(carried.payload).items()}

    def columns(run: int, channel: Channel, above: np.ndarray) -> np.ndarray:
        return _felt(base, channel, carried.columns * (run == carried.run))

    return ColumnBlock((*carried.unknown, *values), columns, values)


def _drift_block(base: BaseParameters, joints: Sequence[str], runs: int) -> ColumnBlock:
    """Build the block of friction's differences from its mean in every run; they add up to zero."""
    kinds = {Parameter(kind, joint) for kind in DRIFTING for joint in joints}
    drifting = [k for k, name in enumerate(base.names) if name in kinds] if runs > 1 else []
    units = np.eye(base.count)[:, drifting]

    def columns(run: int, channel: Channel, above: np.ndarray) -> np.ndarray:
        return _felt(base, channel, np.hstack([units * ((k == run) - (run == runs - 1)) for k in range(runs - 1)]))

    names = tuple(Parameter(base.names[k].kind, base.names[k].body, run) for run in range(runs - 1) for k in drifting)
    return ColumnBlock(names, columns) if names else ColumnBlock((), lambda *_: np.zeros((base.count + EXTRA, 0)))


def _own_block(base: BaseParameters, names: tuple[Parameter, ...]) -> ColumnBlock:
    """Build the block of parameters that act only in the equations of the channel whose name they end in.

    They are further friction of a drive, or friction and offset of a sensor, whose columns are those of its joint's.
    """

    def columns(run: int, channel: Channel, above: np.ndarray) -> np.ndarray:
        found = np.zeros((*above.shape, base.count + EXTRA, len(names)))
        for k, name in enumerate(names):
            if name.body != channel.name:
                continue
            if (kind := name.kind) in TERMS:
                found[..., base.count + TERMS.index(kind), k] = 1.0
            else:
                row = base.standard.index(f"{TEMPERATURE_TERMS.get(kind, kind)}_{channel.joint}")
                found[..., row, k] = above if kind in TEMPERATURE_TERMS else 1.0
        return found

    return ColumnBlock(names, columns)


def unknown_names(blocks: Sequence[ColumnBlock]) -> tuple[Parameter, ...]:
    """List the unknown parameters of the effects, the theta of the problem."""
    return tuple(name for block in blocks for name in block.names if name not in block.stated)


def column_map(
    blocks: Sequence[ColumnBlock], run: int, channel: Channel, above: np.ndarray | float = 0.0
) -> np.ndarray:
    """Map the columns of the factors of a run to those of the problem, for a channel.

    Parameters
    ----------
    blocks : sequence of ColumnBlock
        All effects.
    run, channel : int, Channel
        Which equations.
    above : ndarray, optional
        Temperatures of the channel above the mean, (...,).

    Returns
    -------
    ndarray
        (..., p, n_theta + 4).
    """
    parts = [block.columns(run, channel, np.asarray(above)) for block in blocks]
    p = parts[0].shape[-2]
    unknown = [[name not in block.stated for name in block.names] for block in blocks]
    shape = np.broadcast_shapes(*(part.shape[:-2] for part in parts))
    M = np.zeros((*shape, p, sum(map(sum, unknown)) + FIXED))
    M[..., KNOWN, KNOWN], M[..., SIGNALS, SIGNALS] = 1.0, np.eye(3)
    end = 0
    for block, part, free in zip(blocks, parts, unknown, strict=True):
        begin, end = end, end + sum(free)
        M[..., begin:end] = part[..., free]
        if block.stated:
            M[..., KNOWN] += part[..., np.logical_not(free)] @ list(block.stated.values())
    return M
