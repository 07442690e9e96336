"""What the scale rests on: payloads, torque sensors, wrenches, priors and voltages, and whether the data agree.

Currents alone leave the scale open: gains and parameters may all be twice as large. It comes from constants stated in N
m or kg. With all of them larger by one per cent, every gain and parameter is larger by one per cent too; so the shares
by which a gain grows with each source alone add up to one. Each constant is tested by the others: it is estimated
instead, and the data are fitted again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import ndtr, ndtri

from gtau.errors import GtauError
from gtau.estimation.diagnostics.descriptions import explained_joints, refitted, residual_ratio
from gtau.estimation.diagnostics.verdict import APART, GOOD, WIDTH, contradiction, motors
from gtau.estimation.effects.estimate import CLOSE, estimate_effects
from gtau.estimation.effects.rows import weights_of
from gtau.estimation.estimators.estimator import Fit, Solve
from gtau.estimation.estimators.newton import solve
from gtau.estimation.regression.assembly import known_values
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.factors import KNOWN, SIGNALS
from gtau.estimation.regression.priors import require_scale
from gtau.estimation.regression.problem import Estimates, MotorEquation, Problem
from gtau.findings import Finding, Grade
from gtau.model.base_parameters import whole_mass
from gtau.robots.parameter import Parameter, gain_unit, unit_of
from gtau.signals.channel import Channel
from gtau.signals.reading.statements import FIRST_MOMENTS, Payload

PAYLOAD_MOVES = 0.01  # relative move of the gains when a known payload parameter is estimated instead
IN_METRES = 4.0  # times that a moment must be nearer to mass times the stated value, which is then in m
LEAST_OTHERS = 0.001  # share of all else in an estimate that has a prior, below which it is the prior
DETERMINED = 0.1  # relative standard deviation of a gain by all but its voltage, from which it tests no voltage
STEP = 1e-3  # of a source, for the derivatives of the gains

SCALED_BY_FILE = "the inertias of the robot's file"
SENSOR = "contradictory torque sensor"
SENSOR_ADVICE = "check the sensor's calibration, unit and joint; a payload's mass or a known parameter may be wrong too"
PAYLOAD, PRIOR, VOLTAGE = "contradictory payload", "contradictory prior", "contradictory voltage"
PAYLOAD_MASS, PAYLOAD_PARAMETER = "payload mass", "payload parameter"

Enlarged = Callable[[float], Problem]
"""Makes a problem in which a source of the scale is larger by a share of itself."""


def sources(system: System) -> Iterator[tuple[str, Enlarged, float, Enlarged]]:
    """List what gives the scale, with its relative standard deviation, 0 if it is exact, and what that is of."""
    problem, dataset = system.problem, system.dataset

    def heavier(name: str, masses: bool, by: float) -> Problem:
        loads = dict.fromkeys(range(len(dataset.runs)))
        for columns in system.payloads:
            load = columns.payload
            if load.name == name:
                parameters = {kind: value if masses else (1 + by) * value for kind, value in load.parameters.items()}
                mass = None if load.mass is None else (1 + by) * load.mass
                load = load.model_copy(update={"mass": mass, "parameters": parameters})
            loads[columns.run] = load
        return system.again(payloads=list(loads.values())).problem

    def louder(channels: Sequence[int], torques: np.ndarray | float, by: float) -> Problem:
        blocks = problem.blocks.copy()
        blocks[:, channels, :, SIGNALS] *= 1 + by
        blocks[..., KNOWN] += by * torques
        return replace(problem, make_blocks=lambda: blocks)

    def known(by: float) -> Problem:
        return replace(problem, known=problem.known * [*np.ones(problem.n_theta), 1 + by])

    def faster(by: float) -> Problem:
        return replace(problem, voltages=problem.voltages / [1.0, 1 + by, 1.0])

    loads = {load.payload.name: load.payload for load in reversed(system.payloads) if load.acts}
    for name, payload in reversed(loads.items()):
        std = payload.mass_std / payload.mass if payload.mass else 0.0
        yield f"payload '{name}'", partial(heavier, name, False), std, partial(heavier, name, True)
    for k in problem.sensor_channels:
        channel, sensor = problem.channels[k], partial(louder, [k], 0.0)
        yield f"{channel.kind.name} of '{channel.joint}'", sensor, channel.std, sensor
    if problem.base or system.wrench_columns is not None:
        torques = 0.0 if system.wrench_columns is None else system.wrench_columns
        measured = [channel.std for channel in dataset.runs[0].channels if not channel.kind.measures_joint]
        wrenches = partial(louder, problem.base, torques)
        yield _wrenches(problem), wrenches, max(measured, default=0.0), wrenches
    if len(problem.known):
        yield SCALED_BY_FILE if dataset.scaled_by_file else "known parameters", known, 0.0, known
    if len(problem.voltages):
        yield _voltages(dataset.motors), faster, 0.0, faster


def _voltages(motors: Sequence[MotorEquation]) -> str:
    """Name voltages as a source of the scale."""
    count = "the voltage of a motor" if len(motors) == 1 else f"the voltages of {len(motors)} motors"
    stds = [motor.commutation for motor in motors]
    spread = " to ".join(dict.fromkeys(f"{100 * end(stds):.2g}" for end in (min, max)))
    stated = "stated" if all(motor.stated for motor in motors) else "assumed"
    return f"{count} (efficiency of commutation {spread} %, {stated})"


def _wrenches(problem: Problem) -> str:
    """Name the measured wrenches; with a base that floats they are those on the base too."""
    base = [problem.channels[k].joint for k in problem.base]
    if base and problem.wrenches:
        return "measured wrenches"
    bodies = problem.wrenches or base[-1:]
    return f"wrench{'es' * (len(bodies) > 1)} on {', '.join(repr(body) for body in bodies)}"


def scale_shares(fit: Fit) -> dict[str, np.ndarray]:
    """Find the share of each source in the scale of the joints' estimated gains, source to (n,); they add up to one."""
    shares, n = dict[str, np.ndarray](), len(fit.gains)
    for source, enlarged, *_ in sources(fit.system):
        above, below = (fit.solve(enlarged(by)).gains[:n] for by in (STEP, -STEP))
        shares[source] = (above - below) / (2 * STEP * fit.gains)
    total = np.sum(list(shares.values()), axis=0)  # one, up to rounding
    total = np.where(total == 0.0, 1.0, total)  # of a base, whose gain is known
    return {source: share / total for source, share in shares.items()}


def scale_uncertainty(system: System, again: Solve) -> np.ndarray:
    """Compute the covariance (k, k) that uncertain constants add to estimates, which ``again`` finds with others.

    The uncertainty of known parameters is in the solution's own covariance.
    """
    extra = np.zeros((len(system.problem.unknowns),) * 2)
    for *_, std, enlarged in sources(system):
        if std:
            above, below = (again(enlarged(by)).values for by in (std, -std))
            extra += np.outer(above - below, above - below) / 4
    return extra


@dataclass(frozen=True, eq=False)
class SensorScale:
    """Ratio of a joint's torque from the other stated constants to its sensor's torque, with its standard deviation.

    Each gain moves by ``gain_shift`` (n,), a share of itself, where the scale of the sensor is estimated.
    """

    channel: Channel
    value: float
    std: float
    gain_shift: np.ndarray

    def verdict(self, accuracy: float) -> Finding:
        """Judge the scale: contradictory where it differs from 1 significantly and by more than the ``accuracy``."""
        if abs(self.value - 1) <= max(APART * self.std, accuracy):
            return GOOD
        text = f"all other data give torques {self.value:.4g} times its reading (standard deviation {self.std:.2g})"
        return contradiction("sensor scale", (), text, SENSOR_ADVICE, shown_as="model")


def sensor_scales(fit: Fit) -> tuple[SensorScale, ...]:
    """Estimate the scale of each sensor from the other stated constants, where there are any."""
    problem, scales, payloads = fit.problem, [], [run.payload for run in fit.dataset.runs]
    for k in problem.sensor_channels:
        channel, channels = problem.channels[k], list(problem.channels)
        channels[k] = replace(channel, kind=replace(channel.kind, calibration=""))
        freed = replace(problem, channels=tuple(channels), factored=problem.triangles, independent=problem.own_columns)
        try:
            require_scale(fit.dataset.robot, freed, fit.system.stated, payloads, "ml")
        except GtauError:
            continue  # without this sensor nothing gives the scale
        other = solve(freed, fit.solution.values, lambda squares: weights_of(fit), True)  # each counts as in the fit
        place = problem.unknowns.gains.start + k
        std = float(np.hypot(np.sqrt(other.jackknife[place, place]), channel.std))
        shift = other.gains[: len(fit.gains)] / fit.gains - 1
        scales.append(SensorScale(channel, float(other.gains[k]), std, shift))
    return tuple(scales)


def sensor_contradictions(scales: Sequence[SensorScale], fit: Fit, accuracy: float) -> Iterator[Finding]:
    """Find the gains of a fit that rest on a sensor contradicting the other stated constants."""
    for scale in sorted(scales, key=lambda scale: -float(np.abs(scale.gain_shift).max())):
        moves = np.abs(scale.gain_shift)
        moved = tuple(joint for joint, move in zip(fit.problem.joints, moves, strict=True) if move > accuracy)
        if scale.verdict(accuracy).outcome == Grade.CONTRADICTORY and moved:
            sensor, joint = scale.channel.kind.name, scale.channel.joint
            text = f"the scale comes from the {sensor} of '{joint}', which contradicts all other data"
            yield contradiction(SENSOR, moved, text, SENSOR_ADVICE, joint)


def contradictory_payload(name: str, joints: tuple[str, ...], given: bool = False) -> Finding:
    """Find, against the gains of some joints, a payload that contradicts the data."""
    text = f"the scale comes from payload '{name}', which contradicts the data"
    if given:
        text = f"payload '{name}', which contradicts the data, leaves this joint unexplained"
    return contradiction(PAYLOAD, joints, text, "correct the payload", name)


def contradictory_priors(fit: Fit, estimates: Estimates, accuracy: float) -> Iterator[Finding]:
    """Find base parameters that differ without their prior by more than the ``accuracy`` (relative) from it.

    An estimate is a mean of all else and the prior, whose weight is its share in the information: 1 if it sets the
    scale alone.
    """
    dataset, parameters, base = fit.dataset, fit.problem.parameters, fit.dataset.base.names
    mass = whole_mass(dataset.base, dataset.model.parameter_names) if dataset.robot.floating else ""
    priors = {name: prior for name, prior in dataset.stated_priors.items() if name in base and name in parameters}
    limit = -ndtri(ndtr(-APART) / max(len(priors), 1))  # of many priors some are further off
    for name, prior in priors.items():
        if prior.value is None or prior.std is None:
            continue
        k = parameters.index(name)
        others = 1 - float(fit.solution.covariance[k, k]) / prior.std**2
        if others < LEAST_OTHERS:
            continue
        value = prior.value + (float(fit.solution.theta[k]) - prior.value) / others
        variance = estimates.covariance[k, k] - ((1 - others) * prior.std) ** 2
        std = float(np.sqrt(max(variance, 0.0))) / others
        apart = float(np.hypot(std, prior.std))
        if abs(value - prior.value) <= max(limit * apart, accuracy * abs(prior.value)):
            continue
        text = f"{name} is {value:.4g} from the data (standard deviation {std:.2g}), but {prior.value:.4g} from its "
        text += f"prior ({prior.std:.2g})"
        advice = "check its value, and the units and signs of the other scale references: payloads, sensors, wrenches"
        if name == mass:
            yield contradiction("contradictory mass", motors(fit), f"the mass of the robot, {text}", advice, mass)
        size = abs(value - prior.value) / (WIDTH * apart)
        text = f"the known parameter {text}"
        yield Finding(PRIOR, subject=name, size=size, text=text, advice=advice, shown_as="model")


def contradictory_voltages(fit: Fit, accuracy: float) -> Iterator[Finding]:
    """Find the voltage that contradicts all else, where that explains more than a wrong scale of all else does."""
    motors = fit.dataset.motors
    if not motors or not fit.free_gains:
        return
    alone = _without_voltages(fit, motors)
    others = list[Fit | None]()
    for motor in motors:
        other = alone or _without_voltages(fit, (motor,))
        gain, std = _by_others(other, motor) if other else (1.0, np.inf)
        # a last joint's gain shows in its own current alone: without its voltage it may be anything
        others.append(other if std < DETERMINED * abs(gain) else None)
    apart = _voltages_apart(motors, others, accuracy)
    if apart is not None:  # or effects are, which take seconds
        alone = alone and _beside_effects(alone)
        apart = _voltages_apart(motors, [alone or (other and _beside_effects(other)) for other in others], accuracy)
    if apart is None:
        return
    r, s = apart
    worst = int(np.argmax(np.abs(r / s)))
    motor, weights = motors[worst], 1 / s**2
    common = float(weights @ r / weights.sum())
    if alone and weights @ (r - common) ** 2 <= np.delete(weights * r**2, worst).sum():
        return  # but for one factor, the voltages agree with all else
    moves = np.abs((_without_voltages(fit, (motor,)) or fit).gains / fit.gains - 1)
    moved = tuple(joint for joint, move in zip(fit.problem.joints, moves, strict=True) if move > accuracy)
    gain, unit = motor.ke / (1 + r[worst]), gain_unit(fit.dataset.robot, motor.joint, "current")
    text = f"the voltage of '{motor.joint}' says {motor.ke:.3g} {unit}, and all other data {gain:.3g} {unit}"
    advice = f"check the unit of the voltage, and 'convention' of drives.{motor.joint} (dc, amplitude or power)"
    grade = Grade.CONTRADICTORY if moved else Grade.WARNING
    yield Finding(VOLTAGE, moved, motor.joint, text=text, advice=advice, grade=grade, size=abs(r[worst] / s[worst]))


def _voltages_apart(
    motors: Sequence[MotorEquation], others: Sequence[Fit | None], accuracy: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute the gains by voltages over those of other fits, less 1, and their stds; None where no gain is off."""
    r, s = np.zeros(len(motors)), np.full(len(motors), np.inf)
    for k, (motor, other) in enumerate(zip(motors, others, strict=True)):
        if other is not None:
            gain, std = _by_others(other, motor)
            r[k], s[k] = motor.ke / gain - 1, np.hypot(std / gain, motor.std / motor.ke)
    return (r, s) if np.any((np.abs(r) > APART * s) & (np.abs(r) > accuracy)) else None


def _by_others(fit: Fit, motor: MotorEquation) -> tuple[float, float]:
    """Return the gain of a motor's joint and its standard deviation."""
    place = fit.problem.unknowns.places[Parameter("gain", motor.joint)]
    return float(fit.solution.values[place]), float(np.sqrt(fit.solution.jackknife[place, place]))


def _beside_effects(fit: Fit) -> Fit:
    """Move the estimates by all effects: iron that saturates adds to a payload."""
    mixed = estimate_effects(fit)
    return fit if mixed is None else mixed.applied(fit)


def _without_voltages(fit: Fit, motors: Sequence[MotorEquation]) -> Fit | None:
    """Fit without the voltages of some motors; None where then nothing gives the scale."""
    kept = tuple(motor for motor in fit.dataset.motors if motor not in motors)
    return refitted(fit, dataset=replace(fit.dataset, motors=kept))


def weigh_known(fit: Fit, method: str, accuracy: float, references: Sequence[Finding]) -> dict[str, Finding]:
    """Judge payloads, by name: each known value is estimated in turn, with given gains or from the other constants.

    A verdict names the value that leaves least when it alone is freed, and others that leave as little. The mass of a
    single payload that sets the scale is not tested. Given gains are taken for exact to the ``accuracy`` (relative). A
    voltage that contradicts all else, as ``references`` say, tests no payload.
    """
    wrong = [finding.subject for finding in references if finding.kind == VOLTAGE]
    if wrong:
        fit = _without_voltages(fit, [motor for motor in fit.dataset.motors if motor.joint in wrong]) or fit
    payloads = [run.payload for run in fit.dataset.runs if run.payload]
    known = {payload.name: payload for payload in payloads if payload.mass is not None}
    masses = ("m",) if not fit.free_gains or len(known) > 1 or fit.problem.scaled else ()
    verdicts = {}
    for name, payload in known.items():
        tried = (_freed(fit, method, payload, kind, accuracy) for kind in (*masses, *payload.parameters))
        if freed := sorted(filter(None, tried), key=lambda result: result[0]):
            least, verdicts[name] = freed[0]
            alike = [verdict for remains, verdict in freed if remains < least + CLOSE and verdict.outcome != Grade.GOOD]
            # joints whose axes intersect feel the ratio of moments alone
            if len(alike) > 1 and verdicts[name] is alike[0]:
                text = "; or as likely, ".join(verdict.text for verdict in alike)
                verdicts[name] = replace(alike[0], text=text, advice="check these values, and the payload's frame")
    return verdicts


def _freed(fit: Fit, method: str, payload: Payload, kind: str, accuracy: float) -> tuple[float, Finding] | None:
    """Estimate a payload's parameter without stating it: what that leaves, and a verdict; None if not identifiable."""
    values = {other: value for other, value in payload.parameters.items() if other != kind}
    mass = None if kind == "m" else payload.mass
    changed = payload.model_copy(update={"mass": mass, "parameters": values})
    loads = [run.payload for run in fit.dataset.runs]
    other = refitted(fit, [changed if load and load.name == payload.name else load for load in loads], method=method)
    if other is None or not set(other.system.unexcited) <= set(fit.system.unexcited):
        return None  # without this value nothing gives the scale, or it cannot be separated from what is not declared
    if fit.dataset.motors:
        other = _beside_effects(other)
    problem, theta = other.problem, other.solution.theta
    stds = np.sqrt(np.diag(other.solution.jackknife))
    columns = [
        problem.unknowns.places[label]
        for load in other.system.payloads
        if load.payload.name == payload.name
        for label, sums in zip(load.unknown, load.sums, strict=True)
        if label.kind == kind and np.count_nonzero(sums) == 1 and label in problem.unknowns.places
    ]
    if not columns:
        return None
    best = min(columns, key=lambda k: float(stds[k]))
    value, declared = float(theta[best]), known_values(payload)[kind]
    stated = scale_uncertainty(other.system, other.solve)[best, best]  # of the other payloads' masses, and of its own
    own_std = payload.mass_std if mass is None else 0.0
    std = float(np.sqrt(stds[best] ** 2 + stated + own_std**2))
    likelihood = float(problem.total_rows @ np.log(other.solution.sigma))
    small = abs(value - declared) <= accuracy * abs(declared)
    if fit.free_gains:
        small = kind != "m" and float(np.abs(other.solution.gains / fit.solution.gains - 1).max()) < PAYLOAD_MOVES
    if small or abs(value - declared) <= APART * std:
        return likelihood, GOOD
    return likelihood, _contradicted(fit, other, payload, kind, value, std)


def _contradicted(fit: Fit, other: Fit, payload: Payload, kind: str, value: float, std: float) -> Finding:
    """Find that all other data give a parameter of a payload another value, with its standard deviation."""
    declared, mass = known_values(payload)[kind], payload.mass or 0.0
    if kind == "m":
        wrong = PAYLOAD_MASS
        text = f"all other data give it a mass of {value:.4g} kg (standard deviation {std:.2g}), not {declared:.4g} kg"
        if fit.dataset.motors and fit.free_gains:
            text += _against_voltages(fit, other, declared / value)
        advice = "reweigh the payloads: a mass is wrong, or a run carries a payload other than declared"
        advice += ", or 'convention' of drives is wrong" * bool(fit.dataset.motors)
        if not fit.free_gains:
            torques = fit.kind == "torque"
            doubted = "the unit and scale of the torques" if torques else "the given gains"
            again = "use --method ml" if torques else "identify the gains"
            advice = (
                f"check which runs carry the payload, its mass (kg) and {doubted}; if the mass is certain, {again}: it "
                "then sets their scale"
            )
    else:
        wrong, unit = PAYLOAD_PARAMETER, unit_of(kind, fit.dataset.robot, fit.dataset.robot.tool)
        text = (
            f"given its mass and all other data, its {kind} is {value:.4g} {unit} (standard deviation {std:.2g}), not "
            f"{declared:.4g} {unit}"
        )
        advice = f"check {kind}, its frame (the body that carries the payload) and the mass; or omit {kind}"
        if kind in FIRST_MOMENTS and abs(value - mass * declared) < abs(value - declared) / IN_METRES:
            in_metres = f"write '{kind}: {mass * declared:.4g}' (mass times distance, kg m)"
            advice = f"if {declared:.4g} is in m, {in_metres}; otherwise {advice}"
    joints, values = explained_joints(fit, other), {"remains": residual_ratio(other, fit)}
    size = abs(value - declared) / std
    return contradiction(wrong, joints, text, advice, payload.name, values=values, size=size, shown_as="model")


def _against_voltages(fit: Fit, freed: Fit, ratio: float) -> str:
    """Continue a sentence with a gain by voltages, and ``ratio`` times it, by the payload."""
    joint = min(fit.dataset.motors, key=lambda motor: motor.std / abs(motor.ke)).joint
    gain = float(freed.gains[fit.problem.joints.index(joint)])
    unit = gain_unit(fit.dataset.robot, joint, "current")
    return f": the voltages say {gain:.3g} {unit} at '{joint}', the payload {gain * ratio:.3g} {unit}"
