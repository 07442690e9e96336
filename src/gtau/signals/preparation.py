"""From a run to what the model and the estimators take: q, qd, qdd, the command, and a mask."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from gtau.errors import GtauError
from gtau.signals.bandwidth import JointSpectrum, spectra
from gtau.signals.decimation import MAX_FACTOR, Decimator, decimation_factor
from gtau.signals.filters import (
    STENCIL,
    cutoff_frequency,
    differentiate,
    filter_edge,
    filter_margin,
    position_filter,
)
from gtau.signals.notes import Kind, Note
from gtau.signals.run import Run
from gtau.signals.storage import block, spans, stored

SPEED_FRACTION = 0.05  # of a joint's rms speed
# Decimation widens what is left out around a reversal by two rows. Models of UR10e, TX40, xMate7 and xMate3 predict the
# same rows better by 2 to 7 % of the error where nine tenths of the samples are kept; but rows then hold more of the
# noise of the torques (the Panda's errors rise from 2.0 to 2.3 %, geometric mean), and the standard deviations of the
# Orthoglide's gains from 1.3 to 2.8 N/A.
KEPT = 0.85
FEWEST_ROWS = 200  # of a joint, in all runs together, that decimation leaves where there are so many
STRETCHES = 8  # parts of a long run that are looked at for that
LARGEST_FACTOR = 400
CLOSE_TO_NYQUIST = 0.1  # of the sampling rate: bandwidths above are noted; speeds are then too small by 0.5 %
NOISY = 1e3  # signal-to-noise ratios below are noted: noise then adds more than 0.1 % to the speed's power


@dataclass(frozen=True)
class Preparation:
    """How the runs of an experiment are prepared.

    Attributes
    ----------
    bandwidth, cutoff : float
        Of the motion and of the position filter (None: no filter), Hz.
    decimator : Decimator
        Of runs with this ``rate``; those with another one are decimated to the same rate of rows.
    speed_fraction : float
        A joint's row is left out where its speed is below this share of its rms speed.
    rate : float
        Sampling rate of the slowest run, Hz; 0 where that is not known.
    given : tuple of str
        What was set by hand, see :class:`gtau.signals.settings.PreparationSettings`.
    """

    bandwidth: float
    cutoff: float | None
    decimator: Decimator
    speed_fraction: float = SPEED_FRACTION
    rate: float = 0.0
    given: tuple[str, ...] = ()

    def at(self, rate: float) -> Preparation:
        """Adapt the preparation to runs with another sampling ``rate`` (Hz): the same filter and rate of rows."""
        if not self.rate or abs(rate / self.rate - 1) < 0.1:
            return self
        factor = max(1, round(self.decimator.factor * rate / self.rate))
        cutoff = self.cutoff
        if "position_filter" not in self.given:
            cutoff = max(10 * self.bandwidth, 5.0) if cutoff is None else cutoff
        if cutoff is not None and cutoff >= 0.4 * rate:
            cutoff = None
        return replace(self, cutoff=cutoff, decimator=replace(self.decimator, factor=factor), rate=rate)


@dataclass(frozen=True, eq=False)
class SampleWindow:
    """Consecutive samples of a run, ready for the model; arrays share the sample axis M.

    ``q``, ``qd``, ``qdd`` (M, n) in rad or m, s; ``command`` (M, c), of the joints and then of the torque sensors, and
    its time derivatives ``command_d``, ``command_dd``, the columns of a delay. ``usable`` (M, c) is False where a row
    must not be used: around the joint's reversals and rests, at gaps, at the ends of the filter, and
    always for a joint that does not move. ``time`` (M,) in s.
    """

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    command: np.ndarray
    command_d: np.ndarray
    command_dd: np.ndarray
    usable: np.ndarray

    def __getitem__(self, samples: slice) -> SampleWindow:
        return SampleWindow(*(getattr(self, field.name)[samples] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """A run of which any stretch can be had ready for the model, by :meth:`samples`.

    Attributes
    ----------
    run, preparation : Run, Preparation
        The run, and how it is prepared.
    kept : range
        Samples of the run that are used: those from the first motion to the last.
    moves : ndarray
        (n,) Whether a joint moves at all.
    speeds : ndarray
        (n, n) Mean of ``qd qd^T`` over these samples: what the joints' thresholds of speed refer to.
    friction_speed_ratios : ndarray
        (n_y, n) Speeds of joints whose friction acts in the rows of the motors for which the entry is not zero, from
        the motors' speeds; of each motor's own joint, and of others in coupled chains.
    notes : tuple of Note
        What was left out.
    """

    run: Run
    preparation: Preparation
    kept: range
    moves: np.ndarray
    speeds: np.ndarray
    friction_speed_ratios: np.ndarray
    notes: tuple[Note, ...] = ()

    def __len__(self) -> int:
        return len(self.kept)

    @property
    def time(self) -> np.ndarray:
        """Instants of the samples that are used, (N,) in s."""
        return self.run.time[self.kept.start : self.kept.stop]

    def needed(self, start: int, stop: int) -> range:
        """Find the samples of the run from which those from ``start`` to before ``stop`` are made."""
        at, margin = self.kept[start:stop], filter_margin(self.run.rate, self.preparation.cutoff)
        return range(max(0, at.start - margin), min(len(self.run.time), at.stop + margin))

    def valid(self, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Mark where speeds and accelerations rest on good samples only, (M, n), for the samples of :meth:`samples`."""
        at = self.kept[start:stop]
        return _valid(self.run, self.preparation, at.start, at.stop)

    def samples(self, start: int = 0, stop: int | None = None) -> SampleWindow:
        """Prepare samples from ``start`` to before ``stop`` of those that are used, their neighbours included."""
        at = self.kept[start:stop]
        run, preparation, begin = self.run, self.preparation, max(0, at.start - STENCIL)
        q, qd, qdd = position_filter(run.position, run.rate, preparation.cutoff, at.start, at.stop)
        command = block(run.command, begin, min(len(run.time), at.stop + STENCIL))
        mine = slice(at.start - begin, at.stop - begin)
        command_d, command_dd = (each[mine] for each in differentiate(command, run.rate))
        limit = preparation.speed_fraction * np.sqrt(
            np.einsum("yi,ij,yj->y", self.friction_speed_ratios, self.speeds, self.friction_speed_ratios)
        )
        slow = np.abs(qd @ self.friction_speed_ratios.T) < limit
        rubbing = np.abs(self.friction_speed_ratios) > 1e-9
        # joints without friction may rest
        moving = ~(slow @ rubbing) & (self.moves | ~rubbing.any(axis=0))
        usable = moving[:, run.measured_joints] & self.valid(start, stop)
        return SampleWindow(
            block(run.time, at.start, at.stop), q, qd, qdd, command[mine], command_d, command_dd, usable
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class InMemoryRun:
    """A run ready for the model along a motion that was made, all of it there; to be used as :class:`PreparedRun`."""

    run: Run
    all: SampleWindow

    def __len__(self) -> int:
        return len(self.all.time)

    def samples(self, start: int = 0, stop: int | None = None) -> SampleWindow:
        """Return samples from ``start`` to before ``stop``."""
        stop = len(self) if stop is None else stop
        if stored(self.all.q) is None:
            return self.all[start:stop]
        return SampleWindow(*(block(getattr(self.all, field.name), start, stop) for field in fields(SampleWindow)))


def choose_preparation(runs: Sequence[Run], decimator: Literal["fir", "chebyshev"] = "fir") -> Preparation:
    """Choose the preparation of an experiment from its runs; what their ``settings`` give is taken as it is.

    The bandwidth is the largest of all joints in all runs. The position filter follows from it and from where noise
    takes over, see :func:`gtau.signals.filters.cutoff_frequency`. The decimation leaves five rows in a period of the
    bandwidth, or more where it would lose more than 15 % of the samples around reversals and rests.

    Parameters
    ----------
    runs : sequence of Run
        All runs of the experiment; their rates may differ.
    decimator : {"fir", "chebyshev"}
        The compact FIR, or the paper's filter.

    Returns
    -------
    Preparation

    Raises
    ------
    GtauError
        No joint moves in a run, or a filter that is given is none at the rate of the slowest run.
    """
    settings = runs[0].settings
    slowest = min(run.rate for run in runs)
    found = [moving_spectra(run) for run in runs]
    moving = [each for of_run in found for each in of_run if each.moves]
    bandwidth = settings.bandwidth or max(each.bandwidth for each in moving)
    if settings.position_filter is not None:
        cutoff = _given_cutoff(settings.position_filter, slowest)
    else:
        end = max(each.end for each in moving) if settings.bandwidth is None else np.inf
        seconds = float(np.mean([len(run.time) / run.rate for run in runs]))
        cutoff = cutoff_frequency(bandwidth, end, slowest, seconds)
    fraction = SPEED_FRACTION if settings.least_speed is None else settings.least_speed
    chosen = Preparation(bandwidth, cutoff, Decimator(1, decimator), fraction, slowest, settings.given)
    if settings.decimation is not None:
        factor = settings.decimation
    elif decimator == "chebyshev":
        factor = decimation_factor(slowest, bandwidth)
    else:
        factor = _affordable(runs, found, chosen, decimation_factor(slowest, bandwidth, LARGEST_FACTOR))
    return replace(chosen, decimator=Decimator(factor, decimator))


def _given_cutoff(given: float | Literal["none"], rate: float) -> float | None:
    """Return a cut-off given by hand; raises GtauError where it is above half the ``rate`` (Hz) of the samples."""
    if given == "none":
        return None
    if given >= 0.5 * rate:
        raise GtauError(
            f"preparation.position_filter is {given:g} Hz, but logs sampled at {rate:.4g} Hz hold nothing above "
            f"{rate / 2:.4g} Hz; give a lower cut-off, or none."
        )
    return given


def moving_spectra(run: Run) -> tuple[JointSpectrum, ...]:
    """Compute spectra of the joints of a run; raises GtauError where none moves."""
    found = spectra(run)
    if not any(each.moves for each in found):
        raise GtauError(
            f"run '{run.name}': no joint's motion stands out from the noise of its position; leave the run out, or "
            "give a log of a moving robot."
        )
    return found


def _affordable(
    runs: Sequence[Run], found: Sequence[Sequence[JointSpectrum]], preparation: Preparation, most: int
) -> int:
    """Find the largest decimation, up to ``most``, that leaves the slowest run enough rows."""
    n = len(runs[0].joints)
    lengths: list[list[tuple[float, np.ndarray]]] = [[] for _ in range(n)]  # of usable stretches, and the run's rate
    for run, of_run in zip(runs, found, strict=True):
        moves = np.array([each.moves for each in of_run])
        for j, stretches in enumerate(_usable_stretches(run, preparation.at(run.rate))):
            if moves[j]:
                lengths[j].append((run.rate / preparation.rate, stretches))
    chosen = 1
    for factor in _factors(most):
        kept, total = np.zeros(n), np.zeros(n)
        for j in range(n):
            for ratio, stretches in lengths[j]:
                guard = Decimator(max(1, round(factor * ratio)), preparation.decimator.kind).guard
                kept[j] += np.maximum(stretches - 2 * guard, 0).sum() / ratio
                total[j] += stretches.sum() / ratio
        moving = total > 0
        if (kept[moving] / total[moving]).mean() < KEPT or (kept[moving] / factor).min() < FEWEST_ROWS:
            break
        chosen = factor
    return chosen


def _factors(most: int) -> Iterator[int]:
    """List every factor up to 20, and then steps of some 5 %, up to ``most``."""
    factor = 2
    while factor <= most:
        yield factor
        factor += max(1, factor // MAX_FACTOR)


def _usable_stretches(run: Run, preparation: Preparation) -> list[np.ndarray]:
    """List for each joint the lengths of stretches of valid samples in which it is fast enough."""
    parts = list(spans(len(run.time), 1 << 15))
    parts = [parts[k] for k in sorted({round(k) for k in np.linspace(0, len(parts) - 1, STRETCHES)})]
    speeds = [np.abs(position_filter(run.position, run.rate, preparation.cutoff, *part)[1]) for part in parts]
    limit = preparation.speed_fraction * np.sqrt(np.mean([np.mean(speed**2, axis=0) for speed in speeds], axis=0))
    found: list[list[np.ndarray]] = [[] for _ in run.joints]
    for speed, part in zip(speeds, parts, strict=True):
        usable = (speed >= limit) & _valid(run, preparation, *part)[:, : len(run.joints)]
        for j, of_joint in enumerate(found):
            edges = np.flatnonzero(np.diff(np.r_[False, usable[:, j], False]))
            of_joint.append(edges[1::2] - edges[::2])
    scale = len(run.time) / sum(stop - start for start, stop in parts)
    return [np.repeat(np.concatenate(of_joint), round(scale)) for of_joint in found]


def prepare(run: Run, preparation: Preparation, friction_speed_ratios: np.ndarray | None = None) -> PreparedRun:
    """Find where in a run its joints move.

    The rest at the beginning and the end, where no joint exceeds its speed threshold, is cut off.

    Parameters
    ----------
    run : Run
        One run.
    preparation : Preparation
        Of its experiment.
    friction_speed_ratios : ndarray, optional
        See :class:`PreparedRun`; a joint of its own for each motor if left out.

    Returns
    -------
    Prepared
        Not decimated: the decimator takes the columns of the model.

    Raises
    ------
    GtauError
        No joint moves, or the log is shorter than its filters.
    """
    samples, n = len(run.time), len(run.joints)
    found = spectra(run)
    moves = np.array([each.moves for each in found])

    def speed(start: int, stop: int) -> np.ndarray:
        return position_filter(run.position, run.rate, preparation.cutoff, start, stop)[1]

    def gram(start: int, stop: int) -> np.ndarray:
        qd = speed(start, stop)
        return qd.T @ qd

    pieces = list(spans(samples))
    squares = [gram(*piece) for piece in pieces]
    limit = preparation.speed_fraction * np.sqrt(np.diag(np.sum(squares, axis=0)) / samples)

    def awake(start: int, stop: int) -> np.ndarray:
        moving = (np.abs(speed(start, stop)) >= limit) & moves & _valid(run, preparation, start, stop)[:, :n]
        return start + np.flatnonzero(moving.any(axis=1))

    first = next((int(found[0]) for found in (awake(*piece) for piece in pieces) if found.size), None)
    last = next((int(found[-1]) for found in (awake(*piece) for piece in reversed(pieces)) if found.size), None)
    if first is None or last is None:
        edge = filter_edge(run.rate, preparation.cutoff)
        raise GtauError(
            f"run '{run.name}': no joint moves between its filters' ends ({edge} of {samples} samples at either "
            "side); give a longer log of a moving robot."
        )
    kept = range(first, last + 1)
    ratios = np.eye(n) if friction_speed_ratios is None else friction_speed_ratios
    # Of the moving part alone, as rest lowers the rms speed that the threshold refers to.
    within = [(max(start, kept.start), min(stop, kept.stop)) for start, stop in pieces]
    moved = [
        known if part == piece else gram(*part)
        for piece, part, known in zip(pieces, within, squares, strict=True)
        if part[0] < part[1]
    ]
    return PreparedRun(
        run=run,
        preparation=preparation,
        kept=kept,
        moves=moves,
        speeds=np.sum(moved, axis=0) / len(kept),
        friction_speed_ratios=ratios,
        notes=tuple(_notes(run, found, preparation, np.any(ratios, axis=0))),
    )


def _notes(run: Run, found: Sequence[JointSpectrum], preparation: Preparation, rubbing: np.ndarray) -> Iterator[Note]:
    """List what a user should know of the motion and its noise."""
    noisy = []
    for joint, each, rubs in zip(run.joints, found, rubbing, strict=True):
        if not each.moves and not rubs:
            continue
        if not each.moves:
            yield Note(Kind.REST, f"joint '{joint}' hardly moves: its rows are left out", joint=joint)
        elif each.signal_to_noise < NOISY:
            noisy.append(f"'{joint}' ({100 / np.sqrt(max(each.signal_to_noise, 1)):.0f} %)")
    if noisy:
        what = (
            f"noise of the position makes up a good part of the rms speed of joint{'s' * (len(noisy) > 1)} "
            f"{', '.join(noisy)}: inertias come out too small"
        )
        yield Note(Kind.NOISE, what, "move faster, or use --method iv or didim")
    if preparation.bandwidth > CLOSE_TO_NYQUIST * run.rate:
        what = (
            f"the bandwidth of the motion, {preparation.bandwidth:.3g} Hz, is close to the Nyquist frequency, "
            f"{run.rate / 2:.4g} Hz: speeds and accelerations are inaccurate"
        )
        yield Note(Kind.RATE, what, f"log at {10 * preparation.bandwidth:.0f} Hz or more, or move more slowly")


def _valid(run: Run, preparation: Preparation, start: int, stop: int) -> np.ndarray:
    """Mark where speeds and accelerations rest on good samples only (stop - start, n)."""
    samples, edge = len(run.time), filter_edge(run.rate, preparation.cutoff)
    begin, end = max(0, start - STENCIL), min(samples, stop + STENCIL)
    bad = ~block(run.valid, begin, end)
    bad = np.pad(bad, ((STENCIL - start + begin, STENCIL - end + stop), (0, 0)))
    near = np.any([bad[k : k + stop - start] for k in range(2 * STENCIL + 1)], axis=0)
    number = np.arange(start, stop)
    return ~near & ((number >= edge) & (number < samples - edge))[:, None]
