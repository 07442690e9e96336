"""Sections on a result: verdict, gains, payloads, parameters, correlation, singular values, alternatives, notes."""

from __future__ import annotations

import json
from base64 import b64encode
from collections import Counter
from collections.abc import Sequence

import numpy as np

from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.grades import by_grade
from gtau.estimation.results.estimate import AlternativeMoves, Estimate, PayloadEstimate
from gtau.estimation.results.headline import headline
from gtau.estimation.results.remarks import remarks
from gtau.estimation.results.result import Result
from gtau.estimation.results.scale_text import scale_lines
from gtau.estimation.results.summary import same_in_several
from gtau.report.evidence import (
    GOOD_OUTCOMES,
    Evidence,
    interval_parts,
)
from gtau.report.html.document import Section
from gtau.report.html.drawings import Interval, Panel, interval_rows, panel_figure
from gtau.report.html.elements import (
    Cell,
    Column,
    badge,
    escape,
    facts,
    number,
    paragraph,
    plain,
    sentence,
    table,
    text,
    verdict,
)
from gtau.report.style import joint_label
from gtau.signals.notes import Note

STRONG = 0.9  # correlation from which on a pair is listed
LISTED = 20
POORLY_KNOWN = 1000.0  # per cent: of a larger standard deviation the value says nothing


def verdict_section(evidence: Evidence) -> Section:
    """Show the verdict in words, and the figures that a reader asks for first."""
    result = evidence.result
    outcomes = Counter(gain.verdict.outcome for gain in result.drive_gains.values())
    grade = "good" if set(outcomes) <= set(GOOD_OUTCOMES) else "weak"
    if outcomes[Outcome.CONTRADICTORY] or outcomes[Outcome.NOT_IDENTIFIABLE]:
        grade = "bad"
    said = remarks(result)
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
        found["largest torque error of the fit"] = f"{worst.relative:.2g} % ({worst.joint})"
    unused = [error for run in evidence.runs if not run.used for error in run.errors]
    if unused:
        worst = max(unused, key=lambda each: each.relative)
        whole = worst.relative_all
        more = "" if whole is None else f", {whole:.2g} % with reversals"
        found["largest torque error of validation"] = f"{worst.relative:.2g} %{more} ({worst.joint})"
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
                Cell(f'<span class="name">{escape(joint_label(joint))}</span>'),
                number(gain.value),
                interval_cell(whole),
                *([interval_cell(inner)] if split else []),
                text(gain.unit, "unit"),
                *_prior_cells(gain, given if prior else None, bool(prior)),
                *_delay_cells(result.delays.get(joint)),
                badge(gain.verdict.outcome.value),
            ]
        )
        bars.append(
            Interval(0.0, _relative(whole, gain.value), _relative(inner, gain.value), _off(given, gain.value))
            if gain.value
            else Interval(None)
        )
    columns = [
        Column("joint"),
        Column("gain", True),
        Column("95 % interval", True),
        *([Column("random part", True)] if split else []),
        Column("unit"),
        *([Column("prior", True), Column("prior off by", True)] if prior else []),
        Column("delay, ms", True),
        Column("verdict"),
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
    masses = {f"payload '{each.name}'": each.parameters["m"].value for each in result.payloads if "m" in each.known}
    said = " ".join(scale_lines(result))
    for source, mass in masses.items():
        said = said.replace(source, f"{source} ({mass:g} kg)", 1)
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


def parameters_section(result: Result) -> Section:
    """Show essential, cancelled and friction parameters in one table that sorts and searches."""
    rows, faint = [], []
    entries = [(name, result.essential.get(name, each)) for name, each in result.parameters.items()]
    for name, each in entries:
        kept = name in result.essential
        role = "essential" if kept else "not identifiable" if each.value is None else "cancelled"
        rows.append(_parameter_row(name, each, role))
        if not kept:
            faint.append(len(rows) - 1)
    rows += [_parameter_row(name, each, "friction, by BIC") for name, each in result.friction.items()]
    columns = [
        Column("parameter"),
        Column("value", True),
        Column("std", True),
        Column("std, %", True),
        Column("unit"),
        Column("role"),
        Column("regroups"),
    ]
    cancelled, loss = len(result.parameters) - len(result.essential), result.statistics.get("reduction_loss", 0.0)
    words = (
        f"{len(result.essential)} of {len(result.parameters)} base parameters are essential; cancelling the other "
        f"{cancelled} raises the torque error of the worst joint by {loss:.2g} %. "
        "A standard deviation above 100 % belongs to a parameter that the torques need but that is known only in sums."
    )
    return Section(
        "parameters", "Parameters", paragraph(words) + table(columns, rows, sortable="parameter-table", cancelled=faint)
    )


def _parameter_row(name: str, each: Estimate, role: str) -> list[Cell]:
    percent = each.rel_std
    relative = (
        Cell("–", True)
        if percent is None
        else Cell(f"{percent:.2f}" if percent < POORLY_KNOWN else f"&gt; {POORLY_KNOWN:g}", True, percent)
    )
    return [
        Cell(f'<span class="mono">{escape(name)}</span>'),
        number(each.value, missing="–"),
        number(each.std, 2),
        relative,
        text(each.unit, "unit"),
        text(role),
        Cell(f'<span class="mono soft">{escape(each.regrouping if each.regrouping != name else "")}</span>'),
    ]


def correlation_section(evidence: Evidence) -> Section | None:
    """Show the correlation matrix of the estimates, and the pairs that are strongly correlated."""
    names, matrix = evidence.correlation
    if len(names) < 2:
        return None
    packed = b64encode(np.round(100 * matrix).astype(np.int8).tobytes()).decode("ascii")
    upper = np.triu(np.abs(matrix), 1)
    strongest = np.argsort(upper, axis=None)[::-1]
    pairs = [np.unravel_index(k, upper.shape) for k in strongest if upper.flat[k] >= STRONG]
    rows = [[text(names[i], "mono"), text(names[j], "mono"), number(float(matrix[i, j]), 3)] for i, j in pairs[:LISTED]]
    hint = "Point at a cell to read it. Blue: positive, orange: negative; the fuller the colour, the stronger."
    drawn = (
        f'<div class="matrix" data-names="{escape(json.dumps(names))}" data-values="{packed}">'
        f'<canvas role="img" aria-label="Correlation matrix of {len(names)} estimates"></canvas>'
        f'<output class="soft">{hint}</output></div>'
    )
    words = (
        f"{len(names)} estimates in the order of model.json: parameters, then drive gains, then delays. "
        f"{len(pairs) or 'No'} pair{'' if len(pairs) == 1 else 's'} with a correlation of {STRONG:g} or more"
        + (f", the {LISTED} strongest listed." if len(pairs) > LISTED else ".")
    )
    shown = paragraph(words) + drawn
    if rows:
        shown += table([Column("estimate"), Column("and"), Column("correlation", True)], rows)
    return Section("correlation", "Correlation", shown)


def singular_values_section(evidence: Evidence) -> Section | None:
    """Show singular values in falling order with the gap before the smallest; None where the result has none."""
    values = np.array(evidence.result.singular_values)
    if len(values) < 2 or values[-1] <= 0:
        return None
    gap = float(values[-2] / values[-1])
    order = np.arange(1, len(values) + 1)
    panel = Panel(
        (0.5, len(values) + 0.5),
        (10.0 ** np.floor(np.log10(values[-1])), 10.0 ** np.ceil(np.log10(values[0]))),
        "number",
        "singular value",
        (420.0, 220.0),
        log_y=True,
    )
    panel.line(order.astype(float), values, "grid")
    panel.points(
        order, values, "predicted", [f"{k}: {plain(value, 4)}" for k, value in zip(order, values, strict=True)]
    )
    panel.points(order[-1:], values[-1:], "residual", [f"smallest: {plain(float(values[-1]), 4)}"])
    words = (
        "Of W_tot (eq. 33), rows weighted by the residuals and columns of unit length. The smallest belongs to the "
        f"solution; the next is {gap:.3g} times larger. A ratio near 1 comes from parameters that the motion hardly "
        "excites, those with large standard deviations, and makes total least squares unreliable."
    )
    return Section(
        "singular-values",
        "Singular values",
        paragraph(words) + panel_figure("Singular values in falling order", panel.svg("Singular values"), "wide-panel"),
    )


def alternatives_section(evidence: Evidence) -> Section | None:
    """Show other models of the same data, and by how much each moves the gains; None where the result lists none."""
    listed = evidence.result.alternatives
    if not listed:
        return None
    weighed = sorted(listed, key=lambda each: -each.probability * max(map(abs, each.moves.values()), default=0.0))
    rows = [
        [
            text(each.subject),
            Cell(_share(each.probability), True, each.probability),
            *(_move_cell(each.moves.get(joint)) for joint in evidence.robot.motors),
            _size_cell(each),
            text(each.unit),
            Cell(_share(each.share), True, each.share),
        ]
        for each in weighed
    ]
    columns = [
        Column("alternative"),
        Column("probability, %", True),
        *(Column(f"moves {joint_label(joint)} by, %", True) for joint in evidence.robot.motors),
        Column("size", True),
        Column("unit"),
        Column("share of the residual, %", True),
    ]
    words = (
        "Each alternative has one unknown more than the model. Its size is what the data find, its probability how "
        "well they support it; what they leave open of it widens the intervals of the gains. The alternatives that "
        "matter most come first: probable ones that would move a gain."
    )
    return Section(
        "alternatives", "Alternatives", paragraph(words) + table(columns, rows, sortable="alternatives-table")
    )


def _size_cell(each: AlternativeMoves) -> Cell:
    if each.std is None:
        return Cell("not identifiable", True)
    return Cell(f"{escape(plain(each.size, 2))} ± {escape(plain(each.std, 2))}", True, each.size)


def _move_cell(move: float | None) -> Cell:
    return Cell("–", True) if move is None else Cell(f"{move:.2f}".replace("-", "\N{MINUS SIGN}"), True, move)


def _share(part: float) -> str:
    return "&lt; 0.1" if 0 < part < 0.001 else f"{100 * part:.1f}"


def notes_section(notes: Sequence[Note]) -> Section:
    """List everything that was repaired, left out or noticed."""
    shown = findings_table(notes) or paragraph("Nothing was repaired, left out or noticed.")
    return Section("notes", "Findings", shown)


def findings_table(notes: Sequence[Note]) -> str:
    """Notes as a table, the worst first; empty without notes."""
    rows = [
        [badge(grade.value), text(_where(note)), text(sentence(note.what)), text(note.action and sentence(note.action))]
        for grade, members in by_grade(same_in_several(notes)).items()
        for note in members
    ]
    columns = [Column("grade"), Column("where"), Column("what was found"), Column("what to do")]
    return table(columns, rows, css="findings") if rows else ""


def _where(note: Note) -> str:
    """Log or robot, joint, time and size of a finding, as far as they are known."""
    share = None if note.share is None else f"{100 * note.share:.2g} % of the samples"
    time = None if note.time is None else f"{note.time:.4g} s"
    return ", ".join(part for part in (note.source, note.joint and joint_label(note.joint), time, share) if part)
