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
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.diagnostics.finding import RELATIVE, Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.hypotheses.hypothesis import (
    Candidates,
    Hypothesis,
    friction_levels,
    rms_speeds,
    rms_torques,
    window_motion,
)
from gtau.estimation.diagnostics.linearisation import CandidateColumns, at_full_rate
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.friction import transmitted
from gtau.estimation.regression.rows import Rows
from gtau.estimation.thresholds.estimates import (
    PLAUSIBLE_CUBIC,
    PLAUSIBLE_FRICTION_DRIFT,
    PLAUSIBLE_GAIN_DRIFT,
    PLAUSIBLE_LAG,
    PLAUSIBLE_LOAD_FRICTION,
    PLAUSIBLE_SATURATION,
    PLAUSIBLE_STRIBECK,
    STRIBECK_SPEED,
)
from gtau.robots.parameter import Parameter
from gtau.signals.filters import differentiate
from gtau.signals.preparation import InMemoryRun


def _friction_shape(fit: Fit) -> Candidates:
    """Add cubic, load-dependent or Stribeck friction where the model has none."""
    joints, speeds = fit.dataset.model.actuated, rms_speeds(fit)
    fv, fs = friction_levels(fit)
    level = np.maximum(fv * speeds + fs, 0.02 * rms_torques(fit))
    model, base = fit.dataset.model, fit.dataset.base
    regressor, acting = model.columns(base.standard), transmitted(base.names)
    absent = {
        term: np.array([Parameter(term, j).name not in fit.system.friction.terms for j in joints])
        for term in ("f3", "fl")
    }

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        of = window.samples()
        ratio, sign = of.qd / np.where(speeds > 0, speeds, 1.0), np.sign(of.qd)
        cubic = level * ratio**3 / 3 * absent["f3"]
        torques = regressor.torques_along(model.layout, window_motion(model, window), values * acting)
        load = np.abs(torques.T) * sign * absent["fl"]
        stribeck = level * np.exp(-np.abs(ratio) / STRIBECK_SPEED) * sign
        return at_full_rate(window, fit.dataset, np.stack([cubic.T, load.T, stribeck.T]))

    plausible = np.array([PLAUSIBLE_CUBIC, PLAUSIBLE_LOAD_FRICTION, PLAUSIBLE_STRIBECK])
    return Candidates(
        [Finding(F.CUBIC_FRICTION), Finding(F.LOAD_FRICTION), Finding(F.STRIBECK_FRICTION)],
        ("of its friction", "of its load", "of its friction"),
        np.repeat(plausible[:, None], len(joints), axis=1),
        offer,
    )


FRICTION_SHAPE = Hypothesis(
    "friction shape",
    False,
    _friction_shape,
)


def _friction_drift(fit: Fit) -> Candidates:
    """Add viscous or Coulomb friction that changes along the runs."""
    joints, terms = fit.dataset.model.actuated, fit.system.friction.terms
    # friction that depends on the temperature has a slope of its own for this
    fv, fs = friction_levels(fit) * np.array(
        [Parameter("fvt", j).name not in terms and Parameter("fst", j).name not in terms for j in joints]
    )
    spans = {id(each.run): (each.time[0], each.time[-1]) for each in fit.dataset.prepared}

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        of, (begin, end) = window.samples(), spans[id(window.run)]
        along = ((of.time - begin) / max(end - begin, 1e-12) - 0.5)[:, None]
        return at_full_rate(window, fit.dataset, np.stack([(fv * of.qd * along).T, (fs * np.sign(of.qd) * along).T]))

    return Candidates(
        [Finding(F.VISCOUS_DRIFT), Finding(F.COULOMB_DRIFT)],
        (RELATIVE, RELATIVE),
        np.full((2, len(joints)), PLAUSIBLE_FRICTION_DRIFT),
        offer,
    )


FRICTION_DRIFT = Hypothesis("friction drift", False, _friction_drift)


LARGE = 2.0  # rms currents: where the fall is stated


def _saturation(fit: Fit) -> Candidates:
    """Add a torque constant that falls with the current, ``tau abs(tau)``."""
    regressor, n = fit.dataset.model.columns(fit.dataset.base.standard), len(fit.gains)
    scale = LARGE * rms_torques(fit)

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        def columns(rows: Rows) -> np.ndarray:
            tau = regressor.torques(rows.entries, values, n)
            return (np.abs(tau) * tau / scale[:, None])[:, :, None]

        return columns

    return Candidates(
        [Finding(F.SATURATION)],
        (f"{RELATIVE} up to {LARGE:g} times the rms current",),
        np.full((1, n), PLAUSIBLE_SATURATION),
        offer,
    )


def _gain_drift(fit: Fit) -> Candidates:
    """Add a torque constant that changes along the runs."""
    regressor, n = fit.dataset.model.columns(fit.dataset.base.standard), len(fit.gains)
    spans = {id(each.run): (each.time[0], each.time[-1]) for each in fit.dataset.prepared}

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        begin, end = spans[id(window.run)]

        def columns(rows: Rows) -> np.ndarray:
            along = (rows.time - begin) / max(end - begin, 1e-12) - 0.5
            return (regressor.torques(rows.entries, values, n) * along)[:, :, None]

        return columns

    return Candidates(
        [Finding(F.GAIN_DRIFT)],
        (RELATIVE,),
        np.full((1, n), PLAUSIBLE_GAIN_DRIFT),
        offer,
    )


SATURATION = Hypothesis(
    "saturation",
    False,
    _saturation,
)
GAIN_DRIFT = Hypothesis("gain drift", False, _gain_drift, description=True)


def _current_lag(fit: Fit) -> Candidates:
    """Add a low-pass filter of the current, or an elastic transmission: the torque's second derivative."""
    model, n = fit.dataset.model, len(fit.gains)
    regressor = model.columns(fit.dataset.base.standard)

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        torques = regressor.torques_along(model.layout, window_motion(model, window), values)
        _, change = differentiate(torques.T, window.run.rate)
        return at_full_rate(window, fit.dataset, change.T[None])

    return Candidates(
        [Finding(F.CURRENT_LAG)],
        ("s2",),
        np.full((1, n), PLAUSIBLE_LAG),
        offer,
    )


CURRENT_LAG = Hypothesis("current lag", False, _current_lag)
