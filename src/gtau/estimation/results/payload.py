"""Payloads: estimates of their parameters, and the rigid body behind them in a frame, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gtau import display
from gtau.documents.validation import PATH, takes
from gtau.estimation.diagnostics.verdict import GOOD, Verdict, parameter_verdict, verdict_of
from gtau.estimation.regression.column_blocks import PayloadColumns, known_values
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.unknowns import Estimates
from gtau.estimation.results.estimate import Estimate
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.robots.geometry import longest_placement
from gtau.robots.parameter import Parameter, RigidBody, unit_of
from gtau.robots.robot import INERTIAL, Pose, Robot
from gtau.signals.reading.statements import FIRST_MOMENTS, PAYLOAD_KINDS


@dataclass(frozen=True, eq=False)
class Weighed:
    """Result of a weighing for the parameters chi (10,), in the order of INERTIAL, at the frame of ``body``.

    ``sums @ chi`` (k, 10) are ``values`` with ``covariance``, ``exact @ chi`` (r, 10) are ``stated`` by the user.
    ``freedom`` are the degrees of freedom behind the covariance, None for very many; ``reach`` is the longest placement
    of the robot, m.
    """

    body: str
    sums: np.ndarray
    values: np.ndarray
    covariance: np.ndarray
    exact: np.ndarray
    stated: np.ndarray
    freedom: float | None
    reach: float


@dataclass(frozen=True, eq=False)
class PayloadBody:
    """Mass, centre of mass and inertia about it of a payload, in axes of ``frame``.

    ``parameters`` are the ``QUANTITIES`` by name, without a value where the motion does not show them; products of
    inertia are entries of the tensor (``Ixy = -int x y dm``). ``rigid`` is a body that can exist: where the motion
    shows nothing, what a compact one would have; None where the mass is not identifiable. ``named`` says whether the
    frame was chosen; else it is that of the carrier.
    """

    name: str
    run: str
    frame: str
    parameters: Mapping[str, Estimate]
    rigid: RigidBody | None
    named: bool = True

    @property
    def unseen(self) -> tuple[str, ...]:
        """Names of the quantities that are not identifiable from the motion."""
        return tuple(name for name, each in self.parameters.items() if each.value is None)


@dataclass(frozen=True, repr=False)
class PayloadEstimate:
    """Inertial parameters of the payload of a run, by kind, in the frame of the body that carries it.

    ``weighed`` is what :meth:`in_frame` needs, None where the mass is known or the estimate was read from a file.
    """

    name: str
    run: str
    parameters: Mapping[str, Estimate]
    known: frozenset[str]
    verdict: Verdict = GOOD
    weighed: Weighed | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        return (
            f"PayloadEstimate({self.name!r} of run {self.run!r}: mass {self.parameters.get('m', 'not identifiable')})"
        )

    def _repr_html_(self) -> str:
        html: str = display.views().html(self)
        return html

    @takes(frame=("the name of a link, 'x y z roll pitch yaw', or a pose", (str, Pose)), file=PATH)
    def in_frame(self, frame: str | Pose = "", file: str | Path | None = None) -> PayloadBody:
        """Compute mass, centre of mass and inertia about it, of a physically possible body, with intervals.

        Parameters
        ----------
        frame : str or Pose
            A link of the URDF ``file`` that is fixed to the carrier (``tool0``), or the pose ``"x y z roll pitch yaw"``
            (m, rad) from the carrier's own frame, which it is by default.
        file : path, optional
            The robot's URDF.

        Raises
        ------
        GtauError
            Where there is no such frame, or the payload was not weighed.
        """
        body: PayloadBody = display.late("uses.payload_body").payload_body(self, frame, file)
        return body


def payload_estimates(system: System, vector: Estimates, masses: Mapping[str, Verdict]) -> tuple[PayloadEstimate, ...]:
    """Collect the payload of every loaded run, known and unknown parameters together.

    ``vector`` are the estimates by the equations, ``masses`` verdicts on known payloads, by name.
    """
    dataset, payloads = system.dataset, []
    for carried in system.payloads:
        known, name = known_values(carried.payload), carried.payload.name
        sums = _sums(carried, vector, dataset.robot)
        estimates = {kind: sums[kind] for kind in PAYLOAD_KINDS if kind in sums}
        if "m" in estimates and carried.payload.center is not None:
            unit = unit_of("mx", dataset.robot, dataset.robot.tool)
            moments = zip(FIRST_MOMENTS, carried.payload.center, strict=True)
            estimates |= {kind: _of_mass(kind, estimates["m"], at, unit) for kind, at in moments}
        weighed = None if "m" in known else _weighed(dataset.robot, carried, vector)
        verdict = masses.get(name) or _possible(estimates.get("m"))
        run = dataset.runs[carried.run].name
        payloads.append(PayloadEstimate(name, run, estimates, frozenset(known), verdict, weighed))
    return tuple(payloads)


def _sums(carried: PayloadColumns, vector: Estimates, robot: Robot) -> dict[str, Estimate]:
    """Collect the parameters of a payload by kind: what is stated, and the identified sums."""
    estimates = {}
    for kind, known in known_values(carried.payload).items():
        stated = carried.payload.mass_std or None if kind == "m" else None
        estimates[kind] = Estimate(kind, known, stated, unit_of(kind, robot, robot.tool), kind)
    for name in carried.unknown:
        if (kind := name.kind) not in estimates:
            value, std, freedom = _estimated(vector, name)
            verdict, unit = parameter_verdict(value, std), unit_of(kind, robot, robot.tool)
            estimates[kind] = Estimate(
                kind, value, std, unit, carried.regrouping(name), verdict=verdict, freedom=freedom
            )
    return estimates


def _estimated(vector: Estimates, name: Parameter) -> tuple[float | None, float | None, float | None]:
    """Return value, standard deviation and degrees of freedom of a sum, None where it is not identifiable."""
    if name not in vector.unknowns.places:
        return None, None, None
    k = vector.unknowns.places[name]
    freedom = None if vector.effective_freedom is None else float(vector.effective_freedom[k])
    return float(vector.values[k]), float(np.sqrt(vector.covariance[k, k])), freedom


def _possible(mass: Estimate | None) -> Verdict:
    """Judge a mass that was estimated: contradictory where its 95 % interval lies below zero."""
    ends = None if mass is None else mass.interval()
    if mass is None or mass.value is None or ends is None or ends[1] >= 0:
        return GOOD
    return verdict_of(Finding(F.NEGATIVE_PAYLOAD, values={"mass": mass.value, "std": mass.std}))


def _weighed(robot: Robot, carried: PayloadColumns, vector: Estimates) -> Weighed:
    """Collect the identified sums of parameters, and the stated values of the others."""
    seen = [name for name in carried.unknown if name in vector.unknowns.places]
    sums = np.zeros((len(seen), len(INERTIAL)))
    rows = [carried.unknown.index(name) for name in seen]
    sums[:, [INERTIAL.index(kind) for kind in carried.summed]] = carried.sums[rows]
    estimates = vector.select(seen)
    unit = dict(zip(INERTIAL, np.eye(len(INERTIAL)), strict=True))
    stated = [(unit[kind], value) for kind, value in known_values(carried.payload).items()]
    center = zip(FIRST_MOMENTS, carried.payload.center or (), strict=False)
    stated += [(unit[kind] - at * unit["m"], 0.0) for kind, at in center]
    return Weighed(
        robot.tool,
        sums,
        estimates.values,
        estimates.covariance,
        np.reshape([row for row, _ in stated], (len(stated), len(INERTIAL))),
        np.array([value for _, value in stated]),
        None if estimates.effective_freedom is None or not seen else float(estimates.effective_freedom.min()),
        longest_placement(robot),
    )


def _of_mass(kind: str, mass: Estimate, at: float, unit: str) -> Estimate:
    """Derive a first moment from a mass whose centre is known."""
    value, std = None if mass.value is None else at * mass.value, None if mass.std is None else abs(at) * mass.std
    return replace(mass, name=kind, value=value, std=std, unit=unit, regrouping=f"{at:.5g} m")
