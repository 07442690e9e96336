"""Payload estimates, and the rigid body that was weighed in the frame that a controller needs.

A weighing finds sums of the ten inertial parameters ``chi`` at the frame of the body that carries the payload. The body
is the one whose sums are nearest to these, in units of their covariance, among bodies with a positive definite
pseudo-inertia. Its intervals follow from the sums by the derivatives of each quantity (delta method), so that the
centre ``mx/m`` has the correlation of mass and first moments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from gtau.documents.validation import PATH, takes
from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import GOOD
from gtau.estimation.estimators.physical_consistency import Body, constrained_least_squares, unbounded
from gtau.estimation.results.estimate import Estimate
from gtau.findings import Finding
from gtau.robots.parameter import RigidBody, inertial_parameters
from gtau.robots.readers.read import frame_on
from gtau.robots.robot import INERTIAL, Pose

QUANTITIES = ("m", "cx", "cy", "cz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
UNITS = ("kg", *("m",) * 3, *("kg m2",) * 6)
LOOSE = 10.0  # natural sizes: standard deviation of what is supposed where the data say nothing
COMPACT = 2700.0  # kg/m3, aluminium: such a ball is supposed where the data say nothing of the inertia
EXACT = 1e-6  # natural sizes: standard deviation of what is stated
NARROW = 1 / 3  # half an interval over the mean moment of inertia, from which the inertia is not shown
STEP = 1e-20  # of complex derivatives
IN_SUMS = 1e-6  # of a derivative: a smaller rest is rounding
SEEN = 2.0  # standard deviations of a mass above zero
NOT_RIGID = 6.0  # standard deviations from the nearest rigid body: at most 2.0 in twelve simulated weighings


@dataclass(frozen=True, eq=False)
class Weighed:
    """Result of a weighing for the parameters chi (10,), in the order of INERTIAL, at the frame of ``body``.

    ``sums @ chi`` (k, 10) are ``values`` with ``covariance``, ``exact @ chi`` (r, 10) are ``stated`` by the user.
    ``freedom`` are the degrees of freedom behind the covariance, None for very many; ``reach`` is the longest placement
    of the robot, m; ``by_model`` says that no other load was logged, so that the model's parameters are the reference.
    """

    body: str
    sums: np.ndarray
    values: np.ndarray
    covariance: np.ndarray
    exact: np.ndarray
    stated: np.ndarray
    freedom: float | None
    reach: float
    by_model: bool = False


@dataclass(frozen=True, eq=False, repr=False)
class PayloadBody:
    """Mass, centre of mass and inertia about it of a payload, in axes of ``frame``.

    ``parameters`` are the ``QUANTITIES`` by name, without a value where the motion does not show them; products of
    inertia are entries of the tensor (``Ixy = -int x y dm``). ``rigid`` is a body that can exist: where the motion
    shows nothing, what a compact one would have; None where the mass is not identifiable. ``named`` says whether the
    frame was chosen; else it is the carrier's. What was weighed is ``apart`` standard deviations from that body.
    """

    name: str
    run: str
    frame: str
    parameters: Mapping[str, Estimate]
    rigid: RigidBody | None
    named: bool = True
    apart: float = 0.0

    def __repr__(self) -> str:
        found = ", ".join(f"{name} {estimate}" for name, estimate in self.parameters.items())
        return f"PayloadBody({self.name!r} in {self.frame}: {found})"

    @property
    def doubt(self) -> str:
        """What to say where no rigid body has what was weighed, else empty."""
        if self.apart < NOT_RIGID:
            return ""
        far = f"no rigid body has what was weighed: the nearest is {self.apart:.2g} standard deviations off"
        return f"{far}; check the robot's geometry, and the body that carries the payload"

    @property
    def unseen(self) -> tuple[str, ...]:
        """Names of the quantities that are not identifiable from the motion."""
        return tuple(name for name, estimate in self.parameters.items() if estimate.value is None)


@dataclass(frozen=True, repr=False)
class PayloadEstimate:
    """Inertial parameters of the payload of a run, by kind, in the frame of the body that carries it.

    ``weighed`` is what :meth:`in_frame` needs, None where the mass is known or the estimate was read from a file.
    """

    name: str
    run: str
    parameters: Mapping[str, Estimate]
    known: frozenset[str]
    verdict: Finding = GOOD
    weighed: Weighed | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        return (
            f"PayloadEstimate({self.name!r} of run {self.run!r}: mass {self.parameters.get('m', 'not identifiable')})"
        )

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
        if (weighed := self.weighed) is None:
            raise GtauError(f"payload '{self.name}' was not weighed here; take it from gtau.weigh.")
        called, placement = frame_on(weighed.body, frame, file)
        body = partial(PayloadBody, self.name, self.run, called, named=bool(frame))
        R, p = placement.rotation, placement.position
        (seen,), (mass,), (std_of_mass,) = _seen(weighed, np.eye(10)[9:])
        if not seen or mass < SEEN * std_of_mass:
            return body(
                {key: Estimate(key, None, None, unit) for key, unit in zip(QUANTITIES, UNITS, strict=True)}, None
            )
        chi, apart = _consistent(weighed, float(mass))
        values = quantities(chi, R, p)
        J = np.stack([quantities(chi + 1j * STEP * unit, R, p).imag / STEP for unit in np.eye(10)], axis=1)
        seen_of, _, stds = _seen(weighed, J)
        xx, yy, zz, xy, xz, yz = values[4:]
        rigid = RigidBody(float(values[0]), values[1:4], np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        moment = max(compact_moment(values[0]), NARROW * np.trace(rigid.inertia) / 3)
        widest = np.repeat([np.inf, weighed.reach, moment], [1, 3, 6])  # wider intervals say nothing
        estimates = {}
        for k, (key, unit) in enumerate(zip(QUANTITIES, UNITS, strict=True)):
            std = float(stds[k]) or None
            estimate = Estimate(key, float(values[k]), std, unit, freedom=weighed.freedom)
            shown = seen_of[k] and (estimate.half_interval() or 0.0) <= widest[k]
            estimates[key] = estimate if shown else replace(estimate, value=None, std=None)
        if (weight := self.parameters.get("m")) is not None:  # which the sum itself gives, with its own freedom
            estimates["m"] = replace(estimates["m"], freedom=weight.freedom)
        return body(estimates, rigid, apart=apart)


def quantities(chi: np.ndarray, rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Compute the QUANTITIES (10,) in a frame from parameters (10,), real or complex, at another frame's origin."""
    m = chi[9]
    center = chi[6:9] / m
    tensor = np.zeros((3, 3), chi.dtype)
    tensor[np.triu_indices(3)] = chi[:6]
    tensor = tensor + np.triu(tensor, 1).T - m * ((center @ center) * np.eye(3) - np.outer(center, center))
    entries = (rotation.T @ tensor @ rotation)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return np.concatenate([[m], rotation.T @ (center - position), entries])


def compact_moment(mass: float) -> float:
    """Compute the moment of inertia, kg m2, of a solid ball of aluminium of a mass, kg."""
    return float(0.4 * mass * (3 * mass / (4 * np.pi * COMPACT)) ** (2 / 3))


def _seen(weighed: Weighed, J: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute for functions J (q, 10) of chi whether the sums show them, their values and standard deviations."""
    unit = np.array([weighed.reach**2] * 6 + [weighed.reach] * 3 + [1.0])
    rows = np.concatenate([weighed.sums, weighed.exact]) * unit
    k = len(weighed.sums)
    sizes = np.linalg.norm(rows, axis=1)
    W = np.linalg.lstsq((rows / sizes[:, None]).T, (J * unit).T, rcond=1e-12)[0].T / sizes
    rest = np.linalg.norm(J * unit - W @ rows, axis=1)
    variances = np.einsum("qi,ij,qj->q", W[:, :k], weighed.covariance, W[:, :k])
    shown = rest <= IN_SUMS * np.linalg.norm(J * unit, axis=1)
    return shown, W @ np.concatenate([weighed.values, weighed.stated]), np.sqrt(np.maximum(variances, 0.0))


def _consistent(weighed: Weighed, mass: float) -> tuple[np.ndarray, float]:
    """Find the consistent parameters (10,) of this mass nearest to the sums, compact where unseen, and how near."""
    shown, moments, _ = _seen(weighed, np.eye(10)[6:9])
    center = np.where(shown, moments, 0.0) / mass
    ball = RigidBody(mass, center, compact_moment(mass) * np.eye(3))
    supposed = np.array([inertial_parameters(ball)[kind] for kind in INERTIAL])
    length = float(np.hypot(np.linalg.norm(center), np.sqrt(compact_moment(mass) / mass)))
    unit = mass * np.array([length**2] * 6 + [length] * 3 + [1.0])
    stds = np.maximum(np.sqrt(np.diag(weighed.covariance)), 1e-12)
    spread, axes = np.linalg.eigh(weighed.covariance / np.outer(stds, stds))
    whiten = (axes / np.sqrt(np.maximum(spread, 1e-9))).T / stds
    tight = 1 / (EXACT * (np.abs(weighed.exact) @ unit))
    known, stated = weighed.exact * tight[:, None], weighed.stated * tight
    mass_row = np.eye(10)[9:] / (EXACT * mass)
    R = np.concatenate([whiten @ weighed.sums, known, mass_row, np.diag(1 / (LOOSE * unit))])
    y = np.concatenate([whiten @ weighed.values, stated, [1 / EXACT], supposed / (LOOSE * unit)])
    body = Body("payload", np.arange(10), np.zeros(10))
    chi = constrained_least_squares(R, y, unbounded([body], unit, mass, length))
    return chi, float(np.linalg.norm(whiten @ (weighed.sums @ chi - weighed.values)))
