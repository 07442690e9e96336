"""Payloads: estimates of their parameters, and the rigid body behind them in a frame, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gtau import display
from gtau.documents.validation import PATH, takes
from gtau.estimation.diagnostics.verdict import GOOD, Verdict
from gtau.estimation.results.estimate import Estimate
from gtau.robots.parameter import RigidBody
from gtau.robots.robot import Pose


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
