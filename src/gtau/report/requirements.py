"""Show the requirements of the experiment file on a result."""

from __future__ import annotations

from gtau.estimation.results.estimate import Requirement
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.report.page import Column, Kind, Section, section, table


def requirements_section(result: IdentifiedModel) -> Section | None:
    """Tabulate each requirement, the value found, and pass or fail; None without requirements."""
    if not result.requirements:
        return None
    rows = [
        (*_what(each), "passed" if each.met else "failed", each.limit, each.found, each.joint or None)
        for each in result.requirements
    ]
    columns = (
        Column("required"),
        Column("of"),
        Column("outcome", Kind.BADGE),
        Column("limit, %", Kind.NUMBER),
        Column("found, %", Kind.NUMBER, decimals=2),
        Column("worst joint"),
    )
    return section("Requirements", table(columns, rows), id="requirements")


def missed(result: IdentifiedModel) -> list[str]:
    """Describe each requirement that is not met."""
    said = []
    for each in result.requirements:
        if not each.met:
            found = "not known" if each.found is None else f"{each.found:.2f} % (joint '{each.joint}')"
            said.append(f"{' of '.join(_what(each))}: {found}, and {each.limit:g} % is required")
    return said


def _what(each: Requirement) -> tuple[str, str]:
    if each.name == "gain_interval":
        return "half the 95 % interval", "gains"
    return ("torque error", f"run '{each.run}'") if each.run else ("torque residual", "rows used")
