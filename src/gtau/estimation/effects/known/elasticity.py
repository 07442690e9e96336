"""Elastic joints: the motor, whose position is logged, leads its link by the torque over the stiffness.

The deflection of a joint moves the links behind it, so it changes the torques of all joints, but not the friction and
the rotor of its motor. Base parameters regroup the rotor's inertia ``ia`` with the links', so that the torque is

    B(q - d) + ia dd'',    d = (B - ia q'') / k,

with B the torque of the base parameters and k the stiffness: a second column, of the size ``ia / k``, takes the rotor
out, in the deflection and in what it moves.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import STEP, Effect, EffectColumn, FitWindow, Torques, Words, geared, rms_torques
from gtau.estimation.estimators.estimator import Fit
from gtau.signals.preparation.filters import differentiate

PLAUSIBLE = 1.0  # mrad, or mm, at the rms torque: 50 N m on a strain-wave gear of 2e4 N m/rad are 2.5 mrad
ROTOR = 0.3  # mrad, or mm, at the rms acceleration: a fifth of the torque may speed up the rotor
UNIT, UNIT_OF_ROTOR = "mrad or mm at its rms torque", "mrad or mm at its rms acceleration"
SI = 1e-3


def _motors(fit: Fit) -> list[str]:
    return [joint for joint in fit.dataset.model.actuated if joint in fit.dataset.robot.motors]


def _torques(at: FitWindow) -> Torques:
    fit, window = at.fit, at.window
    torques, per_acceleration = at.torques_along(at.motion, at.transmitted).T, SI / fit.dataset.rms_accelerations
    motions, deflected = (window.q, window.qd, window.qdd), []
    for lead in (torques * SI / rms_torques(fit), window.samples().qdd * per_acceleration):
        steps = (lead, *differentiate(lead, window.run.rate))
        for joint in _motors(fit):
            only = STEP * np.array([name == joint for name in fit.dataset.model.actuated])
            deflected.append(tuple(motion - step * only for motion, step in zip(motions, steps, strict=True)))
    links = at.with_positions(deflected, at.transmitted)
    places = [fit.dataset.model.actuated.index(joint) for joint in _motors(fit)]
    rotors = np.zeros((len(deflected), *torques.T.shape))
    _, change = differentiate(torques * per_acceleration, window.run.rate)
    rotors[range(len(places), len(deflected)), places] = -change.T[places]
    of_rotors = at.decimated(rotors)
    return lambda rows: links(rows) + of_rotors(rows)


def _columns(fit: Fit) -> list[EffectColumn]:
    ratios = {joint: ratio for joint, (ratio, _) in geared(fit).items() if joint in _motors(fit)}
    return [
        *(EffectColumn(PLAUSIBLE / ratio, UNIT, joint, least=0.0) for joint, ratio in ratios.items()),
        *(EffectColumn(ROTOR / ratio, UNIT_OF_ROTOR, joint, about="rotor") for joint, ratio in ratios.items()),
    ]


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    part = f"the {column.about} of " if column.about else ""
    return f"{part}an elastic joint '{column.joint}'", "move more slowly, or log the position behind the gear"


EFFECT = Effect("elasticity", _torques, _columns, _say, shared=True, of_motion=True)
