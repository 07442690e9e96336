"""Faults of logged commands: drives that were off, values that stay, rounded, clipped or without sign."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from gtau.errors import GtauError
from gtau.findings import Finding, counted, percent
from gtau.signals.channel import SideValues
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.formats import listed_joints
from gtau.signals.reading.samples import Ends, Samples, extremes
from gtau.signals.repair.resampling import FROZEN, JUMP, POSITIONS, Clips, Holds, long_runs
from gtau.signals.storage import block, blocks, spans, steps

# A command stays where it is equal for more than FROZEN samples, twice as long as held signals are, and STAYS (s),
# while its joint covers MOVED of its range.
STAYS, MOVED = 0.1, 0.02
# It is then a fault where it jumps by JUMP of its steps before or after that, as a slow one that is rounded changes by
# one, or where it stays ALONE times as long as at any other time. Zeros, which may be the dead band of a sensor that
# reversals pass again and again, must be of all moving joints or ALONE times as long as other zeros, too.
ALONE = 4.0
# Noise of motors that are off, over the largest command of each joint; all moving joints must then be off together, and
# log finer steps than that: coarse ones are zero about each reversal.
OFF = 0.02
COARSE = 20.0  # steps in the range of a coarse command, whose plateaus are no limits, and which jumps by its steps
MOVING = 50.0  # steps of an encoder; a joint that covers less rests, and its command is noise


class Spell(NamedTuple):
    """Samples of a channel with one ``value``; ``jump`` is the larger change of the command at both ends."""

    channel: int
    begin: int
    end: int
    value: float
    jump: float

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.end - self.begin

    def beside(self, other: Spell) -> bool:
        """Decide whether another spell overlaps, and is one of zeros if this one is."""
        return other.begin < self.end and self.begin < other.end and (other.value == 0) == (self.value == 0)

    def outlasts(self, others: list[Spell]) -> bool:
        """Decide whether it is ALONE times as long as any of the other spells."""
        return all(ALONE * other.samples < self.samples for other in others if other is not self)


def refuse_held(samples: Samples, instants: np.ndarray, holds: Holds, ends: Ends) -> None:
    """Refuse commands that stay at a value while their joints move: motors that are off, columns that freeze."""
    channels, (first, last) = samples.channels, extremes(samples.position)
    equal: dict[int, list[Spell]] = {}
    for spell in _spells(samples, np.zeros(len(channels))):
        equal.setdefault(spell.channel, []).append(spell)

    def in_motion(spell: Spell) -> bool:
        channel = channels[spell.channel]
        row, lasts = channel.row, instants[spell.end - 1] - instants[spell.begin]
        if lasts <= STAYS or spell.samples <= 2 * holds[channel.kind.group].longest:
            return False
        low, high = extremes(samples.position[spell.begin : spell.end, row : row + 1])
        return bool(high[0] - low[0] > MOVED * (last - first)[row])

    spells = {j: list(filter(in_motion, spells)) for j, spells in equal.items()}
    acting = [j for j, channel in enumerate(channels) if channel.kind.measures_joint and not channel.kind.link_side]
    moving = [j for j in acting if last[channels[j].row] > first[channels[j].row]]
    coarse, quanta = _coarse_steps(holds, ends), _quanta(holds)

    def at_fault(spell: Spell) -> bool:
        j = spell.channel
        if spell.value != 0 and spell.value in (ends[0][j], ends[1][j]):
            return False  # a limit
        if spell.outlasts(equal[j]):
            return spell.samples > ALONE * FROZEN
        if coarse[j] or spell.jump < JUMP * quanta[j]:
            return False
        together = len(moving) > 1 and all(any(map(spell.beside, spells.get(k, ()))) for k in moving)
        return spell.value != 0 or together or spell.outlasts([other for other in spells[j] if other.value == 0])

    held = list(filter(at_fault, chain(*spells.values())))
    noise = OFF * np.maximum(-ends[0], ends[1])
    off = [spell for spell in _spells(samples, noise) if in_motion(spell)]
    off = [spell for spell in off if spell.value == 0 and noise[spell.channel] > quanta[spell.channel]]
    if len(moving) > 1:
        held += [one for one in off if all(any(one.beside(k) for k in off if k.channel == j) for j in moving)]
    if held:
        raise GtauError(_stays(samples, held))


def _stays(samples: Samples, held: list[Spell]) -> str:
    parts: list[Spell] = []
    for spell in sorted(held, key=lambda spell: -spell.samples):
        if not parts or ((spell.value == 0) == (parts[0].value == 0) and not any(map(spell.beside, parts))):
            parts.append(spell)
    parts.sort(key=lambda spell: spell.begin)
    spell, channels, time = parts[0], samples.channels, samples.time
    names = dict.fromkeys(channels[other.channel].joint for other in held if any(map(other.beside, parts)))
    ends_at = ["the end" if part.end == len(time) else f"{time[part.end]:.9g} s" for part in parts]
    times = [f"from {time[part.begin]:.9g} s to {end}" for part, end in zip(parts, ends_at, strict=True)]
    remedy = f"that part out ({samples.without(spell.begin, spell.end)})"
    if len(parts) > 1:
        remedy = "those parts out (one run of that log for each part between them)"
    return (
        f"{samples.name}, {samples.place(spell.begin)}: the {channels[spell.channel].kind.name} of "
        f"{listed_joints([*names])} stays at {spell.value + 0.0:.6g} "
        f"{' and '.join(times)} in full motion: {'it was not read' if spell.value else 'the motors were off'}; leave "
        f"{remedy}."
    )


def _spells(samples: Samples, noise: np.ndarray) -> Iterator[Spell]:
    """Yield the spells of more than FROZEN equal commands; commands below the ``noise`` (c,) of theirs count as 0."""
    command, last = samples.command, len(samples.time) - 1

    def value(k: int, j: int) -> float:
        return float(command[k, j]) if abs(command[k, j]) >= noise[j] else 0.0

    for j, begin, end in long_runs(command, noise):
        if samples.channels[j].kind.measures_joint:
            here, before, after = (value(k, j) for k in (begin, max(begin - 1, 0), min(end, last)))
            yield Spell(j, begin, end, here, max(abs(before - here), abs(after - here)))


def _quanta(holds: Holds) -> np.ndarray:
    return np.concatenate([held.quanta for group, held in holds.items() if group != POSITIONS])


def _coarse_steps(holds: Holds, ends: Ends) -> np.ndarray:
    """Compute the steps (c,) of the commands that take few values, 0 for others."""
    quanta, (low, high) = _quanta(holds), ends
    return np.where((low < high) & (high - low < COARSE * quanta), quanta, 0.0)


REVERSING = 1.5  # travel of a joint over its range; a motion in one direction has 1
NEAR_ZERO = 0.02  # smallest over largest magnitude; no joint of nine robots is unsigned in 23 shared logs
TOUCHING = 0.5  # of the joints: others hold against gravity
UNSIGNED = (
    "never negative although joints reverse, so the columns hold magnitudes; log signed values (some drives store the "
    "sign in a separate bit or column)"
)


def refuse_magnitudes(samples: Samples, ends: Ends) -> None:
    """Refuse commands without sign: of joints that reverse none is ever negative, half come near zero."""
    low, high = (column[: len(samples.joints)] for column in ends)
    travel = np.sum([np.abs(step).sum(axis=0) for step in steps(samples.position)], axis=0)
    first, last = extremes(samples.position)
    acting = (high > low) & (last > first)
    reversing = travel > REVERSING * (last - first)
    unsigned, touching = ((low >= 0) & reversing)[acting], (low <= NEAR_ZERO * high)[acting]
    if acting.any() and unsigned.all() and touching.mean() >= TOUCHING:
        raise GtauError(f"its commands are {UNSIGNED}.", source=samples.name)


def whole_numbers(command: np.ndarray, joints: int) -> float:
    """Compute the share of the commands (N, c) of the first ``joints`` that are whole numbers."""
    parts = (part[:, :joints] for part in blocks(command))
    return sum(int(np.sum(part == np.round(part))) for part in parts) / (len(command) * joints)


# A moving average of white noise: third differences have a correlation of -0.5 over the window, 0 over two, and 1/3 one
# sample beside it, and no larger one at any other lag.
AVERAGED, TWICE = -0.35, 0.1
SHORTEST, LONGEST, FEWEST = 0.05, 2.0, 8  # s, s, samples: shorter ones take little of a motion, or are a noise's colour
USED = 1 << 16  # samples


def window_of_commands(command: np.ndarray, rate: float) -> float | None:
    """Find the window (s) of the moving average that commands (N, c) are behind; None where they are behind none."""
    changes = np.diff(block(command, 0, min(len(command), USED)), 3, axis=0)
    changes = changes[:, np.median(np.abs(changes), axis=0) > 0.1 * changes.std(axis=0)]  # held values have peaks
    if not changes.size:
        return None
    power = np.abs(np.fft.rfft(changes, 2 * len(changes), axis=0)) ** 2
    correlation = np.fft.irfft(power, axis=0)[: len(changes)]
    rho = np.median(correlation / correlation[0], axis=1)
    lags = range(FEWEST, min(len(rho) // 4, round(LONGEST * rate)))
    window = max(lags, key=lambda lag: abs(rho[lag]), default=0)
    if window < round(SHORTEST * rate) or rho[window] > AVERAGED:
        return None
    sharp = min(rho[window - 1], rho[window + 1]) > 0 and abs(rho[2 * window]) < TWICE  # a motion is not
    return window / rate if sharp else None


CLIPPED_RUN = 3  # samples in a row at the extreme value
PILE_UP = 5.0  # times as many samples at the extreme value as at the one next to it
MAX_CLIPPED = 0.1


def clipped(samples: Samples, ends: Ends, holds: Holds, notes: list[Finding]) -> Clips:
    """Find joints whose commands saturate while they move, as at a drive limit, with the levels; note coarse ones."""
    count = len(samples.time)
    clips = list[tuple[int, float]]()
    coarse = _coarse_steps(holds, ends).tolist()
    first, last = extremes(samples.position)
    travels = last - first > MOVING * holds[POSITIONS].quanta
    for j, (channel, low, high) in enumerate(zip(samples.channels, *ends, strict=True)):
        if low == high or not channel.kind.measures_joint:
            continue
        joints, what = (channel.joint,), f"the {channel.kind.name} of joint '{channel.joint}'"
        if coarse[j] and low != 0:  # whether zeros are magnitudes is judged below
            if travels[channel.row]:
                number, advice = round((high - low) / coarse[j]), "log it with more digits"
                text = f"{what} is rounded to steps of {coarse[j]:.3g}, and its range holds only {number} of them"
                notes.append(Finding("coarse command", joints, text=text, advice=advice))
            continue
        for level in (float(high), float(low)):
            at, beside = _counts_at(samples.command, j, level)
            if at < max(CLIPPED_RUN, PILE_UP * beside) or not _moves_at(samples, j, channel.row, level):
                continue
            if at > MAX_CLIPPED * count and level == low == 0.0:
                raise GtauError(f"{what} is {UNSIGNED}.", source=samples.name)
            if at > MAX_CLIPPED * count:
                raise GtauError(
                    f"{what} is clipped at {level:.4g} in {at} of {count} samples; record it again "
                    f"with slower motions or a higher limit of the drive.",
                    source=samples.name,
                )
            text = f"{what} is clipped at {level:.4g}: masked {counted(at, 'sample')}"
            advice = "log again with smaller accelerations, or a higher limit of the drive"
            notes.append(Finding("clipped command", joints, text=text, advice=advice, share=at / count))
            clips.append((j, level))
    return clips


def _counts_at(command: np.ndarray, j: int, level: float) -> tuple[int, int]:
    at, beside, nearest = 0, 0, np.inf
    for part in blocks(command):
        away = np.abs(part[:, j] - level)
        at += int(np.count_nonzero(away == 0))
        least = away.min(where=away > 0, initial=np.inf)
        if least < nearest:
            nearest, beside = least, 0
        beside += int(np.count_nonzero(away == nearest))
    return at, beside


def _moves_at(samples: Samples, j: int, mover: int, level: float) -> bool:
    """Decide whether joint j moves for CLIPPED_RUN samples in which its command is at ``level``."""
    position, command, count = samples.position, samples.command, len(samples.time)
    least = 0.05 * np.sqrt(sum(np.sum(step[:, mover] ** 2) for step in steps(position)) / count)
    for start, stop in spans(count, before=CLIPPED_RUN):
        speed = np.abs(np.diff(block(position, start, stop)[:, mover]))
        at = (block(command, start, stop)[1:, j] == level) & (speed > least)
        if np.any(np.convolve(at, np.ones(CLIPPED_RUN)) >= CLIPPED_RUN):
            return True
    return False


BEYOND, VOLTS = 1.5, 1000.0  # times the largest voltage, where units are off by 100 and 1000; V, of any supply
SURE = 0.1  # of the largest duty: below, the current of the supply says nothing of the motor's
SPREAD = 0.25  # there over the whole log, geometric mean of the joints, from which they are of the motors
BOTH_WAYS = 0.05  # share of the samples in which a motor is driven in each direction
SMOOTHED = 0.03  # s, of the speeds by which a motor drives or brakes
# What magnitudes with signs leave of the voltage over what currents as logged leave, below which they are magnitudes.
MAGNITUDE = 0.6
BACK_EMF = np.linspace(0.0, 1.5, 76)  # tried, of what would take all of the largest voltage at the largest speed


def motor_currents(
    samples: Samples, side: Mapping[str, SideValues], signals: Signals, notes: list[Finding]
) -> tuple[Samples, Mapping[str, SideValues], np.ndarray]:
    """Make currents of the motors of currents of their supply, over the duty, and of magnitudes, with a sign.

    The duty is logged, or a proportional gain times goal less position. Returns the samples, the side signals with the
    duty, and which commands (N, c) the duty is too small for.
    """
    time, joints, gains = samples.time, samples.joints, signals.proportional_gain or {}
    _refuse_beyond_supply(samples, side)
    errors = {}
    if goal := side.get("goal"):
        errors = {j: goal.si(j, time) - samples.position[:, k] for k, j in enumerate(joints) if j in goal.by_joint}
    if gains and "duty" not in side:
        duty = {joint: np.clip(gains[joint] * error, -1.0, 1.0) for joint, error in errors.items() if joint in gains}
        side = {**side, "duty": SideValues(time, duty, "1")}
    unsure, command, spreads = np.zeros(samples.command.shape, dtype=bool), samples.command, list[float]()
    for j, joint in enumerate(joints):
        kinds = (key for key in ("duty", "voltage") if key in side and joint in side[key].by_joint)
        drive = next((side[key].si(joint, time) for key in kinds), errors.get(joint))
        if drive is None:
            continue
        divisor, current = np.ones_like(drive), command[:, j]
        if signals.supplied:
            least, current = SURE * np.abs(drive).max(), side["supply_current"].si(joint, time)
            unsure[:, j] = np.abs(drive) < least
            small = current[unsure[:, j]]
            spreads.append(float(np.std(small) / np.std(current)) if len(small) and np.ptp(current) else 0.0)
            divisor = np.where(drive < 0, -1.0, 1.0) * np.maximum(np.abs(drive), least)
        if current.min() >= 0 and min(np.mean(drive > 0), np.mean(drive < 0)) > BOTH_WAYS:
            current = _signed(current, drive, samples.position[:, j], time, signals.supplied)
        elif not signals.supplied:
            continue
        command = np.array(command)
        command[:, j] = current / divisor
    if spreads and (spread := float(np.prod(spreads)) ** (1 / len(spreads))) > SPREAD:
        text = f"the supply currents vary by {percent(spread)} of their spread where the duty is small, as motors' do"
        advice = "if they are the motors', write them under 'current'"
        notes.append(Finding("motors' currents", text=text, advice=advice))
    return replace(samples, command=command), side, unsure


def _refuse_beyond_supply(samples: Samples, side: Mapping[str, SideValues]) -> None:
    """Refuse duties above 1 and voltages above the supply's, whose unit is wrong."""
    logged = {(key, joint): np.abs(side[key].si(joint, samples.time)) for key in side for joint in side[key].by_joint}
    for joint in samples.joints:
        volts = np.max(logged.get(("supply_voltage", joint), VOLTS))
        for key, most, unit in (("duty", 1.0, "%"), ("voltage", volts, "mV")):
            reached = np.quantile(logged.get((key, joint), 0.0), 0.999)
            if reached > BEYOND * most:
                text = f"the {key} of '{joint}' reaches {reached:.3g}, where {most:.3g} is the most"
                raise GtauError(f"{text}; write its unit (units: {{{key}: '{unit}'}}).", source=samples.name)


def _signed(size: np.ndarray, drive: np.ndarray, position: np.ndarray, time: np.ndarray, supplied: bool) -> np.ndarray:
    """Give magnitudes of currents the sign of the voltage less the back-EMF that makes their sizes most alike.

    Currents that are never negative may be signed ones of a motor that holds a weight: then they explain the voltage.
    """
    from scipy.ndimage import uniform_filter1d

    step = float(time[-1] - time[0]) / (len(time) - 1)
    speed = uniform_filter1d(np.gradient(position, step), 2 * int(SMOOTHED / 2 / step) + 1)
    largest = np.abs(drive).max() / max(float(np.abs(speed).max()), 1e-300)
    weight = np.abs(drive) if supplied else np.ones_like(drive)
    rest = [drive - share * largest * speed for share in BACK_EMF]
    alike = [(size @ (weight * np.abs(left))) / np.linalg.norm(weight * left) for left in rest]
    signs = np.sign(rest[int(np.argmax(alike))])
    if supplied:
        return size * signs * np.sign(drive)
    as_logged, signed = (_unexplained(drive, current, speed) for current in (size, size * signs))
    return size * signs if signed < MAGNITUDE * as_logged else size


def _unexplained(drive: np.ndarray, current: np.ndarray, speed: np.ndarray) -> float:
    """Compute the norm of what a current and a speed leave of the voltage, or of what is in proportion to it."""
    A = np.column_stack([current, speed, np.ones_like(speed)])
    return float(np.linalg.norm(drive - A @ np.linalg.lstsq(A, drive, rcond=None)[0]))
