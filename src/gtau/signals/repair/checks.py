"""Log checks: report safe repairs, refuse other faults.

Missing samples are interpolated, so that filters have a uniform grid, and marked as not valid, so that no
regression row uses them. The log is read in blocks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import compress
from typing import NamedTuple

import numpy as np

from gtau.errors import GtauError
from gtau.findings import Finding, Grade
from gtau.signals.reading.columns import LARGEST_RATE, LEAST_RATE
from gtau.signals.reading.notes import listed, reading
from gtau.signals.reading.samples import Samples, extremes
from gtau.signals.repair.clock import Clock, clock_of
from gtau.signals.repair.commands import (
    Ends,
    clipped,
    refuse_held,
    refuse_magnitudes,
    whole_numbers,
    window_of_commands,
)
from gtau.signals.repair.faults import find_glitches, glitch_note, refuse_frozen, refuse_slips, without_glitches
from gtau.signals.repair.gaps import Given, in_order
from gtau.signals.repair.resampling import POSITIONS, holds_of, uniform
from gtau.signals.storage import blocks, stored_like

FINER = {"ms": 1e3, "us": 1e6, "ns": 1e9}  # units of time in a second
# s; maximum lateness of the stamps of packets or messages. In the shared logs it is 5 ms (a polled Panda).
LATEST = 0.25
LARGEST_VALUE = 1e9  # of any logged value; even encoder and converter counts are smaller


class Checked(NamedTuple):
    """Checked samples on a uniform grid; ``valid`` (N, c) is False where a command was interpolated or clipped.

    Of the joints' commands as logged ``whole_share`` are whole numbers; a moving average over ``window`` (s) had
    smoothed them. The slowest held signal changes at the rate of ``updates`` (Hz).
    """

    samples: Samples
    valid: np.ndarray
    whole_share: float
    window: float | None
    updates: float


def check(samples: Samples, notes: list[Finding], given: Given = None) -> Checked:
    """Check the complete samples of a log, repair what is safe, and put them on a uniform grid.

    Repeated samples are dropped, angles that wrap around are unwrapped. Samples of a joint whose command is clipped at
    a limit are masked, and outliers of positions are interpolated. Irregular sampling is resampled at the mean rate:
    cubic splines for positions, lines for commands; see :mod:`gtau.signals.repair.clock` for the instants of the
    samples, unless the clock is ``given``. ``notes`` report every repair. Raises GtauError where values cannot be
    right, or too many are missing.
    """
    ends = extremes(samples.command)  # repairs leave them
    _refuse_stuck(samples, ends, notes)
    samples = in_order(samples, notes, given)
    clock = clock_of(samples.time, samples.position, given)
    _refuse_rates(samples, clock)
    if given is None and clock.late > max(LATEST, 3 * clock.period):
        raise GtauError(
            f"{samples.name}, column '{samples.columns[-1]}': by a regular clock of {clock.rate:.4g} Hz the time "
            f"stamps are up to {clock.late:.3g} s late, so they freeze or jump; correct the column, or give the rate "
            "instead (time: {rate: HZ})."
        )
    samples = _unwrapped(samples, notes)
    instants, holds = clock.instants(samples.time), holds_of(samples)
    if glitches := find_glitches(samples, instants, holds[POSITIONS]):
        notes.append(glitch_note(samples, glitches))
        samples = without_glitches(samples, glitches)
        clock = clock_of(samples.time, samples.position, given)
        instants, holds = clock.instants(samples.time), holds_of(samples)
    refuse_frozen(samples, instants, holds[POSITIONS])
    refuse_slips(samples, instants, holds[POSITIONS])
    refuse_held(samples, instants, holds, ends)
    refuse_magnitudes(samples, ends)
    clips = clipped(samples, ends, holds, notes)
    whole_share = whole_numbers(samples.command, len(samples.joints))  # resampled ones are between
    window = window_of_commands(samples.command, clock.rate)
    updates = clock.rate / max(held.period for held in holds.values())
    samples, valid = uniform(samples, clock, instants, holds, clips, notes, given is not None)
    return Checked(samples, valid, whole_share, window, updates)


def _refuse_stuck(samples: Samples, ends: Ends, notes: list[Finding]) -> None:
    n, time = len(samples.joints), samples.time
    low, high = (np.concatenate(pair) for pair in zip(extremes(samples.position), ends, strict=True))
    for column, least, most in zip(samples.columns, low, high, strict=False):
        if max(-least, most) > LARGEST_VALUE:
            value = most if most > -least else least
            raise GtauError(
                f"{samples.name}, column '{column}' reaches {value:.3g}, which is implausible for a joint or drive; "
                f"correct the column, or give its unit."
            )
    still = (low == high)[:n]
    if still.all():
        raise GtauError("no position ever changes; give a log of a moving robot.", source=samples.name)
    for channel, column, least, most in zip(samples.channels, samples.columns[n:-1], low[n:], high[n:], strict=True):
        if least < most or not channel.kind.measures_joint:
            continue
        if channel.kind.link_side or not still[channel.row]:  # a locked joint may have no current
            raise GtauError(
                f"{samples.name}, column '{column}' (joint '{channel.joint}') is stuck at {least + 0.0:g}; "
                "give the column with the measured values, or record the log again."
            )
    resting = (channel for channel, stands in zip(samples.channels, still, strict=False) if stands)
    if names := tuple(channel.joint for channel in resting if channel.kind.measures_joint):
        text = f"the position of {listed(names)} never changes: it yields no rows"
        kind, rest = "position that never changes", "joint at rest"
        notes.append(Finding(kind, names, text=text, grade=Grade.INFORMATION, shown_as=rest))
    if not time[-1] > time[0]:
        raise GtauError(
            f"{samples.name}, column '{samples.columns[-1]}' is {time[-1]:.9g} s in the last row and {time[0]:.9g} s "
            "in the first, so time does not advance; give the time column, or the rate instead (time: {rate: HZ})."
        )


def _unwrapped(samples: Samples, notes: list[Finding]) -> Samples:
    """Unwrap the angles of joints that jump by a full turn."""
    position = samples.position
    wraps = np.zeros(position.shape[1], dtype=bool)
    for part in blocks(position, before=1):
        jump = np.abs(np.diff(part, axis=0))
        wraps |= np.any(np.abs(jump - 2 * np.pi) < 0.5, axis=0)  # no joint moves a turn, or 6 m, between two samples
    if not wraps.any():
        return samples
    joints = tuple(compress(samples.joints, wraps))
    text = f"unwrapped the angle{'s' * (len(joints) > 1)} of {listed(joints)}, which jumped by a turn"
    notes.append(reading("unwrapped angle", text=text, joints=joints))

    def unwrapped() -> Iterator[np.ndarray]:
        turns = np.zeros(len(wraps))  # as far as the sample before
        for k, part in enumerate(blocks(position, before=1)):
            more = np.where(wraps, np.unwrap(part, axis=0), part) + turns
            turns = more[-1] - part[-1]
            yield more[min(k, 1) :]

    return replace(samples, position=stored_like(position, unwrapped()))


def _refuse_rates(samples: Samples, clock: Clock) -> None:
    if LEAST_RATE <= clock.rate <= LARGEST_RATE:
        return
    column = samples.columns[-1]
    finer = (unit for unit, factor in FINER.items() if LEAST_RATE <= clock.rate * factor <= LARGEST_RATE)
    repair = (
        "write the controller's rate in Hz under signals.time"
        if column == "rate"
        else f"give the unit of that column (units: {{time: {' or '.join(finer) or 's'}}}, for all logs; convert one "
        "that differs from the others)"
    )
    raise GtauError(
        f"by its '{column}' it is sampled at {clock.rate:.3g} Hz (steps of {clock.period:.3g} s), which is not a "
        f"plausible sampling rate; {repair}.",
        source=samples.name,
    )
