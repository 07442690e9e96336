"""Errors of the description of robot and logs: encoder zeros, scales of positions, gravity, and measured wrenches.

An encoder's zero adds a constant to its joint's position; a wrong gear ratio scales it, with velocity and
acceleration. Torques are linear in gravity, so a tilted base and another strength of gravity are candidate columns. The
offset of a sensor that was not tared is constant along its own axes. A point of application is a lever, ``m = m_at + at
x f``, so that one which is off adds a moment proportional to the force.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import asin, atan2, hypot

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.alternatives import (
    Candidate,
    Candidates,
    Cause,
    Hypothesis,
    moved,
    moved_motion,
    window_motion,
)
from gtau.estimation.diagnostics.linearisation import CandidateColumns, at_full_rate
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.plausibility import stated_rate
from gtau.estimation.regression.rows import external_torques
from gtau.estimation.thresholds import Threshold
from gtau.findings import Finding
from gtau.findings.words import Sentence, Values, which_payload
from gtau.robots.floating import WRENCH
from gtau.signals.preparation.prepared_run import InMemoryRun

DEGREE, MILLIMETRE, PER_CENT = np.pi / 180, 1e-3, 1e-2
STEP = 0.1  # of the unit: the torques' change is linear over this

ZERO = Cause(
    "encoder zero",
    ("an error in the zero of encoder '{joint}'", "compare the encoder zeros with the robot's zero position"),
    Threshold(0.5, "error of an encoder's zero, degrees or mm", evidence="experience"),
)
SCALE = Cause(
    "position scale",
    (
        "another scale of the positions of '{joint}'",
        "check the gear ratio, encoder resolution and unit of its positions",
    ),
    Threshold(
        1.0,
        "error of the scale of a joint's positions, per cent",
        faulty="5 to 110 (UR10e: positions halved, doubled, or 5 % too large); with 0.5, the 110 +- 6.5 of halved "
        "positions of the first joint are not found",
        evidence="UR10e pair; larger ones widen intervals where positions are noisy (AIRBOT Play: by 60 % with 5)",
    ),
)


def _encoder_zeros(fit: Fit) -> Candidates:
    """Add a constant error of a joint's position."""
    units = ["deg" if turns else "mm" for turns in _turns(fit)]
    one = np.ones(len(units))
    steps = np.diag([DEGREE if turns else MILLIMETRE for turns in _turns(fit)])
    return _of_positions(fit, ZERO, units, [(one, STEP * each) for each in steps])


def _position_scales(fit: Fit) -> Candidates:
    """Scale a joint's positions, velocities and accelerations, as a wrong gear ratio does."""
    joints = np.eye(len(fit.dataset.model.actuated))
    return _of_positions(fit, SCALE, ["%"] * len(joints), [(1 + STEP * PER_CENT * each, 0 * each) for each in joints])


def _turns(fit: Fit) -> list[bool]:
    return [fit.dataset.robot.joint(joint).turns for joint in fit.dataset.model.actuated]


def _of_positions(
    fit: Fit, cause: Cause, units: Sequence[str], steps: Sequence[tuple[np.ndarray, np.ndarray]]
) -> Candidates:
    """Move the positions of each joint in turn by a factor and a shift, both (n,), a ``STEP`` of its unit."""
    dataset = fit.dataset
    model, n = dataset.model, len(dataset.model.actuated)
    regressor = model.columns(dataset.base.standard)

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        motion = window_motion(model, window)
        before = regressor.torques_along(model.layout, motion, values)
        columns = np.zeros((n, *before.shape))
        for k, step in enumerate(steps):
            try:
                other = moved_motion(model, moved(window, *step), motion.c[:, 0])
            except GtauError:
                continue  # the loops do not close there: nothing is said of this joint
            columns[k] = (regressor.torques_along(model.layout, other, values) - before) / STEP
        return at_full_rate(window, dataset, columns)

    return Candidates(
        [
            Candidate(Finding(cause.kind, (joint,)), unit, cause.plausible)
            for joint, unit in zip(model.actuated, units, strict=True)
        ],
        offer,
    )


ENCODER_ZEROS = Hypothesis("encoder zeros", True, _encoder_zeros, (ZERO,), description=True)
POSITION_SCALES = Hypothesis("position scales", True, _position_scales, (SCALE,), description=True)


def _of_gravity(what: str) -> Callable[[Values], Sentence]:
    to_do = "check the direction of gravity, that the base is level, the sampling rate"
    return lambda values: (what, to_do + which_payload(values))


def _other_gravity(values: Values) -> Sentence:
    """Name another gravity; where the robot was fitted with it, say what to write."""
    x, y, z = values["gravity"]
    if "left" not in values:  # an estimate to first order
        return _of_gravity(f"a different gravity vector, about ({x:.1f}, {y:.1f}, {z:.1f}) m/s2")(values)
    listed = ", ".join(f"{round(each, 3) + 0.0:.4g}" for each in (x, y, z))
    joint, (before, after) = max(values["left"].items(), key=lambda each: each[1][0])
    where, file = "base", f"'gravity: [{listed}]' in the robot file"
    also = " or ".join(_direction(each) for each in values["also"])
    if values["floating"]:
        where = "world"
        file += ", in axes of the logged poses, or turn the poses so that their z axis points up"
    else:
        rpy = f"{atan2(-y, -z) if round(hypot(y, z), 3) else 0.0:.4g}, {asin(x / hypot(x, y, z)) + 0.0:.4g}, 0"
        file += f", or 'base: {{{{rpy: [{rpy}]}}}}' beside its 'file' in the experiment file"
    return (
        f"gravity along {_direction(values['gravity'])}{also and ' or ' + also} of the {where}, which leaves "
        f"{100 * after:.2g} % of '{joint}' unexplained instead of {100 * before:.2g} %,",
        f"check how the {'world axes lie' if values['floating'] else 'base is mounted'}, and write {file}",
    )


def _direction(gravity: Sequence[float]) -> str:
    """Name an axis, or write a direction of unit length."""
    size = hypot(*gravity)
    unit = [round(each / size, 2) + 0.0 for each in gravity]
    along = [k for k in range(3) if unit[k]]
    if len(along) == 1:
        return f"{'-' if unit[along[0]] < 0 else '+'}{'xyz'[along[0]]}"
    return "({:.2g}, {:.2g}, {:.2g})".format(*unit)


def _clock(values: Values) -> Sentence:
    """Explain residuals that ask for another strength of gravity.

    Time that runs s times too fast makes velocities s and accelerations s^2 times too large, and with them the inertial
    torques against those of gravity, whose length on Earth is known to 0.3 %.
    """
    rate, accelerations = ("high", "large") if values["factor"] > 1 else ("low", "small")
    return (
        f"a sampling rate that is too {rate}, as accelerations are too {accelerations} against gravity (or wrong "
        "lengths throughout the robot)",
        "{clock}; then check the robot's lengths",
    )


TILT = Cause(
    "gravity tilt",
    _of_gravity("gravity tilted towards ({towards[0]:.2g}, {towards[1]:.2g}, {towards[2]:.2g})"),
    Threshold(1.0, "tilt of the base, degrees", evidence="experience"),
    unit="deg",
)
STRENGTH = Cause(
    "gravity strength",
    _of_gravity("a different magnitude of gravity"),
    Threshold(
        0.2,
        "difference of local gravity from the standard, per cent",
        healthy="0.26 at most on Earth",
        evidence="latitude and height",
    ),
    unit="%",
)
OTHER_GRAVITY = Cause("gravity", _other_gravity)
CLOCK = Cause("clock", _clock)
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


def _gravity(fit: Fit) -> Candidates | None:
    """Add a tilt of the base, or another strength of gravity (a wrong clock)."""
    dataset = fit.dataset
    gravity = np.array(dataset.robot.gravity)
    size = float(np.linalg.norm(gravity))
    if not size:
        return None
    _, _, Vt = np.linalg.svd(gravity[None, :])
    changes = [*Vt[1:] * size * DEGREE, gravity / 100]  # m/s2 a degree, and a per cent
    model, n = dataset.model, len(dataset.model.actuated)
    regressor = model.gravity_torques(dataset.base.standard)

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        entries = regressor(model.layout, window_motion(model, window), values)
        return at_full_rate(window, dataset, np.stack([regressor.torques(entries, each, n) for each in changes]))

    tilts = [replace(TILT.candidate, finding=Finding(TILT.kind, values={"towards": t.tolist()})) for t in Vt[1:]]

    def describe(sizes: np.ndarray, shares: np.ndarray) -> Finding:
        factor = 1 + sizes[-1] / 100
        # as where gravity points up
        reversed_ = factor < CLOCK_REVERSED or bool(np.any(fit.gains < 0))
        if shares[-1] > CLOCK_SIZE and not reversed_:
            return Finding(CLOCK.kind, values={"factor": float(factor), "rate": stated_rate(dataset.runs[0])})
        return Finding(OTHER_GRAVITY.kind, values={"gravity": (gravity + sizes @ np.array(changes)).tolist()})

    return Candidates([*tilts, STRENGTH.candidate], offer, describe)


GRAVITY = Hypothesis("gravity", True, _gravity, (TILT, STRENGTH, OTHER_GRAVITY, CLOCK), description=True)


Reading = Callable[[np.ndarray], np.ndarray]
"""From what the wrenches read (6 k, M) to by how much too large that may be, (m, 6 k, M)."""

MILLIMETRE = 1e-3
COMPONENTS = ("moment x", "moment y", "moment z", "force x", "force y", "force z")


def _offset(values: Values) -> Sentence:
    if "component" in values:
        what = f"an offset in the {values['component']} of the wrench on '{{subject}}'"
    else:
        force, moment = (", ".join(f"{each:.2g}" for each in values[part]) for part in ("force", "moment"))
        what = f"an offset of ({force}) N and ({moment}) N m in the wrench on '{{subject}}'"
    return what, "tare the unloaded force sensor before each run, or subtract its unloaded reading"


OFFSET = Cause(
    "wrench offset",
    _offset,
    Threshold(
        0.01,
        "offset of a measured wrench, of the rms of its force or moment",
        healthy="0.1 to 1 % of the range of a tared six-axis sensor",
        faulty="17 % (5 N on a flange that carries 30 N, not tared)",
        evidence="experience; tests/estimation/test_wrench_errors.py",
    ),
)


def _offsets(fit: Fit) -> Candidates | None:
    """Add a constant error of a measured force or moment."""
    bodies = [frame.body for frame in fit.dataset.runs[0].wrenches]
    if not bodies:
        return None
    unit = np.eye(len(WRENCH) * len(bodies))

    def read(measured: np.ndarray) -> np.ndarray:
        """Offset each component in turn by one unit; (m, 6 k, M)."""
        return np.broadcast_to(unit[:, :, None], (*unit.shape, measured.shape[-1]))

    levels = _rms(fit).reshape(-1, 2, 3)
    levels = np.sqrt(np.sum(levels**2, axis=2, keepdims=True)) * np.ones(3)

    def describe(sizes: np.ndarray, shares: np.ndarray) -> Finding:
        worst = int(np.argmax(np.max(np.abs(sizes.reshape(-1, 6)) / np.maximum(levels.reshape(-1, 6), 1e-12), axis=1)))
        moment, force = sizes.reshape(-1, 2, 3)[worst].tolist()
        return Finding(OFFSET.kind, (), bodies[worst], {"force": force, "moment": moment})

    return Candidates(
        [
            Candidate(
                Finding(OFFSET.kind, (), body, {"component": each}),
                "N m" if each.startswith("moment") else "N",
                OFFSET.plausible * level,
            )
            for body, of_body in zip(bodies, levels.reshape(-1, 6), strict=True)
            for each, level in zip(COMPONENTS, of_body, strict=True)
        ],
        lambda window, values: _felt(fit, window, read),
        describe,
    )


WRENCH_OFFSETS = Hypothesis("wrench offsets", True, _offsets, (OFFSET,), description=True)


def _point(values: Values) -> Sentence:
    if "axis" in values:
        off = f"off in {values['axis']}"
    else:
        off = f"off by ({', '.join(f'{1e3 * each:.2g}' for each in values['shift'])}) mm"
    return (
        f"the reference point of the moment on '{{subject}}', {off}",
        "measure the position of the sensor, and correct 'at' of that wrench",
    )


POINT = Cause(
    "wrench point",
    _point,
    Threshold(
        2.0,
        "error of the point about which a wrench is stated, mm",
        faulty="20 (a plate, a flange)",
        evidence="experience",
    ),
    unit="mm",
)


def _points(fit: Fit) -> Candidates | None:
    """Add another point about which a measured moment is stated."""
    bodies = [frame.body for frame in fit.dataset.runs[0].wrenches]
    if not bodies:
        return None

    def read(measured: np.ndarray) -> np.ndarray:
        """Compute the errors of the moments for a force that acts 1 mm further back; (3 k, 6 k, M)."""
        found = np.zeros((3 * len(bodies), *measured.shape))
        for k in range(len(bodies)):
            force = measured[6 * k + 3 : 6 * k + 6].T
            for axis, direction in enumerate(np.eye(3)):
                found[3 * k + axis, 6 * k : 6 * k + 3] = -MILLIMETRE * np.cross(direction, force).T
        return found

    def describe(sizes: np.ndarray, shares: np.ndarray) -> Finding:
        worst = int(np.argmax(np.max(np.abs(sizes.reshape(-1, 3)), axis=1)))
        shift = (MILLIMETRE * sizes.reshape(-1, 3)[worst]).tolist()
        return Finding(POINT.kind, (), bodies[worst], {"shift": shift})

    return Candidates(
        [
            replace(POINT.candidate, finding=Finding(POINT.kind, (), body, {"axis": axis}))
            for body in bodies
            for axis in "xyz"
        ],
        lambda window, values: _felt(fit, window, read),
        describe,
    )


WRENCH_POINTS = Hypothesis("wrench points", True, _points, (POINT,), description=True)


def _rms(fit: Fit) -> np.ndarray:
    """Compute the rms of all components of the wrenches in all runs, (6 k,), N m and N."""
    squares = [np.mean(run.command[:, run.given] ** 2, axis=0) for run in fit.dataset.runs]
    return np.asarray(np.sqrt(np.mean(squares, axis=0)))


def _felt(fit: Fit, window: InMemoryRun, read: Reading) -> CandidateColumns:
    """Compute the joint torques that errors of the wrench readings cause."""
    model, run = fit.dataset.model, window.run
    measured = window.samples().command.T
    extra = read(measured[run.given])
    padded = np.zeros((len(extra), len(run.channels), extra.shape[-1]))
    padded[:, run.given] = extra
    return at_full_rate(window, fit.dataset, external_torques(model, run, window_motion(model, window), padded))
