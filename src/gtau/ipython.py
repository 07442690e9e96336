"""Pages of what is shown in a notebook: IPython calls the report, which what is shown does not import."""

from __future__ import annotations

from typing import Any

SHOWN = {
    "Named": "gtau.estimation.results.estimate",
    "PayloadEstimate": "gtau.estimation.results.payload_body",
    "Prediction": "gtau.uses.prediction",
    "EstimatorComparison": "gtau.estimation.identify",
    "CheckedExperiment": "gtau.estimation.check_logs",
}
"""Classes that have a page in :mod:`gtau.report.plots`, with their modules."""


def register(shell: Any) -> None:
    """Let an IPython shell show these classes as pages."""
    formatter = shell.display_formatter.formatters["text/html"]
    for name, module in SHOWN.items():
        formatter.for_type_by_name(module, name, html)


def html(shown: object) -> str:
    """Write the page of an object as HTML."""
    from gtau.report import plots

    return plots.html(shown)
