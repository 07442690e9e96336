"""A payload that a run does not carry all the time: gripped late, lost early, or supported for a while."""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import RELATIVE, Effect, EffectColumn, FitWindow, Torques, Words
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.assembly import PayloadColumns, known_values
from gtau.estimation.regression.rows import Rows

PLAUSIBLE = 0.02  # of the payload: experience, as bodies do not change their mass
LARGEST = 1.5  # of the payload: a run without it has -1
BEFORE, AFTER = (0.2, 0.4), (0.6, 0.8)  # shares of the run, before or after which the load may be another one


def _torques(at: FitWindow) -> Torques:
    fit = at.fit
    loads = [_values(fit, load) if load.run == at.run else np.zeros(fit.dataset.base.count) for load in _loads(fit)]

    def torques(rows: Rows) -> np.ndarray:
        share = at.along_run(rows.time) + 0.5
        parts = np.array([share < end for end in BEFORE] + [share > begin for begin in AFTER])
        felt = np.array([at.regressor.torques(rows.entries, load, len(fit.gains)) for load in loads])
        return (felt[:, None] * parts[:, None]).reshape(-1, *felt.shape[1:]).transpose(1, 2, 0)

    return torques


def _loads(fit: Fit) -> list[PayloadColumns]:
    return [load for load in fit.system.payloads if load.acts]


def _values(fit: Fit, load: PayloadColumns) -> np.ndarray:
    """Return the base columns' values of a payload, (n_b,)."""
    estimates = dict(zip(fit.system.problem.parameters, fit.solution.theta, strict=True))
    unknown = [estimates.get(name, 0.0) for name in load.unknown]
    return np.asarray(load.columns @ [*unknown, *known_values(load.payload).values()])


def _columns(fit: Fit) -> list[EffectColumn]:
    columns = []
    for load in _loads(fit):
        run, time = fit.dataset.runs[load.run].name, fit.dataset.prepared[load.run].time
        for word, shares in (("before", BEFORE), ("after", AFTER)):
            abouts = [f"run '{run}' {word} {time[0] + share * (time[-1] - time[0]):.2g} s" for share in shares]
            columns += [EffectColumn(PLAUSIBLE, RELATIVE, about=about, largest=LARGEST) for about in abouts]
    return columns


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"a payload that is {'heavier' if size > 0 else 'lighter'} in {column.about}"
    return what, "cut the log to the time in which the robot carries the payload, and touches nothing"


EFFECT = Effect("load along a run", _torques, _columns, _say, shared=True, description=True)
