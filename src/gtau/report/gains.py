"""Show drive gains and payloads: estimates, intervals, and the sources of their scale."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.results.conclusions import reasons
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.payload import PayloadEstimate
from gtau.estimation.results.result import Result
from gtau.estimation.thresholds.estimates import ACCURACY
from gtau.findings.words import percent_text
from gtau.model.base_parameters import whole_mass
from gtau.report.chart import Chart, intervals
from gtau.report.page import Column, Kind, Section, Table, Text, joint_label, section, table

GOOD_OUTCOMES = (Outcome.GOOD, Outcome.GIVEN)
LEAST = 0.01  # share of a source of the scale that is mentioned
NOT_SHOWN = 1000.0  # per cent: a larger standard deviation is shown as larger


def gains_section(
    result: Result, prior: Mapping[str, float] | None = None, charts: bool = True, short: bool = False
) -> Section:
    """Show drive gains with their 95 % intervals, beside the prior ones, and the sources of their scale."""
    estimated = any(gain.std is not None for gain in result.drive_gains.values())
    of_torques = result.kind == "torque"
    words = "±: half the 95 % interval; random, model: standard deviations; % of the "
    words += "scale, true over reported torque" if of_torques else "gain"
    return section(
        "Torque scale" if of_torques else "Drive gains",
        gains_table(result, prior or {}),
        Text(words, style="soft") if estimated else None,
        reasons_table(result),
        _scale_text(result, short) if estimated else None,
        whole_mass_text(result),
        gains_chart(result.drive_gains, prior or {}) if charts else None,
        id="gains",
    )


def gains_table(result: Result, prior: Mapping[str, float]) -> Table:
    """Tabulate drive gains: verdict, value, interval with its two parts, delay, and the prior gain."""
    estimated = any(gain.std is not None for gain in result.drive_gains.values())
    accuracy = 100 * result.statistics.get("accuracy", ACCURACY)
    name = "scale" if result.kind == "torque" else "gain"
    columns = [Column("joint"), Column("verdict", Kind.BADGE), Column(name, Kind.NUMBER, 5), Column("unit")]
    if estimated:
        columns += [
            Column("±95 %", Kind.NUMBER),
            Column("random", Kind.NUMBER, 2, most=NOT_SHOWN),
            Column("model", Kind.NUMBER, 2, most=NOT_SHOWN),
            Column("delay, ms", Kind.SPREAD, 3),
            Column("95 % interval", Kind.INTERVAL, wide=True),
        ]
    columns += [Column("prior", Kind.NUMBER, 5, wide=True)] if prior else []
    columns += [Column("prior off by, %", Kind.NUMBER, 3, wide=True)] if prior else []
    rows = []
    for joint, gain in result.drive_gains.items():
        row: list[object] = [joint_label(joint), gain.verdict.outcome.value, gain.value, gain.unit]
        if estimated:
            parts = (_relative(gain, gain.random_std), _relative(gain, gain.model_std))
            half = None if gain.half_width is None else percent_text(gain.half_width, accuracy)
            row += [half, *parts, _delay(result.delays.get(joint)), gain.interval()]
        row += [prior.get(joint), _off(prior.get(joint), gain.value)] if prior else []
        rows.append(row)
    return table(columns, rows)


def reasons_table(result: Result) -> Table | None:
    """Tabulate why gains are not good, and what to do; None if all are good."""
    sentences = (Column("reason", Kind.SENTENCE), Column("action", Kind.SENTENCE))
    columns = (Column("joint"), Column("verdict", Kind.BADGE), *sentences)
    found = reasons(result)
    rows = [(", ".join(map(joint_label, each.joints)), each.outcome.value, each.why, each.action) for each in found]
    return table(columns, rows, listed=True) if rows else None


def gains_chart(gains: Mapping[str, Estimate], prior: Mapping[str, float]) -> Chart | None:
    """Draw 95 % intervals of drive gains and their random parts, in per cent of the gain, beside ``prior`` gains."""
    shown = {joint: gain for joint, gain in gains.items() if gain.value}
    off = [_off(prior.get(joint), gain.value) for joint, gain in shown.items()]
    if not any(gain.std for gain in shown.values()) and not any(each is not None for each in off):
        return None
    halves = [gain.half_width for gain in shown.values()]
    inner = [_random_half(gain) for gain in shown.values()]
    labels = [joint_label(joint) for joint in shown]
    axis = "difference from the identified gain, %"
    return Chart((intervals(labels, [0.0] * len(shown), halves, axis, inner, ("prior", off), zero=True),))


def _random_half(gain: Estimate) -> float | None:
    """Half the random part of the interval, per cent; None where no model part is known."""
    if not gain.model_std or not gain.std or gain.half_width is None:
        return None
    return gain.half_width * (gain.random_std or 0.0) / gain.std


def _relative(gain: Estimate, std: float | None) -> float | None:
    return None if std is None or not gain.value else 100 * std / abs(gain.value)


def _off(given: float | None, value: float | None) -> float | None:
    return None if given is None or not value else 100 * (given / value - 1)


def _delay(delay: Estimate | None) -> tuple[float, float] | None:
    if delay is None or delay.value is None or delay.verdict.outcome not in GOOD_OUTCOMES:
        return None
    return 1e3 * delay.value, 1e3 * (delay.half_interval() or 0.0)


def whole_mass_text(result: Result) -> Text | None:
    """Say what a floating robot weighs, the one figure that everyone can check on a scale."""
    if not result.robot.floating:
        return None
    name = whole_mass(result.base, result.idm.parameter_names)
    mass = None if name is None else result.parameters.get(name)
    half = None if mass is None else mass.half_interval()
    if mass is None or mass.value is None or half is None:
        return None
    return Text(f"mass of the whole robot ({mass.name}): {mass.value:.4g} ± {half:.2g} kg")


# What the scale rests on


def _scale_text(result: Result, short: bool) -> Text | None:
    if short:
        found = all_sources(result)
        return Text(f"scale: from {found}") if found else None
    lines = scale_lines(result)
    return Text(lines[0] if len(lines) == 1 else "", tuple(lines) if len(lines) > 1 else ()) if lines else None


def scale_lines(result: Result) -> list[str]:
    """Describe what the scale of all gains rests on, or of each where they differ; empty where they were given."""
    known = {each.name: each.parameters["m"].value for each in result.payloads if "m" in each.known}
    masses = {name: f"payload '{name}' ({mass:g} kg)" for name, mass in known.items() if mass is not None}
    names = _sensors(result) | {f"payload '{name}'": words for name, words in masses.items()}
    words = {joint: _words(gain.scale, names) for joint, gain in result.drive_gains.items() if gain.scale}
    if not words:
        return []
    if len(set(words.values())) == 1:
        return [f"The scale of all gains comes from {next(iter(words.values()))}."]
    return [f"The scale of '{joint}' comes from {each}." for joint, each in words.items()]


def all_sources(result: Result) -> str:
    """List all sources of the scale, those on which most gains rest first; sensors of a kind together, by joint."""
    totals: dict[str, float] = {}
    for gain in result.drive_gains.values():
        for source, share in gain.scale.items():
            totals[source] = totals.get(source, 0.0) + abs(share) / len(result.drive_gains)
    found = [source for source, each in sorted(totals.items(), key=lambda each: -each[1]) if each >= LEAST]
    names, together = _sensors(result), []
    for kind in dict.fromkeys(each.kind for each in result.sensors):
        sensors = [each for each in result.sensors if each.kind == kind and each.source in found]
        if len(sensors) > 1:
            joints = ", ".join(f"'{each.joint}'" for each in sensors)
            together.append(f"the {kind.group} of {joints}")
            found = [source for source in found if source not in {each.source for each in sensors}]
    return " and ".join([*together, *(names.get(source, source) for source in found)])


def _sensors(result: Result) -> dict[str, str]:
    """Name the sensors behind the drives, by the source of a scale that each is."""
    return {each.source: f"the {each.source}" for each in result.sensors}


def _words(scale: Mapping[str, float], names: Mapping[str, str]) -> str:
    """Name the source of a scale, or several with their shares, the largest first."""
    listed = sorted((each for each in scale.items() if abs(each[1]) >= LEAST), key=lambda each: -each[1])
    if len(listed) == 1:
        return names.get(listed[0][0], listed[0][0])
    return ", ".join(f"{names.get(source, source)} ({100 * share:.0f} %)" for source, share in listed)


# Payloads


def payloads_section(payloads: Iterable[PayloadEstimate], title: str = "Payloads") -> Section | None:
    """Show inertial parameters of the payloads, in the frame of the body that carries them; None without any."""
    parts = [
        section(
            f"Payload '{each.name}' of run {each.run}",
            Text(f"{each.verdict.sentence}.") if each.verdict.why else None,
            estimates_table_of(each.parameters, each.known),
        )
        for each in payloads
    ]
    return section(title, *parts, id="payloads") if parts else None


def unknown_payloads(result: Result) -> list[PayloadEstimate]:
    """List the payloads of which something was identified."""
    return [each for each in result.payloads if set(each.parameters) - each.known]


def masses_table(payloads: Sequence[PayloadEstimate]) -> Table | None:
    """Tabulate identified masses of payloads; None without any."""
    found = [each for each in payloads if "m" in set(each.parameters) - each.known]
    rows = [
        (f"payload '{each.name}' of {each.run}", mass.value, mass.std, mass.rel_std, mass.unit)
        for each in found
        for mass in [each.parameters["m"]]
    ]
    return table((Column("mass"), *VALUE), rows) if rows else None


def masses_section(payloads: Sequence[PayloadEstimate]) -> Section | None:
    """Draw the masses of payloads with their intervals; None where none is identifiable."""
    masses = [(each, each.parameters["m"]) for each in payloads if "m" in each.parameters]
    if not any(mass.value is not None for _, mass in masses):
        return None
    panel = intervals(
        [f"{each.name}, {each.run}" for each, _ in masses],
        [mass.value for _, mass in masses],
        [mass.half_interval() for _, mass in masses],
        "mass, kg",
    )
    return section("Masses", Chart((panel,)), id="masses")


VALUE = (
    Column("value", Kind.NUMBER, 5),
    Column("std", Kind.NUMBER, 2),
    Column("std, %", Kind.NUMBER, decimals=2, most=NOT_SHOWN),
    Column("unit"),
)
"""Columns of an estimate, see :func:`value_cells`."""


def value_cells(each: Estimate) -> tuple[object, ...]:
    """Return value, standard deviation, relative standard deviation and unit."""
    return each.value, each.std, each.rel_std, each.unit


def regroups(each: Estimate) -> str:
    """Return what an estimate regroups, empty where that is its name."""
    return each.regrouping if each.regrouping != each.name else ""


def estimates_table_of(estimates: Mapping[str, Estimate], known: Iterable[str] = ()) -> Table:
    """Tabulate estimates by name, with whether they are ``known``, or what they regroup."""
    columns = (Column("parameter", Kind.NAME), *VALUE, Column("95 % interval", Kind.INTERVAL, wide=True), Column(""))
    rows = [
        (
            name,
            *value_cells(each),
            each.interval(),
            "known" if name in known else "not identifiable" if each.value is None else regroups(each),
        )
        for name, each in estimates.items()
    ]
    return table(columns, rows)
