"""Errors of the description of robot and logs: encoder zeros, scales of positions, gravity, and measured wrenches.

An encoder's zero adds a constant to its joint's position; a wrong gear ratio scales it, with velocity and
acceleration. Torques are linear in gravity, so a tilted base and another strength of gravity are candidate columns. The
offset of a sensor that was not tared is constant along its own axes. A point of application is a lever, ``m = m_at + at
x f``, so that one which is off adds a moment proportional to the force.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.alternatives import Alternative, Hypothesis, candidate
from gtau.estimation.diagnostics.linearisation import CandidateColumns, Moving, Offer, at_full_rate, motion_along
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.plausibility import stated_rate
from gtau.estimation.regression.rows import Labels, external_torques
from gtau.estimation.thresholds import Threshold
from gtau.findings import Finding
from gtau.robots.floating import WRENCH
from gtau.signals.preparation.prepared_run import SampleWindow

DEGREE, MILLIMETRE, PER_CENT = np.pi / 180, 1e-3, 1e-2
STEP = 0.1  # of the unit: the torques' change is linear over this

ZERO = candidate(
    "encoder zero",
    Threshold(0.5, "error of an encoder's zero, degrees or mm", evidence="experience"),
)
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


def _encoder_zeros(fit: Fit) -> Offer:
    """Add a constant error of a joint's position."""
    steps = np.diag([STEP * (DEGREE if unit == "deg" else MILLIMETRE) for unit in _units(fit)])
    return _with_positions(fit, [(np.ones(len(steps)), step) for step in steps])


def _position_scales(fit: Fit) -> Offer:
    """Scale a joint's positions, velocities and accelerations, as a wrong gear ratio does."""
    joints = np.eye(len(fit.dataset.model.actuated))
    return _with_positions(fit, [(1 + STEP * PER_CENT * joint, 0 * joint) for joint in joints])


def _units(fit: Fit) -> list[str]:
    return ["deg" if fit.dataset.robot.joint(joint).turns else "mm" for joint in fit.dataset.model.actuated]


def _with_positions(fit: Fit, steps: Sequence[tuple[np.ndarray, np.ndarray]]) -> Offer:
    """Move the positions of each joint in turn by a factor and a shift, both (n,), a ``STEP`` of its unit."""
    model = fit.dataset.model
    regressor = model.columns(fit.dataset.base.standard)

    def offer(window: SampleWindow, motion: Moving, values: np.ndarray) -> CandidateColumns:
        before = regressor.torques_along(model.layout, motion(), values)
        columns = np.zeros((len(steps), *before.shape))
        for k, (factor, shift) in enumerate(steps):
            q, qd, qdd = window.q * factor + shift, window.qd * factor, window.qdd * factor
            moved, labels = replace(window, q=q, qd=qd, qdd=qdd, part_of=None), Labels(window.run.name, window.time)
            try:  # from near the first configuration, so that loops are closed as before
                path = model.path(np.ascontiguousarray(moved.q.T), labels, motion().c[:, 0])
                after = regressor.torques_along(model.layout, motion_along(model, moved, path), values)
            except GtauError:
                continue  # the loops do not close there: nothing is said of this joint
            columns[k] = (after - before) / STEP
        return at_full_rate(window, fit, columns)

    return offer


def _zeros_of(fit: Fit) -> list[Alternative]:
    joints = zip(fit.dataset.model.actuated, _units(fit), strict=True)
    return [replace(ZERO.on(joint), unit=unit) for joint, unit in joints]


def _scales_of(fit: Fit) -> list[Alternative]:
    return list(map(SCALE.on, fit.dataset.model.actuated))


ENCODER_ZEROS = Hypothesis("encoder zeros", True, _encoder_zeros, _zeros_of, description=True)
POSITION_SCALES = Hypothesis("position scales", True, _position_scales, _scales_of, description=True)


TILT = candidate(
    "gravity tilt",
    Threshold(1.0, "tilt of the base, degrees", evidence="experience"),
    unit="deg",
)
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


def _gravity(fit: Fit) -> Offer:
    """Add a tilt of the base, or another strength of gravity (a wrong clock)."""
    model, n = fit.dataset.model, len(fit.dataset.model.actuated)
    regressor, changes = model.gravity_torques(fit.dataset.base.standard), _changes_of_gravity(fit)

    def offer(window: SampleWindow, motion: Moving, values: np.ndarray) -> CandidateColumns:
        entries = regressor(model.layout, motion(), values)
        return at_full_rate(window, fit, np.stack([regressor.torques(entries, change, n) for change in changes]))

    return offer


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

Reading = Callable[[np.ndarray], np.ndarray]
"""From what the wrenches read (6 k, M) to by how much too large that may be, (m, 6 k, M)."""


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


def _offsets(fit: Fit) -> Offer:
    """Add a constant error of a measured force or moment."""
    unit = np.eye(len(WRENCH) * len(_sensed_bodies(fit)))

    def read(measured: np.ndarray) -> np.ndarray:
        """Offset each component in turn by one unit; (m, 6 k, M)."""
        return np.broadcast_to(unit[:, :, None], (*unit.shape, measured.shape[-1]))

    return _felt(fit, read)


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


def _points(fit: Fit) -> Offer:
    """Add another point about which a measured moment is stated."""
    bodies = np.arange(len(_sensed_bodies(fit)))

    def read(measured: np.ndarray) -> np.ndarray:
        """Compute the errors of the moments for a force that acts 1 mm further back; (3 k, 6 k, M)."""
        force = measured.reshape(len(bodies), 2, 1, 3, -1)[:, 1]
        moments = np.cross(np.eye(3)[:, :, None], force, axis=2)  # (k, axes, 3, M)
        errors = np.zeros((len(bodies), 3, len(bodies), 6, measured.shape[1]))
        errors[bodies, :, bodies, :3] = -MILLIMETRE * moments
        return errors.reshape(3 * len(bodies), *measured.shape)

    return _felt(fit, read)


def _point_found(fit: Fit, sizes: np.ndarray, shares: np.ndarray) -> Finding:
    sizes = sizes.reshape(-1, 3)
    worst = int(np.argmax(np.abs(sizes).max(axis=1)))
    shift = (MILLIMETRE * sizes[worst]).tolist()
    return Finding(POINT.kind, (), _sensed_bodies(fit)[worst], {"shift": shift})


def _point_columns(fit: Fit) -> list[Alternative]:
    return [POINT.on(subject=body, axis=axis) for body in _sensed_bodies(fit) for axis in "xyz"]


WRENCH_POINTS = Hypothesis("wrench points", True, _points, _point_columns, _point_found, description=True)


def _felt(fit: Fit, read: Reading) -> Offer:
    """Compute the joint torques that errors of the wrench readings cause."""
    model = fit.dataset.model

    def offer(window: SampleWindow, motion: Moving, values: np.ndarray) -> CandidateColumns:
        run = window.run
        extra = read(window.samples().command.T[run.given])
        padded = np.zeros((len(extra), len(run.channels), extra.shape[-1]))
        padded[:, run.given] = extra
        return at_full_rate(window, fit, external_torques(model, run, motion(), padded))

    return offer
