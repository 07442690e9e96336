"""Bandwidth of a motion, from the spectra of positions with noise of any colour, and the preparation that suits it.

In the acceleration spectrum the motion falls with frequency while position noise rises: white noise, rounding and
jitter with the fourth power. The valley between them is the end of the signal, whatever the noise level. Velocity power
below the valley belongs to the motion, power above it is noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gtau.errors import GtauError
from gtau.signals.preparation import filters
from gtau.signals.preparation.filters import Preparation, valid_samples
from gtau.signals.reading.samples import extremes
from gtau.signals.run import Run, second_differences
from gtau.signals.storage import spans

SPEED_POWER = 0.999  # share of a joint's speed power below its bandwidth
BANDS = 6  # an octave, each a third of an octave wide
CLOSING = 5  # bands of a gap that is filled: one between two harmonics of a motion is an octave wide, less a band
# A valley is real where the spectrum rises from it on both sides by a factor that the mean of few exponentially
# distributed lines rarely does.
PROMINENCE = 4.0
HUMP = 0.02  # share of the speed's power: humps with less are polling jitter, beats and resonances
NOISE = 0.25  # of the sampling rate: the noise of a position is measured above
LEAST_RANGE = 150.0  # least range of a motion in standard deviations of the position's noise
LEAST_SIGNAL = 100.0  # or least signal-to-noise ratio of its speed; rest has 40 and less
FAR_ABOVE = 1e3  # density of a motion over the density of such noise
WHITE = -1.0  # noise is flat in the position's spectrum, or nearly so, where motions fall with f^-2 and faster
ROUNDING = 1e-9  # of a position, by arithmetic: a smaller range is not a motion
# Commands smoothed offline: rms share above ``NOISE`` of the sampling rate, and fall of the density within an octave.
SMOOTH, STEEP = 1e-4, 4e3


@dataclass(frozen=True, eq=False)
class JointSpectrum:
    """Spectra of one joint, averaged over thirds of an octave.

    ``frequency`` (K,) in Hz; power densities of the ``speed`` and of the ``acceleration`` (K,), in the position's unit,
    s and Hz. The signal ends at ``end`` (Hz), where the noise takes over, and has the ``bandwidth`` (Hz); both are NaN
    for a joint that does not move. ``signal_to_noise`` is the ratio of their powers in the speed below ``end``.
    """

    frequency: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    end: float
    bandwidth: float
    signal_to_noise: float

    @property
    def moves(self) -> bool:
        """True where the joint's motion exceeds its position noise."""
        return bool(np.isfinite(self.bandwidth))


def spectra(run: Run) -> tuple[JointSpectrum, ...]:
    """Estimate spectra, end of the signal and bandwidth of every joint; a long run is read in segments."""
    frequency, density, gain = run.accelerations
    high = frequency > NOISE * run.updates
    # The mean of an exponential distribution is its median over ln 2; the median ignores single lines.
    noise = np.sqrt(np.median(density[high] / gain[high, None] ** 2, axis=0) / np.log(2) * run.rate / 2)
    low, most = extremes(run.position)
    rounding = ROUNDING * np.maximum(np.abs(low), np.abs(most))
    density = np.where(most - low <= rounding, 0.0, density)
    columns = zip(density.T, (most - low > LEAST_RANGE * noise).tolist(), strict=True)
    return tuple(_judge(frequency, column, gain, moves) for column, moves in columns)


def end_of_commands(run: Run) -> float | None:
    """Find the frequency (Hz) above which no command holds anything, not even noise; None where one does."""
    frequency, density, gain = second_differences(run.command, run.rate, run.updates)
    density = density[:, density.any(axis=0)] / gain[:, None] ** 2
    above = np.sqrt(np.cumsum(density[::-1], axis=0)[::-1] / np.maximum(density.sum(axis=0), 1e-300))
    if not above.size or above[np.searchsorted(frequency, NOISE * run.updates)].max() > SMOOTH:
        return None
    for column in density.T:
        _, bands = _in_bands(frequency, column)
        if np.all(bands[:-BANDS] <= STEEP * bands[BANDS:]):
            return None
    return float(frequency[np.argmax(above.max(axis=1) <= SMOOTH)])


def position_noise(run: Run, cutoffs: Sequence[float | None]) -> np.ndarray:
    """Bound the noise of positions (n,) by a white density, in the position's unit squared per Hz.

    It is the largest density of a third of an octave above a joint's cut-off (Hz), where the torques show no motion.
    """
    bounds = []
    for cutoff, (centre, density, gain) in zip(cutoffs, _banded(run), strict=True):
        above = centre > (np.inf if cutoff is None else cutoff)
        bounds.append(float(np.max(density / gain**2, where=above, initial=0.0)))
    return np.array(bounds)


def widened(run: Run, cutoffs: Sequence[float | None], noise: Sequence[float]) -> tuple[float | None, ...]:
    """Raise each joint's cut-off (Hz) where a run has faster motion than :func:`position_noise` explains.

    The cut-off minimises the error of the accelerations: lost motion above it, and noise that passes.
    """
    cutoffs_of_joints: list[float | None] = []
    for cutoff, level, (centre, density, gain) in zip(cutoffs, noise, _banded(run), strict=True):
        if cutoff is None or cutoff >= filters.HIGHEST_CUTOFF * run.rate:
            cutoffs_of_joints.append(None)
            continue
        above = centre > cutoff
        frequency, white = centre[above], (level * gain**2)[above]
        motion = np.maximum(density[above] - white, 0.0)
        octaves = np.log2(filters.HIGHEST_CUTOFF * run.updates / cutoff)
        tried = cutoff * 2 ** (np.arange(max(int(4 * octaves), 0) + 1) / 4)
        passed = 1 / (1 + (frequency / tried[:, None]) ** 8)  # of filters.low_pass
        error = ((1 - passed) ** 2 * motion + passed**2 * white) @ frequency
        cutoffs_of_joints.append(float(tried[np.argmin(error)]))
    return tuple(cutoffs_of_joints)


def _banded(run: Run) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """For each joint, list frequencies, density of the accelerations and gain of two differences, in bands."""
    frequency, density, gain = run.accelerations
    bands = [_in_bands(frequency, column) for column in density.T]
    return [(centre, means, np.interp(centre, frequency, gain)) for centre, means in bands]


def _judge(frequency: np.ndarray, density: np.ndarray, gain: np.ndarray, moves: bool) -> JointSpectrum:
    """Find the end of the signal and the bandwidth in the spectrum of one joint's accelerations."""
    from scipy.ndimage import grey_closing

    centre, band_means = _in_bands(frequency, density)
    band_gain = np.interp(centre, frequency, gain)
    if not density.any():
        return JointSpectrum(centre, band_means, band_means, np.nan, np.nan, 0.0)
    level = -np.log(np.maximum(grey_closing(band_means, size=CLOSING, mode="nearest"), 1e-30 * band_means.max()))
    bottom = level.min() - 2 * np.log(PROMINENCE)  # a spectrum that falls throughout ends at its last frequency
    valleys = _peaks(np.r_[bottom, level, bottom], np.log(PROMINENCE)) - 1
    held = np.cumsum(density / gain)
    below = held[np.searchsorted(frequency, centre[valleys], side="right") - 1]
    last = len(valleys) - 1
    while last > 0:
        small = below[last] - below[last - 1] < HUMP * below[last - 1]
        if not (small or _is_white(centre, np.exp(-level) / band_gain**2, valleys[last - 1], valleys[last])):
            break
        last -= 1
    end = int(valleys[last])
    signal_end = int(np.searchsorted(frequency, centre[end], side="right"))
    edge = int(np.searchsorted(held[:signal_end], SPEED_POWER * held[signal_end - 1]))
    noise = np.exp(-level[end]) / band_gain[end] ** 2 * gain[:signal_end].sum()  # white, of the level in the valley
    ratio = float(held[signal_end - 1] / noise)
    ends = (float(centre[end]), float(frequency[edge])) if moves or ratio > LEAST_SIGNAL else (np.nan, np.nan)
    return JointSpectrum(centre, band_means / band_gain, band_means, *ends, ratio)


def _peaks(values: np.ndarray, prominence: float) -> np.ndarray:
    """Find the middles of the peaks that rise by ``prominence`` above the higher saddle to a higher peak or end."""
    firsts = np.flatnonzero(np.diff(values, prepend=np.nan) != 0)
    lasts, heights, middles = np.r_[firsts[1:], len(values)] - 1, values[firsts], []
    for k in range(1, len(heights) - 1):
        higher = np.flatnonzero(heights > heights[k])
        at = int(np.searchsorted(higher, k))
        start = higher[at - 1] if at else 0
        stop = higher[at] if at < len(higher) else len(heights)
        saddle = max(heights[start : k + 1].min(), heights[k:stop].min())
        if heights[k] > max(heights[k - 1], heights[k + 1]) and heights[k] - saddle >= prominence:
            middles.append((firsts[k] + lasts[k]) // 2)
    return np.array(middles, dtype=int)


def _is_white(frequency: np.ndarray, position: np.ndarray, valley: int, end: int) -> bool:
    """Decide whether the spectrum between a valley and the ``end`` is white noise of the position, low-passed.

    Its level equals the valley's and is far below the motion's ``position`` density.
    """
    hump = position[valley : end + 1]
    top = int(np.argmax(hump * frequency[valley : end + 1] ** 4))
    slope = np.log(hump[top] / hump[0]) / np.log(frequency[valley + top] / frequency[valley]) if top else 0.0
    below = position[: valley + 1].max() > FAR_ABOVE * hump[0]
    return bool(below and slope > WHITE and hump.max() < PROMINENCE * hump[0])


def _in_bands(frequency: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Average the density in bands a third of an octave wide: centres (B,) and means (B,); at least one line each."""
    centre = frequency[0] * 2 ** (np.arange(int(BANDS * np.log2(frequency[-1] / frequency[0])) + 1) / BANDS)
    half = 2 ** (1 / 6)
    first = np.searchsorted(frequency, centre / half * (1 - 1e-9))
    stop = np.maximum(np.searchsorted(frequency, centre * half * (1 + 1e-9), side="right"), first + 1)
    held = np.concatenate([[0.0], np.cumsum(density)])
    return centre, (held[stop] - held[first]) / (stop - first)


KEPT = 0.85  # of the samples: decimation widens what is left out around a reversal by two rows
FEWEST_ROWS = 200  # of a joint, in all runs together, that decimation leaves if the logs have them
ABOVE_ROWS = 2.0  # least cut-off of the positions over the cut-off of the decimated rows
LEAST_WIDTH = 2 * ABOVE_ROWS  # cut-off over the bandwidth, as rows reach twice the bandwidth
PARTS = 8  # of a long run that are evaluated for decimation
LARGEST_FACTOR = 400


def choose_preparation(
    runs: Sequence[Run],
    decimator: Literal["fir", "chebyshev"] = "fir",
    judge: Callable[[Preparation], Preparation] | None = None,
) -> Preparation:
    """Choose the preparation of an experiment from its runs; entries of their ``settings`` take precedence.

    The bandwidth is the largest of all joints in all runs, whose rates may differ. The position filter follows from it
    and from where noise takes over, see :func:`gtau.signals.preparation.filters.cutoff_frequency`. The decimation
    leaves five rows in a period of the bandwidth, or more where it would lose more than 15 % of the samples around
    reversals and rests, but rows end where noise takes over. ``judge`` may lower bandwidth and filter where nothing is
    given. Raises GtauError where no joint moves in a run, or the logs cannot hold motion of a given frequency.
    """
    settings = runs[0].log.settings
    slowest, updates = min(run.rate for run in runs), min(run.updates for run in runs)
    run_spectra = [moving_spectra(run) for run in runs]
    moving = [spectrum for joints in run_spectra for spectrum in joints if spectrum.moves]
    longest = max(len(run.time) / run.rate for run in runs)
    for key, least in (("bandwidth", 1 / longest), ("position_filter", 0.0)):
        given = getattr(settings, key)
        if isinstance(given, float) and not least <= given < 0.5 * slowest:
            raise GtauError(
                f"preparation.{key} is {given:g} Hz, but logs of {longest:.3g} s at {slowest:.4g} Hz can hold motion "
                f"of {1 / longest:.2g} to {slowest / 2:.4g} Hz; give a frequency between these, or leave it out."
            )
    bandwidth = settings.bandwidth or max(spectrum.bandwidth for spectrum in moving)
    cutoff = None if settings.position_filter == "none" else settings.position_filter
    if settings.position_filter is None:
        end = max(spectrum.end for spectrum in moving) if settings.bandwidth is None else np.inf
        seconds = float(np.mean([len(run.time) / run.rate for run in runs]))
        cutoff = filters.cutoff_frequency(bandwidth, end, slowest, seconds, updates)
    fraction = filters.SPEED_FRACTION if settings.least_speed is None else settings.least_speed
    chosen = Preparation(bandwidth, cutoff, filters.Decimator(1, decimator), fraction, slowest, settings.given)
    chosen = _decimated(runs, run_spectra, chosen)
    if judge is None or chosen.given:
        return chosen
    judged = judge(chosen)
    # what trials have lowered stays
    return chosen if judged == chosen else replace(_decimated(runs, run_spectra, judged), cutoff=judged.cutoff)


def _decimated(
    runs: Sequence[Run], run_spectra: Sequence[Sequence[JointSpectrum]], preparation: Preparation
) -> Preparation:
    """Choose the decimation, and raise the cut-off above the rows' low-pass."""
    kind, rate, bandwidth = preparation.decimator.kind, preparation.rate, preparation.bandwidth
    factor = runs[0].log.settings.decimation
    if factor is None and kind == "chebyshev":
        factor = filters.decimation_factor(rate, bandwidth)
    elif factor is None:
        # Accelerations beyond the signal are noise. 12 bits at 50 Hz (signal to 6 Hz): rows to 10 Hz put a gain 2.5 %
        # off. Ten UR10e, 18 bits at 200 Hz (to 8.5 Hz): squares of z are 2.8 with rows to 27 Hz, 0.8 to 8.9 Hz.
        # A base tracked to 3 Hz, joints to 5 Hz: rows to 6.7 Hz put the first gain 9 % off, to 3.3 Hz 2.2 %.
        ends = dict[bool, float]()  # where noise takes over: in positions of joints, or before that in a base's pose
        for joint, spectrum in (pair for joints in run_spectra for pair in zip(runs[0].joints, joints, strict=True)):
            if spectrum.moves:
                ends[joint in runs[0].base] = max(spectrum.end, ends.get(joint in runs[0].base, 0.0))
        end = min(ends.values())
        given = runs[0].log.settings.bandwidth is not None
        least, most = (filters.decimation_factor(rate, f, LARGEST_FACTOR) for f in (end / 2, bandwidth))
        factor = _affordable(runs, run_spectra, preparation, 1 if given else least, most)
    decimator = filters.Decimator(factor, kind)
    cutoff = preparation.cutoff
    if cutoff is not None and "position_filter" not in preparation.given and factor > 1:
        highest = max(cutoff, ABOVE_ROWS * decimator.cutoff(rate))
        cutoff = filters.below_nyquist(highest, rate, min(run.updates for run in runs))
    return replace(preparation, decimator=decimator, cutoff=cutoff)


def moving_spectra(run: Run) -> tuple[JointSpectrum, ...]:
    """Compute spectra of the joints of a run; raises GtauError where none moves."""
    joints = spectra(run)
    if not any(spectrum.moves for spectrum in joints):
        raise GtauError(
            f"run '{run.name}': no joint's motion exceeds its position noise; leave the run out, or give a log of a "
            f"moving robot."
        )
    return joints


def _affordable(
    runs: Sequence[Run], run_spectra: Sequence[Sequence[JointSpectrum]], preparation: Preparation, least: int, most: int
) -> int:
    """Find the largest decimation, up to ``most``, that leaves enough rows, and beyond ``least`` enough samples."""
    blocks: list[tuple[int, float, np.ndarray]] = []  # joint, rate of the run, lengths of its usable blocks
    for run, spectra_of_run in zip(runs, run_spectra, strict=True):
        ratio = run.rate / preparation.rate
        for j, lengths in enumerate(_usable_blocks(run, preparation.at(run.rate))):
            if spectra_of_run[j].moves:
                blocks.append((j, ratio, lengths))
    fewest = FEWEST_ROWS / (3 if runs[0].base else 1)  # as each body moves the base's six rows, too
    chosen, factor = 1, 2
    while factor <= max(least, most):
        samples = np.zeros((2, len(runs[0].joints)))
        for j, ratio, lengths in blocks:
            guard = filters.Decimator(max(1, round(factor * ratio)), preparation.decimator.kind).guard
            samples[:, j] += np.sum([np.maximum(lengths - 2 * guard, 0), lengths], axis=1) / ratio
        kept, total = samples[:, samples[1] > 0]
        if not total.size or kept.min() / factor < fewest or (factor > least and (kept / total).mean() < KEPT):
            break
        chosen = factor
        factor += max(1, factor // filters.MAX_FACTOR)  # from there on in steps of some 5 %
    return chosen


def _usable_blocks(run: Run, preparation: Preparation) -> list[np.ndarray]:
    """List for each joint the lengths of blocks of valid samples in which it is fast enough."""
    parts = list(spans(len(run.time), 1 << 15))
    parts = [parts[k] for k in sorted({round(k) for k in np.linspace(0, len(parts) - 1, PARTS)})]
    speeds = [np.abs(filters.position_filter(run.position, run.rate, preparation.cutoff, *part)[1]) for part in parts]
    limit = preparation.speed_fraction * np.sqrt(np.mean([np.mean(speed**2, axis=0) for speed in speeds], axis=0))
    lengths: list[list[np.ndarray]] = [[] for _ in run.joints]
    limit[[joint in run.base for joint in run.joints]] = 0.0  # which has no friction, and may rest
    for speed, part in zip(speeds, parts, strict=True):
        usable = (speed >= limit) & valid_samples(run, preparation, *part)[:, : len(run.joints)]
        for j, joint_lengths in enumerate(lengths):
            edges = np.flatnonzero(np.diff(np.r_[False, usable[:, j], False]))
            joint_lengths.append(edges[1::2] - edges[::2])
    scale = len(run.time) / sum(stop - start for start, stop in parts)
    return [np.repeat(np.concatenate(joint_lengths), round(scale)) for joint_lengths in lengths]
