"""Errors of the description of robot and logs: encoder zeros, scales of positions, gravity, and measured wrenches.

An encoder's zero adds a constant to its joint's position; a wrong gear ratio scales it, with velocity and
acceleration. Torques are linear in gravity, so a tilted base and another strength of gravity are candidate columns. The
offset of a sensor that was not tared is constant along its own axes. A point of application is a lever, ``m = m_at + at
x f``, so that one which is off adds a moment proportional to the force.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.alternatives import Alternative, Hypothesis, candidate
from gtau.estimation.diagnostics.linearisation import CandidateColumns, FitWindow, motion_along
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.plausibility import stated_rate
from gtau.estimation.regression.rows import external_torques, instants
from gtau.estimation.thresholds import Threshold
from gtau.findings import Finding
from gtau.robots.placement import WRENCH

DEGREE, MILLIMETRE, PER_CENT = np.pi / 180, 1e-3, 1e-2
STEP = 0.1  # of the unit: the torques' change is linear over this

ZERO = candidate("encoder zero", Threshold(0.5, "error of an encoder's zero, degrees or mm", evidence="experience"))
SCALE = candidate(
    "position scale",
    Threshold(
        1.0,
        "error of the scale of a joint's positions, per cent",
        faulty="5 to 110 (UR10e: positions halved, doubled, or 5 % too large); with 0.5, the 110 +- 6.5 of halved "
        "positions of the first joint are not found",
        evidence="UR10e pair; larger ones widen intervals where positions are noisy (AIRBOT Play: by 60 % with 5)",
    ),
    unit="%",
)


def _encoder_zeros(at: FitWindow) -> CandidateColumns:
    """Add a constant error of a joint's position."""
    steps = np.diag([STEP * (DEGREE if unit == "deg" else MILLIMETRE) for unit in _units(at.fit)])
    return _with_positions(at, np.ones_like(steps), steps)


def _position_scales(at: FitWindow) -> CandidateColumns:
    """Add a scale error of a joint's positions, velocities and accelerations, as of a wrong gear ratio."""
    joints = np.eye(len(at.fit.dataset.model.actuated))
    return _with_positions(at, 1 + STEP * PER_CENT * joints, 0 * joints)


def _units(fit: Fit) -> list[str]:
    return ["deg" if fit.dataset.robot.joint(joint).turns else "mm" for joint in fit.dataset.model.actuated]


def _with_positions(at: FitWindow, factors: np.ndarray, shifts: np.ndarray) -> CandidateColumns:
    """Move the positions of each joint in turn by factors and shifts, both (., n), a ``STEP`` of its unit."""
    model, window = at.fit.dataset.model, at.window
    before = at.torques_along(at.motion, at.values)
    columns = np.zeros((len(shifts), *before.shape))
    for column, factor, shift in zip(columns, factors, shifts, strict=True):
        q, qd, qdd = window.q * factor + shift, window.qd * factor, window.qdd * factor
        moved, labels = replace(window, q=q, qd=qd, qdd=qdd, part_of=None), instants(window.run.name, window.time)
        try:  # from each configuration, so that loops are closed as before
            path = model.near(at.motion.c, np.ascontiguousarray(q.T), labels)
            after = at.torques_along(motion_along(model, moved, path), at.values)
        except GtauError:
            continue  # the loops do not close there: nothing is said of this joint
        column[:] = (after - before) / STEP
    return at.decimated(columns)


def _zeros_of(fit: Fit) -> list[Alternative]:
    joints = zip(fit.dataset.model.actuated, _units(fit), strict=True)
    return [replace(ZERO.on(joint), unit=unit) for joint, unit in joints]


def _scales_of(fit: Fit) -> list[Alternative]:
    return list(map(SCALE.on, fit.dataset.model.actuated))


ENCODER_ZEROS = Hypothesis("encoder zeros", True, _encoder_zeros, _zeros_of, description=True)
POSITION_SCALES = Hypothesis("position scales", True, _position_scales, _scales_of, description=True)


TILT = candidate("gravity tilt", Threshold(1.0, "tilt of the base, degrees", evidence="experience"), unit="deg")
STRENGTH = candidate(
    "gravity strength",
    Threshold(
        0.2,
        "difference of local gravity from the standard, per cent",
        healthy="0.26 at most on Earth",
        evidence="latitude and height",
    ),
    unit="%",
)
OTHER_GRAVITY = candidate("gravity")
# Time that runs s times too fast makes velocities s and accelerations s^2 times too large, and with them the inertial
# torques against those of gravity, whose length on Earth is known to 0.3 %.
CLOCK = candidate("clock")
CLOCK_SIZE = Threshold(
    0.9,
    "part of what another gravity explains that another strength of it explains alone: the clock is wrong",
    faulty="0.97 (UR10e at 95 Hz read as 125)",
    evidence="UR10e logs with another rate declared",
)
CLOCK_REVERSED = Threshold(
    -0.9,
    "factor of gravity, below which it is rather reversed than of another strength",
    faulty="-1 (upside down)",
    evidence="faults",
)


def _gravity(at: FitWindow) -> CandidateColumns:
    """Add a tilt of the base, or another strength of gravity (a wrong clock)."""
    model, n = at.fit.dataset.model, len(at.fit.dataset.model.actuated)
    regressor = model.gravity_torques(at.fit.dataset.base.standard)
    entries = regressor(model.layout, at.motion, at.values)
    changes = _changes_of_gravity(at.fit)
    return at.decimated(np.stack([regressor.torques(entries, change, n) for change in changes]))


def _across(gravity: np.ndarray) -> np.ndarray:
    """Find two directions (2, 3) across gravity, towards which it may be tilted."""
    return np.asarray(np.linalg.svd(gravity[None, :])[2][1:])


def _changes_of_gravity(fit: Fit) -> np.ndarray:
    """Compute changes (3, 3) of gravity: by a degree towards either direction, and by a per cent, m/s2."""
    gravity = np.array(fit.dataset.robot.gravity)
    return np.vstack([_across(gravity) * float(np.linalg.norm(gravity)) * DEGREE, gravity / 100])


def _gravity_columns(fit: Fit) -> list[Alternative]:
    gravity = np.array(fit.dataset.robot.gravity)
    tilts = [TILT.on(towards=direction.tolist()) for direction in _across(gravity)]
    return [*tilts, STRENGTH] if gravity.any() else []


def _gravity_found(fit: Fit, sizes: np.ndarray, shares: np.ndarray) -> Finding:
    factor = float(1 + sizes[-1] / 100)
    reversed_ = factor < CLOCK_REVERSED or bool(np.any(fit.gains < 0))  # as where gravity points up
    if shares[-1] > CLOCK_SIZE and not reversed_:
        return Finding(CLOCK.kind, values={"factor": factor, "rate": stated_rate(fit.dataset.runs[0])})
    gravity = fit.dataset.robot.gravity + sizes @ _changes_of_gravity(fit)
    return Finding(OTHER_GRAVITY.kind, values={"gravity": gravity.tolist()})


GRAVITY = Hypothesis("gravity", True, _gravity, _gravity_columns, _gravity_found, description=True)

OFFSET = candidate(
    "wrench offset",
    Threshold(
        0.01,
        "offset of a measured wrench, of the rms of its force or moment",
        healthy="0.1 to 1 % of the range of a tared six-axis sensor",
        faulty="17 % (5 N on a flange that carries 30 N, not tared)",
        evidence="experience; tests/estimation/test_wrench_errors.py",
    ),
)


def _offsets(at: FitWindow) -> CandidateColumns:
    """Add a constant error of a measured force or moment."""
    unit = np.eye(len(WRENCH) * len(_sensed_bodies(at.fit)))
    return _felt(at, np.broadcast_to(unit[:, :, None], (*unit.shape, len(at.window))))


def _sensed_bodies(fit: Fit) -> list[str]:
    return [frame.body for frame in fit.dataset.runs[0].wrenches]


def _levels(fit: Fit) -> np.ndarray:
    """Compute the rms moment and force of each wrench in all runs, (k, 2)."""
    squares = [np.mean(run.command[:, run.given] ** 2, axis=0) for run in fit.dataset.runs]
    return np.asarray(np.sqrt(np.mean(squares, axis=0).reshape(-1, 2, 3).sum(axis=2)))


def _offset_columns(fit: Fit) -> Iterator[Alternative]:
    bodies = _sensed_bodies(fit)
    for body, levels in zip(bodies, _levels(fit) if bodies else (), strict=True):
        for quantity, unit, level in zip(("moment", "force"), ("N m", "N"), levels, strict=True):
            plausible = float(OFFSET.plausible * level)
            for axis in "xyz":
                column = OFFSET.on(subject=body, component=f"{quantity} {axis}")
                yield replace(column, unit=unit, plausible=plausible)


def _offset_found(fit: Fit, sizes: np.ndarray, shares: np.ndarray) -> Finding:
    sizes = sizes.reshape(-1, 2, 3)
    relative = np.abs(sizes) / np.maximum(_levels(fit), 1e-12)[..., None]
    worst = int(np.argmax(relative.max(axis=(1, 2))))
    moment, force = sizes[worst].tolist()
    return Finding(OFFSET.kind, (), _sensed_bodies(fit)[worst], {"force": force, "moment": moment})


WRENCH_OFFSETS = Hypothesis("wrench offsets", True, _offsets, _offset_columns, _offset_found, description=True)


POINT = candidate(
    "wrench point",
    Threshold(
        2.0,
        "error of the point about which a wrench is stated, mm",
        faulty="20 (a plate, a flange)",
        evidence="experience",
    ),
    unit="mm",
)


def _points(at: FitWindow) -> CandidateColumns:
    """Add another point about which a measured moment is stated."""
    bodies = np.arange(len(_sensed_bodies(at.fit)))
    measured = at.window.samples().command.T[at.window.run.given]
    # of a force that acts 1 mm further back
    force = measured.reshape(len(bodies), 2, 1, 3, -1)[:, 1]
    errors = np.zeros((len(bodies), 3, len(bodies), 6, measured.shape[1]))
    errors[bodies, :, bodies, :3] = -MILLIMETRE * np.cross(np.eye(3)[:, :, None], force, axis=-2)
    return _felt(at, errors.reshape(3 * len(bodies), *measured.shape))


def _point_found(fit: Fit, sizes: np.ndarray, shares: np.ndarray) -> Finding:
    sizes = sizes.reshape(-1, 3)
    worst = int(np.argmax(np.abs(sizes).max(axis=1)))
    shift = (MILLIMETRE * sizes[worst]).tolist()
    return Finding(POINT.kind, (), _sensed_bodies(fit)[worst], {"shift": shift})


def _point_columns(fit: Fit) -> list[Alternative]:
    return [POINT.on(subject=body, axis=axis) for body in _sensed_bodies(fit) for axis in "xyz"]


WRENCH_POINTS = Hypothesis("wrench points", True, _points, _point_columns, _point_found, description=True)


def _felt(at: FitWindow, errors: np.ndarray) -> CandidateColumns:
    """Compute the joint torques that errors (m, 6 k, N) of the wrench readings cause."""
    run = at.window.run
    padded = np.zeros((len(errors), len(run.channels), errors.shape[-1]))
    padded[:, run.given] = errors
    return at.decimated(external_torques(at.fit.dataset.model, run, at.motion, padded))
