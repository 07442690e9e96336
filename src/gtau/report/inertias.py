"""Compare the inertias in the robot file with the data, as a section of a page."""

from __future__ import annotations

from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
from gtau.report.page import Column, Kind, Section, Table, Text, section, table

SHOWN = 6  # contradicted parameters on a short page
ORDER = ("contradicted", "agrees", "not stated", "not identifiable")


def inertias_section(audit: InertiaAudit | None, short: bool = False) -> Section | None:
    """Show how well the file's inertias predict, what contradicts them, and what is not identifiable."""
    if audit is None:
        return None
    wrong = audit.of("contradicted")
    return section(
        "Inertias of the robot file",
        Text(_headline(audit), tuple(_points(audit, short))),
        _table(audit, short) if wrong or not short else None,
        id="inertias",
    )


def _headline(audit: InertiaAudit) -> str:
    said = (
        f"The file's inertias predict the torques to within {audit.stated_error:.2g} %, the identified ones "
        f"to within {audit.identified_error:.2g} % (rms over the joints; friction and gains as identified)."
    )
    if audit.prior:
        said += (
            f" They are priors with a standard deviation of {100 * audit.prior:.3g} %, and the intervals include them; "
            "the comparison below uses the data without them."
        )
    return said


def _points(audit: InertiaAudit, short: bool) -> list[str]:
    wrong, tested = audit.of("contradicted"), len(audit.of("contradicted")) + len(audit.of("agrees"))
    said = []
    if not wrong:
        said.append(f"the data contradict none of the {tested} base parameters that they determine")
    elif audit.links:
        said.append(f"the data contradict {len(wrong)} of the {tested} base parameters that they determine")
        steps = [f"{each.name} ({each.error:.2g} %)" for each in audit.links]
        said.append(f"correct in the file, in this order (torque error after each step): {', '.join(steps)}")
    if open_ := audit.of("not stated"):
        said.append(f"{len(open_)} include a rotor inertia (armature) that the file does not state")
    if unknown := audit.of("not identifiable"):
        several = len(unknown) > 1
        said.append(
            f"{len(unknown)} base parameter{'s are' if several else ' is'} not identifiable from these motions to "
            "better than +-100 % of the link"
            + (
                f"; --verbose lists {'them' if several else 'it'}"
                if short
                else f": {', '.join(each.name for each in unknown)}"
            )
        )
    return said


def _table(audit: InertiaAudit, short: bool) -> Table:
    ranked = sorted(audit.parameters, key=lambda each: (ORDER.index(each.standing), -abs(each.z or 0.0)))
    shown = [each for each in ranked if each.standing == "contradicted"][:SHOWN] if short else ranked
    columns = (
        Column("base parameter", Kind.NAME),
        Column("link"),
        Column("in the file", Kind.NUMBER, 4),
        Column("95 % interval", Kind.INTERVAL),
        Column("unit"),
        Column("z", Kind.NUMBER, decimals=1),
        Column("data", Kind.BADGE),
    )
    rows = [(each.name, each.link, each.stated, each.interval, each.unit, each.z, each.standing) for each in shown]
    return table(columns, rows)
