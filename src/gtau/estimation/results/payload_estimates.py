"""Estimates of the payloads of all loaded runs, known and unknown parameters together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.parameter_checks import parameter_verdict
from gtau.estimation.diagnostics.verdict import GOOD, Verdict
from gtau.estimation.regression.column_blocks import CarriedPayload, known_values
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.estimation.results.estimate import (
    Estimate,
)
from gtau.estimation.results.payload_body import Weighed
from gtau.estimation.results.payload_estimate import PayloadEstimate
from gtau.robots.geometry import longest_placement
from gtau.robots.robot import INERTIAL
from gtau.robots.units import unit_of
from gtau.signals.payload import FIRST_MOMENTS, PAYLOAD_KINDS


def payload_estimates(
    dataset: Dataset,
    system: System,
    theta: np.ndarray,
    covariance: np.ndarray,
    masses: Mapping[str, Verdict],
    freedom: np.ndarray | None,
) -> tuple[PayloadEstimate, ...]:
    """Collect the payload of every loaded run, known and unknown parameters together.

    ``theta`` are the problem's parameters, the first that ``covariance`` is of; ``masses`` are verdicts on
    known payloads, by name; ``freedom`` the degrees of freedom behind each.
    """
    robot = dataset.robot
    found = named_values(system.problem, theta, np.sqrt(np.diag(covariance)))
    free = named_freedoms(system.problem, freedom)
    payloads = []
    for each in system.payloads:
        known = known_values(each.payload)
        label = {kind: name for name, kind in each.unknown.items()}
        estimates = {}
        for kind in PAYLOAD_KINDS:
            unit = unit_of(kind, robot, robot.tool)
            if kind in known:
                deviation = each.payload.mass_std or None if kind == "m" else None
                estimates[kind] = Estimate(kind, known[kind], deviation, unit, kind)
            elif kind in each.regroupings:
                value, deviation = found.get(label[kind], (None, None))
                verdict = parameter_verdict(value, deviation)
                estimates[kind] = Estimate(
                    kind, value, deviation, unit, each.regroupings[kind], verdict=verdict, freedom=free.get(label[kind])
                )
        if "m" in estimates and each.payload.center is not None:
            unit = unit_of("mx", robot, robot.tool)
            moments = zip(FIRST_MOMENTS, each.payload.center, strict=True)
            estimates |= {kind: _of_mass(kind, estimates["m"], at, unit) for kind, at in moments}
        name, run = each.payload.name, dataset.runs[each.run].name
        weighed = None if "m" in known else _weighed(dataset, system.problem, each, theta, covariance, free)
        payloads.append(PayloadEstimate(name, run, estimates, frozenset(known), masses.get(name, GOOD), weighed))
    return tuple(payloads)


def _weighed(
    dataset: Dataset,
    problem: Problem,
    carried: CarriedPayload,
    theta: np.ndarray,
    covariance: np.ndarray,
    freedoms: Mapping[str, float],
) -> Weighed:
    """Collect the identified sums of parameters, and the stated values of the others."""
    found = [k for k, name in enumerate(carried.unknown) if name in problem.parameters]
    places = [problem.parameters.index(list(carried.unknown)[k]) for k in found]
    sums = np.zeros((len(found), len(INERTIAL)))
    sums[:, [INERTIAL.index(kind) for kind in carried.free]] = carried.sums[found]
    unit = dict(zip(INERTIAL, np.eye(len(INERTIAL)), strict=True))
    stated = [(unit[kind], value) for kind, value in known_values(carried.payload).items()]
    center = zip(FIRST_MOMENTS, carried.payload.center or (), strict=False)
    stated += [(unit[kind] - at * unit["m"], 0.0) for kind, at in center]
    return Weighed(
        dataset.robot.tool,
        sums,
        theta[places],
        covariance[np.ix_(places, places)],
        np.reshape([row for row, _ in stated], (len(stated), len(INERTIAL))),
        np.array([value for _, value in stated]),
        min((freedoms[name] for name in carried.unknown if name in freedoms), default=None),
        longest_placement(dataset.robot),
    )


def _of_mass(kind: str, mass: Estimate, at: float, unit: str) -> Estimate:
    """Derive a first moment from a mass whose centre is known."""
    value, std = (None if each is None else size * each for each, size in ((mass.value, at), (mass.std, abs(at))))
    return replace(mass, name=kind, value=value, std=std, unit=unit, regrouping=f"{at:.5g} m")


def named_values(problem: Problem, theta: np.ndarray, std: np.ndarray) -> dict[str, tuple[float, float]]:
    """Return value and standard deviation of each parameter of a problem, by name."""
    return {name: (float(theta[k]), float(std[k])) for k, name in enumerate(problem.parameters)}


def named_freedoms(problem: Problem, freedom: np.ndarray | None) -> dict[str, float]:
    """Return the degrees of freedom of each parameter of a problem, by name; empty without ``freedom``."""
    return {} if freedom is None else dict(zip(problem.parameters, map(float, freedom), strict=False))
