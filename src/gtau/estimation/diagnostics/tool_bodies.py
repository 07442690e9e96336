"""Test whether a run carries another body at the tool than declared: a payload not declared, absent, or another one.

A body at the tool adds its ten inertial columns in its run (eq. 18), so the data are fitted again with the load of one
run unknown, then of a second one, as long as that explains much more. An unknown load explains part of any fault that
is in one run alone; only a mass far from the declared one is a body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.alternatives import Alternative, established
from gtau.estimation.estimators.estimator import Fit, Solution
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.regression.scale_source import require_scale
from gtau.estimation.regression.system import System
from gtau.estimation.thresholds.estimates import LOAD_ALIKE, LOAD_LEFT, MASS_ABSENT, REFUTED_STD
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.signals.payload import Payload

TOOL_BODIES = "tool bodies"


@dataclass(frozen=True, eq=False)
class _Loaded:
    """The data fitted with the loads of ``runs`` unknown, which leaves a part ``left`` of the residual variance.

    ``masses`` (runs,) are those beyond what is declared, kg.
    """

    runs: tuple[int, ...]
    system: System
    solution: Solution
    left: float
    masses: np.ndarray

    @property
    def places(self) -> list[int]:
        """Numbers of the masses among the parameters."""
        return [self.system.problem.parameters.index(f"m_L{run + 1}") for run in self.runs]

    @property
    def std(self) -> np.ndarray:
        """Standard deviations of the masses by the jackknife."""
        return np.asarray(np.sqrt(np.diag(self.solution.jackknife)[self.places]))


def other_loads(fit: Fit) -> Alternative | None:
    """Find the runs whose bodies at the tool are other than declared, with their masses; None without any."""
    best: _Loaded | None = None
    count = len(fit.dataset.runs)
    while best is None or len(best.runs) < count - 1:
        taken = () if best is None else best.runs
        tried = [_loaded(fit, (*taken, run)) for run in range(count) if run not in taken]
        found = [each for each in tried if each is not None]
        least = min((each.left for each in found), default=1.0)
        if least > LOAD_LEFT * (1.0 if best is None else best.left):
            break
        # a body in some runs is one that the others lack: more is forgotten than taken away
        best = max((each for each in found if each.left < LOAD_ALIKE * least), key=lambda each: each.masses[-1])
    if best is None:
        return None
    declared = [_mass(fit, run) for run in best.runs]
    if np.any(np.abs(best.masses) < np.maximum(REFUTED_STD * best.std, MASS_ABSENT * np.array(declared))):
        return None
    return _alternative(fit, best)


def _loaded(fit: Fit, runs: tuple[int, ...]) -> _Loaded | None:
    """Fit with unknown loads in ``runs``; None where a mass is then not identifiable."""
    dataset, system = fit.dataset, fit.system
    declared = [run.payload for run in dataset.runs]
    loads = [Payload(name=f"of run {k}") if k in runs else each for k, each in enumerate(declared)]
    other = dataset.system(system.friction, system.problem.slowest > 0, loads)
    masses = {f"m_L{run + 1}" for run in runs}
    if not masses <= set(other.problem.parameters) or not set(other.unexcited) <= set(system.unexcited):
        return None
    try:
        if fit.free_gains:
            require_scale(dataset.robot, other, loads, "ml")
        solution = fit.solve(other.problem)
    except GtauError:
        return None
    rows = system.problem.total_rows
    left = float(np.exp(2 * rows @ np.log(solution.sigma / fit.unrefined.sigma) / rows.sum()))
    found = _Loaded(runs, other, solution, left, np.zeros(len(runs)))
    return replace(found, masses=solution.theta[found.places] - [_mass(fit, run) for run in runs])


def _mass(fit: Fit, run: int) -> float:
    """Return the declared mass of a run's payload, kg; 0 without one."""
    payload = fit.dataset.runs[run].payload
    return 0.0 if payload is None else payload.mass or 0.0


def _alternative(fit: Fit, found: _Loaded) -> Alternative:
    from scipy.special import stdtrit

    problem, runs = fit.system.problem, fit.dataset.runs
    freedom = degrees_of_freedom(found.system.problem, found.solution, fit.free_gains)[found.places]
    halves = found.std * stdtrit(freedom, 0.975)
    ratio = found.solution.sigma / fit.unrefined.sigma
    bodies = [
        {
            "run": runs[run].name,
            "more": float(more),
            "half": float(half),
            "declared": "" if (load := runs[run].payload) is None or load.mass is None else load.name,
        }
        for run, more, half in zip(found.runs, found.masses, halves, strict=True)
    ]
    n, rows = len(fit.gains), problem.total_rows
    joints = tuple(joint for joint, each in zip(problem.joints, ratio, strict=False) if each**2 < LOAD_LEFT)
    cause = Finding(F.TOOL_BODY, joints, values={"bodies": bodies, "remains": found.left})
    moves = found.solution.gains[:n] / fit.gains - 1 if fit.free_gains else np.zeros(n)
    return established(fit, TOOL_BODIES, cause, moves, 1 - float(rows @ ratio**2 / rows.sum()))
