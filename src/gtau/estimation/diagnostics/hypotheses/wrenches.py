"""Errors of measured wrenches: a sensor that was not tared, and a misplaced point of application.

A sensor's offset is constant along its own axes. A point is a lever, ``m = m_at + at x f``, so that one which is
off adds a moment proportional to the force.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.hypotheses.hypothesis import Candidate, Candidates, Cause, Hypothesis, window_motion
from gtau.estimation.diagnostics.linearisation import CandidateColumns, at_full_rate
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.rows import external_torques
from gtau.estimation.thresholds import Threshold
from gtau.findings import Finding
from gtau.findings.words import Sentence, Values
from gtau.robots.floating import WRENCH
from gtau.signals.preparation import InMemoryRun

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
