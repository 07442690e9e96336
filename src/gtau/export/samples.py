"""Samples of the identified distribution: models as far apart as the data allow, each physically consistent.

Parameters, drive gains and delays are drawn together, with the correlations of the result's covariance and the marginal
distributions of their intervals (Student's t), among rigid bodies only (:mod:`gtau.export.rigid_draws`). Directions
that the data leave open are drawn about the inertias of the robot's file.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.export.consistent import consistent_model
from gtau.export.rigid_draws import target_of
from gtau.robots.parameter import DISSIPATING, SHAPES, Parameter
from gtau.robots.robot import PLAIN_FRICTION

ALLOWED = 1.0  # standard deviations by which a draw may lie outside what was identified


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of an identified model, N of each quantity, SI units.

    ``standard`` (N, n_st) and ``base`` (N, n_b) parameters are in the order of the robot's model, ``gains`` and
    ``delays`` (N, n) in the order of its actuated joints; the model predicts with ``friction`` (N,). ``moved``
    (N,) is the distance by which rigid bodies keep each draw outside the 95 % region of the estimates, in standard
    deviations; ``shifts`` the distance of the mean of the draws from each estimate, in its standard deviations.
    """

    result: IdentifiedModel
    standard: np.ndarray
    base: np.ndarray
    gains: np.ndarray
    delays: np.ndarray
    friction: dict[Parameter, np.ndarray]
    moved: np.ndarray
    shifts: Mapping[Parameter, float]
    seed: int

    def __len__(self) -> int:
        return len(self.standard)

    @property
    def moved_share(self) -> float:
        """Share of the draws that lie outside the identified region by more than ``ALLOWED``."""
        return float(np.mean(self.moved > ALLOWED))

    @property
    def note(self) -> str:
        """Report the number of draws, their masses, and how far rigid bodies keep them from the estimates."""
        names = self.result.idm.parameter_names
        masses = self.standard[:, [name.kind == "m" for name in names]].sum(axis=1)
        low, middle, high = np.quantile(masses, [0.025, 0.5, 0.975])
        worst = max(self.shifts, key=lambda name: self.shifts[name])
        said = (
            f"{len(self)} draws of the identified model (seed {self.seed}), all of rigid bodies: the moving mass is "
            f"{middle:.3g} kg ({low:.3g} to {high:.3g}); the mean of the draws differs from the estimates by at most "
            f"{self.shifts[worst]:.2g} standard deviations ('{worst}')"
        )
        if not self.moved_share:
            return f"{said}, and no draw lies more than {ALLOWED:g} outside their 95 % region"
        return (
            f"{said}; {100 * self.moved_share:.0f} % of the draws lie more than {ALLOWED:g} standard deviation outside "
            f"the 95 % region of the estimates (at most {self.moved.max():.2g}), as rigid bodies near it do not exist: "
            "do not use the draws before the verdicts and the robot file are settled"
        )

    def npz(self) -> bytes:
        """Return the draws as an NPZ file with names."""
        model, file = self.result.idm, io.BytesIO()
        np.savez(
            file,
            joints=np.array(model.actuated),
            standard_names=np.array(model.parameter_names),
            standard=self.standard,
            base_names=np.array(self.result.base.names),
            base=self.base,
            gains=self.gains,
            delays=self.delays,
            friction_names=np.array(list(self.friction), dtype=str),
            friction=np.column_stack(list(self.friction.values())) if self.friction else np.zeros((len(self), 0)),
            moved=self.moved,
            seed=np.array(self.seed),
        )
        return file.getvalue()

    def results(self) -> Iterator[IdentifiedModel]:
        """Convert each draw to a result, the input of every export."""
        return map(self._result, range(len(self)))

    def _result(self, k: int) -> IdentifiedModel:
        result, joints = self.result, self.result.idm.actuated
        assert result.consistency is not None
        gains, delays = (dict(zip(joints, drawn[k].tolist(), strict=True)) for drawn in (self.gains, self.delays))
        base = dict(zip(result.base.names, self.base[k].tolist(), strict=True))
        standard = dict(zip(result.idm.parameter_names, self.standard[k].tolist(), strict=True))
        friction = {name: float(values[k]) for name, values in self.friction.items()}
        exact = {joint: (gain, 0.0) for joint, gain in gains.items()}
        return result.replaced(
            consistency=replace(result.consistency, standard=standard, gains=exact),
            drive_gains=_with(result.drive_gains, gains),
            parameters=_with(result.parameters, base),
            friction=_with(result.friction, friction),
            delays=_with(result.delays, delays),
        )


def _with(estimates: Mapping[Any, Estimate], values: Mapping[Any, float]) -> dict[Any, Estimate]:
    return {name: replace(estimate, value=values.get(name, estimate.value)) for name, estimate in estimates.items()}


def draw(result: IdentifiedModel, count: int, seed: int = 0) -> Draws:
    """Draw ``count`` models from the distribution identified with ``consistent=True``."""
    consistent_model(result, "samples")
    if not 0 < count <= 100_000:
        raise GtauError(f"the number of samples is {count}; ask for 1 to 100000.")
    if not np.diag(result.covariance).any():
        raise GtauError("the model has no standard deviations to draw from; identify it again.")
    base, n = result.base, len(result.idm.parameter_names)
    estimates = _estimates(result)
    target, unit, start = target_of(result, estimates)
    y = target.draws(start, count, seed)
    x = y[:, :n] * unit
    base_values = x @ base.matrix.T
    deviations = target.deviations(y)
    changes = dict(zip(list(estimates)[len(estimates) - y.shape[1] + n :], (y[:, n:]).T, strict=True))
    unchanged = np.zeros(count)

    def by_joint(kind: str, values: Iterable[float | None]) -> np.ndarray:
        joints = zip(result.idm.actuated, values, strict=True)
        return np.column_stack([(v or 0.0) + changes.get(Parameter(kind, joint), unchanged) for joint, v in joints])

    changes |= {
        standard: base_values[:, k] - (result.parameters[name].value or 0.0)
        for k, (name, standard) in enumerate(zip(base.names, base.standard, strict=True))
    }
    friction = {
        name: (estimate.value or 0.0) + changes.get(name, unchanged)
        for name, estimate in result.friction_parameters.items()
    }
    for name, values in friction.items():
        dissipates = name.kind in PLAIN_FRICTION and name.kind in DISSIPATING
        if dissipates and (result.friction_parameters[name].value or 0.0) >= 0:
            friction[name] = np.maximum(values, 0.0)
    shifts = dict(zip(estimates, map(float, np.abs(deviations.mean(axis=0))), strict=True))
    gains = by_joint("gain", result.gains)
    delays = by_joint("delay", (delay.value for delay in result.delays.values()))
    return Draws(result, x, base_values, gains, delays, friction, target.outside(deviations), shifts, seed)


def _estimates(result: IdentifiedModel) -> dict[Parameter, Estimate]:
    """Collect the estimates that are drawn, by their names in the covariance; base parameters come first."""
    deviations = dict(zip(result.covariance_names, np.diag(result.covariance), strict=True))
    more = {Parameter("gain", joint): estimate for joint, estimate in result.drive_gains.items()}
    more |= {Parameter("delay", joint): estimate for joint, estimate in result.delays.items()}
    more |= {name: estimate for name, estimate in result.friction.items() if name.kind not in SHAPES}
    base = {name: estimate for name, estimate in result.parameters.items() if estimate.value is not None}
    return base | {name: estimate for name, estimate in more.items() if deviations.get(name) and name not in base}
