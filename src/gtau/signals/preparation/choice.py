"""Automatic choice of the preparation: bandwidth, position filter and decimation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from gtau.errors import GtauError
from gtau.signals.preparation import filters
from gtau.signals.preparation.bandwidth import JointSpectrum, spectra
from gtau.signals.preparation.prepared_run import SPEED_FRACTION, Preparation, valid_samples
from gtau.signals.run import Run
from gtau.signals.storage import spans

KEPT = 0.85  # of the samples: decimation widens what is left out around a reversal by two rows
FEWEST_ROWS = 200  # of a joint, in all runs together, that decimation leaves if the logs have them
ABOVE_ROWS = 2.0  # least cut-off of the positions over the cut-off of the decimated rows
LEAST_WIDTH = 2 * ABOVE_ROWS  # cut-off over the bandwidth, as rows reach twice the bandwidth
PARTS = 8  # parts of a long run that are evaluated for that
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
    fraction = SPEED_FRACTION if settings.least_speed is None else settings.least_speed
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
