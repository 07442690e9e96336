"""Whether what an accelerometer on the base reads is gravity, on average."""

from __future__ import annotations

import numpy as np

from gtau.errors import GtauError
from gtau.signals.columns import Signals

# m/s2: a base that stays in its place has no mean acceleration. A bias of 0.3 m/s2 and a tilt of 2 degrees make 0.6; a
# reading in g makes 8.8, one upside down 20, a quaternion with its scalar last nothing where
# the base hardly turns, else some.
LARGEST_MEAN = 1.0
SHORTEST = 2.0  # s: in less a base may well begin or end in motion


def check_accelerometer(run: str, signals: Signals, time: np.ndarray, position: np.ndarray) -> None:
    """Refuse a run in which the base seems to accelerate all the time, though something holds it.

    Parameters
    ----------
    run : str
        Its name, for the message.
    signals : Signals
        With an accelerometer on the base.
    time, position : ndarray
        (N,) in s, and (N, n), of the base's six joints first, its position integrated.

    Raises
    ------
    GtauError
        The mean acceleration is not small: the unit, the mounting, or the order of the quaternion is wrong.
    """
    base = signals.base
    span = float(time[-1] - time[0])
    if base is None or base.accelerometer is None or not (base.wrenches or signals.wrenches) or span < SHORTEST:
        return  # in flight it falls
    t = (np.asarray(time) - time[0]) / span - 0.5
    mean = 2 * np.polynomial.polynomial.polyfit(t, np.asarray(position[:, :3]), 2)[2] / span**2
    if np.linalg.norm(mean) <= LARGEST_MEAN:
        return
    gravity = base.accelerometer.gravity
    reading = mean + np.array([0.0, 0.0, gravity])
    size = float(np.linalg.norm(reading))
    if abs(size - 1.0) < 0.1:
        hint = "it seems to read in g, so multiply its columns by the acceleration of gravity"
    elif reading[2] < -0.9 * gravity:
        hint = "it points down, so reverse its columns, or correct the quaternion"
    else:
        hint = "check its unit, that its axes are those of the base, and the order w, x, y, z of the quaternion"
    listed = ", ".join(f"{each:.3g}" for each in reading)
    raise GtauError(
        f"run '{run}': the accelerometer of the base reads ({listed}) m/s2 in the world on average, where a base "
        f"that is held reads (0, 0, {gravity:.4g}); {hint}."
    )
