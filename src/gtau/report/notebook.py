"""Views of results for notebooks."""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path

from gtau.documents.files import write_atomically
from gtau.estimation.check_logs import ExperimentCheck
from gtau.estimation.compare import EstimatorComparison
from gtau.estimation.results.estimate import Named
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.report.check import check_page
from gtau.report.comparison import comparison_page
from gtau.report.evidence import gather, settings_of
from gtau.report.gains import VALUE, gains_section, payloads_section, unknown_payloads, value_cells
from gtau.report.identification import full_page, report_page, summary_page, verdict_section
from gtau.report.page import Column, Kind, Page, Text, page, section, table
from gtau.report.render.html import frame
from gtau.report.render.html import html as rendered
from gtau.report.render.terminal import plain
from gtau.report.torques import torques_chart
from gtau.report.write import stamped
from gtau.uses.prediction import Prediction

SECTIONS = ("verdict", "notes", "logs", "joints")  # sections of a check in a notebook


def html(shown: object) -> str:
    """Write the page of an object as a frame for a notebook."""
    return frame(view(shown))


def text(result: IdentifiedModel, verbose: bool) -> str:
    """Write a result as text, in full or on one screen."""
    return plain(full_page(result) if verbose else summary_page(result))


def write(result: IdentifiedModel, path: Path) -> None:
    """Write the report of a result and its runs to an HTML file."""
    report = report_page(result, gather(result, result.data), {})
    write_atomically(path, rendered(stamped(report, settings_of(result))))


@singledispatch
def view(shown: object) -> Page:
    """Make the page of an object."""
    return page("", section("", Text(repr(shown), style="command")))


@view.register
def _(shown: IdentifiedModel) -> Page:
    return page(
        "", verdict_section(shown), gains_section(shown, charts=False), payloads_section(unknown_payloads(shown))
    )


@view.register
def _(shown: EstimatorComparison) -> Page:
    return Page("", comparison_page(shown).sections[:2])


@view.register
def _(shown: PayloadEstimate) -> Page:
    return page("", payloads_section([shown]))


@view.register
def _(shown: Named) -> Page:
    columns = (Column("name", Kind.NAME), *VALUE, Column("95 % interval", Kind.INTERVAL), Column("verdict", Kind.BADGE))
    rows = [(name, *value_cells(value), value.interval(), value.verdict.outcome.value) for name, value in shown.items()]
    return page("", section("", table(columns, rows)))


@view.register
def _(shown: Prediction) -> Page:
    return page("", section("", torques_chart(shown, ["N m or N"] * len(shown.joints), "", shown.time - shown.time[0])))


@view.register
def _(shown: ExperimentCheck) -> Page:
    return Page("", tuple(part for part in check_page(shown).sections if part.id in SECTIONS))
