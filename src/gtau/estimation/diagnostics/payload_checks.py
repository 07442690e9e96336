"""Whether the data agree with the known values of the payloads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.parameter_checks import known_verdict
from gtau.estimation.diagnostics.verdict import GOOD, Verdict
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.column_blocks import known_values
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.scale_source import require_scale
from gtau.estimation.thresholds.estimates import PAYLOAD_MOVES
from gtau.robots.units import unit_of
from gtau.signals.payload import Payload


@dataclass(frozen=True)
class Freed:
    """A payload's value estimated from all else, its standard deviation, the residual and the gains' move."""

    value: float
    std: float
    left: float
    moves: float


def weigh_known(fit: Fit, method: str) -> dict[str, Verdict]:
    """Estimate what is known of each payload, one value at a time, with gains from all else that is known.

    Of several values of a payload that the data contradict, the one is named that leaves least when it alone is freed.
    A single payload's mass is not among them where it sets the scale alone.

    Returns
    -------
    dict
        Verdicts by name, of payloads with a value that the others can be tested against.
    """
    dataset = fit.dataset
    known = {run.payload.name: run.payload for run in dataset.runs if run.payload and run.payload.mass is not None}
    verdicts = {}
    for name, payload in known.items():
        tested = (*(("m",) if len(known) > 1 or fit.system.problem.scaled else ()), *payload.parameters)
        freed = {kind: _freed(fit, method, payload, kind) for kind in tested}
        found_of_kind = {kind: found for kind, found in freed.items() if found is not None}
        if not found_of_kind:
            continue
        kind = min(found_of_kind, key=lambda kind: found_of_kind[kind].left)
        found, unit = found_of_kind[kind], unit_of(kind, dataset.robot, dataset.robot.tool)
        small = kind != "m" and found.moves < PAYLOAD_MOVES
        declared = known_values(payload)[kind]
        verdicts[name] = GOOD if small else known_verdict(kind, declared, found.value, found.std, unit)
    return verdicts


def _freed(fit: Fit, method: str, payload: Payload, kind: str) -> Freed | None:
    """Estimate a payload's parameter from all else; None where it is not identifiable."""
    dataset, system = fit.dataset, fit.system
    values = {other: value for other, value in payload.parameters.items() if other != kind}
    mass = None if kind == "m" else payload.mass
    payloads = _with_payload(dataset, payload.name, payload.model_copy(update={"mass": mass, "parameters": values}))
    other = dataset.system(system.friction, system.problem.slowest > 0, payloads)
    try:
        require_scale(dataset.robot, other, payloads, method)
        free = fit.solve(other.problem)
    except GtauError:
        return None  # without this value nothing gives the scale
    std = np.sqrt(np.diag(free.jackknife))
    columns = [
        other.problem.parameters.index(label)
        for each in other.payloads
        if each.payload.name == payload.name
        for (label, of), sums in zip(each.unknown.items(), each.sums, strict=True)
        if of == kind and np.count_nonzero(sums) == 1 and label in other.problem.parameters
    ]
    if not columns or not set(other.unexcited) <= set(system.unexcited):
        return None  # or it cannot be separated from what is not declared
    best = min(columns, key=lambda k: float(std[k]))
    value = float(free.theta[best])
    of_mass = payload.mass_std if mass is None else value * payload.mass_std / mass
    left = float(other.problem.total_rows @ np.log(free.sigma))
    moves = float(np.abs(free.gains / fit.solution.gains - 1).max())
    return Freed(value, float(np.hypot(std[best], of_mass)), left, moves)


def _with_payload(dataset: Dataset, name: str, other: Payload) -> Sequence[Payload | None]:
    """Replace the payload called ``name`` by ``other`` in the runs."""
    return [other if run.payload and run.payload.name == name else run.payload for run in dataset.runs]
