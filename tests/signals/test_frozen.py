"""An encoder that freezes while its joint moves is refused; a joint that comes to rest is not."""

from __future__ import annotations

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.signals.run import Run, read_run

RATE = 200.0
SIGNALS = {"time": "t", "position": {"a": "qa", "b": "qb"}, "current": {"a": "ia", "b": "ib"}}


def motion(quantum: float = 1e-4) -> dict[str, np.ndarray]:
    """Two joints that move on, behind encoders with a quantum (rad)."""
    time = np.arange(round(10 * RATE)) / RATE
    angle = 2 * np.pi * time[:, None] * [0.31, 0.23] + [0.4, 1.1]
    q = np.round(0.8 * np.sin(angle) / quantum) * quantum
    current = 2 * np.cos(angle) + 0.5 * np.sign(np.cos(angle)) + 0.01 * np.random.default_rng(1).normal(size=q.shape)
    return {"t": time, "qa": q[:, 0], "qb": q[:, 1], "ia": current[:, 0], "ib": current[:, 1]}


def frozen(begin: float, end: float) -> dict[str, np.ndarray]:
    log = motion()
    at = (log["t"] >= begin) & (log["t"] < end)
    log["qb"] = np.where(at, log["qb"][np.argmax(at)], log["qb"])
    return log


def read(log: dict[str, np.ndarray]) -> Run:
    return read_run(log, SIGNALS)


@pytest.mark.parametrize(("begin", "end"), [(3.5, 5.0), (3.5, 99.0), (0.0, 2.7)])
def test_a_position_that_freezes_in_motion_is_refused(begin: float, end: float) -> None:
    with pytest.raises(GtauError, match=r"joint 'b' stays at .* its encoder was not read; log again"):
        read(frozen(begin, end))


@pytest.mark.parametrize("quantum", [1e-9, 1e-4, 5e-3])
def test_a_joint_in_motion_is_not_refused(quantum: float) -> None:
    """A coarse encoder repeats values at every reversal."""
    assert len(read(motion(quantum)).time) > 1900


@pytest.mark.parametrize("quantum", [1e-9, 1e-4])
@pytest.mark.parametrize("slowing", [0.1, 0.5])
def test_a_joint_that_comes_to_rest_is_not_refused(slowing: float, quantum: float) -> None:
    """It slows down in some tenths of a second, and its current goes on varying with the other joint's motion."""
    log = motion()
    speed = 0.6 * np.clip((4.0 - log["t"]) / slowing, 0.0, 1.0)
    log["qb"] = np.round(np.cumsum(speed) / RATE / quantum) * quantum
    log["ib"] = np.where(log["t"] < 4.0, 1.0, 0.4) * log["ia"]
    assert len(read(log).time) > 1900


def test_a_drive_that_trips_is_not_refused() -> None:
    """A brake stops the joint within a sample, and its drive is off."""
    log = frozen(6.0, 99.0)
    log["ib"] = np.where(log["t"] >= 6.0, 0.002 * log["ib"], log["ib"])
    assert len(read(log).time) > 1900
