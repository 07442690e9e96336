"""What kind of wrong a command column is: motors that were off, values that stay, coarse ones; healthy ones pass."""

from __future__ import annotations

import numpy as np
import pytest
from small_blocks import working_with

from gtau.errors import GtauError
from gtau.signals.run import Run, read_run

RATE = 200.0
SIGNALS = {"time": "t", "position": {"a": "qa", "b": "qb"}, "torque": {"a": "ia", "b": "ib"}}
Log = dict[str, np.ndarray]


def motion(noise: float = 0.01) -> Log:
    time = np.arange(round(10 * RATE)) / RATE
    angle = 2 * np.pi * time[:, None] * [0.31, 0.23] + [0.4, 1.1]
    torque = 2 * np.cos(angle) + 0.5 * np.sign(np.cos(angle))
    torque += noise * np.random.default_rng(1).normal(size=angle.shape)
    q = 0.8 * np.sin(angle)
    return {"t": time, "qa": q[:, 0], "qb": q[:, 1], "ia": torque[:, 0], "ib": torque[:, 1]}


def put(log: Log, column: str, value: float | None, begin: float, end: float) -> Log:
    """Let a column stay at a value, or at its own one at the begin."""
    at = (log["t"] >= begin) & (log["t"] < end)
    value = log[column][np.argmax(at)] if value is None else value
    return log | {column: np.where(at, value, log[column])}


def read(log: Log) -> Run:
    return read_run(log, SIGNALS)


@pytest.mark.parametrize(
    ("begin", "end", "remedy"),
    [
        (6.0, 99.0, "from 6 s to the end in full motion: the motors were off; leave that part out (to: 5.995)"),
        (0.0, 4.0, "from 0 s to 4 s in full motion: the motors were off; leave that part out (from: 4)"),
        (3.0, 5.0, "one with 'to: 2.995', one with 'from: 5')"),
    ],
)
@pytest.mark.parametrize("block", [97, 1 << 16])
def test_motors_that_are_off_are_named_with_what_to_leave_out(
    begin: float, end: float, remedy: str, block: int
) -> None:
    log = put(put(motion(), "ia", 0.0, begin, end), "ib", 0.0, begin, end)
    with working_with(block), pytest.raises(GtauError) as refusal:
        read(log)
    assert "the command of joints 'a' and 'b' stays at 0 from" in str(refusal.value)
    assert remedy in str(refusal.value)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_all_times_at_which_motors_are_off_are_named_and_noise_does_not_hide_them(noise: float) -> None:
    log, rng = motion(), np.random.default_rng(2)
    for begin, end in ((2.0, 3.5), (6.0, 7.0)):
        log = put(put(log, "ia", 0.0, begin, end), "ib", 0.0, begin, end)
    log |= {name: log[name] + noise * rng.normal(size=log["t"].shape) for name in ("ia", "ib")}
    with pytest.raises(GtauError, match=r"from 2 s to 3\.5 s and from 6 s to 7 s in full motion: the motors were off"):
        read(log)


def test_motors_that_are_off_are_no_magnitudes_and_not_clipped() -> None:
    """A torque that is never negative while the motor drives ends at zero."""
    log = motion()
    log = put(log | {"ia": np.abs(log["ia"]) + 1e-3}, "ia", 0.0, 5.0, 99.0)
    with pytest.raises(GtauError, match=r"joint 'a' stays at 0 from 5 s .*the motors were off"):
        read(log)


@pytest.mark.parametrize("end", [4.2, 99.0])
def test_a_torque_that_freezes_is_named(end: float) -> None:
    with pytest.raises(GtauError, match=r"command of joint 'b' stays at .* from 3 s to .*: it was not read; leave"):
        read(put(motion(), "ib", None, 3.0, end))


@pytest.mark.parametrize("step", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.2])
def test_rounded_torques_are_coarse_and_not_clipped(step: float, noise: float) -> None:
    log = motion(noise)
    run = read(log | {name: step * np.round(log[name] / step) for name in ("ia", "ib")})
    notes = " ".join(map(str, run.notes))
    assert f"the command of joint 'a' is rounded to steps of {step:g}" in notes
    assert "clipped" not in notes
    assert run.valid.all()


def test_motors_that_are_off_are_found_in_rounded_torques_too() -> None:
    log = motion()
    log |= {name: np.round(log[name]) for name in ("ia", "ib")}
    with pytest.raises(GtauError, match="the motors were off"):
        read(put(put(log, "ia", 0.0, 5.0, 99.0), "ib", 0.0, 5.0, 99.0))


@pytest.mark.parametrize("step", [1e-9, 0.01, 0.02])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_healthy_torques_are_none_of_these(step: float, noise: float) -> None:
    log = motion(noise)
    assert read(log | {name: step * np.round(log[name] / step) for name in ("ia", "ib")}).notes == ()


def test_the_dead_band_of_a_sensor_is_no_motor_that_is_off() -> None:
    log = motion()
    assert read(log | {"ia": np.where(np.abs(log["ia"]) < 0.9, 0.0, log["ia"])}).notes == ()


def test_a_robot_that_rests_with_its_brakes_on_is_not_refused() -> None:
    log = motion()
    rest = log["t"] < 4.0
    for name in ("qa", "qb"):
        log[name] = np.where(rest, log[name][800], log[name])
    for name in ("ia", "ib"):
        log[name] = np.where(rest, 0.0, log[name])
    assert read(log).notes == ()
