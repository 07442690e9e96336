"""Show an identification: one screen, in full, or as a report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gtau.estimation.diagnostics.scale import SCALED_BY_FILE
from gtau.estimation.diagnostics.verdict import WIDE_SCALE
from gtau.estimation.estimators import estimator_of
from gtau.estimation.estimators.physical_consistency import Consistency
from gtau.estimation.results.conclusions import VISIBLE, findings, headline, missed, reasons, remarks, required
from gtau.estimation.results.estimate import TorqueError
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding, Grade, Progress, by_severity, percent_text, percents, silent
from gtau.report.gains import GOOD_GRADES, all_sources, gains_section, masses_table, payloads_section, unknown_payloads
from gtau.report.html import write_report
from gtau.report.logs import findings_section, inputs_of, logs_section, preparation_words, same_in_several, settings_of
from gtau.report.page import Column, Facts, Kind, Page, Section, Text, joint_label, table_of
from gtau.report.parameters import (
    PAPER,
    corrections,
    correlation_section,
    effects_section,
    friction_section,
    inertias_section,
    parameters_section,
)
from gtau.report.robot import geometry_section, motion_section, singularities_section
from gtau.report.terminal import plain
from gtau.report.torques import RunEvidence, determination, fit_table, gather, residuals_section, torques_section
from gtau.robots.parameter import Parameter
from gtau.signals.reading.drafting import DRAFT
from gtau.signals.reading.experiment import Experiment
from gtau.signals.run import Run

MOST = 3  # findings, and guesses, on the short page
MOVED = 0.5  # standard deviations; smaller moves are not listed
LISTED = 12


def text(result: IdentifiedModel, verbose: bool) -> str:
    """Write a result as text, in full or on one screen."""
    return plain(full_page(result) if verbose else summary_page(result))


def summary_page(result: IdentifiedModel) -> Page:
    """Show verdict, drive gains, masses, the findings that call for something, and the next step on one screen."""
    guesses = [note for note in result.notes if note.topic == DRAFT]
    files = dict.fromkeys(note.source for note in guesses)
    urgent = same_in_several([note for note in findings(result) if note.topic != DRAFT and note.advice])
    doubts = [
        *map(_in_short, reasons(result)),
        *(str(note) for group in by_severity(urgent).values() for note in group),
    ]
    doubts += corrections(result.audit)
    assumed = [note.what for note in guesses[:MOST]]
    if len(guesses) > MOST:
        assumed.append(f"{len(guesses) - MOST} more, marked CHECK there")
    more = f"{len(doubts) - MOST} more findings, all" if len(doubts) > MOST + 1 else "All"
    cost = "" if result.consistency is None else _growth(*result.consistency.loss.values())
    cost += "; no rigid bodies have such parameters: check payloads and priors" if cost.endswith("times") else ""
    return Page(
        "",
        Section("", Text(headline(result))),
        requirements_section(result),
        gains_section(result, charts=False, reasons=False),
        Section("", masses_table(result.payloads)),
        Section("", Text(f"Physically consistent parameters: torque residuals {cost}.")) if cost else None,
        Section("What to do", Text("", tuple(doubts[:MOST]))) if doubts else None,
        Section(f"Assumed; correct it in {', '.join(files)}", Text("", tuple(assumed))) if guesses else None,
        Section("", Text(f"{more} parameters, fits and notes: --verbose, or report.html.", (*next_steps(result)[:1],))),
    )


def _in_short(reason: Finding) -> str:
    """Write why gains are not good on one line: joints, cause and remedy; the table holds the intervals."""
    first, *others = [part.partition(", because ")[2] or part for part in reason.what.split("; ")]
    alike = ", and similarly for others" if set(others) - {first} else ""
    return f"{', '.join(map(joint_label, reason.joints))}: {first}{alike}; {reason.advice}"


def full_page(result: IdentifiedModel) -> Page:
    """Show all results of an identification, without charts."""
    ratio = result.statistics.get("singular_ratio")
    words = f"ratio of the two smallest singular values of W_tot ({PAPER}, eq. 33): {ratio or 0.0:.2f}"
    nearest = singularities_section(result.singularities)
    return Page(
        f"Identification of {result.robot.name}",
        Section("", Text(headline(result)), _settings(result)),
        requirements_section(result),
        gains_section(result, charts=False),
        _sensors_section(result),
        payloads_section(unknown_payloads(result)),
        parameters_section(result),
        friction_section(result),
        inertias_section(result.audit),
        Section("Torque fit", fit_table(result.residuals, "joint"), Text(words) if ratio else None),
        Section("Singularities", *nearest.items) if nearest else None,
        geometry_section(result.geometry),
        _consistency_section(result.consistency),
        findings_section(findings(result)),
    )


def report_page(result: IdentifiedModel, runs: Sequence[RunEvidence], prior: Mapping[str, float]) -> Page:
    """Show all results of an identification with predictions of its runs and of the validation runs.

    Verdict, gains, findings and torques come first; the details are folded.
    """
    details = (
        residuals_section(result, runs),
        parameters_section(result),
        friction_section(result, runs),
        inertias_section(result.audit),
        correlation_section(result),
        motion_section(result, runs),
        geometry_section(result.geometry),
        _consistency_section(result.consistency),
        logs_section([run.run for run in runs]),
        effects_section(result),
    )
    for part in filter(None, details):
        part.folded = True
    return Page(
        f"Identification of {result.robot.name}",
        verdict_section(result, runs),
        requirements_section(result),
        gains_section(result, prior),
        _sensors_section(result),
        findings_section(findings(result)),
        torques_section(result, runs),
        payloads_section(unknown_payloads(result)),
        *details,
        lead=[f"Estimator: {estimator_of(result.method).description}. Runs: {', '.join(result.runs)}."],
    )


def verdict_section(result: IdentifiedModel, runs: Sequence[RunEvidence] = ()) -> Section:
    """Show the verdict, what to do about it, and the key figures."""
    outcomes = Counter(gain.verdict.outcome for gain in result.drive_gains.values())
    style = "good" if set(outcomes) <= set(GOOD_GRADES) else "weak"
    if outcomes[Grade.NOT_IDENTIFIABLE] or not result.believable or missed(result):
        style = "bad"
    decisive = [str(note) for note in remarks(result) if note.decisive]
    decisive += [str(note) for run in runs for note in run.notes if note.decisive]
    head = (headline(result),) if style == "bad" else ()
    said = (*head, *decisive, *actions(result), *next_steps(result, runs))
    words = headline(result) if style == "good" else counts(result)
    return Section("Verdict", Text(words, said, style), _tiles(result, runs), id="verdict")  # type: ignore[arg-type]


def actions(result: IdentifiedModel) -> list[str]:
    """List remedies for gains that are not good, the worst first."""
    accuracy = 100 * result.statistics.get("accuracy", 0.0)
    named = {
        joint: f"{joint} (+-{percent_text(gain.half_width, accuracy)} %)" if gain.half_width else joint
        for joint, gain in result.drive_gains.items()
    }
    return [f"{', '.join(named[joint] for joint in r.joints)}, {r.outcome.value}: {r.advice}" for r in reasons(result)]


def next_steps(result: IdentifiedModel, runs: Sequence[RunEvidence] = ()) -> list[str]:
    """List the next steps after a believable result."""
    if not result.believable:
        return []
    wide = [joint for joint, gain in result.drive_gains.items() if gain.verdict.kind == WIDE_SCALE]
    if any(SCALED_BY_FILE in result.scale[joint] for joint in wide):
        first = "Next: log a run with a payload of known mass, which gives the scale better than any file"
    elif not all(gain.verdict.outcome in GOOD_GRADES for gain in result.drive_gains.values()):
        first = "Next: plan a motion that narrows these intervals (gtau excite DESIGN.yaml), and log it"
    elif all(run.used for run in runs):
        first = "Next: predict a log that was not used (gtau validate MODEL.json LOG)"
    else:
        first = "Next: weigh a known load, which tests the scale as no residual does (gtau payload MODEL.json LOG)"
    return [first, "Then export the model (gtau export), or watch the robot with it (gtau watch)"]


def _tiles(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> Facts:
    widths = {joint: gain.half_width for joint, gain in result.drive_gains.items() if gain.half_width}
    widest = max(widths, key=lambda joint: widths[joint], default="")
    errors = [error for run in runs if not run.used for error in run.errors]
    shares = determination([run for run in runs if run.used])
    least = min(shares, key=lambda joint: shares[joint], default="")
    what = "torque scale" if result.kind == "torque" else "gain"
    return Facts(
        {
            f"widest 95 % interval of a {what}": f"+-{percent_text(widths[widest])} % ({widest})" if widest else None,
            "largest torque residual of the rows used": _largest(result.residuals),
            "largest torque error of a validation run, in band": _largest(errors, in_band=True),
            "smallest R² of a joint": f"{shares[least]:.4f} ({least})" if least else None,
            "scale from": all_sources(result) or None,
            "base parameters": f"{len(result.essential)} of {len(result.parameters)} essential",
        }
    )


def _largest(errors: Sequence[TorqueError], in_band: bool = False) -> str | None:
    """Return the largest error and its joint, over the rows used or ``in_band`` with reversals."""
    sizes = [((error.relative_all if in_band else error.relative) or 0.0, error.joint) for error in errors]
    size, worst = max(sizes, default=(0.0, ""))
    return f"{percents([size])} ({worst})" if worst else None


def counts(result: IdentifiedModel) -> str:
    """Count the verdicts on the drive gains in one sentence."""
    outcomes = Counter(gain.verdict.outcome for gain in result.drive_gains.values())
    (first, count), *others = outcomes.most_common()
    more = "".join(f", {count} {'is' if count == 1 else 'are'} {outcome.value}" for outcome, count in others)
    missing = len(missed(result))
    required = f" {missing} of {len(result.requirements)} requirements missed." if missing else ""
    total = len(result.drive_gains)
    what = "torque scales" if result.kind == "torque" else "drive gains"
    return f"{count} of {total} {what} {'is' if count == 1 else 'are'} {first.value}{more}.{required}"


def _settings(result: IdentifiedModel) -> Facts:
    bandwidth, cutoff, decimation = preparation_words(result.preparation)
    given = f"; by hand: {', '.join(result.preparation.given)}" if result.preparation.given else ""
    return Facts(
        {
            "Method": estimator_of(result.method).description,
            "Runs": ", ".join(result.runs),
            "Payload": f"on '{result.robot.tool}'" if result.payloads else None,
            "Signals": f"bandwidth {bandwidth}, position filter {cutoff}, decimation {decimation}{given}",
        }
    )


def _sensors_section(result: IdentifiedModel) -> Section | None:
    """Show the fit of torque sensors, and their scale according to all other data."""
    if not result.sensors:
        return None
    ratios = [sensor for sensor in result.sensors if sensor.ratio is not None]
    listed = table_of(
        ratios,
        (Column("joint"), "joint"),
        (Column("ratio", Kind.NUMBER, 5), "ratio.value"),
        (Column("std", Kind.NUMBER, 2), "ratio.std"),
        (Column("verdict", Kind.BADGE), "ratio.verdict.outcome.value"),
    )
    words = "ratio: torque according to all other data, over the reading of the sensor"
    return Section(
        " and ".join(dict.fromkeys(sensor.kind.group for sensor in result.sensors)).capitalize(),
        *((listed, Text(words, style="soft")) if ratios else ()),
        fit_table([sensor.residual for sensor in result.sensors], "sensor of"),
        id="sensors",
    )


def requirements_section(result: IdentifiedModel) -> Section | None:
    """Tabulate each requirement with its value and outcome; None without requirements."""
    if not result.requirements:
        return None
    listed = table_of(
        result.requirements,
        (Column("required"), lambda requirement: required(requirement)[0]),
        (Column("of"), lambda requirement: required(requirement)[1]),
        (Column("outcome", Kind.BADGE), lambda requirement: "passed" if requirement.met else "failed"),
        (Column("limit, %", Kind.NUMBER), "limit"),
        (Column("found, %", Kind.NUMBER, decimals=2), "found"),
        (Column("worst joint"), lambda requirement: requirement.joint or None),
    )
    return Section("Requirements", listed, id="requirements")


def _consistency_section(consistency: Consistency | None) -> Section | None:
    """Show the moves of estimates due to physical consistency, and the cost in residuals."""
    if consistency is None:
        return None
    moved = [move for move in consistency.moves if move.deviations >= MOVED]
    gains = [Parameter("gain", joint) for joint in consistency.gains]
    shown = [move for move in moved if move.name not in gains][:LISTED]
    shown += [move for name in gains for move in consistency.moves if move.name == name]
    listed = table_of(
        shown,
        (Column("estimate", Kind.NAME), "name"),
        (Column("free", Kind.NUMBER, 5), "free"),
        (Column("consistent", Kind.NUMBER, 5), "consistent"),
        (Column("moved, std", Kind.NUMBER, decimals=2), "deviations"),
    )
    joint = max(consistency.loss, key=lambda name: consistency.loss[name])
    words = (
        f"{len(moved)} of {len(consistency.moves)} moved by {MOVED:g} standard deviations or more; torque residuals "
        f"{_growth(*consistency.loss.values())} ({consistency.loss[joint]:z.1f} % at the worst joint, {joint}). "
        "model.json has every standard parameter under 'standard'; open masses are chosen near equal without priors."
    )
    return Section("Physically consistent parameters", listed, Text(words), id="consistency")


def _growth(*losses: float) -> str:
    """Describe the growth of torque residuals, of several joints together, by losses in per cent."""
    loss = 100 * (np.sqrt(np.mean([(1 + loss / 100) ** 2 for loss in losses])) - 1)
    growth = f"by {loss:.2g} %" if loss < 100 else f"{1 + loss / 100:.1f} times"
    return "do not grow" if loss < VISIBLE else f"grow {growth}"


def write_identification(
    result: IdentifiedModel,
    validation: Sequence[Run],
    path: Path,
    experiment: Experiment,
    folder: Path,
    seconds: float,
    progress: Progress = silent,
) -> Path:
    """Write the report of an identification of the ``experiment`` in ``path``, with its ``validation`` runs."""
    page = report_page(result, gather(result, result.data, validation, progress), experiment.expected_gains)
    return write_report(page, folder, seconds, inputs_of(path, experiment), settings_of(result))
