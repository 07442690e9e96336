"""Preparation of a run for model and estimators: q, qd, qdd, the command, and a mask."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np

from gtau.errors import GtauError
from gtau.findings import Finding, Grade
from gtau.signals.preparation import filters
from gtau.signals.preparation.bandwidth import JointSpectrum, spectra
from gtau.signals.preparation.filters import Preparation, valid_samples
from gtau.signals.run import Run
from gtau.signals.storage import block, spans, stored

PARTS = 2000  # of a run, used to find rests
CLOSE_TO_NYQUIST = 0.1  # of the sampling rate: bandwidths above are noted; speeds are then too small by 0.5 %
NOISY = 1e3  # signal-to-noise ratios below are noted: noise then adds more than 0.1 % to the speed's power


@dataclass(frozen=True, eq=False)
class SampleWindow:
    """Consecutive samples of a run in memory, ready for the model; arrays share the sample axis M.

    ``q``, ``qd``, ``qdd`` (M, n) in rad or m, s; ``command`` (M, c + 6 k), of the joints, then of the torque sensors,
    then of k wrenches, and its time derivatives ``command_d``, ``command_dd``, the columns of a delay. ``usable``
    (M, c) is False where a row must not be used: around the joint's reversals and rests, at gaps, at the ends of the
    filter, and always for a joint that does not move. ``time`` (M,) in s. It may be ``part_of`` another window, from
    the sample of this number on.
    """

    run: Run
    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    command: np.ndarray
    command_d: np.ndarray
    command_dd: np.ndarray
    usable: np.ndarray
    part_of: tuple[SampleWindow, int] | None = field(default=None, kw_only=True)

    def __len__(self) -> int:
        return len(self.time)

    @cached_property
    def paths(self) -> MutableMapping[object, np.ndarray]:
        """Configurations (n_c, N) of models along these samples, kept as long as both live."""
        return WeakKeyDictionary()

    def __getitem__(self, samples: slice) -> SampleWindow:
        return SampleWindow(self.run, *(getattr(self, name)[samples] for name in ARRAYS))

    def awake(self) -> tuple[np.ndarray, np.ndarray]:
        """Split the samples into parts at (parts + 1,) indices, and mark the parts in which a row is usable."""
        at = _parts(len(self))
        return at, np.array([bool(np.any(block(self.usable, *span))) for span in pairwise(at.tolist())])

    def samples(self, start: int = 0, stop: int | None = None) -> SampleWindow:
        """Return samples from ``start`` to before ``stop``."""
        stop = len(self) if stop is None else stop
        if stored(self.q) is None:
            return self if (start, stop) == (0, len(self)) else self[start:stop]
        return SampleWindow(self.run, *(block(getattr(self, name), start, stop) for name in ARRAYS))


ARRAYS = "time", "q", "qd", "qdd", "command", "command_d", "command_dd", "usable"


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """Prepared run; :meth:`samples` returns any part of it ready for the model.

    The samples ``kept`` are used, from the first motion to the last. ``moves`` (n,) marks joints that
    move; ``speeds`` (n, n) is the mean of ``qd qd^T`` over these samples, the reference of the joints' speed
    thresholds. ``motor_to_joint_speed`` (n_y, n) gives joint speeds from motor speeds; it is nonzero where a joint's
    friction appears in the motor's row: for the motor's own joint, and for others in coupled chains. ``peaks`` (PARTS,
    n) are the largest speeds in equal parts of the run; ``notes`` report omitted parts. ``cutoffs`` (Hz) of
    the position filter hold for each joint; if empty, the cut-off of the preparation holds for all.
    """

    run: Run
    preparation: Preparation
    kept: range
    moves: np.ndarray
    speeds: np.ndarray
    motor_to_joint_speed: np.ndarray
    peaks: np.ndarray
    notes: tuple[Finding, ...] = ()
    cutoffs: tuple[float | None, ...] = ()

    @cached_property
    def paths(self) -> MutableMapping[object, np.ndarray]:
        """Configurations (n_c, N) of models along the run, kept as long as both live."""
        return WeakKeyDictionary()

    @cached_property
    def all_samples(self) -> SampleWindow:
        """All samples, prepared once."""
        return self.samples()

    def __len__(self) -> int:
        return len(self.kept)

    @property
    def time(self) -> np.ndarray:
        """Instants of the samples that are used, (N,) in s."""
        return self.run.time[self.kept.start : self.kept.stop]

    @property
    def _cutoff(self) -> filters.Cutoff:
        return self.cutoffs or self.preparation.cutoff

    def awake(self) -> tuple[np.ndarray, np.ndarray]:
        """Split the used samples into parts at (parts + 1,) indices, and mark the parts in which a joint moves."""
        limit = self.preparation.speed_fraction * np.sqrt(np.diag(self.speeds))
        moving = ((self.peaks >= limit) & self.moves).any(axis=1)
        return np.clip(_parts(len(self.run.time)), self.kept.start, self.kept.stop) - self.kept.start, moving

    def valid(self, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Mark speeds and accelerations from valid samples only, (M, n), for the samples of :meth:`samples`."""
        at = self.kept[start:stop]
        return valid_samples(self.run, self.preparation, at.start, at.stop)

    def path(self, time: np.ndarray) -> np.ndarray:
        """Return positions (n, N) at consecutive samples, given by their times, without spurious reversals."""
        start = int(np.searchsorted(self.run.time, time[0]))
        return filters.smooth_path(self.run.position, self.run.rate, self._cutoff, start, start + len(time)).T

    def samples(self, start: int = 0, stop: int | None = None) -> SampleWindow:
        """Prepare the used samples from ``start`` to before ``stop``, with their neighbours."""
        at, run, preparation = self.kept[start:stop], self.run, self.preparation
        begin = max(0, at.start - filters.STENCIL)
        mine = slice(at.start - begin, at.stop - begin)
        q, qd, qdd = filters.position_filter(run.position, run.rate, self._cutoff, at.start, at.stop)
        command = block(run.command, begin, min(len(run.time), at.stop + filters.STENCIL))
        command, command_d, command_dd = (array[mine] for array in (command, *filters.differentiate(command, run.rate)))
        modelled = [channel for channel in run.channels if channel.kind.modelled]
        rows, c = [channel.row for channel in modelled], len(modelled)
        wrenches = [(frame, slice(c + 6 * k, c + 6 * k + 6)) for k, frame in enumerate(run.wrenches)]
        for frame, six in wrenches:
            if frame.body in run.base:
                continue
            # noise of other wrenches is on the model's side of the equations, as the positions' noise is
            along = filters.position_filter(run.command[:, six], run.rate, preparation.cutoff, at.start, at.stop)
            for array, filtered in zip((command, command_d, command_dd), along, strict=True):
                array[:, six] = filtered
        ratios = self.motor_to_joint_speed
        limit = preparation.speed_fraction * np.sqrt(np.einsum("yi,ij,yj->y", ratios, self.speeds, ratios))
        slow = np.abs(qd @ ratios.T) < limit
        rubbing = np.abs(ratios) > 1e-9
        # joints without friction may rest
        moving = ~(slow @ rubbing) & (self.moves | ~rubbing.any(axis=0))
        valid = self.valid(start, stop)
        # a wrench acts on all joints, one on a floating base on its rows alone
        usable = moving[:, rows] & valid[:, :c]
        base = np.array([not channel.kind.measures_joint for channel in modelled])
        for frame, six in wrenches:
            usable &= valid[:, six].all(axis=1, keepdims=True) | (frame.body in run.base) & ~base
        time = block(run.time, at.start, at.stop)
        return SampleWindow(run, time, q, qd, qdd, command, command_d, command_dd, usable)


def joined(windows: Sequence[SampleWindow]) -> SampleWindow:
    """Concatenate windows of a run."""
    if len(windows) == 1:
        return windows[0]
    arrays = (np.concatenate([getattr(window, name) for window in windows]) for name in ARRAYS)
    return SampleWindow(windows[0].run, *arrays)


def prepare(run: Run, preparation: Preparation, motor_to_joint_speed: np.ndarray | None = None) -> PreparedRun:
    """Find the moving part of a run: the rest at its beginning and end, where no joint is fast enough, is cut off.

    ``motor_to_joint_speed``, see :class:`PreparedRun`, is a joint of its own for each motor if left out. Nothing is
    decimated, as decimation is applied to the columns of the model. Raises GtauError where no joint moves, or the log
    is shorter than its filters.
    """
    samples, n, fraction = len(run.time), len(run.joints), preparation.speed_fraction
    joint_spectra = spectra(run)
    moves = np.array([spectrum.moves for spectrum in joint_spectra])
    edges, peaks = _parts(samples), np.zeros((PARTS, n))

    def speed(start: int, stop: int) -> np.ndarray:
        return filters.position_filter(run.position, run.rate, preparation.cutoff, start, stop)[1]

    def gram(start: int, stop: int) -> np.ndarray:
        qd = speed(start, stop)
        part = np.searchsorted(edges, np.arange(start, stop), side="right") - 1
        firsts = np.flatnonzero(np.diff(part, prepend=-1))
        peaks[part[firsts]] = np.maximum(peaks[part[firsts]], np.maximum.reduceat(np.abs(qd), firsts))
        return qd.T @ qd

    pieces = list(spans(samples))
    squares = [gram(*piece) for piece in pieces]
    limit = fraction * np.sqrt(np.diag(np.sum(squares, axis=0)) / samples)

    def awake(start: int, stop: int) -> np.ndarray:
        moving = (np.abs(speed(start, stop)) >= limit) & moves & valid_samples(run, preparation, start, stop)[:, :n]
        return start + np.flatnonzero(moving.any(axis=1))

    first = next((int(moving[0]) for piece in pieces if (moving := awake(*piece)).size), None)
    last = next((int(moving[-1]) for piece in reversed(pieces) if (moving := awake(*piece)).size), None)
    if first is None or last is None:
        edge = filters.filter_edge(run.rate, preparation.cutoff)
        given = "position_filter" in preparation.given
        remedy = "give a higher preparation.position_filter" if given else "give a longer log of a moving robot"
        raise GtauError(
            f"run '{run.name}': no joint moves between its filter margins ({edge} of {samples} samples at either "
            f"side); {remedy}."
        )
    kept = range(first, last + 1)
    ratios = np.eye(n) if motor_to_joint_speed is None else motor_to_joint_speed
    # Of the moving part alone, as rest lowers the rms speed that the threshold refers to.
    within = ((max(start, kept.start), min(stop, kept.stop)) for start, stop in pieces)
    parts = zip(pieces, within, squares, strict=True)
    moved = [known if part == piece else gram(*part) for piece, part, known in parts if part[0] < part[1]]
    speeds = np.sum(moved, axis=0) / len(kept)
    notes = tuple(_notes(run, joint_spectra, preparation, np.any(ratios, axis=0)))
    return PreparedRun(run, preparation, kept, moves, speeds, ratios, peaks, notes)


def _parts(samples: int) -> np.ndarray:
    """List the first samples of the parts of a run, and its end, (PARTS + 1,)."""
    return np.asarray(np.arange(PARTS + 1) * samples // PARTS)


def _notes(
    run: Run, joint_spectra: Sequence[JointSpectrum], preparation: Preparation, rubbing: np.ndarray
) -> Iterator[Finding]:
    noisy = dict[str, float]()  # per cent
    for joint, spectrum, rubs in zip(run.joints, joint_spectra, rubbing, strict=True):
        if spectrum.moves and spectrum.signal_to_noise < NOISY:
            noisy[joint] = 100 / float(np.sqrt(max(spectrum.signal_to_noise, 1)))
        elif rubs and not spectrum.moves:
            text = f"joint '{joint}' hardly moves: its rows are left out"
            yield Finding("joint at rest", (joint,), text=text, grade=Grade.INFORMATION)
    if noisy:
        shares = ", ".join(f"'{joint}' ({share:.0f} %)" for joint, share in noisy.items())
        text = f"position noise contributes much of the rms speed of {shares}: inertias are underestimated"
        advice = "move faster, or use --method iv or didim"
        yield Finding("noisy speeds", tuple(noisy), text=text, advice=advice, shown_as="position noise")
    if (bandwidth := preparation.bandwidth) > CLOSE_TO_NYQUIST * run.updates:
        nyquist = f"the Nyquist frequency, {run.updates / 2:.4g} Hz: speeds and accelerations are inaccurate"
        text = f"the bandwidth of the motion, {bandwidth:.3g} Hz, is close to {nyquist}"
        yield Finding("sampling rate", text=text, advice=f"log at {10 * bandwidth:.0f} Hz or more, or move more slowly")
