"""Ripple of gears and motors.

It repeats many times over the range of a joint. Each joint has sines of its position, of the wave numbers that stand
out in what the plain fit lacks. In measured logs these are the turns of the motor and twice as many: 101 and 202 a turn
of a UR10e's joints, 120 and 240 of a Panda's, 160 and 320 of an xMate 7's, with 0.5 to 28 % of the torque.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words, rms_torques
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.run_blocks import WINDOWS

PLAUSIBLE = 0.02  # of the rms torque
WAVES = 3  # of a joint, at most: turns of the motor, and harmonics
STANDS_OUT = 30.0  # power of a wave over the median of those around it
FEWEST, MOST = 12, 512  # periods in the range of a joint; fewer are any function of its position
BINS = 4 * MOST  # of a joint's range
FINE = 8  # frequencies for each whole number of periods
AROUND = 250  # frequencies around a wave
LOBE = 4 * FINE  # frequencies on either side, into which a wave leaks


def _waves(fit: Fit) -> np.ndarray:
    """Find the wave numbers (n, WAVES) of each joint's ripple, the clearest first; 0 for none."""
    low, high = fit.dataset.travels
    ratios, waves = _over_median(fit), np.zeros((len(fit.gains), WAVES))
    for wave, ratio, travel in zip(waves, ratios, high - low, strict=True):
        for k in range(WAVES):
            best = int(np.argmax(ratio))
            if ratio[best] < STANDS_OUT:
                break
            wave[k] = 2 * np.pi * (FEWEST + best / FINE) / travel
            ratio[max(best - LOBE, 0) : best + LOBE + 1] = 0
    return waves


def _over_median(fit: Fit) -> np.ndarray:
    """Compute the power of waves along each joint's range over the median of those around, (n, frequencies).

    Integrated along the path, ``sum |qd| r exp(i w q)``, torques r that a joint lacks at low speed count for little.
    """
    (low, high), n = fit.dataset.travels, len(fit.gains)
    travel, gains, delays = np.where(high > low, high - low, 1.0), fit.gains[:, None], fit.solution.delays[:n, None]
    lacks = np.zeros((n, BINS))
    for run, window in fit.dataset.windows(WINDOWS):
        samples = window.samples()
        speed = np.abs(samples.qd.T) + 1e-300
        lacking = gains * samples.command.T[:n] - FitWindow(fit, run, window).unmoved
        lacking = speed * (lacking - np.average(lacking, axis=1, weights=speed)[:, None])
        at = (samples.q.T + delays * samples.qd.T - low[:, None]) / travel[:, None]  # positions lag behind currents
        for total, part, bins in zip(lacks, lacking, np.clip(at * BINS, 0, BINS - 1).astype(int), strict=True):
            total += np.bincount(bins, part, minlength=BINS)
    power = np.abs(np.fft.rfft(lacks, FINE * BINS)[:, FINE * FEWEST : FINE * MOST]) ** 2
    around = np.median(power.reshape(n, -1, AROUND), axis=-1)
    return np.asarray(power / np.maximum(around, 1e-300).repeat(AROUND, axis=1))


def _torques(at: FitWindow) -> Torques:
    waves = np.transpose([column.waves for column in at.columns[EFFECT.name][:WAVES]])
    angles = at.window.samples().q[..., None] * waves
    sizes = rms_torques(at.fit)[:, None] * (waves > 0)
    columns = np.concatenate([np.sin(angles) * sizes, np.cos(angles) * sizes], axis=-1)
    return at.decimated(columns.transpose(2, 1, 0))


def _columns(fit: Fit) -> list[EffectColumn]:
    waves = _waves(fit).T
    return [EffectColumn(PLAUSIBLE, "of its torque", waves=tuple(wave)) for wave in (*waves, *waves) if waves.any()]


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    period = 2 * np.pi / column.waves[fit.problem.joints.index(column.joint)]
    turns = fit.dataset.robot.joint(column.joint).turns
    every = f"{np.degrees(period):.3g} deg" if turns else f"{1e3 * period:.3g} mm"
    what = f"a torque of '{column.joint}' that repeats every {every} (ripple of its gear or motor)"
    return what, "repeat each motion with and without the payload, so that the ripple of both is the same"


EFFECT = Effect("ripple", _torques, _columns, _say, function=True)
