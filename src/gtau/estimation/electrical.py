"""The motor's own voltage equation: back-EMF constant and resistance of each joint from motion alone.

In SI units the torque constant of a motor is its back-EMF constant. With the drive gain g of a joint, which is both at
the joint, current i, voltage u and speed qd

    u = R i + L di/dt + (g / c) qd + u_0,

c is 1 for a DC motor and the power-invariant q axis, 3/2 for the amplitude-invariant one. Rows are filtered and
decimated as the equations of motion are, so that filters cancel, and keep samples that rest: friction is not in them.
What bridges and windings add is estimated beside, in the mixed model of all effects. g then is an equation beside the
equations of motion (:class:`gtau.estimation.regression.problem.MotorEquation`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gtau.estimation.effects.mixed_model import MixedModel, fit_mixed, lag_products
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.problem import Estimates, MotorEquation
from gtau.estimation.results.estimate import Estimate
from gtau.robots.parameter import Parameter, unit_of
from gtau.signals.preparation.filters import Decimator, position_filter
from gtau.signals.preparation.prepared_run import PreparedRun, valid_samples
from gtau.signals.reading.statements import Drive

CONVENTIONS = {"dc": 1.0, "power": 1.0, "amplitude": 1.5}
COMMUTATION = 0.015  # relative standard deviation of the torque constant over the back-EMF constant
FEWEST = 50  # rows of a joint
KNOTS = 4  # of drifts along a run
LARGEST = 3.0  # plausible sizes of an effect
FLOOR = 5e-4  # of ke and R, whose noise biases them by less
LOST = 0.3  # relative standard deviation of ke, from which it is no reference
# plausible sizes: of dead time and offset over the rms voltage, R and ke over themselves, of lags in s
DEAD, OFFSET, WARMER, WEAKER, SATURATED, LAG, IDLE = 0.05, 0.02, 0.1, 0.01, 0.05, 0.002, 0.02


def motor_equations(dataset: Dataset, drives: Mapping[str, Drive]) -> tuple[MotorEquation, ...]:
    """Fit the voltage equation of each joint whose voltages are logged; those that say nothing are left out."""
    equations = []
    for j, joint in enumerate(dataset.model.actuated):
        if joint not in dataset.robot.motors:
            continue
        decimators = (dataset.preparation.at(prepared.run.rate).decimator for prepared in dataset.prepared)
        pairs = zip(dataset.prepared, decimators, strict=True)
        rows = [part for prepared, decimator in pairs if (part := _rows(prepared, decimator, joint, j)) is not None]
        if sum(part.shape[1] for part in rows) >= FEWEST:
            equation = _equation(joint, rows, drives.get(joint))
            if equation.ke and np.sqrt(equation.covariance[0, 0]) < LOST * abs(equation.ke):
                equations.append(equation)
    return tuple(equations)


def voltage(prepared: PreparedRun, joint: str) -> np.ndarray | None:
    """Return the voltage of a joint's motor at all samples of its run, (N,) in V; None where it was not logged."""
    side, time = prepared.run.side, prepared.run.time
    logged = {key: values.si(joint, time) for key, values in side.items() if joint in values.by_joint}
    if "voltage" in logged:
        return logged["voltage"]
    if "duty" in logged and "supply_voltage" in logged:
        return logged["duty"] * logged["supply_voltage"]
    return None


def _rows(prepared: PreparedRun, decimator: Decimator, joint: str, j: int) -> np.ndarray | None:
    """Filter and decimate the rows of a joint, (8, K); None where it rests, or its voltage was not logged.

    They are the voltage, the current with its rate, speed and acceleration, the column of an idle current, the place
    along the run, 0 to 1, and whether a row begins a stretch without gaps.
    """
    run, kept = prepared.run, prepared.kept
    u = voltage(prepared, joint)
    if u is None or not prepared.moves[j]:
        return None
    side, idle = run.side, np.zeros_like(u)
    if "supply_current" in side and "duty" in side:
        duty = side["duty"].si(joint, run.time)
        idle = duty / np.maximum(duty**2, (0.1 * np.abs(duty).max()) ** 2)
    raw = np.column_stack([u, run.command[:, j], run.position[:, j], idle])
    smooth, rate, second = position_filter(raw, run.rate, prepared.preparation.cutoff, kept.start, kept.stop)
    columns = np.stack([smooth[:, 0], smooth[:, 1], rate[:, 1], rate[:, 2], second[:, 2], smooth[:, 3]])
    valid = valid_samples(run, prepared.preparation, kept.start, kept.stop)[:, j]
    keep = decimator.keep(valid)
    used = np.flatnonzero(keep)
    along, begins = np.linspace(0.0, 1.0, len(keep))[used], np.diff(used, prepend=-2) != 1
    return np.vstack([decimator.apply(columns)[:, used], along, begins])


def _equation(joint: str, parts: Sequence[np.ndarray], drive: Drive | None) -> MotorEquation:
    """Fit ``[ke, R, offset]`` of a joint, with what bridge and winding add as effects of unknown size."""
    u, i, i_d, qd, qdd, idle, _, begins = np.hstack(parts)
    c = CONVENTIONS[drive.convention if drive else "dc"]
    A = np.column_stack([qd / c, i, np.ones_like(u)])
    x = np.linalg.lstsq(A, u, rcond=None)[0]
    if x[1] < 0:  # the voltage counts the other way
        u, x = -u, -x
    ke, R, _ = x
    left = u - A @ x
    level, noise = float(np.std(u)), float(np.std(left)) or 1e-9
    size = float(np.sqrt(np.mean(i**2))) or 1.0
    hats = _hats(parts)
    effects = [
        DEAD * level * np.tanh(i / (0.05 * size))[:, None],
        WARMER * R * i[:, None] * hats,
        WEAKER * ke * qd[:, None] / c * hats,
        LAG * R * i_d[:, None],
        LAG * ke * qdd[:, None] / c,
        SATURATED * R * (i * np.abs(i) / size)[:, None],
        OFFSET * level * hats,
        IDLE * R * idle[:, None],
    ]
    effects = [columns for columns in effects if columns.any()]
    groups = np.repeat(range(len(effects)), [columns.shape[1] for columns in effects])
    rows = np.column_stack([*effects, A, left]) / noise
    nothing, none = np.zeros((A.shape[1] + 1,) * 2), np.zeros(0, dtype=int)
    model = MixedModel((lag_products(rows, begins > 0),), nothing, groups, none, np.full(len(effects), LARGEST))
    at = fit_mixed(model).at
    ke, R, _ = x - at.common
    commutation = drive.commutation if drive else None
    return MotorEquation(
        joint,
        float(ke),
        float(R),
        at.covariance[:2, :2] + np.diag((FLOOR * np.array([ke, R])) ** 2),
        commutation or COMMUTATION,
        commutation is not None,
        1 - float(np.var(left) / max(np.var(u), 1e-300)),
    )


def _hats(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Build hat functions (K, runs KNOTS) along each run."""
    from scipy.linalg import block_diag

    knots = np.linspace(0.0, 1.0, KNOTS)
    return block_diag(*(np.array([np.interp(part[6], knots, hat) for hat in np.eye(KNOTS)]).T for part in parts))


def motor_estimates(dataset: Dataset, estimates: Estimates) -> dict[Parameter, Estimate]:
    """Estimate ke and R of each motor with voltages, moved with the drive gain of the equations of motion."""
    found = dict[Parameter, Estimate]()
    for motor in dataset.motors:
        k = estimates.unknowns.places[Parameter("gain", motor.joint)]
        slopes = motor.covariance[0] / motor.std**2
        values = np.array([motor.ke, motor.resistance]) + slopes * (estimates.values[k] - motor.ke)
        change = estimates.covariance[k, k] - motor.std**2
        stds = np.sqrt(np.maximum(np.diag(motor.covariance) + slopes**2 * change, 0.0))
        for kind, value, std in zip(("ke", "R"), values, stds, strict=True):
            name = Parameter(kind, motor.joint)
            found[name] = Estimate(name, float(value), float(std), unit_of(kind, dataset.robot, motor.joint))
    return found
