"""Identify a robot: the stages from an experiment to a result, the same for every command, by one estimator or all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.descriptions import TOOL_BODIES
from gtau.estimation.diagnostics.diagnose import Examination, channel_verdicts, diagnose, estimates_of, examine
from gtau.estimation.diagnostics.gains import REFUTED
from gtau.estimation.diagnostics.inertia_audit import InertiaAudit, audit_inertias
from gtau.estimation.diagnostics.log_checks import (
    command_lag,
    lack_of_fit,
    require_payload_excitation,
    smoothed_commands,
)
from gtau.estimation.diagnostics.scale import contradictory_voltages, sensor_contradictions, sensor_scales, weigh_known
from gtau.estimation.diagnostics.verdict import worst
from gtau.estimation.electrical import motor_estimates
from gtau.estimation.estimators import NAMES, estimator_of
from gtau.estimation.estimators.essential import essential_parameters, select_friction
from gtau.estimation.estimators.estimator import Estimator, Fit, Gains
from gtau.estimation.estimators.physical_consistency import Consistency, consistent
from gtau.estimation.experiment_runs import Options, Source, Subject, geometry_of, read
from gtau.estimation.friction.curves import friction_step
from gtau.estimation.preconditions import Attempt, hidden_payloads, plan, reduced, require_inputs
from gtau.estimation.regression.dataset import Dataset, System
from gtau.estimation.regression.problem import Estimates
from gtau.estimation.results.build import evidence, fit_record, model_estimates, sensor_estimates
from gtau.estimation.results.conclusions import SCALE_UNTESTED
from gtau.estimation.results.estimate import Named
from gtau.estimation.results.result import NO_BODIES, IdentifiedModel
from gtau.findings import Finding, Grade, Progress, listed, silent
from gtau.model.program import single_threaded_blas
from gtau.robots.parameter import Parameter, gain_unit
from gtau.signals.reading.statements import data_sheet_notes
from gtau.signals.run import Run

if TYPE_CHECKING:
    import polars as pl

PAPER_RATIO = 10.0  # the paper's r_sigma for the essential parameters
NO_GAIN = {Grade.CONTRADICTORY, Grade.NOT_IDENTIFIABLE}


def identify_subject(subject: Subject, progress: Progress = silent) -> IdentifiedModel:
    """Identify a robot from its runs; raises GtauError if the data cannot be used, or lack an input of the method."""
    estimator, experiment = require_inputs(subject), subject.experiment
    dataset = reduced(subject, estimator, progress)
    system = dataset.system()
    result = _identified(subject, estimator, dataset, system, progress)
    geometry = geometry_of(experiment, experiment.runs, dataset.model, progress) if experiment else None
    beside = [*([geometry.note] if geometry else []), *smoothed_commands(dataset.runs)]
    beside += command_lag(dataset, system)
    gains = {Parameter("gain", joint): gain for joint, gain in result.drive_gains.items() if gain.std is not None}
    estimates = {str(name): (one.value, one.std) for name, one in (gains | dict(result.parameters)).items()}
    beside += data_sheet_notes(experiment.drives if experiment else {}, result.robot, estimates)
    return result.replaced(geometry=geometry, notes=(*beside, *result.notes))


def _identified(
    subject: Subject, estimator: Estimator, dataset: Dataset, system: System, progress: Progress
) -> IdentifiedModel:
    """Make the planned attempts in turn, until one finds the gains or none is left."""
    *attempts, last = plan(subject, estimator, dataset, system)
    untested: tuple[Finding, ...] = ()
    assumed = not attempts and last[1] is not None and subject.options.method is None
    if assumed and (hidden := hidden_payloads(system)):
        why = f"no joint torque shows the mass of {listed(hidden, ' or ')} by itself on '{dataset.robot.tool}'"
        advice = "check 'tool' of the robot, which carries the payload, or state the payload's 'center'"
        untested = (_untested_scale(why, advice),)
    for attempt in attempts:
        try:
            result = _attempted(attempt, subject, dataset, system, progress)
        except GtauError as refusal:
            untested = (_untested_scale(str(refusal).rstrip(".")),)
            continue
        first, *_ = result.drive_gains.values()
        lost = first.verdict.finding
        if lost is None or _outcomes(result) != {Grade.NOT_IDENTIFIABLE}:
            return result
        untested = (_untested_scale(f"no joint has an identifiable scale ('{first.name}': {lost.what})"),)
    result = _attempted(last, subject, dataset, system, progress)
    return result.replaced(notes=(*untested, *result.notes))


def _attempted(
    attempt: Attempt, subject: Subject, dataset: Dataset, system: System, progress: Progress
) -> IdentifiedModel:
    """Estimate, and refuse a payload that the currents never felt where no gain can be believed."""
    estimator, gains = attempt
    try:
        result = estimate(dataset, estimator, gains, subject.options, progress)
    except GtauError:
        require_payload_excitation(system)
        raise
    kinds = {gain.verdict.kind for gain in result.drive_gains.values()}
    if _outcomes(result) <= NO_GAIN and REFUTED not in kinds:  # which has an advice of its own
        require_payload_excitation(system)
    return result


def _outcomes(result: IdentifiedModel) -> set[Grade]:
    return {gain.verdict.outcome for gain in result.drive_gains.values()}


def _untested_scale(why: str, advice: str = "add runs with a heavier payload of known mass, or longer ones") -> Finding:
    return Finding(
        SCALE_UNTESTED,
        text=f"the torques are assumed to be correct, because their scale could not be tested: {why}",
        advice=advice,
        grade=Grade.INFORMATION,
        shown_as="reading",
    )


def estimate(
    dataset: Dataset, estimator: Estimator, gains: np.ndarray | None, options: Options, progress: Progress = silent
) -> IdentifiedModel:
    """Estimate parameters, drive gains and their uncertainties from reduced runs, with verdicts.

    As in the paper friction is viscous and Coulomb friction, the same in all runs, without delays, covariances are by
    the method's formula, and the gains are estimated again together with the essential parameters. Otherwise friction
    terms are selected from the data, then identified on all samples at these gains and inertial parameters, and
    covariances are by the block jackknife, which allows for residuals correlated in time.

    ``dataset`` are the reduced runs (eqs. 19 and 20), ``gains`` (n,) those that the estimator is given; estimated if
    None. Raises GtauError where the data do not suit the estimator.
    """
    as_paper, ratio, accuracy = options.as_paper, options.ratio, options.accuracy
    if as_paper:
        system = dataset.system(delays=False)  # eqs. (29) to (33)
        ratio = PAPER_RATIO if ratio is None else ratio
    else:
        system = select_friction(dataset, estimator.solver(gains), progress)
    progress("estimation", 0, 1)
    fit = estimator.fit(system, gains, progress)  # eqs. (24) to (28), or (34) to (39)
    examined = examine(fit, progress)
    moved = examined.moved(fit) if estimator.name == "ml" and not as_paper else None
    scales = sensor_scales(fit) if fit.free_gains else ()
    if any(scale.verdict(accuracy).outcome == Grade.CONTRADICTORY for scale in scales):
        moved = None  # what a sensor contradicts, effects would explain in part
    estimates = estimates_of(fit, examined, not as_paper, moved is not None)
    lack = lack_of_fit(fit.system.problem, fit.solution)
    plain, fit = fit, moved or fit
    solve = fit.solve if as_paper else fit.solve_fixed
    essential, reduced, loss = essential_parameters(fit.problem, fit.dataset.base.names, solve, ratio, not as_paper)
    bare, audit = _audited(plain, fit, estimates, examined)
    references = (*sensor_contradictions(scales, plain, accuracy), *contradictory_voltages(plain, accuracy))
    payloads = {} if bare is None else weigh_known(bare, estimator.name, accuracy, references)
    bodies, lost = _consistent_bodies(fit, plain, np.sqrt(np.diag(estimates.covariance)), options)
    progress("estimation", 1, 1)
    if as_paper:  # the gains that go with the essential parameters
        fit = replace(fit, system=replace(fit.system, problem=essential), solution=reduced)
        nothing = np.zeros_like(reduced.covariance)
        estimates = Estimates(essential.unknowns, reduced.values, reduced.covariance, nothing, nothing, None)
        plain = fit
        examined = replace(examined, mixed=None)  # which is of all parameters
    findings = diagnose(plain, examined, estimates, payloads, options.gains, references, accuracy, audit) + lost
    verdicts = channel_verdicts(fit, estimates, findings, delayed=not as_paper)
    predicting, curves, errors = (estimates, {}, {}) if as_paper else friction_step(fit, estimates)
    figures = {"reduction_loss": loss, "lack_of_fit": lack, "accuracy": float(accuracy)}
    return IdentifiedModel(
        dataset.equations,
        **model_estimates(fit, estimates, predicting, verdicts, payloads, essential),
        **fit_record(fit, estimator.name, errors, figures),
        **evidence(fit, estimates, examined, findings, curves),
        sensors=sensor_estimates(plain, estimates, verdicts, scales, accuracy),
        consistency=bodies,
        audit=audit,
        motors=Named(motor_estimates(dataset, estimates)),
    )


def _audited(
    plain: Fit, fit: Fit, estimates: Estimates, examined: Examination
) -> tuple[Fit | None, InertiaAudit | None]:
    """Hold the robot file against the ``estimates`` of a fit; also return the ``plain`` one without its inertias."""
    if not fit.dataset.robot.inertias:
        return plain, None
    undeclared = TOOL_BODIES in {effect.effect for effect in examined.effects}
    bare, audit = audit_inertias(fit, estimates, undeclared or bool(fit.system.always_carried))
    return plain if bare is fit else bare, audit


def _consistent_bodies(
    fit: Fit, plain: Fit, std: np.ndarray, options: Options
) -> tuple[Consistency | None, tuple[Finding, ...]]:
    """Find consistent parameters if they are asked for, or a note why there are none."""
    if not options.consistent:
        return None, ()
    try:
        return consistent(fit, plain.solution, std, options.priors or {}), ()
    except GtauError as refusal:  # what the data contradict, no bodies may have
        reason, _, advice = str(refusal).rstrip(".").partition("; ")
        text = f"physically consistent parameters were not found: {reason}"
        return None, (Finding(NO_BODIES, text=text, advice=advice, shown_as="model"),)


# All estimators on the same logs


@dataclass(frozen=True, eq=False)
class MethodRow:
    """Estimates of one estimator.

    ``gains`` and ``std`` (n,), N m/A or N per A, the standard deviations None where the gains are given;
    ``half_widths`` (n,) are half their 95 % intervals. ``residuals`` (n,) are of the currents in per cent of
    them, ``seconds`` the time of the estimation alone. An estimator that refuses the data has only its ``refusal``.
    """

    method: str
    gains: np.ndarray | None = None
    std: np.ndarray | None = None
    residuals: np.ndarray | None = None
    seconds: float = 0.0
    outcome: Grade | None = None
    refusal: str = ""
    half_widths: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class EstimatorComparison:
    """A row for each estimator, with the gains of the ``joints`` in their ``units``, and ``notes`` on drafted logs."""

    joints: tuple[str, ...]
    rows: tuple[MethodRow, ...]
    units: tuple[str, ...] = ()
    robot: str = ""
    notes: tuple[Finding, ...] = ()

    def __repr__(self) -> str:
        return f"EstimatorComparison(joints {', '.join(self.joints)}; {', '.join(row.method for row in self.rows)})"

    def to_frame(self) -> pl.DataFrame:
        """Return the comparison as a Polars table, one row per estimator and joint."""
        import polars as pl

        numbers = dict.fromkeys(("gain", "std", "residual"), pl.Float64)
        schema = {"method": pl.String, "joint": pl.String, **numbers, "verdict": pl.String, "refusal": pl.String}
        rows = []
        for row, (j, joint) in product(self.rows, enumerate(self.joints)):
            values = (None if of is None else float(of[j]) for of in (row.gains, row.std, row.residuals))
            outcome = None if row.outcome is None else row.outcome.value
            rows.append((row.method, joint, *values, outcome, row.refusal or None))
        return pl.DataFrame(rows, schema=schema, orient="row")


def compare(
    source: Source, runs: Sequence[Run] | None = None, options: Options | None = None, progress: Progress = silent
) -> EstimatorComparison:
    """Identify with every estimator, and compare the results; see :func:`gtau.compare`. Raises GtauError."""
    subject = read(source, runs, replace(options or Options(), method="ml"), progress)

    def row(method: str) -> MethodRow:
        def said(stage: str, done: int, total: int) -> None:
            progress(f"{method} ({1 + NAMES.index(method)} of {len(NAMES)}): {stage}", done, total)

        start = perf_counter()
        by_method = replace(subject, options=replace(subject.options, method=method))
        try:
            estimator = require_inputs(by_method)
            ((_, given),) = plan(by_method, estimator, dataset, system)
            usable = dataset if estimator.takes_priors else replace(dataset, priors={})
            result = estimate(usable, estimator, given, by_method.options, said)
        except GtauError as refusal:
            return MethodRow(method, refusal=str(refusal))
        seconds = perf_counter() - start
        gains = result.drive_gains.values()
        residuals = np.array([error.relative for error in result.residuals])
        numbers = ((gain.value, gain.std, gain.half_interval()) for gain in gains)
        values, std, halves = np.array(list(numbers), dtype=float).T
        if estimator.gains == Gains.GIVEN:
            return MethodRow(method, values, None, residuals, seconds)
        return MethodRow(
            method, values, std, residuals, seconds, worst(gain.verdict for gain in gains), half_widths=halves
        )

    with single_threaded_blas():
        dataset = reduced(subject, estimator_of("ml"), progress)
        system = dataset.system()
        plan(subject, estimator_of("ml"), dataset, system)  # refuses runs that do not fix the scale
        rows = [row(name) for name in NAMES]
    robot, kind = subject.robot, dataset.runs[0].kind
    units = tuple(gain_unit(robot, joint, kind) for joint in robot.motors)
    guesses = subject.experiment.guesses if subject.experiment else ()
    return EstimatorComparison(robot.motors, tuple(rows), units, robot.name, guesses)


def comparison_document(comparison: EstimatorComparison) -> dict[str, Any]:
    """Describe the comparison as a JSON document."""
    numbers = ("gains", "std", "residuals")
    rows = [
        {
            "method": row.method,
            **{key: None if (held := getattr(row, key)) is None else held.tolist() for key in numbers},
            "seconds": row.seconds,
            "outcome": None if row.outcome is None else row.outcome.value,
            "refusal": row.refusal,
        }
        for row in comparison.rows
    ]
    return {"joints": list(comparison.joints), "estimators": rows}
