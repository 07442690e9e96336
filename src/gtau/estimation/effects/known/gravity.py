"""A tilt of the base, or another strength of gravity, which a wrong clock has the effect of.

Time that runs s times too fast makes velocities s and accelerations s^2 times too large, and with them the inertial
torques against gravity, whose strength on Earth is known to 0.3 %.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.plausibility import stated_rate
from gtau.findings import clock_advice, percent

TILT, STRENGTH = 1.0, 0.1  # degrees (experience); per cent: local gravity differs by 0.26 % from the standard at most
STEEPEST = 12.0  # degrees: a Sawyer tilted by 4.0 degrees is found as 3.87 +- 0.18
EARTH = 0.5  # per cent: beyond it another strength is no gravity, but a wrong clock or wrong lengths


def _torques(at: FitWindow) -> Torques:
    model, n = at.fit.dataset.model, len(at.fit.dataset.model.actuated)
    regressor = model.gravity_torques(at.fit.dataset.base.standard)
    entries = regressor(model.layout, at.motion, at.values)
    changes = gravity_changes(np.array(at.fit.dataset.robot.gravity))
    return at.decimated(np.stack([regressor.torques(entries, change, n) for change in changes]))


def gravity_changes(gravity: np.ndarray) -> np.ndarray:
    """Compute changes (3, 3) of gravity: by a degree towards two directions across it, and by a per cent, m/s2."""
    across = np.linalg.svd(gravity[None, :])[2][1:]
    return np.vstack([across * float(np.linalg.norm(gravity)) * np.pi / 180, gravity / 100])


def _columns(fit: Fit) -> list[EffectColumn]:
    gravity = np.array(fit.dataset.robot.gravity)
    if not gravity.any():
        return []
    towards = [
        ", ".join(f"{x:.2g}" for x in change / np.linalg.norm(change)) for change in gravity_changes(gravity)[:2]
    ]
    return [
        *(EffectColumn(TILT, "deg", about=direction, largest=STEEPEST) for direction in towards),
        EffectColumn(STRENGTH, "%", about="strength"),
    ]


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    strength = column.about == "strength"
    if strength and abs(size) > EARTH:
        return clock_words(fit, max(1 - size / 100, 0.1) ** -0.5)
    what = "a different magnitude of gravity" if strength else f"gravity tilted towards ({column.about})"
    loads = ", which runs carry the payload, and on which body" if fit.system.payloads else ""
    return what, f"check the direction of gravity, that the base is level, the sampling rate{loads}"


def clock_words(fit: Fit, factor: float) -> Words:
    """Say that time runs a ``factor`` too fast, or that the lengths are too large by its square: they look alike."""
    high, large = ("high", "large") if factor > 1 else ("low", "small")
    off, off_squared = (percent(abs(ratio - 1)) for ratio in (factor, factor**2))
    clock = f"a sampling rate that is too {high} by {off}"
    lengths = f"lengths throughout the robot that are too {large} by {off_squared}"
    against = f"as accelerations are too {large} against gravity"
    if (rate := stated_rate(fit.dataset.runs[0])) is None:
        return f"{lengths}, or {clock}, {against}", "check the lengths in the robot file; then the log's time"
    return f"{clock}, or {lengths}, {against}", f"{clock_advice(rate)} (rather {rate / factor:.3g}); then the lengths"


EFFECT = Effect("gravity", _torques, _columns, _say, shared=True, description=True)
