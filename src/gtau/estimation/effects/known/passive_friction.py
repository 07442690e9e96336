"""Friction of passive joints that differs between runs.

With changes of 10 % of a tenth of the motors' friction, gains of a five-bar and a 3-RRR were 5 to 8 % off.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words
from gtau.estimation.estimators.estimator import Fit
from gtau.robots.parameter import DRIFTING, Parameter

PLAUSIBLE = 0.1  # relative change between runs, as of motors


def _passive(fit: Fit) -> list[Parameter]:
    """List the friction parameters of passive joints that are estimated."""
    names, driven = fit.system.problem.parameters, fit.dataset.model.actuated
    passive = (name for name in fit.dataset.base.names if name.kind in DRIFTING and name.body not in driven)
    return [name for name in passive if name in names]


def _torques(at: FitWindow) -> Torques:
    base = at.fit.dataset.base.names
    alone = np.eye(len(base))[[base.index(name) for name in _passive(at.fit)]] * at.values
    return lambda rows: np.stack([at.regressor.torques(rows.entries, part, len(at.fit.gains)) for part in alone], -1)


def _columns(fit: Fit) -> list[EffectColumn]:
    return [EffectColumn(PLAUSIBLE, subject=name.body) for name in _passive(fit) if len(fit.dataset.runs) > 1]


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"friction of '{column.subject}' that is {'larger' if size > 0 else 'smaller'} in run '{column.about}'"
    return what, "let the robot warm up before the runs"


EFFECT = Effect("friction of passive joints", _torques, _columns, _say, shared=True, in_runs=True)
