"""Viscous and Coulomb friction that change along a run, as joints warm up.

The change is a parabola in time, as warm-up is exponential: with a linear one gains of two arms whose friction falls by
5 % were 0.40 % off (rms of 40; now 0.27), of the unloaded arm of a robot with two up to 1.7 % (now 0.9).
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words, plain_friction
from gtau.estimation.estimators.estimator import Fit
from gtau.robots.parameter import Parameter

PLAUSIBLE = 0.1  # relative change along a run: experience


def _torques(at: FitWindow) -> Torques:
    terms, samples, joints = at.fit.system.terms, at.window.samples(), at.fit.dataset.model.actuated
    # friction that depends on the temperature has a slope of its own for this
    free = np.array([{Parameter("fvt", joint), Parameter("fst", joint)}.isdisjoint(terms) for joint in joints])
    fv, fs = plain_friction(at.fit)
    friction = np.stack([(free * fv * samples.qd).T, (free * fs * np.sign(samples.qd)).T])
    along = at.along_run(samples.time)
    return at.decimated(np.concatenate([friction * along, friction * (2 * along**2 - 1 / 6)]))


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"{column.about} friction of '{column.joint}' changing along the runs"
    return what, "let the robot warm up before the runs, or split long runs"


COLUMNS = [EffectColumn(PLAUSIBLE, about="viscous"), EffectColumn(PLAUSIBLE, about="Coulomb")] * 2
EFFECT = Effect("friction drift", _torques, lambda fit: COLUMNS, _say)
