"""The report of a validation: how well a model reproduces the torques of runs that it was not identified from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gtau.estimation.results.result import Result
from gtau.report import provenance
from gtau.report.evidence import Evidence, RunEvidence
from gtau.report.gain_sections import gains_section
from gtau.report.html.document import Section
from gtau.report.html.elements import verdict
from gtau.report.html.series import Arrays
from gtau.report.identification_report import page
from gtau.report.log_section import logs_section
from gtau.report.motion_section import motion_section
from gtau.report.provenance import Provenance
from gtau.report.torque_sections import torques_section
from gtau.report.validation_page import CAUTION, Validation


def evidence_of(result: Result, validations: Sequence[Validation], prior_gains: Mapping[str, float]) -> Evidence:
    """Turn the runs of a validation into evidence on a model."""
    runs = tuple(RunEvidence(each.run, False, each.prediction, each.errors) for each in validations)
    return Evidence(result, runs, dict(prior_gains))


def validation_report(evidence: Evidence, of: Provenance, notes: Sequence[str] = ()) -> str:
    """Render the report of a validation as the text of one HTML file; ``notes`` stand beside its verdict."""
    result, arrays = evidence.result, Arrays()
    preparation = result.preparation
    runs = [each.run for each in evidence.runs]
    sections = (
        Section("verdict", "Verdict", verdict("plain", headline(evidence), [*notes, CAUTION])),
        torques_section(evidence, arrays),
        gains_section(evidence),
        motion_section(evidence, arrays),
        logs_section(runs, result.robot, preparation.bandwidth, preparation.cutoff),
        provenance.section(of),
    )
    lead = [f"Model identified from {', '.join(result.runs)}; validated on {', '.join(run.name for run in runs)}."]
    return page(f"Validation of {result.robot.name}", lead, sections, arrays)


def headline(evidence: Evidence) -> str:
    """Summarise the torque errors over all runs in one sentence."""
    errors = [error for run in evidence.runs for error in run.errors]
    if not errors:
        return "No joint moves in these runs, so there is no torque error."
    worst = max(errors, key=lambda each: each.relative)
    words = (
        f"The predicted torques differ from the measured ones by {min(error.relative for error in errors):.2f} to "
        f"{worst.relative:.2f} % away from reversals, most at {worst.joint}"
    )
    whole = [error.relative_all for error in errors if error.relative_all is not None]
    return words + (f"; over all samples by {min(whole):.2f} to {max(whole):.2f} %." if whole else ".")
