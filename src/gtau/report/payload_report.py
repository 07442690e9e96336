"""The report of a weighing: what unknown payloads weigh, and with which drive gains that was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gtau.estimation.results.estimate import PayloadEstimate
from gtau.estimation.results.result import Result
from gtau.report import provenance
from gtau.report.evidence import Evidence
from gtau.report.gain_sections import gains_section, payloads_section
from gtau.report.html.document import Section
from gtau.report.html.drawings import Interval, interval_rows
from gtau.report.html.elements import escape, paragraph, verdict
from gtau.report.html.series import Arrays
from gtau.report.identification_report import page
from gtau.report.provenance import Provenance
from gtau.report.robot_drawing import robot_drawing


def payload_report(
    result: Result, payloads: Sequence[PayloadEstimate], gains: str, prior_gains: Mapping[str, float], of: Provenance
) -> str:
    """Render the report of a weighing with the ``gains`` (identified or prior) as the text of one HTML file."""
    words = [f"Weighed with the {gains} drive gains."]
    words += [f"payload '{each.name}': {each.verdict.sentence}" for each in payloads if each.verdict.why]
    if gains == "prior":
        words.append("the standard deviations do not contain the uncertainty of the prior gains")
    robot = Section("robot", "Robot", f'<figure class="panel robot">{robot_drawing(result.robot)}</figure>')
    sections = (
        Section("verdict", "Verdict", verdict("plain", headline(payloads), words)),
        _masses(payloads),
        payloads_section(payloads, "Inertial parameters"),
        gains_section(Evidence(result, prior_gains=dict(prior_gains))),
        robot,
        provenance.section(of),
    )
    return page(f"Payloads of {result.robot.name}", [], sections, Arrays())


def headline(payloads: Sequence[PayloadEstimate]) -> str:
    """Summarise the masses in one sentence."""
    parts = []
    for each in payloads:
        mass = each.parameters.get("m")
        if mass is None or mass.value is None:
            parts.append(f"the mass of '{each.name}' is not identifiable")
            continue
        ends = mass.interval()
        between = "" if ends is None else f" (95 % interval {ends[0]:.4g} to {ends[1]:.4g} kg)"
        parts.append(f"‘{each.name}’ weighs {mass.value:.4g} kg{between}")
    words = "; ".join(parts)
    return f"{words[:1].upper()}{words[1:]}."


def _masses(payloads: Sequence[PayloadEstimate]) -> Section | None:
    masses = [(each, each.parameters["m"]) for each in payloads if "m" in each.parameters]
    if not any(mass.value is not None for _, mass in masses):
        return None
    bars, axis = interval_rows([Interval(mass.value, mass.interval()) for _, mass in masses])
    rows = "".join(
        f'<tr><td class="name">{escape(each.name)}<br><span class="soft">{escape(each.run)}</span></td>'
        f'<td class="bar">{bar}</td></tr>'
        for (each, _), bar in zip(masses, bars, strict=True)
    )
    chart = (
        f'<div class="scroll"><table class="intervals"><tbody>{rows}<tr><td class="soft">mass, kg</td>'
        f'<td class="bar">{axis}</td></tr></tbody></table></div>'
    )
    return Section("masses", "Masses", chart + paragraph("Discs are the masses, lines their 95 % intervals.", "soft"))
