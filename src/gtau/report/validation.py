"""Show predictions of other runs and weighed payloads, as pages, JSON documents and files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gtau.documents.files import write_table
from gtau.estimation.results.conclusions import headline as headline_of_model
from gtau.estimation.results.model_file import payload_documents, torque_error
from gtau.estimation.results.payload_body import PayloadBody, PayloadEstimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding, Grade, percents, to_width
from gtau.report.gains import gains_section, payloads_section
from gtau.report.logs import logs_section, unique_names
from gtau.report.page import Column, Kind, Page, Section, Text, table_of
from gtau.report.robot import motion_section
from gtau.report.torques import REVERSALS, RunEvidence, bands_section, errors_table, torques_section
from gtau.uses.weigh import FRICTION_CHANGE, GAIN_CHANGE

CAUTION = (
    "A small error says nothing about the gains, which scale measured and predicted torque alike. Next: weigh a known "
    "load (gtau payload MODEL.json LOG); then export the model (gtau export), or watch the robot with it (gtau watch)."
)


def validation_document(runs: Sequence[RunEvidence]) -> dict[str, Any]:
    """Describe torque errors as JSON: ``rms`` and ``signal`` in ``unit``, ``relative`` in per cent, ``bands`` in Hz."""
    documents = [
        {"log": run.run.name, "joints": list(map(torque_error, run.errors)), "notes": list(map(str, run.notes))}
        for run in runs
    ]
    return {"runs": documents}


def validation_page(result: IdentifiedModel, runs: Sequence[RunEvidence], notes: Sequence[Finding] = ()) -> Page:
    """Show the torque errors of each run; ``notes`` hold assumptions of all predictions."""
    noted = [(run.run.name, note) for run in runs for note in run.notes]
    said = [str(note) if note.decisive else f"run '{name}': {note}" for name, note in noted]
    style: Any = "bad" if any(note.decisive for _, note in noted) else "neutral"
    verdict = Text(headline(result, runs), (*said, *map(str, notes), CAUTION), style)
    return Page(
        f"Validation of {result.robot.name}",
        Section("Verdict", verdict, id="verdict"),
        Section("Torque errors", errors_table(runs), Text(REVERSALS), id="errors"),
        bands_section([error for run in runs for error in run.errors]),
        lead=[f"Model identified from {', '.join(result.runs)}; validated on {', '.join(r.run.name for r in runs)}."],
    )


def validation_report(
    result: IdentifiedModel, runs: Sequence[RunEvidence], prior: Mapping[str, float], notes: Sequence[Finding] = ()
) -> Page:
    """Show verdict, torques, gains, motion and logs."""
    short = validation_page(result, runs, notes)
    return Page(
        short.title,
        short.sections[0],
        torques_section(result, runs),
        gains_section(result, prior),
        motion_section(result, runs),
        logs_section([run.run for run in runs]),
        lead=short.lead,
    )


def headline(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> str:
    """Summarise the torque errors over all runs in one sentence."""
    errors = [error for run in runs for error in run.errors]
    if not errors:
        return "No joint moves in these runs, so there is no torque error."
    worst = max(errors, key=lambda error: error.relative_raw or 0.0)
    raw, in_band, away = (
        percents(values)
        for values in zip(*((error.relative_raw, error.relative_all, error.relative) for error in errors), strict=True)
    )
    band = max(result.preparation.at(run.run.rate).decimator.cutoff(run.run.rate) for run in runs)  # Hz
    return (
        f"The predicted torques differ from the raw measured ones by {raw}, most at joint '{worst.joint}'; in the "
        f"band of the identification (below {band:.3g} Hz) by {in_band}, leaving out reversals by {away}."
    )


def write_torques(runs: Sequence[RunEvidence], folder: Path) -> list[Path]:
    """Write a table with all samples of each run; raises GtauError if a file cannot be written."""
    written = []
    for name, run in zip(unique_names([run.run.name for run in runs]), runs, strict=True):
        if run.samples is not None:
            written.append(folder / f"torques_{name}.parquet")
            write_table(run.samples.to_frame(), written[-1])
    return written


def weighing_page(
    result: IdentifiedModel,
    payloads: Sequence[PayloadEstimate],
    gains: str,
    exact: Sequence[str] = (),
    bodies: Sequence[PayloadBody] = (),
    prior: Mapping[str, float] | None = None,
) -> Page:
    """Show payloads weighed with the ``gains`` (identified or prior), which are taken as exact for joints ``exact``.

    With ``prior`` gains the page also shows the drive gains and the robot.
    """
    torques = result.kind == "torque" and gains != "prior"
    said = [f"Weighed with the {gains} drive gains."]
    if gains != "prior" and not exact and not result.believable:
        said.append(headline_of_model(result))
    if exact and torques:
        said = ["Weighed with the logged torques: an error of 1 % in all of them is 1 % of a mass."]
    elif exact:
        excluded = f"the {gains} gains" if len(exact) == len(result.gains) else f"the gains of {', '.join(exact)}"
        said.append(
            f"the intervals exclude the uncertainty of {excluded}: an error of 1 % in all gains is 1 % of a mass; "
            "write it as 'prior_gains: {joint: {value: 2.4, std: 0.1}}'"
        )
    if any(payload.weighed and payload.weighed.by_model for payload in payloads):
        said.append(
            "no run shows the robot with another load, so the model is the reference, with gains that may have changed "
            f"by {100 * GAIN_CHANGE:.0f} % and friction by {100 * FRICTION_CHANGE:.0f} %; a log of the same motion "
            "without payload narrows the interval"
        )
    given = "the logged torques taken as true, whose scale was not tested" if torques else "these gains assumed exact"
    words = masses_words(payloads, f"with {given}, " if exact else "")
    return Page(
        f"Payloads of {result.robot.name}",
        Section("Verdict", Text(words, tuple(said), "neutral"), id="verdict"),
        bodies_section(bodies),
        payloads_section(payloads, "Inertial parameters"),
        *(() if prior is None else (gains_section(result, prior), Section("Robot", result.robot, id="robot"))),
    )


def bodies_section(bodies: Sequence[PayloadBody]) -> Section | None:
    """Tabulate mass, centre of mass and inertia about it, in the requested frame; None without payloads."""
    parts = []
    for body in bodies:
        shown = table_of(
            [(key, quantity) for key, quantity in body.parameters.items() if quantity.value is not None],
            (Column("quantity", Kind.NAME), lambda item: item[0]),
            (Column("value", Kind.SPREAD, 4), lambda item: (item[1].value, item[1].half_interval())),
            (Column("unit"), lambda item: item[1].unit),
        )
        lost = f"The motion does not show {', '.join(body.unseen)}." if body.unseen else ""
        what = Text(f"In {body.frame}; inertia about the centre of mass, +- half a 95 % interval. {lost}".strip())
        doubt = Text(f"{body.doubt[0].upper()}{body.doubt[1:]}.", style="bad") if body.doubt else None
        parts.append(Section(f"Payload '{body.name}' of run {body.run}", what, doubt, shown if shown.rows else None))
    return Section("For a controller", *parts, id="controller") if parts else None


def weighing_document(
    payloads: tuple[PayloadEstimate, ...], bodies: Sequence[PayloadBody], gains: str, exact: Sequence[str]
) -> dict[str, Any]:
    """Describe weighed payloads as JSON, with null for quantities of bodies that the motion does not show."""
    described = [
        {
            "name": body.name,
            "run": body.run,
            "frame": body.frame,
            "parameters": {
                key: {"value": quantity.value, "interval": quantity.interval(), "unit": quantity.unit}
                for key, quantity in body.parameters.items()
            },
        }
        for body in bodies
    ]
    return {
        "payloads": payload_documents(payloads),
        "bodies": described,
        "gains": gains,
        "gain_uncertainty_included": not exact,
    }


def masses_words(payloads: Sequence[PayloadEstimate], given: str) -> str:
    """Summarise the masses and their intervals, which hold under the condition ``given``, in one sentence."""
    parts = []
    for payload in payloads:
        name, mass = payload.name, payload.parameters.get("m")
        if mass is None or mass.value is None:
            parts.append(f"the mass of '{name}' is not identifiable")
            continue
        ends, half = mass.interval(), mass.half_interval() or 0.0
        low, high = (to_width(end, half) for end in ends or (0.0, 0.0))
        between = "" if ends is None else f" ({given}95 % interval {low} to {high} kg)"
        if payload.verdict.outcome == Grade.CONTRADICTORY:
            parts.append(f"the mass of '{name}' contradicts the data{between}: {payload.verdict.sentence}")
        elif ends is not None and ends[0] < 0:
            parts.append(f"the mass of '{name}' cannot be distinguished from zero{between}")
        else:
            parts.append(f"'{name}' weighs {to_width(mass.value, half)} kg{between}")
    words = "; ".join(parts)
    return f"{words[:1].upper()}{words[1:]}."
