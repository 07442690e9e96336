"""The decimated rows of a run, ``[W | V_tau]`` of eq. (20), streamed block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from gtau.model.inverse_dynamics import PATH, InverseDynamics, Regressor
from gtau.model.loops import Labels, Motion
from gtau.robots.parameter import KINDS, TERMS
from gtau.signals.preparation.filters import Decimator
from gtau.signals.preparation.prepared_run import PreparedRun, SampleWindow
from gtau.signals.run import Run
from gtau.signals.storage import spans


class Sliding(NamedTuple):
    """State of a joint on which its friction depends: numbers, arrays, or expressions of CasADi (so ``abs``, no NumPy).

    ``speed`` in rad/s or m/s; ``direction`` is the sign of the speed, or the state of presliding; ``load`` the size of
    the torque that the joint transmits, N m or N; ``falling`` is ``exp(-|speed| / v_s)``, 0 without a v_s; ``above``
    the temperature above the mean.
    """

    speed: Any
    direction: Any
    load: Any = 0.0
    falling: Any = 0.0
    above: Any = 0.0


FORMULAS: Mapping[str, Callable[[Sliding], Any]] = {
    "fv": lambda at: at.speed,
    "fs": lambda at: at.direction,
    "fb": lambda at: at.falling * at.direction,
    "fl": lambda at: at.load * at.direction,
    "f3": lambda at: at.speed * at.speed * at.speed,  # a power would take ten times as long
}
"""Friction of a joint per unit of each parameter."""
SLOPES: Mapping[str, Callable[[float], float]] = {"f3": lambda speed: 3 * speed**2}
"""Derivatives by the speed of the terms of actuated joints that are extrapolated beyond the logged speeds."""


def column(kind: str, at: Sliding) -> Any:
    """Evaluate the column of a kind of friction; the column of a temperature slope is its kind's times ``above``."""
    if slope_of := KINDS[kind].slope_of:
        return at.above * FORMULAS[slope_of](at)
    return FORMULAS[kind](at)


SHORT = 16384  # samples of a run that is prepared once: longer ones would fill the memory
ALL_SAMPLES = 4096  # of a block that is not decimated
FAST_SAMPLES = 1024  # of a block, before decimation: enough to amortise Python, and few enough to stay in the cache


@dataclass(frozen=True)
class Rows:
    """Rows of all channels, the joints' and then the torque sensors', at K output instants.

    ``time`` (K,) in s; ``keep`` (c, K); ``entries`` of the regressor (entries, K); ``currents``
    (3, c, K): the command and its first two time derivatives, for a base its external forces; ``terms``
    (terms, n, K), the columns of further friction of the joints; ``external`` (n, K), the joint torques of
    wrenches on bodies, 0 for a base; ``outputs`` their numbers in the run; ``motion`` of the whole tree
    at these instants; ``friction`` (n, K), where a law of it is given.
    """

    time: np.ndarray
    keep: np.ndarray
    entries: np.ndarray
    currents: np.ndarray
    terms: np.ndarray
    external: np.ndarray
    outputs: slice
    motion: Motion
    friction: np.ndarray | None = None

    def matrix(self, regressor: Regressor, n: int) -> np.ndarray:
        """Return W (n, K, columns) of the actuated joints."""
        W = np.zeros((n, len(self.time), len(regressor.names)))
        W[regressor.rows, :, regressor.columns] = self.entries
        return W


Law = Callable[[np.ndarray, Motion, np.ndarray], np.ndarray]
"""Torques (n, N) at times (N,), along a motion, under the torques (n, N) that the joints transmit."""


def stream_rows(
    idm: InverseDynamics,
    regressor: Regressor,
    prepared: PreparedRun | SampleWindow,
    decimator: Decimator,
    load: np.ndarray | None = None,
    fast: int = FAST_SAMPLES,
    friction: Law | None = None,
) -> Iterator[Rows]:
    """Evaluate ``regressor`` along a run and decimate it in parallel with the currents (eqs. 19 and 20).

    ``load`` (columns,) gives the torques transmitted by the joints, for friction that depends on them; without it the
    command replaces the torque, up to the drive gain. ``fast`` samples make a block before decimation; ``friction``
    are torques outside the linear model, to be decimated too. Raises GtauError where the loops cannot be closed at a
    sample, or a pose is too close to a singularity.
    """
    n = len(prepared)
    size = max(fast, 8 * decimator.warm_up) // decimator.factor
    blocks = list(decimator.blocks(n, size))
    windows = _along(idm, prepared, (decimator.samples(outputs, n) for outputs in blocks))
    for outputs, (window, c) in zip(blocks, windows, strict=True):
        kept = decimator.at(outputs)
        motion, measured, external = _measured(idm, prepared.run, window, c)
        currents = measured[:, : window.usable.shape[1]]
        entries, qd = regressor(idm.layout, motion), window.qd.T
        effort = currents[0, : len(qd)]
        if load is not None:
            effort = regressor.torques(entries, load, len(idm.actuated)) - external[0]
        sliding = Sliding(qd, np.sign(qd), np.abs(effort))
        terms = np.stack([FORMULAS[kind](sliding) for kind in TERMS])
        yield Rows(
            window.time[kept],
            decimator.keep(window.usable, outputs).T,
            decimator.apply(entries, outputs),
            decimator.apply(currents, outputs),
            decimator.apply(terms, outputs),
            decimator.apply(external[0], outputs),
            outputs,
            motion[kept],
            None if friction is None else decimator.apply(friction(window.time, motion, effort), outputs),
        )


def stream_torques(
    idm: InverseDynamics, regressor: Regressor, prepared: PreparedRun, values: np.ndarray, friction: Law
) -> Iterator[np.ndarray]:
    """Compute blocks (3, n, K) at every sample: torques with friction and wrenches, friction, commands."""
    for window, c in _along(idm, prepared, _every_sample(prepared)):
        motion, measured, external = _measured(idm, prepared.run, window, c)
        effort = regressor.torques_along(idm.layout, motion, values) - external[0]
        friction_torque = friction(window.time, motion, effort)
        yield np.stack([effort + friction_torque, friction_torque, measured[0, : len(effort)]])


def _every_sample(prepared: PreparedRun) -> Iterator[slice]:
    return (slice(*span) for span in spans(len(prepared), ALL_SAMPLES))


def _measured(
    idm: InverseDynamics, run: Run, window: SampleWindow, c: np.ndarray
) -> tuple[Motion, np.ndarray, np.ndarray]:
    """Compute motion, commands (3, ., M) with derivatives, and torques of wrenches (3, n, M), zero on a base."""
    motion = idm.rates(c, window.qd.T.copy(), window.qdd.T.copy(), instants(run.name, window.time))
    measured = np.stack([window.command.T, window.command_d.T, window.command_dd.T])
    external = external_torques(idm, run, motion, measured)
    base = [idm.actuated.index(joint) for joint in idm.robot.base]
    measured[:, base] += external[:, base]
    external[:, base] = 0.0
    return motion, measured, external


def stream_motions(idm: InverseDynamics, prepared: PreparedRun) -> Iterator[tuple[SampleWindow, Motion]]:
    """Compute the motion at every sample of a run, filtered by the positions' low-pass alone; raises GtauError."""
    for window, c in _along(idm, prepared, _every_sample(prepared)):
        yield window, idm.rates(c, window.qd.T.copy(), window.qdd.T.copy(), instants(prepared.run.name, window.time))


def external_torques(idm: InverseDynamics, run: Run, motion: Motion, measured: np.ndarray) -> np.ndarray:
    """Compute the torques of a run's wrenches at the actuated joints, ``J^T w`` (3, n, M).

    ``measured`` (3, ., M) are the columns of the run's commands and their time derivatives, the wrenches last;
    ``motion`` is the motion at the same M samples. A delayed wrench is mapped at the current pose, so that the
    columns of its delay are ``J^T w'`` and ``J^T w''``.
    """
    torques = np.zeros((len(measured), len(idm.actuated), measured.shape[-1]))
    if run.wrenches:
        columns, w = idm.wrenches(run.wrenches), measured[:, run.given]
        for entry, row, column in zip(columns(idm.layout, motion), columns.rows, columns.columns, strict=True):
            torques[:, row] += entry * w[:, column]
    return torques


def configurations(idm: InverseDynamics, window: SampleWindow) -> np.ndarray:
    """Compute the configurations (n_c, N) of a model along a window; raises GtauError."""
    run, first = window.part_of or (window, 0)
    return _along_whole(idm, run)[:, first : first + len(window)]


def _along_whole(idm: InverseDynamics, prepared: PreparedRun | SampleWindow) -> np.ndarray:
    """Compute the configurations along a whole run, which factors, friction and windows of effects share."""
    if idm not in prepared.paths:
        window = prepared.all_samples if isinstance(prepared, PreparedRun) else prepared
        prepared.paths[idm] = idm.path(window.q.T.copy(), instants(prepared.run.name, window.time))
    return prepared.paths[idm]


def _along(
    idm: InverseDynamics, prepared: PreparedRun | SampleWindow, blocks: Iterable[slice]
) -> Iterator[tuple[SampleWindow, np.ndarray]]:
    """Stream blocks of samples with their configurations, made for longer stretches, which is faster."""
    begin, end = 0, 0  # the stretch that ``window`` and ``c`` are for
    c = np.zeros((idm.layout.n_c, 0))
    if isinstance(prepared, PreparedRun) and len(prepared) <= SHORT:
        end = len(prepared)
        c = _along_whole(idm, prepared)
        window = prepared.all_samples
    for at in blocks:
        if at.stop > end:
            known = max(end - at.start, 0) if c.size else 0
            stop = min(max(at.start + PATH, at.stop), len(prepared))
            window = prepared.samples(at.start, stop)
            if isinstance(prepared, SampleWindow) and prepared.part_of is not None:
                c = configurations(idm, prepared)[:, at.start : stop]
            else:
                labels = instants(prepared.run.name, window.time[known:])
                path = idm.path(window.q[known:].T.copy(), labels, c[:, -1] if c.size else None)
                c = np.hstack([c[:, c.shape[1] - known :], path])
            begin, end = at.start, stop
        yield window[at.start - begin : at.stop - begin], c[:, at.start - begin : at.stop - begin]


def instants(run: str, time: np.ndarray) -> Labels:
    """Label samples by time in messages."""
    return lambda sample: f"t = {time[sample]:.4f} s of run '{run}'"


def stop(q: np.ndarray, widths: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Follow positions by elements of some widths: friction before sliding (Prandtl and Ishlinskii; Maxwell slip).

    An element of width ``w`` holds ``z``, between -1 and 1: ``z <- clip(z + dq / w, -1, 1)``. It is a spring as long
    as the joint stays within ``w`` of where it stopped, and slips beyond, where ``z = sign(dq)``. Neither rate nor
    noise of the speed matters. Between its turning points a path is monotone, and ``z`` has a closed form.

    From positions ``q`` (N,) in the unit of the ``widths`` (w,) and states ``start`` (w,) at the first one it returns
    the states (w, N).
    """
    step = np.sign(np.diff(q))
    moved = np.flatnonzero(step)  # at rest a path keeps the direction of its last step
    turns = moved[1:][step[moved[1:]] * step[moved[:-1]] < 0]
    edges = np.concatenate([[0], turns, [len(q) - 1]])
    states = np.empty((len(edges), len(widths)))
    states[0] = start
    for k, way in enumerate(np.diff(q[edges])[:, None] / widths):
        states[k + 1] = np.minimum(np.maximum(states[k] + way, -1.0), 1.0)
    stretch = np.searchsorted(turns, np.arange(len(q)), side="right")
    way = (q - q[edges[stretch]]) / widths[:, None] + states.T.take(stretch, axis=1)
    return np.clip(way, -1.0, 1.0, out=way)
