"""Physics of the drives that the model lacks: friction, torque constants, lag.

- Friction is cubic in speed, grows with the load, is Stribeck's, or changes along a run as joints warm up. The load is
  the model's, without friction, as in the term ``fl``: the measured current is the friction itself where friction
  exceeds the load, so it would explain the noise of the current and any drive gain.
- The torque constant falls with the current, as iron saturates and as drives log currents before they limit them, or
  along the runs, as the motor warms up. A payload then scales the gain at the largest currents, and the other
  parameters absorb the rest so well that the size of the residuals hardly shows it: with a constant that falls by 10
  per cent the gain is 12 per cent off. The shape of the residuals does show it.
- A low-pass filter of the current and the elasticity of a transmission both add the second derivative of the torque, to
  first order. It is that of the model's torque: the measured current's is correlated with the noise of the current.
- Friction may differ between runs, and has values of its own in each (:mod:`.column_blocks`); a
  drive gain may not, as a payload is weighed by how loaded and unloaded runs differ. A motor that got warmer, by 2 per
  cent of its torque constant, can move the gain by 5. All that the payload does not add to is the same in all runs, and
  shows it: the current of the model is offered once more in these runs alone.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gtau.estimation.diagnostics.alternatives import (
    GAIN_CHANGE,
    TORQUE_SCALE,
    Alternative,
    Hypothesis,
    candidate,
    friction_levels,
    rms_speeds,
    rms_torques,
)
from gtau.estimation.diagnostics.linearisation import (
    CandidateColumns,
    FitWindow,
    Linearised,
    slopes_of,
    weighted,
    weights_of,
)
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import jacobian_of_known
from gtau.estimation.regression.column_blocks import is_transmitted
from gtau.estimation.regression.factors import KNOWN, modelled
from gtau.estimation.regression.rows import Rows
from gtau.estimation.thresholds import Threshold
from gtau.estimation.thresholds.estimates import ALTERNATIVE_PRIOR, PLAUSIBLE_GAIN_CHANGE
from gtau.estimation.thresholds.refutation import DOMINANT, SCALED, TIE
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.findings.words import RELATIVE
from gtau.robots.parameter import Parameter
from gtau.signals.preparation.filters import differentiate

CUBIC_FRICTION = candidate(
    "cubic friction",
    Threshold(0.2, "cubic friction at three times the rms speed, of the friction", evidence="experience"),
    unit="of its friction",
)
LOAD_FRICTION = candidate(
    "load-dependent friction",
    Threshold(
        0.05, "friction coefficient of the load", healthy="0.02 to 0.1 in strain-wave gears", evidence="UR10e pairs"
    ),
    unit="of its load",
)
STRIBECK_FRICTION = candidate(
    "Stribeck friction",
    Threshold(0.3, "Stribeck friction at rest, of the friction", evidence="experience"),
    unit="of its friction",
)
STRIBECK_SPEED = Threshold(0.1, "Stribeck speed, in rms speeds", evidence="experience")


def _friction_shape(at: FitWindow) -> CandidateColumns:
    """Add cubic, load-dependent or Stribeck friction where the model has none."""
    dataset, terms, qd = at.fit.dataset, at.fit.system.terms, at.window.samples().qd
    joints, speeds = dataset.model.actuated, rms_speeds(at.fit)
    fv, fs = friction_levels(at.fit)
    level = np.maximum(fv * speeds + fs, 0.02 * rms_torques(at.fit))
    no_cubic, no_load = (np.array([Parameter(term, j) not in terms for j in joints]) for term in ("f3", "fl"))
    ratio, sign = qd / np.where(speeds > 0, speeds, 1.0), np.sign(qd)
    transmitted = at.values * is_transmitted(dataset.base.names)
    torques = at.torques_along(at.motion, transmitted).T
    cubic = level * ratio**3 / 3 * no_cubic
    load = np.abs(torques) * sign * no_load
    stribeck = level * np.exp(-np.abs(ratio) / STRIBECK_SPEED) * sign
    return at.decimated(np.stack([cubic.T, load.T, stribeck.T]))


FRICTION_SHAPE = Hypothesis(
    "friction shape", False, _friction_shape, (CUBIC_FRICTION, LOAD_FRICTION, STRIBECK_FRICTION)
)

FRICTION_CHANGE = Threshold(0.1, "relative change of friction along a run", evidence="experience")
VISCOUS_DRIFT = candidate("drifting viscous friction", FRICTION_CHANGE, RELATIVE)
COULOMB_DRIFT = candidate("drifting Coulomb friction", FRICTION_CHANGE, RELATIVE)


def _friction_drift(at: FitWindow) -> CandidateColumns:
    """Add viscous or Coulomb friction that changes along the runs."""
    terms, samples = at.fit.system.terms, at.window.samples()
    # friction that depends on the temperature has a slope of its own for this
    joints = at.fit.dataset.model.actuated
    free = [{Parameter("fvt", j), Parameter("fst", j)}.isdisjoint(terms) for j in joints]
    fv, fs = friction_levels(at.fit) * np.array(free)
    friction = np.stack([(fv * samples.qd).T, (fs * np.sign(samples.qd)).T])
    return at.decimated(friction * _along_run(at, samples.time))


def _along_run(at: FitWindow, time: np.ndarray) -> np.ndarray:
    """Map instants in a window's run to -0.5 at its beginning, 0.5 at its end."""
    begin, *_, end = at.fit.dataset.prepared[at.run].time[[0, -1]]
    return np.asarray((time - begin) / max(end - begin, 1e-12) - 0.5)


FRICTION_DRIFT = Hypothesis("friction drift", False, _friction_drift, (VISCOUS_DRIFT, COULOMB_DRIFT))

LARGE = 2.0  # rms currents: where the fall is stated
FALLING_CONSTANT = candidate(
    "saturation",
    Threshold(
        0.03,
        "relative fall of a torque constant up to twice the rms current",
        healthy="0 to 0.05",
        evidence="data sheets of servo motors",
    ),
    unit=f"{RELATIVE} up to {LARGE:g} times the rms current",
)


def _saturation(at: FitWindow) -> CandidateColumns:
    """Add a torque constant that falls with the current, ``tau abs(tau)``."""
    scale = LARGE * rms_torques(at.fit)[:, None]

    def columns(rows: Rows) -> np.ndarray:
        tau = at.torques(rows)
        return (np.abs(tau) * tau / scale)[:, :, None]

    return columns


SATURATION = Hypothesis("saturation", False, _saturation, (FALLING_CONSTANT,))

DRIFTING_CONSTANT = candidate(
    "gain drift",
    Threshold(
        0.005,
        "relative change of a torque constant along a run",
        healthy="0.001 a kelvin of the magnets",
        evidence="data sheets of servo motors",
    ),
    unit=RELATIVE,
)


def _gain_drift(at: FitWindow) -> CandidateColumns:
    """Add a torque constant that changes along the runs."""
    return lambda rows: (at.torques(rows) * _along_run(at, rows.time))[:, :, None]


GAIN_DRIFT = Hypothesis("gain drift", False, _gain_drift, (DRIFTING_CONSTANT,), description=True)

OTHER_SCALE = candidate(
    TORQUE_SCALE,
    Threshold(0.1, "relative error of one joint's torques, or of its given gain", evidence="experience"),
    unit=RELATIVE,
)


def _torque_scale(at: FitWindow) -> CandidateColumns:
    """Add another scale of one joint's torques: links that joints share would have another inertia at each."""
    return lambda rows: at.torques(rows)[:, :, None]


TORQUE_SCALES = Hypothesis(
    TORQUE_SCALE, False, _torque_scale, lambda fit: () if fit.free_gains else (OTHER_SCALE,), description=True
)

FILTER_OR_ELASTICITY = candidate(
    "current lag",
    Threshold(
        1e-4,
        "coefficient of the torque's second derivative, s2",
        healthy="elastic at 16 Hz, or a filter of 14 ms",
        evidence="experience",
    ),
    unit="s2",
)


def _current_lag(at: FitWindow) -> CandidateColumns:
    """Add a low-pass filter of the current, or an elastic transmission: the torque's second derivative."""
    torques = at.torques_along(at.motion, at.values)
    _, change = differentiate(torques.T, at.window.run.rate)
    return at.decimated(change.T[None])


CURRENT_LAG = Hypothesis("current lag", False, _current_lag, (FILTER_OR_ELASTICITY,))


def gain_changes(fit: Fit) -> Iterator[Alternative]:
    """Find the most significant change of every joint's current between one run, or the loaded ones, and the others.

    Its size is the relative increase of the current, its share that of the residual variance of all joints where each
    has such a change in these runs. Changes that no motor makes, of sign or unit, are left to other checks.
    """
    problem, solution = fit.system.problem, fit.solution
    runs, of_block = np.unique(fit.system.block_positions[:, 0].astype(int), return_inverse=True)
    loaded = np.zeros(len(runs), dtype=bool)
    np.logical_or.at(loaded, of_block, np.any(problem.blocks[..., KNOWN], axis=(1, 2)))
    groups = np.unique(np.vstack([np.eye(len(runs), dtype=bool), loaded]), axis=0)
    groups = groups[~groups.all(axis=1) & groups.any(axis=1)]
    if not (fit.free_gains and len(groups)):
        return
    tried = len(np.unique(groups ^ groups[:, :1], axis=0))  # larger in some runs is smaller in the others
    errors, J = weighted(fit, problem.blocks)
    current = modelled(problem.blocks, solution.theta) * (weights_of(fit) / solution.gains)[:, None]
    offered = -current[..., None] * groups[:, of_block].T[:, None, None, :]
    known = np.zeros(len(problem.known)), jacobian_of_known(problem, True)
    clusters = np.unique(problem.block_numbers, return_inverse=True)[1]
    linear = Linearised(errors, J, offered, known, clusters)
    sizes, stds, of_joints, slopes = linear.score_tests(slice(None), shared=False)
    t, shares = np.abs(sizes) / np.maximum(stds, 1e-300), of_joints.sum(axis=1)
    worst = _first_largest(t[:, : len(fit.gains)])
    if shares.max() > DOMINANT:  # the same runs for all joints
        worst[:] = _first_largest(shares)
    T, prior = slopes_of(fit), float(ALTERNATIVE_PRIOR) / tried  # the largest of several is larger by chance
    for j, k in enumerate(worst):
        change, std = float(sizes[k, j]), float(stds[k, j])
        if not t[k, j] or abs(change) > SCALED:
            continue  # reversed, or in another unit: other checks name these better
        names = [fit.dataset.runs[run].name for run in runs[groups[k]]]
        cause = Finding(F.GAIN_CHANGE, (problem.joints[j],), "", {"runs": names, "change": change})
        share, plausible = float(shares[k]), float(PLAUSIBLE_GAIN_CHANGE)
        effect = Alternative(GAIN_CHANGE, (cause,), change, std, RELATIVE, prior, share, plausible=plausible)
        of_gains = np.zeros(len(T))
        of_gains[problem.gain_rows] = (T @ slopes[k, j])[problem.gain_rows]
        yield effect.moving(fit, of_gains)


def _first_largest(values: np.ndarray) -> np.ndarray:
    """Find the first of the largest values along the first axis, robust to rounding of ties.

    Of two runs one is larger as significantly as the other is smaller.
    """
    return np.asarray(np.argmax(values >= (1 - TIE) * values.max(axis=0), axis=0))
