"""Show drive gains and payloads: estimates, intervals, sources of the scale, and gains by all estimators."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from gtau.estimation.experiment_runs import ACCURACY
from gtau.estimation.identify import EstimatorComparison
from gtau.estimation.results.conclusions import reasons
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Grade, percent_text, to_width
from gtau.model.base_parameters import whole_mass
from gtau.report.chart import Chart, intervals
from gtau.report.page import Column, ColumnOf, Kind, Page, Section, Table, Text, joint_label, table_of

GOOD_GRADES = (Grade.GOOD, Grade.GIVEN)
LEAST = 0.01  # smallest share of a source of the scale that is mentioned
LARGEST = 1000.0  # per cent; larger standard deviations are shown as "> 1000"


def gains_section(
    result: IdentifiedModel, prior: Mapping[str, float] | None = None, charts: bool = True, reasons: bool = True
) -> Section:
    """Show drive gains with 95 % intervals, prior gains, reasons of verdicts, and the sources of the scale."""
    prior, gains = prior or {}, result.drive_gains
    title, what = "Drive gains", "gain"
    if result.kind == "torque":
        title, what = "Torque scale", "scale, true over reported torque"
    words = f"±: half the 95 % interval; random, model: standard deviations; % of the {what}"
    estimated = any(gain.std is not None for gain in gains.values())
    return Section(
        title,
        _gains_table(result, prior, estimated),
        Text(words, style="soft") if estimated else None,
        _reasons_table(result, charts) if reasons else None,
        _scale_text(result, short=not reasons) if estimated else None,
        _whole_mass(result),
        gains_chart(gains, prior) if charts else None,
        id="gains",
    )


def _gains_table(result: IdentifiedModel, prior: Mapping[str, float], estimated: bool) -> Table:
    """Tabulate drive gains: verdict, value, interval and its two parts, delay, and prior gain."""
    gains = result.drive_gains
    accuracy = 100 * result.statistics.get("accuracy", ACCURACY)

    def half(joint: str) -> str | None:
        width = gains[joint].half_width
        return None if width is None else percent_text(width, accuracy)

    columns: list[ColumnOf] = [
        (Column("joint"), joint_label),
        (Column("verdict", Kind.BADGE), lambda joint: gains[joint].verdict.outcome.value),
        (Column("scale" if result.kind == "torque" else "gain", Kind.NUMBER, 5), lambda joint: gains[joint].value),
        (Column("unit"), lambda joint: gains[joint].unit),
    ]
    if estimated:
        part = partial(Column, kind=Kind.NUMBER, digits=2, most=LARGEST)
        columns += [
            (Column("±95 %", Kind.NUMBER), half),
            (part("random"), lambda joint: _relative(gains[joint], gains[joint].random_std)),
            (part("model"), lambda joint: _relative(gains[joint], gains[joint].model_std)),
            (Column("delay, ms", Kind.SPREAD, 3), lambda joint: _delay(result.delays.get(joint))),
            (Column("95 % interval", Kind.INTERVAL, wide=True), lambda joint: gains[joint].interval()),
        ]
    if prior:
        off = Column("prior off by, %", Kind.NUMBER, 3, wide=True)
        columns.append((Column("prior", Kind.NUMBER, 5, wide=True), prior.get))
        columns.append((off, lambda joint: _off(prior.get(joint), gains[joint])))
    return table_of(gains, *columns)


def _reasons_table(result: IdentifiedModel, beside_actions: bool = False) -> Table | None:
    """Tabulate why gains are not good, with the remedies unless shown beside; None if all are good."""
    columns: list[ColumnOf] = [
        (Column("joint"), lambda reason: ", ".join(map(joint_label, reason.joints))),
        (Column("verdict", Kind.BADGE), "outcome.value"),
        (Column("reason", Kind.SENTENCE), "why"),
    ]
    if not beside_actions:
        columns.append((Column("action", Kind.SENTENCE), "advice"))
    listed = reasons(result)
    return table_of(listed, *columns, listed=True) if listed else None


def gains_chart(gains: Mapping[str, Estimate], prior: Mapping[str, float]) -> Chart | None:
    """Draw 95 % intervals of drive gains, their random parts and ``prior`` gains, in per cent of the gain."""
    shown = {joint: gain for joint, gain in gains.items() if gain.value}
    off = [_off(prior.get(joint), gain) for joint, gain in shown.items()]
    if not any(gain.std for gain in shown.values()) and set(off) <= {None}:
        return None
    halves = [gain.half_width for gain in shown.values()]
    inner = [_random_half(gain) for gain in shown.values()]
    what = "scale" if any(gain.unit == "1" for gain in shown.values()) else "gain"
    labels, axis = [joint_label(joint) for joint in shown], f"difference from the identified {what}, %"
    return Chart((intervals(labels, [0.0] * len(shown), halves, axis, inner, ("prior", off), zero=True),))


def _random_half(gain: Estimate) -> float | None:
    """Return the half-width of the random part of the interval, per cent; None if the model part is unknown."""
    if not gain.model_std or not gain.std or gain.half_width is None:
        return None
    return gain.half_width * (gain.random_std or 0.0) / gain.std


def _relative(gain: Estimate, std: float | None) -> float | None:
    return None if std is None or not gain.value else 100 * std / abs(gain.value)


def _off(given: float | None, gain: Estimate) -> float | None:
    return None if given is None or not gain.value else 100 * (given / gain.value - 1)


def _delay(delay: Estimate | None) -> tuple[float, float] | None:
    if delay is None or delay.value is None or delay.verdict.outcome not in GOOD_GRADES:
        return None
    return 1e3 * delay.value, 1e3 * (delay.half_interval() or 0.0)


def _whole_mass(result: IdentifiedModel) -> Text | None:
    """Give the mass of a floating robot, which users can check on a scale."""
    if not result.robot.floating:
        return None
    name = whole_mass(result.base, result.idm.parameter_names)
    mass = result.parameters.get(name) if name else None
    if mass is None or mass.value is None or (half := mass.half_interval()) is None:
        return None
    return Text(f"mass of the whole robot ({mass.name}): {mass.value:.4g} ± {half:.2g} kg")


def _scale_text(result: IdentifiedModel, short: bool) -> Text | None:
    """Name the sources of the scale, joint by joint if they differ; None if the gains were given."""
    if short:
        sources = all_sources(result)
        return Text(f"scale: from {sources}") if sources else None
    names = {sensor.source: f"the {sensor.source}" for sensor in result.sensors}
    for payload in result.payloads:
        if "m" in payload.known and (mass := payload.parameters["m"].value) is not None:
            names[f"payload '{payload.name}'"] = f"payload '{payload.name}' ({mass:g} kg)"
    words = {}
    for joint, shares in result.scale.items():
        large = {source: share for source, share in shares.items() if abs(share) >= LEAST}
        ranked = sorted(large, key=lambda source: -large[source])
        named = [names.get(source, source) for source in ranked]
        if len(named) > 1:
            named = [f"{name} ({100 * large[source]:.0f} %)" for name, source in zip(named, ranked, strict=True)]
        if shares:
            words[joint] = ", ".join(named)
    if len(set(words.values())) == 1:
        return Text(f"The scale of all joints comes from {next(iter(words.values()))}.")
    lines = [f"The scale of '{joint}' comes from {sources}." for joint, sources in words.items()]
    return Text("", tuple(lines)) if lines else None


def all_sources(result: IdentifiedModel) -> str:
    """List the sources of the scale of all gains, largest first, with the sensors of a kind merged."""
    totals: Counter[str] = Counter()
    for shares in result.scale.values():
        totals.update({source: abs(share) for source, share in shares.items()})
    names = {source: source for source, total in totals.most_common() if total >= LEAST * len(result.drive_gains)}
    together = []
    for kind in dict.fromkeys(sensor.kind for sensor in result.sensors):
        sensors = (sensor for sensor in result.sensors if sensor.kind == kind and sensor.source in names)
        joints = {sensor.source: sensor.joint for sensor in sensors}
        if len(joints) > 1:
            together.append(f"the {kind.group} of " + ", ".join(f"'{joint}'" for joint in joints.values()))
            names = {source: words for source, words in names.items() if source not in joints}
        names |= {source: f"the {source}" for source in joints if source in names}
    return " and ".join([*together, *names.values()])


def payloads_section(payloads: Iterable[PayloadEstimate], title: str = "Payloads") -> Section | None:
    """Show inertial parameters of payloads, in the frame of the body that carries them; None without payloads."""
    columns = (Column("parameter", Kind.NAME), *VALUE, Column("95 % interval", Kind.INTERVAL, wide=True), Column(""))
    parts = []
    for payload in payloads:
        rows = []
        for name, value in payload.parameters.items():
            role = "known" if name in payload.known else "not identifiable" if value.value is None else value.regroups
            rows.append((name, *value_cells(value), value.interval(), role))
        verdict = Text(f"{payload.verdict.sentence}.") if payload.verdict.why else None
        parts.append(Section(f"Payload '{payload.name}' of run {payload.run}", verdict, Table(columns, rows)))
    return Section(title, *parts, id="payloads") if parts else None


def unknown_payloads(result: IdentifiedModel) -> list[PayloadEstimate]:
    """List the payloads with identified parameters."""
    return [payload for payload in result.payloads if set(payload.parameters) - payload.known]


def masses_table(payloads: Sequence[PayloadEstimate]) -> Table | None:
    """Tabulate identified masses of payloads; None without payloads."""
    rows = [
        (f"payload '{payload.name}' of {payload.run}", (mass.value, mass.half_interval()), mass.unit)
        for payload in payloads
        if "m" not in payload.known and (mass := payload.parameters.get("m")) and mass.value is not None
    ]
    return Table((Column("mass"), Column("value", Kind.SPREAD, 5), Column("unit")), rows) if rows else None


VALUE = (
    Column("value", Kind.NUMBER, 5),
    Column("std", Kind.NUMBER, 2),
    Column("std, %", Kind.NUMBER, decimals=2, most=LARGEST),
    Column("unit"),
)
"""Columns for :func:`value_cells`."""


def value_cells(estimate: Estimate) -> tuple[object, ...]:
    """Return value (rounded to its interval), standard deviation, relative standard deviation and unit."""
    value, half = estimate.value, estimate.half_interval()
    shown = float(to_width(value, half)) if half and value is not None else value
    return shown, estimate.std, estimate.rel_std, estimate.unit


TRUSTED = ("good", "weak")


def comparison_page(comparison: EstimatorComparison, prior: Mapping[str, float] | None = None) -> Page:
    """Show the results of each estimator."""
    said = [f"{row.method}: {row.refusal}" for row in comparison.rows if row.refusal]
    judged = [(row.method, row.outcome.value) for row in comparison.rows if row.outcome]
    said += [f"{method}: the gains are {outcome}" for method, outcome in judged if outcome not in TRUSTED]
    said += map(str, comparison.notes)
    verdict = Text(_agreement(comparison), tuple(said), "neutral")
    words = "residual: worst joint, % of its current; time: estimation alone; ±: half the 95 % interval"
    return Page(
        f"Estimators on {comparison.robot}",
        Section("Verdict", verdict, id="verdict"),
        Section("Estimators", comparison_table(comparison), Text(words, style="soft"), id="estimators"),
        Section("Drive gains by estimator", *_charts(comparison, prior or {}), id="gains"),
    )


def _agreement(comparison: EstimatorComparison) -> str:
    rows = [row for row in comparison.rows if row.gains is not None and row.std is not None]
    trusted = [row for row in rows if row.outcome is not None and row.outcome.value in TRUSTED]
    if len(trusted) < 2:
        return f"{len(trusted) or 'None'} of {len(rows)} estimators that find drive gains give trustworthy ones."
    gains = np.array([row.gains for row in trusted])
    spread = 100 * np.ptp(gains, axis=0) / np.abs(np.median(gains, axis=0))
    j = int(np.argmax(spread))
    return (
        f"{len(trusted)} of {len(rows)} estimators find trustworthy gains, which agree to "
        f"{percent_text(spread[j])} % or better, and differ most at joint '{comparison.joints[j]}'."
    )


def comparison_table(comparison: EstimatorComparison) -> Table:
    """Tabulate each estimator: worst verdict, residual, time, and gains with their 95 % intervals."""
    units = zip(comparison.joints, _units(comparison), strict=True)
    labels = [f"{joint_label(joint)}, {unit}" for joint, unit in units]
    columns = (
        Column("estimator", Kind.NAME),
        Column("worst verdict", Kind.BADGE),
        Column("residual, %", Kind.NUMBER, decimals=2),
        Column("time, s", Kind.NUMBER, decimals=2),
        *(Column(label, Kind.SPREAD, 5) for label in labels),
    )
    rows: list[tuple[object, ...]] = []
    for row in comparison.rows:
        if row.gains is None or row.residuals is None:
            rows.append((row.method, "refused", None, None, *([None] * len(comparison.joints))))
            continue
        halves = np.zeros(len(comparison.joints)) if row.half_widths is None else row.half_widths
        outcome = "given" if row.outcome is None else row.outcome.value
        gains = zip(row.gains.tolist(), halves.tolist(), strict=True)
        rows.append((row.method, outcome, float(row.residuals.max()), row.seconds, *gains))
    return Table(columns, rows)


def _charts(comparison: EstimatorComparison, prior: Mapping[str, float]) -> Iterator[Chart]:
    """Draw the gain of each joint by every estimator, with 95 % intervals and the prior gain."""
    rows = {row.method: (row.gains, row.half_widths) for row in comparison.rows}
    shown = {method: (g.tolist(), h.tolist()) for method, (g, h) in rows.items() if g is not None and h is not None}
    for j, (joint, unit) in enumerate(zip(comparison.joints, _units(comparison), strict=True) if shown else ()):
        values = [gains[j] for gains, _ in shown.values()]
        halves = [half[j] for _, half in shown.values()]
        given, axis = ("prior", [prior.get(joint)] * len(shown)), f"{joint_label(joint)}, {unit}"
        yield Chart((intervals(list(shown), values, halves, axis, other=given),))


def _units(comparison: EstimatorComparison) -> tuple[str, ...]:
    return comparison.units or ("N m/A or N per A",) * len(comparison.joints)
