"""The decimated rows of a run, ``[W | V_tau]`` of eq. (20), streamed block by block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from idim.estimation.friction import term_columns
from idim.model.inverse_dynamics import PATH, InverseDynamics, Regressor
from idim.signals.decimation import Block, Decimator
from idim.signals.preparation import Prepared

FAST_SAMPLES = 1024  # of a block, before decimation: enough to amortise Python, and few enough to stay in the cache


@dataclass(frozen=True)
class Rows:
    """Rows of all joints at K output instants.

    ``time`` (K,) in s; ``keep`` (n, K); ``entries`` of the regressor (entries, K); ``currents``
    (3, n, K): the command and its first two time derivatives; ``terms`` (2, n, K), the columns of further
    friction; ``outputs`` their numbers in the run.
    ``condition`` is the largest condition number of the closures among the block's samples.
    """

    time: np.ndarray
    keep: np.ndarray
    entries: np.ndarray
    currents: np.ndarray
    terms: np.ndarray
    outputs: slice
    condition: float


def stream_rows(
    idm: InverseDynamics,
    regressor: Regressor,
    prepared: Prepared,
    decimator: Decimator,
    load: np.ndarray | None = None,
) -> Iterator[Rows]:
    """Evaluate ``regressor`` along a run and decimate it in parallel with the currents (section 3.1).

    Parameters
    ----------
    idm, regressor : InverseDynamics, Regressor
        The model, and the columns wanted of it.
    prepared, decimator : Prepared, Decimator
        The run, and its filter.
    load : ndarray, optional
        Values of the columns (columns,) that give the torques transmitted by the joints, for friction
        that depends on them; without it the command stands in for the torque, up to the drive gain.

    Raises
    ------
    IdimError
        Where the loops cannot be closed at a sample, or a pose is too close to a singularity.
    """
    n = len(prepared.time)
    size = max(FAST_SAMPLES, 8 * decimator.warm_up) // decimator.factor
    for block, c in _paths(idm, prepared, decimator.blocks(n, size)):
        at = block.samples
        first = at.start + block.first
        last = first + (block.outputs.stop - block.outputs.start - 1) * decimator.factor
        seen = slice(first - decimator.support, last + decimator.support + 1)
        qd, qdd = prepared.qd[at].T.copy(), prepared.qdd[at].T.copy()
        motion = idm.rates(c, qd, qdd, Labels(prepared.run.name, prepared.time[at]))
        currents = np.stack([prepared.command[at].T, prepared.command_d[at].T, prepared.command_dd[at].T])
        entries = regressor(idm.layout, motion)
        effort = currents[0] if load is None else regressor.torques(entries, load, len(idm.actuated))
        yield Rows(
            prepared.time[first : last + 1 : decimator.factor],
            decimator.keep(prepared.usable[seen]).T,
            decimator.apply(entries, block),
            decimator.apply(currents, block),
            decimator.apply(term_columns(qd, effort), block),
            block.outputs,
            float(motion.condition.max(initial=0.0)),
        )


def _paths(idm: InverseDynamics, prepared: Prepared, blocks: Iterable[Block]) -> Iterator[tuple[Block, np.ndarray]]:
    """The blocks, each with its configurations; loops are closed along longer stretches, which is faster."""
    begin, end = 0, 0  # the stretch that ``c`` is for
    c = np.zeros((idm.layout.n_c, 0))
    for block in blocks:
        at = block.samples
        if at.stop > end:
            more = slice(end, min(max(end + PATH, at.stop), len(prepared.time)))
            labels = Labels(prepared.run.name, prepared.time[more])
            path = idm.path(prepared.q[more].T.copy(), labels, c[:, -1] if end else None)
            c, begin, end = np.hstack([c[:, at.start - begin :], path]), min(at.start, end), more.stop
        yield block, c[:, at.start - begin : at.stop - begin]


@dataclass(frozen=True)
class Labels:
    """What messages call the samples of a run: its name and the time."""

    run: str
    time: np.ndarray

    def __getitem__(self, sample: int) -> str:
        return f"t = {self.time[sample]:.4f} s of run '{self.run}'"
