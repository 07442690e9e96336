"""Checks of a log: what is safe is repaired and said, the rest is refused.

A sample that is missing, for whatever reason, is interpolated, so that filters have a uniform grid to
work on, and marked as not valid, so that no row of an identification rests on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from idim.errors import IdimError

MIN_SAMPLES = 100
MAX_MISSING = 0.05  # part of a log that may be bad or missing
MAX_GAP = 0.1  # s; longer ones cannot be bridged without inventing a motion
MISSING_STEP = 1.5  # steps longer than so many mean steps have lost a sample
SLIP = 20.0  # times what 99.9 % of the samples show: a change of speed between two samples that is no motion
SLIP_SPEED = 0.5  # and in shares of the joint's speed
CLIPPED_RUN = 3  # samples in a row at the extreme value
PILE_UP = 5.0  # times as many samples at the extreme value as at the one next to it
MAX_CLIPPED = 0.1


@dataclass(frozen=True)
class Samples:
    """The samples of a log as they stand in it, SI units.

    ``time`` (N,), ``position`` and ``command`` (N, n); ``rows`` (N,) are their rows in the file, the
    first of which stands in ``first_line``. ``columns`` are the names of the position columns, the
    command columns and the time column.
    """

    source: str
    joints: tuple[str, ...]
    columns: tuple[str, ...]
    texts: dict[str, str]
    time: np.ndarray
    position: np.ndarray
    command: np.ndarray
    rows: np.ndarray
    first_line: int = 1
    line_word: str = "line"

    def place(self, sample: int) -> str:
        """Where a sample stands in the file."""
        return f"{self.line_word} {self.rows[sample] + self.first_line}"

    def select(self, kept: np.ndarray) -> Samples:
        """The samples where `kept` (N,) is true."""
        return replace(
            self,
            time=self.time[kept],
            position=self.position[kept],
            command=self.command[kept],
            rows=self.rows[kept],
        )


@dataclass(frozen=True)
class UniformSamples:
    """Samples on a uniform grid; where ``valid`` (N,) is false they were interpolated over missing ones."""

    time: np.ndarray
    position: np.ndarray
    command: np.ndarray
    valid: np.ndarray
    notes: tuple[str, ...]


def check(samples: Samples) -> UniformSamples:
    """Check a log, repair what is safe, and put it on a uniform grid.

    Samples that are incomplete or repeated are dropped, angles that wrap around are unwrapped. Samples
    whose command is clipped at a limit are masked. Irregular sampling is resampled at the mean rate: cubic
    splines for positions, lines for commands. Steps of more than 1.5 mean steps are gaps.

    Parameters
    ----------
    samples : Samples
        The log.

    Returns
    -------
    UniformSamples
        With a note on every repair.

    Raises
    ------
    IdimError
        The log has fewer than 100 samples, more than 5 % of them bad or missing, a gap of more than
        0.1 s (or three steps), reversed time, a command that never changes or is clipped in more than a
        tenth of the samples, a position that jumps, or no moving joint.
    """
    notes: list[str] = []
    _refuse_short(samples)
    samples = _drop_bad(samples, notes)
    _refuse_stuck(samples, notes)
    samples = _drop_repeated(samples, notes)
    samples = _unwrap(samples, notes)
    _refuse_slips(samples)
    return _uniform(samples, _clipped(samples, notes), notes)


def _refuse_short(samples: Samples) -> None:
    if len(samples.time) < MIN_SAMPLES:
        raise IdimError(
            f"{samples.source} has {len(samples.time)} samples; an identification needs a log of some seconds "
            f"(at least {MIN_SAMPLES} samples)."
        )


def _drop_bad(samples: Samples, notes: list[str]) -> Samples:
    values = np.column_stack([samples.position, samples.command, samples.time])
    finite = np.isfinite(values)
    for column, good in zip(samples.columns, finite.T, strict=True):
        if not good.any():
            entry = samples.texts.get(column, "")
            raise IdimError(
                f"{samples.source}, column '{column}' holds no number"
                + (f" (it begins with '{entry}')" if entry else "")
                + "; give the column that holds them."
            )
    kept = finite.all(axis=1)
    bad = np.flatnonzero(~kept)
    if not bad.size:
        return samples
    if bad.size > MAX_MISSING * len(kept):
        column = samples.columns[int(np.argmin(finite[bad[0]]))]
        entry = samples.texts.get(column, "")
        raise IdimError(
            f"{samples.source} has {bad.size} of {len(kept)} rows with missing or non-numeric values (first in "
            f"{samples.place(bad[0])}, column '{column}'" + (f": '{entry}'" if entry else "") + "); record it again."
        )
    notes.append(f"dropped {_count(bad.size, 'row')} with missing or non-numeric values ({_places(samples, bad)})")
    return samples.select(kept)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _places(samples: Samples, which: np.ndarray) -> str:
    listed = ", ".join(str(samples.rows[i] + samples.first_line) for i in which[:5])
    return f"{samples.line_word}{'s' * (which.size > 1)} {listed}{', ...' if which.size > 5 else ''}"


def _refuse_stuck(samples: Samples, notes: list[str]) -> None:
    n = len(samples.joints)
    still = np.ptp(samples.position, axis=0) == 0
    if still.all():
        raise IdimError(f"{samples.source}: no position ever changes; give a log of a moving robot.")
    for joint, column in zip(samples.joints, samples.columns[n : 2 * n], strict=True):
        stuck = samples.command[:, samples.joints.index(joint)]
        if np.ptp(stuck) == 0:
            raise IdimError(
                f"{samples.source}, column '{column}' (joint '{joint}') is stuck at {stuck[0]:g}; "
                "give the column with the measured values, or record the log again."
            )
    if still.any():
        names = _quoted([joint for joint, s in zip(samples.joints, still, strict=True) if s])
        notes.append(f"the position of joint {names} never changes: it yields no rows")


def _quoted(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _drop_repeated(samples: Samples, notes: list[str]) -> Samples:
    step = np.diff(samples.time)
    if (step < 0).any():
        i = int(np.argmax(step < 0))
        raise IdimError(
            f"{samples.source}, {samples.place(i + 1)}: time goes back from {samples.time[i]:.9g} s to "
            f"{samples.time[i + 1]:.9g} s; cut the log there into two runs, or correct the time column."
        )
    repeated = np.r_[False, step == 0]
    if not repeated.any():
        return samples
    values = np.column_stack([samples.position, samples.command])
    different = repeated & np.r_[False, (np.diff(values, axis=0) != 0).any(axis=1)]
    if different.any():
        i = int(np.argmax(different))
        raise IdimError(
            f"{samples.source}, {samples.place(i)}: the time {samples.time[i]:.9g} s stands in two rows with different "
            "values; log the time with more digits, or give the rate instead (time: {rate: HZ})."
        )
    which = np.flatnonzero(repeated)
    notes.append(f"dropped {_count(which.size, 'repeated row')} ({_places(samples, which)})")
    samples = samples.select(~repeated)
    _refuse_short(samples)
    return samples


def _unwrap(samples: Samples, notes: list[str]) -> Samples:
    jump = np.abs(np.diff(samples.position, axis=0))
    wraps = np.any(np.abs(jump - 2 * np.pi) < 0.5, axis=0)  # no joint moves a turn, or 6 m, between two samples
    if not wraps.any():
        return samples
    names = _quoted([joint for joint, wrap in zip(samples.joints, wraps, strict=True) if wrap])
    notes.append(f"unwrapped the angle of joint {names}, which jumped by a turn")
    return replace(samples, position=np.where(wraps, np.unwrap(samples.position, axis=0), samples.position))


def _refuse_slips(samples: Samples) -> None:
    """Refuse a position that jumps between two samples, as after a slipped coupling or lost counts."""
    step = np.diff(samples.time)
    speed = np.diff(samples.position, axis=0) / step[:, None]
    change = speed[1:-1] - (speed[:-2] + speed[2:]) / 2
    whole = step <= MISSING_STEP * np.median(step)
    change[~(whole[:-2] & whole[1:-1] & whole[2:])] = 0.0
    usual = np.quantile(np.abs(change), 0.999, axis=0)
    fast = np.quantile(np.abs(speed), 0.999, axis=0)
    slips = (np.abs(change) > SLIP * usual) & (np.abs(change) > SLIP_SPEED * fast)
    for j in np.flatnonzero(slips.any(axis=0)):
        k = int(np.argmax(np.abs(change[:, j])))
        raise IdimError(
            f"{samples.source}, {samples.place(k + 2)}: the position of joint '{samples.joints[j]}' jumps by "
            f"{change[k, j] * step[k + 1]:.3g} (rad or m) at {samples.time[k + 2]:.9g} s, which is no motion; check "
            "the coupling and the counter of its encoder, or cut the log there into two runs."
        )


def _clipped(samples: Samples, notes: list[str]) -> np.ndarray:
    """Where a command stands at its extreme value although its joint moves (N,), as behind a limit of the drive."""
    speed = np.abs(np.diff(samples.position, axis=0, prepend=samples.position[:1]))
    moving = speed > 0.05 * np.sqrt(np.mean(speed**2, axis=0))
    clipped = np.zeros(len(samples.time), dtype=bool)
    for j, joint in enumerate(samples.joints):
        for sign in (1.0, -1.0):
            command = sign * samples.command[:, j]
            levels = np.sort(command)
            at = command == levels[-1]
            beside = int((command == levels[len(levels) - 1 - at.sum()]).sum()) if not at.all() else 0
            edges = np.flatnonzero(np.diff(np.r_[False, at & moving[:, j], False]))
            longest = np.max(edges[1::2] - edges[::2], initial=0)
            if longest < CLIPPED_RUN or at.sum() < PILE_UP * beside:
                continue
            if at.sum() > MAX_CLIPPED * len(at):
                raise IdimError(
                    f"{samples.source}: the command of joint '{joint}' is clipped at {sign * levels[-1]:.4g} in "
                    f"{at.sum()} of {len(at)} samples; record it again with slower motions or a higher limit of the "
                    "drive."
                )
            masked = _count(int(at.sum()), "sample")
            notes.append(f"the command of joint '{joint}' is clipped at {sign * levels[-1]:.4g}: masked {masked}")
            clipped |= at
    return clipped


def _uniform(samples: Samples, masked: np.ndarray, notes: list[str]) -> UniformSamples:
    time, period, regular = _grid(samples.time)
    step = np.diff(time)
    _refuse_gaps(samples, step, period)
    n = round((time[-1] - time[0]) / period) if regular else int((time[-1] - time[0]) / period)
    grid = time[0] + period * np.arange(n + 1)
    if regular and n + 1 == len(time):
        return UniformSamples(grid, samples.position, samples.command, ~masked, tuple(notes))

    from scipy.interpolate import CubicSpline

    # Lines for the commands: a spline would overshoot where the current is noisy.
    position = CubicSpline(time, samples.position)(grid)
    command = np.column_stack([np.interp(grid, time, each) for each in samples.command.T])
    before = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, len(step) - 1)
    near = np.minimum(np.abs(grid - time[before]), np.abs(time[before + 1] - grid)) < 0.01 * period
    valid = near | (step[before] <= MISSING_STEP * period)
    clear = ~(masked[before] | masked[before + 1])
    missing = int((~valid).sum())
    if missing > MAX_MISSING * len(grid):
        raise IdimError(
            f"{samples.source} lacks {missing} of {len(grid)} samples (steps of {step.min() * 1e3:.3g} to "
            f"{step.max() * 1e3:.3g} ms); record it at a steady rate."
        )
    if missing:
        notes.append(f"interpolated and masked {_count(missing, 'missing sample')}")
    if not regular:
        notes.append(
            f"resampled from irregular steps of {step.min() * 1e3:.3g} to {step.max() * 1e3:.3g} ms "
            f"to a uniform {1 / period:.2f} Hz"
        )
    return UniformSamples(grid, position, command, valid & clear, tuple(notes))


def _grid(time: np.ndarray) -> tuple[np.ndarray, float, bool]:
    """Instants of the samples, the mean period, and whether they are multiples of it.

    They are when they leave the straight line by no more than the rounding of the time column, and
    then the line is the better clock.
    """
    step = np.diff(time)
    number = np.r_[0.0, np.cumsum(np.maximum(np.round(step / np.median(step)), 1.0))]
    elapsed = time - time[0]
    period, offset = np.polyfit(number, elapsed, 1)
    line = period * number + offset
    if np.abs(elapsed - line).max() <= max(1e-3 * period, min(_resolution(elapsed), 0.5 * period)):
        return time[0] + line - line[0], float(period), True
    return time, float(period), False


def _resolution(elapsed: np.ndarray) -> float:
    """Last decimal of a time column, s; a microsecond where it is finer, which no motion notices."""
    for digits in range(6):
        scaled = elapsed * 10**digits
        # A clock that counts from 1970 is right to 2e-7 s in a float.
        if np.abs(scaled - np.round(scaled)).max() < 0.03:
            return 10.0**-digits
    return 1e-6


def _refuse_gaps(samples: Samples, step: np.ndarray, period: float) -> None:
    longest = int(np.argmax(step))
    if step[longest] > max(MAX_GAP, 3 * period):
        raise IdimError(
            f"{samples.source}, {samples.place(longest)}: {step[longest]:.3g} s are missing after "
            f"{samples.time[longest]:.9g} s; cut the log there into two runs."
        )
