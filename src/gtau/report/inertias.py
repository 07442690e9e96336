"""The inertias of the robot's file held against the data, as a section of a page."""

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
        Text(_headline(audit), tuple(_points(audit))),
        _table(audit, short) if wrong or not short else None,
        id="inertias",
    )


def _headline(audit: InertiaAudit) -> str:
    said = (
        f"The file's inertias predict the torques to {audit.stated_error:.2g} %, the identified ones to "
        f"{audit.identified_error:.2g} % (rms over the joints; friction and gains as identified)."
    )
    if audit.prior:
        said += (
            f" They were taken as priors to {100 * audit.prior:.3g} %, and the intervals include them; what follows is "
            "from the data without them."
        )
    return said


def _points(audit: InertiaAudit) -> list[str]:
    wrong, tested = audit.of("contradicted"), len(audit.of("contradicted")) + len(audit.of("agrees"))
    said = []
    if not wrong:
        said.append(f"the data contradict none of the {tested} base parameters that they determine")
    elif audit.links:
        said.append(f"the data contradict {len(wrong)} of the {tested} base parameters that they determine")
        steps = [f"{each.name} ({each.error:.2g} %)" for each in audit.links]
        said.append(f"what to change in the file, in turn, with the torque error then left: {', '.join(steps)}")
    if open_ := audit.of("not stated"):
        said.append(f"{len(open_)} regroup a rotor inertia (armature) that the file does not state")
    if unknown := audit.of("not identifiable"):
        names = ", ".join(each.name for each in unknown)
        said.append(f"not identifiable from these motions, to less than +-100 % of the link: {names}")
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
