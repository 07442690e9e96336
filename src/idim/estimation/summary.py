"""A result as a table to read, in the manner of statsmodels."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from idim.estimation.result import Estimate, PayloadEstimate, Result

WIDTH = 88
METHODS = {
    "ml": "maximum likelihood in the current domain",
    "mixed": "mixed LS-TLS (regressor exact, currents noisy)",
    "tls": "total least squares (the paper's)",
    "wls": "weighted least squares with given gains",
    "ols": "ordinary least squares with given gains",
}


def summary(result: Result) -> str:
    """Drive gains, payloads, essential parameters, fit and notes, as text."""
    preparation = result.preparation
    low_pass = "none" if preparation.cutoff is None else f"{preparation.cutoff:.3g} Hz"
    lines = [
        "=" * WIDTH,
        f"Robot     {result.robot.name}",
        f"Method    {METHODS[result.method]}",
        *textwrap.wrap(f"Runs      {', '.join(result.runs)}", WIDTH, subsequent_indent=" " * 10),
        f"Signals   bandwidth {preparation.bandwidth:.3g} Hz, position filter {low_pass}, "
        f"decimation {preparation.decimator.factor} ({preparation.decimator.kind})",
        "=" * WIDTH,
    ]
    lines += [f"{'Drive gains':<24}{'value':>12}{'std':>11}{'std %':>9}   {'unit':<10}{'delay ms':>9}"]
    for joint, gain in result.drive_gains.items():
        delay = result.delays[joint]
        lines.append(f"{_row(joint, gain)}   {gain.unit:<10}{1e3 * (delay.value or 0.0):>9.3f}")
    for payload in result.payloads:
        lines += ["-" * WIDTH, *payload_lines(payload)]
    left_out = len(result.parameters) - len(result.essential)
    lines += [
        "-" * WIDTH,
        f"{'Essential parameters':<24}{'value':>12}{'std':>11}{'std %':>9}   unit      regrouping",
        *(line for each in result.essential.values() for line in _parameter_lines(each)),
        f"  {left_out} of {len(result.parameters)} base parameters are too small to be seen in these runs; model.json has all.",
        "-" * WIDTH,
        f"{'Torque fit':<24}{'error rms':>12}{'signal rms':>11}{'error %':>9}   unit",
    ]
    lines += [
        f"  {each.joint:<22}{each.rms:>12.4g}{each.signal:>11.4g}{each.relative:>9.2f}   {each.unit}" for each in result.residuals
    ]
    if "singular_ratio" in result.statistics:
        lines.append(f"  ratio of the two smallest singular values of W_tot: {result.statistics['singular_ratio']:.2f}")
    lines += ["=" * WIDTH, *_notes(result.notes)]
    return "\n".join(line.rstrip() for line in lines)


def payload_lines(payload: PayloadEstimate) -> list[str]:
    """One payload as lines of a table."""
    head = f"Payload '{payload.name}', {payload.run}"
    lines = [head if len(head) < 24 else f"{head}\n{'':24}"]
    lines[0] = f"{lines[0]:<24}{'value':>12}{'std':>11}{'std %':>9}   unit"
    for kind, each in payload.parameters.items():
        known = "known" if kind in payload.known else each.regrouping if each.regrouping != kind else ""
        lines.append(f"{_row(kind, each)}   {each.unit:<10}{known}")
    return lines


def _row(name: str, estimate: Estimate) -> str:
    value = "cannot tell" if estimate.value is None else f"{estimate.value:.5g}"
    std = "" if estimate.std is None else f"{estimate.std:.2g}"
    relative = "" if estimate.rel_std is None else f"{estimate.rel_std:.2f}"
    return f"  {name:<22}{value:>12}{std:>11}{relative:>9}"


def _parameter_lines(estimate: Estimate) -> list[str]:
    regrouping = estimate.regrouping if estimate.name.endswith("R") else ""
    wrapped = textwrap.wrap(regrouping, 42) or [""]
    first = f"{_row(estimate.name, estimate)}   {estimate.unit:<10}{wrapped[0]}"
    return [first, *(f"{'':69}{more}" for more in wrapped[1:])]


def _notes(notes: Iterable[str]) -> list[str]:
    lines: list[str] = []
    for note in notes:
        lines += textwrap.wrap(f"- {note}", WIDTH, subsequent_indent="  ")
    return lines
