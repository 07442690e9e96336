"""Friction that grows with a joint's load.

The load is the model's, without friction, as in the term ``fl``: the measured current is the friction itself where
friction exceeds the load, so it would explain the noise of the current and any drive gain. A gear does not
transmit the torque of its rotor, which is in the load of ``fl``: it goes with the first column, and with further ones,
of rotors of several inertias, where base parameters regroup the rotor with the links, or the data do not determine it.
"""

from __future__ import annotations

from itertools import compress

import numpy as np

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words, rms_torques
from gtau.estimation.estimators.estimator import Fit
from gtau.robots.parameter import Parameter
from gtau.robots.robot import PLAIN_FRICTION

PLAUSIBLE = 0.05  # friction coefficient of the load: 0.02 to 0.1 in strain-wave gears (UR10e pairs)
# Rotors that are tried, in rms torques over rms accelerations; a mixture stands for one in between. With the load's
# slope by the rotor alone, gains of a five-bar with nine effects were 1.0 % off (now 0.4), of an arm 0.5 (now 0.1).
ROTORS = (0.1, 0.2, 0.4, 0.8)
# Standard deviation of a rotor in this unit, up to which it is known: 0.001 to 0.016 on measured and simulated arms.
# With rotors for all, gains of a UR10e of different days differ by 1.21 standard deviations rms (0.93); with none where
# it was 0.12 or 0.21, a gain was 1.1 +- 0.4 % off (0.1).
UNKNOWN = 0.02


def _torques(at: FitWindow) -> Torques:
    fit, joints, samples = at.fit, at.fit.dataset.model.actuated, at.window.samples()
    unit, base = rms_torques(fit) / fit.dataset.rms_accelerations, fit.dataset.base.names
    modelled = np.array([Parameter("fl", joint) in fit.system.terms for joint in joints])
    rotors = [Parameter("ia", joint) for joint in joints]
    places = [fit.problem.unknowns.places.get(rotor) for rotor in rotors]
    stds = np.array([np.inf if k is None else np.sqrt(fit.solution.covariance[k, k]) for k in places])
    unknown = stds > UNKNOWN * unit
    # their torque is in the load, whether the links have it or not; of passive joints gears transmit the friction too
    unknown_rotors = set(compress(rotors, unknown))
    in_load = [name in unknown_rotors or (name.kind in PLAIN_FRICTION and name.body not in joints) for name in base]
    load = at.torques_along(at.motion, at.transmitted + at.values * in_load).T
    of_term = at.torques_along(at.motion, fit.system.load(at.run, fit.solution.theta)).T
    rotor = samples.qdd * unit * unknown
    more = np.stack([np.abs(load - size * rotor) - np.abs(load) for size in ROTORS])
    loads = np.concatenate([(np.abs(load) - modelled * np.abs(of_term))[None], more])
    return at.decimated((loads * np.sign(samples.qd)).swapaxes(1, 2))


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"load-dependent friction of '{column.joint}'"
    return what, "add runs at other speeds, or with other loads, to separate it from other effects"


COLUMNS = [EffectColumn(PLAUSIBLE, "of its torque")] * (1 + len(ROTORS))
EFFECT = Effect("load-dependent friction", _torques, lambda fit: COLUMNS, _say, function=True)
