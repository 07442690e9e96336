"""The motor's own voltage equation: back-EMF constant and resistance of each joint from motion alone.

In SI units the torque constant of a motor is its back-EMF constant. With the drive gain g of a joint, which is both at
the joint, current i, voltage u and speed qd

    u = R i + L di/dt + (g / c) qd + u_0,

c is 1 for a DC motor and the power-invariant q axis, 3/2 for the amplitude-invariant one. Rows are filtered and
decimated as the equations of motion are, and keep samples that rest: friction is not in them. What bridges and windings
add is estimated beside. g then is an equation beside the equations of motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gtau.errors import quoted
from gtau.estimation.effects.effect import hats
from gtau.estimation.effects.mixed_model import MixedModel, fit_mixed, lag_products
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.problem import Estimates, MotorEquation
from gtau.estimation.results.estimate import Estimate
from gtau.findings import Finding, Grade, enumerated, listed, percent
from gtau.robots.parameter import Parameter, unit_of
from gtau.signals.channel import SIDE_SIGNALS
from gtau.signals.preparation.filters import position_filter, valid_samples
from gtau.signals.preparation.prepared_run import PreparedRun
from gtau.signals.reading.column_names import has_word
from gtau.signals.reading.statements import Drive

CONVENTIONS = {"dc": 1.0, "power": 1.0, "amplitude": 1.5}
# Relative standard deviation of the torque constant over the back-EMF constant: assumed, not measured (1 to 2 %).
COMMUTATION = 0.015
FEWEST = 50  # rows of a joint
WIDTHS = 0.05, 0.3  # of the change of the sign of a current, in its standard deviation: ripple, and dead time
KNOTS = 4  # of drifts along a run
LARGEST = 3.0  # plausible sizes of an effect
FLOOR = 5e-4  # of ke and R, whose noise biases them by less
SHAPE = 0.1  # share of a bridge's lost voltage that counts as R i, as the shape of its change of sign is assumed
EXPLAINED = 0.97  # least share of the variance of the voltage, or another equation holds
NO_CURRENT = frozenset[str]().union(*(kind.words for kind in SIDE_SIGNALS if kind.key in ("voltage", "duty")))
LOST = 0.3  # relative standard deviation of ke, from which it is no reference
# plausible sizes: of dead time, offset and idle current over the rms voltage, R and ke over themselves, of lags in s
DEAD, OFFSET, IDLE, WARMER, WEAKER, SATURATED, LAG = 0.05, 0.02, 0.05, 0.1, 0.01, 0.05, 0.002
RESISTANCE = 0.1  # relative standard deviation of a stated resistance: windings are warmer than data sheets say


def with_voltages(dataset: Dataset, drives: Mapping[str, Drive]) -> Dataset:
    """Fit the voltage equation of each joint whose voltages are logged; notes say why some give no gain."""
    equations, causes = list[MotorEquation](), dict[tuple[str, str], dict[str, str]]()  # by text and advice
    signals, unstated = dataset.runs[0].log.signals, Drive(convention="dc")

    def note(joint: str, text: str, advice: str, share: str = "") -> None:
        causes.setdefault((text, advice), {})[joint] = f"{quoted(joint)}{share}"

    for joint in dataset.robot.motors:
        drive = drives.get(joint, unstated)
        parts = (_rows(prepared, joint, drive) for prepared in dataset.prepared)
        rows = [part for part in parts if part is not None]
        logged = {key for run in dataset.runs for key, values in run.side.items() if joint in values.by_joint}
        if signals is not None and has_word(signals.command.get(joint, ""), NO_CURRENT):
            text = "the current of … is a voltage or duty: its gain is the torque constant over the resistance"
            note(joint, f"{text}, and its viscous friction contains the back-EMF", "log the current, too")
        if signals is not None and "supply_current" in logged and not signals.supplied:
            note(joint, "the supply current of … is not used beside the current", "remove one of them from the signals")
        if not logged & {"voltage", "duty"}:
            if "goal" in logged:
                text = "the goal of … gives no gain, as the proportional gain is not stated"
                note(joint, text, "add 'proportional_gain' to the signals")
            continue
        if sum(part.shape[1] for part in rows) < FEWEST:
            text = "the duty of … gives no gain: neither its supply voltage nor its resistance is known"
            note(joint, text, "add 'supply_voltage' to the signals, or 'resistance' to its entry under 'drives'")
            continue
        equation = _equation(joint, rows, drive)
        if equation.explained < EXPLAINED:
            text = "current and speed alone do not explain the voltage of …, which gives no gain"
            advice = "check that voltage (or duty) and current are of the motor, their units and clock"
            note(joint, text, advice, f" ({percent(equation.explained, '.0f')} explained)")
        elif not np.sqrt(equation.covariance[0, 0]) < LOST * abs(equation.ke):
            note(joint, "the voltage of … does not show its back-EMF, and gives no gain", "move the joint faster")
        else:
            equations.append(equation)
    notes = list[Finding]()
    for (text, advice), named in causes.items():
        said = text.replace("…", enumerated([*named.values()]))
        notes.append(Finding("voltage", tuple(named), text=said, advice=advice, grade=Grade.INFORMATION))
    stated = {joint for joint, drive in drives.items() if "convention" in drive.model_fields_set}
    if assumed := [motor.joint for motor in equations if motor.joint not in stated]:
        text = f"the voltages of {listed(assumed)} are taken for voltages of DC motors, as no 'convention' is stated"
        advice = "state it under 'drives': 'amplitude' (q axes of most field-oriented drives) gives 1.5 times the gain"
        notes.append(Finding("voltage", tuple(assumed), text=text, advice=advice, grade=Grade.INFORMATION))
    return replace(dataset, motors=tuple(equations), remarks=tuple(notes))


def _rows(prepared: PreparedRun, joint: str, drive: Drive) -> np.ndarray | None:
    """Filter and decimate the rows of a joint, (10, K); None where it rests, or its voltage was not logged.

    They are y, x with its rate, speed, acceleration, columns of the offset and of two signs of the current, the place
    along the run, 0 to 1, and where a stretch without gaps begins. y are voltages and x currents, or R i and duties
    where R is stated and the supply voltage unknown; all are times the duty where a supply's current is logged.
    """
    run, kept, decimator = prepared.run, prepared.kept, prepared.preparation.decimator
    j, signals = run.joints.index(joint), run.log.signals
    logged = {key: values.si(joint, run.time) for key, values in run.side.items() if joint in values.by_joint}
    u, duty, i = logged.get("voltage"), logged.get("duty"), run.command[:, j]
    if u is None and duty is not None and "supply_voltage" in logged:
        u = duty * logged["supply_voltage"]
    if (u is None and (duty is None or drive.resistance is None)) or not prepared.moves[j]:
        return None
    supplied = "supply_current" in logged and (signals is None or signals.supplied)
    w = duty if supplied and duty is not None else np.ones_like(i)
    y, x = (u, i) if u is not None else ((drive.resistance or 0.0) * i, duty)
    sharp, gradual = (np.tanh(i / (width * float(np.std(i)) or 1.0)) for width in WIDTHS)
    raw = np.column_stack([y * w, x * w, run.position[:, j], w, sharp * w, gradual * w])
    smooth, rate, second = position_filter(raw, run.rate, prepared.preparation.cutoff, kept.start, kept.stop)
    y, x, _, w, *signs = smooth.T
    columns = np.stack([y, x, rate[:, 1], rate[:, 2] * w, second[:, 2] * w, w, *signs])
    keep = decimator.keep(valid_samples(run, prepared.preparation, kept.start, kept.stop)[:, j])
    used = np.flatnonzero(keep)
    along, begins = np.linspace(0.0, 1.0, len(keep))[used], np.diff(used, prepend=-2) != 1
    return np.vstack([decimator.apply(columns)[:, used], along, begins])


def _equation(joint: str, parts: Sequence[np.ndarray], drive: Drive) -> MotorEquation:
    """Fit ``[ke, R, offset]`` of a joint, with what bridge and winding add as effects of unknown size.

    Where R is stated, the supply voltage U is in its place: ``R i = U duty - (ke / c) qd - u_0``.
    """
    from scipy.linalg import block_diag

    y, x, x_d, qd, qdd, w, sharp, gradual, _, begins = np.hstack(parts)
    stated = drive.resistance
    c = CONVENTIONS[drive.convention] * (1.0 if stated is None else -1.0)
    A = np.column_stack([qd / c, x, w])
    values = np.linalg.lstsq(A, y, rcond=None)[0]
    if values @ np.std(A, axis=0) < 0:  # the voltage counts the other way; a lag alone turns R over, not both
        y, values = -y, -values
    ke, R, _ = values
    left = y - A @ values
    level, noise = float(np.std(y)), float(np.std(left)) or 1e-9
    size = float(np.sqrt(np.mean(x**2))) or 1.0
    knots, supplied, bent = np.linspace(0.0, 1.0, KNOTS)[:, None], np.ptp(w) > 0, x * np.abs(x) / size
    along_runs = block_diag(*(hats(part[8][:, None], knots)[:, 0].T for part in parts))
    bridge = DEAD * level * np.column_stack([sharp, gradual])
    effects = [
        bridge,
        WARMER * R * x[:, None] * along_runs,
        WEAKER * ke * qd[:, None] / c * along_runs,
        LAG * R * x_d[:, None],
        LAG * ke * qdd[:, None] / c,
        SATURATED * R * (bent - x * (bent @ x) / max(x @ x, 1e-300))[:, None],  # so that R is of the usual currents
        OFFSET * level * w[:, None] * along_runs,
        *([IDLE * level * np.ones((len(y), 1))] if supplied else []),
    ]
    groups = np.repeat(range(len(effects)), [columns.shape[1] for columns in effects])
    rows = np.column_stack([*effects, A, left]) / noise
    nothing, none = np.zeros((A.shape[1] + 1,) * 2), np.zeros(0, dtype=int)
    model = MixedModel(((lag_products(rows, begins > 0),),), nothing, groups, none, np.full(len(effects), LARGEST))
    mixed = fit_mixed(model)
    at = mixed.at
    ke, R = (values - at.common)[:2]
    lost = float(np.std(bridge @ at.own_effects[0][:2])) * mixed.sizes[0]
    covariance = at.covariance[:2, :2] + np.diag([(FLOOR * ke) ** 2, (FLOOR * R) ** 2 + (SHAPE * lost / size) ** 2])
    if stated is not None:  # ke is in proportion to it
        both = (drive.uncertainty or RESISTANCE) * np.array([ke, stated])
        R, covariance = stated, np.diag([covariance[0, 0], 0.0]) + np.outer(both, both)
    all_columns = np.column_stack([A, sharp, x[:, None] * along_runs])
    rest = y - all_columns @ np.linalg.lstsq(all_columns, y, rcond=None)[0]
    explained = 1 - float(np.var(rest) / max(np.var(y), 1e-300))
    commutation, known = drive.commutation or COMMUTATION, drive.commutation is not None
    return MotorEquation(joint, float(ke), float(R), covariance, commutation, known, explained)


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
