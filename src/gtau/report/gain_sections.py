"""Sections on what the data give: the verdict, drive gains and payloads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.results.estimate import Estimate, PayloadEstimate
from gtau.estimation.results.headline import headline
from gtau.estimation.results.remarks import remarks
from gtau.estimation.results.result import Result
from gtau.estimation.results.scale_text import scale_lines
from gtau.report.evidence import (
    GOOD_OUTCOMES,
    Evidence,
    interval_parts,
)
from gtau.report.html.document import Section
from gtau.report.html.drawings import Interval, interval_rows
from gtau.report.html.elements import (
    Cell,
    Column,
    badge,
    escape,
    facts,
    number,
    paragraph,
    plain,
    table,
    text,
    verdict,
)
from gtau.report.style import joint_label


def verdict_section(evidence: Evidence) -> Section:
    """Show the verdict in words, and the figures that a reader asks for first."""
    result = evidence.result
    outcomes = Counter(gain.verdict.outcome for gain in result.drive_gains.values())
    grade = "good" if set(outcomes) <= set(GOOD_OUTCOMES) else "weak"
    if outcomes[Outcome.CONTRADICTORY] or outcomes[Outcome.NOT_IDENTIFIABLE]:
        grade = "bad"
    said = list(map(str, remarks(result)))
    words = (headline(result), said) if grade == "good" else (counts(result), [headline(result), *said])
    shown = facts(
        {
            "robot": result.robot.name,
            "estimator": result.method,
            "runs used": str(len(result.runs)),
            **_worst_errors(evidence),
            "base parameters": f"{len(result.essential)} of {len(result.parameters)} essential",
        }
    )
    return Section("verdict", "Verdict", verdict(grade, *words) + shown)


def counts(result: Result) -> str:
    """Count the verdicts on the drive gains, in one sentence."""
    outcomes = Counter(gain.verdict.outcome for gain in result.drive_gains.values())
    (first, count), *others = outcomes.most_common()
    more = "".join(f", {count} {'is' if count == 1 else 'are'} {outcome.value}" for outcome, count in others)
    return f"{count} of {len(result.drive_gains)} drive gains {'is' if count == 1 else 'are'} {first.value}{more}."


def _worst_errors(evidence: Evidence) -> dict[str, str]:
    """Find the largest torque error of the fit, and on the runs kept for validation."""
    found = {}
    if evidence.result.residuals:
        worst = max(evidence.result.residuals, key=lambda each: each.relative)
        found["largest torque error of the fit"] = f"{worst.relative:.2f} % ({worst.joint})"
    unused = [error for run in evidence.runs if not run.used for error in run.errors]
    if unused:
        worst = max(unused, key=lambda each: each.relative)
        whole = worst.relative_all
        more = "" if whole is None else f", {whole:.2f} % with reversals"
        found["largest torque error of validation"] = f"{worst.relative:.2f} %{more} ({worst.joint})"
    return found


def gains_section(evidence: Evidence) -> Section:
    """Show drive gains with their 95 % intervals, beside the prior ones, as a table and as a chart."""
    result, prior = evidence.result, evidence.prior_gains
    joints = list(result.drive_gains)
    parts = {joint: interval_parts(gain) for joint, gain in result.drive_gains.items()}
    split = any(inner is not None for _, inner in parts.values())
    rows, bars = [], []
    for joint, gain in result.drive_gains.items():
        whole, inner = parts[joint]
        given = prior.get(joint)
        rows.append(
            [
                text(joint_label(joint), "unit"),
                badge(gain.verdict.outcome.value),  # before what a phone scrolls out of sight
                number(gain.value),
                interval_cell(whole),
                *([interval_cell(inner)] if split else []),
                text(gain.unit, "unit"),
                *_prior_cells(gain, given if prior else None, bool(prior)),
                *_delay_cells(result.delays.get(joint)),
            ]
        )
        bars.append(
            Interval(0.0, _relative(whole, gain.value), _relative(inner, gain.value), _off(given, gain.value))
            if gain.value
            else Interval(None)
        )
    columns = [
        Column("joint"),
        Column("verdict"),
        Column("gain", True),
        Column("95 % interval", True),
        *([Column("random part", True)] if split else []),
        Column("unit"),
        *([Column("prior", True), Column("prior off by", True)] if prior else []),
        Column("delay, ms", True),
    ]
    shown = table(columns, rows)
    if any(bar.outer or bar.other is not None for bar in bars):
        shown += "<h3>Intervals, per cent of the identified gain</h3>" + _interval_table(
            joints, bars, split, bool(prior)
        )
    shown += scale_note(result)
    return Section("gains", "Drive gains", shown)


def scale_note(result: Result) -> str:
    """Describe what the scale of the gains rests on."""
    if not any(gain.std is not None for gain in result.drive_gains.values()):
        return ""
    said = " ".join(scale_lines(result, masses=True))
    return paragraph(said, "soft") if said else ""


def _interval_table(joints: Sequence[str], bars: Sequence[Interval], split: bool, prior: bool) -> str:
    drawn, axis = interval_rows(bars, zero=0.0)
    rows = "".join(
        f'<tr><td class="name">{escape(joint_label(joint))}</td><td class="bar">{bar}</td></tr>'
        for joint, bar in zip(joints, drawn, strict=True)
    )
    words = ["disc: identified gain", "thin line: 95 % interval"]
    words += ["thick line: its random part"] if split else []
    words += ["diamond: prior gain"] if prior else []
    return (
        f'<div class="scroll"><table class="intervals"><tbody>{rows}<tr><td class="soft">difference, %</td>'
        f'<td class="bar">{axis}</td></tr></tbody></table></div>' + paragraph("; ".join(words) + ".", "soft")
    )


def interval_cell(interval: tuple[float, float] | None) -> Cell:
    """Make a cell of an interval."""
    if interval is None:
        return Cell("–", True)
    low, high = interval
    decimals = int(np.clip(1 - np.floor(np.log10(high - low)), 0, 12)) if high > low else 4
    words = f"{low:.{decimals}f} to {high:.{decimals}f}".replace("-", "\N{MINUS SIGN}")
    return Cell(words, True, high - low)


def _prior_cells(gain: Estimate, given: float | None, wanted: bool) -> list[Cell]:
    if not wanted:
        return []
    return [number(given), _percent_cell(_off(given, gain.value))]


def _percent_cell(value: float | None) -> Cell:
    return Cell("–", True) if value is None else Cell(f"{escape(plain(value, 3))} %", True, value)


def _delay_cells(delay: Estimate | None) -> list[Cell]:
    if delay is None or delay.value is None or delay.verdict.outcome not in GOOD_OUTCOMES:
        return [Cell("not identifiable", True)]
    half = "" if delay.std is None else f" ± {1.96e3 * delay.std:.2g}"
    return [Cell(f"{escape(plain(1e3 * delay.value, 3))}{half}", True, delay.value)]


def _relative(interval: tuple[float, float] | None, value: float | None) -> tuple[float, float] | None:
    if interval is None or not value:
        return None
    a, b = (100 * (end / value - 1) for end in interval)
    return min(a, b), max(a, b)


def _off(given: float | None, value: float | None) -> float | None:
    return None if given is None or not value else 100 * (given / value - 1)


def payloads_section(payloads: Sequence[PayloadEstimate], title: str = "Payloads") -> Section | None:
    """Show inertial parameters of the payloads; None without any."""
    if not payloads:
        return None
    parts = []
    for each in payloads:
        rows = [
            [
                Cell(f'<span class="name">{escape(kind)}</span>'),
                number(found.value, missing="not identifiable"),
                interval_cell(found.interval()),
                text(found.unit, "unit"),
                text("known" if kind in each.known else found.regrouping if found.regrouping != kind else "identified"),
            ]
            for kind, found in each.parameters.items()
        ]
        columns = [
            Column("parameter"),
            Column("value", True),
            Column("95 % interval", True),
            Column("unit"),
            Column("origin, or what it regroups"),
        ]
        parts.append(f"<h3>Payload ‘{escape(each.name)}’ of run {escape(each.run)}</h3>")
        if each.verdict.why:
            parts.append(paragraph(f"{each.verdict.sentence}.".capitalize()))
        parts.append(table(columns, rows))
    parts.append(paragraph("In the frame of the body that carries the payload.", "soft"))
    return Section("payloads", title, "\n".join(parts))
